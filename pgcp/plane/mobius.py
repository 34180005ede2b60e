"""Moebius maps of the disk and the sphere: stereographic projection, conformal barycentres, least distortion.

The plane and the sphere meet in the stereographic projection that keeps orientation, the sphere seen from outside:
0 is the north pole (0, 0, 1), infinity the south pole.
"""

from __future__ import annotations

import numpy as np

from pgcp.types import ComplexArray, FloatArray, IntArray

_STEPS = 200
_LONGEST_STEP = 0.8
_BALANCED = 1e-12
_CLOSEST = 1e-14
_STRAIGHT = 1e-6


def sphere_points(p: ComplexArray, q: ComplexArray) -> FloatArray:
    """Unit vectors (n, 3) of the points p / q (n,) of the extended plane; q = 0 is infinity."""
    size = np.maximum(np.abs(p), np.abs(q))
    with np.errstate(invalid="ignore"):
        p, q = p / size, q / size
    cross = 2.0 * p * q.conj()
    one, two = np.abs(p) ** 2, np.abs(q) ** 2
    points = np.column_stack([cross.real, cross.imag, two - one])
    return points / np.linalg.norm(points, axis=1)[:, None]


def to_sphere(z: ComplexArray) -> FloatArray:
    """Inverse stereographic projection (n, 3) of z (n,), which may hold infinity."""
    finite = np.isfinite(z)
    return sphere_points(np.where(finite, z, 1.0), np.where(finite, 1.0 + 0.0j, 0.0))


def to_plane(points: FloatArray) -> ComplexArray:
    """Stereographic projection (n,) of unit vectors (n, 3), none of them the south pole."""
    xy: ComplexArray = points[:, 0] + 1j * points[:, 1]
    north = points[:, 2] > 0
    # the projection is xy / (1 + z), and 1 + z cancels near the south pole
    down = (points[:, 0] ** 2 + points[:, 1] ** 2) / np.where(north, 1.0, 1.0 - points[:, 2])
    return xy / np.where(north, 1.0 + points[:, 2], down)


def rotation_to_north(direction: FloatArray) -> FloatArray:
    """Rotation matrix (3, 3) that takes a unit vector to the north pole (0, 0, 1)."""
    helper = np.eye(3)[int(np.argmin(np.abs(direction)))]
    one = np.cross(helper, direction)
    one /= np.linalg.norm(one)
    return np.stack([one, np.cross(direction, one), direction])


def in_ball(v: FloatArray) -> FloatArray:
    """Point (k,) of the unit ball at hyperbolic distance 2 |v| from its centre, in the direction of v (k,)."""
    size = float(np.linalg.norm(v))
    return v * (np.tanh(size) / size) if size > 0 else v


def ball_slope(v: FloatArray) -> FloatArray:
    """Jacobian (k, k) of ``in_ball``."""
    size = float(np.linalg.norm(v))
    if size < _STRAIGHT:
        return np.eye(len(v))
    unit, reach = v / size, np.tanh(size)
    return (reach / size) * np.eye(len(v)) + (1.0 - reach**2 - reach / size) * np.outer(unit, unit)


def boost(points: FloatArray, b: FloatArray) -> FloatArray:
    """Move unit vectors (n, 3) by the Moebius map of the ball that takes 0 to b, |b| < 1: points drift towards b."""
    along = points @ b
    square = float(b @ b)
    moved = (1.0 - square) * points + (2.0 + 2.0 * along)[:, None] * b
    moved /= np.sqrt(np.einsum("ij,ij->i", moved, moved))[:, None]
    return moved


def boost_slope(points: FloatArray, moved: FloatArray, b: FloatArray, slope: FloatArray) -> FloatArray:
    """Gradient (3,) with respect to b of what has the gradient slope (n, 3) with respect to ``boost`` of points, moved."""
    along, square = points @ b, float(b @ b)
    size = 1.0 + 2.0 * along + square
    inwards, across, lost = slope @ b, np.einsum("ij,ij->i", slope, points), np.einsum("ij,ij->i", slope, moved)
    on_points, on_b = (2.0 * inwards - 2.0 * lost) / size, (-2.0 * across - 2.0 * lost) / size
    return np.asarray(on_points @ points + on_b.sum() * b + (2.0 * (1.0 + along) / size) @ slope, np.float64)


