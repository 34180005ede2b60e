"""Cotangents keep their digits, whatever the triangle."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from pgcp.surface.operators import cotangents


def exact_cotangent(triangle, corner):
    """Cotangent at a corner: its square is rational."""
    a, b, c = ([Fraction(x) for x in triangle[(corner + k) % 3].tolist()] for k in range(3))
    u, v = ([x - y for x, y in zip(p, a, strict=True)] for p in (b, c))
    dot = sum(x * y for x, y in zip(u, v, strict=True))
    normal = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    square = dot**2 / sum(x * x for x in normal)
    return float(np.sign(float(dot))) * float(square) ** 0.5


@pytest.mark.parametrize("first", [0, 1, 2])
@pytest.mark.parametrize("height", [1e-3, 1e-6, 1e-9])
def test_a_needle_has_the_cotangents_of_its_exact_corners(height, first):
    """Two corners close together, whichever corner comes first: no digit of the short edge is lost in the long ones."""
    random = np.random.default_rng(int(-np.log10(height)) + first)
    for _ in range(40):
        tip, direction, aside = random.normal(size=(3, 3))
        triangle = np.roll([tip, tip + direction, tip + direction + height * aside], first, axis=0)
        found = cotangents(triangle, np.array([[0, 1, 2]]))[0]
        for corner in range(3):
            assert found[corner] == pytest.approx(exact_cotangent(triangle, corner), rel=1e-13, abs=1e-13)
