"""Fill holes of a surface with triangles, without new vertices (Barequet, Sharir 1995; Liepa 2003)."""

from __future__ import annotations

import numba
import numpy as np

from pgcp.surface import plain
from pgcp.surface.operators import looked_at_areas
from pgcp.types import BoolArray, FloatArray, IntArray

_LARGEST = 0.1
_TINY = 0.01
_MOST_EDGES = 5000
_MOST_OPTIMAL = 300
_NEEDLE = 1e-6
_ROUND = 0.01


def hole_shares(points: FloatArray, faces: IntArray, loops: tuple[IntArray, ...]) -> FloatArray:
    """Size of every loop (N,): the area of a flat disk with its length, over the surface's area."""
    lengths = np.array([np.linalg.norm(points[np.roll(loop, -1)] - points[loop], axis=1).sum() for loop in loops])
    area = float(looked_at_areas(points, faces).sum())
    return lengths**2 / (4.0 * np.pi * max(area, 1e-300))


def chosen_holes(shares: FloatArray, closed: bool | None) -> IntArray:
    """Which loops (by number) are to be filled: all for a ``closed`` surface, all but the longest for an open one.

    None is a closed one where there are several loops and none has more than a hundredth of the surface's area.
    """
    if closed is None:
        closed = len(shares) > 1 and bool(shares.max() <= _TINY)
    numbers = np.arange(len(shares))
    return numbers if closed else np.delete(numbers, np.argmax(shares))


def is_too_large(share: float, edge_count: int) -> str:
    """Why a loop is not filled; empty where it is."""
    if edge_count > _MOST_EDGES:
        return f"it has more than {_MOST_EDGES} edges"
    if share > _LARGEST:
        size, limit = 100.0 * share, 100.0 * _LARGEST
        return f"a flat disk of its length would have {size:.0f} % of the surface's area, more than {limit:.0f} %"
    return ""


@numba.njit(cache=True)
def _weight(p: FloatArray, i: int, j: int, k: int) -> float:
    """Cost of a triangle: its area, a little for its edges so that equal areas prefer round ones, much for a needle."""
    ux, uy, uz = p[j, 0] - p[i, 0], p[j, 1] - p[i, 1], p[j, 2] - p[i, 2]
    vx, vy, vz = p[k, 0] - p[i, 0], p[k, 1] - p[i, 1], p[k, 2] - p[i, 2]
    wx, wy, wz = p[k, 0] - p[j, 0], p[k, 1] - p[j, 1], p[k, 2] - p[j, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area = 0.5 * np.sqrt(nx * nx + ny * ny + nz * nz)
    uu, vv, ww = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz
    needle = area <= _NEEDLE * max(uu, vv, ww)
    return area + _ROUND * (uu + vv + ww) + (1.0 * p.shape[0] if needle else 0.0)


@numba.njit(cache=True)
def _optimal(p: FloatArray, taken: BoolArray) -> IntArray:
    """Best corner (n, n) of the triangle on chord i, j, i < j, -1 for none; chords that are ``taken`` (n, n) are not used."""
    n = p.shape[0]
    cost = np.full((n, n), np.inf)
    best = np.full((n, n), -1, np.int64)
    for i in range(n - 1):
        cost[i, i + 1] = 0.0
    for span in range(2, n):
        for i in range(n - span):
            j = i + span
            if span < n - 1 and taken[i, j]:
                continue
            for m in range(i + 1, j):
                inside = cost[i, m] + cost[m, j]
                if inside < cost[i, j]:
                    total = inside + _weight(p, i, m, j)
                    if total < cost[i, j]:
                        cost[i, j], best[i, j] = total, m
    return best


def _plain_weights(p: FloatArray, i: IntArray, j: IntArray, k: IntArray) -> FloatArray:
    """Costs of triangles as ``_weight`` has them."""
    u, v, w = (p[j] - p[i]).T, (p[k] - p[i]).T, (p[k] - p[j]).T
    x, y, z = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
    area = 0.5 * np.sqrt(x * x + y * y + z * z)
    squares = [e[0] * e[0] + e[1] * e[1] + e[2] * e[2] for e in (u, v, w)]
    needle = area <= _NEEDLE * np.maximum(np.maximum(squares[0], squares[1]), squares[2])
    total: FloatArray = area + _ROUND * (squares[0] + squares[1] + squares[2]) + np.where(needle, 1.0 * len(p), 0.0)
    return total


def _plain_optimal(p: FloatArray, taken: BoolArray) -> IntArray:
    """What ``_optimal`` returns, all chords of one span at a time: nothing has to be compiled."""
    n = len(p)
    cost, best = np.full((n, n), np.inf), np.full((n, n), -1, np.int64)
    cost[np.arange(n - 1), np.arange(1, n)] = 0.0
    for span in range(2, n):
        i = np.arange(n - span)
        j, m = i + span, i[:, None] + np.arange(1, span)
        ends = [np.broadcast_to(end[:, None], m.shape).reshape(-1) for end in (i, j)]
        total = cost[i[:, None], m] + cost[m, j[:, None]] + _plain_weights(p, ends[0], m.reshape(-1), ends[1]).reshape(m.shape)
        least = np.argmin(total, axis=1)
        value = total[i, least]
        good = np.isfinite(value) & ~(taken[i, j] & (span < n - 1))
        cost[i[good], j[good]], best[i[good], j[good]] = value[good], m[i, least][good]
    return best


@numba.njit(cache=True)
def _clip_ears(p: FloatArray, taken: BoolArray, most: int) -> tuple[IntArray, IntArray]:
    """Cut off the cheapest ear again and again until ``most`` corners are left; triangles (m, 3) and the corners left.

    Stops early where every ear would need a chord that is taken.
    """
    n = p.shape[0]
    before, after = np.arange(n) - 1, np.arange(n) + 1
    before[0], after[n - 1] = n - 1, 0
    weight = np.full(n, np.inf)
    alive = np.ones(n, np.bool_)
    for i in range(n):
        if not taken[before[i], after[i]]:
            weight[i] = _weight(p, before[i], i, after[i])
    triangles = np.empty((n - most, 3), np.int64)
    count = 0
    while count < n - most:
        ear = int(np.argmin(weight))
        if weight[ear] == np.inf:
            break
        a, b = before[ear], after[ear]
        triangles[count] = (a, ear, b)
        count += 1
        alive[ear], weight[ear] = False, np.inf
        after[a], before[b] = b, a
        for i in (a, b):
            weight[i] = np.inf if taken[before[i], after[i]] else _weight(p, before[i], i, after[i])
    return triangles[:count], np.flatnonzero(alive)


def triangulate_loop(points: FloatArray, taken: BoolArray) -> IntArray | None:
    """Triangles (n - 2, 3) that fill a loop of points (n, 3), along it; None where no choice of chords avoids ``taken``.

    taken (n, n): pairs of points that an edge joins already. The least total cost by dynamic programming; of loops of
    more than 300 points the cheapest ears are cut off first.
    """
    length = float(np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1).sum())
    scaled = (points - points[0]) / (length if length > 0.0 else 1.0)
    ears, left = np.empty((0, 3), np.int64), np.arange(len(points))
    if len(points) > _MOST_OPTIMAL:
        ears, left = _clip_ears(scaled, taken, _MOST_OPTIMAL)
        if len(left) > _MOST_OPTIMAL:
            return None
    best = (_plain_optimal if plain.is_few(left, _optimal) else _optimal)(scaled[left], taken[np.ix_(left, left)])
    triangles, stack = [], [(0, len(left) - 1)]
    while stack:
        i, j = stack.pop()
        if j - i < 2:
            continue
        m = int(best[i, j])
        if m < 0:
            return None
        triangles.append((i, m, j))
        stack += [(i, m), (m, j)]
    return np.concatenate([ears, left[np.array(triangles, np.int64)]])


