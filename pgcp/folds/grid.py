"""An embedding of any closed surface of genus 0 into the sphere that rounding cannot fold: a drawing on a grid.

Without one face, the lid, a triangulation is drawn in a triangle with whole numbers as barycentric coordinates: the numbers of
faces in the three regions into which three paths from a vertex to the lid's corners part it (Schnyder 1990, "Embedding planar
graphs on the grid"). No face is smaller than half a cell of a grid of as many rows as there are faces, so nothing is crowded,
whatever the surface's shape; angles are not kept at all. The drawing is seen from the sphere's centre as a plane above it, with
the lid's corners moved below the horizon. Faces at a corner then look outwards, since the neighbours of corner k stand in the
order of the difference of their two other coordinates.
"""

from __future__ import annotations

import numba
import numpy as np

from pgcp.errors import SolveFailedError
from pgcp.surface.topology import pair_half_edges
from pgcp.types import FloatArray, IntArray

_DROP = 1e-3


@numba.njit(cache=True, nogil=True)
def _realizer(faces: IntArray, twins: IntArray, first: IntArray, lid: int) -> tuple[IntArray, IntArray, bool]:
    """Parents (V, 3) of all vertices in three trees, the order in which vertices are taken away, and whether all were.

    first (V,): a half-edge that leaves each vertex. The trees' roots are the lid's first, third and second corner. From the
    outer cycle one vertex without chords is taken after the other: what it is joined to on either side are its first and second
    parent, and it is the third one of those that then come to the outer cycle.
    """
    # long: one compiled loop, whose steps share the outer cycle
    n = first.shape[0]
    one, two, three = faces[lid, 0], faces[lid, 2], faces[lid, 1]
    parent = np.full((n, 3), -1)
    after, before = np.full(n, -1), np.full(n, -1)  # counter-clockwise on the outer cycle
    after[one], after[two], after[three] = two, three, one
    before[two], before[three], before[one] = one, two, three
    state = np.zeros(n, np.int8)  # 1 on the outer cycle, 2 taken
    state[one] = state[two] = state[three] = 1
    chords = np.zeros(n, np.int64)
    order = np.empty(n - 2, np.int64)
    waiting = np.empty(4 * faces.shape[0] + n, np.int64)
    waiting[0] = three
    height, count = 1, 0
    around = np.empty(n, np.int64)
    while height > 0:
        height -= 1
        v = waiting[height]
        if state[v] != 1 or chords[v] != 0 or v in (one, two):
            continue
        left, right = after[v], before[v]
        h = first[v]
        while faces[h // 3, (h % 3 + 1) % 3] != left:
            h = twins[3 * (h // 3) + (h % 3 + 2) % 3]
        inner = 0
        while True:
            h = twins[3 * (h // 3) + (h % 3 + 2) % 3]
            u = faces[h // 3, (h % 3 + 1) % 3]
            if u == right:
                break
            around[inner] = u
            inner += 1
        state[v] = 2
        order[count] = v
        count += 1
        parent[v, 0], parent[v, 1] = left, right
        previous = right
        for i in range(inner - 1, -1, -1):
            u = around[i]
            parent[u, 2] = v
            state[u] = 3  # new there: a chord between two of them is counted once
            after[previous], before[u] = u, previous
            previous = u
        after[previous], before[left] = left, previous
        if inner == 0 and after[left] != right:  # their edge was a chord
            chords[left] -= 1
            chords[right] -= 1
        for i in range(inner):
            u = around[i]
            start = first[u]
            h = start
            while True:
                w = faces[h // 3, (h % 3 + 1) % 3]
                if (state[w] == 1 or state[w] == 3) and w != after[u] and w != before[u] and (state[w] == 1 or w < u):
                    chords[u] += 1
                    chords[w] += 1
                h = twins[3 * (h // 3) + (h % 3 + 2) % 3]
                if h == start:
                    break
        for i in range(inner):
            state[around[i]] = 1
        waiting[height] = left
        waiting[height + 1] = right
        height += 2
        for i in range(inner):
            waiting[height] = around[i]
            height += 1
    return parent, order[:count], count == n - 2


@numba.njit(cache=True, nogil=True)
def _counted(parent: IntArray, order: IntArray, roots: IntArray) -> IntArray:
    """Faces (V, 3) in the region of each inner vertex opposite to each root."""
    n = parent.shape[0]
    size = np.ones((n, 3), np.int64)  # of subtrees
    for k in range(order.shape[0]):  # children before parents in the first two trees
        v = order[k]
        if v != roots[2]:
            size[parent[v, 0], 0] += size[v, 0]
            size[parent[v, 1], 1] += size[v, 1]
    for k in range(order.shape[0] - 1, 0, -1):
        v = order[k]
        size[parent[v, 2], 2] += size[v, 2]
    along = np.zeros((n, 3, 3), np.int64)  # sizes in tree i summed over the path in tree j
    length = np.ones((n, 3), np.int64)
    for j in range(3):
        for i in range(3):
            along[roots[j], i, j] = size[roots[j], i] if i == j else 1
    for j in range(3):
        for k in range(1, order.shape[0]):
            v = order[k] if j == 2 else order[order.shape[0] - k]
            p = parent[v, j]
            length[v, j] = length[p, j] + 1
            for i in range(3):
                along[v, i, j] = along[p, i, j] + size[v, i]
    out = np.zeros((n, 3), np.int64)
    for k in range(1, order.shape[0]):
        v = order[k]
        for i in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            inside = along[v, i, a] + along[v, i, b] - size[v, i]
            rim = length[v, a] + length[v, b] - 1
            out[v, i] = 2 * (inside - rim) + rim - 2
    return out


def grid_coordinates(faces: IntArray, vertex_count: int, lid: int) -> IntArray:
    """Barycentric coordinates (V, 3), whole numbers with the sum F - 1, of a drawing of all faces but the lid.

    faces (F, 3) of a closed surface of genus 0, every vertex used. The coordinates belong to the lid's first, third and second
    corner, which go counter-clockwise around the drawing. Raises SolveFailedError where two edges join the same vertices.
    """
    faces = np.ascontiguousarray(faces, np.int64)
    twins = pair_half_edges(faces, vertex_count).astype(np.int64)
    if (twins < 0).any():
        raise SolveFailedError("the surface is not closed, or two of its edges join the same vertices")
    first = np.empty(vertex_count, np.int64)
    first[faces.reshape(-1)] = np.arange(faces.size)
    parent, order, whole = _realizer(faces, twins, first, lid)
    if not whole:
        raise SolveFailedError("the surface could not be drawn on a grid")
    roots = faces[lid, [0, 2, 1]]
    out = _counted(parent, order, roots)
    out[roots] = np.eye(3, dtype=np.int64) * (len(faces) - 1)
    return out


def grid_sphere(faces: IntArray, vertex_count: int, lid: int) -> FloatArray:
    """Unit vectors (V, 3) of an embedding without folds; see ``grid_coordinates``."""
    share = grid_coordinates(faces, vertex_count, lid) / (len(faces) - 1)
    angles = 2.0 * np.pi * np.arange(3) / 3.0
    corners = np.column_stack([np.cos(angles), np.sin(angles)])
    flat = share @ corners
    radius = 1.0 / np.sqrt(np.median((flat**2).sum(axis=1)) + 1e-12)
    points = np.column_stack([radius * flat, np.ones(len(flat))])
    points[faces[lid, [0, 2, 1]]] = np.column_stack([corners, np.full(3, -_DROP / (radius * len(faces)))])
    out: FloatArray = points / np.linalg.norm(points, axis=1)[:, None]
    return out
