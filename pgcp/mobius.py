"""Moebius maps of the disk and the sphere: stereographic projection, conformal barycentres, least distortion.

The plane and the sphere meet in the stereographic projection that keeps orientation, the sphere seen from outside:
0 is the north pole (0, 0, 1), infinity the south pole.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pgcp.types import ComplexArray, FloatArray, IntArray

_STEPS = 200
_LONGEST_STEP = 0.8
_BALANCED = 1e-12
_SMOOTH = 1e-2
_CLOSEST = 1e-14


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


def boost(points: FloatArray, b: FloatArray) -> FloatArray:
    """Move unit vectors (n, 3) by the Moebius map of the ball that takes 0 to b, |b| < 1: points drift towards b."""
    along = points @ b
    square = float(b @ b)
    moved = (1.0 - square) * points + (2.0 + 2.0 * along)[:, None] * b
    moved /= np.sqrt(np.einsum("ij,ij->i", moved, moved))[:, None]
    return moved


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


def are_apart(z: ComplexArray, boundary: IntArray) -> bool:
    """Whether boundary points z[boundary] (B,) of a disk are far enough from their neighbours to be told apart."""
    return bool(np.abs(np.roll(z[boundary], -1) - z[boundary]).min() > _CLOSEST)


def bend_plane(z: ComplexArray, beta: complex) -> ComplexArray:
    """Moebius map z / (1 - beta z): up to similarities every one whose pole is not 0 (PGCP eq. 6.2)."""
    return z / (1.0 - beta * z)


def _log_of_sum(logs: FloatArray) -> float:
    """Log of the sum of numbers (n,) given by their logs."""
    largest = logs.max()
    return float(largest + np.log(np.exp(logs - largest).sum()))


class AreaSample:
    """A weighted sample of faces on which the mean of |d_area| (PGCP eq. 6.1) is minimised over Moebius maps.

    surface, image (F,) areas; faces of no area are left out. Up to ``size`` faces are drawn, half of them evenly, half in
    proportion to their areas, which the totals need; fewer are all taken.
    """

    def __init__(self, surface: FloatArray, image: FloatArray, size: int = 20_000, seed: int = 0) -> None:
        usable = np.flatnonzero((surface > 0) & (image > 0))
        surface, image = surface[usable], image[usable]
        count = len(usable)
        if count <= size:
            self.chosen = usable
            chance = np.full(count, 1.0 / count)
            picked = np.arange(count)
        else:
            chance = 0.5 / count + 0.25 * image / image.sum() + 0.25 * surface / surface.sum()
            picked = np.random.default_rng(seed).choice(count, size, p=chance / chance.sum())
            self.chosen = usable[picked]
            chance = chance[picked]
        self.weights = 1.0 / chance
        self.weights /= self.weights.sum()
        self._log_weights = np.log(self.weights)
        log_surface, self._log_image = np.log(surface[picked]), np.log(image[picked])
        self._log_surface = log_surface - _log_of_sum(log_surface + self._log_weights)

    def distortion(self, growth: FloatArray, slope: FloatArray) -> tuple[float, FloatArray]:
        """Mean |d_area| (smoothed at 0) when image areas grow by exp(growth) (n,), and its gradient.

        slope (n, k) is the gradient of the growth.
        """
        log_image = self._log_image + growth
        total = _log_of_sum(log_image + self._log_weights)
        ratio = log_image - total - self._log_surface
        size = np.sqrt(ratio**2 + _SMOOTH**2)
        share = np.exp(log_image + self._log_weights - total)
        pull = self.weights * ratio / size
        return float(self.weights @ size), pull @ slope - pull.sum() * (share @ slope)


def _in_ball(u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Point of the open unit ball for any vector u (k,), and its Jacobian (k, k)."""
    size = np.sqrt(1.0 + u @ u)
    return u / size, np.eye(len(u)) / size - np.outer(u, u) / size**3


def _least_area(sample: AreaSample, growth: Callable[[FloatArray], tuple[FloatArray, FloatArray]], k: int) -> FloatArray:
    """Vector (k,) in the unit ball that minimises the distortion; growth(b) gives log area factors and their gradient."""

    def objective(u: FloatArray) -> tuple[float, FloatArray]:
        """Value and gradient, unconstrained."""
        b, jacobian = _in_ball(u)
        factor, slope = growth(b)
        value, gradient = sample.distortion(factor, slope)
        return value, gradient @ jacobian

    from scipy.optimize import minimize

    found = minimize(objective, np.zeros(k), jac=True, method="BFGS", options={"gtol": 1e-7, "maxiter": 200})
    return _in_ball(found.x)[0]


def least_area_shift(z: ComplexArray, sample: AreaSample) -> complex:
    """alpha of the disk automorphism with the least area distortion; z (n,) centres of the sampled faces."""

    def growth(b: FloatArray) -> tuple[FloatArray, FloatArray]:
        """log |f'|^2 of ``shift_disk``, but for a constant."""
        w = 1.0 - complex(b[0], -b[1]) * z
        square = np.abs(w) ** 2
        slope = 4.0 * np.column_stack([(w.conj() * z).real, (w.conj() * z).imag]) / square[:, None]
        return -2.0 * np.log(square), slope

    alpha = _least_area(sample, growth, 2)
    return complex(alpha[0], alpha[1])


def least_area_bend(z: ComplexArray, sample: AreaSample) -> complex:
    """beta of ``bend_plane`` with the least area distortion, its pole outside the unit disk, which holds z (n,)."""
    shift = least_area_shift(z, sample)
    return complex(np.conj(shift))


def least_area_boost(points: FloatArray, sample: AreaSample) -> FloatArray:
    """b (3,) of ``boost`` with the least area distortion; points (n, 3) unit vectors of the sampled faces."""

    def growth(b: FloatArray) -> tuple[FloatArray, FloatArray]:
        """log of the area factor ((1 - |b|^2) / (1 + 2 x b + |b|^2))^2, but for a constant."""
        square = 1.0 + 2.0 * points @ b + b @ b
        return -2.0 * np.log(square), -4.0 * (points + b) / square[:, None]

    return _least_area(sample, growth, 3)