def _chords(faces: IntArray, loops: list[IntArray], vertex_count: int) -> tuple[list[BoolArray], BoolArray]:
    """For every loop, which pairs of its vertices (n, n) an edge of the mesh joins, other than neighbours on it.

    And which loops are those of a single face.
    """
    loop_of, place = np.full(vertex_count, -1, np.int64), np.zeros(vertex_count, np.int64)
    for number, loop in enumerate(loops):
        loop_of[loop], place[loop] = number, np.arange(len(loop))
    tails, heads = faces.reshape(-1), faces[:, [1, 2, 0]].reshape(-1)
    within = np.flatnonzero((loop_of[tails] >= 0) & (loop_of[tails] == loop_of[heads]))
    within = within[np.argsort(loop_of[tails[within]], kind="stable")]
    ends = np.searchsorted(loop_of[tails[within]], np.arange(len(loops) + 1))
    out = []
    for number, loop in enumerate(loops):
        chosen = within[ends[number] : ends[number + 1]]
        joined = np.zeros((len(loop), len(loop)), bool)
        joined[place[tails[chosen]], place[heads[chosen]]] = True
        joined |= joined.T
        beside = np.arange(len(loop))
        joined[beside, np.roll(beside, 1)] = joined[beside, np.roll(beside, -1)] = False
        out.append(joined)
    corners = loop_of[faces]
    alone = np.zeros(len(loops), bool)
    alone[corners[(corners[:, 0] >= 0) & (corners == corners[:, :1]).all(axis=1), 0]] = True
    return out, alone & (np.array([len(loop) for loop in loops]) == 3)


def fill_loops(points: FloatArray, faces: IntArray, loops: list[IntArray]) -> list[IntArray | None]:
    """Faces (n - 2, 3) that close each boundary loop (n,), oriented like the surface; None where the mesh leaves no way.

    No edge is used that the mesh has already, which would give it more than two faces. loops as from ``boundary_loops``:
    no vertex is on two of them.
    """
    around = [loop[::-1] for loop in loops]
    filled: list[IntArray | None] = []
    for loop, joined, is_face in zip(around, *_chords(faces, around, len(points)), strict=True):
        triangles = None if is_face else triangulate_loop(points[loop], joined)
        filled.append(None if triangles is None else loop[triangles])
    return filled