def boost_matrix(b: FloatArray) -> ComplexArray:
    """Matrix (2, 2) of the Moebius map of the extended plane that ``boost`` is in the stereographic projection."""
    t = float(np.linalg.norm(b))
    if t == 0.0:
        return np.eye(2, dtype=np.complex128)
    u = b / t
    if u[2] < 0.0:
        u, t = -u, -t
    pole = complex(u[0], u[1]) / (1.0 + u[2])
    turn = np.array([[1.0, -pole], [np.conj(pole), 1.0]])
    back = np.array([[1.0, pole], [-np.conj(pole), 1.0]])
    matrix: ComplexArray = back @ np.diag([1.0 - t, 1.0 + t]) @ turn
    return matrix / np.abs(matrix).max()


def balancing_step(points: FloatArray, weights: FloatArray) -> FloatArray:
    """Newton step b towards the conformal barycentre of points (n, d) on the unit sphere, |b| < 1; 0 when it is at 0.

    The barycentre minimises sum w log(|x - b|^2 / (1 - |b|^2)), which is convex along geodesics of the ball; its
    gradient at 0 is -2 sum w x, its Hessian 4 (1 - sum w x x^T), for weights that sum to 1. There is no step from points
    that are not finite.
    """
    mean = weights @ points
    if not np.linalg.norm(mean) >= _BALANCED:
        return np.zeros(points.shape[1])
    spread = np.eye(points.shape[1]) - (points * weights[:, None]).T @ points
    step = np.asarray(0.5 * np.linalg.lstsq(spread, mean, rcond=1e-12)[0], np.float64)
    if step @ mean <= 0.0:
        step = mean
    size = float(np.linalg.norm(step))
    return step * min(1.0, _LONGEST_STEP / size)


def balance_sphere(z: ComplexArray, weights: FloatArray) -> tuple[FloatArray, ComplexArray]:
    """Unit vectors (n, 3) of z (n,), after the Moebius map, unique up to a rotation, that makes their weighted mean 0.

    z may hold infinity. Returns the matrix (2, 2) of the map as well. All maps are composed before z is touched, so
    crowded points keep their digits. Without a balance (half the weight in one point) the last try is returned.
    """
    weights = weights / weights.sum()
    finite = np.isfinite(z)
    p, q = np.where(finite, z, 1.0), np.where(finite, 1.0 + 0.0j, 0.0)
    middle = np.exp(np.median(np.log(np.abs(z[finite & (z != 0)]))))
    matrix: ComplexArray = np.array([[1.0 / middle, 0.0], [0.0, 1.0]], np.complex128)
    for _ in range(_STEPS):
        points = sphere_points(matrix[0, 0] * p + matrix[0, 1] * q, matrix[1, 0] * p + matrix[1, 1] * q)
        step = balancing_step(points, weights)
        if not step.any():
            break
        matrix = boost_matrix(-step) @ matrix
        matrix = matrix / np.abs(matrix).max()
    return points, matrix


def shift_disk(z: ComplexArray, alpha: complex) -> ComplexArray:
    """Disk automorphism (z - alpha) / (1 - conj(alpha) z), |alpha| < 1 (PGCP eq. 6.3, CDCP eq. 19)."""
    return (z - alpha) / (1.0 - np.conj(alpha) * z)


def _real_slope(by: ComplexArray, by_conjugate: ComplexArray | float, slope: FloatArray) -> FloatArray:
    """Gradient (2,) with respect to a complex parameter from derivatives by it and its conjugate; slope (n, 2 or more)."""
    pull = slope[:, 0] - 1j * slope[:, 1]
    by_itself, by_other = (pull * by).sum(), (pull * by_conjugate).sum()
    return np.array([(by_itself + by_other).real, (by_other - by_itself).imag])


def shift_slope(z: ComplexArray, alpha: complex, slope: FloatArray) -> FloatArray:
    """Gradient (2,) with respect to alpha of what has the gradient slope (n, 2 or more) with respect to ``shift_disk`` of z."""
    below = 1.0 / (1.0 - np.conj(alpha) * z)
    return _real_slope(-below, z * (z - alpha) * below**2, slope)


def are_apart(z: ComplexArray, boundary: IntArray) -> bool:
    """Whether boundary points z[boundary] (B,) of a disk are far enough from their neighbours to be told apart."""
    return bool(np.abs(np.roll(z[boundary], -1) - z[boundary]).min() > _CLOSEST)


def bend_plane(z: ComplexArray, beta: complex) -> ComplexArray:
    """Moebius map z / (1 - beta z): up to similarities every one whose pole is not 0 (PGCP eq. 6.2)."""
    return z / (1.0 - beta * z)


def bend_slope(z: ComplexArray, beta: complex, slope: FloatArray) -> FloatArray:
    """Gradient (2,) with respect to beta of what has the gradient slope (n, 2 or more) with respect to ``bend_plane`` of z."""
    return _real_slope((z / (1.0 - beta * z)) ** 2, 0.0, slope)
