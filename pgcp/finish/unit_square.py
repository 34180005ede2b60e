"""Texture coordinates of a finished map: upright in the unit square, or longitude and latitude of the sphere.

Neither is mirrored: where the map's faces are counter-clockwise, those of the texture are.
"""

from __future__ import annotations

from functools import partial

import numba
import numpy as np

from pgcp.errors import InputError
from pgcp.finish.quality import single_precision_folds
from pgcp.options import UPS
from pgcp.parallel import in_slices
from pgcp.plane.space import PLANE, find_folds
from pgcp.surface.topology import used_vertices
from pgcp.types import FloatArray, IntArray, Layout, Mesh

MARGIN = 0.02
_STEADY = 0.05  # an axis shows where the map's upward directions agree so far
_POLE = 1e-9  # radians
_SAMPLE = 100_000  # faces
_FRONT = {0: np.array([0.0, -1.0, 0.0]), 1: np.array([0.0, 0.0, 1.0]), 2: np.array([0.0, -1.0, 0.0])}


@numba.njit(cache=True, nogil=True)
def _upwards(vertices: FloatArray, image: FloatArray, faces: IntArray, units: FloatArray, begin: int, end: int) -> FloatArray:
    """Sums (4, 2): gradients in the map of x, y and z, times the map's scale and the area on the surface; then (area, 0).

    units (2,): of the surface and of the map, in which lengths are of about 1.
    """
    total, edges, sides = np.zeros((4, 2)), np.empty((2, 3)), np.empty((2, 2))
    for f in range(begin, end):
        for i in range(2):
            for d in range(3):
                edges[i, d] = (vertices[faces[f, i + 1], d] - vertices[faces[f, 0], d]) / units[0]
            for d in range(2):
                sides[i, d] = (image[faces[f, i + 1], d] - image[faces[f, 0], d]) / units[1]
        nx = edges[0, 1] * edges[1, 2] - edges[0, 2] * edges[1, 1]
        ny = edges[0, 2] * edges[1, 0] - edges[0, 0] * edges[1, 2]
        nz = edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0]
        area = 0.5 * np.sqrt(nx * nx + ny * ny + nz * nz)
        double = sides[0, 0] * sides[1, 1] - sides[0, 1] * sides[1, 0]
        if not (area > 0.0 and double > 0.0):
            continue
        weight = area * np.sqrt(0.5 * double / area) / double
        for d in range(3):
            total[d, 0] += weight * (edges[0, d] * sides[1, 1] - edges[1, d] * sides[0, 1])
            total[d, 1] += weight * (edges[1, d] * sides[0, 0] - edges[0, d] * sides[1, 0])
        total[3, 0] += area
    return total


def upright_angle(mesh: Mesh, uv: FloatArray, up: str = "auto") -> tuple[float, str | None]:
    """By what angle, in radians, a map (V, 2) is turned so that the surface's up is up, and which axis that is.

    Up is the direction in which a coordinate of the surface grows, on average over its area. With ``auto`` it is that of y
    or z, whichever is steadier. Where none shows, as of a ball from above, 0 and None.
    """
    units = np.array([max(*(float(np.ptp(column)) for column in points.T), 1e-300) for points in (mesh.vertices, uv)])
    sums = np.sum(in_slices(partial(_upwards, mesh.vertices, uv, mesh.faces, units), len(mesh.faces)), axis=0)
    gradients = sums[:3] / max(float(sums[3, 0]), 1e-300)
    steady = np.hypot(*gradients.T)
    axis = _axis(up, steady)
    if not steady[axis] > _STEADY:
        return 0.0, None
    angle = float(0.5 * np.pi - np.arctan2(gradients[axis, 1], gradients[axis, 0]))
    return (angle + np.pi) % (2 * np.pi) - np.pi, "xyz"[axis]


