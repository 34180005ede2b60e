"""Seams solved exactly or relaxed: what takes the place of such a map, and what is said of it."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import icosphere

import pgcp
from pgcp.types import Mesh


@pytest.mark.parametrize("method", ["dncp", "scp"])
def test_a_map_from_welds_that_is_better_says_why(method):
    ball = icosphere(2)
    result = pgcp.parameterize(Mesh(ball.vertices, ball.faces[1:], "without a face"), method=method)
    assert result.report["retries"] == []
    assert result.report["fallback"]["to"] == "welded ones"
    assert "smaller angle errors" in result.report["fallback"]["reason"]
    assert result.quality.folds == 0


def test_seams_of_a_split_that_was_done_with_are_relaxed():
    """All maps of a coiled tube to the plane fold; the disk is then tried from welds whose patches are no longer stored."""
    t = np.linspace(0, 1, 41)
    middle = np.column_stack([np.cos(20 * t) * (1 + t), np.sin(20 * t) * (1 + t), 4 * t])
    along = np.gradient(middle, axis=0)
    side = np.cross(along, [0, 0, 1.0])
    side /= np.linalg.norm(side, axis=1)[:, None]
    other = np.cross(along, side) / np.linalg.norm(along, axis=1)[:, None]
    turn = np.pi / 2 * np.arange(4)
    ring = np.cos(turn)[None, :, None] * side[:, None] + np.sin(turn)[None, :, None] * other[:, None]
    points = np.vstack([(middle[:, None] + 0.35 * np.linspace(1, 0.4, 41)[:, None, None] * ring).reshape(-1, 3), middle[-1:]])
    k, after = np.arange(4), (np.arange(4) + 1) % 4
    faces = [np.column_stack([160 + k, 160 + after, 0 * k + 164])]
    for start in range(0, 160, 4):
        faces += [start + np.column_stack([k, after, after + 4]), start + np.column_stack([k, after + 4, k + 4])]
    result = pgcp.compute(Mesh(points, np.concatenate(faces), "coil"), pgcp.Options(target="free", patches=2, seams="relax"))
    assert result.quality.folds == 0
