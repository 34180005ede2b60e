"""Intrinsic Delaunay triangulations: no negative weight is left, lengths and area of the surface stay."""

from __future__ import annotations

import numpy as np
import pytest

from pgcp.surface.intrinsic import intrinsic_delaunay, share_not_delaunay
from pgcp.surface.operators import cotangent_laplacian, face_areas
from pgcp.surface.topology import pair_half_edges
from pgcp.types import Mesh
from tests.meshes import grid, icosphere, lifted


def stretched(mesh, factors):
    return Mesh(mesh.vertices * factors, mesh.faces)


def triangulated(mesh, mollification=0.0):
    return intrinsic_delaunay(mesh, pair_half_edges(mesh.faces, len(mesh.vertices)), mollification)


def least_weight(laplacian):
    off = laplacian.tocoo()
    inner = off.row != off.col
    return -off.data[inner].max()


@pytest.mark.parametrize("mesh", [stretched(lifted(grid(20)), (1, 0.1, 1)), stretched(icosphere(3), (1, 1, 0.02))])
def test_no_negative_weight_is_left_but_on_the_boundary(mesh):
    found = triangulated(mesh)
    assert found.flips > 50
    flat = found.faces.reshape(-1)
    laplacian = found.laplacian(len(mesh.vertices)).tocsr()
    laplacian.sum_duplicates()
    assert np.abs(laplacian.sum(axis=1)).max() < 1e-6 * laplacian.diagonal().max()
    if (pair_half_edges(mesh.faces, len(mesh.vertices)) >= 0).all():
        assert least_weight(laplacian) > -1e-6 * laplacian.diagonal().max()
    assert sorted(np.unique(flat)) == sorted(np.unique(mesh.faces))
    assert least_weight(cotangent_laplacian(mesh.vertices, mesh.faces)) < -0.1


def test_area_stays_and_lengths_are_those_of_the_surface():
    mesh = stretched(icosphere(3), (1, 1, 0.02))
    found = triangulated(mesh)
    half = found.lengths.sum(axis=1) / 2
    areas = np.sqrt(half * np.prod(half[:, None] - found.lengths, axis=1))
    assert areas.sum() == pytest.approx(face_areas(mesh.vertices, mesh.faces).sum(), rel=1e-9)


def test_in_the_plane_it_is_the_delaunay_triangulation():
    from scipy.spatial import Delaunay

    rng = np.random.default_rng(4)
    points = rng.random((200, 2))
    points[:4] = [(-1, -1), (2, -1), (2, 2), (-1, 2)]
    wanted = Delaunay(points)
    # another triangulation of the same points: that of them squeezed to a fifth
    other = Delaunay(points * (1, 0.2)).simplices
    a, b, c = points[other].transpose(1, 0, 2)
    turned = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0
    other[turned] = other[turned][:, ::-1]
    mesh = Mesh(np.column_stack([points, np.zeros(200)]), other)
    found = triangulated(mesh)
    assert found.flips > 0
    assert {tuple(sorted(face)) for face in found.faces.tolist()} == {tuple(sorted(face)) for face in wanted.simplices.tolist()}


def test_the_share_of_negative_weights():
    mesh = icosphere(2)
    twins = pair_half_edges(mesh.faces, len(mesh.vertices))
    assert share_not_delaunay(mesh, twins, 0.0) < 0.05
    assert share_not_delaunay(stretched(mesh, (1, 1, 0.02)), twins, 0.0) > 0.1


def test_faces_without_area_are_flipped_away():
    quad = Mesh(np.array([[0.0, 0, 0], [2, 0, 0], [1, 0, 0], [1, 1, 0]]), np.array([[0, 1, 3], [0, 2, 1]]))
    found = triangulated(quad, 1e-5)
    assert found.flips == 1
    assert np.isfinite(found.laplacian(4).toarray()).all()
