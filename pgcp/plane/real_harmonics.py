"""Real spherical harmonics at points of the unit sphere, and functions fitted by them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgcp.types import FloatArray, IntArray

_ROWS = 4096  # of the matrix that is made at a time


def degree_and_order(degree: int) -> tuple[IntArray, IntArray]:
    """Degree l and order m of the (L + 1)^2 harmonics up to degree L, in their order: l^2 + l + m is the place of l, m."""
    degrees = np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)
    return degrees, np.arange(len(degrees)) - degrees * (degrees + 1)


def real_harmonics(degree: int, points: FloatArray) -> FloatArray:
    """Values (N, (L + 1)^2) of the real harmonics up to degree L at unit vectors (N, 3), orthonormal on the sphere.

    Y_lm is sqrt(2) times a normalised associated Legendre function of z times cos(m phi) for m > 0 and sin(-m phi) for m < 0,
    without the factor (-1)^m (Condon-Shortley). By recurrence in l, which is stable (Holmes, Featherstone 2002).
    """
    x, y, z = points.T
    out = np.empty(((degree + 1) ** 2, len(points)))
    sector, turn = np.full(len(points), np.sqrt(0.25 / np.pi)), np.ones(len(points), np.complex128)
    for m in range(degree + 1):
        if m:
            sector = sector * np.sqrt((2 * m + 1) / (2 * m))
            turn = turn * (x + 1j * y)
        before, now = np.zeros(len(points)), sector
        for k in range(m, degree + 1):
            if k > m:
                a, b = np.sqrt((4 * k * k - 1) / (k * k - m * m)), np.sqrt(((k - 1) ** 2 - m * m) / (4 * (k - 1) ** 2 - 1))
                before, now = now, a * (z * now - b * before)
            middle = k * k + k
            if m == 0:
                out[middle] = now
            else:
                out[middle + m], out[middle - m] = np.sqrt(2.0) * now * turn.real, np.sqrt(2.0) * now * turn.imag
    return out.T


class Fitted(NamedTuple):
    """Functions fitted by harmonics up to each degree.

    triangle (n, n), image (n, C): the least squares problem R c = q in a triangular form; rest (L + 1, C): mean squares of what
    is left of each function by degree; condition: of R, after its columns are scaled.
    """

    triangle: FloatArray
    image: FloatArray
    rest: FloatArray
    condition: float

    def coefficients(self, degree: int) -> FloatArray:
        """Coefficients ((l + 1)^2, C) of the best fit by harmonics up to a degree l."""
        from scipy.linalg import solve_triangular

        n = (degree + 1) ** 2
        return np.asarray(solve_triangular(self.triangle[:n, :n], self.image[:n]))


def fitted(degree: int, points: FloatArray, areas: FloatArray, values: FloatArray) -> Fitted:
    """Least squares fits of functions, values (N, C) at unit vectors (N, 3), by harmonics up to degree L, weighted by areas.

    By QR of the weighted matrix, some rows at a time. The leading part of the triangular problem is that of every lower
    degree, so one factorization gives all fits, and what each leaves. (L + 1)^2 must be at most N.
    """
    share = np.sqrt(areas / areas.sum())
    columns = (degree + 1) ** 2
    block = np.zeros((0, columns + values.shape[1]))
    for begin in range(0, len(points), _ROWS):
        some = slice(begin, begin + _ROWS)
        rows = np.hstack([real_harmonics(degree, points[some]), values[some]]) * share[some, None]
        block = np.asarray(np.linalg.qr(np.vstack([block, rows]), mode="r"))
    triangle, image, left = block[:columns, :columns], block[:columns, columns:], block[columns:, columns:]
    # from what the last degree leaves upwards, which loses no digits where little is left
    taken = np.vstack([image**2, (left**2).sum(axis=0)])
    after = np.cumsum(taken[::-1], axis=0)[::-1]
    rest = after[(np.arange(degree + 1) + 1) ** 2]
    scale = np.linalg.norm(triangle, axis=0)
    condition = float(np.linalg.cond(triangle / scale)) if scale.all() else np.inf
    return Fitted(triangle, image, rest, condition)


def power_by_degree(coefficients: FloatArray) -> FloatArray:
    """Sum of squares (L + 1,) of the coefficients ((L + 1)^2, C) of each degree, over orders and functions.

    It stays the same when the sphere is turned, and for places in space when the surface is.
    """
    degree = round(len(coefficients) ** 0.5) - 1
    return np.asarray(np.bincount(degree_and_order(degree)[0], (coefficients**2).sum(axis=1), degree + 1), np.float64)
