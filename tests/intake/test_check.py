"""What is refused for its geometry, in one sentence; and faces of no area, collapsed on request."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from meshes import grid, icosphere, lifted, lines_up

import pgcp
from pgcp.errors import DegenerateError
from pgcp.intake.manifold import contracted, flattened_fins
from pgcp.intake.mend import mend
from pgcp.types import Mesh

PILLOW = Mesh(np.eye(3), np.array([[0, 1, 2], [0, 2, 1]]), "pillow")


def snapped(mesh, steps, noise=0.0):
    """A mesh whose vertices are moved to a grid of so many steps a unit: voxel-like, most of its faces without area."""
    moved = np.round(mesh.vertices * steps) / steps
    return Mesh(moved + noise * np.random.default_rng(5).normal(size=moved.shape), mesh.faces, mesh.name)


def half(mesh):
    return Mesh(mesh.vertices, mesh.faces[mesh.vertices[mesh.faces][:, :, 2].mean(axis=1) > -0.2], mesh.name)


@pytest.mark.parametrize("turn", [[0, 1], [1, 0]])
@pytest.mark.parametrize("options", [{}, {"fix": True}, {"target": "disk"}, {"target": "sphere", "patches": 2}])
def test_two_faces_glued_together_are_refused(options, turn):
    faces = np.roll(PILLOW.faces, 1, axis=1)[turn]
    with pytest.raises(DegenerateError, match="pillow: the surface is two faces glued along all three edges"):
        pgcp.compute(Mesh(np.vstack([np.zeros(3), PILLOW.vertices]), faces + 1, "pillow"), pgcp.Options(**options))


def test_a_tetrahedron_is_not():
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    assert pgcp.parameterize(Mesh(np.vstack([np.eye(3), np.zeros(3)]), faces)).quality.folds == 0


VOXELS = {
    "ball": snapped(icosphere(5), 10),
    "coarse ball": snapped(icosphere(4), 2),
    "other ball": snapped(Mesh(icosphere(5).vertices * [1.3, 0.9, 0.7], icosphere(5).faces), 7),
    "half": half(snapped(icosphere(5), 10)),
    "sheet": snapped(lifted(grid(60)), 9),
}


@pytest.mark.parametrize("name", VOXELS)
def test_faces_of_no_area_are_collapsed_on_request(name):
    mesh = VOXELS[name]
    with pytest.raises(DegenerateError, match=r"\d+ of \d+ faces have zero area; --fix would collapse \d+ vertices into"):
        pgcp.parameterize(mesh, patches=2)
    result = pgcp.parameterize(mesh, patches=2, fix=True)
    assert result.report["fixes"][0]["step"] == "collapse"
    assert result.report["fixes"][0]["message"].startswith("collapsed ")
    assert result.quality.folds == 0
    lines_up(mesh, result)
    corners = result.mesh.vertices[result.mesh.faces]
    assert not (corners == np.roll(corners, -1, axis=1)).all(axis=2).any()


def test_a_vertex_at_the_centre_may_be_one_that_was_collapsed():
    mesh = VOXELS["half"]
    into = contracted(mesh.vertices, mesh.faces)
    inner = np.flatnonzero((into != np.arange(len(into))) & (mesh.vertices[:, 2] > 0.5))[0]
    result = pgcp.parameterize(mesh, patches=2, fix=True, target="disk", centre=int(inner))
    here = np.flatnonzero(result.vertex_of == into[inner])[0]
    assert np.abs(result.coordinates[here]).max() < 1e-9


def test_faces_without_area_on_a_line_are_not_called_mendable():
    flat = Mesh(grid(6).vertices * [1.0, 0.0, 0.0], grid(6).faces, "line")
    with pytest.raises(DegenerateError, match=r"zero area$"):
        pgcp.parameterize(flat)
    with pytest.raises(DegenerateError, match="zero area"):
        pgcp.parameterize(flat, fix=True)


def test_a_mesh_that_fits_is_not_collapsed():
    """A tenth of the faces have no area: the map copes."""
    mesh = lifted(grid(12, jitter=0.2))
    vertices = mesh.vertices.copy()
    vertices[mesh.faces[::20, 0]] = vertices[mesh.faces[::20, 1]]
    assert pgcp.parameterize(Mesh(vertices, mesh.faces), patches=2, fix=True).report["fixes"] == []


def test_fins_of_any_depth_go_and_the_surface_closes_up():
    """A strip of faces back to back stands on an edge of a sphere cut open there."""
    ball = icosphere(2)
    a, b = ball.faces[0, :2]
    n = len(ball.vertices)
    strip = np.array([[a, b, n], [b, n + 1, n], [n, n + 1, n + 2]])
    faces = np.vstack([ball.faces, strip, strip[:, ::-1]])
    fins = flattened_fins(faces, n + 3)
    assert np.array_equal(np.flatnonzero(fins), len(ball.faces) + np.arange(6))
    assert not flattened_fins(ball.faces, n).any()
    assert not flattened_fins(np.vstack([ball.faces, strip]), n + 3).any()
    twice = np.vstack([ball.faces, strip, strip])  # listed twice the same way round: no fin
    assert not flattened_fins(twice, n + 3).any()


def test_what_is_collapsed_keeps_the_rest():
    mesh = VOXELS["ball"]
    mended = mend(mesh, collapses=True)
    assert mended.topology.is_sphere
    assert mended.fixes[0].step == "collapse"
    assert len(np.unique(mended.mesh.vertices, axis=0)) >= len(mended.mesh.vertices) - 40


@pytest.mark.parametrize(
    "noise", [pytest.param(1e-15, marks=pytest.mark.slow), 1e-12, pytest.param(1e-9, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("options", [{"target": "disk"}, {"flatten": "scp"}, {"method": "scp"}])
def test_faces_of_nearly_no_area_give_no_warning(options, noise):
    mesh = half(snapped(icosphere(4), 8, noise))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            pgcp.compute(mesh, pgcp.Options(**options))
        except pgcp.NumericalError:
            return
