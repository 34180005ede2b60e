"""The zipper's maps against exact ones: collinear arcs in sixty digits, and differences that neighbours cannot show."""

from __future__ import annotations

from decimal import Decimal, localcontext
from itertools import pairwise

import numpy as np
import pytest

from pgcp.plane.curves import crosses_itself
from pgcp.plane.zipper import _right_root, close_arcs, open_arc, scale_variation

COLLINEAR = {
    "even": np.linspace(0.0, 1.0, 9),
    "close pairs": np.array([0.0, 0.25, 0.5, 0.5 + 1e-9, 0.5 + 2e-9, 0.75, 0.75 + 1e-12, 1.0]),
    "crowded start": np.array([0.0, 1e-13, 2e-13, 0.3, 0.3 + 1e-14, 0.9, 1.0]),
    "crowded end": np.array([0.0, 0.2, 1.0 - 1e-8, 1.0 - 3e-13, 1.0 - 1e-13, 1.0]),
}


def exact_gaps(arc):
    """Differences of sqrt(x / (1 - x)): the point x of a straight arc from 0 to 1 has this inverse height, up to one scale."""
    with localcontext() as context:
        context.prec = 60
        x = [Decimal(float(v)) for v in arc]
        share = [(v - x[0]) / (x[-1] - x[0]) for v in x[:-1]]
        p = [(v / (1 - v)).sqrt() for v in share]
        return np.array([float(b - a) for a, b in pairwise(p)])


@pytest.mark.parametrize("arc", COLLINEAR.values(), ids=COLLINEAR)
@pytest.mark.parametrize("branch", [1.0, -1.0])
@pytest.mark.parametrize("turn", [1.0, 0.8 - 0.6j])
def test_gaps_keep_their_relative_precision_however_close_points_lie(arc, branch, turn):
    gaps, _, stuck = open_arc(turn * arc.astype(complex), np.array([turn * (0.5 + 0.5j)]), branch)
    assert stuck == -1
    ratio = gaps / exact_gaps(arc)
    limit = 1e-14 if turn == 1.0 else 1e-14 + 4e-16 / np.diff(arc).min()  # a turn rounds the points themselves
    assert np.abs(ratio / ratio[np.argmax(np.diff(arc)[:-1])] - 1.0).max() < limit


def test_a_straight_slit_is_opened_by_the_square_root():
    """sqrt((z - 1) / z), followed by a Moebius map with 0 fixed: inverses are linear in each other."""
    others = np.array([0.3 + 0.4j, -1.0 + 0.2j, 0.8 - 0.5j, 2.0 + 1.0j])
    _, moved, _ = open_arc(np.linspace(0.0, 1.0, 12).astype(complex), others, 1.0)
    assert (moved.real > 0).all()
    exact = np.sqrt((others - 1.0) / others)
    terms = np.column_stack([1.0 / exact, np.ones(4)])
    parts = np.linalg.lstsq(terms, 1.0 / moved, rcond=None)[0]
    assert np.abs((terms @ parts) * moved - 1.0).max() < 1e-12


def test_roots_have_both_parts_to_full_precision():
    rng = np.random.default_rng(0)
    with localcontext() as context:
        context.prec = 300
        for _ in range(300):
            re, im = (rng.choice([-1.0, 1.0], 2) * 10.0 ** rng.uniform(-60, 60, 2)).tolist()
            a, b = _right_root(re, im)
            size = (Decimal(re) ** 2 + Decimal(im) ** 2).sqrt()
            u = ((size + Decimal(re)) / 2).sqrt()
            v = Decimal(im) / (2 * u)
            assert a > 0
            assert abs(Decimal(float(a)) / u - 1) < Decimal("1e-15")
            assert abs(Decimal(float(b)) / v - 1) < Decimal("1e-15")
    assert _right_root(0.0, 0.0) == (0.0, 0.0)
    assert _right_root(-4.0, 0.0) == (0.0, 2.0)
    assert _right_root(-4.0, -0.0) == (0.0, -2.0)


@pytest.mark.parametrize(("arc", "first"), [([0, 1, 2, 2, 3], 3), ([0, 1, 0.5, 3], 2), ([0, 1, 2, 1.5], 3)])
def test_an_arc_that_runs_back_over_itself_is_stuck_where_it_does(arc, first):
    _, _, stuck = open_arc(np.array(arc, complex), np.array([5.0 + 5j]), 1.0)
    assert stuck == first


FIGURES = {
    "loop": [0, 2, 2 + 1j, 1 + 1j, 1 - 1j],
    "eight": [0, 1 + 1j, 1, 1j],
    "loop with a tail": [0, 2, 2 + 1j, 1 + 1j, 1 - 1j, 3 - 2j],
}


def through(corners, parts):
    """Points along a polyline, each side in so many parts."""
    corners = np.array(corners, complex)
    sides = [a + (b - a) * np.arange(parts) / parts for a, b in pairwise(corners)]
    return np.concatenate([*sides, corners[-1:]])


