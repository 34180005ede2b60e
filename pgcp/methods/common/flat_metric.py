"""Newton's method for the flat metric that is conformally equivalent to a surface (Springborn, Schroeder, Pinkall 2008).

The matrix of a step is the cotangent Laplacian of the current lengths, which belong to no surface in space, so that patches
cannot be eliminated again; but it is near that of the surface, since angles hardly change. Each step is solved by conjugate
gradients preconditioned with the surface's Laplacian. Where angles do change, so that this takes many turns, the matrix is
factored as a whole.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from pgcp.elimination.sparse_boundary import either_factor
from pgcp.errors import SolveFailedError
from pgcp.methods.common.conjugate_gradients import conjugate_gradients
from pgcp.methods.common.edge_metric import Shapes, angle_sums, conformal_equivalence_energy, scaled_lengths, shapes_of
from pgcp.surface.operators import weighted_laplacian
from pgcp.types import BoolArray, FloatArray, IntArray

_STEPS, _HALVINGS = 50, 30
_MANY = 20  # turns of conjugate gradients in one step, from which on matrices are factored
_FLAT, _NEARLY_FLAT = (
    1e-12,
    1e-8,
)  # largest angle defect, radians, that ends it, and that is good enough otherwise
_SUFFICIENT, _ROUNDING = 1e-4, 1e-14
_SHIFT = 1e-8
_ADVICE = "remesh the surface with better-shaped faces, or choose --method bff"

Precondition = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Faces (F, 3), the lengths (F, 3) of their edges, target angle sums (V,), and which vertices' (V,) factors are sought."""

    faces: IntArray
    lengths: FloatArray
    targets: FloatArray
    free: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class Metric:
    """Lengths (F, 3) under scale factors (V,), the shapes and the energy that they have, and the defects (V,) that are left."""

    factors: FloatArray
    lengths: FloatArray
    shapes: Shapes
    energy: float
    defects: FloatArray

    @property
    def largest(self) -> float:
        """The largest angle defect, radians."""
        return float(np.abs(self.defects).max(initial=0.0))


def metric_of(problem: Problem, factors: FloatArray) -> Metric:
    """The metric that scale factors (V,) give."""
    lengths = scaled_lengths(problem.lengths, problem.faces, factors)
    shapes = shapes_of(lengths)
    energy = conformal_equivalence_energy(lengths, shapes, problem.faces, factors, problem.targets)
    defects = problem.targets - angle_sums(shapes.angles, problem.faces, len(factors))
    return Metric(factors, lengths, shapes, energy, np.where(problem.free, defects, 0.0))


def flat_metric(problem: Problem, precondition: Precondition) -> tuple[Metric, list[dict[str, Any]]]:
    """The metric of the target angle sums, by Newton's method with a line search, and the record of the iterates.

    precondition takes a load (V,) to the factors that it has on the surface itself, 0 where they are not sought. Raises
    SolveFailedError where it does not converge, as where no such metric exists with these triangles.
    """
    metric = metric_of(problem, np.zeros(len(problem.targets)))
    steps = [_record(0, metric, 0.0, 0)]
    inner = 0
    for iteration in range(1, _STEPS + 1):
        if metric.largest <= _FLAT:
            break
        if inner <= _MANY:
            direction, inner = _nearby_direction(problem, metric, precondition)
        else:
            direction = _factored_direction(problem, metric)
        found = _line_search(problem, metric, direction)
        if found is None:
            break
        length, after = found
        if after.largest > 0.5 * metric.largest and metric.largest <= _NEARLY_FLAT:
            break  # rounding
        metric = after
        steps.append(_record(iteration, metric, length, inner))
    broken = int(metric.shapes.broken.sum())
    if not metric.largest <= _NEARLY_FLAT:
        raise SolveFailedError(
            f"no flat metric was found in {len(steps) - 1} Newton steps: the largest angle defect left is {metric.largest:.3g} "
            f"radians, at vertex {int(np.abs(metric.defects).argmax())}; {_broken(broken)}; {_ADVICE}"
        )
    if broken:
        raise SolveFailedError(
            f"no flat metric is equivalent to the surface with these triangles: where the largest angle defect is "
            f"{metric.largest:.3g} radians, {_broken(broken)}; {_ADVICE}"
        )
    return metric, steps


def _broken(count: int) -> str:
    return f"{count} {'face breaks its' if count == 1 else 'faces break their'} triangle inequality"


def _record(iteration: int, metric: Metric, length: float, inner: int) -> dict[str, Any]:
    size = float(np.linalg.norm(metric.defects))
    record = {"method": "cetm", "iteration": iteration, "energy": metric.energy, "gradient_norm": 0.5 * size, "step": length}
    return record | {"inner": inner}


def _matrix(problem: Problem, metric: Metric) -> csr_array:
    """The Laplacian of the current lengths; a small part of the surface's stands in for what broken faces leave out."""
    cotangents = metric.shapes.cotangents
    if metric.shapes.broken.any():
        cotangents = cotangents + _SHIFT * shapes_of(problem.lengths).cotangents
    return weighted_laplacian(problem.faces, 0.5 * cotangents, len(problem.targets))


def _factored_direction(problem: Problem, metric: Metric) -> FloatArray:
    """Solve L(l) d = - defects by one factorization."""
    held = np.flatnonzero(~problem.free)
    factor = either_factor(_matrix(problem, metric), held)
    return np.asarray(factor.solve(-metric.defects.astype(np.complex128), np.zeros(len(held), np.complex128)).real, np.float64)


def _nearby_direction(problem: Problem, metric: Metric, precondition: Precondition) -> tuple[FloatArray, int]:
    """Solve L(l) d = - defects by conjugate gradients, and count their turns."""
    matrix = _matrix(problem, metric)

    def applied(x: FloatArray) -> FloatArray:
        """The matrix times factors (V,), where they are sought."""
        return np.asarray(np.where(problem.free, matrix @ x, 0.0), np.float64)

    # as good as a step of second order can use
    tolerance = float(np.clip(0.01 * metric.largest, 1e-6, 1e-2))
    return conjugate_gradients(applied, precondition, -metric.defects, tolerance, _MANY + 1)


def _line_search(problem: Problem, metric: Metric, direction: FloatArray) -> tuple[float, Metric] | None:
    """The longest of halved steps that lowers the energy enough; None where none does."""
    slope = 0.5 * float(metric.defects @ direction)
    if not slope < 0.0:
        return None
    slack = _ROUNDING * float(np.abs(metric.shapes.angles * np.log(metric.lengths)).sum())
    length = 1.0
    for _ in range(_HALVINGS):
        after = metric_of(problem, metric.factors + length * direction)
        if after.energy <= metric.energy + _SUFFICIENT * length * slope + slack:
            return length, after
        length *= 0.5
    return None
