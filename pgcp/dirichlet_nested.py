"""Boundary-last elimination along a nested dissection of the faces: multifrontal Cholesky, every machine, no matrix assembled.

Every node of the dissection has a front, a dense symmetric matrix on the vertices eliminated there and on the later ones
its faces touch: the sum of its faces' element matrices or of its children's Schur complements (Duff, Reid 1983). It is
eliminated in place; what is left goes up. What the root leaves is the Dirichlet-to-Neumann operator on the kept
vertices. Small fronts are eliminated by compiled loops, large ones by SciPy's BLAS and LAPACK.
"""

from __future__ import annotations

from collections.abc import Callable

import numba
import numpy as np
from llvmlite import binding
from numba import types
from numba.extending import get_cython_function_address

from pgcp.dissection import dissect
from pgcp.errors import SolveFailedError
from pgcp.operators import corner_weights
from pgcp.types import ComplexArray, FloatArray, IntArray

_SMALL_FRONT = 32
_FEW_COLUMNS = 8

# names of their own, so that compiled code that uses them can be kept between runs
for _module, _name in (("lapack", "dpotrf"), ("blas", "dtrsm"), ("blas", "dsyrk")):
    binding.add_symbol(f"pgcp_{_name}", get_cython_function_address(f"scipy.linalg.cython_{_module}", _name))
_DOUBLES, _INTS, _CHARS = types.CPointer(types.float64), types.CPointer(types.intc), types.CPointer(types.uint8)
_potrf = types.ExternalFunction("pgcp_dpotrf", types.void(_CHARS, _INTS, _DOUBLES, _INTS, _INTS))
_trsm = types.ExternalFunction(
    "pgcp_dtrsm",
    types.void(_CHARS, _CHARS, _CHARS, _CHARS, _INTS, _INTS, _DOUBLES, _DOUBLES, _INTS, _DOUBLES, _INTS),
)
_syrk = types.ExternalFunction(
    "pgcp_dsyrk", types.void(_CHARS, _CHARS, _INTS, _INTS, _DOUBLES, _DOUBLES, _INTS, _DOUBLES, _DOUBLES, _INTS)
)


@numba.njit(cache=True, nogil=True)
def _eliminate_large(front: FloatArray, own: int, width: int) -> bool:
    """Eliminate the first ``own`` of ``width`` rows of a front by BLAS; False where a pivot is not positive.

    The front's upper triangle by rows is, to Fortran, its lower triangle by columns.
    """
    lower, right = np.array([ord("L")], np.uint8), np.array([ord("R")], np.uint8)
    transposed, plain = np.array([ord("T")], np.uint8), np.array([ord("N")], np.uint8)
    columns, stride = np.array([own], np.intc), np.array([width], np.intc)
    rest, info = np.array([width - own], np.intc), np.zeros(1, np.intc)
    one, minus_one = np.ones(1), -np.ones(1)
    _potrf(lower.ctypes, columns.ctypes, front.ctypes, stride.ctypes, info.ctypes)
    if info[0] != 0:
        return False
    if width > own:
        below, corner = front[own:], front[own * width + own :]
        _trsm(
            right.ctypes, lower.ctypes, transposed.ctypes, plain.ctypes, rest.ctypes, columns.ctypes, one.ctypes,
            front.ctypes, stride.ctypes, below.ctypes, stride.ctypes,
        )  # fmt: skip
        _syrk(
            lower.ctypes, plain.ctypes, rest.ctypes, columns.ctypes, minus_one.ctypes, below.ctypes, stride.ctypes,
            one.ctypes, corner.ctypes, stride.ctypes,
        )  # fmt: skip
    return True


@numba.njit(cache=True, nogil=True)
def _eliminate_small(front: FloatArray, own: int, width: int) -> bool:
    """The same by loops: row t of U, then the rows below it."""
    rows = front[: width * width].reshape(width, width)
    for t in range(own):
        pivot = rows[t, t]
        if not pivot > 0.0:
            return False
        root = np.sqrt(pivot)
        rows[t, t] = root
        inverse = 1.0 / root
        for b in range(t + 1, width):
            rows[t, b] *= inverse
        for a in range(t + 1, width):
            factor = rows[t, a]
            for b in range(a, width):
                rows[a, b] -= factor * rows[t, b]
    return True


