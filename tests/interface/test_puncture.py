"""Where a closed surface is opened: at a well-shaped face near its middle."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import icosphere

from pgcp.interface.puncture import puncture_face
from pgcp.surface.operators import face_areas
from pgcp.types import Mesh


def bent_around(mesh):
    """For each face, the largest departure from 60 degrees (radians) of a corner of any face that shares a vertex with it."""
    corners = mesh.vertices[mesh.faces]
    ahead, behind = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cosine = (ahead * behind).sum(axis=2) / (np.linalg.norm(ahead, axis=2) * np.linalg.norm(behind, axis=2))
    bent = np.abs(np.arccos(np.clip(cosine, -1, 1)) - np.pi / 3).max(axis=1)
    return np.array([bent[np.isin(mesh.faces, face).any(axis=1)].max() for face in mesh.faces])


def from_centre(mesh):
    """Distance of each face from the surface's centre of mass."""
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    return np.linalg.norm(centres - np.average(centres, axis=0, weights=face_areas(mesh.vertices, mesh.faces)), axis=1)


def limbed(seed, roughness):
    """A sphere with a long limb, rough where it is round: the best faces of all are near the limb's tip."""
    sphere = icosphere(3)
    points = sphere.vertices.copy()
    points += roughness * np.random.default_rng(seed).normal(size=points.shape) * (points[:, 2:] < 0.9)
    points[:, 2] += np.where(sphere.vertices[:, 2] > 0.9, 3.0, 0.0) + 2.0 * np.maximum(points[:, 2], 0.0)
    return Mesh(points, sphere.faces)


@pytest.mark.parametrize("seed", range(4))
def test_the_face_is_the_best_shaped_with_those_around_it_of_the_central_quarter(seed):
    mesh = limbed(seed, 0.02)
    bent, away = bent_around(mesh), from_centre(mesh)
    central = away <= np.quantile(away, 0.25)
    chosen = puncture_face(mesh)
    assert central[chosen]
    assert bent[chosen] == pytest.approx(bent[central].min(), rel=1e-9)
    assert bent[chosen] < 0.7 * np.median(bent[central])
    assert bent.min() < 0.9 * bent[chosen]  # a better one lies outside


def test_a_face_without_area_is_never_opened_while_there_are_others():
    sphere = icosphere(1)
    points = sphere.vertices.copy()
    a, b, c = sphere.faces[0]
    points[a] = 0.5 * (points[b] + points[c])
    mesh = Mesh(points, sphere.faces)
    assert not np.isin(mesh.faces[puncture_face(mesh)], a).any()
