"""Beltrami coefficients of piecewise linear maps, and an exact fold test."""

from __future__ import annotations

import numba
import numpy as np

from pgcp.parallel import in_slices
from pgcp.surface.exact import plane_signs, space_signs
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray

_ROUNDING = 8.0 * np.finfo(np.float64).eps
_LARGEST = float(np.sqrt(np.finfo(np.float64).max) / 4.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _coefficient(vertices: FloatArray, a: int, b: int, c: int, e: complex, g: complex) -> complex:
    """Beltrami coefficient of the map of a face (a, b, c) whose edges a -> b and a -> c become e and g."""
    ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
    vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
    length = np.sqrt(ux * ux + uy * uy + uz * uz)
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    x = (ux * vx + uy * vy + uz * vz) / length
    y = np.sqrt(nx * nx + ny * ny + nz * nz) / length
    if not y > 0.0:
        return complex(1.0, 0.0)
    # chart corners 0, length, x + i y; f = p w + q conj(w) through the two edges
    along = e / length
    across = (g - x * along) / y
    p, q = along - 1j * across, along + 1j * across
    if p == 0.0 or not np.isfinite(abs(q / p)) or abs(q / p) > _LARGEST:
        return complex(_LARGEST, 0.0)
    return q / p


@numba.njit(cache=True, nogil=True, error_model="numpy")
def beltrami_coefficients(vertices: FloatArray, faces: IntArray, z: ComplexArray) -> ComplexArray:
    """Beltrami coefficient mu = f_zbar / f_z of every face (F,) of the map vertices (V, 3) -> z (V,) (PGCP eq. 3.14).

    Each face has its own isometric chart, first edge along the real axis, counter-clockwise: |mu| does not depend on
    it, the argument does. |mu| < 1 exactly where the face keeps its orientation. A face whose image is
    anti-conformal gets the largest finite number instead of infinity, a face without area on the surface 1.
    """
    out = np.empty(faces.shape[0], np.complex128)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        out[f] = _coefficient(vertices, a, b, c, z[b] - z[a], z[c] - z[a])
    return out


@numba.njit(cache=True, nogil=True)
def _signed_areas(faces: IntArray, z: ComplexArray) -> tuple[FloatArray, BoolArray]:
    out = np.empty(faces.shape[0])
    unsure = np.empty(faces.shape[0], np.bool_)
    for f in range(faces.shape[0]):
        a, b, c = z[faces[f, 0]], z[faces[f, 1]], z[faces[f, 2]]
        u, v = b - a, c - a
        one, two = u.real * v.imag, u.imag * v.real
        out[f] = 0.5 * (one - two)
        unsure[f] = abs(one - two) <= _ROUNDING * (abs(one) + abs(two))
    return out, unsure


def folded_faces(faces: IntArray, z: ComplexArray) -> IntArray:
    """Indices of faces whose image in the plane has no positive area, decided exactly where rounding could mislead."""
    area, unsure = _signed_areas(faces, z)
    folded = area <= 0.0
    if unsure.any():
        corners = z[faces[unsure]]
        folded[unsure] = plane_signs(np.stack([corners.real, corners.imag], axis=-1)) <= 0.0
    return np.flatnonzero(folded)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def beltrami_coefficients_on_sphere(vertices: FloatArray, faces: IntArray, points: FloatArray) -> ComplexArray:
    """Beltrami coefficient of every face (F,) of the map vertices (V, 3) -> points (V, 3) on the unit sphere.

    Between the face and its chordal triangle, both flattened isometrically; the triangle is turned over where it faces
    inwards. Charts as in ``beltrami_coefficients``.
    """
    out = np.empty(faces.shape[0], np.complex128)
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        a, b, c = points[i], points[j], points[k]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(ux * ux + uy * uy + uz * uz)
        height = np.sqrt(nx * nx + ny * ny + nz * nz) / length
        third = complex((ux * vx + uy * vy + uz * vz) / length, np.copysign(height, nx * a[0] + ny * a[1] + nz * a[2]))
        out[f] = _coefficient(vertices, i, j, k, complex(length, 0.0), third)
    return out


@numba.njit(cache=True, nogil=True)
def _volumes(faces: IntArray, points: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Six times the volume of the tetrahedron of each face and the origin, and where rounding may change its sign."""
    out = np.empty(faces.shape[0])
    unsure = np.empty(faces.shape[0], np.bool_)
    for f in range(faces.shape[0]):
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        out[f] = nx * a[0] + ny * a[1] + nz * a[2]
        size = (abs(uy * vz) + abs(uz * vy)) * abs(a[0]) + (abs(uz * vx) + abs(ux * vz)) * abs(a[1])
        size += (abs(ux * vy) + abs(uy * vx)) * abs(a[2])
        unsure[f] = abs(out[f]) <= _ROUNDING * size
    return out, unsure


def folded_faces_on_sphere(faces: IntArray, points: FloatArray) -> IntArray:
    """Indices of faces whose image on the sphere does not face outwards, decided exactly where rounding could mislead.

    The sign of det(a, b, c) is that of the spherical triangle with these corners, and of the chordal triangle's normal.
    """
    volume, unsure = _volumes(faces, points)
    folded = volume <= 0.0
    if unsure.any():
        folded[unsure] = space_signs(points[faces[unsure]]) <= 0.0
    return np.flatnonzero(folded)


@numba.njit(cache=True, nogil=True)
def covering_degree(faces: IntArray, points: FloatArray) -> float:
    """How often the sphere is covered: signed areas of all spherical triangles over 4 pi (van Oosterom, Strackee 1983)."""
    total = 0.0
    for f in range(faces.shape[0]):
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        volume = (uy * vz - uz * vy) * a[0] + (uz * vx - ux * vz) * a[1] + (ux * vy - uy * vx) * a[2]
        ab = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
        bc = b[0] * c[0] + b[1] * c[1] + b[2] * c[2]
        ca = c[0] * a[0] + c[1] * a[1] + c[2] * a[2]
        total += 2.0 * np.arctan2(volume, 1.0 + ab + bc + ca)
    return total / (4.0 * np.pi)


def signed_area(faces: IntArray, z: ComplexArray) -> float:
    """Signed area of the image, summed over all faces."""
    return float(sum(in_slices(lambda begin, end: _signed_areas(faces[begin:end], z)[0].sum(), len(faces))))
