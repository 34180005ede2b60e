"""CEM with the sparse systems solved by multigrid: the map of the direct solver."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import grid, icosphere, lifted

import pgcp
from pgcp.cli.main import main

HILLS = lifted(grid(24, jitter=0.2))


def test_multigrid_gives_the_map_of_the_direct_solver():
    pytest.importorskip("pyamg")
    direct, multigrid = (pgcp.parameterize(HILLS, method="cem", target="disk", solver=name) for name in ("direct", "multigrid"))
    assert np.abs(direct.coordinates - multigrid.coordinates).max() < 1e-7
    assert multigrid.report["options"]["solver"] == "multigrid"


def test_multigrid_is_refused_where_it_cannot_be(tmp_path, capsys):
    with pytest.raises(pgcp.InputError, match="the solver multigrid is one for open surfaces"):
        pgcp.parameterize(icosphere(2), method="cem", solver="multigrid")
    pgcp.write_mesh(tmp_path / "m.ply", HILLS)
    assert main([str(tmp_path / "m.ply"), "--method", "ccem", "--solver", "multigrid"]) == 2
    assert "solver" in capsys.readouterr().err
