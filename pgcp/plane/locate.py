"""Where points of a map lie: the face of each and the weights of its corners, found in a tree of boxes around faces."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numba
import numpy as np

from pgcp.parallel import in_slices
from pgcp.types import BoolArray, FloatArray, IntArray

_LEAF = 4
_DEEP = 128  # of the stack of nodes: two a level
_SLACK = 1e-12  # of a point on an edge, whose weights are rounded


class Places(NamedTuple):
    """Places on a surface: faces (N,), weights (N, 3) of their corners, points (N, 3), and which (N,) lie in a face's image."""

    faces: IntArray
    weights: FloatArray
    points: FloatArray
    inside: BoolArray


@numba.njit(cache=True, nogil=True)
def _morton(centres: FloatArray, low: FloatArray, per_unit: float, bits: int) -> np.ndarray:
    """Morton codes (n,): the bits of the coordinates in turn, so that neighbours in order are neighbours in space."""
    out = np.empty(centres.shape[0], np.uint64)
    most = (1 << bits) - 1
    for k in range(centres.shape[0]):
        code = np.uint64(0)
        for d in range(centres.shape[1]):
            x = np.uint64(min(max(int((centres[k, d] - low[d]) * per_unit * most), 0), most))
            for b in range(bits):
                code |= ((x >> np.uint64(b)) & np.uint64(1)) << np.uint64(b * centres.shape[1] + d)
        out[k] = code
    return out


@numba.njit(cache=True, nogil=True)
def _boxes(corners: FloatArray, leaves: int, on_sphere: bool) -> FloatArray:
    """Boxes (2 * leaves - 1, 2, d) of a complete binary tree, children of node k at 2 k + 1 and 2 k + 2, leaves last.

    corners (F, 3, d), leaf by leaf. On the sphere a box holds the spherical triangle, which stands above the flat one by no
    more than the plane of that is below the sphere.
    """
    boxes = np.empty((2 * leaves - 1, 2, corners.shape[2]))
    boxes[:, 0, :], boxes[:, 1, :] = np.inf, -np.inf
    for k in range(corners.shape[0]):
        node, room = leaves - 1 + k // _LEAF, 0.0
        if on_sphere:
            a, b, c = corners[k, 0], corners[k, 1], corners[k, 2]
            ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
            vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            height = abs(nx * a[0] + ny * a[1] + nz * a[2]) / length if length > 0.0 else 1.0
            room = max(1.0 - height, 0.0) + 1e-15
        for i in range(3):
            for d in range(corners.shape[2]):
                x = corners[k, i, d]
                boxes[node, 0, d] = min(boxes[node, 0, d], x - room)
                boxes[node, 1, d] = max(boxes[node, 1, d], x + room)
    for node in range(leaves - 2, -1, -1):
        for d in range(corners.shape[2]):
            boxes[node, 0, d] = min(boxes[2 * node + 1, 0, d], boxes[2 * node + 2, 0, d])
            boxes[node, 1, d] = max(boxes[2 * node + 1, 1, d], boxes[2 * node + 2, 1, d])
    return boxes


@numba.njit(cache=True, inline="always")
def _planar_weights(p: FloatArray, corners: FloatArray) -> tuple[float, float, float]:
    """Barycentric weights of a point in a face of corners (3, 2), -1 where the face has no positive area."""
    px, py = p[0], p[1]
    ax, ay, bx, by, cx, cy = corners[0, 0], corners[0, 1], corners[1, 0], corners[1, 1], corners[2, 0], corners[2, 1]
    u = (bx - px) * (cy - py) - (by - py) * (cx - px)
    v = (cx - px) * (ay - py) - (cy - py) * (ax - px)
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if not area > 0.0:
        return -1.0, -1.0, -1.0
    return u / area, v / area, 1.0 - u / area - v / area


