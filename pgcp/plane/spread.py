"""Points spread over a map with prescribed distances: centroidal Voronoi tessellations under a density.

Du, Faber, Gunzburger (1999): in a tessellation whose points are the centroids of their cells under the density h^-4, points
are about h apart. Lloyd's iteration moves each point to the centroid of its cell.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from pgcp.types import FloatArray, IntArray

_STEEPEST = 2.0  # logarithm of how much the density may differ within a cell
_FARTHEST = 0.45  # of the distance to its neighbours that a point is moved at once
_CAREFUL, _BEYOND = 3, 1.5  # after some steps points are moved beyond the centroid, which moves on, too


def even_start(samples: FloatArray, count: int) -> IntArray:
    """Which ``count`` of some samples (M, d), at least as many, are about as dense as all.

    A balanced tree parts them into groups of equal number; one of the middle of each is taken.
    """
    per_group = len(samples) // count
    groups = cKDTree(samples, leafsize=max(per_group, 1)).indices[: count * per_group].reshape(count, per_group)
    middles = samples[groups].mean(axis=1, keepdims=True)
    nearest = ((samples[groups] - middles) ** 2).sum(axis=2).argmin(axis=1)
    return groups[np.arange(count), nearest]


def to_centroids(points: FloatArray, faces: IntArray, spacing: FloatArray) -> FloatArray:
    """From each point (N, d) to the centroid of its Voronoi cell (N, d), under the density spacing^-4.

    faces (F, 3): Delaunay triangles; spacing (N,) is positive and taken to change by a constant factor along each edge. Cells
    of points at the rim of the triangles are cut off there. 0 for points in no triangle.
    """
    corners = points[faces]
    log_density = -4.0 * np.log(spacing)[faces]
    sides = [corners[:, (k + 2) % 3] - corners[:, (k + 1) % 3] for k in range(3)]  # opposite to corner k
    square = np.stack([np.einsum("fd,fd->f", side, side) for side in sides], axis=1)
    dots = np.stack([-np.einsum("fd,fd->f", sides[(k + 1) % 3], sides[(k + 2) % 3]) for k in range(3)], axis=1)
    double = np.sqrt(np.maximum(square[:, 1] * square[:, 2] - dots[:, 0] ** 2, 0.0))
    cot = dots / np.maximum(double, 1e-300)[:, None]
    share = square * dots
    share /= np.maximum(np.abs(share.sum(axis=1, keepdims=True)), 1e-300)  # barycentric coordinates of the circumcentre
    mass, moment = np.zeros(len(points)), np.zeros_like(points)
    for i in range(3):
        for j, k in (((i + 1) % 3, (i + 2) % 3), ((i + 2) % 3, (i + 1) % 3)):
            half = 0.5 * (corners[:, j] - corners[:, i])
            centre = share[:, j, None] * (corners[:, j] - corners[:, i]) + share[:, k, None] * (corners[:, k] - corners[:, i])
            area = square[:, k] * cot[:, k] / 8.0
            own = log_density[:, i]
            middle = np.exp(np.clip(0.5 * (log_density[:, j] - own), -_STEEPEST, _STEEPEST))
            inner = np.exp(np.clip(log_density.mean(axis=1) - own, -_STEEPEST, _STEEPEST))
            mass += np.bincount(faces[:, i], area * (1.0 + middle + inner) / 3.0, len(points))
            for_half, for_centre = 1.0 + 2.0 * middle + inner, 1.0 + middle + 2.0 * inner
            parts = (area / 12.0)[:, None] * (for_half[:, None] * half + for_centre[:, None] * centre)
            for d in range(parts.shape[1]):
                moment[:, d] += np.bincount(faces[:, i], parts[:, d], len(points))
    return np.where((mass > 0.0)[:, None], moment / np.where(mass > 0.0, mass, 1.0)[:, None], 0.0)


def relaxed(
    points: FloatArray,
    fixed: int,
    move: Callable[[FloatArray], FloatArray],
    settled: Callable[[FloatArray, FloatArray], FloatArray],
    steps: int,
) -> FloatArray:
    """Points (N, d) moved ``steps`` times, all but the first ``fixed``.

    move(points): the way of each (N, d) to its centroid; settled(before, after): where moved points come to lie.
    """
    for step in range(steps):
        way = move(points) * (1.0 if step < _CAREFUL else _BEYOND)
        way[:fixed] = 0.0
        points = settled(points, points + way)
    return points


def shortened(ways: FloatArray, spacing: FloatArray) -> FloatArray:
    """Ways (N, d) that are no longer than a share of the distance (N,) between points."""
    length = np.linalg.norm(ways, axis=1)
    return ways * np.minimum(1.0, _FARTHEST * spacing / np.maximum(length, 1e-300))[:, None]
