"""Folds are told exactly, where double arithmetic tells them wrong."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from pgcp.surface.beltrami import folded_faces, folded_faces_on_sphere


def exact(row):
    return [Fraction(x) for x in row.tolist()]


def plane_is_folded(a, b, c):
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) <= 0


def sphere_is_folded(a, b, c):
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = a, b, c
    return ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx) <= 0


def volume(points):
    """The sign's usual formula, in doubles."""
    a, b, c = points
    return float(np.cross(b - a, c - a) @ a)


def test_folds_in_the_plane_are_exact():
    random = np.random.default_rng(0)
    a, along = random.normal(size=(2, 3000, 2))
    t = random.uniform(0, 1, (3000, 1))
    corners = np.stack([a, a + along, a + t * along + 1e-17 * random.normal(size=(3000, 2))], axis=1)
    z = corners.reshape(-1, 2) @ [1, 1j]
    faces = np.arange(9000).reshape(-1, 3)
    expected = [plane_is_folded(*map(exact, face)) for face in corners]
    in_doubles = [((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]) <= 0 for a, b, c in corners]
    assert sum(one != other for one, other in zip(expected, in_doubles, strict=True)) > 100
    assert folded_faces(faces, z).tolist() == np.flatnonzero(expected).tolist()


def test_folds_on_the_sphere_are_exact():
    """Corners next to a great circle: the sign of their determinant is lost in doubles."""
    random = np.random.default_rng(1)
    a, b = random.normal(size=(2, 3000, 3))
    c = a * random.uniform(0, 1, (3000, 1)) + b + 1e-17 * random.normal(size=(3000, 3))
    corners = np.stack([a, b, c], axis=1)
    corners /= np.linalg.norm(corners, axis=2, keepdims=True)
    expected = [sphere_is_folded(*map(exact, face)) for face in corners]
    assert sum(folded != (volume(face) <= 0) for folded, face in zip(expected, corners, strict=True)) > 100
    found = folded_faces_on_sphere(np.arange(9000).reshape(-1, 3), corners.reshape(-1, 3))
    assert found.tolist() == np.flatnonzero(expected).tolist()
