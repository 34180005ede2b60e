"""Discrete operators of a triangle mesh: cotangents, cotangent Laplacian, areas, angles."""

from __future__ import annotations

import numba
import numpy as np
from scipy.sparse import csr_array

from pgcp.types import FloatArray, IntArray


@numba.njit(cache=True)
def cotangents(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Cotangent of every corner (F, 3), from edge lengths by Kahan's stable area (no cancellation in needles).

    Where a face has zero area the cotangents are not finite; callers check for it.
    """
    out = np.empty((faces.shape[0], 3))
    length = np.empty(3)
    for f in range(faces.shape[0]):
        for i in range(3):
            p, q = faces[f, (i + 1) % 3], faces[f, (i + 2) % 3]
            dx = vertices[p, 0] - vertices[q, 0]
            dy = vertices[p, 1] - vertices[q, 1]
            dz = vertices[p, 2] - vertices[q, 2]
            length[i] = np.sqrt(dx * dx + dy * dy + dz * dz)
        c, b, a = np.sort(length)
        square = (a + (b + c)) * (c - (a - b)) * (c + (a - b)) * (a + (b - c))
        four_area = np.sqrt(max(square, 0.0))
        for i in range(3):
            x, y, z = length[i], length[(i + 1) % 3], length[(i + 2) % 3]
            # y^2 + z^2 - x^2 with the difference of squares factored
            big, small = max(y, z), min(y, z)
            out[f, i] = ((big - x) * (big + x) + small * small) / four_area if four_area > 0 else np.inf
    return out


@numba.njit(cache=True)
def face_areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Area of every face (F,), in squared units of the vertices."""
    out = np.empty(faces.shape[0])
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        out[f] = 0.5 * np.sqrt(nx * nx + ny * ny + nz * nz)
    return out


def cotangent_laplacian(vertices: FloatArray, faces: IntArray) -> csr_array:
    """Cotangent Laplacian L (n, n), symmetric positive semi-definite, off-diagonal -(cot a + cot b)/2 (PGCP eq. 4.6).

    The sign is that of the Dirichlet energy: E_D(u) = 1/2 u^T L u.
    """
    weights = 0.5 * cotangents(vertices, faces)
    n = len(vertices)
    tails = faces[:, [1, 2, 0]].reshape(-1)
    heads = faces[:, [2, 0, 1]].reshape(-1)
    values = weights.reshape(-1)
    rows = np.concatenate([tails, heads, tails, heads])
    columns = np.concatenate([heads, tails, tails, heads])
    data = np.concatenate([-values, -values, values, values])
    return csr_array((data, (rows, columns)), shape=(n, n))
