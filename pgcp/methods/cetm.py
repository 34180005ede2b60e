"""CETM: conformal equivalence of triangle meshes (Springborn, Schroeder, Pinkall 2008).

Scale factors are sought that make all angle sums inside 2 pi: the minimum of a convex energy, by Newton's method. Its matrix
is the cotangent Laplacian of the current lengths, which belong to no surface in space, so that patches cannot be eliminated
again; but it is near that of the surface, since angles hardly change. Each step is solved by conjugate gradients preconditioned
with the surface's Laplacian, eliminated once and patch by patch. Where angles do change, so that this takes many turns, the
matrix is factored as a whole. The flat metric is laid out by its boundary and one more solve of the first kind.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from pgcp.elimination.dirichlet import eliminate_interior
from pgcp.errors import InputError, SolveFailedError
from pgcp.interface.factor import InterfaceFactor
from pgcp.interface.whole_mesh import eliminated
from pgcp.methods.base import Method, OwnOption, whole
from pgcp.methods.common.boundary_first import closed_lengths
from pgcp.methods.common.conjugate_gradients import conjugate_gradients
from pgcp.methods.common.double_cover import solve_symmetric
from pgcp.methods.common.edge_metric import (
    Shapes,
    angle_sums,
    conformal_equivalence_energy,
    edge_lengths,
    scaled_lengths,
    shapes_of,
)
from pgcp.methods.common.harmonic import mapped_whole
from pgcp.methods.common.prescribed import ANGLES, of_boundary, read_turning
from pgcp.options import Options
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts
from pgcp.surface.operators import weighted_laplacian
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray

_ISOMETRIC = "isometric"
_STEPS, _HALVINGS, _INNER = 50, 30, 400
_MANY = 20  # turns of conjugate gradients in one step, from which on matrices are factored
_FLAT, _NEARLY_FLAT = (
    1e-12,
    1e-8,
)  # largest angle defect, radians, that ends it, and that is good enough where it ends otherwise
_SUFFICIENT, _ROUNDING = 1e-4, 1e-14
_SHIFT = 1e-8
_MISFIT = 1e-3

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
    if broken or not metric.largest <= _NEARLY_FLAT:
        raise SolveFailedError(
            f"no flat metric was found in {len(steps) - 1} Newton steps: the largest angle defect left is {metric.largest:.3g} "
            f"radians, at vertex {int(np.abs(metric.defects).argmax())}, and {broken} faces break their triangle inequality; "
            "remesh the surface with better-shaped faces, or choose --method bff"
        )
    return metric, steps


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
    factor = eliminate_interior(_matrix(problem, metric), held)
    return np.asarray(factor.solve(-metric.defects.astype(np.complex128), np.zeros(len(held), np.complex128)).real, np.float64)


def _nearby_direction(problem: Problem, metric: Metric, precondition: Precondition) -> tuple[FloatArray, int]:
    """Solve L(l) d = - defects by conjugate gradients, and count their turns."""
    matrix = _matrix(problem, metric)

    def apply(x: FloatArray) -> FloatArray:
        return np.asarray(np.where(problem.free, matrix @ x, 0.0), np.float64)

    # as good as a step of second order can use
    tolerance = float(np.clip(0.01 * metric.largest, 1e-6, 1e-2))
    return conjugate_gradients(apply, precondition, -metric.defects, tolerance, _MANY + 1)


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


def _preconditioner(factor: InterfaceFactor, loop: IntArray, free: BoolArray) -> Precondition:
    """What solves the surface's own Laplacian for a load: the boundary held at 0, or free with one vertex held."""
    none = np.zeros(len(loop), np.complex128)
    schur = factor.schur[1:, 1:] if free[loop].any() else None

    def precondition(load: FloatArray) -> FloatArray:
        whole_load = load.astype(np.complex128)
        held = none
        if schur is not None:
            reduced = factor.reduce(whole_load).real[1:, None]
            held = np.concatenate([[0.0], solve_symmetric(schur, reduced)[:, 0]]).astype(np.complex128)
        return np.where(free, factor.solve(whole_load, held).real, 0.0)

    return precondition


