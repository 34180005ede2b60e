"""Descent with steps that satisfy the Wolfe conditions, and quasi-Newton directions (CCEM Algorithms 4.1 and 4.2)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pgcp.types import FloatArray

SUFFICIENT = 1e-4
FLAT = 0.9
_TRIALS = 60

Objective = Callable[[FloatArray], tuple[float, FloatArray]]
Direction = Callable[[FloatArray, FloatArray], FloatArray]


def wolfe_step(
    objective: Objective, x: FloatArray, direction: FloatArray, value: float, gradient: FloatArray, first: float
) -> tuple[float, float, FloatArray] | None:
    """Step length, value and gradient where both Wolfe conditions hold (CCEM eq. 4.7, 4.9), by bisection from ``first``.

    Algorithm 4.1 looks for such a step by factors of 0.99. Where rounding leaves none, the longest found that lowers the
    value enough; None where there is none either.
    """
    slope = float(gradient @ direction)
    if not slope < 0.0:
        return None
    low, high, length = 0.0, np.inf, first
    found = None
    for _ in range(_TRIALS):
        new_value, new_gradient = objective(x + length * direction)
        if not new_value < min(value, value + SUFFICIENT * length * slope):
            high = length
        else:
            low, found = length, (length, new_value, new_gradient)
            if new_gradient @ direction >= FLAT * slope:
                break
        length = 2.0 * low if high == np.inf else 0.5 * (low + high)
    return found


class QuasiNewton:
    """The directions of CCEM Algorithm 4.2: BFGS from H_1 = 1 / delta_1, by the two-loop recursion over all pairs.

    A pair without curvature, y^T s <= 0, is left out.
    """

    def __init__(self) -> None:
        self._pairs: list[tuple[FloatArray, FloatArray, float]] = []
        self._last: tuple[FloatArray, FloatArray] | None = None
        self._scale = 1.0

    def __call__(self, x: FloatArray, gradient: FloatArray) -> FloatArray:
        """Direction (n,) at x with a gradient; to be called at every iterate, in order."""
        if self._last is not None:
            s, y = x - self._last[0], gradient - self._last[1]
            inner = float(y @ s)
            if inner > 0.0:
                if not self._pairs:
                    self._scale = float(s @ s) / inner
                self._pairs.append((s, y, 1.0 / inner))
        self._last = x, gradient
        q = gradient.copy()
        shares = []
        for s, y, rho in reversed(self._pairs):
            shares.append(rho * float(s @ q))
            q -= shares[-1] * y
        q *= self._scale
        for (s, y, rho), share in zip(self._pairs, reversed(shares), strict=True):
            q += (share - rho * float(y @ q)) * s
        return -q
