"""What looks at a mesh before it is mapped, by NumPy and SciPy, as compiled functions do it, to the last bit.

A mesh of few faces is looked at so as long as the compiled function has not been loaded: compiling takes seconds, and a mesh
that is refused needs nothing else.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pgcp.types import FloatArray, IntArray

FEW = 1 << 17


def is_few(faces: IntArray, compiled: Any) -> bool:
    """Whether faces (F, 3) are so few, and the compiled function has not been loaded."""
    return len(faces) <= FEW and not compiled.signatures


def pair(faces: IntArray, twins: IntArray) -> tuple[int, IntArray, IntArray]:
    """Fill in twins (3F,): all of ``topology._pair``."""
    flat = faces.reshape(-1).astype(np.int64)
    head = np.roll(faces, -1, axis=1).reshape(-1).astype(np.int64)
    low, high = np.minimum(flat, head), np.maximum(flat, head)
    order = np.lexsort((high, low))
    first = np.flatnonzero(np.append(True, (low[order[1:]] != low[order[:-1]]) | (high[order[1:]] != high[order[:-1]])))
    first = first[: len(order)]
    count = np.diff(np.append(first, len(order)))
    one, other = order[first[count == 2]], order[first[count == 2] + 1]
    twins[one], twins[other] = other, one
    crowded = np.repeat(count > 2, count)
    twins[order[crowded]] = -2
    return len(first), order[first[count > 2]], one[flat[one] == flat[other]]


def component_count(twins: IntArray) -> int:
    """Connected components of faces that share an edge: ``topology._component_count``."""
    count = len(twins) // 3
    inner = np.flatnonzero(twins >= 0)
    graph = coo_array((np.ones(len(inner), np.int8), (inner // 3, twins[inner] // 3)), (count, count))
    return int(connected_components(graph, directed=False)[0])


def fans(faces: IntArray, twins: IntArray) -> IntArray:
    """Lowest corner (3F,) of the fan that every corner belongs to: ``manifold._fans``."""
    half_edges = np.flatnonzero(twins >= 0)
    others = twins[half_edges].astype(np.int64)
    heads, other_heads = (np.where(h % 3 < 2, h + 1, h - 2) for h in (half_edges, others))
    flat = faces.reshape(-1)
    opposite = flat[half_edges] == flat[other_heads]
    one = np.concatenate([half_edges, heads])
    two = np.concatenate([np.where(opposite, other_heads, others), np.where(opposite, others, other_heads)])
    graph = coo_array((np.ones(len(one), np.int8), (one, two)), (len(twins), len(twins)))
    labels = connected_components(graph, directed=False)[1]
    lowest: IntArray = np.unique(labels, return_index=True)[1]
    return lowest[labels]


def vertices_of_fans(faces: IntArray, twins: IntArray) -> IntArray:
    """Vertices whose faces form more than one fan."""
    first = np.flatnonzero(fans(faces, twins) == np.arange(len(twins)))
    vertices, count = np.unique(faces.reshape(-1)[first], return_counts=True)
    return np.asarray(vertices[count > 1], np.int64)


def face_areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Area of every face (F,): ``operators.face_areas``."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    u, v = (b - a).T, (c - a).T
    x, y, z = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
    return np.asarray(0.5 * np.sqrt(x * x + y * y + z * z), np.float64)


def most_needed(vertices: FloatArray, faces: IntArray, enough: float, spare: float) -> tuple[float, float]:
    """Most that any face needs to have enough to spare, and the sum of edge lengths: ``operators._most_needed``."""
    lengths = []
    for i in range(3):
        x, y, z = (vertices[faces[:, (i + 2) % 3]] - vertices[faces[:, (i + 1) % 3]]).T
        lengths.append(np.sqrt(x * x + y * y + z * z))
    total = lengths[0] + lengths[1] + lengths[2]
    longest = np.maximum(np.maximum(lengths[0], lengths[1]), lengths[2])
    has = total - 2.0 * longest
    needed = np.where(has >= enough * longest, 0.0, spare - has / np.where(longest > 0.0, longest, 1.0))
    most = float(np.where(longest > 0.0, needed, 1.0).max())
    return most, float(np.cumsum(total)[-1])  # added one by one, as in the loop


def extent(points: FloatArray, faces: IntArray) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest coordinates (3,) of the points that faces use: ``check._extent``."""
    used = np.zeros(len(points), bool)
    used[faces.reshape(-1)] = True
    return points[used].min(axis=0), points[used].max(axis=0)
