"""Where a closed surface is opened: at a well-shaped face near its middle."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import icosphere

import pgcp
from pgcp.interface.puncture import large_faces, puncture_face
from pgcp.plane.mobius import boost
from pgcp.surface.operators import face_areas
from pgcp.types import Mesh


def spheroid_with(height, rough, seed=0):
    """A spheroid of this height whose vertices are moved where ``rough``, of their points on the sphere, says so."""
    sphere = icosphere(3)
    random = np.random.default_rng(seed)
    points = sphere.vertices + 0.06 * random.normal(size=sphere.vertices.shape) * rough(sphere.vertices)[:, None]
    return Mesh(points / np.linalg.norm(points, axis=1, keepdims=True) * [1, 1, height], sphere.faces)


def corner_angles(mesh, face):
    for k in range(3):
        a, b, c = (mesh.vertices[mesh.faces[face, (k + j) % 3]] for j in range(3))
        yield np.arccos((b - a) @ (c - a) / np.linalg.norm(b - a) / np.linalg.norm(c - a))


def worst_around(mesh, face):
    """The most that an angle of the face, or of one that shares a vertex with it, is away from 60 degrees."""
    near = np.flatnonzero(np.isin(mesh.faces, mesh.faces[face]).any(axis=1))
    return max(abs(angle - np.pi / 3) for other in near for angle in corner_angles(mesh, other))


def from_the_middle(mesh):
    return np.linalg.norm(mesh.vertices[mesh.faces].mean(axis=1), axis=1)


@pytest.mark.parametrize("seed", range(3))
def test_of_the_faces_near_the_middle_the_best_shaped_is_opened(seed):
    mesh = spheroid_with(0.6, lambda p: np.where(p[:, 2] < 0.9, 1.0, 0.0), seed)
    face = puncture_face(mesh)
    distance = from_the_middle(mesh)
    near = np.flatnonzero(distance <= np.quantile(distance, 0.2))
    assert distance[face] <= np.quantile(distance, 0.3)
    assert worst_around(mesh, face) <= min(worst_around(mesh, other) for other in near) + 1e-12


def test_the_tip_of_a_limb_is_not_opened_however_well_shaped():
    """The tips of a long spheroid have its best faces; the middle is rough."""
    mesh = spheroid_with(3.0, lambda p: np.where(np.abs(p[:, 2]) < 0.9, 1.0, 0.0))
    distance, face = from_the_middle(mesh), puncture_face(mesh)
    everywhere = range(0, len(mesh.faces), 7)
    assert min(everywhere, key=lambda f: worst_around(mesh, f)) in np.flatnonzero(distance > np.quantile(distance, 0.8))
    assert distance[face] <= np.quantile(distance, 0.3)


def test_other_faces_are_opened_where_the_first_leads_to_large_errors():
    """A sphere moved along itself: fine on one side, so coarse on the other that no chart of it is good; it is its own map."""
    ball = icosphere(3)
    moved = boost(ball.vertices, np.array([0.9, 0.1, 0.2]) * 0.9)
    mesh = Mesh(moved, ball.faces)
    faces = large_faces(mesh, 5)
    areas = face_areas(mesh.vertices, mesh.faces)
    assert len(set(faces.tolist())) == 5
    assert faces[0] == np.argmax(areas)
    assert areas[faces].min() >= np.quantile(areas, 0.9)
    result = pgcp.parameterize(mesh, target="sphere", seams="exact")
    assert result.quality.folds == 0
    assert result.quality.angle_mean_deg < 2.0
