"""Untangle folds by moving the few vertices around them, one after the other.

The signed areas of the faces around a vertex are linear in its position x, so the x that makes the smallest of them
(relative to the area each face has on the surface) as large as possible is a linear programme in three unknowns
(Freitag, Plassmann 2000). The vertex moves towards it no farther than needed, so angles elsewhere keep.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pgcp.folds.regions import Region
from pgcp.plane.mobius import rotation_to_north
from pgcp.plane.space import Space, find_folds
from pgcp.surface.operators import face_areas
from pgcp.surface.topology import rings_around
from pgcp.types import ComplexArray, FloatArray, IntArray, Mesh, Positions

_ROUNDS = 40
_IDLE_ROUNDS = 5
_MOST_FOLDS = 2000
_MOST_FRACTION = 0.005
_ALWAYS = 50
_ENOUGH = 0.1
_STEPS = np.linspace(0.05, 1.0, 20)
_LOWEST = 0.05
_MOST_ROWS = 1_000_000  # of all linear programmes together, each counted with _ROWS more: seconds
_ROWS = 400
_SMALLEST = 1e-290  # what a product of two relative numbers is divided by


def _star(faces: IntArray, face_ids: IntArray, vertex: int) -> tuple[IntArray, IntArray, IntArray]:
    """Faces around a vertex, and the two other corners of each, counter-clockwise."""
    around = face_ids[(faces[face_ids] == vertex).any(axis=1)]
    corner = np.argmax(faces[around] == vertex, axis=1)
    rows = np.arange(len(around))
    return around, faces[around][rows, (corner + 1) % 3], faces[around][rows, (corner + 2) % 3]


def _relative_areas(x: complex, p: ComplexArray, q: ComplexArray, extent: float, target: FloatArray) -> FloatArray:
    return np.imag(np.conj((p - x) / extent) * ((q - x) / extent)) / target


def _better_place(x: complex, p: ComplexArray, q: ComplexArray, surface: FloatArray) -> complex | None:
    """Nearby position where the smallest relative area around the vertex is larger, or None."""
    extent = float(np.abs(p - x).max())
    if not extent > _SMALLEST:
        return None
    # all in units of the extent: areas of the smallest stars are less than doubles can hold
    area = np.imag(np.conj((p - x) / extent) * ((q - x) / extent))
    size = float(np.abs(area).sum())
    if not size > _SMALLEST or not surface.sum() > 0:
        return None
    target = np.maximum(surface * (size / surface.sum()), 1e-9 * size)
    before = float(_relative_areas(x, p, q, extent, target).min())
    # unknowns d = (position - x) / extent and t: area(x) - d x (q - p) / extent >= t target
    side = (q - p) / extent
    rows = np.column_stack([side.imag, -side.real, target])
    scale = np.abs(rows).max(axis=1)
    from scipy.optimize import linprog

    solved = linprog(
        [0.0, 0.0, -1.0],
        A_ub=rows / scale[:, None],
        b_ub=area / scale,
        bounds=[(-2.0, 2.0), (-2.0, 2.0), (None, 1.0)],
        method="highs",
    )
    if not solved.success:
        return None
    goal = x + extent * complex(solved.x[0], solved.x[1])
    best = float(_relative_areas(goal, p, q, extent, target).min())
    wanted = min(0.5 * best, _ENOUGH) if best > 0 else before + 0.5 * (best - before)
    if not best > before:
        return None
    for step in _STEPS:
        place = x + step * (goal - x)
        if _relative_areas(place, p, q, extent, target).min() >= wanted:
            return complex(place)
    return goal


def _move_in_plane(z: ComplexArray, vertex: int, p: IntArray, q: IntArray, surface: FloatArray) -> complex | None:
    """Better place of a vertex in the plane, where a face around it is folded."""
    here, one, two = complex(z[vertex]), z[p], z[q]
    if (np.imag(np.conj(one - here) * (two - here)) > 0).all():
        return None
    return _better_place(here, one, two, surface)


def _move_on_sphere(points: FloatArray, vertex: int, p: IntArray, q: IntArray, surface: FloatArray) -> FloatArray | None:
    """The same on the sphere, in the gnomonic chart about the star: great circles are its straight lines."""
    star = np.vstack([points[vertex], points[p], points[q]])
    middle = star[1:].mean(axis=0)
    size = float(np.linalg.norm(middle))
    if not size > _LOWEST:
        return None
    rotation = rotation_to_north(middle / size)
    turned = star @ rotation.T
    if turned[:, 2].min() < _LOWEST:
        return None
    chart: ComplexArray = turned[:, 0] / turned[:, 2] + 1j * (turned[:, 1] / turned[:, 2])
    place = _move_in_plane(chart, 0, np.arange(len(p)) + 1, np.arange(len(q)) + 1 + len(p), surface)
    if place is None:
        return None
    moved = np.array([place.real, place.imag, 1.0]) @ rotation
    back: FloatArray = moved / np.linalg.norm(moved)
    return back


def untangle(space: Space, mesh: Mesh, region: Region, points: Positions) -> Positions:
    """Move the region's free vertices around folds until no face of it is folded, or no move helps.

    Returns new positions of its vertices, of the round that left fewest folds; it ends after some thousand moves. Many folds
    (over half a percent of the mesh's faces and over 50) are left as they are: then the map is wrong, and moving vertices would
    only hide it.
    """
    here = points[region.vertex_ids]
    folded = find_folds(space, region.faces, here)
    if not 0 < len(folded) <= min(_MOST_FOLDS, max(_ALWAYS, _MOST_FRACTION * len(mesh.faces))):
        return here
    best, idle = (len(folded), here.copy()), 0
    surface = face_areas(mesh.vertices[region.vertex_ids], region.faces)
    move: Any = _move_on_sphere if space.closed else _move_in_plane
    rows = 0
    for _ in range(_ROUNDS):
        vertices = np.unique(region.faces[folded])
        near = np.flatnonzero(rings_around(region.faces, folded, 1, len(here)))
        changed = False
        for vertex in vertices[~region.held[vertices]].tolist():
            around, p, q = _star(region.faces, near, vertex)
            rows += _ROWS + len(around)
            if rows > _MOST_ROWS:
                break
            place = move(here, vertex, p, q, surface[around])
            if place is not None:
                here[vertex] = place
                changed = True
        folded = find_folds(space, region.faces, here)
        if len(folded) < best[0]:
            best, idle = (len(folded), here.copy()), 0
        else:
            idle += 1
        if len(folded) == 0 or not changed or idle == _IDLE_ROUNDS or rows > _MOST_ROWS:
            break
    return best[1]
