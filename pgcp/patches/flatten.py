"""Flatten one patch freely: its boundary by DNCP or SCP on the Schur complement (PGCP section 4.2)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.linalg.lapack import zhesv
from scipy.sparse import csr_array, diags_array

from pgcp.elimination.dirichlet import DirichletFactor, eliminate_mesh
from pgcp.elimination.sparse_boundary import AnyFactor, AnySchur, SparseFactor, SparseSchur, sparse_solver, stays_sparse
from pgcp.errors import SolveFailedError, WeldFailedError
from pgcp.patches.plan import plan_welds
from pgcp.patches.split import cut_patch, split_mesh
from pgcp.patches.types import BoundaryCurve, Patch
from pgcp.patches.weld import run_welds, start_component, subdivide
from pgcp.plane.curves import crosses_itself
from pgcp.surface.operators import cotangent_laplacian
from pgcp.surface.topology import examine, used_vertices
from pgcp.types import ComplexArray, FloatArray, IntArray, Mesh

_POWER_STEPS = 60
_SHIFT = 1e-9  # of SCP's matrix, times its mean diagonal entry
_LONG = 600  # boundary vertices of a patch from which on its operator may stay sparse


def conformal_energy_matrix(schur: FloatArray) -> ComplexArray:
    """Hermitian H (n_B, n_B) with E_C(u) = 1/2 u^* H u: the Dirichlet energy less the area (PGCP eq. 4.5-4.9).

    With the area 1/4i sum over boundary edges p -> q of (conj(u_p) u_q - u_p conj(u_q)), eq. 4.7.
    """
    n = len(schur)
    h = schur.astype(np.complex128)
    p = np.arange(n)
    q = (p + 1) % n
    np.add.at(h, (p, q), 0.5j)
    np.add.at(h, (q, p), -0.5j)
    return h


def sparse_energy_matrix(schur: SparseSchur) -> csr_array:
    """The Hermitian matrix (n, n) of the same energy on all vertices, the boundary's n_B first: nothing is eliminated."""
    system, count = schur.system, len(schur)
    p = np.arange(count)
    q = (p + 1) % count
    area = np.repeat([0.5j, -0.5j], count)
    return csr_array(system + csr_array((area, (np.concatenate([p, q]), np.concatenate([q, p]))), system.shape))


def _pins(positions: FloatArray) -> tuple[int, int]:
    """Two boundary vertices far apart: the one farthest from the centre, and the one farthest from it."""
    first = int(np.argmax(np.linalg.norm(positions - positions.mean(axis=0), axis=1)))
    second = int(np.argmax(np.linalg.norm(positions - positions[first], axis=1)))
    return first, second


def dncp_boundary(schur: AnySchur, positions: FloatArray) -> ComplexArray:
    """Boundary of the discrete natural conformal map with two pinned boundary vertices (PGCP eq. 4.10).

    schur (n_B, n_B), positions (n_B, 3) on the surface, counter-clockwise. Returns z (n_B,), the pins as far apart
    as on the surface. Raises SolveFailedError where the system is singular.
    """
    if isinstance(schur, SparseSchur):
        return _sparse_dncp(sparse_energy_matrix(schur), positions)
    h = conformal_energy_matrix(schur)
    first, second = _pins(positions)
    distance = float(np.linalg.norm(positions[second] - positions[first]))
    z = np.zeros(len(h), np.complex128)
    z[second] = distance
    free = np.setdiff1d(np.arange(len(h)), [first, second])
    right = -h[free, second] * distance
    h[[first, second]] = 0.0
    h[:, [first, second]] = 0.0
    h[[first, second], [first, second]] = 1.0
    full = np.zeros(len(h), np.complex128)
    full[free] = right
    try:
        # by columns the rows of h are its conjugate: no copy is made, and the conjugate system is solved
        factor = cho_factor(h.T, lower=True, overwrite_a=True, check_finite=False)
        z[free] = cho_solve(factor, full.conj(), check_finite=False).conj()[free]
    except LinAlgError:
        z[free] = _solved_indefinite(conformal_energy_matrix(schur)[np.ix_(free, free)], right)
    return _checked(z)


def _sparse_dncp(h: csr_array, positions: FloatArray) -> ComplexArray:
    """The same from the sparse matrix h (n, n) of all vertices, the boundary first."""
    first, second = _pins(positions)
    distance = float(np.linalg.norm(positions[second] - positions[first]))
    free = np.setdiff1d(np.arange(h.shape[0]), [first, second])
    rows = csr_array(h[free])
    z = np.zeros(h.shape[0], np.complex128)
    z[second] = distance
    z[free] = sparse_solver(csr_array(rows[:, free])).solve(-distance * rows[:, [second]].toarray()[:, 0])
    return _checked(z[: len(positions)])


def _solved_indefinite(system: ComplexArray, right: ComplexArray) -> ComplexArray:
    """Solve a Hermitian system that is positive definite but for rounding: its diagonal scaled to 1, by Bunch and Kaufman.

    The solve is backward stable whatever the condition; what the map is worth is seen by its folds.
    """
    diagonal = np.abs(np.diag(system))
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    _, _, solution, info = zhesv(scale[:, None] * system * scale, scale * right)
    if info != 0:
        raise SolveFailedError("the DNCP boundary system is singular")
    solved: ComplexArray = scale * solution
    return solved