@numba.njit(cache=True, nogil=True)
def _factor(
    faces: IntArray, weights: FloatArray, order: IntArray, depth: int, children: IntArray, leaf: IntArray,
    first: IntArray, position: IntArray, starts: IntArray, others: IntArray,
    count_in: int, factor: FloatArray, stack: FloatArray, front: FloatArray,
) -> int:  # fmt: skip
    """All fronts from the leaves up: rows of U into factor, unless that is empty, and update matrices onto the stack.

    Positions from count_in on are in no front. Returns the size of the stack, which then holds the root's Schur complement
    (upper triangle), or -1 where a pivot is not positive.
    """
    n = faces.shape[0]
    place = np.zeros(position.shape[0], np.int32)
    into = np.empty(position.shape[0], np.int32)
    top, done = 0, 0
    for k in range(children.shape[0]):
        begin, end, start = first[k], first[k + 1], starts[k]
        own, rest = end - begin, starts[k + 1] - start
        width = own + rest
        rows = front[: width * width].reshape(width, width)
        rows[:, :] = 0.0
        if leaf[k] >= 0:
            for t in range(own):
                place[begin + t] = t
            for t in range(rest):
                place[others[start + t]] = own + t
            for p in range((n * leaf[k]) >> depth, (n * (leaf[k] + 1)) >> depth):
                f = order[p]
                for i in range(3):
                    p1, p2 = position[faces[f, (i + 1) % 3]], position[faces[f, (i + 2) % 3]]
                    if p1 < count_in:
                        rows[place[p1], place[p1]] += weights[f, i]
                    if p2 < count_in:
                        rows[place[p2], place[p2]] += weights[f, i]
                    if p1 < count_in and p2 < count_in:
                        a, b = place[p1], place[p2]
                        rows[min(a, b), max(a, b)] -= weights[f, i]
        else:
            for side in (1, 0):
                child = children[k, side]
                size = starts[child + 1] - starts[child]
                top -= size * size
                update = stack[top : top + size * size].reshape(size, size)
                q = 0
                for t in range(size):
                    which = others[starts[child] + t]
                    if which < end:
                        into[t] = which - begin
                    else:
                        while others[start + q] < which:
                            q += 1
                        into[t] = own + q
                for a in range(size):
                    row = into[a]
                    for b in range(a, size):
                        rows[row, into[b]] += update[a, b]
        small = width <= _SMALL_FRONT or own < _FEW_COLUMNS
        if not (_eliminate_small(front, own, width) if small else _eliminate_large(front, own, width)):
            return -1
        if factor.shape[0] > 0:
            for t in range(own):
                factor[done : done + width - t] = rows[t, t:]
                done += width - t
        update = stack[top : top + rest * rest].reshape(rest, rest)
        for a in range(rest):
            for b in range(a, rest):
                update[a, b] = rows[own + a, own + b]
        top += rest * rest
    return top


@numba.njit(cache=True, nogil=True)
def _forward(factor: FloatArray, first: IntArray, starts: IntArray, others: IntArray, x: FloatArray) -> None:
    """Solve U^T y = x in place for the eliminated positions, x (n, 2); kept positions get what is left of the load there."""
    row = 0
    for k in range(starts.shape[0] - 1):
        begin, end, start, stop = first[k], first[k + 1], starts[k], starts[k + 1]
        for t in range(begin, end):
            re, im = x[t, 0] / factor[row], x[t, 1] / factor[row]
            x[t, 0], x[t, 1] = re, im
            for b in range(t + 1, end):
                x[b, 0] -= factor[row + b - t] * re
                x[b, 1] -= factor[row + b - t] * im
            for b in range(start, stop):
                u = factor[row + end - t + b - start]
                x[others[b], 0] -= u * re
                x[others[b], 1] -= u * im
            row += end - t + stop - start


