"""CCEM: convergent conformal energy minimisation (Kuo, Lin, Yueh, Yau 2021), all of it on the boundary's angles.

A descent on E_C(theta) whose steps satisfy the Wolfe conditions, so that it converges from any start (CCEM Theorem 4.1),
along the gradient (Algorithm 4.1) or the quasi-Newton direction (Algorithm 4.2, Remark 4.2). Both may pass a boundary vertex
through its neighbour, and end there on thin parts. The same quasi-Newton descent on the logarithms of the gaps
between neighbours cannot: every iterate is a boundary in order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from pgcp.boundary_energy import Descent, Step, curvature, energy_and_gradient, on_circle
from pgcp.cem import cem_boundary
from pgcp.descent import Direction, QuasiNewton, steepest, wolfe_step
from pgcp.dirichlet import DirichletFactor
from pgcp.errors import SolveFailedError
from pgcp.types import ComplexArray, FloatArray

ITERATIONS = 200
TOLERANCE = 1e-7
_CLOSEST = 2e-14

Descend = Callable[[FloatArray, FloatArray, int, float], Descent]


class _Angles:
    """The angles themselves as unknowns."""

    def unknowns(self, angles: FloatArray) -> FloatArray:
        """Unknowns (n_B,) of angles."""
        return angles

    def angles(self, x: FloatArray) -> FloatArray:
        """Angles (n_B,) of unknowns."""
        return x

    def pull(self, x: FloatArray, gradient: FloatArray) -> FloatArray:
        """Gradient by the unknowns from the gradient by the angles."""
        return gradient


class _LogGaps:
    """The logarithms of the gaps between neighbours, up to a constant, as unknowns; the first angle is 0."""

    def unknowns(self, angles: FloatArray) -> FloatArray:
        """Unknowns (n_B,) of angles; neighbours that cannot be told apart are spread out."""
        return np.asarray(np.log(np.maximum(_gaps(angles), _CLOSEST)), np.float64)

    def angles(self, x: FloatArray) -> FloatArray:
        """Angles (n_B,) of unknowns."""
        gaps = self._of(x)
        return np.concatenate([[0.0], np.cumsum(gaps[:-1])])

    def pull(self, x: FloatArray, gradient: FloatArray) -> FloatArray:
        """Gradient by the unknowns from the gradient by the angles."""
        gaps = self._of(x)
        # a gap moves all angles behind it
        behind = np.append(np.cumsum(gradient[:0:-1])[::-1], 0.0)
        return np.asarray(gaps * (behind - gaps @ behind / (2.0 * np.pi)), np.float64)

    @staticmethod
    def _of(x: FloatArray) -> FloatArray:
        gaps = np.exp(x - x.max())
        return np.asarray(gaps * (2.0 * np.pi / gaps.sum()), np.float64)


def _gaps(angles: FloatArray) -> FloatArray:
    """Gaps (n_B,) from each angle to the next, the last to the first a turn later."""
    return np.diff(np.append(angles, angles[0] + 2.0 * np.pi))


def _descend(
    schur: FloatArray, start: FloatArray, kind: _Angles | _LogGaps, choose: Direction, iterations: int, tolerance: float
) -> Descent:
    """Descend until an iteration gains less than ``tolerance``, its angles (n_B,) written in unknowns of some kind."""

    def objective(x: FloatArray) -> tuple[float, FloatArray]:
        """Energy and its gradient by the unknowns."""
        value, by_angles = energy_and_gradient(schur, kind.angles(x))
        return value, kind.pull(x, by_angles)

    def step(iteration: int, length: float) -> Step:
        """Record of the iterate x."""
        value, by_angles = energy_and_gradient(schur, kind.angles(x))
        return Step("ccem", iteration, value, float(np.linalg.norm(by_angles)), length)

    x = kind.unknowns(start)
    energy, gradient = objective(x)
    steps = [step(0, 0.0)]
    for iteration in range(1, iterations + 1):
        direction = choose(x, gradient)
        if not gradient @ direction < 0.0:
            direction = -gradient
        first = 1.0
        if isinstance(kind, _Angles) and (iteration == 1 or choose is steepest):
            # the least point of the quadratic approximation (CCEM eq. 4.6)
            half = curvature(schur, x, direction)
            first = -float(gradient @ direction) / (2.0 * half) if half > 0.0 else 1.0
        found = wolfe_step(objective, x, direction, energy, gradient, first)
        if found is None:
            return Descent(kind.angles(x), tuple(steps), True)
        length, value, gradient = found
        x = x + length * direction
        gain, energy = energy - value, value
        steps.append(step(iteration, length))
        if gain < tolerance:
            return Descent(kind.angles(x), tuple(steps), True)
    return Descent(kind.angles(x), tuple(steps), False)


def descend_by_gradient(
    schur: FloatArray, start: FloatArray, iterations: int = ITERATIONS, tolerance: float = TOLERANCE
) -> Descent:
    """Minimise E_C along its negative gradient (CCEM Algorithm 4.1), the quadratic approximation's step tried first.

    schur (n_B, n_B); start (n_B,) increasing through one turn. The angles found need not increase.
    """
    return _descend(schur, start, _Angles(), steepest, iterations, tolerance)


def descend_by_quasi_newton(
    schur: FloatArray, start: FloatArray, iterations: int = ITERATIONS, tolerance: float = TOLERANCE
) -> Descent:
    """Minimise E_C along quasi-Newton directions (CCEM Algorithm 4.2) with the steps of Algorithm 4.1 (Remark 4.2).

    schur (n_B, n_B); start (n_B,) increasing through one turn. The angles found need not increase.
    """
    return _descend(schur, start, _Angles(), QuasiNewton(), iterations, tolerance)


def descend_in_order(
    schur: FloatArray, start: FloatArray, iterations: int = ITERATIONS, tolerance: float = TOLERANCE
) -> Descent:
    """Minimise E_C over boundaries in order: Algorithm 4.2 on the logarithms of the gaps between neighbours.

    schur (n_B, n_B); start (n_B,) increasing through one turn, as all iterates do.
    """
    return _descend(schur, start, _LogGaps(), QuasiNewton(), iterations, tolerance)


@dataclass(frozen=True, slots=True, eq=False)
class EnergyMap:
    """A map of little conformal energy: z (n,) in the closed unit disk, the record of its descent, whether it converged."""

    z: ComplexArray
    steps: tuple[Step, ...]
    converged: bool


def cem_map(factor: DirichletFactor, block: csr_array, start: FloatArray) -> EnergyMap:
    """Map a disk-like surface to the unit disk by CEM; arguments as ``ccem_map``'s."""
    found = cem_boundary(factor.schur, block, start)
    return EnergyMap(_extended(factor, found.angles), found.steps, found.converged)


