"""Boundaries between one that keeps its lengths and a simple one."""

from __future__ import annotations

import numpy as np
import pytest

from pgcp.methods.common.boundary_first import BoundaryFlattening
from pgcp.methods.common.evened import _from_circle, _from_map, boundaries_between, turning_angles
from pgcp.plane.curves import crosses_itself


@pytest.fixture
def circle():
    return np.exp(2j * np.pi * np.arange(40) / 40)


def test_turning_angles_of_a_simple_polygon_make_one_turn(circle):
    turning = turning_angles(circle * np.tile([1.0, 0.8], 20))
    assert turning.sum() == pytest.approx(2 * np.pi)
    assert turning.min() < 0.0 < turning.max()


def test_a_simple_boundary_that_keeps_its_lengths_comes_first(circle):
    lengths = np.abs(np.roll(circle, -1) - circle)
    flat = BoundaryFlattening(np.eye(40), turning_angles(circle), lengths)
    share, found = next(_from_map(flat, circle * (3.0 + circle)))
    assert share == 0.0
    assert np.allclose(np.abs(np.roll(found, -1) - found), lengths)


def test_where_that_crosses_itself_the_nearest_simple_one_on_the_way_comes_first(circle):
    # a strip that turns by more than half a round at both ends
    kappa = np.where(np.arange(40) % 20 < 10, 0.9, -0.9 + 0.2 * np.pi)
    kappa += (2 * np.pi - kappa.sum()) / 40
    flat = BoundaryFlattening(np.eye(40), kappa, np.full(40, 0.15))
    assert crosses_itself(flat.isometric())
    found = list(boundaries_between(flat, np.zeros(40), np.full(40, 2 * np.pi / 40)))
    assert 0.0 < found[0][0] < 1.0
    assert [share for share, _ in found] == sorted(share for share, _ in found)
    assert not any(crosses_itself(z) for _, z in found)


def test_a_boundary_with_points_that_coincide_leads_nowhere(circle):
    flat = BoundaryFlattening(np.eye(40), turning_angles(circle), np.full(40, 0.15))
    circle[3] = circle[4]
    assert list(_from_map(flat, circle)) == []


def test_the_way_to_a_circle_starts_at_the_lengths_that_are_kept(circle):
    operator = 40.0 * (2.0 * np.eye(40) - np.roll(np.eye(40), 1, 0) - np.roll(np.eye(40), -1, 0))
    lengths = np.abs(np.roll(circle, -1) - circle)
    flat = BoundaryFlattening(operator, turning_angles(circle), lengths)
    share, found = next(_from_circle(flat))
    assert share == 0.0
    assert np.allclose(np.abs(found - found.mean()), 1.0)
