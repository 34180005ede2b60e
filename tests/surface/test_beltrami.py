"""Folds decided exactly, in the plane and on the sphere, and how often a sphere is covered."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from meshes import icosphere

from pgcp.plane.mobius import to_sphere
from pgcp.surface.beltrami import (
    beltrami_coefficients_on_sphere,
    covering_degree,
    folded_faces,
    folded_faces_on_sphere,
    signed_area,
)


def planar_area(a, b, c):
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def volume(a, b, c):
    return sum(a[i] * (b[(i + 1) % 3] * c[(i + 2) % 3] - b[(i + 2) % 3] * c[(i + 1) % 3]) for i in range(3))


def edge_volume(a, b, c):
    """The same number by edges, which loses less to rounding."""
    u, v = [y - x for x, y in zip(a, b, strict=True)], [y - x for x, y in zip(a, c, strict=True)]
    return sum(a[i] * (u[(i + 1) % 3] * v[(i + 2) % 3] - u[(i + 2) % 3] * v[(i + 1) % 3]) for i in range(3))


def exactly(form, corners):
    return form(*([Fraction(x) for x in corner] for corner in corners.tolist()))


def test_folds_in_the_plane_are_decided_exactly_where_doubles_mislead():
    rng = np.random.default_rng(0)
    corners = rng.uniform(-1, 1, (400, 3, 2))
    corners[:, 2] = corners[:, 0] + rng.uniform(0.1, 2, (400, 1)) * (corners[:, 1] - corners[:, 0])
    faces = np.arange(1200).reshape(-1, 3)
    exact = np.array([exactly(planar_area, three) <= 0 for three in corners])
    rounded = np.array([planar_area(*three) <= 0 for three in corners.tolist()])
    assert (exact != rounded).sum() > 20
    found = folded_faces(faces, corners.reshape(-1, 2) @ [1, 1j])
    assert found.tolist() == np.flatnonzero(exact).tolist()


def test_folds_on_the_sphere_are_decided_exactly_where_doubles_mislead():
    """Three points of a great circle, as near to it as numbers allow."""
    rng = np.random.default_rng(1)
    corners = rng.normal(size=(400, 3, 3))
    corners[:, 2] = rng.uniform(0.2, 1, (400, 1)) * corners[:, 0] + rng.uniform(0.2, 1, (400, 1)) * corners[:, 1]
    corners /= np.linalg.norm(corners, axis=2, keepdims=True)
    faces = np.arange(1200).reshape(-1, 3)
    exact = np.array([exactly(volume, three) <= 0 for three in corners])
    for rounding in (volume, edge_volume):
        assert (exact != np.array([rounding(*three) <= 0 for three in corners.tolist()])).sum() > 20
    assert folded_faces_on_sphere(faces, corners.reshape(-1, 3)).tolist() == np.flatnonzero(exact).tolist()


def test_a_face_that_turns_inwards_is_a_fold_and_has_a_large_coefficient():
    mesh = icosphere(2)
    assert len(folded_faces_on_sphere(mesh.faces, mesh.vertices)) == 0
    assert np.abs(beltrami_coefficients_on_sphere(mesh.vertices, mesh.faces, mesh.vertices)).max() < 1e-12
    mirrored = mesh.vertices * [1, 1, -1]
    assert len(folded_faces_on_sphere(mesh.faces, mirrored)) == len(mesh.faces)
    assert (np.abs(beltrami_coefficients_on_sphere(mesh.vertices, mesh.faces, mirrored)) > 1).all()


@pytest.mark.parametrize("times", [1, 2, 3])
def test_the_degree_is_how_often_the_sphere_is_covered(times):
    mesh = icosphere(4)
    x, y, z = mesh.vertices.T
    with np.errstate(divide="ignore", invalid="ignore"):
        w = (x + 1j * y) / (1 + z)
    image = to_sphere(w**times)
    assert covering_degree(mesh.faces, image) == pytest.approx(times, abs=1e-9)
    assert covering_degree(mesh.faces, image * [1, 1, -1]) == pytest.approx(-times, abs=1e-9)


def test_the_area_of_an_image_is_signed():
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    square = np.array([0, 2, 2 + 3j, 3j])
    assert signed_area(faces, square) == 6.0
    assert signed_area(faces, square.conj()) == -6.0
