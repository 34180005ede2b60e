"""The boundary of the spherical harmonic map of a surface's double cover (CDCP Algorithm 1, lines 1-6).

Half of the double cover is enough (CDCP Theorem 1), and of that only the boundary's equation S g = reduce(r). The pole lies
on the face that heat from the boundary reaches last.
"""

from __future__ import annotations

import numba
import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from pgcp.elimination.sparse_boundary import AnyFactor, AnySchur, SparseSchur
from pgcp.errors import CrowdedError, SolveFailedError
from pgcp.methods.common.boundary_energy import goes_round_once, increasing_angles
from pgcp.plane.geodesic import geodesic_map
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray

_SMALLEST_GAP = 2e-14
_STOUT = 0.1


def late_heat(boundary: IntArray, used: BoolArray, factor: AnyFactor) -> FloatArray:
    """Heat (n,) from a boundary (n_B,) at 1 after a long time, its first value taken off and time times as large.

    used (n,): vertices that some face uses; what the others are given goes nowhere.

    The limit of CDCP eq. 13: L f = 1_B - n_B / n, n the vertices used. It needs no factor but the Laplacian's own, and one
    time fits all meshes; sections 4.1 and 6.2 find the time and the place of little weight.
    """
    load = np.full(len(used), -len(boundary) / used.sum(), np.complex128)
    load[boundary] += 1.0
    reduced = factor.reduce(load).real
    on_boundary = np.zeros(len(boundary), np.complex128)
    on_boundary[1:] = solve_pinned(factor.schur, reduced[1:, None])[:, 0]
    return np.asarray(factor.solve(load, on_boundary).real, np.float64)


@numba.njit(cache=True)
def _coldest(vertices: FloatArray, faces: IntArray, warmth: FloatArray, stout: float) -> int:
    """Face of least warmth among those of a certain height over their longest edge, else the stoutest."""
    best, stoutest, least, most = -1, 0, np.inf, -1.0
    edge = np.empty((3, 3))
    for f in range(faces.shape[0]):
        longest = 0.0
        for i in range(3):
            square = 0.0
            for d in range(3):
                edge[i, d] = vertices[faces[f, (i + 1) % 3], d] - vertices[faces[f, i], d]
                square += edge[i, d] ** 2
            longest = max(longest, square)
        x = edge[0, 1] * edge[1, 2] - edge[0, 2] * edge[1, 1]
        y = edge[0, 2] * edge[1, 0] - edge[0, 0] * edge[1, 2]
        z = edge[0, 0] * edge[1, 1] - edge[0, 1] * edge[1, 0]
        height = np.sqrt(x * x + y * y + z * z) / longest if longest > 0.0 else 0.0
        warm = warmth[faces[f, 0]] + warmth[faces[f, 1]] + warmth[faces[f, 2]]
        if height >= stout and warm < least:
            best, least = f, warm
        if height > most:
            stoutest, most = f, height
    return best if best >= 0 else stoutest


def central_face(vertices: FloatArray, faces: IntArray, warmth: FloatArray) -> int:
    """Face that heat reaches last (CDCP eq. 15), of those whose height is a tenth of their longest edge, if any.

    warmth (V,). The pole's right-hand side (eq. 17) is made of the face's edge and height: a needle carries no direction.
    """
    return int(_coldest(vertices, faces, warmth, _STOUT))


def solve_symmetric(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve a symmetric positive definite system (n, n) for columns (n, k); raise SolveFailedError where it is not definite."""
    try:
        return np.asarray(cho_solve(cho_factor(matrix, check_finite=False), right, check_finite=False), np.float64)
    except LinAlgError as problem:
        raise SolveFailedError(f"a boundary system of {len(matrix)} unknowns is not positive definite") from problem


def solve_pinned(schur: AnySchur, right: FloatArray) -> FloatArray:
    """Values (n_B - 1, k) under loads (n_B - 1, k) on all boundary vertices but the first, which is held at 0."""
    if isinstance(schur, SparseSchur):
        return schur.solve_pinned(right)
    return solve_symmetric(schur[1:, 1:], right)


def dipole(corners: FloatArray) -> ComplexArray:
    """Right-hand side (3,) at the corners (3, 3) of the face that holds the pole (CDCP eq. 17)."""
    i, j, k = corners
    along = j - i
    length = float(np.linalg.norm(along))
    alpha = float((k - i) @ along) / length**2
    height = float(np.linalg.norm(k - (i + alpha * along)))
    return np.array([-1.0 / length, 1.0 / length, 0.0]) + 1j * np.array([1.0 - alpha, alpha, -1.0]) / height


def harmonic_boundary(vertices: FloatArray, face: IntArray, factor: AnyFactor) -> ComplexArray:
    """Boundary (n_B,) of the reduced spherical harmonic map (CDCP eq. 18), its mean at 0, with the pole on ``face`` (3,).

    It goes clockwise: the surface lies outside, its pole at infinity.
    """
    load = np.zeros(len(vertices), np.complex128)
    load[face] = dipole(vertices[face])
    reduced = factor.reduce(load)
    # the dipole sums to 0: what rounding leaves over would all go out through the pinned vertex
    reduced = reduced - reduced.mean()
    # one value is free (their h_B(1) = 0); the pinned rest is definite
    solved = solve_pinned(factor.schur, np.column_stack([reduced.real, reduced.imag])[1:])
    h: ComplexArray = np.concatenate([[0.0], solved[:, 0] + 1j * solved[:, 1]])
    return h - h.mean()


def circle_boundary(h: ComplexArray) -> ComplexArray:
    """Boundary points (n_B,) on the unit circle, the first at 1: the conformal map of what lies outside h (CDCP eq. 1-6).

    h (n_B,) clockwise around 0; infinity, the pole, goes to 0. Raises SolveFailedError where h crosses itself, CrowdedError
    where points cannot be told apart on the circle. Three points are taken evenly: a Moebius map of the disk brings any there.
    """
    if len(h) == 3:
        return np.exp(2j * np.pi * np.arange(3) / 3)
    curve = np.abs(h).mean() / h
    plane = geodesic_map(curve, np.zeros(1, np.complex128))
    if isinstance(plane, int):
        raise SolveFailedError(f"the harmonic boundary of {len(h)} points crosses itself near its point {plane}")
    gaps = plane.circle_gaps(plane.inside[0])
    if not float(gaps.min()) > _SMALLEST_GAP:
        raise CrowdedError(
            "the surface has parts so long and thin that they would span less of the unit circle than double precision can tell"
        )
    angles = 2.0 * np.pi * np.concatenate([[0.0], np.cumsum(gaps[:-1])]) / gaps.sum()
    z: ComplexArray = np.exp(1j * angles)
    return z


def start_angles(h: ComplexArray) -> FloatArray:
    """Increasing angles (n_B,) from 0 of h, clockwise around 0, on the circle: the start of CEM (CDCP Remark 7).

    Seen from 0 where that keeps the order, by the geodesic algorithm, which always does, elsewhere; raises as that does.
    """
    seen = np.asarray(np.conj(h) / np.abs(h), np.complex128)
    return increasing_angles(seen if goes_round_once(seen) else circle_boundary(h))
