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
    stay open where more than two of one part of the surface are at one place, and where both faces are the same triangle back
    to back. Vertices that touch in a point only stay apart.

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
    back = vertices[tips]
    glued: IntArray = np.empty((0, 2), np.int64)
    left: IntArray = np.arange(len(half_edges))
    label: IntArray = np.zeros(len(half_edges), np.int64)
    for _ in range(2):  # those that are alone at their place, then those alone in their part of the surface
        one, two = (left[side] for side in _opposite(place[tail[left]], place[head[left]], label[left]))
        apart = (back[one] != back[two]).any(axis=1)
        one, two = one[apart], two[apart]
        pairs = np.column_stack([np.concatenate([tail[one], head[one]]), np.concatenate([head[two], tail[two]])])
        glued = np.concatenate([glued, pairs])
        out = _lowest(ends, glued, len(vertices))
        left = np.setdiff1d(left, np.concatenate([one, two]))
        if not _are_crowded(place[tail[left]], place[head[left]]):
            break
        label = _parts(out[faces], len(vertices))[half_edges // 3]
    return out if (out[ends] != ends).any() else None


def _lowest(ends: IntArray, pairs: IntArray, count: int) -> IntArray:
    """For every vertex (count,) the lowest of those that pairs (N, 2) of places in ``ends`` join it to."""
    graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), (len(ends), len(ends)))
    labels = connected_components(graph, directed=False)[1]
    lowest: IntArray = np.unique(labels, return_index=True)[1]
    out = np.arange(count)
    out[ends] = ends[lowest[labels]]
    return out


def _parts(faces: IntArray, count: int) -> IntArray:
    """Number (F,) of the connected part that each face belongs to."""
    rows, columns = np.concatenate([faces[:, 0], faces[:, 1]]), np.concatenate([faces[:, 1], faces[:, 2]])
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), (count, count))
    return np.asarray(connected_components(graph, directed=False)[1][faces[:, 0]])


def _are_crowded(tails: IntArray, heads: IntArray) -> bool:
    """Whether more than two of some edges between places have the same two ends."""
    ends = np.sort(np.column_stack([tails, heads]), axis=1)
    return bool(len(ends) and np.unique(ends, axis=0, return_counts=True)[1].max() > 2)


def _places(points: FloatArray, distance: float) -> IntArray:
    """For every point (n,) the lowest one at its place, which chains of points within ``distance`` make one."""
    if not distance > 0.0:
        return coincident(points)
    pairs = cKDTree(points).query_pairs(distance, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), (len(points), len(points)))
    labels = connected_components(graph, directed=False)[1]
    lowest: IntArray = np.unique(labels, return_index=True)[1]
    return lowest[labels]


def _opposite(tails: IntArray, heads: IntArray, labels: IntArray) -> tuple[IntArray, IntArray]:
    """Pairs of edges of one label that run against each other and are the only two of it between their places."""
    low, high = np.minimum(tails, heads), np.maximum(tails, heads)
    order = np.lexsort((labels, high, low))
    same = [(values[order[1:]] == values[order[:-1]]) for values in (low, high, labels)]
    starts = np.flatnonzero(np.append(len(order) > 0, ~(same[0] & same[1] & same[2])))
    two = starts[np.diff(np.append(starts, len(order))) == 2]
    one, other = order[two], order[two + 1]
    fits: BoolArray = (tails[one] == heads[other]) & (tails[one] != heads[one])
    return one[fits], other[fits]
