"""The geodesic algorithm against domains whose maps to the disk are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ellipk, ellipkinc

from pgcp.plane.geodesic import HalfPlane, balanced_centre, geodesic_map, roomiest_centre


def polygon(corners, parts):
    corners = np.asarray(corners, complex)
    t = np.arange(parts) / parts
    return (corners[:, None] + t * (np.roll(corners, -1) - corners)[:, None]).ravel()


def mapped(boundary, inside=()):
    plane = geodesic_map(boundary, np.asarray(inside, complex))
    assert isinstance(plane, HalfPlane)
    return plane


def test_a_disk_stays_a_disk():
    errors = []
    for n in (16, 32, 64):
        boundary = np.exp(2j * np.pi * np.arange(n) / n)
        inside = np.array([0.0, 0.5j, -0.3 + 0.2j])
        plane = mapped(boundary, inside)
        centre = complex(plane.inside[0])
        errors.append(np.abs(plane.circle(centre) - boundary).max())
        assert np.abs(plane.disk(centre)[1:] - inside[1:]).max() < 2 * errors[-1]
        assert np.allclose(plane.circle_gaps(centre).sum(), 2 * np.pi, atol=1e-12)
    assert errors[1] < 0.6 * errors[0]
    assert errors[2] < 0.6 * errors[1]


def test_gaps_are_the_angles_between_neighbours():
    rng = np.random.default_rng(0)
    boundary = np.exp(2j * np.pi * np.arange(40) / 40) * (1 + 0.3 * rng.random(40))
    plane = mapped(boundary, [0.1])
    for centre in (complex(plane.inside[0]), 3.0 + 0.2j):
        on_circle = plane.circle(centre)
        steps = np.angle(np.roll(on_circle, -1) / on_circle)
        assert (plane.circle_gaps(centre) > 0).all()
        assert np.allclose(plane.circle_gaps(centre), steps % (2 * np.pi), atol=1e-12)


def test_a_square_has_its_corners_at_right_angles():
    errors = []
    for parts in (10, 40, 160):
        boundary = polygon([0, 1, 1 + 1j, 1j], parts)
        plane = mapped(boundary, [0.5 + 0.5j])
        gaps = plane.circle_gaps(complex(plane.inside[0])).reshape(4, parts).sum(axis=1)
        errors.append(np.abs(gaps - np.pi / 2).max())
    assert errors[0] < 0.05
    assert errors[1] < 0.4 * errors[0]
    assert errors[2] < 0.4 * errors[1]


@pytest.mark.parametrize("aspect", [2.0, 5.0, 9.0])
def test_a_long_rectangle_is_as_crowded_as_theory_says(aspect):
    """Its short sides take the angle given by the modulus k of K(k') / K(k) = aspect, down to 1e-6 of a turn."""
    parts = 60
    boundary = polygon([0, aspect, aspect + 1j, 1j], parts)
    plane = mapped(boundary, [0.5 * aspect + 0.5j])
    gaps = plane.circle_gaps(complex(plane.inside[0])).reshape(4, parts).sum(axis=1)
    q = np.exp(-0.5 * np.pi * aspect)  # corners -1/k, -1, 1, 1/k seen from i / sqrt(k); k' by its theta series
    other = 4 * np.sqrt(q) * ((1 + q**2 + q**6) / (1 + 2 * q + 2 * q**4)) ** 2
    # pi - 4 atan(sqrt(k)), without cancellation
    root = (1 - other**2) ** 0.25
    expected = 4 * np.arctan(other**2 / ((1 + root**2) * (1 + root) ** 2))
    assert gaps[1] == pytest.approx(expected, rel=0.05)
    assert gaps[1] == pytest.approx(gaps[3], rel=0.05)


def test_crowded_gaps_keep_their_relative_precision():
    """The far end of a strip of aspect 30 spans less than 1e-38 of the circle: its gaps are still those of the near end."""
    plane = mapped(polygon([0, 30, 30 + 1j, 1j], 600), [0.5 + 0.5j])
    gaps = plane.circle_gaps(complex(plane.inside[0])).reshape(4, 600)
    far = gaps[1]
    assert 0 < far.sum() < 1e-35
    assert np.allclose(far, far[::-1], rtol=0.05)


def test_a_curve_that_crosses_itself_is_named_by_a_point():
    figure_eight = np.array([0, 1 + 1j, 1, 1j], complex)
    dense = polygon(figure_eight, 30)
    assert isinstance(geodesic_map(dense, np.empty(0, complex)), int)


def test_the_balanced_centre_balances():
    plane = mapped(polygon([0, 3, 3 + 1j, 1j], 30))
    weights = np.random.default_rng(0).random(120)
    centre = balanced_centre(plane, weights)
    assert centre.imag > 0
    assert abs(weights @ plane.circle(centre)) / weights.sum() < 1e-10


def test_the_roomiest_centre_keeps_the_two_ends_of_a_strip_alike():
    parts = 80
    plane = mapped(polygon([0, 8, 8 + 1j, 1j], parts), [0.4 + 0.5j])
    corners = np.arange(0, 4 * parts, 4)
    off = complex(plane.inside[0])
    centre = roomiest_centre(plane, corners, off)

    def least(c):
        return np.add.reduceat(plane.circle_gaps(c), corners).min()

    assert least(centre) > 100 * least(off)
    sides = plane.circle_gaps(centre).reshape(4, parts).sum(axis=1)
    assert sides[1] == pytest.approx(sides[3], rel=0.2)


def test_the_incomplete_integral_agrees_along_a_square_side():
    """Positions along a side, not only corners: Schwarz-Christoffel on the square."""
    parts = 100
    plane = mapped(polygon([0, 1, 1 + 1j, 1j], parts), [0.5 + 0.5j])
    gaps = plane.circle_gaps(complex(plane.inside[0]))[:parts]
    angle = np.concatenate([[0.0], np.cumsum(gaps)])
    angle = angle / angle[-1] * np.pi / 2
    # int dt / sqrt(cos(2 t)) on the circle, corners at +-pi/4
    t = angle - np.pi / 4
    s = np.arcsin(np.clip(np.sqrt(2) * np.sin(t), -1, 1))
    length = ellipkinc(s, 0.5) / ellipk(0.5)
    assert np.abs(0.5 * (length + 1) - np.arange(parts + 1) / parts).max() < 0.01


def test_a_gap_that_is_lost_in_rounding_does_not_stop_the_search_for_room():
    plane = HalfPlane(np.array([-np.inf, -2.0, -1.0, -1.0, 0.0]), np.array([1.0, 1e-323, 1.0]), np.array([1j]))
    groups = np.arange(5)
    far = 1e4 + 1e4j  # from here the smallest gap is 0
    assert plane.circle_gaps(far).min() == 0.0
    centre = roomiest_centre(plane, groups, far)
    assert np.isfinite(centre)
    assert centre.imag > 0.0


def test_gaps_do_not_depend_on_how_large_the_half_plane_is():
    x = np.array([-np.inf, -2.0, -0.5, 1.0, 4.0])
    one = HalfPlane(x, np.diff(x[1:]), np.array([0.5 + 1j]))
    far = HalfPlane(x * 1e200, np.diff(x[1:]) * 1e200, one.inside * 1e200)
    assert np.allclose(far.circle_gaps(complex(far.inside[0])), one.circle_gaps(0.5 + 1j), atol=1e-14)
