"""Nested dissection of a patch by its faces: which vertices are eliminated together, and in which order.

The faces are halved again and again by their centroids, down to leaves of a few faces: large halves in the direction, of
some, in which the fewest faces lie on the cut, small ones across their longest axis. The halves form a complete binary
tree, numbered children first. A vertex is eliminated at the lowest node that holds all of
its faces: by then everything that it is joined to is known (George 1973). Vertices to be kept are in no node.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from pgcp.types import FloatArray, IntArray

_LEAF_FACES = 64
_SAMPLE = 100  # faces by which a long axis is found
_POWER_STEPS = 12
_CUT_SAMPLE = 500  # and a short cut
_CUT_LEVELS = 7  # which most of the arithmetic is on
_CUT_BAND = 0.15  # faces near a cut, in standard deviations
_SLANT = np.sqrt(0.5)
# directions of cuts along the principal axes, the longest first
_CUTS = np.array(
    [(np.cos(k * np.pi / 8), np.sin(k * np.pi / 8), 0.0) for k in range(8)]
    + [(_SLANT, 0.0, _SLANT), (_SLANT, 0.0, -_SLANT), (0.0, _SLANT, _SLANT), (0.0, _SLANT, -_SLANT), (0.0, 0.0, 1.0)]
)


class EliminationTree(NamedTuple):
    """What is eliminated where. Positions are ranks in the order of elimination, kept vertices last.

    order (F,): faces, leaf by leaf; depth of the tree; children (N, 2) of each node, -1 at leaves; leaf (N,) number of a
    leaf, -1 elsewhere; first (N + 1,): node k eliminates positions first[k] to first[k + 1]; position (n,) of each vertex;
    starts (N + 1,) into others: the sorted later positions that each node's faces touch; sizes of the factor, of the
    largest stack of left children's update matrices and the root's, upper triangles, and of the largest front, in numbers and
    rows.
    """

    order: IntArray
    depth: int
    children: IntArray
    leaf: IntArray
    first: IntArray
    position: IntArray
    starts: IntArray
    others: IntArray
    factor_size: int
    stack_size: int
    widest: int


@numba.njit(cache=True, nogil=True)
def _halve(key: FloatArray, items: IntArray, points: FloatArray, low: int, high: int, middle: int) -> None:
    """Reorder keys, items and points in [low, high) so that none before ``middle`` has a larger key than one from it on."""
    last = high - 1
    while low < last:
        a, b, c = key[low], key[(low + last) // 2], key[last]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = low, last
        while i <= j:
            while key[i] < pivot:
                i += 1
            while key[j] > pivot:
                j -= 1
            if i <= j:
                key[i], key[j] = key[j], key[i]
                items[i], items[j] = items[j], items[i]
                for d in range(3):
                    points[i, d], points[j, d] = points[j, d], points[i, d]
                i += 1
                j -= 1
        if middle <= j:
            last = j
        elif middle >= i:
            low = i
        else:
            return


@numba.njit(cache=True, nogil=True)
def _long_axis(points: FloatArray, low: int, high: int) -> FloatArray:
    """Direction (3,) in which an even sample of the points spreads most."""
    stride = max(1, (high - low) // _SAMPLE)
    mean = np.zeros(3)
    count = 0
    for i in range(low, high, stride):
        count += 1
        for d in range(3):
            mean[d] += points[i, d]
    mean /= count
    spread = np.zeros((3, 3))
    for i in range(low, high, stride):
        for d in range(3):
            for e in range(3):
                spread[d, e] += (points[i, d] - mean[d]) * (points[i, e] - mean[e])
    axis = np.array([1.0, 0.9, 0.8])
    for _ in range(_POWER_STEPS):
        turned = np.zeros(3)
        for d in range(3):
            for e in range(3):
                turned[d] += spread[d, e] * axis[e]
        size = np.sqrt((turned**2).sum())
        if size == 0.0:
            break
        axis = turned / size
    return axis


@numba.njit(cache=True, nogil=True)
def _short_cut(vertices: FloatArray, faces: IntArray, items: IntArray, low: int, high: int) -> FloatArray:
    """Direction (3,), of some, in which the fewest faces lie across the plane that halves them, by an even sample.

    Their number is that of all faces by the width of a band about the plane and the mean width of the faces in it.
    """
    stride = max(1, (high - low) // _CUT_SAMPLE)
    count = (high - low + stride - 1) // stride
    centre, one, two = np.empty((3, count)), np.empty((3, count)), np.empty((3, count))
    for k in range(count):
        f = items[low + k * stride]
        for d in range(3):
            a, b, c = vertices[faces[f, 0], d], vertices[faces[f, 1], d], vertices[faces[f, 2], d]
            centre[d, k], one[d, k], two[d, k] = a + b + c, b - a, c - a
    for d in range(3):
        centre[d] -= centre[d].mean()
    spread = np.zeros((3, 3))
    for d in range(3):
        for e in range(3):
            spread[d, e] = (centre[d] * centre[e]).sum()
    axes = np.linalg.eigh(spread)[1]
    key, width = np.empty(count), np.empty(count)
    moved, items_moved, points_moved = np.empty(count, np.float32), np.zeros(count, np.int32), np.zeros((count, 3), np.float32)
    best, fewest = axes[:, 2].copy(), np.inf
    for c in range(_CUTS.shape[0]):
        axis = _CUTS[c, 0] * axes[:, 2] + _CUTS[c, 1] * axes[:, 1] + _CUTS[c, 2] * axes[:, 0]
        x, y, z = axis[0], axis[1], axis[2]
        square = 0.0
        for k in range(count):
            key[k] = x * centre[0, k] + y * centre[1, k] + z * centre[2, k]
            square += key[k] * key[k]
            p = x * one[0, k] + y * one[1, k] + z * one[2, k]
            q = x * two[0, k] + y * two[1, k] + z * two[2, k]
            width[k] = max(0.0, p, q) - min(0.0, p, q)
        moved[:] = key
        _halve(moved, items_moved, points_moved, 0, count, count // 2)
        middle, reach = moved[count // 2], _CUT_BAND * np.sqrt(square / count)
        across = 0.0
        for k in range(count):
            across += width[k] if abs(key[k] - middle) < reach else 0.0
        if across < fewest * reach:
            best, fewest = axis, across / reach
    return best


@numba.njit(cache=True, nogil=True)
def _depth(face_count: int, leaf_faces: int) -> int:
    depth = 0
    while (face_count >> depth) > leaf_faces:
        depth += 1
    return depth


@numba.njit(cache=True, nogil=True)
def halved_faces(vertices: FloatArray, faces: IntArray, depth: int) -> IntArray:
    """Faces (F,) in an order in which node j of level l, down to ``depth``, holds those from F j / 2^l to F (j + 1) / 2^l."""
    n = faces.shape[0]
    centre = np.empty((n, 3), np.float32)
    for f in range(n):
        for d in range(3):
            origin = vertices[faces[0, 0], d]
            centre[f, d] = (
                (vertices[faces[f, 0], d] - origin) + (vertices[faces[f, 1], d] - origin) + (vertices[faces[f, 2], d] - origin)
            )
    order = np.arange(n).astype(np.int32)
    key = np.empty(n, np.float32)
    for level in range(depth):
        for j in range(1 << level):
            low, high = (n * j) >> level, (n * (j + 1)) >> level
            if level < _CUT_LEVELS and high - low > _CUT_SAMPLE:
                axis = _short_cut(vertices, faces, order, low, high)
            else:
                axis = _long_axis(centre, low, high)
            x, y, z = np.float32(axis[0]), np.float32(axis[1]), np.float32(axis[2])
            for i in range(low, high):
                key[i] = x * centre[i, 0] + y * centre[i, 1] + z * centre[i, 2]
            _halve(key, order, centre, low, high, (n * (2 * j + 1)) >> (level + 1))
    return order


@numba.njit(cache=True, nogil=True)
def _numbered(depth: int) -> tuple[IntArray, IntArray, IntArray]:
    """Nodes of a complete binary tree, children before parents: number of each heap place, children, leaf of each number."""
    leaves = 1 << depth
    count = 2 * leaves - 1
    number = np.empty(count, np.int32)
    children = np.full((count, 2), -1, np.int32)
    leaf = np.full(count, -1, np.int32)
    number[0] = count - 1
    level = 0
    for place in range(count):
        if place + 1 >= 2 << level:
            level += 1
        own = number[place]
        if level == depth:
            leaf[own] = place - (leaves - 1)
            continue
        right = own - 1
        left = right - ((1 << (depth - level)) - 1)
        number[2 * place + 1], number[2 * place + 2] = left, right
        children[own, 0], children[own, 1] = left, right
    return number, children, leaf


@numba.njit(cache=True, nogil=True)
def _positions(
    faces: IntArray, order: IntArray, depth: int, number: IntArray, vertex_count: int, kept: IntArray
) -> tuple[IntArray, IntArray]:
    """Where each node's eliminated vertices begin (N + 1,), and every vertex's position (n,), -1 where no face uses it."""
    n, leaves = faces.shape[0], 1 << depth
    low = np.full(vertex_count, -1, np.int32)
    high = np.full(vertex_count, -1, np.int32)
    for leaf in range(leaves):
        for p in range((n * leaf) >> depth, (n * (leaf + 1)) >> depth):
            for i in range(3):
                v = faces[order[p], i]
                if low[v] < 0:
                    low[v] = leaf
                high[v] = leaf
    for v in kept:
        low[v] = -1
    count = 2 * leaves - 1
    node = np.full(vertex_count, -1, np.int32)
    first = np.zeros(count + 1, np.int64)
    for v in range(vertex_count):
        if low[v] >= 0:
            a, b, level = low[v], high[v], depth
            while a != b:
                a, b, level = a >> 1, b >> 1, level - 1
            node[v] = number[(1 << level) - 1 + a]
            first[node[v] + 1] += 1
    for k in range(count):
        first[k + 1] += first[k]
    fill = first.copy()
    position = np.full(vertex_count, -1, np.int32)
    for v in range(vertex_count):
        if node[v] >= 0:
            position[v] = fill[node[v]]
            fill[node[v]] += 1
    for i in range(kept.shape[0]):
        position[kept[i]] = first[count] + i
    return first, position


@numba.njit(cache=True, nogil=True)
def _with_room(array: IntArray, used: int, more: int) -> IntArray:
    if used + more <= array.shape[0]:
        return array
    out = np.empty(2 * array.shape[0] + more, array.dtype)
    out[:used] = array[:used]
    return out


@numba.njit(cache=True, nogil=True)
def _later_positions(
    faces: IntArray,
    order: IntArray,
    depth: int,
    children: IntArray,
    leaf: IntArray,
    first: IntArray,
    position: IntArray,
    count_in: int,
) -> tuple[IntArray, IntArray]:
    """For every node the sorted positions from first[k + 1] to count_in that its faces touch: starts (N + 1,), positions."""
    n, count = faces.shape[0], children.shape[0]
    starts = np.zeros(count + 1, np.int64)
    others = np.empty(4 * position.shape[0] + 1024, np.int32)
    seen = np.full(position.shape[0], -1, np.int32)
    total = 0
    for k in range(count):
        end = first[k + 1]
        if leaf[k] >= 0:
            low, high = (n * leaf[k]) >> depth, (n * (leaf[k] + 1)) >> depth
            others = _with_room(others, total, 3 * (high - low))
            for p in range(low, high):
                for i in range(3):
                    v = faces[order[p], i]
                    if end <= position[v] < count_in and seen[v] != k:
                        seen[v] = k
                        others[total] = position[v]
                        total += 1
            others[starts[k] : total].sort()
        else:
            a, a_end = starts[children[k, 0]], starts[children[k, 0] + 1]
            b, b_end = starts[children[k, 1]], starts[children[k, 1] + 1]
            others = _with_room(others, total, a_end - a + b_end - b)
            while a < a_end or b < b_end:
                if b >= b_end or (a < a_end and others[a] <= others[b]):
                    lowest = others[a]
                    if b < b_end and others[b] == lowest:
                        b += 1
                    a += 1
                else:
                    lowest = others[b]
                    b += 1
                if lowest >= end:
                    others[total] = lowest
                    total += 1
        starts[k + 1] = total
    return starts, others[:total].copy()


@numba.njit(cache=True)
def _sizes(children: IntArray, first: IntArray, starts: IntArray) -> tuple[int, int, int]:
    """Numbers in the factor and in the largest stack of left children's updates, and rows of the largest front."""
    factor, stack, most, widest = 0, 0, 0, 0
    for k in range(children.shape[0]):
        own, rest = first[k + 1] - first[k], starts[k + 1] - starts[k]
        factor += own * (own + 1) // 2 + own * rest
        left = children[k, 0]
        if left >= 0:
            size = starts[left + 1] - starts[left]
            stack -= size * (size + 1) // 2
        if k + 1 == children.shape[0] or children[k + 1, 1] != k:
            stack += rest * (rest + 1) // 2
        most, widest = max(most, stack), max(widest, own + rest)
    return factor, most, widest


def dissect(
    vertices: FloatArray,
    faces: IntArray,
    kept: IntArray,
    leaf_faces: int = _LEAF_FACES,
    without_kept: bool = False,
    order: IntArray | None = None,
) -> EliminationTree:
    """Plan the elimination of all vertices but ``kept`` (n_K,) of a mesh, vertices (n, 3), faces (F, 3).

    Kept vertices come last, in the order given; or are left out of all fronts, where only values at them will be given. order
    (F,): that of an earlier dissection of the same faces, which saves most of the time.
    """
    depth = _depth(len(faces), leaf_faces)
    if order is None:
        order = halved_faces(vertices, faces, depth)
    number, children, leaf = _numbered(depth)
    first, position = _positions(faces, order, depth, number, len(vertices), np.asarray(kept, np.int64))
    starts, others = _later_positions(
        faces, order, depth, children, leaf, first, position, int(first[-1]) if without_kept else len(vertices)
    )
    return EliminationTree(order, depth, children, leaf, first, position, starts, others, *_sizes(children, first, starts))
