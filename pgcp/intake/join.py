"""Split vertices: open edges at one place, as texture seams, creases and flat shading leave them, are joined for the map."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pgcp.intake.manifold import coincident
from pgcp.surface.topology import BOUNDARY
from pgcp.types import BoolArray, FloatArray, IntArray


def joined_vertices(vertices: FloatArray, faces: IntArray, twins: IntArray, distance: float = 0.0) -> IntArray | None:
    """For every vertex (V,) the lowest of those it is joined to along open edges; None where there is nothing to join.

    Two open edges are joined where their ends are at the same places and they run against each other, as neighbours do. Edges
    stay open where more than two are at one place, and where both faces are the same triangle back to back. Vertices
    that touch in a point only stay apart, so an edge never gets a third face from this unless others of its own ends do.

    vertices (V, 3), faces (F, 3), twins (3F,) of ``pair_half_edges``; places are the same where they are equal, or within
    ``distance``, in the unit of the vertices.
    """
    half_edges = np.flatnonzero(twins == BOUNDARY)
    if len(half_edges) == 0:
        return None
    flat = faces.reshape(-1)
    tails, heads, tips = (flat[3 * (half_edges // 3) + (half_edges % 3 + k) % 3] for k in range(3))
    ends, numbers = np.unique(np.concatenate([tails, heads]), return_inverse=True)
    place = _places(vertices[ends], distance)
    if (place == np.arange(len(place))).all():
        return None
    tail, head = np.split(numbers.reshape(-1), 2)
    one, two = _opposite(place[tail], place[head], len(ends))
    back_to_back = (vertices[tips[one]] == vertices[tips[two]]).all(axis=1)
    one, two = one[~back_to_back], two[~back_to_back]
    rows, columns = np.concatenate([tail[one], head[one]]), np.concatenate([head[two], tail[two]])
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), (len(ends), len(ends)))
    labels = connected_components(graph, directed=False)[1]
    lowest: IntArray = np.unique(labels, return_index=True)[1]
    out = np.arange(len(vertices))
    out[ends] = ends[lowest[labels]]
    return out if (out[ends] != ends).any() else None


def _places(points: FloatArray, distance: float) -> IntArray:
    """For every point (n,) the lowest one at its place, which chains of points within ``distance`` make one."""
    if not distance > 0.0:
        return coincident(points)
    pairs = cKDTree(points).query_pairs(distance, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), (len(points), len(points)))
    labels = connected_components(graph, directed=False)[1]
    lowest: IntArray = np.unique(labels, return_index=True)[1]
    return lowest[labels]


def _opposite(tails: IntArray, heads: IntArray, count: int) -> tuple[IntArray, IntArray]:
    """Pairs of directed edges between places that run against each other and are the only two between theirs."""
    keys = np.minimum(tails, heads).astype(np.int64) * count + np.maximum(tails, heads)
    order = np.argsort(keys, kind="stable")
    starts = np.flatnonzero(np.append(True, keys[order[1:]] != keys[order[:-1]]))
    two = starts[np.diff(np.append(starts, len(order))) == 2]
    one, other = order[two], order[two + 1]
    fits: BoolArray = (tails[one] == heads[other]) & (tails[one] != heads[one])
    return one[fits], other[fits]
