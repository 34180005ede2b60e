"""Closed planar curves: where one crosses itself, found through a tree of boxes over its edges."""

from __future__ import annotations

from fractions import Fraction

import numba
import numpy as np

from pgcp.types import ComplexArray, FloatArray, IntArray

_ROUNDING = 8.0 * np.finfo(np.float64).eps
_LEAF_PAIRS = 64
MOST_CROSSINGS = 10_000


@numba.njit(cache=True)
def _boxes(x: FloatArray, y: FloatArray, leaves: int) -> FloatArray:
    """Boxes (2 leaves, 4) of a binary tree over the edges of a closed polygon: low x, high x, low y, high y; 1 is the root."""
    n = x.shape[0]
    out = np.empty((2 * leaves, 4))
    out[:, 0::2], out[:, 1::2] = np.inf, -np.inf
    for e in range(n):
        f = e + 1 if e + 1 < n else 0
        out[leaves + e, 0], out[leaves + e, 1] = min(x[e], x[f]), max(x[e], x[f])
        out[leaves + e, 2], out[leaves + e, 3] = min(y[e], y[f]), max(y[e], y[f])
    for b in range(leaves - 1, 0, -1):
        for i in range(0, 4, 2):
            out[b, i] = min(out[2 * b, i], out[2 * b + 1, i])
            out[b, i + 1] = max(out[2 * b, i + 1], out[2 * b + 1, i + 1])
    return out


@numba.njit(cache=True, inline="always")
def _side(ax: float, ay: float, bx: float, by: float, px: float, py: float) -> int:
    """1 where p is left of the line from a to b, -1 right of it, 0 where rounding may mislead."""
    one, two = (bx - ax) * (py - ay), (by - ay) * (px - ax)
    if abs(one - two) <= _ROUNDING * (abs(one) + abs(two)):
        return 0
    return 1 if one > two else -1


@numba.njit(cache=True)
def _meeting_edges(x: FloatArray, y: FloatArray, boxes: FloatArray, leaves: int, until_sure: bool, most: int) -> IntArray:
    """Pairs (n, 3) of edges that are no neighbours and cross (third column 1) or may touch (0).

    With ``until_sure`` the search ends at the first crossing, the last pair found.
    """
    n = x.shape[0]
    count, found = 0, np.empty((_LEAF_PAIRS, 3), np.int64)
    size, stack = 1, np.empty((_LEAF_PAIRS, 2), np.int64)
    stack[0, 0] = stack[0, 1] = 1
    while size:
        size -= 1
        a, b = stack[size, 0], stack[size, 1]
        if boxes[a, 0] > boxes[b, 1] or boxes[b, 0] > boxes[a, 1] or boxes[a, 2] > boxes[b, 3] or boxes[b, 2] > boxes[a, 3]:
            continue
        if a < leaves or b < leaves:
            if size + 4 > stack.shape[0]:
                larger = np.empty((2 * stack.shape[0], 2), np.int64)
                larger[:size] = stack[:size]
                stack = larger
            if a == b:
                stack[size, 0] = stack[size, 1] = 2 * a
                stack[size + 1, 0] = stack[size + 1, 1] = 2 * a + 1
                stack[size + 2, 0], stack[size + 2, 1] = 2 * a, 2 * a + 1
                size += 3
            elif a < leaves:
                stack[size, 0], stack[size, 1] = 2 * a, b
                stack[size + 1, 0], stack[size + 1, 1] = 2 * a + 1, b
                size += 2
            else:
                stack[size, 0], stack[size, 1] = a, 2 * b
                stack[size + 1, 0], stack[size + 1, 1] = a, 2 * b + 1
                size += 2
            continue
        i, j = a - leaves, b - leaves
        if i == j or j >= n or i >= n or (i + 1) % n == j or (j + 1) % n == i:
            continue
        k, m = (i + 1) % n, (j + 1) % n
        one, two = _side(x[i], y[i], x[k], y[k], x[j], y[j]), _side(x[i], y[i], x[k], y[k], x[m], y[m])
        three, four = _side(x[j], y[j], x[m], y[m], x[i], y[i]), _side(x[j], y[j], x[m], y[m], x[k], y[k])
        if one * two > 0 or three * four > 0:
            continue
        sure = one * two < 0 and three * four < 0
        if count == found.shape[0]:
            more = np.empty((2 * count, 3), np.int64)
            more[:count] = found
            found = more
        found[count, 0], found[count, 1], found[count, 2] = min(i, j), max(i, j), 1 if sure else 0
        count += 1
        if (until_sure and sure) or count == most:
            break
    return found[:count]


