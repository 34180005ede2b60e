"""Is it a map without folds? Seen without the product's code, on the coordinates that were written."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from surfaces import Array

_EPS = float(np.finfo(np.float64).eps)
_SMALL = 1e-280  # below it products may have lost digits


def flipped_in_plane(points: Array, faces: Array) -> int:
    """How many faces have no positive area in the plane: by the sign of the area, exactly where rounding might change it."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        u, v = b - a, c - a
        left, right = u[:, 0] * v[:, 1], u[:, 1] * v[:, 0]
        sure = np.abs(left - right) > 8 * _EPS * (np.abs(left) + np.abs(right)) + _SMALL
        flipped = ~(left - right > 0)
    for f in np.flatnonzero(~sure):
        (ax, ay), (bx, by), (cx, cy) = ([Fraction(x) for x in points[v].tolist()] for v in faces[f])
        flipped[f] = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) <= 0
    return int(flipped.sum())


def flipped_on_sphere(points: Array, faces: Array) -> int:
    """How many spherical triangles do not face outwards: by the sign of det(a, b, c), exactly where it may be rounding."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    terms = np.stack([s * a[:, i] * b[:, j] * c[:, k] for s, i, j, k in _TERMS])
    value, size = terms.sum(axis=0), np.abs(terms).sum(axis=0)
    flipped = ~(value > 0)
    for f in np.flatnonzero(~(np.abs(value) > 16 * _EPS * size + _SMALL)):
        p, q, r = ([Fraction(x) for x in points[v].tolist()] for v in faces[f])
        flipped[f] = sum(s * p[i] * q[j] * r[k] for s, i, j, k in _TERMS) <= 0
    return int(flipped.sum())


_TERMS = [(1, 0, 1, 2), (1, 1, 2, 0), (1, 2, 0, 1), (-1, 0, 2, 1), (-1, 2, 1, 0), (-1, 1, 0, 2)]


def covered(points: Array, faces: Array) -> float:
    """How often the sphere is covered by the spherical triangles (van Oosterom, Strackee 1983)."""
    points = points / np.linalg.norm(points, axis=1)[:, None]
    a, b, c = (points[faces[:, k]] for k in range(3))
    volume = np.einsum("fd,fd->f", np.cross(b - a, c - a), a)
    across = 1 + np.einsum("fd,fd->f", a, b) + np.einsum("fd,fd->f", b, c) + np.einsum("fd,fd->f", c, a)
    return float(2 * np.arctan2(volume, across).sum() / (4 * np.pi))


def boundary_of(faces: Array) -> Array:
    """Vertices of the boundary loop, in the order in which faces run along it."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    both = {(b, a) for a, b in edges.tolist()}
    after = {a: b for a, b in edges.tolist() if (a, b) not in both}
    loop = [next(iter(after))]
    while (vertex := after[loop[-1]]) != loop[0]:
        loop.append(vertex)
    return np.array(loop)


def corner_angles(points: Array, faces: Array) -> Array:
    """Angles (F, 3) of triangles in space or in the plane, degrees; NaN where a face has edges of no length."""
    out = []
    with np.errstate(divide="ignore", invalid="ignore"):
        p = points[faces]
        size = np.abs(p - p[:, :1]).max(axis=(1, 2), keepdims=True)
        p = (p - p[:, :1]) / size
        for k in range(3):
            u, v = p[:, (k + 1) % 3] - p[:, k], p[:, (k + 2) % 3] - p[:, k]
            u = u / np.linalg.norm(u, axis=1)[:, None]
            v = v / np.linalg.norm(v, axis=1)[:, None]
            out.append(2 * np.degrees(np.arctan2(np.linalg.norm(u - v, axis=1), np.linalg.norm(u + v, axis=1))))
    return np.column_stack(out)


def mean_error(vertices: Array, faces: Array, image: Array) -> float:
    """Mean |angle in the map - angle on the surface|, degrees, over the corners of faces that have angles."""
    errors = np.abs(corner_angles(image, faces) - corner_angles(vertices, faces))
    known = errors[np.isfinite(errors).all(axis=1)]
    return float(known.mean()) if len(known) else 0.0


def faults_of(points: Array, faces: Array, target: str, used: Array) -> list[str]:
    """What is wrong with a map's coordinates, as phrases; empty where it is right."""
    if not np.isfinite(points).all():
        return [f"{int((~np.isfinite(points)).sum())} coordinates are not finite"]
    faults = []
    if target == "sphere":
        off = float(np.abs(np.linalg.norm(points, axis=1) - 1).max())
        if off > 1e-14:
            faults.append(f"off the sphere by {off:.0e}")
        if folds := flipped_on_sphere(points, faces):
            return [*faults, f"{folds} folds"]
        if abs(covered(points, faces) - 1) > 1e-6:
            faults.append(f"the sphere is covered {covered(points, faces):.3f} times")
        return faults
    if folds := flipped_in_plane(points, faces):
        return [f"{folds} folds"]
    if target == "disk":
        loop = points[boundary_of(faces)]
        off = float(np.abs(np.linalg.norm(loop, axis=1) - 1).max())
        if off > 1e-12:
            faults.append(f"the boundary is off the circle by {off:.0e}")
        if np.linalg.norm(points[used], axis=1).max() > 1 + 1e-12:
            faults.append("vertices lie outside the disk")
        turn = np.diff(np.arctan2(*np.vstack([loop, loop[:1]]).T[::-1])) % (2 * np.pi)
        if (turn <= 0).any() or abs(turn.sum() - 2 * np.pi) > 1e-6:
            faults.append("the boundary does not run once around the circle")
    return faults
