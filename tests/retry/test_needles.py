"""Maps that are harmonic on other triangles, where the mesh's own are needles."""

from __future__ import annotations

import numpy as np
import pytest

import pgcp
from pgcp.types import Mesh
from tests.meshes import grid, icosphere

WORKS = pgcp.Options()


def thin_plate(levels=4):
    ball = icosphere(levels)
    return Mesh(np.sign(ball.vertices) * np.abs(ball.vertices) ** 0.2 * (1, 1, 0.01), ball.faces)


def test_a_thin_plate_is_mapped_on_other_triangles_and_its_own_are_not_folded():
    plate = thin_plate()
    result = pgcp.compute(plate)
    assert result.report["intrinsic"]["flips"] > 1000
    assert result.quality.folds == 0
    assert np.array_equal(result.mesh.faces, plate.faces)
    exact = pgcp.compute(plate, pgcp.Options(seams="exact"))
    assert exact.report["intrinsic"] is None
    assert result.quality.angle_mean_deg < 0.35 * exact.quality.angle_mean_deg


def test_a_map_whose_weights_are_positive_stays_as_it_is():
    result = pgcp.compute(icosphere(3))
    assert result.report["intrinsic"] is None


@pytest.mark.parametrize("target", ["free", "disk"])
def test_the_better_of_both_is_taken_on_a_noisy_sheet(target):
    sheet = grid(40)
    rough = sheet.vertices.copy()
    rough[:, 2] = np.random.default_rng(2).normal(0.0, 0.6 / 40, len(rough))
    mesh = Mesh(rough, sheet.faces)
    result = pgcp.compute(mesh, pgcp.Options(target=target))
    exact = pgcp.compute(mesh, pgcp.Options(target=target, seams="exact"))
    assert result.quality.folds == 0
    assert result.quality.angle_mean_deg < exact.quality.angle_mean_deg


def test_the_map_is_the_same_with_workers():
    plate = thin_plate(3)
    alone = pgcp.compute(plate)
    assert alone.report["intrinsic"] is not None
    there = pgcp.compute(plate, None, pgcp.Running(workers=2))
    assert alone.coordinates.tobytes() == there.coordinates.tobytes()
