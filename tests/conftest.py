from __future__ import annotations

import pytest
from meshes import SHARED, grid, lifted


@pytest.fixture(scope="session")
def hills():
    return lifted(grid(24))


@pytest.fixture(autouse=True)
def _no_lines_of_progress(monkeypatch):
    """A run of this process that is slow, on a busy machine, says no more than another."""
    monkeypatch.setattr("pgcp.cli.progress._SOON", float("inf"))


@pytest.fixture
def mesh_folder():
    if not SHARED.is_dir():
        pytest.skip("the folder of real meshes is not beside this checkout")
    return SHARED
