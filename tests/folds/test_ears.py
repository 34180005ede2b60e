"""Faces with two edges on the circle have an area even where three points of the circle lie on one line in double precision."""

from __future__ import annotations

import numpy as np
import pytest

import pgcp
from pgcp.folds.ears import ears_among, lifted_ears
from pgcp.surface.beltrami import folded_faces
from pgcp.types import Mesh


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.0, np.pi, 4.4])
@pytest.mark.parametrize("gap", [1e-9, 1e-12, 1e-14])
def test_an_ear_is_lifted_off_the_line_by_a_few_units_in_the_last_place(angle, gap):
    z = np.exp(1j * (angle + np.array([0.0, gap, 2 * gap, 2.0])))
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    folded = folded_faces(faces, z)
    lifted = lifted_ears(z, faces, folded, np.arange(4))
    assert len(folded_faces(faces, lifted)) == 0
    assert np.abs(np.abs(lifted) - 1.0).max() < 17 * np.finfo(float).eps
    assert (lifted != z).sum() == (0 in folded)


def test_only_faces_with_a_corner_of_their_own_on_the_boundary_are_ears():
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4]], np.int32)
    ears, tips = ears_among(faces, np.arange(3), np.arange(5))
    assert ears.tolist() == [0, 2]
    assert tips.tolist() == [1, 4]
    assert len(ears_among(faces, np.arange(3), np.array([0, 2, 3]))[0]) == 0


def test_a_sheet_graded_over_six_decades_has_no_fold_on_the_disk():
    i, j = np.meshgrid(np.arange(121), np.arange(61), indexing="ij")
    size = 10.0 ** (6 * i / 120 - 6)
    points = np.column_stack([size.ravel(), (size * j / 60).ravel(), np.zeros(i.size)])
    a = (i * 61 + j)[:-1, :-1].ravel()
    faces = np.stack([np.column_stack([a, a + 61, a + 62]), np.column_stack([a, a + 62, a + 1])], axis=1).reshape(-1, 3)
    result = pgcp.compute(Mesh(points, faces), pgcp.Options(target="disk"))
    assert result.quality.folds == 0
    assert any(repair["method"] == "lift" for repair in result.report["repairs"])
