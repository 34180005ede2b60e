"""CETM: conformal equivalence of triangle meshes (Springborn, Schroeder, Pinkall 2008).

Scale factors are sought that make all angle sums inside 2 pi: the minimum of a convex energy, by Newton's method. The flat
metric is laid out by its boundary and one harmonic solve.
"""

from __future__ import annotations

import numpy as np

from pgcp.elimination.sparse_boundary import pinned_solver
from pgcp.errors import InputError, SolveFailedError
from pgcp.methods.base import Method, OwnOption, whole
from pgcp.methods.common.boundary_first import closed_lengths
from pgcp.methods.common.conjugate_gradients import conjugate_gradients
from pgcp.methods.common.disk import BoundaryFactor, boundary_factor
from pgcp.methods.common.edge_metric import angle_sums, edge_lengths
from pgcp.methods.common.flat_metric import Metric, Precondition, Problem, flat_metric
from pgcp.methods.common.harmonic import mapped_whole
from pgcp.methods.common.prescribed import ANGLES, of_boundary, read_turning
from pgcp.options import Options
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts
from pgcp.surface.operators import weighted_laplacian
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray

_ISOMETRIC = "isometric"
_TURNS = 400
_LAID_OUT = 1e-13
_MISFIT = 1e-3


def _preconditioner(factor: BoundaryFactor, loop: IntArray, free: BoolArray) -> Precondition:
    """What solves the surface's own Laplacian for a load: the boundary held at 0, or free with one vertex held."""
    none = np.zeros(len(loop), np.complex128)
    held_apart = pinned_solver(factor.schur) if free[loop].any() else None

    def precondition(load: FloatArray) -> FloatArray:
        """Factors (V,) of a load (V,)."""
        whole_load = load.astype(np.complex128)
        held = none
        if held_apart is not None:
            reduced = held_apart(factor.reduce(whole_load).real[1:, None])[:, 0]
            held = np.concatenate([[0.0], reduced]).astype(np.complex128)
        return np.where(free, factor.solve(whole_load, held).real, 0.0)

    return precondition


def laid_out(run: Run, problem: Problem, metric: Metric, factor: BoundaryFactor) -> tuple[ComplexArray, float]:
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
        _LAID_OUT,
        _TURNS,
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
    factor = boundary_factor(run, parts)
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
