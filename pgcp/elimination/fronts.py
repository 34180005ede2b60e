"""Elimination of fronts, dense symmetric matrices: large ones by SciPy's BLAS and LAPACK, small ones by loops over vectors.

A front's upper triangle is held by rows, one every ``stride`` numbers, from a multiple of eight numbers on and to one: what
is left of the diagonal there, and right of the last column, is of no meaning. BLAS is slow where matrices are small, and so
are compiled loops that end anywhere; these go by eight numbers, four rows and four pivots at a time.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from llvmlite import binding, ir
from numba import types
from numba.core.cgutils import for_range_slice
from numba.extending import get_cython_function_address, intrinsic

from pgcp.types import FloatArray, IntArray

_SMALL_FRONT = 192
_FEW_COLUMNS = 8
_LANES = 8

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
def padded(width: int) -> int:
    """Numbers from one row to the next of a front of this width."""
    return (width + _LANES - 1) & -_LANES


@intrinsic
def _subtract(_typing: Any, front: Any, targets: Any, pivots: Any, column: Any, begin: Any, end: Any) -> Any:
    """Of rows that begin at targets, subtract what eliminating rows that begin at pivots takes of them, columns begin to end.

    The rows of the targets, as columns, are ``column`` and those after it: row i loses sum_k front[pivots[k] + column + i] of
    row k. Columns begin and end at multiples of _LANES.
    """
    rows, ranks = targets.count, pivots.count
    long, lane = ir.IntType(64), ir.IntType(32)
    vector = ir.VectorType(ir.DoubleType(), _LANES)
    undefined, first_lane = ir.Constant(vector, ir.Undefined), ir.Constant(ir.VectorType(lane, _LANES), [0] * _LANES)
    fused = ("contract",)

    def _generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        to = [builder.extract_value(arguments[1], i) for i in range(rows)]
        of = [builder.extract_value(arguments[2], k) for k in range(ranks)]

        def _vector_at(row: Any, offset: Any) -> Any:
            return builder.bitcast(builder.gep(data, [builder.add(row, offset)]), vector.as_pointer())

        def _factor(i: int, k: int) -> Any:
            place = builder.add(of[k], builder.add(arguments[3], ir.Constant(long, i)))
            one = builder.insert_element(undefined, builder.load(builder.gep(data, [place])), ir.Constant(lane, 0))
            return builder.shuffle_vector(one, undefined, first_lane)

        factors = [[_factor(i, k) for k in range(ranks)] for i in range(rows)]
        with for_range_slice(builder, arguments[4], arguments[5], ir.Constant(long, _LANES), inc=True) as (offset, _):
            values = [builder.load(_vector_at(row, offset), align=8) for row in of]
            for i in range(rows):
                place = _vector_at(to[i], offset)
                left = builder.load(place, align=8)
                for k in range(ranks):
                    left = builder.fsub(left, builder.fmul(factors[i][k], values[k], flags=fused), flags=fused)
                builder.store(left, place, align=8)
        return context.get_dummy_value()

    return types.void(front, targets, pivots, types.int64, types.int64, types.int64), _generate


@numba.njit(cache=True, nogil=True)
def _subtract_from(front: FloatArray, stride: int, begin: int, end: int, pivots: tuple[int, ...]) -> None:
    """Of rows ``begin`` to ``end``, subtract what eliminating rows that begin at ``pivots`` takes of them."""
    row = begin
    while row + 4 <= end:
        at = row * stride
        targets = (at, at + stride, at + 2 * stride, at + 3 * stride)
        _subtract(front, targets, pivots, row, row & -_LANES, stride)
        row += 4
    while row < end:
        _subtract(front, (row * stride,), pivots, row, row & -_LANES, stride)
        row += 1


@numba.njit(cache=True, nogil=True)
def _eliminate_small(front: FloatArray, own: int, width: int, stride: int) -> bool:
    """Eliminate by loops: up to four rows of U, then all rows below them."""
    row = 0
    while row < own:
        count = min(4, own - row)
        for t in range(row, row + count):
            at = t * stride
            pivot = front[at + t]
            if not pivot > 0.0:
                return False
            root = np.sqrt(pivot)
            inverse = 1.0 / root
            for b in range(at + t + 1, at + width):
                front[b] *= inverse
            front[at + t] = root
            _subtract_from(front, stride, t + 1, row + count, (at,))
        at, row = row * stride, row + count
        if count == 4:
            _subtract_from(front, stride, row, width, (at, at + stride, at + 2 * stride, at + 3 * stride))
        elif count == 3:
            _subtract_from(front, stride, row, width, (at, at + stride, at + 2 * stride))
        elif count == 2:
            _subtract_from(front, stride, row, width, (at, at + stride))
        else:
            _subtract_from(front, stride, row, width, (at,))
    return True


@numba.njit(cache=True, nogil=True)
def _eliminate_large(front: FloatArray, own: int, width: int, stride: int) -> bool:
    """Eliminate by BLAS. The front's upper triangle by rows is, to Fortran, its lower triangle by columns."""
    lower, right = np.array([ord("L")], np.uint8), np.array([ord("R")], np.uint8)
    transposed, plain = np.array([ord("T")], np.uint8), np.array([ord("N")], np.uint8)
    columns, leading = np.array([own], np.intc), np.array([stride], np.intc)
    rest, info = np.array([width - own], np.intc), np.zeros(1, np.intc)
    one, minus_one = np.ones(1), -np.ones(1)
    _potrf(lower.ctypes, columns.ctypes, front.ctypes, leading.ctypes, info.ctypes)
    if info[0] != 0:
        return False
    if width > own:
        below, corner = front[own:], front[own * stride + own :]
        _trsm(
            right.ctypes, lower.ctypes, transposed.ctypes, plain.ctypes, rest.ctypes, columns.ctypes, one.ctypes,
            front.ctypes, leading.ctypes, below.ctypes, leading.ctypes,
        )  # fmt: skip
        _syrk(
            lower.ctypes, plain.ctypes, rest.ctypes, columns.ctypes, minus_one.ctypes, below.ctypes, leading.ctypes,
            one.ctypes, corner.ctypes, leading.ctypes,
        )  # fmt: skip
    return True


