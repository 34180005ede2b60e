"""Beltrami coefficients of piecewise linear maps, and an exact fold test."""

from __future__ import annotations

from fractions import Fraction

import numba
import numpy as np

from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray

_ROUNDING = 8.0 * np.finfo(np.float64).eps


@numba.njit(cache=True, error_model="numpy")
def beltrami_coefficients(vertices: FloatArray, faces: IntArray, z: ComplexArray) -> ComplexArray:
    """Beltrami coefficient mu = f_zbar / f_z of every face (F,) of the map vertices (V, 3) -> z (V,) (PGCP eq. 3.14).

    Each face has its own isometric chart, first edge along the real axis, counter-clockwise: |mu| does not depend on
    it, the argument does. |mu| < 1 exactly where the face keeps its orientation. A face whose image is
    anti-conformal gets the largest finite number instead of infinity.
    """
    out = np.empty(faces.shape[0], np.complex128)
    largest = np.sqrt(np.finfo(np.float64).max) / 4.0
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        length = np.sqrt(ux * ux + uy * uy + uz * uz)
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        x = (ux * vx + uy * vy + uz * vz) / length
        y = np.sqrt(nx * nx + ny * ny + nz * nz) / length
        # chart corners 0, length, x + i y; f = p w + q conj(w) through the two edges
        e, g = z[b] - z[a], z[c] - z[a]
        along = e / length
        across = (g - x * along) / y
        p, q = along - 1j * across, along + 1j * across
        if p == 0.0 or not np.isfinite(abs(q / p)) or abs(q / p) > largest:
            out[f] = complex(largest, 0.0)
        else:
            out[f] = q / p
    return out


@numba.njit(cache=True)
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
    for f in np.flatnonzero(unsure):
        (ax, ay), (bx, by), (cx, cy) = ((Fraction(w.real), Fraction(w.imag)) for w in z[faces[f]].tolist())
        folded[f] = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) <= 0
    return np.flatnonzero(folded)


def signed_area(faces: IntArray, z: ComplexArray) -> float:
    """Signed area of the image, summed over all faces."""
    return float(_signed_areas(faces, z)[0].sum())