@numba.njit(cache=True, nogil=True)
def _backward(factor: FloatArray, first: IntArray, starts: IntArray, others: IntArray, x: FloatArray) -> None:
    """Solve U u = x in place for the eliminated positions, x (n, 2), kept positions given."""
    row = factor.shape[0]
    for k in range(starts.shape[0] - 2, -1, -1):
        begin, end, start, stop = first[k], first[k + 1], starts[k], starts[k + 1]
        for t in range(end - 1, begin - 1, -1):
            row -= end - t + stop - start
            re, im = x[t, 0], x[t, 1]
            for b in range(t + 1, end):
                re -= factor[row + b - t] * x[b, 0]
                im -= factor[row + b - t] * x[b, 1]
            for b in range(start, stop):
                u = factor[row + end - t + b - start]
                re -= u * x[others[b], 0]
                im -= u * x[others[b], 1]
            x[t, 0], x[t, 1] = re / factor[row], im / factor[row]


@numba.njit(cache=True, nogil=True)
def _mirrored(upper: FloatArray) -> FloatArray:
    """The symmetric matrix with this upper triangle."""
    out = np.empty_like(upper)
    for a in range(upper.shape[0]):
        for b in range(a, upper.shape[0]):
            out[a, b] = upper[a, b]
            out[b, a] = upper[a, b]
    return out


@numba.njit(cache=True, nogil=True)
def _load_of(faces: IntArray, weights: FloatArray, position: IntArray, values: FloatArray, inner: int) -> FloatArray:
    """-L_IB u_B (n_I, 2) by position, from values (n_B, 2) at kept positions, which begin at ``inner``."""
    out = np.zeros((inner, 2))
    for f in range(faces.shape[0]):
        for i in range(3):
            p, q = position[faces[f, (i + 1) % 3]], position[faces[f, (i + 2) % 3]]
            if p > q:
                p, q = q, p
            if p < inner <= q:
                out[p, 0] += weights[f, i] * values[q - inner, 0]
                out[p, 1] += weights[f, i] * values[q - inner, 1]
    return out


class _Elimination:
    """A mesh's cotangent weights eliminated along a dissection; raises SolveFailedError where that cannot be done."""

    def __init__(
        self,
        vertices: FloatArray,
        faces: IntArray,
        kept: IntArray,
        mollification: float,
        without_kept: bool,
        keeps: Callable[[int], bool] | None = None,
        order: IntArray | None = None,
    ) -> None:
        self.faces = np.ascontiguousarray(faces, np.int32)
        tree = dissect(vertices, self.faces, kept, without_kept=without_kept, order=order)
        self.order = tree.order
        if (tree.position < 0).any():
            raise SolveFailedError("the Laplacian is singular: a vertex is in no face")
        self.weights = corner_weights(vertices, self.faces, mollification)
        if not np.isfinite(self.weights).all():
            raise SolveFailedError("the Laplacian has entries that are not finite: a face has zero area")
        self.is_kept = keeps is None or keeps(8 * tree.factor_size)
        self.factor = np.empty(tree.factor_size if self.is_kept else 0)
        self.stack = np.empty(max(1, tree.stack_size))
        self.first, self.starts, self.others, self.position = tree.first, tree.starts, tree.others, tree.position
        plan = tree.order, tree.depth, tree.children, tree.leaf, tree.first, tree.position, tree.starts, tree.others
        count_in = int(tree.first[-1]) if without_kept else len(vertices)
        front = np.empty(max(1, tree.widest**2))
        if _factor(self.faces, self.weights, *plan, count_in, self.factor, self.stack, front) < 0:
            raise SolveFailedError(
                f"the elimination of a Laplacian of {len(vertices)} vertices met a pivot that is not positive"
            )