def standing(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """How well (3,) a surface stands with x, y or z up: how wide its lowest twentieth is, as a share of all of it.

    An animal has its feet there, a bust its base, a tail or a nose is narrow.
    """
    used = np.zeros(len(vertices), bool)
    used[faces[:: len(faces) // _SAMPLE | 1]] = True
    points = np.ascontiguousarray(vertices[used].T)  # columns: quicker than rows of three
    low, span = points.min(axis=1), np.maximum(np.ptp(points, axis=1), 1e-300)
    shares = np.empty(3)
    for axis in range(3):
        lowest = points[:, points[axis] <= low[axis] + 0.05 * span[axis]]
        across = np.delete(np.ptp(lowest, axis=1) / span, axis)
        shares[axis] = across.prod()
    return shares


def _axis(up: str, shown: FloatArray) -> int:
    """The axis that is up: the one asked for, else y or z, whichever shows more; of equals z."""
    if up not in UPS:
        raise InputError(f"unknown axis {up!r}; choose from {', '.join(UPS)}")
    return "xyz".index(up) if up != "auto" else 1 if shown[1] > 1.05 * shown[2] else 2


def in_unit_square(mesh: Mesh, uv: FloatArray, up: str = "auto") -> Layout:
    """A map to the plane (V, 2) in [0, 1]^2: turned upright (``upright_angle``), scaled evenly, moved; 2 % margin.

    Away from 0, doubles have no room for parts below about 1e-16: the record counts the faces that are folded here.
    Raises InputError for another axis.
    """
    angle, axis = upright_angle(mesh, uv, up)
    along, across, used = np.cos(angle), np.sin(angle), used_vertices(mesh)
    turned = along * uv[:, 0] - across * uv[:, 1], across * uv[:, 0] + along * uv[:, 1]  # columns: quicker than rows of two
    low, high = (np.array([end(column[used]) for column in turned]) for end in (np.min, np.max))
    scale = (1.0 - 2.0 * MARGIN) / max(float((high - low).max()), 1e-300)
    shift = 0.5 - 0.5 * scale * (low + high)
    points = np.empty_like(uv)
    for k, column in enumerate(turned):
        points[:, k] = np.clip(column * scale + shift[k], 0.0, 1.0)  # vertices that no face uses
    positions = PLANE.positions(points)
    record = {
        "kind": "unit square",
        "up": axis,
        "angle_deg": float(np.degrees(angle)),
        "scale": scale,
        "shift": shift.tolist(),
        "folds": len(find_folds(PLANE, mesh.faces, positions)),
        "single_precision_folds": single_precision_folds(PLANE, mesh.faces, points),
    }
    return Layout(points, mesh.faces, np.empty(0, np.int64), record)


def on_the_globe(mesh: Mesh, sphere: FloatArray, up: str = "auto", polygon_of: IntArray | None = None) -> Layout:
    """Longitude and latitude of a map to the sphere (V, 3) as texture coordinates, (0, 0) at the date line's south end.

    The axis is the one along which the surface stands: with ``auto`` y or z, whichever it stands on more widely. The date
    line is at the back. A face across it has corners beyond 1, which repeating textures continue; a corner at a pole has the
    mean longitude of the face's other corners. Faces that follow each other with the same number in ``polygon_of`` (F,) are one
    polygon, whose corners have one place each. Raises InputError for another axis.
    """
    axis = _axis(up, standing(mesh.vertices, mesh.faces) if up == "auto" else np.zeros(3))
    north = np.eye(3)[axis]
    front = _FRONT[axis]
    x, y, z = sphere @ front, sphere @ np.cross(north, front), sphere @ north
    across = np.hypot(x, y)
    points = np.column_stack([0.5 + np.arctan2(y, x) / (2.0 * np.pi), 0.5 + np.arctan2(z, across) / np.pi])
    corners = points[mesh.faces, 0]
    polar = across[mesh.faces] < _POLE
    # longitudes near that of the first corner that has one, then the pole between the others
    numbers = np.arange(len(corners)) if polygon_of is None else polygon_of
    begins = np.flatnonzero(np.append(True, numbers[1:] != numbers[:-1]))
    group = np.repeat(np.arange(len(begins)), np.diff(np.append(begins, len(numbers))))
    has_one = ~polar.all(axis=1)
    leader = np.minimum.reduceat(np.where(has_one, np.arange(len(corners)), len(corners)), begins)
    leader = np.where(leader < len(corners), leader, begins)
    first = corners[leader, np.argmin(polar[leader], axis=1)]
    near = corners - np.rint(corners - first[group, None])
    least = np.minimum.reduceat(np.where(polar, np.inf, near).min(axis=1), begins)
    near -= np.floor(np.where(np.isfinite(least), least, 0.0) + 1e-15)[group, None]  # all of a face may lie at the pole
    known = np.maximum(np.add.reduceat((~polar).sum(axis=1), begins), 1)
    middle = np.add.reduceat(np.where(polar, 0.0, near).sum(axis=1), begins) / known
    near = np.where(polar, middle[group, None], near)
    return _with_copies(mesh, points, near, {"kind": "longitude and latitude", "up": "xyz"[axis]})


def _with_copies(mesh: Mesh, points: FloatArray, longitudes: FloatArray, record: dict[str, object]) -> Layout:
    """A layout whose corners have these longitudes (F, 3): those of their vertices, or of further points."""
    faces = mesh.faces.copy()
    row, column = np.nonzero(np.abs(longitudes - points[faces, 0]) > 1e-12)
    pairs = np.column_stack([faces[row, column], longitudes[row, column]])
    unlike, place = np.unique(np.round(pairs, 12), axis=0, return_inverse=True)
    more = np.column_stack([unlike[:, 1], points[unlike[:, 0].astype(np.int64), 1]])
    faces[row, column] = len(points) + place.reshape(-1)
    return Layout(np.vstack([points, more]), faces, unlike[:, 0].astype(np.int64), record)
