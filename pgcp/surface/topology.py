"""Topology of a triangle mesh: half-edge pairing, defects, Euler characteristic, boundary loops.

A half-edge ``h = 3 f + i`` runs from ``faces[f, i]`` to ``faces[f, (i + 1) % 3]``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numba
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pgcp.parallel import at_once, in_parts, in_slices
from pgcp.surface import plain
from pgcp.types import BoolArray, IntArray, Mesh

BOUNDARY = -1
NON_MANIFOLD = -2
_LEAST_VERTICES = 1 << 16  # worth a thread
_MANY = 64  # edges from one vertex that are sorted by insertion
_HALF = 33  # bits of a half-edge's number, beside the 30 of a vertex: enough for a billion vertices
_LOWER = (1 << _HALF) - 1


@dataclass(frozen=True, slots=True, eq=False)
class Defect:
    """One kind of defect: what it is, how often it occurs, and the first few offenders."""

    kind: str
    count: int
    first: tuple[tuple[int, ...], ...]
    message: str


@dataclass(frozen=True, slots=True, eq=False)
class Topology:
    """What a mesh is: counts, loops and defects. ``twins`` is (3F,) (-1 boundary, -2 non-manifold)."""

    vertex_count: int
    face_count: int
    edge_count: int
    component_count: int
    euler_characteristic: int
    loops: tuple[IntArray, ...]
    unreferenced_count: int
    defects: tuple[Defect, ...]
    twins: IntArray = field(repr=False)

    @property
    def is_disk(self) -> bool:
        """Whether the mesh is one disk: no defect, one component, chi = 1, one boundary loop."""
        return self._clean() and self.euler_characteristic == 1 and len(self.loops) == 1

    @property
    def is_sphere(self) -> bool:
        """Whether the mesh is one closed surface of genus 0."""
        return self._clean() and self.euler_characteristic == 2 and not self.loops

    def fits(self, closed: bool | None) -> bool:
        """Whether the mesh is what is wanted: a ``closed`` surface, an open one, or (None) either."""
        return (self.is_disk and closed is not True) or (self.is_sphere and closed is not False)

    @property
    def genus(self) -> int | None:
        """Genus of the one oriented component, or None where it is not defined."""
        if not self._clean():
            return None
        return (2 - self.euler_characteristic - len(self.loops)) // 2

    def _clean(self) -> bool:
        return not self.defects and self.component_count == 1

    def describe(self) -> str:
        """One line that says what the mesh is."""
        loops = len(self.loops)
        if self.is_disk:
            kind = f"an open surface (a disk) with one boundary loop of {len(self.loops[0])} edges"
        elif self.is_sphere:
            kind = "a closed surface of genus 0 (a sphere)"
        elif self.defects:
            kind = "not a clean surface"
        elif self.component_count != 1:
            kind = f"{self.component_count} separate components"
        else:
            ends = "closed" if loops == 0 else f"{loops} boundary loop{'s' if loops > 1 else ''}"
            kind = f"a surface of genus {self.genus}, {ends}"
        return kind


@numba.njit(cache=True, nogil=True)
def _by_lower_end(faces: IntArray, first: int, stop: int) -> tuple[IntArray, IntArray]:
    """Half-edges whose lower vertex is one from first to stop, sorted by it: where each begins, and the half-edges.

    A half-edge is one number, with its higher vertex in the upper half.
    """
    starts = np.zeros(stop - first + 1, np.int64)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        for lower in (min(a, b), min(b, c), min(c, a)):
            if first <= lower < stop:
                starts[lower - first + 1] += 1
    for v in range(stop - first):
        starts[v + 1] += starts[v]
    fill = starts.copy()
    half_edges = np.empty(starts[-1], np.int64)
    for f in range(faces.shape[0]):
        for i in range(3):
            a, b = faces[f, i], faces[f, (i + 1) % 3]
            lower = min(a, b)
            if first <= lower < stop:
                half_edges[fill[lower - first]] = np.int64(max(a, b)) << _HALF | (3 * f + i)
                fill[lower - first] += 1
    return starts, half_edges


@numba.njit(cache=True, nogil=True)
def _pair(faces: IntArray, twins: IntArray, first: int, stop: int) -> tuple[int, IntArray, IntArray]:
    """Fill in twins of half-edges whose lower vertex is one from first to stop.

    Returns the number of edges, and one half-edge of each with more than two faces or two that disagree.
    """
    starts, half_edges = _by_lower_end(faces, first, stop)
    crowded = [np.int64(0) for _ in range(0)]
    turned = [np.int64(0) for _ in range(0)]
    edge_count = 0
    for v in range(stop - first):
        low, high = starts[v], starts[v + 1]
        if high - low > _MANY:
            half_edges[low:high].sort()
        else:
            for i in range(low + 1, high):
                one, j = half_edges[i], i - 1
                while j >= low and half_edges[j] > one:
                    half_edges[j + 1] = half_edges[j]
                    j -= 1
                half_edges[j + 1] = one
        start = low
        while start < high:
            end = start + 1
            while end < high and half_edges[end] >> _HALF == half_edges[start] >> _HALF:
                end += 1
            edge_count += 1
            one = half_edges[start] & _LOWER
            if end - start == 2:
                other = half_edges[start + 1] & _LOWER
                twins[one], twins[other] = other, one
                if faces[one // 3, one % 3] == faces[other // 3, other % 3]:
                    turned.append(one)
            elif end - start > 2:
                crowded.append(one)
                for r in range(start, end):
                    twins[half_edges[r] & _LOWER] = NON_MANIFOLD
            start = end
    return edge_count, np.array(crowded), np.array(turned)


def _paired(faces: IntArray, vertex_count: int) -> tuple[IntArray, int, IntArray, IntArray]:
    """Twins (3F,), in 32 bits where they fit, and what ``_pair`` says of all edges."""
    half_edge_count = 3 * len(faces)
    twins: IntArray = np.full(half_edge_count, BOUNDARY, np.int32 if half_edge_count < 2**31 else np.int64)
    faces = np.ascontiguousarray(faces)
    if plain.is_few(faces, _pair):
        edge_count, *odd = plain.pair(faces, twins)
        return twins, edge_count, np.sort(odd[0]), np.sort(odd[1])
    parts = in_parts(partial(_pair, faces, twins), vertex_count, _LEAST_VERTICES)
    counts, crowded, turned = zip(*parts, strict=True)
    return twins, sum(counts), np.sort(np.concatenate(crowded)), np.sort(np.concatenate(turned))


def pair_half_edges(faces: IntArray, vertex_count: int) -> IntArray:
    """Twin half-edge of every half-edge (3F,): -1 on the boundary, -2 where three or more faces meet."""
    return _paired(faces, vertex_count)[0]


@numba.njit(cache=True, nogil=True)
def _fan_starts(faces: IntArray, twins: IntArray, vertex_count: int) -> tuple[IntArray, IntArray]:
    """For every vertex (V,) how many faces it has, and a half-edge that leaves it: the first of its fan where that is open."""
    corner_count = np.zeros(vertex_count, np.int32)
    start = np.full(vertex_count, -1, twins.dtype)
    for f in range(faces.shape[0]):
        for i in range(3):
            v, h = faces[f, i], 3 * f + i
            corner_count[v] += 1
            if start[v] < 0 or twins[h] < 0:
                start[v] = h
    return corner_count, start


@numba.njit(cache=True, nogil=True)
def _split_fans(twins: IntArray, corner_count: IntArray, start: IntArray, first: int, stop: int) -> IntArray:
    """Vertices from first to stop whose faces form more than one fan."""
    bad = np.zeros(stop - first, np.bool_)
    for v in range(first, stop):
        if start[v] < 0:
            continue
        h, seen = start[v], 0
        while True:
            seen += 1
            before = h - 1 if h % 3 else h + 2
            h = twins[before]
            if h < 0 or h == start[v] or seen > corner_count[v]:
                break
        bad[v - first] = seen != corner_count[v]
    return first + np.flatnonzero(bad)


def _vertices_of_fans(faces: IntArray, twins: IntArray, vertex_count: int) -> IntArray:
    """Vertices whose faces form more than one fan."""
    if plain.is_few(faces, _fan_starts):
        return plain.vertices_of_fans(faces, twins)
    split = partial(_split_fans, twins, *_fan_starts(faces, twins, vertex_count))
    return np.concatenate(in_parts(split, vertex_count, _LEAST_VERTICES))


def boundary_loops(faces: IntArray, twins: IntArray, vertex_count: int) -> tuple[IntArray, ...]:
    """Boundary loops, each along the surface's orientation from its lowest vertex id, longest first.

    Assumes manifold vertices (at most one boundary half-edge leaves any vertex).
    """
    open_half_edges = np.flatnonzero(twins == BOUNDARY)
    if len(open_half_edges) == 0:
        return ()
    flat = faces.reshape(-1)
    corner = open_half_edges % 3
    loops = loops_of(flat[open_half_edges], flat[open_half_edges - corner + (corner + 1) % 3])
    return tuple(sorted(loops, key=lambda loop: (-len(loop), loop[0])))


def loops_of(tails: IntArray, heads: IntArray) -> list[IntArray]:
    """Closed loops of directed edges, of which at most one leaves any vertex: each from its lowest vertex, by that vertex."""
    follower = dict(zip(tails.tolist(), heads.tolist(), strict=True))
    loops: list[IntArray] = []
    for tail in sorted(follower):
        if tail not in follower:
            continue
        loop = [tail]
        vertex = follower.pop(tail)
        while vertex != tail and vertex in follower:
            loop.append(vertex)
            vertex = follower.pop(vertex)
        loops.append(np.array(loop, np.int64))
    return loops


@numba.njit(cache=True, nogil=True)
def _component_count(twins: IntArray) -> int:
    """Connected components of faces that share an edge."""
    face_count = twins.shape[0] // 3
    leader = np.arange(face_count).astype(np.int32)
    count = face_count
    for h in range(twins.shape[0]):
        if twins[h] <= h:
            continue
        a, b = h // 3, twins[h] // 3
        while leader[a] != a:
            leader[a] = leader[leader[a]]
            a = leader[a]
        while leader[b] != b:
            leader[b] = leader[leader[b]]
            b = leader[b]
        if a != b:
            leader[max(a, b)] = min(a, b)
            count -= 1
    return count


def _components(faces: IntArray, twins: IntArray) -> int:
    """Connected components of faces that share an edge."""
    return plain.component_count(twins) if plain.is_few(faces, _component_count) else int(_component_count(twins))


def _is_orientable(faces: IntArray, twins: IntArray) -> bool:
    """Whether flipping some faces would make all agree: the signed double cover stays in two pieces."""
    face_count = len(faces)
    inner = np.flatnonzero(twins >= 0)
    flat = faces.reshape(-1)
    agree = flat[inner] != flat[twins[inner]]
    here, there = inner // 3, twins[inner] // 3
    rows = np.concatenate([here, here + face_count])
    columns = np.concatenate([np.where(agree, there, there + face_count), np.where(agree, there + face_count, there)])
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), (2 * face_count, 2 * face_count))
    _, labels = connected_components(graph, directed=False)
    return bool(np.all(labels[:face_count] != labels[face_count:]))


def _listing(rows: IntArray, limit: int = 5) -> str:
    shown = ", ".join("-".join(str(int(i)) for i in np.atleast_1d(row)) for row in rows[:limit])
    return shown + (", ..." if len(rows) > limit else "")


def _defect(kind: str, rows: IntArray, sentence: str) -> Defect:
    first = tuple(tuple(int(i) for i in np.atleast_1d(row)) for row in rows[:5])
    return Defect(kind, len(rows), first, sentence.format(n=len(rows), which=_listing(rows)))


def _duplicate_faces(faces: IntArray) -> IntArray:
    ordered = np.sort(faces, axis=1)
    order = np.lexsort(ordered.T[::-1])
    same = np.all(ordered[order[1:]] == ordered[order[:-1]], axis=1)
    return np.sort(order[1:][same])


def examine(faces: IntArray, vertex_count: int) -> Topology:
    """Examine a mesh's topology and list every defect with its count and first few offenders.

    Parameters: faces (F, 3) integers in [0, vertex_count). Nothing is changed or repaired.
    """
    faces = np.ascontiguousarray(faces)
    defects: list[Defect] = []
    a, b, c = faces.T
    repeated = np.flatnonzero((a == b) | (b == c) | (c == a))
    if len(repeated):
        defects.append(_defect("repeated-index-face", repeated, "{n} faces use a vertex twice: faces {which}"))
    twins, edge_count, crowded, turned = _paired(faces, vertex_count)
    flat = faces.reshape(-1)

    def ends(half_edges: IntArray) -> IntArray:
        """Vertices (N, 2) of half-edges."""
        corner = half_edges % 3
        return np.column_stack([flat[half_edges], flat[half_edges - corner + (corner + 1) % 3]])

    if len(crowded):
        duplicates = _duplicate_faces(faces)
        if len(duplicates):
            defects.append(_defect("duplicate-face", duplicates, "{n} faces are listed twice: faces {which}"))
        defects.append(_defect("non-manifold-edge", ends(crowded), "{n} edges have more than two faces: edges {which}"))
    elif len(turned):
        if len(faces) == 0 or _is_orientable(faces, twins):
            sentence = "faces disagree in orientation across {n} edges: edges {which}"
            defects.append(_defect("inconsistent-orientation", ends(turned), sentence))
        else:
            sentence = "the surface is not orientable (a Moebius band lies in it): {n} edges disagree, edges {which}"
            defects.append(_defect("not-orientable", ends(turned), sentence))
    counted: list[Any] = at_once(
        lambda: _components(faces, twins), lambda: _vertices_of_fans(faces, twins, vertex_count) if not defects else None
    )
    if not defects:
        split = counted[1]
        if len(split):
            sentence = "{n} vertices are non-manifold (faces touch in the vertex only): vertices {which}"
            defects.append(_defect("non-manifold-vertex", split, sentence))
    referenced = np.zeros(vertex_count, bool)
    referenced[flat] = True
    used = int(np.count_nonzero(referenced))
    components = int(counted[0])
    return Topology(
        vertex_count=vertex_count,
        face_count=len(faces),
        edge_count=int(edge_count),
        component_count=components,
        euler_characteristic=used - int(edge_count) + len(faces),
        loops=boundary_loops(faces, twins, vertex_count) if not defects else (),
        unreferenced_count=vertex_count - used,
        defects=tuple(defects),
        twins=twins,
    )


@numba.njit(cache=True, nogil=True)
def _mark(faces: IntArray, used: BoolArray, begin: int, end: int) -> None:
    for f in range(begin, end):
        for i in range(3):
            used[faces[f, i]] = True


def used_vertices(mesh: Mesh) -> BoolArray:
    """Which vertices (V,) some face uses."""
    used = np.zeros(len(mesh.vertices), bool)
    in_slices(partial(_mark, mesh.faces, used), len(mesh.faces))
    return used


def loop_edges(edges: IntArray, loop: IntArray, node_count: int) -> IntArray:
    """Numbers (B,) of the edges (M, 2) along a closed loop (B,) of nodes, the first from loop[0] to loop[1]."""
    after = np.roll(loop, -1)
    keys = edges.min(axis=1) * node_count + edges.max(axis=1)
    order = np.argsort(keys)
    found: IntArray = order[np.searchsorted(keys[order], np.minimum(loop, after) * node_count + np.maximum(loop, after))]
    return found


@numba.njit(cache=True, nogil=True)
def rings_around(faces: IntArray, start: IntArray, rings: int, vertex_count: int) -> BoolArray:
    """Which faces (F,) are within so many rings of the given ones."""
    chosen, touched = np.zeros(faces.shape[0], np.bool_), np.zeros(vertex_count, np.bool_)
    for f in start:
        chosen[f] = True
    for _ in range(rings):
        for f in range(faces.shape[0]):
            if chosen[f]:
                touched[faces[f, 0]] = touched[faces[f, 1]] = touched[faces[f, 2]] = True
        count = 0
        for f in range(faces.shape[0]):
            if not chosen[f] and (touched[faces[f, 0]] or touched[faces[f, 1]] or touched[faces[f, 2]]):
                chosen[f] = True
                count += 1
        if count == 0:
            break
    return chosen
