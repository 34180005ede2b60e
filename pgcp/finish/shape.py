"""How well a triangle mesh is shaped, and how far two meshes are apart."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from pgcp.surface.distortion import corner_angles
from pgcp.surface.operators import face_areas
from pgcp.types import FloatArray, IntArray, Mesh

_POINTS, _TRIED = 30_000, 8
_BLOCK = 20_000  # points at once


def diagonal(mesh: Mesh) -> float:
    """Length of the diagonal of the box around the vertices that faces use."""
    return float(np.linalg.norm(np.ptp(mesh.vertices[np.unique(mesh.faces)], axis=0)))


def edge_lengths(mesh: Mesh) -> FloatArray:
    """Lengths (E,) of the edges, each once."""
    ends = np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    keys = np.unique(ends[:, 0] << 32 | ends[:, 1])
    return np.asarray(np.linalg.norm(mesh.vertices[keys >> 32] - mesh.vertices[keys & 0xFFFFFFFF], axis=1))


def shape_record(mesh: Mesh) -> dict[str, float | int]:
    """Counts, the median and least of the faces' smallest angles in degrees, mean and coefficient of variation of edge lengths.

    Faces without area count with angle 0.
    """
    angles = np.degrees(corner_angles(mesh.vertices, mesh.faces).min(axis=1))
    lengths = edge_lengths(mesh)
    mean = float(lengths.mean())
    return {
        "vertices": len(np.unique(mesh.faces)),
        "faces": len(mesh.faces),
        "min_angle_median_deg": float(np.median(angles)),
        "min_angle_least_deg": float(angles.min()),
        "edge_mean": mean,
        "edge_variation": float(lengths.std() / mean) if mean > 0.0 else 0.0,
    }


def _points_on(mesh: Mesh, count: int, seed: int) -> tuple[FloatArray, IntArray]:
    """Places on a mesh (n, 3), ``count`` evenly by area and up to as many vertices, and a face (n,) of each."""
    rng = np.random.default_rng(seed)
    total = np.cumsum(face_areas(mesh.vertices, mesh.faces))
    found = np.searchsorted(total, (np.arange(count) + rng.random(count)) / count * total[-1])
    found = np.minimum(found, len(mesh.faces) - 1)
    inner = np.einsum("nk,nkd->nd", rng.dirichlet([1.0, 1.0, 1.0], count), mesh.vertices[mesh.faces[found]])
    used, first = np.unique(mesh.faces.reshape(-1), return_index=True)
    some = slice(None, None, len(used) // count + 1)
    return np.vstack([inner, mesh.vertices[used[some]]]), np.concatenate([found, first[some] // 3])


def _farthest(points: FloatArray, samples: FloatArray, face_of: IntArray, mesh: Mesh) -> float:
    """Largest distance of points (n, 3) from a mesh: to the nearest of the faces on which the nearest samples lie."""
    from trimesh.triangles import closest_point

    tree, corners, worst = cKDTree(samples), mesh.vertices[mesh.faces], 0.0
    for start in range(0, len(points), _BLOCK):
        some = points[start : start + _BLOCK]
        faces = face_of[tree.query(some, min(_TRIED, len(samples)))[1].reshape(len(some), -1)]
        again = np.repeat(some, faces.shape[1], axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            nearest = closest_point(corners[faces.reshape(-1)], again)
        distance = np.linalg.norm(nearest - again, axis=1).reshape(faces.shape)
        worst = max(worst, float(np.nanmin(distance, axis=1).max()))
    return worst


def hausdorff_distance(one: Mesh, two: Mesh, count: int = _POINTS, seed: int = 0) -> tuple[float, float]:
    """How far mesh ``one`` comes from ``two`` at most, and ``two`` from ``one``; the larger is the Hausdorff distance.

    Sampled: at ``count`` points of each, evenly by area, and up to as many of its vertices. The distance of a point is that to
    the nearest of the faces on which the eight nearest of the other's points lie.
    """
    places = [_points_on(mesh, count, seed) for mesh in (one, two)]
    return _farthest(places[0][0], *places[1], two), _farthest(places[1][0], *places[0], one)