def laid_out(run: Run, problem: Problem, metric: Metric, factor: InterfaceFactor) -> tuple[ComplexArray, float]:
    """Positions z (V,) of a flat metric, and by how much an edge differs from its length, as a part of the face's perimeter.

    The boundary is laid out by its lengths and angles; all else is harmonic in the metric, as positions in the plane are.
    """
    loop, faces, count = run.boundary, problem.faces, len(problem.targets)
    sums = angle_sums(metric.shapes.angles, faces, count)[loop]
    here = run.mesh.vertices[loop] - run.mesh.vertices[np.roll(loop, -1)]
    factors = metric.factors[loop]
    sides = (np.linalg.norm(here, axis=1) + run.mollification) * np.exp(0.5 * (factors + np.roll(factors, -1)))
    along = np.exp(1j * np.cumsum(np.pi - sums))
    steps = closed_lengths(sides, along, sides) * along
    on_boundary = np.asarray(np.concatenate([[0.0], np.cumsum(steps[:-1])]), np.complex128)
    first = factor.extend(on_boundary)
    laplacian = weighted_laplacian(faces, 0.5 * metric.shapes.cotangents, count)
    inside = np.zeros(count, bool)
    inside[faces] = True
    inside[loop] = False
    none = np.zeros(len(loop), np.complex128)
    correction, _ = conjugate_gradients(
        lambda x: np.where(inside, laplacian @ x, 0.0),
        lambda load: np.where(inside, factor.solve(load, none), 0.0),
        np.asarray(np.where(inside, -(laplacian @ first), 0.0), np.complex128),
        1e-13,
        _INNER,
    )
    z = first + correction
    corners = z[faces]
    there = np.abs(np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1))
    misfit = np.abs(there - metric.lengths) / metric.lengths.sum(axis=1, keepdims=True)
    return z, float(misfit.max())


def _problem(run: Run) -> Problem:
    """What is sought: 2 pi inside, and on the boundary factors of 0 or the angles that are prescribed."""
    mesh, loop = run.mesh, run.boundary
    _, path = of_boundary(run.options.own["boundary"], (_ISOMETRIC,), (ANGLES,))
    free = np.zeros(len(mesh.vertices), bool)
    free[mesh.faces] = True
    targets = np.where(free, 2.0 * np.pi, 0.0)
    free[loop] = path is not None
    if path is not None:
        targets[loop] = np.pi - read_turning(path, loop)
        free[loop[0]] = False  # a common factor is left: the sum of all defects is 0
    else:
        targets[loop] = np.pi  # adds nothing: their factors are 0
    return Problem(mesh.faces, edge_lengths(mesh.vertices, mesh.faces, run.mollification), targets, free)


def _map(run: Run, parts: Parts) -> Mapped:
    problem, loop = _problem(run), run.boundary
    factor = eliminated(run, parts, loop)
    with run.clock.stage("map"):
        metric, steps = flat_metric(problem, _preconditioner(factor, loop, problem.free))
    with run.clock.stage("lay out"):
        z, misfit = laid_out(run, problem, metric, factor)
    record = factor.record()
    factor.release()
    if not misfit <= _MISFIT:
        raise SolveFailedError(
            f"the flat metric cannot be laid out to rounding: an edge differs from its length by {misfit:.3g} of its face's "
            "perimeter; choose --method bff"
        )
    details = {"interface": record, "iterations": steps, "converged": True}
    return mapped_whole(run, parts, z, loop, details)


def _boundary(value: str) -> None:
    _, path = of_boundary(value, (_ISOMETRIC,), (ANGLES,))
    if path is not None:
        read_turning(path)


def _meant(options: Options) -> Options:
    if options.fix and options.own["boundary"] != _ISOMETRIC:
        raise InputError(
            f"{options.own['boundary']}: the file names vertices that --fix may renumber; map the mesh that it writes"
        )
    return options


METHOD = Method(
    name="cetm",
    targets=("free",),
    summary="conformal equivalence: scale factors that make all angles flat, the minimum of a convex energy",
    guarantees="the same map for any cuts; the metric is flat to rounding, or the run ends and says so",
    reference="Springborn, Schroeder, Pinkall 2008 (CETM)",
    mapper=whole(_map),
    options=_meant,
    own=(
        OwnOption(
            "boundary",
            "isometric (keeps lengths) or angles:FILE (a vertex and the degrees it turns by a line)",
            _ISOMETRIC,
            metavar="WHICH",
            check=_boundary,
        ),
    ),
)
