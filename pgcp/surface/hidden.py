"""Where a cut shows least: how widely each vertex is seen from outside, and how sharp the creases are."""

from __future__ import annotations

import numpy as np

from pgcp.types import FloatArray, IntArray

_VIEWS, _PIXELS, _SAMPLES = 48, 96, 50_000
_BEHIND = 2.0  # pixels behind the foremost that still count as seen
_CREASE = 0.7
_KINDS = ((0.15, 1.0), (0.1, 2.0), (0.0, 0.0))  # what is added to how widely an edge is seen, to what power


def directions(count: int) -> FloatArray:
    """Unit vectors (count, 3) spread over the sphere (spherical Fibonacci points)."""
    k = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * k / count, np.pi * (1.0 + 5.0**0.5) * k
    across = np.sqrt(1.0 - z * z)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


def face_normals(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, FloatArray]:
    """Unit normals (F, 3), 0 where there is none, and areas (F,)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    length = np.linalg.norm(across, axis=1)
    return across / np.where(length > 0.0, length, 1.0)[:, None], 0.5 * length


def _samples(vertices: FloatArray, faces: IntArray, areas: FloatArray) -> FloatArray:
    """Points (N, 3) spread over the faces by area, always the same ones."""
    ends = np.cumsum(areas)
    at = (np.arange(_SAMPLES) + 0.5) / _SAMPLES * ends[-1]
    face = np.minimum(np.searchsorted(ends, at), len(faces) - 1)
    u, v = np.modf(np.arange(_SAMPLES) * 0.7548776662466927)[0], np.modf(np.arange(_SAMPLES) * 0.5698402909980532)[0]
    over = u + v > 1.0
    u, v = np.where(over, 1.0 - u, u), np.where(over, 1.0 - v, v)
    a, b, c = (vertices[faces[face, k]] for k in range(3))
    return np.asarray(a + u[:, None] * (b - a) + v[:, None] * (c - a))


def visibility(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """How widely each vertex (V,) is seen from outside: 0 from nowhere, 1 as one of a convex surface.

    A closed surface may be inside out.

    From 48 directions, by depth images of 96 x 96 pixels; a direction counts by the cosine with the vertex's normal.
    """
    normals, areas = face_normals(vertices, faces)
    # which side is outside: that to which the faces look away from their middle, on average
    middles = vertices[faces].mean(axis=1)
    middles -= np.average(middles, axis=0, weights=areas)
    normals *= -1.0 if float((normals * middles).sum(axis=1) @ areas) < 0.0 else 1.0
    of_vertex = np.zeros_like(vertices)
    for axis in range(3):
        of_vertex[:, axis] = sum(np.bincount(c, normals[:, axis] * areas, len(vertices)) for c in faces.T)
    of_vertex /= np.maximum(np.linalg.norm(of_vertex, axis=1), 1e-300)[:, None]
    used = np.zeros(len(vertices), bool)
    used[faces.reshape(-1)] = True
    points = np.concatenate([vertices[used], _samples(vertices, faces, areas)])
    size = float(np.ptp(points, axis=0).max())
    pixel = 1.02 * 3**0.5 * size / _PIXELS
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    seen, total = np.zeros(int(used.sum())), np.zeros(int(used.sum()))
    for towards in directions(_VIEWS):
        right = np.cross(towards, np.eye(3)[np.argmin(np.abs(towards))])
        right /= np.linalg.norm(right)
        up = np.cross(towards, right)
        place = ((points - middle) @ np.column_stack([right, up]) / pixel + 0.5 * _PIXELS).astype(np.int64)
        depth, cell = (points - middle) @ towards, place[:, 0] * _PIXELS + place[:, 1]
        foremost = np.full(_PIXELS * _PIXELS, -np.inf)
        np.maximum.at(foremost, cell, depth)
        facing = np.maximum(of_vertex[used] @ towards, 0.0)
        slope = np.sqrt(np.maximum(1.0 / np.maximum(facing, 0.2) ** 2 - 1.0, 0.0))  # depth across a pixel of the vertex's plane
        front = depth[: len(seen)] >= foremost[cell[: len(seen)]] - (_BEHIND + slope) * pixel
        seen += facing * front
        total += facing
    out = np.zeros(len(vertices))
    out[used] = seen / np.maximum(total, 1e-300)
    return out


def edge_costs(
    vertices: FloatArray, faces: IntArray, ends: IntArray, halves: IntArray, seen: FloatArray, kind: int = 0
) -> FloatArray:
    """What a cut along each edge (E,) costs: its length, by how widely it is seen, and less where it is sharp.

    seen (V,): ``visibility``. kind: 0, length times 0.15 plus how widely it is seen; 1, times 0.1 plus the square of that; 2,
    length alone. In all an edge whose faces stand at right angles costs 0.3 of one in a flat place. ends (E, 2), halves (E, 2)
    of ``EdgeGraph``.
    """
    length = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1)
    normals, _ = face_normals(vertices, faces)
    one, two = halves[:, 0] // 3, np.maximum(halves[:, 1], 0) // 3
    bend = np.arccos(np.clip((normals[one] * normals[two]).sum(axis=1), -1.0, 1.0))
    crease = np.where(halves[:, 1] >= 0, np.clip(bend / (0.5 * np.pi), 0.0, 1.0), 0.0)
    plain, power = _KINDS[kind]
    costs = length * (plain + seen[ends].mean(axis=1) ** power) * (1.0 - _CREASE * crease)
    return np.asarray(np.maximum(costs, 1e-6 * max(float(costs.mean()), 1e-300)))
