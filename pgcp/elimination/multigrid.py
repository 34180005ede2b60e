"""Sparse systems by conjugate gradients with algebraic multigrid, beside the direct factors: needs the package pyamg.

CEM + CMG of the papers takes combinatorial multigrid (Koutis, Miller, Tolliver 2011); smoothed aggregation is the nearest
public thing. It solves for the whole mesh in one process, not patch by patch: a hierarchy of the whole cannot be put together
from those of its patches.
"""

from __future__ import annotations

from types import ModuleType

import numpy as np
from scipy.sparse import csr_array, csr_matrix

from pgcp.errors import InputError, SolveFailedError
from pgcp.parallel import one_blas_thread
from pgcp.types import FloatArray

TOLERANCE = 1e-11
MOST_ITERATIONS = 500
_STRONG = 0.08  # of |a_ij| / sqrt(a_ii a_jj), from which on two unknowns are put together: thin triangles have weaker edges


def _pyamg() -> ModuleType:
    try:
        import pyamg
    except ImportError as problem:
        raise InputError("the multigrid solver needs the package pyamg: pip install pgcp[multigrid]") from problem
    module: ModuleType = pyamg
    return module


class MultigridSolver:
    """What solves a symmetric positive definite system (n, n) for columns, each to a residual of 1e-11 of its load.

    A solve starts from the solution before it where there are as many columns: loads of an iteration change less and less.
    The hierarchy is made with random vectors from a fixed seed; the state of NumPy's generator is left as it was. Raises
    InputError where pyamg is not installed.
    """

    def __init__(self, matrix: csr_array) -> None:
        pyamg = _pyamg()
        plain = csr_matrix(matrix)
        plain.sort_indices()
        state = np.random.get_state()
        np.random.seed(0)
        try:
            levels = pyamg.smoothed_aggregation_solver(plain, strength=("symmetric", {"theta": _STRONG}))
        finally:
            np.random.set_state(state)
        self._preconditioner = levels.aspreconditioner(cycle="V")
        self._matrix = plain
        self._last: FloatArray | None = None

    def solve(self, load: FloatArray) -> FloatArray:
        """The solution (n, k) for loads (n, k); raises SolveFailedError where conjugate gradients do not get there."""
        from scipy.sparse.linalg import cg

        loads = np.asarray(load, np.float64).reshape(len(load), -1).T
        if self._last is None or self._last.shape != loads.shape:
            self._last = np.zeros_like(loads)
        columns = []
        for column, start in zip(loads, self._last, strict=True):
            with one_blas_thread():  # vectors are too short for threads of BLAS, which wait for each other
                x, failed = cg(
                    self._matrix, column, start, rtol=TOLERANCE, atol=0.0, maxiter=MOST_ITERATIONS, M=self._preconditioner
                )  # fmt: skip
            if failed:
                residual = float(np.linalg.norm(self._matrix @ x - column) / np.linalg.norm(column))
                raise SolveFailedError(
                    f"multigrid did not converge in {MOST_ITERATIONS} iterations on {len(column)} unknowns: residual"
                    f" {residual:.1e} of the load; the direct solver does without"
                )
            columns.append(x)
        self._last = np.array(columns)
        return np.column_stack(columns).reshape(np.shape(load))
