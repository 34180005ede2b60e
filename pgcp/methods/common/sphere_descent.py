"""Descent on the Dirichlet energy of maps to the sphere, along curves that stay on it (Lai, Wen, Yin, Gu, Lui 2014).

The curves are the Cayley transforms of Goldfarb, Wen, Yin (2009), in closed form vertex by vertex; steps are those of Barzilai
and Borwein, accepted by the nonmonotone rule of Zhang and Hager (2004). There is no linear solve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from pgcp.plane.mobius import balancing_step, boost
from pgcp.types import FloatArray

ITERATIONS = 1000
ENERGY_TOLERANCE, GRADIENT_TOLERANCE = 1e-13, 1e-5
CENTRED = 1e-3
_EVERY = 20  # iterations from one centring to the next
_FIRST, _SUFFICIENT, _SHORTER, _TRIALS, _MEMORY, _LAST = 1e-3, 1e-4, 0.1, 5, 0.85, 3
_SHORTEST, _LONGEST = 1e-20, 1e20
_CENTRING_STEPS = 50


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """A map, points (V, 3) on the sphere, with its energy, the energy's gradient (V, 3), and its part along the sphere."""

    points: FloatArray
    energy: float
    gradient: FloatArray
    along: FloatArray

    @property
    def size(self) -> float:
        """Norm of the gradient along the sphere."""
        return float(np.sqrt((self.along**2).sum()))  # threads of BLAS are slow to start on a busy machine


@dataclass(frozen=True, slots=True, eq=False)
class SphereDescent:
    """Where a descent has ended, the energy and gradient norm of every iterate, and whether it has converged."""

    points: FloatArray
    steps: list[tuple[float, float]]
    converged: bool


def state_of(laplacian: csr_array, points: FloatArray) -> State:
    """Energy 1/2 tr(F^T L F) of points F (V, 3), and its gradient L F."""
    gradient = laplacian @ points
    inwards = np.einsum("ij,ij->i", points, gradient)
    return State(points, 0.5 * float(inwards.sum()), gradient, gradient - inwards[:, None] * points)


def moved_along(points: FloatArray, gradient: FloatArray, step: float) -> FloatArray:
    """Unit vectors (V, 3) on the Cayley curve from points against a gradient (V, 3), a step away."""
    half = 0.5 * step
    product = np.einsum("ij,ij->i", points, gradient)
    square = np.einsum("ij,ij->i", gradient, gradient)
    below = 1.0 + half**2 * (square - product**2)
    one = ((1.0 + half * product) ** 2 - half**2 * square) / below
    moved = one[:, None] * points - (step / below)[:, None] * gradient
    return moved / np.sqrt(np.einsum("ij,ij->i", moved, moved))[:, None]


def centred(points: FloatArray, weights: FloatArray) -> FloatArray:
    """Unit vectors (V, 3) after the Moebius map that makes their weighted mean 0, to 1e-3; weights (V,) add up to 1."""
    for _ in range(_CENTRING_STEPS):
        if not np.linalg.norm(weights @ points) > CENTRED:
            break
        points = boost(points, -balancing_step(points, weights))
    return points


def descend_on_sphere(
    laplacian: csr_array, start: FloatArray, weights: FloatArray, iterations: int = ITERATIONS
) -> SphereDescent:
    """Descend from unit vectors (V, 3); weights (V,), which add up to 1, say where the centre is.

    The map is centred again after every 20 iterations: else all of it gathers at one point, which has no energy.
    """
    now = state_of(laplacian, centred(start, weights))
    steps = [(now.energy, now.size)]
    step, memory, reference = _FIRST, 1.0, now.energy
    changes: list[float] = []
    for iteration in range(iterations):
        if now.size < GRADIENT_TOLERANCE or (len(changes) >= _LAST and np.mean(changes[-_LAST:]) < ENERGY_TOLERANCE):
            return SphereDescent(now.points, steps, True)
        before, (now, step) = now, _tried(laplacian, now, step, reference)
        changes.append(abs(before.energy - now.energy) / max(abs(before.energy), 1.0))
        step = _next_length(now.points - before.points, now.along - before.along, iteration, step)
        if iteration % _EVERY == _EVERY - 1:
            now = state_of(laplacian, centred(now.points, weights))
            memory, reference = 1.0, now.energy
        else:
            longer = _MEMORY * memory + 1.0
            reference = (_MEMORY * memory * reference + now.energy) / longer
            memory = longer
        steps.append((now.energy, now.size))
    return SphereDescent(now.points, steps, False)


def _tried(laplacian: csr_array, now: State, step: float, reference: float) -> tuple[State, float]:
    """The first state that falls far enough below a reference, by steps that grow shorter, or the last; and its step."""
    for trial in range(_TRIALS + 1):
        found = state_of(laplacian, moved_along(now.points, now.gradient, step))
        if found.energy <= reference - _SUFFICIENT * step * now.size**2 or trial == _TRIALS:
            break
        step *= _SHORTER
    return found, step


def _next_length(moved: FloatArray, change: FloatArray, iteration: int, step: float) -> float:
    """The length of Barzilai and Borwein for a move and the change of the gradient along it, of two kinds in turn."""
    across = abs(float((moved * change).sum()))
    long, short = float((moved**2).sum()), float((change**2).sum())
    if not (across > 0.0 and short > 0.0):
        return step
    return min(max(long / across if iteration % 2 == 0 else across / short, _SHORTEST), _LONGEST)
