"""Repair folds in a finished map by moving the few vertices around them.

The signed areas of the faces around a vertex are linear in its position x, so the x that makes the smallest of them
(relative to the area each face has on the surface) as large as possible is a linear programme in three unknowns
(Freitag, Plassmann 2000). The vertex moves towards it no farther than needed, so angles elsewhere keep.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from pgcp.beltrami import folded_faces, folded_faces_on_sphere
from pgcp.mobius import rotation_to_north
from pgcp.operators import face_areas
from pgcp.types import ComplexArray, FloatArray, IntArray, Mesh, Positions

_ROUNDS = 40
_IDLE_ROUNDS = 5
_MOST_FOLDS = 2000
_MOST_FRACTION = 0.005
_ALWAYS = 50
_ENOUGH = 0.1
_STEPS = np.linspace(0.05, 1.0, 20)
_LOWEST = 0.05


@dataclass(frozen=True, slots=True)
class Repair:
    """What a repair did: folds before and after, vertices moved."""

    method: str
    folds_before: int
    folds_after: int
    moved_vertices: int


def _star(faces: IntArray, face_ids: IntArray, vertex: int) -> tuple[IntArray, IntArray, IntArray]:
    """Faces around a vertex, and the two other corners of each, counter-clockwise."""
    around = face_ids[(faces[face_ids] == vertex).any(axis=1)]
    corner = np.argmax(faces[around] == vertex, axis=1)
    rows = np.arange(len(around))
    return around, faces[around][rows, (corner + 1) % 3], faces[around][rows, (corner + 2) % 3]


def _relative_areas(x: complex, p: ComplexArray, q: ComplexArray, target: FloatArray) -> FloatArray:
    return np.imag(np.conj(p - x) * (q - x)) / target


def _better_place(x: complex, p: ComplexArray, q: ComplexArray, surface: FloatArray) -> complex | None:
    """Nearby position where the smallest relative area around the vertex is larger, or None."""
    area = np.imag(np.conj(p - x) * (q - x))
    size = float(np.abs(area).sum())
    if not size > 0 or not surface.sum() > 0:
        return None
    target = np.maximum(surface * (size / surface.sum()), 1e-9 * size)
    before = float(_relative_areas(x, p, q, target).min())
    # scaled unknowns d = (position - x) / extent and t: area(x) - d x (q - p) extent >= t target
    extent = float(np.abs(p - x).max())
    side = (q - p) * extent
    rows = np.column_stack([side.imag, -side.real, target])
    scale = np.abs(rows).max(axis=1)
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
    best = float(_relative_areas(goal, p, q, target).min())
    wanted = min(0.5 * best, _ENOUGH) if best > 0 else before + 0.5 * (best - before)
    if not best > before:
        return None
    for step in _STEPS:
        place = x + step * (goal - x)
        if _relative_areas(place, p, q, target).min() >= wanted:
            return complex(place)
    return goal


def _fold_list(faces: IntArray, points: Positions) -> IntArray:
    return folded_faces(faces, points) if points.ndim == 1 else folded_faces_on_sphere(faces, points)


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
    rotation = rotation_to_north(middle / np.linalg.norm(middle))
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


def repair_folds(mesh: Mesh, points: Positions, fixed: IntArray) -> tuple[Positions, IntArray, Repair | None]:
    """Move vertices of folded faces until no face is folded, or no move helps.

    points: complex (V,) in the plane or unit vectors (V, 3); fixed: vertices that must stay. Returns new positions, the
    faces (sorted) whose image changed, and what was done: None where there was no fold. Many folds (over half a percent of
    the faces and over 50) are left as they are: then the map is wrong, and moving vertices would only hide it.
    """
    folded = _fold_list(mesh.faces, points)
    before = len(folded)
    if before == 0:
        return points, folded, None
    moved: set[int] = set()
    if before <= min(_MOST_FOLDS, max(_ALWAYS, _MOST_FRACTION * len(mesh.faces))):
        best: tuple[int, Positions, set[int]] = before, points, set()
        points = points.copy()
        surface = face_areas(mesh.vertices, mesh.faces)
        move = _move_in_plane if points.ndim == 1 else _move_on_sphere
        idle = 0
        for _ in range(_ROUNDS):
            vertices = np.unique(mesh.faces[folded])
            near = np.flatnonzero(np.isin(mesh.faces, vertices).any(axis=1))
            changed = False
            for vertex in np.setdiff1d(vertices, fixed).tolist():
                around, p, q = _star(mesh.faces, near, vertex)
                place = move(points, vertex, p, q, surface[around])
                if place is not None:
                    points[vertex] = place
                    moved.add(vertex)
                    changed = True
            folded = _fold_list(mesh.faces, points)
            if len(folded) < best[0]:
                best, idle = (len(folded), points.copy(), set(moved)), 0
            else:
                idle += 1
            if len(folded) == 0 or not changed or idle == _IDLE_ROUNDS:
                break
        left, points, moved = best
    else:
        left = before
    touched = np.flatnonzero(np.isin(mesh.faces, np.array(sorted(moved), np.int64)).any(axis=1))
    return points, touched, Repair("local untangling", before, left, len(moved))
