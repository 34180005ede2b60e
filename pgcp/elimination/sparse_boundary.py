"""A Laplacian whose boundary is not small beside its interior: nothing is eliminated, its boundary operator stays sparse.

The Schur complement S = L_BB - L_BI L_II^{-1} L_IB is dense, (n_B, n_B). Where nearly all vertices lie on the boundary, as in
a fan, two sparse factors do all that it is asked for: that of L_II applies S, that of L with one boundary vertex held solves
S g = r, since (g, u_I) solves L u = (r, 0).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import splu

from pgcp.elimination.dirichlet import DirichletFactor, eliminate_interior
from pgcp.errors import SolveFailedError
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray

_LEAST, _TIMES = 1500, 200


def stays_sparse(boundary_count: int, vertex_count: int, least: int = _LEAST) -> bool:
    """Whether a boundary is so long, and so large beside the interior, that a dense operator is dearer than sparse factors.

    least: vertices of a boundary that is long.
    """
    return boundary_count >= least and boundary_count**2 > _TIMES * vertex_count


class SparseSolver(Protocol):
    """A sparse symmetric system that can be solved."""

    def solve(self, load: Any) -> Any:
        """The solution (n, k) for loads (n, k), or (n,) for (n,), complex where the loads and the matrix are."""
        ...


def sparse_solver(matrix: csr_array) -> SparseSolver:
    """A sparse factor of a symmetric matrix, its ``solve`` for columns; raises SolveFailedError where it is singular."""
    try:
        solver: Any = splu(csc_array(matrix), "MMD_AT_PLUS_A", 0.0, options={"SymmetricMode": True})
    except RuntimeError as problem:
        raise SolveFailedError(f"a sparse system of {matrix.shape[0]} unknowns is singular") from problem
    made: SparseSolver = solver
    return made


Make = Callable[[csr_array], SparseSolver]


class SparseSchur:
    """The Schur complement (n_B, n_B) of a Laplacian on its boundary, as what is done with it; ``@`` applies it to columns."""

    def __init__(self, laplacian: csr_array, interior: IntArray, boundary: IntArray, make: Make) -> None:
        self._laplacian, self._interior, self._boundary, self._make = laplacian, interior, boundary, make
        self._block = laplacian[boundary][:, boundary]
        self.to_boundary = laplacian[boundary][:, interior]
        self._within = make(laplacian[interior][:, interior]) if len(interior) else None
        self._pinned: SparseSolver | None = None

    def __len__(self) -> int:
        return len(self._boundary)

    @property
    def system(self) -> csr_array:
        """The Laplacian itself (n_B + n_I, n_B + n_I), the boundary first."""
        order = np.concatenate([self._boundary, self._interior])
        return csr_array(self._laplacian[order][:, order])

    def inside(self, load: FloatArray) -> FloatArray:
        """L_II^{-1} r (n_I, k) for columns r."""
        return np.asarray(self._within.solve(load), np.float64) if self._within is not None else load

    def __matmul__(self, columns: FloatArray) -> FloatArray:
        return np.asarray(self._block @ columns - self.to_boundary @ self.inside(self.to_boundary.T @ columns), np.float64)

    def solve_pinned(self, load: FloatArray) -> FloatArray:
        """Values (n_B - 1, k) of all boundary vertices but the first, which is held at 0, under loads (n_B - 1, k) on them."""
        if self._pinned is None:
            free = np.concatenate([self._boundary[1:], self._interior])
            self._pinned = self._make(self._laplacian[free][:, free])
        all_load = np.concatenate([load, np.zeros((len(self._interior), load.shape[1]))])
        return np.asarray(self._pinned.solve(all_load)[: len(load)], np.float64)


class SparseFactor:
    """What a DirichletFactor does, its ``schur`` sparse; used (n,) says which vertices some face uses.

    make: what makes solvers of its sparse systems.
    """

    def __init__(self, laplacian: csr_array, boundary: IntArray, used: BoolArray, make: Make = sparse_solver) -> None:
        inside = used.copy()
        inside[boundary] = False
        self._interior, self._boundary, self._size = np.flatnonzero(inside), boundary, len(used)
        self.schur = SparseSchur(laplacian, self._interior, boundary, make)

    def extend(self, boundary_values: ComplexArray) -> ComplexArray:
        """Values (n,) of the harmonic function with the given ones on the boundary (n_B,)."""
        return self.solve(np.zeros(self._size, np.complex128), boundary_values)

    def solve(self, load: ComplexArray, boundary_values: ComplexArray) -> ComplexArray:
        """Values (n,) with the given ones on the boundary (n_B,) and, in the interior, the load (n,); 0 where nothing is."""
        out = np.zeros(self._size, np.complex128)
        out[self._boundary] = boundary_values
        # relative to the first value, so that constants pass unchanged
        first = boundary_values[0]
        passed = load[self._interior] - self.schur.to_boundary.T @ (boundary_values - first)
        out[self._interior] = first + self._inside(passed)
        return out

    def reduce(self, load: ComplexArray) -> ComplexArray:
        """Load (n_B,) on the boundary that does what a load (n,) does on the whole."""
        out: ComplexArray = load[self._boundary] - self.schur.to_boundary @ self._inside(load[self._interior])
        return out

    def _inside(self, load: ComplexArray) -> ComplexArray:
        solved = self.schur.inside(np.column_stack([load.real, load.imag]))
        out: ComplexArray = solved[:, 0] + 1j * solved[:, 1]
        return out

    def record(self) -> None:
        """There is no interface to be reported."""

    @property
    def nbytes(self) -> int:
        """No array is kept but the Laplacian and sparse factors: little beside a dense operator."""
        return 0

    def release(self) -> None:
        """Nothing is stored."""


AnyFactor = DirichletFactor | SparseFactor
AnySchur = FloatArray | SparseSchur


def either_factor(laplacian: csr_array, kept: IntArray, backend: str = "superlu") -> AnyFactor:
    """A Laplacian (n, n) with ``kept`` (n_K,) last: eliminated, or sparse where nearly all is kept; raises SolveFailedError."""
    if not stays_sparse(len(kept), laplacian.shape[0]):
        return eliminate_interior(laplacian, kept, backend)
    if not np.isfinite(laplacian.data).all():
        raise SolveFailedError("the Laplacian has entries that are not finite: a face has zero area")
    return SparseFactor(laplacian, kept, np.ones(laplacian.shape[0], bool))


def applied(schur: AnySchur, values: ComplexArray) -> ComplexArray:
    """The operator times complex values (n_B,)."""
    product = schur @ np.column_stack([values.real, values.imag])
    out: ComplexArray = product[:, 0] + 1j * product[:, 1]
    return out


def pinned_solver(schur: AnySchur) -> Callable[[FloatArray], FloatArray]:
    """What solves for values (n_B - 1, k) of all but the first, held at 0, under loads (n_B - 1, k) on them, factored once.

    Raises SolveFailedError where the system is not positive definite.
    """
    if isinstance(schur, SparseSchur):
        return schur.solve_pinned
    try:
        factor = cho_factor(schur[1:, 1:], check_finite=False)
    except LinAlgError as problem:
        raise SolveFailedError(f"the boundary system of {len(schur)} unknowns is not positive definite") from problem
    return lambda load: np.asarray(cho_solve(factor, load, check_finite=False), np.float64)
