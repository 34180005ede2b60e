"""The embedding into the sphere that rounding cannot fold."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import icosphere, tetrahedron
from scipy.spatial import ConvexHull

from pgcp.errors import SolveFailedError
from pgcp.folds.grid import grid_coordinates, grid_sphere
from pgcp.folds.repair import Surroundings, embedding_alone
from pgcp.plane.space import SPHERE, find_folds
from pgcp.surface.beltrami import covering_degree
from pgcp.types import Mesh


def random_sphere(count: int, seed: int) -> Mesh:
    """The hull of random points, most of them near one another: degrees from 3 to hundreds."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3)) * [1.0, 1.0, 30.0] + rng.integers(0, 2, (count, 1)) * [0.0, 0.0, 50.0]
    points /= np.linalg.norm(points, axis=1)[:, None]
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    turned = np.linalg.det(corners) < 0
    faces = np.where(turned[:, None], hull.simplices[:, ::-1], hull.simplices)
    return Mesh(points, faces)


def needle(length: int) -> Mesh:
    """A tube of three vertices around and so many along, closed at both ends: Tutte's map of it shrinks at every ring."""
    angle = 2 * np.pi * np.arange(3) / 3
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    points = np.column_stack([np.tile(ring, (length, 1)), np.repeat(np.arange(length), 3)]).astype(float)
    k, after = np.arange(3), (np.arange(3) + 1) % 3
    faces = [np.array([[2, 1, 0]]), np.array([[0, 1, 2]]) + 3 * (length - 1)]
    for i in range(length - 1):
        p, q = 3 * i + k, 3 * i + after
        faces += [np.column_stack([p, q, q + 3]), np.column_stack([p, q + 3, p + 3])]
    return Mesh(points, np.concatenate(faces))


MESHES = {
    "tetrahedron": tetrahedron(),
    "icosahedron": icosphere(0),
    "ball": icosphere(4),
    "random": random_sphere(3000, 1),
    "needle": needle(500),
}


@pytest.mark.parametrize("name", MESHES)
def test_nothing_is_folded_whatever_the_shape(name):
    mesh = MESHES[name]
    for lid in np.random.default_rng(0).integers(0, len(mesh.faces), 5).tolist():
        points = grid_sphere(mesh.faces, len(mesh.vertices), lid)
        assert np.linalg.norm(points, axis=1) == pytest.approx(1.0)
        assert len(find_folds(SPHERE, mesh.faces, points)) == 0
        assert covering_degree(mesh.faces, points) == pytest.approx(1.0)


@pytest.mark.parametrize("name", MESHES)
def test_coordinates_are_whole_numbers_on_a_small_grid(name):
    mesh = MESHES[name]
    share = grid_coordinates(mesh.faces, len(mesh.vertices), 0)
    assert (share.sum(axis=1) == len(mesh.faces) - 1).all()
    assert share.min() >= 0
    assert len(np.unique(share, axis=0)) == len(share)
    corners = share[np.delete(mesh.faces, 0, axis=0)]
    assert (np.linalg.det(corners) > 0).all()


def test_a_surface_of_which_no_other_embedding_is_free_of_folds_has_this_one():
    mesh = MESHES["needle"]
    points = embedding_alone(Surroundings(mesh, SPHERE, np.empty(0, np.int64), 0.0))
    assert len(find_folds(SPHERE, mesh.faces, points)) == 0


def test_two_edges_between_the_same_vertices_cannot_be_drawn():
    with pytest.raises(SolveFailedError):
        grid_coordinates(np.array([[0, 1, 2], [0, 2, 1], [0, 1, 3], [0, 3, 1]]), 4, 0)
