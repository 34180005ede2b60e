from __future__ import annotations

import pytest
from meshes import SHARED, grid, lifted


@pytest.fixture(scope="session")
def hills():
    return lifted(grid(24))


@pytest.fixture
def mesh_folder():
    if not SHARED.is_dir():
        pytest.skip("the folder of real meshes is not beside this checkout")
    return SHARED