@pytest.mark.parametrize(("arc", "first"), [([0, 1, 2, 2 + 1j, 1 + 1j, 1], 5), (through(FIGURES["loop"], 2), 7),
                                            (through(FIGURES["eight"], 2), 5)])  # fmt: skip
@pytest.mark.parametrize("branch", [1.0, -1.0])
@pytest.mark.parametrize("turn", [1.0, 0.8 - 0.6j])
def test_an_arc_that_comes_back_to_its_second_point_is_stuck_there(arc, first, branch, turn):
    _, _, stuck = open_arc(turn * np.array(arc, complex), np.array([5.0 + 5j]), branch)
    assert stuck == first


@pytest.mark.parametrize("corners", FIGURES.values(), ids=FIGURES)
@pytest.mark.parametrize("parts", [1, 3, 10, 40])
@pytest.mark.parametrize("branch", [1.0, -1.0])
def test_an_arc_that_crosses_itself_is_stuck_or_opened_to_numbers(corners, parts, branch):
    """Between its points a crossing is not seen: gaps may shrink to 0, but are numbers, and the curve is known to cross.

    Points beside it may be lost, where gaps are; a weld refuses positions that are not finite.
    """
    arc = through(corners, parts)
    gaps, others, stuck = open_arc(arc, np.array([5.0 + 5j, -4.0 + 1j]), branch)
    assert stuck == -1 or 1 < stuck < len(arc)
    if stuck == -1:
        assert np.isfinite(gaps).all()
        assert (gaps >= 0).all()
        assert np.isfinite(others).all() or gaps.min() == 0
    closed = np.concatenate([arc, [4.0 - 4j, -4.0 - 4j]])
    assert crosses_itself(closed)


def test_equal_sides_are_closed_onto_a_straight_line():
    """A straight arc opened upwards and downwards and closed again has gone through a Moebius map, small steps too."""
    arc = np.cumsum(np.append(0.0, 10.0 ** np.random.default_rng(1).uniform(-6, 0, 14))).astype(complex)
    others = np.array([3.0 + 4j, -7.0 + 2j])
    up, a, _ = open_arc(arc, others, 1.0)
    down, b, _ = open_arc(arc, others.conj(), -1.0)
    assert a == pytest.approx(b.conj(), rel=1e-12)
    assert up == pytest.approx(down, rel=1e-12)
    welded, moved, stuck = close_arcs(up, down, np.concatenate([a, b]))
    assert stuck == -1
    assert np.abs(welded.imag).max() < 1e-12 * np.abs(welded).max()
    assert moved[:2] == pytest.approx(moved[2:].conj(), rel=1e-9)
    z, w = arc[1:].real, welded.real
    known = (z[1:-1] - z[0]) / (z[1:-1] - z[-1])
    found = (w[1:-1] - w[0]) / (w[1:-1] - w[-1])
    assert np.abs(found / known / (found / known)[0] - 1.0).max() < 1e-6


def test_the_variation_of_scale_is_weighted_by_length_and_leaves_infinity_out():
    rng = np.random.default_rng(2)
    tails, heads, poles = (rng.normal(size=n) + 1j * rng.normal(size=n) for n in (30, 30, 7))
    lengths = 10.0 ** rng.uniform(-3, 1, 30)
    log_lengths = np.log(np.abs(tails - heads) / lengths)
    found = scale_variation(tails, heads, log_lengths, lengths, poles)
    scale = np.log(np.abs(1 / (tails - poles[:, None]) - 1 / (heads - poles[:, None])) / lengths)
    mean = np.average(scale, axis=1, weights=lengths)
    expected = np.average((scale - mean[:, None]) ** 2, axis=1, weights=lengths)
    assert found == pytest.approx(expected, rel=1e-9)
    assert np.abs(scale.var(axis=1) / expected - 1).min() > 0.01
    more_tails, more_heads = np.append(tails, np.inf), np.append(heads, 1.0)
    more = scale_variation(more_tails, more_heads, np.append(log_lengths, np.inf), np.append(lengths, 3.0), poles)
    assert more == pytest.approx(found, rel=1e-12)


@pytest.mark.parametrize("size", [1e-100, 1e100])
def test_the_variation_of_scale_does_not_depend_on_the_unit_of_length(size):
    """Products of squared distances are no longer numbers where lengths are 1e-100 or 1e100."""
    rng = np.random.default_rng(4)
    tails, heads, poles = (rng.normal(size=n) + 1j * rng.normal(size=n) for n in (20, 20, 5))
    lengths = 10.0 ** rng.uniform(-2, 1, 20)
    log_lengths = np.log(np.abs(tails - heads) / lengths)
    found = scale_variation(tails, heads, log_lengths, lengths, poles)
    scaled = scale_variation(size * tails, size * heads, log_lengths, lengths, size * poles)
    assert scaled == pytest.approx(found, rel=1e-9)
