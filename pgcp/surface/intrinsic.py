"""Intrinsic Delaunay triangulations: the same surface and vertices, edges flipped on the surface (Bobenko, Springborn 2007).

Their cotangent weights are not negative. Where faces are needles, harmonic functions that are linear on these triangles are far
more accurate than those that are linear on the faces (Sharp, Soliman, Crane 2019).
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from scipy.sparse import csr_array

from pgcp.surface.operators import corner_weights, edge_laplacian
from pgcp.types import FloatArray, IntArray, Mesh

_TOLERANCE = 1e-10
_MOST_FLIPS = 20  # per half-edge; many times what any surface has needed


@dataclass(frozen=True, slots=True, eq=False)
class Intrinsic:
    """An intrinsic triangulation: triangles (F, 3) in the mesh's vertices, and how many flips led to it.

    lengths (F, 3): of the edge from each corner to the next. A pair of vertices may have several edges between them.
    """

    faces: IntArray
    lengths: FloatArray
    flips: int

    def laplacian(self, vertex_count: int) -> csr_array:
        """Its cotangent Laplacian (n, n), with the sign of ``operators.cotangent_laplacian``; its weights are not negative."""
        tails, heads = self.faces.reshape(-1), self.faces[:, [1, 2, 0]].reshape(-1)
        return edge_laplacian(tails, heads, 0.5 * _cotangents(self.lengths).reshape(-1), vertex_count)


def share_not_delaunay(mesh: Mesh, twins: IntArray, mollification: float) -> float:
    """Which part of the inner edges has a negative cotangent weight, 0 to 1."""
    opposite = corner_weights(mesh.vertices, mesh.faces, mollification)[:, [2, 0, 1]].reshape(
        -1
    )  # of the edge from a corner on
    inner = np.flatnonzero(twins > np.arange(len(twins)))
    return float(np.mean(opposite[inner] + opposite[twins[inner]] < -_TOLERANCE)) if len(inner) else 0.0


def intrinsic_delaunay(mesh: Mesh, twins: IntArray, mollification: float) -> Intrinsic:
    """Flip edges until every one has a cotangent weight of 0 or more.

    twins (3F,): the other half of the half-edge from each corner to the next, negative on the boundary. All edges are taken
    longer by ``mollification``, which keeps faces without area apart (Sharp, Crane 2020).
    """
    faces, corners = mesh.faces.astype(np.int64), mesh.vertices[mesh.faces]
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2) + mollification
    flips = _flip(faces.reshape(-1), lengths.reshape(-1), twins.astype(np.int64), _MOST_FLIPS * len(twins))
    return Intrinsic(faces, lengths, int(flips))


def _cotangents(lengths: FloatArray) -> FloatArray:
    """Cotangents (F, 3) of the corners opposite to edges of these lengths (F, 3)."""
    c, b, a = np.sort(lengths, axis=1).T
    # Heron's formula as Kahan orders it
    four_areas = np.sqrt(np.maximum((a + (b + c)) * (c - (a - b)) * (c + (a - b)) * (a + (b - c)), np.finfo(np.float64).tiny))
    square = lengths**2
    out: FloatArray = (square.sum(axis=1, keepdims=True) - 2.0 * square) / four_areas[:, None]
    return out


@numba.njit(cache=True, nogil=True)
def _cotangent(a: float, b: float, c: float) -> float:
    """Cotangent of the corner opposite to the edge a of a triangle."""
    half = 0.5 * (a + b + c)
    area = np.sqrt(max(half * (half - a) * (half - b) * (half - c), 1e-300))
    return (b * b + c * c - a * a) / (4.0 * area)


@numba.njit(cache=True, nogil=True)
def _flip(ends: IntArray, length: FloatArray, twins: IntArray, most: int) -> int:
    """Flip the edges of triangles in place, by half-edges: where they start, their lengths and twins. Returns how often."""
    count = length.shape[0]
    queue, waiting = np.arange(count), np.ones(count, np.bool_)
    first, size, flips = 0, count, 0
    new, outer, before = np.empty(4, np.int64), np.empty(4, np.int64), np.empty(4, np.int64)
    start, long = np.empty(4, np.int64), np.empty(4)
    while size > 0 and flips < most:
        h = queue[first]
        first, size = (first + 1) % count, size - 1
        waiting[h] = False
        g = twins[h]
        if g < 0 or h // 3 == g // 3:
            continue
        h1, h2 = h - h % 3 + (h + 1) % 3, h - h % 3 + (h + 2) % 3
        g1, g2 = g - g % 3 + (g + 1) % 3, g - g % 3 + (g + 2) % 3
        a = length[h]
        if _cotangent(a, length[h1], length[h2]) + _cotangent(a, length[g1], length[g2]) >= -_TOLERANCE:
            continue
        # the two triangles in the plane, the edge along the axis from 0
        x, u = (a * a + length[h2] ** 2 - length[h1] ** 2) / (2.0 * a), (a * a + length[g1] ** 2 - length[g2] ** 2) / (2.0 * a)
        y = np.sqrt(max(length[h2] ** 2 - x * x, 0.0))
        v = -np.sqrt(max(length[g1] ** 2 - u * u, 0.0))
        across = np.sqrt((x - u) ** 2 + (y - v) ** 2)
        left, right = h - h % 3, g - g % 3
        before[:] = (g2, h1, h2, g1)  # around the four sides: to the head of h, from it, and so on
        new[:] = (left + 1, left + 2, right + 1, right + 2)
        for k in range(4):
            outer[k], start[k], long[k] = twins[before[k]], ends[before[k]], length[before[k]]
        apex, foot = ends[h2], ends[g2]
        ends[left], ends[right] = apex, foot
        length[left] = length[right] = across
        twins[left], twins[right] = right, left
        for k in range(4):
            ends[new[k]], length[new[k]], twins[new[k]] = start[k], long[k], outer[k]
        for k in range(4):
            t = outer[k]
            for j in range(4):
                if t == before[j]:  # a triangle glued to itself or to the other twice
                    t = new[j]
                    break
            twins[new[k]] = t
            if t >= 0:
                twins[t] = new[k]
        flips += 1
        for k in range(4):
            if not waiting[new[k]]:
                waiting[new[k]] = True
                queue[(first + size) % count] = new[k]
                size += 1
    return flips