def _search(z: ComplexArray, until_sure: bool) -> IntArray:
    x, y = np.ascontiguousarray(z.real), np.ascontiguousarray(z.imag)
    leaves = 1 << max(1, int(len(z) - 1).bit_length())
    return _meeting_edges(x, y, _boxes(x, y, leaves), leaves, until_sure, MOST_CROSSINGS)


def _exact_side(a: complex, b: complex, p: complex) -> int:
    ax, ay, bx, by, px, py = (Fraction(v) for w in (a, b, p) for v in (w.real, w.imag))
    area = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
    return (area > 0) - (area < 0)


def _within(a: complex, b: complex, p: complex) -> bool:
    """Whether p, on the line through a and b, lies between them."""
    return min(a.real, b.real) <= p.real <= max(a.real, b.real) and min(a.imag, b.imag) <= p.imag <= max(a.imag, b.imag)


def _meet(a: complex, b: complex, c: complex, d: complex) -> bool:
    """Whether the segments ab and cd have a point in common, decided exactly."""
    one, two, three, four = _exact_side(a, b, c), _exact_side(a, b, d), _exact_side(c, d, a), _exact_side(c, d, b)
    if one * two < 0 and three * four < 0:
        return True
    return any(
        side == 0 and _within(*line, p)
        for side, line, p in ((one, (a, b), c), (two, (a, b), d), (three, (c, d), a), (four, (c, d), b))
    )


def _edges_meet(z: ComplexArray, i: int, j: int) -> bool:
    after = z[(i + 1) % len(z)], z[(j + 1) % len(z)]
    return _meet(complex(z[i]), complex(after[0]), complex(z[j]), complex(after[1]))


def crosses_itself(z: ComplexArray) -> bool:
    """Whether the closed polygon z (n,) has two edges, no neighbours, that cross or touch; decided exactly."""
    found = _search(z, True) if len(z) > 3 else np.empty((0, 3), np.int64)
    if len(found) and found[-1, 2]:
        return True
    return any(_edges_meet(z, i, j) for i, j, _ in found.tolist())


def crossings(z: ComplexArray) -> IntArray:
    """Pairs (n, 2) of edges, by the number of their first point, at which the closed polygon z (B,) meets itself.

    Edges that are no neighbours and cross or touch, and neighbours that fold back on each other. A fold-free map of a
    disk is injective exactly where its boundary curve has none. Decided exactly where rounding could mislead; the search
    takes O(B log B) for a curve that keeps clear of itself, and ends after 10,000 pairs.
    """
    n = len(z)
    found = _search(z, False) if n > 3 else np.empty((0, 3), np.int64)
    pairs = [(i, j) for i, j, sure in found.tolist() if sure or _edges_meet(z, i, j)]
    step = np.roll(z, -1) - z
    turn = step * np.conj(np.roll(step, 1))
    back = np.flatnonzero((turn.real < 0) & (np.abs(turn.imag) <= _ROUNDING * np.abs(turn.real)))
    pairs += [
        (int(i) - 1 if i else n - 1, int(i))
        for i in back
        if _exact_side(complex(z[i - 1]), complex(z[i]), complex(z[(i + 1) % n])) == 0
    ]
    return np.array(sorted(pairs), np.int64).reshape(-1, 2)
