"""How a map distorts a surface, face by face: angles and areas (PGCP eq. 5.1, 6.1)."""

from __future__ import annotations

import numba
import numpy as np

from pgcp.parallel import in_slices
from pgcp.surface.operators import around_vertices, face_areas
from pgcp.types import ComplexArray, FloatArray, IntArray, Mesh

_TINY = 1e-290
_SMALL = 0.04  # to the 12th power 2e-17


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


@numba.njit(cache=True, inline="always")
def _products(ux: float, uy: float, uz: float, vx: float, vy: float, vz: float) -> tuple[float, float]:
    """Length of the cross product and dot product of two edges."""
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return np.sqrt(nx * nx + ny * ny + nz * nz), ux * vx + uy * vy + uz * vz


@numba.njit(cache=True, inline="always")
def _corners(points: FloatArray, a: int, b: int, c: int) -> tuple[tuple[float, float], ...]:
    """At a, b and c: length of the cross product, and dot product, of the edges that leave; points (V, 2) or (V, 3)."""
    px, py = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    qx, qy = points[c, 0] - points[b, 0], points[c, 1] - points[b, 1]
    rx, ry = points[a, 0] - points[c, 0], points[a, 1] - points[c, 1]
    if points.shape[1] == 2:
        return (
            (abs(px * ry - py * rx), -(px * rx + py * ry)),
            (abs(qx * py - qy * px), -(qx * px + qy * py)),
            (abs(rx * qy - ry * qx), -(rx * qx + ry * qy)),
        )
    pz, qz, rz = points[b, 2] - points[a, 2], points[c, 2] - points[b, 2], points[a, 2] - points[c, 2]
    return (
        _products(px, py, pz, -rx, -ry, -rz),
        _products(qx, qy, qz, -px, -py, -pz),
        _products(rx, ry, rz, -qx, -qy, -qz),
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def angle_error_slice(vertices: FloatArray, image: FloatArray, faces: IntArray, begin: int, end: int) -> FloatArray:
    """|angle in the image - angle on the surface| (N, 3), degrees, of faces from begin to end; image (V, 2) or (V, 3).

    Each by one arc tangent: the argument of the quotient of the two corners, seen as complex numbers.
    """
    out = np.empty((end - begin, 3))
    for f in range(begin, end):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        surface, drawn = _corners(vertices, a, b, c), _corners(image, a, b, c)
        for i in range(3):
            s, d = surface[i]
            t, e = drawn[i]
            across, along = t * d - e * s, e * d + t * s
            if abs(across) + abs(along) < _TINY:
                size = abs(np.arctan2(t, e) - np.arctan2(s, d))
            elif abs(across) < _SMALL * along:
                q = across / along
                p = q * q
                size = abs(q) * (1.0 - p * (1 / 3 - p * (1 / 5 - p * (1 / 7 - p * (1 / 9 - p / 11)))))
            else:
                size = abs(np.arctan2(across, along))
            out[f - begin, i] = np.degrees(size)
    return out


def angle_errors(mesh: Mesh, image: FloatArray) -> FloatArray:
    """|angle in the map - angle on the surface| of every corner (F, 3), degrees (PGCP eq. 5.1).

    image: coordinates (V, 2) in the plane or (V, 3) on the sphere, whose faces are chordal triangles.
    """
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


def log_area_ratios(surface: FloatArray, image: FloatArray, totals: tuple[float, float]) -> FloatArray:
    """d_area of faces (N,) from their areas and the areas of both surfaces (PGCP eq. 6.1); not finite where an area is 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios: FloatArray = np.log(image / totals[1]) - np.log(surface / totals[0])
    return ratios


def mean_distortion(mesh: Mesh, image: FloatArray) -> tuple[float, float]:
    """Mean |d_area| and mean |angle error| (degrees) of all faces of a map to points (V, 3); nothing of their number is made.

    Faces without area on either side count with the largest finite |d_area| met.
    """

    def areas(begin: int, end: int) -> tuple[FloatArray, FloatArray]:
        """On the surface and in the image."""
        return face_areas(mesh.vertices, mesh.faces[begin:end]), face_areas(image, mesh.faces[begin:end])

    def sums(begin: int, end: int) -> tuple[float, ...]:
        """Of areas and of angle errors."""
        errors = angle_error_slice(mesh.vertices, image, mesh.faces, begin, end)
        return *(float(part.sum()) for part in areas(begin, end)), float(errors.sum())

    surface_sum, image_sum, error_sum = np.sum(in_slices(sums, len(mesh.faces)), axis=0).tolist()

    def ratios(begin: int, end: int) -> tuple[float, float, int]:
        """Sum and largest of the finite ratios, and how many are not."""
        sizes = np.abs(log_area_ratios(*areas(begin, end), (surface_sum, image_sum)))
        finite = sizes[np.isfinite(sizes)]
        return float(finite.sum()), float(finite.max(initial=0.0)), end - begin - len(finite)

    total, largest, without = zip(*in_slices(ratios, len(mesh.faces)), strict=True)
    count = len(mesh.faces)
    return (sum(total) + max(largest) * sum(without)) / count, error_sum / (3 * count)


def log_scales(areas: FloatArray, image_areas: FloatArray, faces: IntArray, count: int) -> FloatArray:
    """Natural logarithm (V,) of length in a map over length on the surface, from areas (F,) of faces there and in the map.

    Of the faces around each vertex; 0 where there is no area around it.
    """
    around = [around_vertices(each, faces, count) for each in (areas, image_areas)]
    known = (around[0] > 0.0) & (around[1] > 0.0)
    surface, image = (np.where(known, total, 1.0) for total in around)
    return np.asarray(0.5 * np.log(image / surface))
