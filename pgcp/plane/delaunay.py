"""Delaunay triangulations of points in the plane and on the sphere, and of what a closed polygon of the plane encloses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, QhullError, cKDTree

from pgcp.errors import NumericalError
from pgcp.types import BoolArray, FloatArray, IntArray

_RESOLVED, _ROOM = 1e-5, 64.0
_NEIGHBOURS = 6


def planar_delaunay(points: FloatArray) -> IntArray:
    """Counter-clockwise Delaunay triangles (F, 3) of points (N, 2), which may lie close in some places and far apart in others.

    Doubles tell which circles are empty where points are no closer than some 1e-6 of what they span. Closer ones are magnified
    and triangulated by themselves; of these triangles those with such points are taken. Points at one place are in none.
    Raises NumericalError where all points lie on a line.
    """
    low, span = points.min(axis=0), float(np.ptp(points, axis=0).max())
    try:  # Qhull's triangles are counter-clockwise as neighbours agree, whatever the rounded areas of slivers are
        faces = Delaunay((points - low) / max(span, 1e-300)).simplices.astype(np.int64)
    except (QhullError, ValueError) as problem:
        raise NumericalError(f"{len(points)} points of the map cannot be triangulated") from problem
    if len(points) > _NEIGHBOURS:
        apart = cKDTree(points).query(points, [_NEIGHBOURS + 1])[0][:, 0]
        for some, own in _magnified(points, np.flatnonzero(apart < _RESOLVED * span), _ROOM * _RESOLVED * span):
            if 0.0 < float(np.ptp(points[some], axis=0).max()) < 0.5 * span:
                local = some[planar_delaunay(points[some])]
                faces = np.vstack([faces[~own[faces].any(axis=1)], local[own[local].any(axis=1)]])
    return faces


def _magnified(points: FloatArray, close: IntArray, room: float) -> Iterator[tuple[IntArray, BoolArray]]:
    """Groups of close points: all points in a box around each that leaves room, and which (N,) are in the group."""
    if not len(close):
        return
    cells, cell_of = np.unique(np.floor((points[close] - points[close].min(axis=0)) / room), axis=0, return_inverse=True)
    pairs = cKDTree(cells).query_pairs(1.5, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), (len(cells), len(cells)))
    count, label = connected_components(graph, directed=False)
    group = label[cell_of.reshape(-1)]
    for k in range(count):
        members = close[group == k]
        low, high = points[members].min(axis=0) - room, points[members].max(axis=0) + room
        own = np.zeros(len(points), bool)
        own[members] = True
        yield np.flatnonzero(((points >= low) & (points <= high)).all(axis=1)), own


def spherical_delaunay(points: FloatArray, pole: int = 0) -> IntArray:
    """Delaunay triangles (F, 3) of unit vectors (N, 3), counter-clockwise from outside: the faces of their convex hull.

    The stereographic projection from one of the points keeps circles. The triangles without that point are those of the
    others in the plane; those with it stand on the edges of their hull. ``pole`` is best where points are far apart.
    """
    others = np.delete(np.arange(len(points)), pole)
    north = points[pole]
    across = np.eye(3)[int(np.argmin(np.abs(north)))]
    right = np.cross(across, north)
    right /= np.linalg.norm(right)
    forward = np.cross(north, right)
    away = points[others] - north
    height = 0.5 * np.einsum("nk,nk->n", away, away)  # 1 - cos, without cancellation
    flat = np.column_stack([points[others] @ forward, points[others] @ right]) / np.maximum(height, 1e-300)[:, None]
    faces = planar_delaunay(flat)
    tails, heads = _rim(faces)
    fan = np.column_stack([heads, tails, np.full(len(tails), len(others))])
    return np.append(others, pole)[np.vstack([faces, fan])]


def _keys(tails: IntArray, heads: IntArray) -> IntArray:
    """One number for each directed edge."""
    return tails.astype(np.int64) * (1 << 32) + heads


def _half_edges(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Tails and heads (3 F,) of the half-edges of faces: face by face, from each corner to the next."""
    return faces.reshape(-1), faces[:, [1, 2, 0]].reshape(-1)


def _rim(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Tails and heads of the half-edges that have no other half."""
    tails, heads = _half_edges(faces)
    alone = ~np.isin(_keys(heads, tails), _keys(tails, heads))
    return tails[alone], heads[alone]


def enclosed(faces: IntArray, count: int) -> tuple[IntArray, IntArray]:
    """Those of the triangles (F, 3) that the polygon of the first ``count`` points encloses, and edges that they have not.

    The polygon runs counter-clockwise; edges are named by their first point. Where some are missing, triangles may be too many.
    """
    tails, heads = _half_edges(faces)
    keys = _keys(tails, heads)
    first = np.arange(count)
    inner, outer = _keys(first, (first + 1) % count), _keys((first + 1) % count, first)
    missing = np.flatnonzero(~np.isin(inner, keys))
    order = np.argsort(keys)
    twin = _keys(heads, tails)
    place = np.minimum(np.searchsorted(keys[order], twin), len(keys) - 1)
    joined = (keys[order[place]] == twin) & ~np.isin(keys, inner) & ~np.isin(keys, outer)
    one, two = np.flatnonzero(joined) // 3, order[place[joined]] // 3
    graph = coo_array((np.ones(len(one), np.int8), (one, two)), (len(faces), len(faces)))
    label = connected_components(graph, directed=False)[1]
    inside = np.unique(label[np.flatnonzero(np.isin(keys, inner)) // 3])
    return faces[np.isin(label, inside)], missing
