"""FLASH: its parts on small cases, and a sphere that comes back whatever the cuts."""

from __future__ import annotations

import numpy as np
from meshes import icosphere
from oracles import moebius_distance

import pgcp
from pgcp.methods.common.kept import most_regular_face
from pgcp.methods.flash import similar_triangle
from pgcp.plane.space import SPHERE, find_folds
from pgcp.types import Mesh


def test_similar_triangle_keeps_angles():
    corners = np.array([[0.0, 0, 1], [2, 0, 1], [0.5, 0, 2]])
    assert np.allclose(similar_triangle(corners), [0, 1, 0.25 + 0.5j])


def test_most_regular_face_is_the_equilateral_one():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 3**0.5 / 2, 0], [3, 3, 0]])
    assert most_regular_face(Mesh(vertices, np.array([[1, 3, 2], [0, 1, 2]]))) == 1


def test_sphere_comes_back_up_to_moebius_and_cuts_do_not_matter():
    mesh = icosphere(3)
    one, other = (pgcp.parameterize(mesh, method="flash", patches=p, moebius="none") for p in (2, 5))
    assert len(find_folds(SPHERE, mesh.faces, one.coordinates)) == 0
    assert moebius_distance(one.coordinates, mesh.vertices) < 0.01
    assert np.abs(one.coordinates - other.coordinates).max() < 1e-9
