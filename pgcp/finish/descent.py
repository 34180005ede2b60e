"""Least value of a function of a few numbers: quasi-Newton steps along the gradient (Broyden, Fletcher, Goldfarb, Shanno)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pgcp.types import FloatArray

Sloped = Callable[[FloatArray], tuple[float, FloatArray]]
_ENOUGH = 1e-4  # of the decrease that the slope promises
_NEWTON_STEPS, _DIFFERENCE = 4, 1e-5
_COARSE, _FINE = 2.0**-11, 2.0**-18  # sizes of lattices
_SHORTEST = 1e-7  # part of a step below which none helps


def descend(function: Sloped, start: FloatArray, longest: float, steps: int, gain: float) -> tuple[float, FloatArray]:
    """Least value found from ``start`` (k,), and where; the function returns its value and its gradient (k,).

    No step is longer than ``longest``. It ends after so many steps, where no shorter step helps, or where two in a row gain
    less than ``gain`` of the value.
    """
    x = start
    value, gradient = function(x)
    inverse, idle = np.eye(len(x)) * (longest / max(float(np.linalg.norm(gradient)), 1e-300)), 0
    for _ in range(steps):
        step = -inverse @ gradient
        slope = float(gradient @ step)
        if not slope < 0.0:
            break
        step *= min(1.0, longest / float(np.linalg.norm(step)))
        found = _shortened(function, x, value, gradient, step)
        if found is None:
            break
        moved, lower, after = found
        idle = idle + 1 if value - lower < gain * abs(value) else 0
        inverse = _updated(inverse, moved - x, after - gradient)
        x, value, gradient = moved, lower, after
        if idle == 2:
            break
    return value, x


def _shortened(
    function: Sloped, x: FloatArray, value: float, gradient: FloatArray, step: FloatArray
) -> tuple[FloatArray, float, FloatArray] | None:
    """Where a step, or as much of it as helps, leads; None where no part of it does."""
    share, slope = 1.0, float(gradient @ step)
    while share > _SHORTEST:
        moved = x + share * step
        lower, after = function(moved)
        if lower <= value + _ENOUGH * share * slope:
            return moved, lower, after
        # the least of the parabola through both values and the slope
        bend = 2.0 * (lower - value - share * slope)
        share *= min(0.5, max(0.1, -share * slope / bend)) if np.isfinite(bend) and bend > 0.0 else 0.2
    return None


def _updated(inverse: FloatArray, step: FloatArray, change: FloatArray) -> FloatArray:
    """Inverse Hessian (k, k) after a step that changed the gradient; the same where the function is not convex along it."""
    along = float(step @ change)
    if not along > 1e-12 * float(np.linalg.norm(step) * np.linalg.norm(change)):
        return inverse
    side = np.eye(len(step)) - np.outer(step, change) / along
    return np.asarray(side @ inverse @ side.T + np.outer(step, step) / along, np.float64)


def refined(function: Sloped, start: FloatArray) -> FloatArray:
    """A least value's place (k,) to nearly all digits, from one that is known to about half of them: Newton steps.

    For smooth functions: second derivatives are differences of gradients. A step that does not lower the gradient ends it.
    """
    x, (_, gradient) = start, function(start)
    for _ in range(_NEWTON_STEPS):
        across = np.eye(len(x)) * _DIFFERENCE
        hessian = np.array([(function(x + e)[1] - function(x - e)[1]) / (2.0 * _DIFFERENCE) for e in across])
        try:
            moved = x - np.linalg.solve(0.5 * (hessian + hessian.T), gradient)
        except np.linalg.LinAlgError:
            break
        after = function(moved)[1]
        if not np.linalg.norm(after) < np.linalg.norm(gradient):
            break
        x, gradient = moved, after
    return x


def settled(function: Callable[[FloatArray], float], start: FloatArray) -> FloatArray:
    """A least value's place (k,) on a lattice, by trying neighbours on finer and finer ones.

    Where a function has kinks, the end of a descent depends on rounding to about half of its digits. A place on a lattice
    does not, and is found by comparing values alone.
    """
    step = _COARSE
    x = np.round(start / step) * step
    least = function(x)
    while step > _FINE:
        step *= 0.5
        for aside in (*np.eye(len(x)), *-np.eye(len(x))):
            value = function(x + step * aside)
            if value < least:
                x, least = x + step * aside, value
    return x
