"""Which of several maps is taken."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import grid, icosphere

import pgcp
from pgcp.surface.operators import corner_weights, cotangents, needed_mollification
from pgcp.types import Mesh


@pytest.mark.parametrize("level", [2, 4])
def test_a_free_map_is_not_worse_than_one_to_the_disk(level):
    mesh = icosphere(level)
    open_one = Mesh(mesh.vertices, mesh.faces[1:], "sphere without a face")
    free, disk = (pgcp.parameterize(open_one, target=target).quality for target in ("free", "disk"))
    assert free.folds == disk.folds == 0
    assert free.angle_mean_deg <= disk.angle_mean_deg * (1 + 1e-9)


@pytest.mark.parametrize("height", [5.0, 0.2, 0.01])
def test_a_triangle_is_mapped_exactly(height):
    mesh = Mesh(np.array([[0.0, 0, 0], [10, 0, 0], [4, height, 1]]), np.array([[0, 1, 2]]), "one")
    for target in ("free", "disk"):
        result = pgcp.parameterize(mesh, target=target)
        assert result.quality.angle_max_deg < 1e-9
        assert result.report["fallback"] is None


def test_mollification_changes_only_faces_without_area():
    mesh = grid(8)
    points = mesh.vertices * [1e-5, 1e-5, 1]  # most faces tiny, and one large one without area
    points = np.vstack([points, [[0.5, 0, 0], [1, 0, 0]]])
    faces = np.vstack([mesh.faces, [[0, len(points) - 2, len(points) - 1]]])
    assert needed_mollification(points[:-2], mesh.faces) == 0
    needed = needed_mollification(points, faces)
    assert needed > 0
    weights = corner_weights(points, faces, needed)
    assert np.array_equal(weights[:-1], 0.5 * cotangents(points, mesh.faces))
    assert np.isfinite(weights[-1]).all()
