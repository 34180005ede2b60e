"""Conjugate gradients for operators near one that has been eliminated, which then is the preconditioner.

Laplacians that change from step to step, as those of a flow or of Newton's method do, are solved so without a factorization of
their own: the elimination of the surface's Laplacian, done once and patch by patch, serves all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from pgcp.types import ComplexArray, FloatArray

Vector = TypeVar("Vector", FloatArray, ComplexArray)


def conjugate_gradients(
    apply: Callable[[Vector], Vector],
    precondition: Callable[[Vector], Vector],
    right: Vector,
    tolerance: float,
    most: int,
) -> tuple[Vector, int]:
    """Solve a symmetric positive semi-definite system, and count the steps.

    right (n, ...), real or complex: real and imaginary parts are systems of the same matrix, as columns are. Ends where the
    residual, in the preconditioner's norm, is ``tolerance`` times what it was, after ``most`` steps, or where the operator is
    not positive along a direction; what it has then is returned.
    """
    x = np.zeros_like(right)
    residual = right.copy()
    z = precondition(residual)
    direction = z
    square = first = _product(residual, z)
    steps = 0
    while steps < most and square > 0.0 and square > tolerance**2 * first:
        image = apply(direction)
        curvature = _product(direction, image)
        if not curvature > 0.0:
            break
        step = square / curvature
        x = x + step * direction
        residual = residual - step * image
        z = precondition(residual)
        before, square = square, _product(residual, z)
        direction = z + (square / before) * direction
        steps += 1
    return x, steps


def _product(one: Vector, other: Vector) -> float:
    return float(np.vdot(one, other).real)
