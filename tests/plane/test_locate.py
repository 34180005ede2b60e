"""Points of a map are found where it is crowded."""

from __future__ import annotations

import numpy as np
from meshes import grid
from scipy.spatial.transform import Rotation

from pgcp.plane.locate import Locator


def on_sphere(flat):
    square = (flat**2).sum(axis=1, keepdims=True)
    return np.hstack([2.0 * flat, 1.0 - square]) / (1.0 + square) @ Rotation.random(rng=3).as_matrix()


def test_places_on_faces_of_a_sphere_that_are_far_smaller_than_the_root_of_rounding():
    mesh = grid(20, jitter=0.2)
    flat = mesh.vertices[:, :2] * 1e-9
    rng = np.random.default_rng(1)
    faces, weights = rng.integers(0, len(mesh.faces), 2000), rng.dirichlet([1, 1, 1], 2000)
    places = np.einsum("nk,nkd->nd", weights, flat[mesh.faces[faces]])
    found = Locator(on_sphere(flat), mesh.faces, True).find(on_sphere(places), mesh.vertices)
    wanted = np.einsum("nk,nkd->nd", weights, mesh.vertices[mesh.faces[faces]])
    assert found.inside.mean() > 0.999
    assert np.abs(found.points - wanted).max() < 1e-4