def ccem_map(
    factor: DirichletFactor,
    block: csr_array,
    start: FloatArray,
    descend: Descend = descend_in_order,
    iterations: int = ITERATIONS,
    tolerance: float = TOLERANCE,
) -> EnergyMap:
    """Map a disk-like surface to the unit disk by CEM and, from its best iterate, CCEM (CCEM section 6).

    factor: the Laplacian's, boundary last; block L_BB (n_B, n_B); start (n_B,) boundary angles, increasing through one
    turn. Raises SolveFailedError where a position is not finite, or where the boundary has shrunk towards one point, which
    has no energy at all (CCEM Lemma 5.1): that takes a start far from conformal.
    """
    first = cem_boundary(factor.schur, block, start)
    found = descend(factor.schur, first.angles, iterations, tolerance)
    return EnergyMap(_extended(factor, found.angles), first.steps + found.steps, found.converged)


def _extended(factor: DirichletFactor, angles: FloatArray) -> ComplexArray:
    """Positions (n,) from boundary angles; neighbours in order but too close to be told apart are spread out."""
    gaps = _gaps(angles)
    if gaps.max() > np.pi:
        raise SolveFailedError(f"a boundary of {len(gaps)} vertices shrank to one side of the circle")
    gaps = np.where(gaps > 0.0, np.maximum(gaps, _CLOSEST), gaps)
    angles = np.concatenate([[0.0], np.cumsum(gaps[:-1])]) * (2.0 * np.pi / gaps.sum())
    z = factor.extend(on_circle(angles))
    if not np.isfinite(z).all():
        raise SolveFailedError("the disk map is not finite")
    return z
