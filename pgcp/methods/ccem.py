"""CCEM: convergent conformal energy minimisation (Kuo, Lin, Yueh, Yau 2021), all of it on the boundary's angles.

A descent on E_C(theta) whose steps satisfy the Wolfe conditions, so that it converges from any start (CCEM Theorem 4.1),
along the gradient (Algorithm 4.1) or the quasi-Newton direction (Algorithm 4.2, Remark 4.2). Both may pass a boundary vertex
through its neighbour, and end there on thin parts. The same quasi-Newton descent on the logarithms of the gaps
between neighbours cannot: every iterate is a boundary in order.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from scipy.sparse import csr_array

from pgcp.elimination.sparse_boundary import AnyFactor, AnySchur
from pgcp.methods.base import Method, whole
from pgcp.methods.cem import better_start, cem_boundary
from pgcp.methods.common.boundary_energy import (
    CLOSEST,
    Descent,
    EnergyMap,
    Step,
    circle_gaps,
    energy_and_gradient,
    extended,
)
from pgcp.methods.common.descent import Direction, QuasiNewton, wolfe_step
from pgcp.methods.common.disk import Disk, DiskMap, map_disk, of_energy
from pgcp.types import FloatArray

ITERATIONS = 200
TOLERANCE = 1e-7

Descend = Callable[[AnySchur, FloatArray, int, float], Descent]


class Unknowns(Protocol):
    """How boundary angles are written in the unknowns of a descent."""

    def unknowns(self, angles: FloatArray) -> FloatArray:
        """Unknowns (n_B,) of angles."""
        ...

    def angles(self, x: FloatArray) -> FloatArray:
        """Angles (n_B,) of unknowns."""
        ...

    def pull(self, x: FloatArray, gradient: FloatArray) -> FloatArray:
        """Gradient by the unknowns from the gradient by the angles."""
        ...

    def first_step(self, schur: AnySchur, x: FloatArray, gradient: FloatArray, direction: FloatArray, iteration: int) -> float:
        """Length of the step that is tried first."""
        ...


class LogGaps:
    """The logarithms of the gaps between neighbours, up to a constant, as unknowns; the first angle is 0."""

    def unknowns(self, angles: FloatArray) -> FloatArray:
        """Unknowns (n_B,) of angles; neighbours that cannot be told apart are spread out."""
        return np.asarray(np.log(np.maximum(circle_gaps(angles), CLOSEST)), np.float64)

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

    def first_step(self, schur: AnySchur, x: FloatArray, gradient: FloatArray, direction: FloatArray, iteration: int) -> float:
        """The quasi-Newton direction itself."""
        return 1.0

    @staticmethod
    def _of(x: FloatArray) -> FloatArray:
        gaps = np.exp(x - x.max())
        return np.asarray(gaps * (2.0 * np.pi / gaps.sum()), np.float64)


def descend(
    schur: AnySchur, start: FloatArray, kind: Unknowns, choose: Direction, iterations: int, tolerance: float
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
        first = kind.first_step(schur, x, gradient, direction, iteration)
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


def descend_in_order(schur: AnySchur, start: FloatArray, iterations: int = ITERATIONS, tolerance: float = TOLERANCE) -> Descent:
    """Minimise E_C over boundaries in order: Algorithm 4.2 on the logarithms of the gaps between neighbours.

    schur (n_B, n_B); start (n_B,) increasing through one turn, as all iterates do.
    """
    return descend(schur, start, LogGaps(), QuasiNewton(), iterations, tolerance)


def ccem_map(
    factor: AnyFactor,
    block: csr_array,
    start: FloatArray,
    descent: Descend = descend_in_order,
    iterations: int = ITERATIONS,
    tolerance: float = TOLERANCE,
) -> EnergyMap:
    """Map a disk-like surface to the unit disk by CEM and, from its best iterate, CCEM (CCEM section 6).

    factor: the Laplacian's, boundary last; block L_BB (n_B, n_B); start (n_B,) boundary angles, increasing through one
    turn. Raises SolveFailedError where a position is not finite, or where the boundary has shrunk towards one point, which
    has no energy at all (CCEM Lemma 5.1): that takes a start far from conformal.
    """
    first = cem_boundary(factor.schur, block, start)
    found = descent(factor.schur, first.angles, iterations, tolerance)
    return EnergyMap(extended(factor, found.angles), first.steps + found.steps, found.converged)


def _map(disk: Disk) -> DiskMap:
    block = disk.boundary_block()
    return of_energy(ccem_map(disk.factor, block, better_start(disk.factor.schur, block, disk.starts())))


METHOD = Method(
    name="ccem",
    targets=("disk",),
    summary="conformal energy minimised by a quasi-Newton descent on the gaps between boundary vertices, started from CEM",
    guarantees="conformal energy falls in every iteration; boundary in order",
    reference="Kuo, Lin, Yueh, Yau 2021 (CCEM)",
    mapper=whole(lambda run, parts: map_disk(run, parts, _map)),
    moebius="none",
)
