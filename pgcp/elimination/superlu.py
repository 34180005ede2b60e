"""Boundary-last elimination by SciPy's SuperLU in symmetric mode: wheels everywhere."""

from __future__ import annotations

import numba
import numpy as np
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import splu

from pgcp.errors import SolveFailedError
from pgcp.types import ComplexArray, FloatArray, IntArray


def _interior_order(laplacian: csr_array, interior: IntArray) -> IntArray:
    """Fill-reducing order of the interior: METIS nested dissection, or SuperLU's minimum degree without pymetis."""
    block = laplacian[interior][:, interior]
    try:
        from pymetis import CSRAdjacency, nested_dissection
    except ImportError:
        options = {"SymmetricMode": True}
        return np.argsort(splu(csc_array(block), "MMD_AT_PLUS_A", 0.0, options=options).perm_c)
    block.setdiag(0)
    block.eliminate_zeros()
    if block.nnz == 0:
        return np.arange(len(interior))
    order, _ = nested_dissection(CSRAdjacency(block.indptr.astype(np.int32), block.indices.astype(np.int32)))
    return np.asarray(order, np.int64)


@numba.njit(cache=True)
def _back_substitute(indptr: IntArray, indices: IntArray, data: FloatArray, first_boundary: int, x: ComplexArray) -> None:
    """Solve U x = 0 for x[:first_boundary] in place, x[first_boundary:] given; U upper triangular, CSC."""
    for column in range(x.shape[0] - 1, -1, -1):
        start, stop = indptr[column], indptr[column + 1]
        if column < first_boundary:
            x[column] /= data[stop - 1]
            stop -= 1
        value = x[column]
        for p in range(start, stop):
            if indices[p] < first_boundary:
                x[indices[p]] -= data[p] * value


@numba.njit(cache=True)
def _forward_substitute(indptr: IntArray, indices: IntArray, data: FloatArray, first_boundary: int, x: ComplexArray) -> None:
    """Solve the transpose of ``_back_substitute`` in place: x[first_boundary:] becomes the load on the boundary."""
    for column in range(x.shape[0]):
        start, stop = indptr[column], indptr[column + 1]
        value = x[column]
        for p in range(start, stop):
            row = indices[p]
            if row < first_boundary and row != column:
                value -= data[p] * x[row]
        x[column] = value / data[stop - 1] if column < first_boundary else value


def harmonic_extension(laplacian: csr_array, interior: IntArray, boundary: IntArray, values: ComplexArray) -> ComplexArray:
    """Harmonic values (n,) of a Laplacian (n, n) with those at ``boundary`` (n_B,) given; see ``dirichlet.extend_once``."""
    out = np.empty(laplacian.shape[0], np.complex128)
    out[boundary] = values
    if len(interior) == 0:
        return out
    if len(interior) > 1:
        interior = interior[_interior_order(laplacian, interior)]
    rows = laplacian[interior]
    try:
        options = {"SymmetricMode": True, "Equil": False}
        lu = splu(csc_array(rows[:, interior]), "NATURAL", 0.0, options=options)
    except RuntimeError as problem:
        raise SolveFailedError(f"SuperLU could not factor a Laplacian of {len(out)} vertices: {problem}") from problem
    if not np.array_equal(lu.perm_r, lu.perm_c):
        raise SolveFailedError("SuperLU pivoted off the diagonal: the interior block is not definite")
    load = -(rows[:, boundary] @ values)
    out[interior] = lu.solve(np.ascontiguousarray(load.real)) + 1j * lu.solve(np.ascontiguousarray(load.imag))
    return out


class SuperLUFactor:
    """L = P^T (L U) P with the boundary last; only the rows of U are kept (U is D L^T, and a zero right-hand
    side is zero after forward elimination)."""

    def __init__(self, laplacian: csr_array, interior: IntArray, boundary: IntArray) -> None:
        n_interior, n_boundary = len(interior), len(boundary)
        if n_interior == 0:
            self.schur: FloatArray = laplacian[boundary][:, boundary].toarray()
            self._order, self._first = np.asarray(boundary), 0
            self._u: csc_array = csc_array((n_boundary, n_boundary))
            self.nbytes = self.schur.nbytes
            return
        if n_interior > 1:
            interior = interior[_interior_order(laplacian, interior)]
        order = np.concatenate([interior, boundary])
        matrix = csc_array(laplacian[order][:, order])
        # the whole Laplacian is singular (constants); lift its last pivot, and take the lift off S again
        lift = float(np.abs(matrix.diagonal()).max())
        last = len(order) - 1
        matrix = matrix + csc_array(([lift], ([last], [last])), shape=matrix.shape)
        try:
            options = {"SymmetricMode": True, "Equil": False}
            lu = splu(csc_array(matrix), "NATURAL", 0.0, options=options)
        except RuntimeError as problem:
            raise SolveFailedError(f"SuperLU could not factor a Laplacian of {len(order)} vertices: {problem}") from problem
        if not np.array_equal(lu.perm_r, lu.perm_c):
            raise SolveFailedError("SuperLU pivoted off the diagonal: the interior block is not definite")
        u = lu.U
        # postordering may move a boundary column before unrelated interior ones: put them last again
        position = lu.perm_c
        if not np.array_equal(position[n_interior:], np.arange(n_interior, len(order))):
            back = np.concatenate([np.sort(position[:n_interior]), position[n_interior:]])
            inverse = np.empty_like(position)
            inverse[position] = np.arange(len(order))
            order = np.concatenate([order[inverse[back[:n_interior]]], boundary])
            u = csc_array(u[back][:, back])
        else:
            inverse = np.empty_like(position)
            inverse[position] = np.arange(len(order))
            order = order[inverse]
        del lu
        u.sort_indices()
        corner = u[n_interior:][:, n_interior:].toarray()
        diagonal = corner.diagonal().copy()
        schur = (corner / diagonal[:, None]).T @ corner
        schur[-1, -1] -= lift
        self.schur = 0.5 * (schur + schur.T)
        self._order, self._first, self._u = order, n_interior, u
        self.nbytes = int(u.data.nbytes + u.indices.nbytes + u.indptr.nbytes + self.schur.nbytes)

    def extend(self, boundary_values: ComplexArray) -> ComplexArray:
        """Discrete harmonic extension; see DirichletFactor."""
        x = np.zeros(len(self._order), np.complex128)
        x[self._first :] = boundary_values
        if self._first:
            _back_substitute(self._u.indptr, self._u.indices, self._u.data, self._first, x)
        out = np.empty_like(x)
        out[self._order] = x
        return out

    def solve(self, load: ComplexArray, boundary_values: ComplexArray) -> ComplexArray:
        """Interior values under a load; see DirichletFactor."""
        x = load[self._order].astype(np.complex128)
        if self._first:
            u = self._u
            _forward_substitute(u.indptr, u.indices, u.data, self._first, x)
            x[: self._first] *= u.data[u.indptr[1 : self._first + 1] - 1]
        x[self._first :] = boundary_values
        if self._first:
            _back_substitute(u.indptr, u.indices, u.data, self._first, x)
        out = np.empty_like(x)
        out[self._order] = x
        return out

    def reduce(self, load: ComplexArray) -> ComplexArray:
        """Load on the boundary in place of a load on the whole; see DirichletFactor."""
        x = load[self._order].astype(np.complex128)
        if self._first:
            _forward_substitute(self._u.indptr, self._u.indices, self._u.data, self._first, x)
        return x[self._first :]

    def release(self) -> None:
        """Drop the arrays."""
        self._u = csc_array((0, 0))
