"""Quads from a regular lattice in the map: squares of the plane, or the cubed sphere; squares stay square on the surface."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from pgcp.errors import InputError
from pgcp.finish.resample import Resampled, Sheet, triangulated_within
from pgcp.types import FloatArray, IntArray, Source

_APART = 0.55  # of the lattice's step from the boundary
_LEAN = 1e-3  # a shear
_FINE = 12  # points of the boundary for each step, to measure distances from it


def quads_of_plane(sheet: Sheet, step: float, angle: float) -> tuple[Resampled, Source]:
    """Squares of side ``step`` in the map, turned by ``angle`` (radians), and triangles between them and the boundary.

    The boundary has points about ``step`` apart in the map, and its corners. Raises InputError where no square has room.
    """
    assert sheet.rim is not None
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned = sheet.image @ turn.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    counts = np.maximum(np.ceil((high - low) / step), 1).astype(np.int64)
    origin = low + 0.5 * (high - low - step * counts)
    i, j = (k.ravel() for k in np.meshgrid(*(np.arange(n + 1) for n in counts.tolist()), indexing="ij"))
    nodes = np.column_stack([i, j])
    places = (origin + step * nodes) @ turn
    lengths = sheet.rim.spaced_in_map(step)
    fine = sheet.rim.at(np.linspace(0.0, sheet.rim.ends[-1], _FINE * len(lengths), endpoint=False))[1]
    fine = np.vstack([fine, sheet.rim.image])
    inside = sheet.locator.find(places, sheet.vertices).inside
    inside[inside] = cKDTree(fine).query(places[inside])[0] >= _APART * step
    made = triangulated_within(sheet, lengths, places[inside], _LEAN)
    return made, _merged(made, origin, step, turn)


def _merged(made: Resampled, origin: FloatArray, step: float, turn: FloatArray) -> Source:
    """Pairs of triangles that make a square of the lattice as quads, then all other triangles."""
    exact = (made.image @ turn.T - origin) / step
    nodes = np.rint(exact).astype(np.int64)
    on_lattice = np.abs(exact - nodes).max(axis=1) < 1e-6
    on_lattice[: made.rim] = False
    corners = nodes[made.faces]
    low = corners.min(axis=1)
    within = on_lattice[made.faces].all(axis=1) & (corners.max(axis=1) - low == 1).all(axis=1)
    candidates = np.flatnonzero(within)
    _, cell, times = np.unique(low[candidates], axis=0, return_inverse=True, return_counts=True)
    cell = cell.reshape(-1)
    paired = candidates[times[cell] == 2]
    order = paired[np.argsort(cell[times[cell] == 2], kind="stable")].reshape(-1, 2)
    if not len(order):
        raise InputError("no square of the lattice has room in the map; take shorter edges or more vertices")
    quads = np.array([_quad(*made.faces[pair].tolist()) for pair in order], np.int64)
    others = np.delete(made.faces, order.reshape(-1), axis=0)
    ends = np.cumsum(np.concatenate([np.full(len(quads), 4), np.full(len(others), 3)]))
    return Source(made.points, np.concatenate([quads.reshape(-1), others.reshape(-1)]), np.append(0, ends))


def _quad(one: list[int], two: list[int]) -> list[int]:
    """The corners of two triangles with a common edge, around both."""
    own = next(k for k in range(3) if one[k] not in two)
    other = next(v for v in two if v not in one)
    return [one[own], one[(own + 1) % 3], other, one[(own + 2) % 3]]


def cubed_sphere(across: int) -> tuple[FloatArray, IntArray]:
    """Unit vectors (6 n^2 + 2, 3) and quads (6 n^2, 4), counter-clockwise from outside: n = ``across`` along a cube's edge.

    Lines are at even angles (Ronchi, Iacono, Paolucci 1996).
    """
    ticks = np.rint(np.linspace(-across, across, across + 1)).astype(np.int64)
    a, b = np.meshgrid(np.arange(across), np.arange(across), indexing="ij")
    parts = []
    for axis in range(3):
        for side in (-1, 1):
            quad = np.stack([np.stack([a + p, b + q], axis=-1) for p, q in ((0, 0), (1, 0), (1, 1), (0, 1))], axis=2)
            place = np.empty((across, across, 4, 3), np.int64)
            place[..., axis] = side * across
            place[..., (axis + 1) % 3], place[..., (axis + 2) % 3] = ticks[quad[..., 0]], ticks[quad[..., 1]]
            parts.append(place.reshape(-1, 4, 3)[:, ::side])
    corners = np.concatenate(parts)
    nodes, quads = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    points = np.tan(0.25 * np.pi * nodes / across)
    return points / np.linalg.norm(points, axis=1)[:, None], quads.reshape(-1, 4)


def quads_of_sphere(sheet: Sheet, across: int) -> tuple[Resampled, Source]:
    """The cubed sphere in the map: quads only."""
    image, quads = cubed_sphere(across)
    points = sheet.locator.find(image, sheet.vertices).points
    faces = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.int32)
    return Resampled(points, image, faces, 0), Source(points, quads.reshape(-1), 4 * np.arange(len(quads) + 1))