@numba.njit(cache=True, nogil=True)
def clear(front: FloatArray, width: int) -> None:
    """Make a front zero."""
    stride = padded(width)
    for t in range(width):
        front[t * stride + (t & -_LANES) : (t + 1) * stride] = 0.0


@numba.njit(cache=True, nogil=True)
def eliminate(front: FloatArray, own: int, width: int) -> bool:
    """Eliminate the first ``own`` of ``width`` rows of a front in place: U in these, the Schur complement in the others.

    False where a pivot is not positive.
    """
    if width <= _SMALL_FRONT or own < _FEW_COLUMNS:
        return _eliminate_small(front, own, width, padded(width))
    return _eliminate_large(front, own, width, padded(width))


@numba.njit(cache=True, nogil=True)
def add_update(front: FloatArray, width: int, into: IntArray, update: FloatArray, at: int, step: int, shrink: int) -> None:
    """Add a symmetric matrix to a front: its row and column a, of those of ``into``, to row and column into[a], increasing.

    update: its upper triangle by rows; the first row begins ``at``, the next ``step`` later, each of the others ``shrink``
    less.
    """
    stride = padded(width)
    size = into.shape[0]
    for a in range(size):
        row = front[into[a] * stride : (into[a] + 1) * stride]
        values, columns = update[at : at + size - a], into[a:]
        for b in range(size - a):
            row[columns[b]] += values[b]
        at += step
        step -= shrink


@numba.njit(cache=True, nogil=True)
def store_update(front: FloatArray, own: int, width: int, stack: FloatArray, top: int) -> int:
    """Copy a front's Schur complement, its upper triangle by rows without gaps, to the stack's top; returns the new one."""
    stride = padded(width)
    for a in range(own, width):
        values, place = front[a * stride + a : a * stride + width], stack[top : top + width - a]
        for b in range(width - a):
            place[b] = values[b]
        top += width - a
    return top
