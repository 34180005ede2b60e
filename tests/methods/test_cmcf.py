"""cMCF: spheres stay, spheroids become them as is known, cuts do not matter, and a flow that is not done says so."""

from __future__ import annotations

import json

import numpy as np
import pytest
from meshes import grid, icosphere, spheroid, tetrahedron
from oracles import moebius_distance

import pgcp
from pgcp.cli.main import main
from pgcp.methods.cmcf import centred, flow, vertex_areas
from pgcp.surface.operators import cotangent_laplacian


def mapped(mesh, **named):
    return pgcp.parameterize(mesh, method="cmcf", **{"moebius": "none", "patches": 2, **named})


def test_a_step_is_the_implicit_one():
    mesh, _ = spheroid(2, 1.5)
    laplacian = cotangent_laplacian(mesh.vertices, mesh.faces)
    inverse = np.linalg.pinv(laplacian.toarray())
    with pytest.raises(pgcp.NumericalError, match=r"has not come to rest at a sphere in 1 steps: radii spread by 0\.1"):
        flow(mesh.vertices, mesh.faces, lambda load: inverse @ load, lambda x: laplacian @ x, 0.1, 1)
    start = centred(mesh.vertices, vertex_areas(mesh.vertices, mesh.faces))
    areas = np.diag(vertex_areas(start, mesh.faces))
    exact = np.linalg.solve(areas + 10.0 * laplacian.toarray(), areas @ start)
    points, _ = flow_once(mesh, 10.0)
    exact = centred(exact, vertex_areas(exact, mesh.faces))
    assert np.abs(points - exact).max() < 1e-5


def flow_once(mesh, step):
    """The first step of a flow, taken for the last."""
    from pgcp.methods import cmcf

    laplacian = cotangent_laplacian(mesh.vertices, mesh.faces)
    inverse = np.linalg.pinv(laplacian.toarray())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cmcf, "is_at_rest", lambda steps: True)
        return flow(mesh.vertices, mesh.faces, lambda load: inverse @ load, lambda x: laplacian @ x, step, 1)


def test_a_sphere_stays_and_a_spheroid_becomes_one():
    mesh = icosphere(2)
    assert moebius_distance(mapped(mesh, flow_step=0.5).coordinates, mesh.vertices) < 1e-3
    errors = []
    for levels in (1, 2):
        surface, exact = spheroid(levels, 1.5)
        errors.append(moebius_distance(mapped(surface, flow_step=0.5).coordinates, exact))
    assert errors[1] < 0.35 * errors[0] < 0.1


@pytest.mark.slow
def test_cuts_do_not_matter():
    mesh = spheroid(2, 1.4)[0]
    two, four = (mapped(mesh, patches=patches, flow_step=0.5).coordinates for patches in (2, 4))
    assert np.abs(two - four).max() < 1e-9


def test_the_smallest_surface_is_mapped():
    assert mapped(tetrahedron()).quality.folds == 0


def test_the_report_has_the_flow(tmp_path):
    pgcp.write_mesh(tmp_path / "ball.ply", spheroid(2, 1.5)[0])
    assert (
        main([str(tmp_path / "ball.ply"), "--method", "cmcf", "--flow-step", "0.4", "--no-png", "--patches", "2", "--quiet"])
        == 0
    )
    report = json.loads((tmp_path / "ball_pgcp" / "report.json").read_text())
    spreads = [step["spread"] for step in report["iterations"]]
    assert spreads[-1] < 0.02 < 0.1 < spreads[0]
    assert (report["options"]["flow_step"], report["options"]["flow_steps"]) == (0.4, 100)
    assert report["converged"] is True


def test_a_flow_that_is_not_done_ends_with_status_3(tmp_path, capsys):
    pgcp.write_mesh(tmp_path / "ball.ply", spheroid(2, 1.5)[0])
    assert main([str(tmp_path / "ball.ply"), "--method", "cmcf", "--flow-steps", "2", "--patches", "2", "--quiet"]) == 3
    said = capsys.readouterr().err
    assert "the flow has not come to rest at a sphere in 2 steps: radii spread by" in said
    assert "try more steps (--flow-steps), or choose --method pgcp" in said


@pytest.mark.parametrize(
    ("named", "sentence"),
    [
        ({"flow_step": 0}, "flow_step is 0.0, it must be above 0"),
        ({"flow_steps": -3}, "flow_steps is -3, it must be above 0"),
        ({"flow_steps": 1.5}, "flow_steps is 1.5, it must be a whole number"),
        ({"target": "free"}, "the method cmcf is one for the target sphere, not free"),
    ],
)
def test_what_it_cannot_do_is_refused(named, sentence):
    with pytest.raises(pgcp.InputError, match=sentence):
        mapped(grid(3), **named)


@pytest.mark.slow
def test_angle_errors_of_a_real_mesh_are_below_those_of_one_pole(mesh_folder):
    result = pgcp.parameterize(mesh_folder / "closed" / "max_planck.ply", method="cmcf")
    assert result.quality.angle_mean_deg < 0.9
    assert result.quality.folds == 0