class NestedSolver:
    """Discrete harmonic functions of a mesh, given at ``kept`` (n_K,): the second pass alone, without a Schur complement.

    order (F,): the ``order`` of a factor of the same mesh, which saves time.
    """

    def __init__(
        self,
        vertices: FloatArray,
        faces: IntArray,
        kept: IntArray,
        mollification: float = 0.0,
        order: IntArray | None = None,
    ) -> None:
        e = _Elimination(vertices, faces, kept, mollification, without_kept=True, order=order)
        e.stack = np.empty(0)
        self._elimination = e
        self.nbytes = sum(a.nbytes for a in (e.factor, e.faces, e.weights, e.first, e.starts, e.others, e.position, e.order))

    def extend(self, boundary_values: ComplexArray) -> ComplexArray:
        """Discrete harmonic extension; see DirichletFactor."""
        e = self._elimination
        values = np.ascontiguousarray(boundary_values, np.complex128).view(np.float64).reshape(-1, 2)
        x = _load_of(e.faces, e.weights, e.position, values, int(e.first[-1]))
        _forward(e.factor, e.first, e.starts, e.others, x)
        _backward(e.factor, e.first, e.starts, e.others, x)
        solved = np.concatenate([x.view(np.complex128)[:, 0], boundary_values])
        out: ComplexArray = solved[e.position]
        return out

    def release(self) -> None:
        """Free the factor's memory."""
        self._elimination.factor = np.empty(0)


class NestedFactor:
    """The cotangent Laplacian of a mesh with all but the kept vertices eliminated; see DirichletFactor.

    vertices (n, 3), faces (F, 3), kept (n_K,); ``order`` (F,) is how the faces were dissected. keeps(bytes) is asked whether
    the factor is to be kept: without it there is the Schur complement and no more. Raises SolveFailedError where rounding
    leaves no positive pivot, or a vertex is in no face.
    """

    def __init__(
        self,
        vertices: FloatArray,
        faces: IntArray,
        kept: IntArray,
        mollification: float = 0.0,
        keeps: Callable[[int], bool] | None = None,
    ) -> None:
        e = _Elimination(vertices, faces, kept, mollification, without_kept=False, keeps=keeps)
        count = len(kept)
        self.order = e.order
        self.is_whole = e.is_kept
        self._factor, self._first, self._starts, self._others = e.factor, e.first, e.starts, e.others
        self._position, self._kept = e.position, np.array(kept)
        self.schur: FloatArray = _mirrored(e.stack[: count * count].reshape(count, count))
        held = (self._factor, self.schur, self._first, self._starts, self._others, self._position)
        self.nbytes = sum(array.nbytes for array in held)

    def extend(self, boundary_values: ComplexArray) -> ComplexArray:
        """Discrete harmonic extension; see DirichletFactor."""
        return self._solved(np.zeros((len(self._position), 2)), boundary_values)

    def solve(self, load: ComplexArray, boundary_values: ComplexArray) -> ComplexArray:
        """Interior values under a load; see DirichletFactor."""
        return self._solved(self._reduced(load), boundary_values)

    def reduce(self, load: ComplexArray) -> ComplexArray:
        """Load on the boundary in place of a load on the whole; see DirichletFactor."""
        left = self._reduced(load)[self._first[-1] :]
        out: ComplexArray = left[:, 0] + 1j * left[:, 1]
        return out

    def _reduced(self, load: ComplexArray) -> FloatArray:
        x = np.empty((len(load), 2))
        x[self._position, 0], x[self._position, 1] = load.real, load.imag
        _forward(self._factor, self._first, self._starts, self._others, x)
        return x

    def _solved(self, x: FloatArray, boundary_values: ComplexArray) -> ComplexArray:
        x[self._first[-1] :, 0], x[self._first[-1] :, 1] = boundary_values.real, boundary_values.imag
        _backward(self._factor, self._first, self._starts, self._others, x)
        out: ComplexArray = x.view(np.complex128)[:, 0][self._position]
        out[self._kept] = boundary_values
        return out

    def release(self) -> None:
        """Free the factor's memory."""
        self._factor = np.empty(0)
