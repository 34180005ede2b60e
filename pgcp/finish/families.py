"""The Moebius maps that take each target to itself, by a vector: which of them serve a correction.

A vector v stands for the point of the unit ball at hyperbolic distance 2 |v| from its centre; 0 is the identity.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from pgcp.finish.least_area import AreaSample, least_area_bend, least_area_boost, least_area_shift
from pgcp.plane.mobius import (
    are_apart,
    ball_slope,
    bend_plane,
    bend_slope,
    boost,
    boost_slope,
    in_ball,
    shift_disk,
    shift_slope,
)
from pgcp.types import ComplexArray, FloatArray, IntArray, Positions


class Family(Protocol):
    """Moebius maps by a vector of so many numbers."""

    parameters: int

    def moved(self, positions: Positions, v: FloatArray) -> Positions:
        """Positions after the map of a vector."""
        ...

    def pulled(self, positions: Positions, moved: Positions, v: FloatArray, slope: FloatArray) -> FloatArray:
        """Gradient (k,) with respect to v of what has the gradient slope (n, 3) with respect to the moved points."""
        ...

    def least_area(self, centres: Positions, sample: AreaSample) -> FloatArray:
        """Point of the unit ball whose map has the least area distortion; centres (n,) of the sampled faces."""
        ...

    def aims(self, points: FloatArray) -> FloatArray:
        """Vectors whose maps spread out what lies at points (n, 3) of the image."""
        ...

    def keeps(self, moved: Positions, boundary: IntArray) -> bool:
        """Bring boundary vertices back to the target's own boundary, in place; whether they can still be told apart."""
        ...


class Bends:
    """Of the plane: maps whose pole lies outside a circle around all points (PGCP section 6.2)."""

    parameters = 2

    def __init__(self, z: ComplexArray) -> None:
        self._middle = complex(0.5 * (z.real.min() + z.real.max()), 0.5 * (z.imag.min() + z.imag.max()))
        self._radius = float(np.abs(z - self._middle).max())

    def moved(self, positions: ComplexArray, v: FloatArray) -> ComplexArray:
        """See Family."""
        return bend_plane((positions - self._middle) / self._radius, complex(*in_ball(v)))

    def pulled(self, positions: ComplexArray, moved: ComplexArray, v: FloatArray, slope: FloatArray) -> FloatArray:
        """See Family."""
        return bend_slope((positions - self._middle) / self._radius, complex(*in_ball(v)), slope) @ ball_slope(v)

    def least_area(self, centres: ComplexArray, sample: AreaSample) -> FloatArray:
        """See Family."""
        found = least_area_bend((centres - self._middle) / self._radius, sample)
        return np.array([found.real, found.imag])

    def aims(self, points: FloatArray) -> FloatArray:
        """See Family."""
        return points[:, :2]

    def keeps(self, moved: ComplexArray, boundary: IntArray) -> bool:
        """See Family: the boundary is free."""
        return True


class Shifts:
    """Of the unit disk: its automorphisms without rotation."""

    parameters = 2

    def moved(self, positions: ComplexArray, v: FloatArray) -> ComplexArray:
        """See Family."""
        return shift_disk(positions, complex(*in_ball(v)))

    def pulled(self, positions: ComplexArray, moved: ComplexArray, v: FloatArray, slope: FloatArray) -> FloatArray:
        """See Family."""
        return shift_slope(positions, complex(*in_ball(v)), slope) @ ball_slope(v)

    def least_area(self, centres: ComplexArray, sample: AreaSample) -> FloatArray:
        """See Family."""
        found = least_area_shift(centres, sample)
        return np.array([found.real, found.imag])

    def aims(self, points: FloatArray) -> FloatArray:
        """See Family."""
        return points[:, :2]

    def keeps(self, moved: ComplexArray, boundary: IntArray) -> bool:
        """See Family."""
        moved[boundary] /= np.abs(moved[boundary])
        return are_apart(moved, boundary)


class Boosts:
    """Of the unit sphere: its Moebius maps without rotation."""

    parameters = 3

    def moved(self, positions: FloatArray, v: FloatArray) -> FloatArray:
        """See Family."""
        return boost(positions, in_ball(v))

    def pulled(self, positions: FloatArray, moved: FloatArray, v: FloatArray, slope: FloatArray) -> FloatArray:
        """See Family."""
        return boost_slope(positions, moved, in_ball(v), slope) @ ball_slope(v)

    def least_area(self, centres: FloatArray, sample: AreaSample) -> FloatArray:
        """See Family."""
        return least_area_boost(centres / np.linalg.norm(centres, axis=1)[:, None], sample)

    def aims(self, points: FloatArray) -> FloatArray:
        """See Family."""
        return -points

    def keeps(self, moved: FloatArray, boundary: IntArray) -> bool:
        """See Family: there is no boundary."""
        return True
