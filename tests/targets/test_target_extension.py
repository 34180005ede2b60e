"""A target is one thing, registered: the command and the library know it then."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from meshes import grid, icosphere, lifted, similarity_error

import pgcp
from pgcp.cli.main import main
from pgcp.finish.place import place_free
from pgcp.targets.registry import TARGETS


@pytest.fixture
def toy():
    """The plane with the long axis of the boundary upright."""

    def upright(done, centre=None):
        coordinates = place_free(done, centre)
        return np.column_stack([-coordinates[:, 1], coordinates[:, 0]])

    target = replace(TARGETS.get("free"), name="upright", summary="as free, on end", place=upright, rank=5)
    yield TARGETS.register(target)
    TARGETS.remove(target.name)


def test_a_registered_target_runs_through_the_command(toy, tmp_path, capsys):
    mesh = grid(6, 24)
    pgcp.write_mesh(tmp_path / "strip.ply", mesh)
    assert main([str(tmp_path / "strip.ply"), "--target", toy.name, "--patches", "3", "--no-png"]) == 0
    assert "target upright, 3 patches" in capsys.readouterr().out
    assert json.loads((tmp_path / "strip_pgcp" / "report.json").read_text())["target"] == toy.name
    uv = np.load(tmp_path / "strip_pgcp" / "strip.npz")["uv"]
    assert similarity_error(uv @ [1, 1j], mesh.vertices @ [1, 1j, 0]) < 1e-7
    assert np.ptp(uv[:, 1]) == pytest.approx(4 * np.ptp(uv[:, 0]))


@pytest.mark.parametrize("options", [{}, {"seams": "exact"}, {"seams": "relax"}, {"workers": 1}])
def test_a_registered_target_goes_by_every_route(toy, options):
    free, upright = (
        pgcp.parameterize(lifted(grid(12)), target=target, patches=3, **options).coordinates for target in ("free", toy.name)
    )
    assert np.array_equal(np.column_stack([-free[:, 1], free[:, 0]]), upright)


def test_a_target_that_does_not_fit_is_refused_by_its_name(toy):
    with pytest.raises(pgcp.NotSimplyConnectedError, match="which the target upright does not fit; use target sphere"):
        pgcp.parameterize(icosphere(1), target=toy.name)
    with pytest.raises(pgcp.NotSimplyConnectedError, match="use target free or disk or upright"):
        pgcp.parameterize(grid(3), target="sphere")


def test_auto_chooses_the_target_of_least_rank(toy):
    assert pgcp.parameterize(grid(5), patches=1).target == "free"
    TARGETS.register(replace(toy, rank=-1))
    assert pgcp.parameterize(grid(5), patches=1).target == "upright"


@pytest.mark.parametrize("name", TARGETS.names())
def test_every_target_says_what_it_is_and_is_mapped_to(name):
    target = TARGETS.get(name)
    assert (target.name, bool(target.summary)) == (name, True)
    result = pgcp.parameterize(icosphere(2) if target.space.closed else lifted(grid(8)), target=name, patches=2)
    assert (result.target, result.quality.folds, result.coordinates.shape[1]) == (name, 0, target.space.dimension)
