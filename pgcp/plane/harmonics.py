"""Functions on the sphere in spherical harmonics, and how alike two of them are after every rotation.

Harmonics are orthonormal and have the Condon-Shortley phase: Y_lm = P_lm(cos t) exp(i m p), Y_l,-m = (-1)^m conj(Y_lm).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pgcp.types import ComplexArray, FloatArray

_CHUNK = 4096  # points whose Legendre functions are held at a time


def sphere_grid(degree: int) -> FloatArray:
    """Points (n, 3) on which harmonics up to a degree are integrated exactly: rows of Gauss-Legendre heights, each a circle.

    n = (degree + 1) * (2 degree + 2), the highest row first in height's own order, from -1 to 1.
    """
    heights, _ = np.polynomial.legendre.leggauss(degree + 1)
    angles = np.arange(2 * degree + 2) * (np.pi / (degree + 1))
    across = np.sqrt(1.0 - heights**2)[:, None]
    rows = across * np.cos(angles), across * np.sin(angles), np.broadcast_to(heights[:, None], (degree + 1, len(angles)))
    return np.stack(rows, axis=-1).reshape(-1, 3)


def _legendre(degree: int, heights: FloatArray) -> FloatArray:
    """Normalised associated Legendre functions (degree + 1, degree + 1, n) of l, m and heights (n,)."""
    out = np.zeros((degree + 1, degree + 1, len(heights)))
    out[0, 0] = np.sqrt(0.25 / np.pi)
    across = np.sqrt(1.0 - heights**2)
    for m in range(degree + 1):
        if m > 0:
            out[m, m] = -np.sqrt((2 * m + 1) / (2 * m)) * across * out[m - 1, m - 1]
        if m < degree:
            out[m + 1, m] = np.sqrt(2 * m + 3) * heights * out[m, m]
        for n in range(m + 2, degree + 1):
            one, two = np.sqrt((4 * n * n - 1) / (n * n - m * m)), np.sqrt(((n - 1) ** 2 - m * m) / (4 * (n - 1) ** 2 - 1))
            out[n, m] = one * (heights * out[n - 1, m] - two * out[n - 2, m])
    return out


def harmonic_coefficients(values: FloatArray, degree: int) -> ComplexArray:
    """Coefficients (degree + 1, 2 degree + 1), by l and m + degree, of a real function with ``values`` on ``sphere_grid``."""
    heights, weights = np.polynomial.legendre.leggauss(degree + 1)
    rows = np.asarray(values, np.float64).reshape(degree + 1, -1)
    waves = np.fft.fft(rows, axis=1)[:, : degree + 1] * (2.0 * np.pi / rows.shape[1])
    return _all_orders(np.einsum("lmh,h,hm->lm", _legendre(degree, heights), weights, waves))


def measure_coefficients(points: FloatArray, weights: FloatArray, degree: int) -> ComplexArray:
    """Coefficients (degree + 1, 2 degree + 1) of the measure with weights (n,) at unit vectors (n, 3)."""
    upper = np.zeros((degree + 1, degree + 1), np.complex128)
    for begin in range(0, len(points), _CHUNK):
        some = slice(begin, begin + _CHUNK)
        x, y, z = points[some].T
        waves = np.exp(-1j * np.arctan2(y, x)[:, None] * np.arange(degree + 1)) * weights[some, None]
        upper += np.einsum("lmh,hm->lm", _legendre(degree, np.clip(z, -1.0, 1.0)), waves)
    return _all_orders(upper)


def _all_orders(upper: ComplexArray) -> ComplexArray:
    """Coefficients of a real function for orders of either sign, from those (L + 1, L + 1) of orders 0 to L."""
    signs = (-1.0) ** np.arange(1, len(upper))
    lower = (signs * upper[:, 1:].conj())[:, ::-1]
    return np.concatenate([lower, upper], axis=1)


def _turns(order: int, tilts: FloatArray) -> FloatArray:
    """Wigner's small matrices d (n, 2 l + 1, 2 l + 1) of degree l = ``order`` for angles ``tilts`` (n,), in radians."""
    m = np.arange(-order, order)
    raised = np.zeros((2 * order + 1, 2 * order + 1))
    raised[np.arange(1, 2 * order + 1), np.arange(2 * order)] = np.sqrt(order * (order + 1) - m * (m + 1))
    values, vectors = np.linalg.eigh((raised - raised.T) / 2j)
    phases = np.exp(-1j * tilts[:, None] * np.round(values))
    return np.asarray(np.einsum("ik,nk,jk->nij", vectors, phases, vectors.conj()).real, np.float64)


def rotation_correlations(one: ComplexArray, other: ComplexArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """How much the first function, rotated, is like the second, for a grid of all rotations.

    one, other: coefficients (L + 1, 2 L + 1). Returns angles (N,) about z, tilts (N // 2 + 1,) about y, N = 2 L + 2, and the
    integrals (N // 2 + 1, N, N) of f(R^-1 x) g(x) over the sphere, by tilt b, last angle a and first angle c of
    R = Rz(a) Ry(b) Rz(c).
    """
    degree = len(one) - 1
    count = 2 * degree + 2
    angles = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False, dtype=np.float64)
    tilts = np.linspace(0.0, np.pi, count // 2 + 1, dtype=np.float64)
    spectrum = np.zeros((len(tilts), count, count), np.complex128)
    for order in range(degree + 1):
        own = np.arange(-order, order + 1)
        a, b = one[order, own + degree], other[order, own + degree].conj()
        spectrum[:, own[:, None], own[None, :]] += _turns(order, tilts) * (b[:, None] * a[None, :])
    return angles, tilts, np.fft.fft2(spectrum, axes=(1, 2)).real


def best_rotations(one: ComplexArray, other: ComplexArray, count: int, apart: float) -> tuple[FloatArray, FloatArray]:
    """Rotations (k, 3, 3), k <= count, after which one function is most like another, best first, and the integrals (k,).

    one, other: coefficients as ``harmonic_coefficients`` gives them. No two are closer than the angle ``apart``, in radians.
    """
    angles, tilts, scores = rotation_correlations(one, other)
    order = np.argsort(scores, axis=None)[::-1][: 400 * count]
    tilt, last, first = np.unravel_index(order, scores.shape)
    found = Rotation.from_euler("ZYZ", np.column_stack([angles[last], tilts[tilt], angles[first]]))
    matrices, values = found.as_matrix(), scores.reshape(-1)[order]
    chosen: list[int] = []
    free = np.ones(len(order), bool)
    while free.any() and len(chosen) < count:
        best = int(np.argmax(free))
        chosen.append(best)
        cosines = 0.5 * (np.einsum("nij,ij->n", matrices, matrices[best]) - 1.0)
        free &= cosines < np.cos(apart)
    return matrices[chosen], values[chosen]
