"""The embedding into the disk that hardly shrinks anything, whatever the surface's shape."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import cap, grid, icosphere
from test_grid import needle

import pgcp
from pgcp.errors import SolveFailedError
from pgcp.folds.embed import embed_disk
from pgcp.folds.grid_disk import grid_disk
from pgcp.plane.space import PLANE, find_folds
from pgcp.surface.topology import examine
from pgcp.types import Mesh


def fan(count):
    turn = 2 * np.pi * np.arange(count) / count
    points = np.vstack([[0, 0, 1], np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])])
    k = np.arange(count)
    return Mesh(points, np.column_stack([0 * k, 1 + k, 1 + (k + 1) % count]), "fan")


def without_a_face(mesh):
    return Mesh(mesh.vertices, mesh.faces[1:], mesh.name)


def strip(count):
    k = np.arange(count)
    faces = np.where((k % 2 == 1)[:, None], np.column_stack([k, k + 2, k + 1]), np.column_stack([k, k + 1, k + 2]))
    n = np.arange(count + 2)
    return Mesh(np.column_stack([0.5 * n, -(n % 2), 0 * n]).astype(float), faces, "strip")


MESHES = {
    "triangle": Mesh(np.eye(3), np.array([[0, 1, 2]])),
    "square": grid(1),
    "grid": grid(30, 20),
    "cap": cap(20)[0],
    "ball": without_a_face(icosphere(4)),
    "needle": without_a_face(needle(500)),
    "fan": fan(5000),
    "strip": strip(3000),
}


@pytest.mark.parametrize("name", MESHES)
def test_nothing_is_folded_whatever_the_shape(name):
    mesh = MESHES[name]
    (loop,) = examine(mesh.faces, len(mesh.vertices)).loops
    z = grid_disk(mesh.faces, len(mesh.vertices), loop)
    assert len(find_folds(PLANE, mesh.faces, z)) == 0
    assert z[loop] == pytest.approx(np.exp(2j * np.pi * np.arange(len(loop)) / len(loop)))
    a, b, c = z[mesh.faces.T]
    assert (np.conj(b - a) * (c - a)).imag.min() > 1e-4 / len(mesh.faces) ** 2


def test_uniform_weights_shrink_a_needle_until_it_folds():
    mesh = without_a_face(needle(500))
    (loop,) = examine(mesh.faces, len(mesh.vertices)).loops
    z = np.zeros(len(mesh.vertices), complex)
    z[loop] = np.exp(2j * np.pi * np.arange(3) / 3)
    assert len(find_folds(PLANE, mesh.faces, embed_disk(mesh, z, loop, 0.0, True))) > 100


def test_what_is_no_triangulation_without_double_edges_is_refused():
    """Two faces on the same three vertices, one with its side to a third: closed off, an edge is there twice."""
    with pytest.raises(SolveFailedError):
        grid_disk(np.array([[0, 1, 2], [0, 1, 2]]), 3, np.array([0, 1, 2]))


@pytest.mark.parametrize(("rows", "columns"), [(30, 1), (60, 1)])
def test_folds_that_crowding_brings_are_taken_away(rows, columns):
    """A sheet whose rows shrink over three decades: its ends are so crowded on the circle that faces have no room there."""
    flat = grid(rows, columns)
    size = 10.0 ** (3 * (flat.vertices[:, 0] - 1))
    across = flat.vertices[:, 1] / flat.vertices[:, 1].max()
    mesh = Mesh(np.column_stack([size, size * across, 0 * size]), flat.faces, "graded sheet")
    result = pgcp.compute(mesh, pgcp.Options(target="disk"))
    assert result.quality.folds == 0
    a, b, c = (result.coordinates @ [1, 1j])[mesh.faces.T]
    assert (np.conj(b - a) * (c - a)).imag.min() > 0
