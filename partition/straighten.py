"""Straighten seams: each is replaced by the shortest path of edges between its ends, within a band around it."""

from __future__ import annotations

from functools import partial
from heapq import heappop, heappush

import numba
import numpy as np

from .dual_graph import AtOnce, FloatArray, IntArray, in_turn


@numba.njit(cache=True, nogil=True)
def _before(h: int) -> int:
    return h - 1 if h % 3 else h + 2


@numba.njit(cache=True, nogil=True)
def _after(h: int) -> int:
    return h + 1 if h % 3 < 2 else h - 2


@numba.njit(cache=True, nogil=True)
def _runs(twins: IntArray, labels: IntArray, start: int) -> int:
    """Changes of label around a vertex, from one of its half-edges on; 3 or more also where it is on the surface's boundary."""
    changes, h = 0, start
    while True:
        before = _before(h)
        other = twins[before]
        if other < 0:
            return 3
        if labels[other // 3] != labels[h // 3]:
            changes += 1
        h = other
        if h == start:
            return changes


@numba.njit(cache=True, nogil=True)
def _next_on_seam(twins: IntArray, labels: IntArray, h: int) -> int:
    """The seam's half-edge after h, with the same two labels at its sides; h ends in a vertex of this seam alone."""
    h = _after(h)
    while labels[twins[h] // 3] == labels[h // 3]:
        h = _after(twins[h])
    return h


@numba.njit(cache=True, nogil=True)
def _band(
    faces: IntArray,
    twins: IntArray,
    labels: IntArray,
    starts: IntArray,
    seam: IntArray,
    rings: int,
    mark: IntArray,
    number: int,
) -> None:
    """Mark with ``number`` the vertices that a path in place of the seam may use: near it, and on no other seam."""
    near = [0 for _ in range(0)]
    p, q = labels[seam[0] // 3], labels[twins[seam[0]] // 3]
    for i in range(1, seam.shape[0]):
        v = faces[seam[i] // 3, seam[i] % 3]
        mark[v] = number
        near.append(v)
    begin = 0
    for _ in range(rings):
        end = len(near)
        for i in range(begin, end):
            first = starts[near[i]]
            h = first
            while True:
                v = faces[_after(h) // 3, _after(h) % 3]
                if mark[v] != number and starts[v] >= 0:
                    label = labels[starts[v] // 3]
                    if label in (p, q) and _runs(twins, labels, starts[v]) == 0:
                        mark[v] = number
                        near.append(v)
                h = twins[_before(h)]
                if h < 0 or h == first:
                    break
        begin = end


@numba.njit(cache=True, nogil=True)
def _shortest(
    faces: IntArray,
    twins: IntArray,
    labels: IntArray,
    lengths: FloatArray,
    starts: IntArray,
    seam: IntArray,
    mark: IntArray,
    number: int,
    distance: FloatArray,
    came: IntArray,
) -> IntArray:
    """Half-edges of the shortest path between the seam's ends over marked vertices; none where it is no shorter."""
    p, q = labels[seam[0] // 3], labels[twins[seam[0]] // 3]
    source = faces[seam[0] // 3, seam[0] % 3]
    last = _after(seam[-1])
    target = faces[last // 3, last % 3]
    now = 0.0
    for i in range(seam.shape[0]):
        now += lengths[seam[i]]
    reached = [source]
    distance[source] = 0.0
    heap = [(0.0, source)]
    while len(heap) > 0:
        far, v = heappop(heap)
        if v == target or far >= now:
            break
        if far > distance[v]:
            continue
        first = starts[v]
        h = first
        while True:
            head = _after(h)
            w = faces[head // 3, head % 3]
            if twins[h] >= 0 and (mark[w] == number or w == target):
                one, other = labels[h // 3], labels[twins[h] // 3]
                step = far + lengths[h]
                another = v == source and w == target and one != other  # a single edge, which is another seam
                if one in (p, q) and other in (p, q) and not another and step < distance[w]:
                    if distance[w] == np.inf:
                        reached.append(w)
                    distance[w], came[w] = step, h
                    heappush(heap, (step, w))
            h = twins[_before(h)]
            if h < 0 or h == first:
                break
    path = [0 for _ in range(0)]
    if distance[target] < now * (1.0 - 1e-12):
        v = target
        while v != source:
            path.append(came[v])
            v = faces[came[v] // 3, came[v] % 3]
    for v in reached:
        distance[v] = np.inf
    return np.array(path)[::-1].copy() if len(path) > 0 else np.empty(0, np.int64)


@numba.njit(cache=True, nogil=True)
def _fill(twins: IntArray, labels: IntArray, size: IntArray, wall: IntArray, number: int, seeds: IntArray, label: int) -> None:
    """Give the seeds that carry another label, and all faces of theirs not behind the wall, this label."""
    work = [0 for _ in range(0)]
    old = -1
    for f in seeds:
        if labels[f] != label:
            old = labels[f]
            labels[f] = label
            work.append(f)
    while len(work) > 0:
        f = work.pop()
        size[old] -= 1
        size[label] += 1
        for i in range(3):
            h = 3 * f + i
            if twins[h] >= 0 and wall[h] != number and labels[twins[h] // 3] == old:
                labels[twins[h] // 3] = label
                work.append(twins[h] // 3)


@numba.njit(cache=True, nogil=True)
def _replace(
    twins: IntArray, labels: IntArray, size: IntArray, path: IntArray, wall: IntArray, number: int, p: int, q: int
) -> None:
    """Make the path the seam between p, on its left, and q."""
    left, right = path // 3, np.empty_like(path)
    for i in range(path.shape[0]):
        right[i] = twins[path[i]] // 3
        wall[path[i]] = number
        wall[twins[path[i]]] = number
    _fill(twins, labels, size, wall, number, left, p)
    _fill(twins, labels, size, wall, number, right, q)


@numba.njit(cache=True, nogil=True)
def _find_seams(faces: IntArray, twins: IntArray, starts: IntArray, labels: IntArray) -> tuple[IntArray, IntArray]:
    """Half-edges of all seams, one after the other, each in its order, and where each seam begins; circles in two halves."""
    seen = np.zeros(twins.shape[0], np.bool_)
    on_seams = [0 for _ in range(0)]
    for h in range(twins.shape[0]):
        if twins[h] >= 0 and labels[h // 3] < labels[twins[h] // 3]:
            on_seams.append(h)
    half_edges = [0 for _ in range(0)]
    begins = [0]
    for closed in (False, True):
        for h in on_seams:
            if seen[h] or (not closed and _runs(twins, labels, starts[faces[h // 3, h % 3]]) < 3):
                continue
            chain = [h]
            seen[h] = True
            while True:
                head = _after(chain[-1])
                if _runs(twins, labels, starts[faces[head // 3, head % 3]]) >= 3:
                    break
                follower = _next_on_seam(twins, labels, chain[-1])
                if seen[follower]:
                    break
                seen[follower] = True
                chain.append(follower)
            half_edges.extend(chain)
            if closed and len(chain) > 1:
                begins.append(begins[-1] + len(chain) // 2)
            begins.append(len(half_edges))
    return np.array(half_edges) if len(half_edges) > 0 else np.empty(0, np.int64), np.array(begins)


@numba.njit(cache=True, nogil=True)
def _straighten(
    faces: IntArray,
    twins: IntArray,
    lengths: FloatArray,
    starts: IntArray,
    labels: IntArray,
    size: IntArray,
    rings: int,
    mark: IntArray,
    wall: IntArray,
    distance: FloatArray,
    came: IntArray,
    seam: IntArray,
    number: int,
) -> bool:
    """Replace one seam by the shortest path near it; says whether it has changed."""
    p, q = labels[seam[0] // 3], labels[twins[seam[0]] // 3]
    _band(faces, twins, labels, starts, seam, rings, mark, number)
    path = _shortest(faces, twins, labels, lengths, starts, seam, mark, number, distance, came)
    if path.shape[0] == 0:
        return False
    _replace(twins, labels, size, path, wall, number, p, q)
    return True


def _rounds(taken: list[tuple[set[int], set[int]]]) -> list[list[int]]:
    """Numbers of the seams that can be moved at the same time: no two have a part or an end in common."""
    rounds: list[tuple[list[int], set[int], set[int]]] = []
    for number, (parts, ends) in enumerate(taken):
        for numbers, parts_there, ends_there in rounds:
            if parts_there.isdisjoint(parts) and ends_there.isdisjoint(ends):
                numbers.append(number)
                parts_there.update(parts)
                ends_there.update(ends)
                break
        else:
            rounds.append(([number], set(parts), set(ends)))
    return [numbers for numbers, _, _ in rounds]


def straighten_seams(
    faces: IntArray,
    twins: IntArray,
    lengths: FloatArray,
    starts: IntArray,
    labels: IntArray,
    part_count: int,
    rings: int,
    at_once: AtOnce = in_turn,
) -> int:
    """Replace every seam in place by the shortest path of edges within so many rings of it; returns how many have changed.

    The ends of seams stay where they are. A path uses no vertex of another seam or of the surface's boundary, so parts that
    are disks stay disks: what a seam joins is a disk, which the path cuts in two. Seams without a part or an end in common
    are replaced ``at_once``: what is read and written for one lies in the two parts that it divides.
    """
    half_edges, begins = _find_seams(faces, twins, starts, labels)
    seams = [seam for seam in np.split(half_edges, begins[1:-1]) if len(seam) > 1]
    flat = faces.reshape(-1)
    taken = []
    for seam in seams:
        sides = {int(labels[seam[0] // 3]), int(labels[twins[seam[0]] // 3])}
        taken.append((sides, {int(flat[seam[0]]), int(flat[_after(seam[-1])])}))
    work = (
        np.bincount(labels, minlength=part_count),
        rings,
        np.full(len(starts), -1, np.int32),
        np.full(len(twins), -1, np.int32),
        np.full(len(starts), np.inf),
        np.empty(len(starts), np.int64),
    )
    straighten = partial(_straighten, faces, twins, lengths, starts, labels, *work)
    changed = 0
    for numbers in _rounds(taken):
        changed += sum(at_once(*(partial(straighten, seams[number], number) for number in numbers)))
    return changed
