"""Where closed curves cross themselves, against all pairs of edges in exact arithmetic."""

from __future__ import annotations

import numpy as np
import pytest

from pgcp.plane.curves import _exact_side, _meet, crosses_itself, crossings


def by_all_pairs(z):
    n = len(z)
    p = [complex(w) for w in z]
    apart = [(i, j) for i in range(n) for j in range(i + 2, n) if (i, j) != (0, n - 1)]
    return [[i, j] for i, j in apart if _meet(p[i], p[i + 1], p[j], p[(j + 1) % n])]


@pytest.mark.parametrize("n", [5, 9, 40, 100])
def test_crossings_are_those_of_all_pairs(n):
    rng = np.random.default_rng(n)
    seen = set()
    for _ in range(40 if n < 100 else 4):
        z = np.exp(2j * np.pi * np.arange(n) / n) * (1 + 0.9 * rng.uniform(-1, 1, n)) + rng.choice([0, 0.3]) * rng.normal(
            size=n
        )
        expected = by_all_pairs(z)
        assert crossings(z).tolist() == expected
        assert crosses_itself(z) == bool(expected)
        seen.add(bool(expected))
    assert seen == {True, False} or n > 40


def test_touching_is_crossing_and_is_decided_exactly():
    square = np.array([0, 2, 2 + 2j, 1, 2j])
    assert crossings(square).tolist() == [[0, 2], [0, 3]]
    assert crosses_itself(square)
    for lift in (1e-300, 5e-324):
        assert len(crossings(np.array([0, 2, 2 + 2j, 1 + lift * 1j, 2j]))) == 0
        assert len(crossings(np.array([0, 2, 2 + 2j, 1 - lift * 1j, 2j]))) == 2


def test_neighbours_that_fold_back_are_found():
    assert crossings(np.array([0, 2, 1, 1 + 1j])).tolist() == [[0, 1], [0, 2]]
    assert crossings(np.array([0, 2, 1 + 1e-20j, 1 + 1j])).tolist() == []
    assert crossings(np.array([0, 1, 1j])).tolist() == []


def test_a_long_spiral_is_searched_quickly_and_right():
    t = np.linspace(0, 40 * np.pi, 100_000)
    arm = t * np.exp(1j * t)
    simple = np.concatenate([arm, (arm + 0.3 * np.exp(1j * t))[::-1]])
    assert len(crossings(simple)) == 0
    simple[50_000] += 20.0
    assert crosses_itself(simple)


def rounded_side(a, b, p):
    """On which side of the line from a to b p lies, in doubles."""
    area = (b.real - a.real) * (p.imag - a.imag) - (b.imag - a.imag) * (p.real - a.real)
    return int(area > 0) - int(area < 0)


def by_rounding(z):
    """Whether edge 0 of a polygon meets the edges at its third point, in doubles."""
    sides = [rounded_side(z[0], z[1], z[k]) for k in (2, 3, 4)]
    return sides[0] * sides[1] <= 0 or sides[1] * sides[2] <= 0


def test_crossings_are_decided_exactly_where_doubles_mislead():
    """A spike comes down to an edge and ends as near to it as numbers allow, on this side or that."""
    rng = np.random.default_rng(0)
    wrong = {True: 0, False: 0}
    for _ in range(400):
        a, b = rng.normal(size=2) @ [1, 1j], rng.normal(size=2) @ [1, 1j]
        across = 1j * (b - a)
        tip = a + rng.uniform(0.2, 0.8) * (b - a)
        z = np.array([a, b, b + across, tip, a + across])
        expected = _exact_side(complex(a), complex(b), complex(tip)) <= 0
        assert crosses_itself(z) == expected
        assert crossings(z).tolist() == ([[0, 2], [0, 3]] if expected else [])
        wrong[expected] += by_rounding(z) != expected
    assert min(wrong.values()) > 5


def test_neighbours_fold_back_exactly_where_they_are_on_one_line():
    """In doubles some spikes that are open have no width, and some that have none do."""
    rng = np.random.default_rng(1)
    wrong, seen = 0, set()
    for _ in range(400):
        a, b = rng.normal(size=2) @ [1, 1j], rng.normal(size=2) @ [1, 1j]
        c = a + 0.5 * (b - a) if rng.uniform() < 0.5 else a + rng.uniform(0.2, 0.8) * (b - a)
        away = c + 1j * (b - a)
        z = np.array([a, b, c, away])
        side = _exact_side(complex(a), complex(b), complex(c))
        assert ([0, 1] in crossings(z).tolist()) == (side == 0)
        wrong += (rounded_side(a, b, c) == 0) != (side == 0)
        seen.add(side)
    assert seen == {-1, 0, 1}
    assert wrong > 5
