"""How a map distorts a surface, face by face: angles and areas (PGCP eq. 5.1, 6.1)."""

from __future__ import annotations

import numba
import numpy as np

from pgcp.operators import face_areas
from pgcp.parallel import in_slices
from pgcp.types import ComplexArray, FloatArray, IntArray, Mesh, Positions

_TINY = 1e-290


def as_points(positions: Positions) -> FloatArray:
    """Points (V, 3) of positions in the plane, complex (V,) or (V, 2), or in space (V, 3)."""
    if positions.ndim == 1:
        return np.column_stack([positions.real, positions.imag, np.zeros(len(positions))])
    if positions.shape[1] == 3:
        return np.asarray(positions, np.float64)
    return np.column_stack([positions, np.zeros(len(positions))])


@numba.njit(cache=True, nogil=True)
def corner_angles(vertices: FloatArray, faces: np.ndarray) -> FloatArray:
    """Angle of every corner (F, 3), radians, by atan2 of cross and dot product."""
    out = np.empty((faces.shape[0], 3))
    for f in range(faces.shape[0]):
        for i in range(3):
            a, b, c = faces[f, i], faces[f, (i + 1) % 3], faces[f, (i + 2) % 3]
            ux, uy, uz = (
                vertices[b, 0] - vertices[a, 0],
                vertices[b, 1] - vertices[a, 1],
                vertices[b, 2] - vertices[a, 2],
            )
            vx, vy, vz = (
                vertices[c, 0] - vertices[a, 0],
                vertices[c, 1] - vertices[a, 1],
                vertices[c, 2] - vertices[a, 2],
            )
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            out[f, i] = np.arctan2(np.sqrt(nx * nx + ny * ny + nz * nz), ux * vx + uy * vy + uz * vz)
    return out


@numba.njit(cache=True, nogil=True)
def _corner(points: FloatArray, a: int, b: int, c: int) -> tuple[float, float]:
    """Length of the cross product and dot product of the edges a -> b and a -> c; points (V, 2) or (V, 3)."""
    ux, uy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    vx, vy = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
    if points.shape[1] == 2:
        return abs(ux * vy - uy * vx), ux * vx + uy * vy
    uz, vz = points[b, 2] - points[a, 2], points[c, 2] - points[a, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return np.sqrt(nx * nx + ny * ny + nz * nz), ux * vx + uy * vy + uz * vz


@numba.njit(cache=True, nogil=True)
def angle_error_slice(vertices: FloatArray, image: FloatArray, faces: IntArray, begin: int, end: int) -> FloatArray:
    """|angle in the image - angle on the surface| (N, 3), degrees, of faces from begin to end; image (V, 2) or (V, 3).

    Each by one arc tangent: the argument of the quotient of the two corners, seen as complex numbers.
    """
    out = np.empty((end - begin, 3))
    for f in range(begin, end):
        for i in range(3):
            a, b, c = faces[f, i], faces[f, (i + 1) % 3], faces[f, (i + 2) % 3]
            s, d = _corner(vertices, a, b, c)
            t, e = _corner(image, a, b, c)
            across, along = t * d - e * s, e * d + t * s
            if abs(across) + abs(along) < _TINY:
                out[f - begin, i] = np.degrees(abs(np.arctan2(t, e) - np.arctan2(s, d)))
            else:
                out[f - begin, i] = np.degrees(abs(np.arctan2(across, along)))
    return out


def angle_errors(mesh: Mesh, positions: Positions) -> FloatArray:
    """|angle in the map - angle on the surface| of every corner (F, 3), degrees (PGCP eq. 5.1); chords on the sphere."""
    image = positions if positions.ndim == 2 else np.column_stack([positions.real, positions.imag])
    parts = in_slices(lambda begin, end: angle_error_slice(mesh.vertices, image, mesh.faces, begin, end), len(mesh.faces))
    return np.concatenate(parts)


@numba.njit(cache=True, nogil=True)
def _conformal_energy(vertices: FloatArray, faces: np.ndarray, z: np.ndarray) -> float:
    total = 0.0
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        square = ux * ux + uy * uy + uz * uz
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        double_area = np.sqrt(nx * nx + ny * ny + nz * nz)
        if not double_area > 0.0:
            continue
        # chart corners 0, length, (dot + i double_area) / length; f_zbar = (f_x + i f_y) / 2
        along, to_third = z[b] - z[a], z[c] - z[a]
        dot = ux * vx + uy * vy + uz * vz
        q = along * complex(double_area, -dot) + 1j * square * to_third
        total += (q.real * q.real + q.imag * q.imag) / (square * double_area)
    return 0.25 * total


def conformal_energy(mesh: Mesh, z: ComplexArray) -> float:
    """Conformal energy of a map z (V,) to the plane: Dirichlet energy less signed area, 2 int |f_zbar|^2 (CCEM eq. 2.4).

    Equals 1/2 z^* L z less the area of the boundary's polygon, but is summed face by face from squares: never negative, and
    small values keep their digits. Faces without area on the surface do not count.
    """
    return float(_conformal_energy(mesh.vertices, mesh.faces, z))


def log_area_ratios(mesh: Mesh, positions: Positions) -> FloatArray:
    """d_area of every face (F,) (PGCP eq. 6.1); faces without area on either side get the largest finite value met."""
    image, surface = face_areas(as_points(positions), mesh.faces), face_areas(mesh.vertices, mesh.faces)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.log(image / image.sum()) - np.log(surface / surface.sum())
    finite = np.isfinite(ratio)
    ratio[~finite] = np.abs(ratio[finite]).max(initial=0.0)
    return ratio
