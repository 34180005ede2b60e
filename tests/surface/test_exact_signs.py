"""Signs of many determinants at once, against rational arithmetic."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from pgcp.surface import exact
from pgcp.surface.exact import plane_signs, space_signs


def _slivers(count, dimension, seed=0):
    """Triangles whose determinants are 0 or next to it: a third corner on the line or the plane of the others, as rounded."""
    random = np.random.default_rng(seed)
    a, b = random.normal(size=(2, count, dimension))
    t = random.uniform(0, 1, (count, 1))
    c = t * a + ((1 - t) if dimension == 2 else random.uniform(0, 1, (count, 1))) * b
    corners = np.stack([a, b, c], axis=1)
    corners[::3, 2] = np.nextafter(corners[::3, 2], 9.0)
    corners[::5, 2] = corners[::5, 1]  # no area at all
    return corners


def _sign(corners):
    rows = [[Fraction(x) for x in row] for row in corners.tolist()]
    if len(rows[0]) == 2:
        rows = [[*row, Fraction(1)] for row in rows]
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = rows
    value = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    return (value > 0) - (value < 0)


@pytest.mark.parametrize(("signs", "dimension"), [(plane_signs, 2), (space_signs, 3)])
@pytest.mark.parametrize("scale", [1.0, 1e-80, 1e80, 1e-170, 1e110])
def test_signs_are_exact_at_every_scale(signs, dimension, scale):
    corners = _slivers(300, dimension) * scale
    expected = [_sign(face) for face in corners]
    assert {-1, 0, 1} == set(expected)
    assert signs(corners).tolist() == expected
    assert signs(corners[:7]).tolist() == expected[:7]
    assert signs(corners[:0]).tolist() == []


@pytest.mark.parametrize(("signs", "dimension"), [(plane_signs, 2), (space_signs, 3)])
def test_many_are_told_without_rational_numbers(signs, dimension, monkeypatch):
    """A map whose faces are nearly all squeezed has as many to be told as the mesh has faces, more than once."""
    corners = _slivers(1000, dimension, 1)
    expected = [_sign(face) for face in corners]
    monkeypatch.setattr(exact, "Fraction", None)
    assert signs(corners).tolist() == expected
