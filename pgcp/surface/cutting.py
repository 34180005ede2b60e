"""Cuts that open a surface to a disk: loops around handles, and trees of edges through boundaries and tips.

Edges have costs; a cut is short where it is cheap. Handles: tree-cotree decomposition, whose loops through a point are the
shortest there are (Eppstein 2003; Erickson, Whittlesey 2005). Tips: a Steiner tree, each tip joined to what there is by a
shortest path (Takahashi, Matsuyama 1980), which costs at most twice as much as the cheapest tree.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra, minimum_spanning_tree

from pgcp.types import BoolArray, FloatArray, IntArray

_ROOTS, _ON_CUT = 6, 5
_NOWHERE = -9999  # SciPy's predecessor of what has none


@dataclass(frozen=True, eq=False)
class EdgeGraph:
    """The edges of an oriented manifold mesh.

    ends (E, 2): vertices, the lower first; halves (E, 2): half-edges, the second -1 on the boundary; count: of vertices;
    face_count: of faces.
    """

    ends: IntArray
    halves: IntArray
    count: int
    face_count: int

    @classmethod
    def of(cls, faces: IntArray, twins: IntArray, count: int) -> EdgeGraph:
        """The edges of faces (F, 3), with twins (3F,) of ``pair_half_edges``."""
        first = np.flatnonzero(np.arange(len(twins)) > twins)  # of two half-edges the later, boundary edges too
        first = np.where(twins[first] >= 0, twins[first], first)
        flat = faces.reshape(-1).astype(np.int64)
        heads = np.roll(faces, -1, axis=1).reshape(-1).astype(np.int64)
        ends = np.sort(np.column_stack([flat[first], heads[first]]), axis=1)
        return cls(ends, np.column_stack([first, np.maximum(twins[first], -1)]), count, len(faces))

    @cached_property
    def is_boundary(self) -> BoolArray:
        """Whether each edge (E,) has one face only."""
        return np.asarray(self.halves[:, 1] < 0)

    @property
    def characteristic(self) -> int:
        """Euler characteristic."""
        return len(np.unique(self.ends)) - len(self.ends) + self.face_count

    @cached_property
    def _keys(self) -> tuple[IntArray, IntArray]:
        keys = self.ends[:, 0] * self.count + self.ends[:, 1]
        order = np.argsort(keys)
        return keys[order], order

    def numbers(self, pairs: IntArray) -> IntArray:
        """Numbers (N,) of the edges between pairs (N, 2) of vertices, -1 where there is none."""
        keys, order = self._keys
        low, high = pairs.min(axis=1), pairs.max(axis=1)
        wanted = low * self.count + high
        at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        return np.where((keys[at] == wanted) & (low >= 0) & (high < self.count), order[at], -1)

    def matrix(self, costs: FloatArray) -> csr_array:
        """Symmetric matrix (V, V) of costs (E,), all positive."""
        a, b = self.ends.T
        rows, columns = np.concatenate([a, b]), np.concatenate([b, a])
        return csr_array((np.concatenate([costs, costs]), (rows, columns)), shape=(self.count, self.count))

    def degrees(self, chosen: BoolArray) -> IntArray:
        """How many of the chosen edges (E,) end at each vertex (V,)."""
        return np.bincount(self.ends[chosen].reshape(-1), minlength=self.count)


def _opening(graph: EdgeGraph, costs: FloatArray, root: int, loops: IntArray) -> BoolArray:
    """Edges (E,), boundary ones among them, whose complement is a disk: tree-cotree from a root.

    A shortest-path tree of vertices, boundary edges for nothing, then a tree of faces across other edges that leaves uncrossed
    those that close the shortest loops. Those edges, and the paths from their ends and from a vertex of every boundary loop
    to the root, are the cut.
    """
    free = np.where(graph.is_boundary, 1e-9 * costs.min(), costs)
    distance, before = dijkstra(graph.matrix(free), indices=root, return_predecessors=True)
    has = np.flatnonzero(before != _NOWHERE)
    tree = np.zeros(len(costs), bool)
    tree[graph.numbers(np.column_stack([has, before[has]]))] = True
    inner = np.flatnonzero(~tree & ~graph.is_boundary)
    around = free[inner] + distance[graph.ends[inner]].sum(axis=1)
    crossed = _tree_of_faces(graph.halves[inner] // 3, around, graph.face_count)
    left = np.setdiff1d(inner, inner[crossed])
    cut = graph.is_boundary.copy()
    cut[left] = True
    cut[graph.numbers(_paths_up(before, np.concatenate([graph.ends[left].reshape(-1), loops])))] = True
    return _without_stem(graph, cut, root)


def _tree_of_faces(pairs: IntArray, loops: FloatArray, face_count: int) -> IntArray:
    """Which edges, between pairs (n, 2) of faces, a spanning tree crosses that leaves uncrossed those of the shortest loops."""
    low, high = pairs.min(axis=1).astype(np.int64), pairs.max(axis=1).astype(np.int64)
    key = low * face_count + high
    order = np.lexsort((-loops, key))  # of several edges between two faces the one of the longest loop
    first = order[np.append(True, np.diff(key[order]) != 0)]
    weights = 2.0 * loops.max() - loops[first]
    dual = csr_array((weights, (low[first], high[first])), shape=(face_count, face_count))
    found = minimum_spanning_tree(dual).tocoo()
    rows, columns = found.row.astype(np.int64), found.col.astype(np.int64)
    wanted = np.minimum(rows, columns) * face_count + np.maximum(rows, columns)
    return np.asarray(first[np.searchsorted(key[first], wanted)])


def _paths_up(before: IntArray, starts: IntArray) -> IntArray:
    """Pairs (n, 2) of vertices along the paths from some vertices to the root of a tree of predecessors (V,)."""
    pairs, seen = [], set[int]()
    for start in starts.tolist():
        v = start
        while v not in seen:
            seen.add(v)
            above = int(before[v])
            if above == _NOWHERE:
                break
            pairs.append((v, above))
            v = above
    return np.array(pairs, np.int64).reshape(-1, 2)


def _without_stem(graph: EdgeGraph, cut: BoolArray, root: int) -> BoolArray:
    """A cut (E,) without the edges from its root to where it branches or meets the boundary."""
    cut, v = cut.copy(), root
    of_vertex: dict[int, list[int]] = {}
    for e in np.flatnonzero(cut & ~graph.is_boundary).tolist():
        for end in graph.ends[e].tolist():
            of_vertex.setdefault(end, []).append(e)
    on_boundary = set(graph.ends[graph.is_boundary].reshape(-1).tolist())
    while v not in on_boundary and len(of_vertex.get(v, [])) == 1:
        e = of_vertex[v][0]
        cut[e] = False
        v = int(graph.ends[e].sum()) - v
        of_vertex[v].remove(e)
    return cut


def open_surface(graph: EdgeGraph, costs: FloatArray, roots: IntArray, loops: IntArray) -> BoolArray:
    """Edges (E,) that open a connected surface to a disk, boundary edges among them; none of a sphere.

    costs (E,): positive; roots: vertices of which the one with the cheapest cut is the loops' common point, or else one of five
    on that cut; loops (b,): a
    vertex of each boundary loop.
    """
    if graph.characteristic + len(loops) == 2 and len(loops) < 2:
        return graph.is_boundary.copy()

    def cost(cut: BoolArray) -> float:
        """What a cut costs."""
        return float(costs[cut & ~graph.is_boundary].sum())

    best = min((_opening(graph, costs, int(root), loops) for root in roots), key=cost)
    on_cut = np.unique(graph.ends[best & ~graph.is_boundary])
    others = on_cut[np.linspace(0, len(on_cut) - 1, _ON_CUT).astype(np.int64)]
    return min((best, *(_opening(graph, costs, int(root), loops) for root in others)), key=cost)


def spread_vertices(graph: EdgeGraph, costs: FloatArray, used: BoolArray, count: int = _ROOTS) -> IntArray:
    """Vertices far from each other: each the farthest from those before it."""
    matrix = graph.matrix(costs)
    found = [int(np.argmax(used))]
    for _ in range(count):
        distance = dijkstra(matrix, indices=found, min_only=True)
        found.append(int(np.argmax(np.where(np.isfinite(distance) & used, distance, -1.0))))
    return np.array(found[1:])


def with_tips(graph: EdgeGraph, costs: FloatArray, cut: BoolArray, tips: IntArray) -> BoolArray:
    """A cut (E,) and the paths that join tips to it, the nearest first; where there is no cut yet, to the first tip."""
    cut, matrix = cut.copy(), graph.matrix(costs)
    left = np.asarray(tips, np.int64)
    on_cut = graph.degrees(cut) > 0
    if not on_cut.any() and len(left):
        on_cut[left[0]] = True
    left = left[~on_cut[left]]
    while len(left):
        distance, before, _ = dijkstra(matrix, indices=np.flatnonzero(on_cut), min_only=True, return_predecessors=True)
        tip = int(left[np.argmin(distance[left])])
        path = [tip]
        while not on_cut[path[-1]]:
            path.append(int(before[path[-1]]))
        cut[graph.numbers(np.column_stack([path[:-1], path[1:]]))] = True
        on_cut[path] = True
        left = left[~on_cut[left]]
    return cut


def opened_twins(graph: EdgeGraph, twins: IntArray, cut: BoolArray) -> IntArray:
    """Twins (3F,) in which the edges of a cut (E,) are boundary."""
    out = twins.copy()
    out[graph.halves[cut & ~graph.is_boundary].reshape(-1)] = -1
    return out
