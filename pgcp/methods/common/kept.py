"""A disk-like surface whose boundary and some inner vertices are kept: harmonic maps of it and of its double cover.

The double cover is the surface glued to its mirror image along the boundary. Its operator on the boundary, the inner
vertices kept in one copy and those in the other is made of two copies of the surface's own.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from pgcp.elimination.sparse_boundary import sparse_solver, stays_sparse
from pgcp.interface.factor import InterfaceFactor
from pgcp.interface.whole_mesh import eliminated, seen_on_the_final_map
from pgcp.methods.common.double_cover import solve_symmetric
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts
from pgcp.patches.types import SeamPositions, SolveReport
from pgcp.plane.space import map_coefficients
from pgcp.surface.operators import cotangent_laplacian
from pgcp.surface.topology import used_vertices
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray, Mesh, Positions

_DIGITS = 2.0**-26


def first_of(values: FloatArray, count: int) -> IntArray:
    """Places (count,) of the least values (n,), least first; those that differ by rounding only go by their places.

    Maps of other cuts differ by rounding, and symmetric surfaces have many equal values: the choice is to be the same.
    """
    finite = np.isfinite(values)
    step = _DIGITS * float(np.abs(values[finite]).max(initial=0.0))
    coarse = np.where(finite, np.rint(np.where(finite, values, 0.0) / step) if step > 0.0 else 0.0, np.inf)
    return np.argsort(coarse, kind="stable")[:count]


def rim_of(held: BoolArray, faces: IntArray) -> IntArray:
    """Held vertices (n,), ascending, with a neighbour that is not: they separate the others from the rest of the held."""
    mixed = faces[held[faces].any(axis=1) & ~held[faces].all(axis=1)]
    rim = np.unique(mixed)
    return rim[held[rim]]


def most_regular_face(mesh: Mesh) -> int:
    """The face whose edges are nearest to a third of its perimeter each: the least sum of |length / perimeter - 1/3|."""
    corners = mesh.vertices[mesh.faces]
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    perimeter = lengths.sum(axis=1)
    share = lengths / np.where(perimeter > 0.0, perimeter, 1.0)[:, None]
    return int(np.abs(share - 1.0 / 3.0).sum(axis=1).argmin())


def harmonic_with(run: Run, parts: Parts, kept: IntArray, values: ComplexArray) -> tuple[ComplexArray, dict[str, object]]:
    """The harmonic function (V,) with given values (n,) at some vertices, and what the report says of its elimination."""
    factor = eliminated(run, parts, kept)
    with run.clock.stage("map"):
        out = factor.extend(values)
    record = factor.record()
    factor.release()
    return out, record


def harmonic(matrix: FloatArray | csr_array, held: BoolArray, values: ComplexArray) -> ComplexArray:
    """Values (n,) with no load where they are not held (n,), as they are elsewhere; matrix (n, n) symmetric.

    Raises SolveFailedError where the matrix of those not held is not positive definite.
    """
    out = np.where(held, values, 0.0)
    if held.all():
        return out
    columns = np.column_stack([out[held].real, out[held].imag])
    if isinstance(matrix, csr_array):
        rows = matrix[~held]
        solved = sparse_solver(rows[:, ~held]).solve(-(rows[:, held] @ columns))
    else:
        solved = solve_symmetric(matrix[np.ix_(~held, ~held)], -(matrix[np.ix_(~held, held)] @ columns))
    out[~held] = solved[:, 0] + 1j * solved[:, 1]
    return out


class KeptDisk:
    """A disk-like surface with all eliminated but its boundary loop (n_B,) and inner vertices (n_R,), ascending.

    Where the boundary is not small beside the interior nothing is eliminated: all vertices are kept, the operator is sparse.
    """

    def __init__(self, run: Run, parts: Parts, inner: IntArray) -> None:
        mesh = run.mesh
        self.loop, self.size = run.boundary, len(mesh.vertices)
        self.factor: InterfaceFactor | None = None
        self.schur: FloatArray | csr_array
        if stays_sparse(len(self.loop), self.size):
            self.inner = np.setdiff1d(np.flatnonzero(used_vertices(mesh)), self.loop)
            self.kept = np.concatenate([self.loop, self.inner])
            laplacian = cotangent_laplacian(mesh.vertices, mesh.faces, run.mollification)
            self.schur = csr_array(laplacian[self.kept][:, self.kept])
            return
        self.inner = np.setdiff1d(inner, self.loop)
        self.kept = np.concatenate([self.loop, self.inner])
        self.factor = eliminated(run, parts, self.kept)
        self.schur = self.factor.schur

    def extend(self, values: ComplexArray) -> ComplexArray:
        """The harmonic function (V,) with values at the kept vertices (n_B + n_R,)."""
        if self.factor is not None:
            return self.factor.extend(values)
        out = np.zeros(self.size, np.complex128)
        out[self.kept] = values
        return out

    def within(self, on_loop: ComplexArray) -> ComplexArray:
        """The harmonic function (V,) with values on the boundary (n_B,) only."""
        held = np.arange(len(self.kept)) < len(self.loop)
        values = np.concatenate([on_loop, np.zeros(len(self.inner), np.complex128)])
        return self.extend(harmonic(self.schur, held, values))

    def doubled(self, held: BoolArray, values: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """The harmonic function of the double cover on either copy (n_B + n_R,), given at some vertices.

        held and values (2, V): of the vertices of the first copy and of the second. Those held in the interior of a copy, or
        the rim of them, must be among the inner vertices; boundary vertices are looked up in the first copy.
        """
        n, more = len(self.loop), len(self.inner)
        first, second = np.arange(n + more), np.concatenate([np.arange(n), np.arange(n + more, n + 2 * more)])
        matrix: FloatArray | csr_array
        if isinstance(self.schur, csr_array):
            copies = [
                csr_array((np.ones(n + more), p, np.arange(n + more + 1)), (n + more, n + 2 * more)) for p in (first, second)
            ]
            matrix = csr_array(sum(copy.T @ self.schur @ copy for copy in copies))
        else:
            matrix = np.zeros((n + 2 * more, n + 2 * more))
            for places in (first, second):
                matrix[np.ix_(places, places)] += self.schur
        kept = np.concatenate([held[0, self.kept], held[1, self.inner]])
        given = np.concatenate([values[0, self.kept], values[1, self.inner]])
        out = harmonic(matrix, kept, given)
        return out[first], out[second]

    def release(self) -> dict[str, object] | None:
        """Free what is stored; returns what the report says of it."""
        if self.factor is None:
            return None
        record = self.factor.record()
        self.factor.release()
        return record


def as_mapped(
    run: Run, parts: Parts, points: Positions, held: IntArray, interface: dict[str, object] | None, **details: object
) -> Mapped:
    """A finished map (V,) of the undivided mesh; what the report says: held vertices (n,), the interface, details."""
    mu = map_coefficients(run.target.space, run.mesh, run.mesh.faces, points)
    untouched = [SolveReport(patch.index, 0, 0, 0, 0.0) for patch in parts.patches]
    solved = seen_on_the_final_map(run, parts, untouched, points, mu)
    seams = SeamPositions(held, points[held])
    return Mapped(parts, run.target, points, mu, seams, solved, details={"interface": interface, **details})