@numba.njit(cache=True, nogil=True)
def _triple(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    """Determinant of three points, from differences: that of a small face is less than what its corners are rounded to."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    return a[0] * (uy * vz - uz * vy) + a[1] * (uz * vx - ux * vz) + a[2] * (ux * vy - uy * vx)


@numba.njit(cache=True, nogil=True)
def _spherical_weights(p: FloatArray, corners: FloatArray) -> tuple[float, float, float]:
    """Weights of the point of a flat face (3, 3) below p, -1 where it does not look outwards or p is on the other side."""
    a, b, c = corners[0], corners[1], corners[2]
    u, v, w = _triple(p, b, c), _triple(p, c, a), _triple(p, a, b)
    total = u + v + w
    if not total > 0.0 or not _triple(a, b, c) > 0.0:
        return -1.0, -1.0, -1.0
    return u / total, v / total, w / total


@numba.njit(cache=True, nogil=True)
def _beyond(p: FloatArray, box: FloatArray) -> float:
    """Square of the distance of a point from a box."""
    total = 0.0
    for d in range(p.shape[0]):
        x = max(box[0, d] - p[d], p[d] - box[1, d], 0.0)
        total += x * x
    return total


@numba.njit(cache=True, nogil=True)
def _on_edge(p: FloatArray, a: FloatArray, b: FloatArray) -> tuple[float, float]:
    """Square of the distance of a point from an edge, and the weight of the edge's end at the nearest place."""
    along = square = 0.0
    for d in range(p.shape[0]):
        along += (p[d] - a[d]) * (b[d] - a[d])
        square += (b[d] - a[d]) ** 2
    t = min(max(along / square, 0.0), 1.0) if square > 0.0 else 0.0
    total = 0.0
    for d in range(p.shape[0]):
        total += (a[d] + t * (b[d] - a[d]) - p[d]) ** 2
    return total, t


@numba.njit(cache=True, nogil=True)
def _nearest(p: FloatArray, corners: FloatArray, order: IntArray, boxes: FloatArray, stack: IntArray, out: FloatArray) -> int:
    """The face whose edges come nearest to a point; its weights go to ``out`` (3,)."""
    leaves, best, found, top = (boxes.shape[0] + 1) // 2, np.inf, -1, 1
    stack[0] = 0
    while top > 0:
        top -= 1
        node = stack[top]
        if _beyond(p, boxes[node]) >= best:
            continue
        if node < leaves - 1:
            one, two = 2 * node + 1, 2 * node + 2
            if _beyond(p, boxes[one]) < _beyond(p, boxes[two]):
                one, two = two, one
            stack[top], stack[top + 1] = one, two
            top += 2
            continue
        begin = (node - leaves + 1) * _LEAF
        for k in range(begin, min(begin + _LEAF, order.shape[0])):
            for i in range(3):
                square, t = _on_edge(p, corners[k, i], corners[k, (i + 1) % 3])
                if square < best:
                    best, found = square, order[k]
                    out[:] = 0.0
                    out[i], out[(i + 1) % 3] = 1.0 - t, t
    return found


@numba.njit(cache=True, nogil=True)
def _find(
    wanted: FloatArray,
    corners: FloatArray,
    order: IntArray,
    boxes: FloatArray,
    on_sphere: bool,
    turn: IntArray,
    found: IntArray,
    weights: FloatArray,
    inside: BoolArray,
    begin: int,
    end: int,
) -> None:
    """Fill found (N,), weights (N, 3) and inside (N,) for the points ``turn[begin:end]`` of wanted (N, 2) or (N, 3)."""
    leaves, stack = (boxes.shape[0] + 1) // 2, np.empty(_DEEP, np.int64)
    for k in range(begin, end):
        p = wanted[turn[k]]
        best, face, u, v, w, top = -np.inf, -1, 0.0, 0.0, 0.0, 1
        stack[0] = 0
        while top > 0 and best < 0.0:
            top -= 1
            node = stack[top]
            if _beyond(p, boxes[node]) > 0.0:
                continue
            if node < leaves - 1:
                stack[top], stack[top + 1] = 2 * node + 2, 2 * node + 1
                top += 2
                continue
            first = (node - leaves + 1) * _LEAF
            for m in range(first, min(first + _LEAF, order.shape[0])):
                x, y, z = _spherical_weights(p, corners[m]) if on_sphere else _planar_weights(p, corners[m])
                if min(x, y, z) > best:
                    best, face, u, v, w = min(x, y, z), order[m], x, y, z
        i = turn[k]
        inside[i] = best >= -_SLACK
        if inside[i]:
            u, v, w = max(u, 0.0), max(v, 0.0), max(w, 0.0)
            found[i] = face
            weights[i, 0], weights[i, 1], weights[i, 2] = u / (u + v + w), v / (u + v + w), w / (u + v + w)
        else:
            found[i] = _nearest(p, corners, order, boxes, stack, weights[i])


class Locator:
    """Finds faces of a map: image (V, 2), or unit vectors (V, 3) ``on_sphere``, faces (F, 3).

    The tree is made once, in the order of a Morton curve through the middles of faces.
    """

    def __init__(self, image: FloatArray, faces: IntArray, on_sphere: bool) -> None:
        self._faces, self._on_sphere = faces, on_sphere
        corners = np.asarray(image, np.float64)[faces]
        middles = corners.mean(axis=1)
        self._low = middles.min(axis=0)
        self._per_unit = 1.0 / max(float(np.ptp(middles, axis=0).max()), 1e-300)
        self._order = np.argsort(self._codes(middles), kind="stable").astype(np.int64)
        self._corners = corners[self._order]
        leaves = 1 << max(int(np.ceil(np.log2(-(-len(faces) // _LEAF)))), 0)
        self._boxes = _boxes(self._corners, leaves, on_sphere)

    def _codes(self, points: FloatArray) -> np.ndarray:
        return _morton(points, self._low, self._per_unit, min(62 // points.shape[1], 31))

    def find(self, wanted: FloatArray, vertices: FloatArray) -> Places:
        """Places on the surface ``vertices`` (V, 3) of points (N, 2), or (N, 3) of length 1, of the map.

        Where several faces lie over a point, one of them. A point outside the image, or within faces without positive area,
        is taken to the nearest place on an edge.
        """
        wanted = np.ascontiguousarray(wanted, np.float64)
        count = len(wanted)
        found, weights, inside = np.zeros(count, np.int64), np.zeros((count, 3)), np.zeros(count, bool)
        turn = np.argsort(self._codes(wanted), kind="stable")  # neighbours one after the other find their nodes in the cache
        tree = self._corners, self._order, self._boxes, self._on_sphere
        in_slices(partial(_find, wanted, *tree, turn, found, weights, inside), count)
        points = np.einsum("nk,nkd->nd", weights, vertices[self._faces[found]])
        return Places(found, weights, points, inside)
