"""Boundary-last elimination by MKL PARDISO in Schur mode (iparm[35] = 2). Needs the ``mkl`` package."""

from __future__ import annotations

import ctypes
import functools
import sys
import sysconfig
import threading
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_array, triu

from pgcp.errors import SolveFailedError
from pgcp.parallel import library_loaded
from pgcp.types import ComplexArray, FloatArray, IntArray

_SYMMETRIC_INDEFINITE = -2
_SEQUENTIAL = 1
# in Schur mode PARDISO crashes now and then when two threads of a process are in it; __del__ may come within a call
_ONE_AT_A_TIME = threading.RLock()
_MESSAGES = {
    -1: "the input is inconsistent",
    -2: "there is not enough memory",
    -3: "the reordering failed",
    -4: "a pivot is zero",
    -7: "the diagonal is singular",
}


@functools.cache
def runtime() -> Any:
    """Return the MKL runtime, loaded once, or None where it is not installed."""
    places = [Path(sysconfig.get_path("data")), Path(sys.prefix)]
    for place in places:
        for pattern in ("lib/libmkl_rt.so*", "Library/bin/mkl_rt*.dll"):
            for path in sorted(place.glob(pattern)):
                try:
                    library = ctypes.CDLL(str(path))
                except OSError:
                    continue
                library_loaded()
                return library
    return None


@functools.cache
def _sequential() -> Any:
    """Return the MKL runtime without threads of its own; the tasks are what runs in parallel."""
    library = runtime()
    library.MKL_Set_Threading_Layer(ctypes.c_int(_SEQUENTIAL))
    return library


def is_available() -> bool:
    """Whether the MKL runtime can be loaded."""
    return runtime() is not None


def _pointer(array: Any) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


class PardisoFactor:
    """The Laplacian's factor inside PARDISO, and the dense Schur complement on the boundary."""

    def __init__(self, laplacian: csr_array, interior: IntArray, boundary: IntArray) -> None:
        order = np.concatenate([interior, boundary])
        matrix = csr_array(triu(laplacian[order][:, order], format="csr"))
        matrix.sum_duplicates()
        matrix.sort_indices()
        starts, stops = matrix.indptr[:-1], matrix.indptr[1:]
        if np.any(starts == stops) or np.any(matrix.indices[starts] != np.arange(len(order))):  # PARDISO counts on them
            raise SolveFailedError(f"a Laplacian of {len(order)} vertices has rows without a diagonal entry")
        self._n, self._n_boundary, self._order = len(order), len(boundary), order
        self._data = np.ascontiguousarray(matrix.data, np.float64)
        self._indptr = matrix.indptr.astype(np.int32)
        self._indices = matrix.indices.astype(np.int32)
        self._handle = np.zeros(64, np.int64)
        self._iparm = np.zeros(64, np.int32)
        self._iparm[0] = 1  # no defaults
        self._iparm[1] = 2  # METIS nested dissection
        self._iparm[9] = 8  # pivot perturbation 1e-8
        self._iparm[34] = 1  # zero-based indices
        self._iparm[35] = 2  # Schur complement, factor kept for solves
        self._permutation = np.zeros(self._n, np.int32)
        self._permutation[len(interior) :] = 1
        schur = np.zeros((self._n_boundary, self._n_boundary))
        self._call(12, np.zeros(self._n), schur)
        # PARDISO fills one triangle; mirror whichever it is
        upper, lower = np.triu(schur, 1), np.tril(schur, -1)
        if np.any(upper) and np.any(lower):
            self.schur: FloatArray = 0.5 * (schur + schur.T)
        else:
            strict = upper + lower.T
            self.schur = strict + strict.T + np.diag(np.diag(schur))
        factor_bytes = 1024 * int(max(self._iparm[14], self._iparm[15] + self._iparm[16]))
        self.nbytes = factor_bytes + self.schur.nbytes + self._data.nbytes + self._indices.nbytes

    def extend(self, boundary_values: ComplexArray) -> ComplexArray:
        """Discrete harmonic extension; see DirichletFactor."""
        return self._back(np.zeros((2, self._n)), boundary_values)

    def solve(self, load: ComplexArray, boundary_values: ComplexArray) -> ComplexArray:
        """Interior values under a load; see DirichletFactor."""
        # phase 332, the diagonal, changes nothing but the boundary in Schur mode: 331 and 333 are the whole solve
        return self._back(self._forward(load), boundary_values)

    def reduce(self, load: ComplexArray) -> ComplexArray:
        """Load on the boundary in place of a load on the whole; see DirichletFactor."""
        partial = self._forward(load)[:, self._n - self._n_boundary :]
        out: ComplexArray = partial[0] + 1j * partial[1]
        return out

    def _forward(self, load: ComplexArray) -> FloatArray:
        """Forward elimination of a load (n,): two rows, real and imaginary part, in the factor's order."""
        ordered = load[self._order]
        right = np.ascontiguousarray(np.stack([ordered.real, ordered.imag]), np.float64)
        partial = np.zeros_like(right)
        self._call(331, right, partial)
        return partial

    def _back(self, right: FloatArray, boundary_values: ComplexArray) -> ComplexArray:
        """Back-substitution into rows (2, n) that hold the interior's part; their boundary's part is overwritten."""
        right[0, self._n - self._n_boundary :] = boundary_values.real
        right[1, self._n - self._n_boundary :] = boundary_values.imag
        solution = np.zeros((2, self._n))
        self._call(333, right, solution)
        out = np.empty(self._n, np.complex128)
        out[self._order] = solution[0] + 1j * solution[1]
        out[self._order[self._n - self._n_boundary :]] = boundary_values
        return out

    def release(self) -> None:
        """Free PARDISO's memory for this factor."""
        if self._handle.any():
            self._call(-1, np.zeros(1), np.zeros(1))
            self._handle[:] = 0

    def __del__(self) -> None:
        # late at exit even module names are gone, and the memory goes with the process
        if sys is not None and not sys.is_finalizing() and hasattr(self, "_permutation"):
            self.release()

    def _call(self, phase: int, right: FloatArray, result: FloatArray) -> None:
        count = 2 if right.ndim == 2 else 1
        integers = [ctypes.c_int32(v) for v in (1, 1, _SYMMETRIC_INDEFINITE, phase, self._n, count, 0, 0)]
        maxfct, mnum, kind, what, size, columns, quiet, status = integers
        with _ONE_AT_A_TIME:
            _sequential().pardiso(
                _pointer(self._handle), ctypes.byref(maxfct), ctypes.byref(mnum), ctypes.byref(kind), ctypes.byref(what),
                ctypes.byref(size), _pointer(self._data), _pointer(self._indptr), _pointer(self._indices),
                _pointer(self._permutation), ctypes.byref(columns), _pointer(self._iparm), ctypes.byref(quiet),
                _pointer(right), _pointer(result), ctypes.byref(status),
            )  # fmt: skip
        if status.value != 0:
            reason = _MESSAGES.get(status.value, f"code {status.value}")
            raise SolveFailedError(f"PARDISO failed on a Laplacian of {self._n} vertices: {reason}")