def scp_boundary(schur: AnySchur, positions: FloatArray) -> ComplexArray:
    """Boundary of the spectral conformal map: the smallest non-constant mode of H u = lambda B u.

    B weighs boundary vertices by their share of the boundary's length. No vertex is pinned.
    """
    step = np.linalg.norm(np.roll(positions, -1, axis=0) - positions, axis=1)
    mass = 0.5 * (step + np.roll(step, 1))
    mass = np.maximum(mass / mass.sum(), 1e-12)
    shifted = _shifted_solver(schur)
    z = dncp_boundary(schur, positions)
    for _ in range(_POWER_STEPS):
        z = z - mass @ z
        z /= np.sqrt(mass @ np.abs(z) ** 2)
        before = z
        z = shifted(mass * z)
        z = z - mass @ z
        overlap = abs((mass * before.conj()) @ z) / np.sqrt(mass @ np.abs(z) ** 2)
        if 1.0 - overlap < 1e-14:
            break
    return _checked(z * (step.sum() / np.abs(np.roll(z, -1) - z).sum()))


def _shifted_solver(schur: AnySchur) -> Callable[[ComplexArray], ComplexArray]:
    """What solves (H + a small multiple of 1) u = r for loads r (n_B,) on the boundary."""
    if isinstance(schur, SparseSchur):
        sparse, count = sparse_energy_matrix(schur), len(schur)
        lift = np.zeros(sparse.shape[0])
        lift[:count] = _SHIFT * float(np.abs(sparse.diagonal()[:count]).mean())
        solver = sparse_solver(csr_array(sparse + diags_array(lift)))
        rest = np.zeros(len(lift) - count)
        return lambda load: np.asarray(solver.solve(np.concatenate([load, rest]))[:count], np.complex128)
    h = conformal_energy_matrix(schur)
    h[np.diag_indices(len(h))] += _SHIFT * float(np.abs(np.diag(h)).mean())
    try:
        factor = cho_factor(h, check_finite=False)
    except LinAlgError as problem:
        raise SolveFailedError("the SCP boundary system is not positive semi-definite") from problem
    return lambda load: cho_solve(factor, load, check_finite=False)


_FLATTENERS = {"dncp": dncp_boundary, "scp": scp_boundary}


def flatten_boundary(schur: AnySchur, positions: FloatArray, flattener: str) -> ComplexArray:
    """Boundary of a free-boundary conformal map, by the flattener of that name: dncp or scp."""
    return _FLATTENERS[flattener](schur, positions)


def _checked(z: ComplexArray) -> ComplexArray:
    if not np.isfinite(z).all():
        raise SolveFailedError("the boundary of a flattened patch is not finite")
    return z


def factor_patch(
    patch: Patch, backend: str, kept: IntArray | None = None, keeps: Callable[[int], bool] | None = None
) -> DirichletFactor:
    """Eliminate a patch's interior, or all but the local vertices ``kept``; the factor itself only where that is kept."""
    kept = patch.boundary if kept is None else kept
    return eliminate_mesh(patch.vertices, patch.faces, kept, backend, patch.mollification, keeps)


def first_factor(patch: Patch, backend: str) -> AnyFactor:
    """What flattens a patch and is not kept: its interior eliminated, or all sparse where nearly all lies on its boundary."""
    if not stays_sparse(len(patch.boundary), len(patch.vertices), _LONG):
        return factor_patch(patch, backend, keeps=lambda _nbytes: False)
    mesh = Mesh(patch.vertices, patch.faces)
    laplacian = cotangent_laplacian(patch.vertices, patch.faces, patch.mollification)
    if not np.isfinite(laplacian.data).all():
        raise SolveFailedError(f"the Laplacian of patch {patch.index} has entries that are not finite")
    return SparseFactor(laplacian, patch.boundary, used_vertices(mesh))


def flatten_simply(patch: Patch, factor: AnyFactor, method: str, backend: str) -> BoundaryCurve:
    """Flatten one patch to a boundary curve that does not cross itself, subdivided.

    Where the free boundary overlaps itself, two halves of the patch are flattened and welded: the weld of two simple
    curves is simple. A half that crosses itself is halved again.
    """
    z = flatten_boundary(factor.schur, patch.vertices[patch.boundary], method)
    ids = patch.vertex_ids[patch.boundary]
    if not crosses_itself(z):
        return BoundaryCurve(patch.index, ids, subdivide(z, patch.parts))
    if len(patch.faces) < 2:
        raise WeldFailedError(f"the free boundary of patch {patch.index} crosses itself in a single face")
    mesh = Mesh(patch.vertices, patch.faces, f"patch {patch.index}")
    topology = examine(mesh.faces, len(mesh.vertices))
    split = split_mesh(mesh, topology, 2, mollification=patch.mollification)
    parts = split.edges.parts.copy()
    parts[split.edges.rank(patch.boundary, np.roll(patch.boundary, -1))] = patch.parts
    split = replace(split, edges=replace(split.edges, parts=parts))
    halves, pieces = {}, 0
    for index in range(2):
        half = cut_patch(mesh, topology, split, index)
        half_factor = first_factor(half, backend)
        curve = flatten_simply(half, half_factor, method, backend)
        half_factor.release()
        halves[index] = start_component(curve, mesh.vertices, split.edges)
        pieces += curve.pieces
    union = run_welds(halves, plan_welds(split.table, 2).steps)
    start = int(np.flatnonzero(union.nodes[union.loop] == patch.boundary[0])[0])
    return BoundaryCurve(patch.index, ids, union.z[np.roll(union.loop, -start)], pieces)
