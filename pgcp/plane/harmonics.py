"""Real spherical harmonics: functions on the sphere by their coefficients, fits, and how alike two are after every rotation.

Coefficients are rows ((L + 1)^2, ...) in the order of ``degree_and_order``, of the harmonics of ``real_harmonics``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from pgcp.types import ComplexArray, FloatArray, IntArray

_ROWS = 4096  # of the matrix that is made at a time


def degree_and_order(degree: int) -> tuple[IntArray, IntArray]:
    """Degree l and order m of the (L + 1)^2 harmonics up to degree L, in their order: l^2 + l + m is the place of l, m."""
    degrees = np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)
    return degrees, np.arange(len(degrees)) - degrees * (degrees + 1)


def degree_of(coefficients: FloatArray) -> int:
    """The highest degree L of coefficients ((L + 1)^2, ...)."""
    return round(len(coefficients) ** 0.5) - 1


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


def points_on_rings(colatitudes: FloatArray, around: int) -> FloatArray:
    """Points (n, 3) of the unit sphere on rings at these colatitudes, ``around`` on each, evenly from longitude 0."""
    angles = 2.0 * np.pi * np.arange(around) / around
    across, up = np.sin(colatitudes)[:, None], np.cos(colatitudes)[:, None]
    parts = np.broadcast_arrays(across * np.cos(angles), across * np.sin(angles), up)
    return np.stack(parts, axis=-1).reshape(-1, 3)


def sphere_grid(degree: int) -> tuple[FloatArray, FloatArray]:
    """Points (n, 3) and weights (n,) that integrate products of two harmonics up to a degree L: Gauss-Legendre rings.

    n = (L + 1) (2 L + 2); weights sum to 4 pi.
    """
    heights, weights = np.polynomial.legendre.leggauss(degree + 1)
    around = 2 * degree + 2
    return points_on_rings(np.arccos(heights), around), np.repeat(weights * (2.0 * np.pi / around), around)


def projected(degree: int, points: FloatArray, weights: FloatArray) -> FloatArray:
    """Coefficients ((L + 1)^2,) of the measure with weights (n,) at unit vectors (n, 3): sums of weights times harmonics.

    Those of a function are those of its values times the weights of a grid.
    """
    out = np.zeros((degree + 1) ** 2)
    for begin in range(0, len(points), _ROWS):
        some = slice(begin, begin + _ROWS)
        out += weights[some] @ real_harmonics(degree, points[some])
    return out


def at_points(coefficients: FloatArray, points: FloatArray) -> FloatArray:
    """Values (N, C) at unit vectors (N, 3) of functions with coefficients ((L + 1)^2, C)."""
    degree = degree_of(coefficients)
    parts = [real_harmonics(degree, points[k : k + _ROWS]) @ coefficients for k in range(0, len(points), _ROWS)]
    return np.concatenate(parts)


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
    degree = degree_of(coefficients)
    return np.asarray(np.bincount(degree_and_order(degree)[0], (coefficients**2).sum(axis=1), degree + 1), np.float64)


def _by_order(coefficients: FloatArray) -> ComplexArray:
    """Coefficients (L + 1, 2 L + 1), by l and m + L, of the complex harmonics P_lm(cos t) exp(i m p) of quantum mechanics.

    Those have the factor (-1)^m (Condon-Shortley) for m > 0, and Y_l,-m = (-1)^m conj(Y_lm).
    """
    top = degree_of(coefficients)
    degrees, orders = degree_and_order(top)
    opposite = coefficients[degrees * (degrees + 1) - orders]
    pairs = np.sqrt(0.5) * (coefficients - 1j * opposite)
    out = np.zeros((top + 1, 2 * top + 1), np.complex128)
    some = orders > 0
    out[degrees[some], top + orders[some]] = (-1.0) ** orders[some] * pairs[some]
    out[degrees[some], top - orders[some]] = pairs[some].conj()
    out[:, top] = coefficients[orders == 0]
    return out


def _turns(order: int, tilts: FloatArray) -> FloatArray:
    """Wigner's small matrices d (n, 2 l + 1, 2 l + 1) of degree l = ``order`` for angles ``tilts`` (n,), in radians."""
    m = np.arange(-order, order)
    raised = np.zeros((2 * order + 1, 2 * order + 1))
    raised[np.arange(1, 2 * order + 1), np.arange(2 * order)] = np.sqrt(order * (order + 1) - m * (m + 1))
    values, vectors = np.linalg.eigh((raised - raised.T) / 2j)
    phases = np.exp(-1j * tilts[:, None] * np.round(values))
    return np.asarray(np.einsum("ik,nk,jk->nij", vectors, phases, vectors.conj()).real, np.float64)


def rotation_correlations(one: FloatArray, other: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """How much the first function, rotated, is like the second, for a grid of all rotations.

    one, other: coefficients ((L + 1)^2,). Returns angles (N,) about z, tilts (N // 2 + 1,) about y, N = 2 L + 2, and the
    integrals (N // 2 + 1, N, N) of f(R^-1 x) g(x) over the sphere, by tilt b, last angle a and first angle c of
    R = Rz(a) Ry(b) Rz(c).
    """
    first, second = _by_order(one), _by_order(other).conj()
    degree = len(first) - 1
    count = 2 * degree + 2
    angles = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False, dtype=np.float64)
    tilts = np.linspace(0.0, np.pi, count // 2 + 1, dtype=np.float64)
    spectrum = np.zeros((len(tilts), count, count), np.complex128)
    for order in range(degree + 1):
        own = np.arange(-order, order + 1)
        a, b = first[order, own + degree], second[order, own + degree]
        spectrum[:, own[:, None], own[None, :]] += _turns(order, tilts) * (b[:, None] * a[None, :])
    return angles, tilts, np.fft.fft2(spectrum, axes=(1, 2)).real


def best_rotations(one: FloatArray, other: FloatArray, count: int, apart: float) -> tuple[FloatArray, FloatArray]:
    """Rotations (k, 3, 3), k <= count, after which one function is most like another, best first, and the integrals (k,).

    one, other: coefficients ((L + 1)^2,). No two are closer than the angle ``apart``, in radians.
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
