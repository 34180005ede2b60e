"""CEM: conformal energy minimisation by a fixed-point iteration (Yueh, Lin, Wu, Yau 2017), the start of CCEM.

One step moves every boundary vertex to where it is harmonic, the interior held, L_BB w = -L_BI f_I, and puts the boundary
back on the circle, its mean at 0, so that it cannot shrink to a point. With the interior harmonic, -L_BI f_I is
(L_BB - S) f_B. There is no line search: the energy may rise, and the boundary may lose its order. The start decides where it
ends; of two, the boundary of the double cover's harmonic map and the boundary by its length, the better one is taken.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import splu

from pgcp.elimination.multigrid import MultigridSolver
from pgcp.elimination.sparse_boundary import AnyFactor, AnySchur
from pgcp.errors import InputError, SolveFailedError
from pgcp.methods.base import Method, OwnOption, whole
from pgcp.methods.common.boundary_energy import (
    Descent,
    EnergyMap,
    Step,
    energy_and_gradient,
    extended,
    goes_round_once,
    increasing_angles,
    on_circle,
)
from pgcp.methods.common.disk import Disk, DiskMap, map_disk, of_energy
from pgcp.methods.common.sphere_energy import map_by_caps
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts
from pgcp.types import FloatArray

ITERATIONS = 20
TOLERANCE = 1e-6
_ROUNDING = 1e-13
DIRECT, MULTIGRID = "direct", "multigrid"


def cem_boundary(
    schur: AnySchur, block: csr_array, start: FloatArray, iterations: int = ITERATIONS, tolerance: float = TOLERANCE
) -> Descent:
    """Iterate from increasing angles (n_B,) until the energy changes by less than ``tolerance``.

    schur S and block L_BB (n_B, n_B). Ends before that where the boundary loses its order, and at once where there is no
    interior: then nothing holds the boundary, L_BB has the constants in its kernel, and there is no step. Returns the iterate
    of least energy; the record holds all. Raises SolveFailedError where L_BB is singular otherwise.
    """
    best = angles = start
    energy, gradient = energy_and_gradient(schur, angles)
    least = energy
    steps = [Step("cem", 0, energy, float(np.linalg.norm(gradient)))]
    if not _has_interior(block):
        return Descent(best, tuple(steps), False)
    try:
        solver = splu(csc_array(block))
    except RuntimeError as problem:
        raise SolveFailedError("the boundary block of the Laplacian is singular") from problem
    for iteration in range(1, iterations + 1):
        z = on_circle(angles)
        plane = np.column_stack([z.real, z.imag])
        plane -= solver.solve(schur @ plane)
        plane -= plane.mean(axis=0)
        z = plane[:, 0] + 1j * plane[:, 1]
        if not (np.isfinite(z).all() and goes_round_once(z)):
            return Descent(best, tuple(steps), False)
        angles, before = increasing_angles(z), energy
        energy, gradient = energy_and_gradient(schur, angles)
        steps.append(Step("cem", iteration, energy, float(np.linalg.norm(gradient))))
        if energy < least:
            best, least = angles, energy
        if abs(energy - before) < tolerance:
            return Descent(best, tuple(steps), True)
    return Descent(best, tuple(steps), False)


def _has_interior(block: csr_array) -> bool:
    """Whether a boundary vertex has an inner neighbour: the rows of a Laplacian without one add up to 0."""
    return bool(np.abs(block.sum(axis=1)).max() > _ROUNDING * np.abs(block.data).max())


def better_start(schur: AnySchur, block: csr_array, starts: tuple[FloatArray, ...]) -> FloatArray:
    """The one of several starts (n_B,) from which CEM comes to the least energy; the first of those that come to the same."""
    if len(starts) == 1:
        return starts[0]
    return min(starts, key=lambda start: _least(cem_boundary(schur, block, start)))


def _least(found: Descent) -> float:
    return min(step.energy for step in found.steps)


def cem_map(factor: AnyFactor, block: csr_array, *starts: FloatArray) -> EnergyMap:
    """Map a disk-like surface to the unit disk by CEM, from the best of several starts; arguments as ``ccem_map``'s."""
    found = min((cem_boundary(factor.schur, block, start) for start in starts), key=_least)
    return EnergyMap(extended(factor, found.angles), found.steps, found.converged)


def _map(disk: Disk) -> DiskMap:
    block = disk.boundary_block()
    return of_energy(cem_map(disk.factor, block, *disk.starts()))


def _map_either(run: Run, parts: Parts) -> Mapped:
    by_multigrid = run.options.own["solver"] == MULTIGRID
    if run.is_closed and by_multigrid:
        raise InputError(f"the solver {MULTIGRID} is one for open surfaces; a closed one is eliminated patch by patch")
    if run.is_closed:
        return map_by_caps(run, parts)
    return map_disk(run, parts, _map, MultigridSolver if by_multigrid else None)


METHOD = Method(
    name="cem",
    targets=("disk", "sphere"),
    summary="conformal energy minimised by a fixed-point iteration on the boundary, or on two caps of the sphere",
    guarantees="disk: boundary in order, no descent promised; sphere: energy falls in every step",
    reference="Yueh, Lin, Wu, Yau 2017",
    mapper=whole(_map_either),
    moebius="none",
    own=(
        OwnOption(
            "solver",
            "what solves the sparse systems: direct, the patches' elimination; multigrid, which needs pgcp[multigrid]",
            DIRECT,
            choices=(DIRECT, MULTIGRID),
        ),
    ),
)
