"""Two maps to one disk or sphere brought into line: centred, turned until they look alike, or fitted to landmarks.

A Moebius map of the disk or the sphere is a matrix (2, 2) that acts on z = p / q; on the sphere by the stereographic projection
of ``plane.mobius``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from pgcp.plane.harmonics import best_rotations, degree_of
from pgcp.plane.mobius import balancing_step, boost, boost_matrix, in_ball, sphere_points
from pgcp.types import ComplexArray, FloatArray

Field = Callable[[FloatArray], FloatArray]
_STEPS = 200
_LONGEST_STEP = 0.8
_BALANCED = 1e-12
_SLOPE_STEP = 2e-3  # radians over which differences of a field that is linear on faces are taken


# The sphere -------------------------------------------------------------------------------------------------------------------


def undone(matrix: ComplexArray) -> ComplexArray:
    """The matrix of the inverse of a Moebius map."""
    return np.array([[matrix[1, 1], -matrix[0, 1]], [-matrix[1, 0], matrix[0, 0]]])


def _pairs(points: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """p and q (n,) of unit vectors (n, 3): each has its digits on either half of the sphere."""
    across: ComplexArray = points[:, 0] + 1j * points[:, 1]
    north = points[:, 2] >= 0.0
    return np.where(north, across, 1.0 - points[:, 2]), np.where(north, 1.0 + points[:, 2], across.conj())


def moved_on_sphere(matrix: ComplexArray, points: FloatArray) -> FloatArray:
    """Unit vectors (n, 3) after a Moebius map of the sphere."""
    p, q = _pairs(points)
    return sphere_points(matrix[0, 0] * p + matrix[0, 1] * q, matrix[1, 0] * p + matrix[1, 1] * q)


def log_scale_on_sphere(matrix: ComplexArray, points: FloatArray) -> FloatArray:
    """Natural logarithm (n,) of how much a Moebius map of the sphere lengthens at unit vectors (n, 3)."""
    p, q = _pairs(points)
    before = np.abs(p) ** 2 + np.abs(q) ** 2
    after = np.abs(matrix[0, 0] * p + matrix[0, 1] * q) ** 2 + np.abs(matrix[1, 0] * p + matrix[1, 1] * q) ** 2
    return np.asarray(np.log(np.abs(np.linalg.det(matrix)) * before / after), np.float64)


def rotation_as_moebius(rotation: FloatArray) -> ComplexArray:
    """The matrix (2, 2) of a rotation (3, 3) of the sphere."""
    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return np.array([[complex(w, z), complex(y, -x)], [complex(-y, -x), complex(w, -z)]])


def centring_of_sphere(points: FloatArray, weights: FloatArray) -> ComplexArray:
    """The Moebius map without rotation after which unit vectors (n, 3) have the weighted mean 0 (Baden, Crane, Kazhdan 2018).

    weights (n,), 0 or more. Without a balance (half of the weight in one point) the last try is returned.
    """
    weights, matrix, moved = weights / weights.sum(), np.eye(2, dtype=np.complex128), points
    for _ in range(_STEPS):
        step = balancing_step(moved, weights)
        if not step.any():
            break
        matrix = boost_matrix(-step) @ matrix
        matrix = matrix / np.abs(matrix).max()
        moved = moved_on_sphere(matrix, points)
    return matrix


def turns_of_sphere(one: FloatArray, other: FloatArray, count: int) -> FloatArray:
    """Rotations (k, 3, 3) after which one function is most like another, best first, at most ``count``, far from each other.

    one, other: their coefficients ((L + 1)^2,) in spherical harmonics, correlated for all rotations as Moebius Registration
    does (Baden, Crane, Kazhdan 2018); reflections are none of them.
    """
    found, _ = best_rotations(one, other, count, 3.0 * np.pi / (degree_of(one) + 1))
    return found


def finer_turn_of_sphere(
    start: FloatArray, points: FloatArray, values: FloatArray, weights: FloatArray, field: Field, most: int = 30
) -> tuple[FloatArray, float]:
    """The rotation near ``start`` (3, 3) that takes unit vectors (n, 3) to where ``field`` has their values (n,).

    Least squares with weights (n,), in at most so many steps. Returns the rotation and the weighted mean of squared
    differences.
    """
    begun, roots = points @ start.T, np.sqrt(weights / weights.sum())

    def residuals(v: FloatArray) -> FloatArray:
        """Differences (n,) after a further rotation by the vector v (3,)."""
        return roots * (field(Rotation.from_rotvec(v).apply(begun)) - values)

    found = _least(residuals, np.zeros(3), most)
    return Rotation.from_rotvec(found.x).as_matrix() @ start, 2.0 * float(found.cost)


def landmarks_on_sphere(one: FloatArray, other: FloatArray, is_rotation: bool) -> ComplexArray:
    """The rotation, or the Moebius map, with the least squares of distances from points (n, 3) to others after it.

    A rotation is fixed by two points that are not opposite, a Moebius map by three.
    """
    rotation = Rotation.align_vectors(other, one)[0]
    turned = rotation.apply(one)
    if is_rotation:
        return rotation_as_moebius(rotation.as_matrix())

    def residuals(v: FloatArray) -> FloatArray:
        """Distances after a boost by v[:3] and a rotation by the vector v[3:]."""
        return np.asarray(Rotation.from_rotvec(v[3:]).apply(boost(turned, in_ball(v[:3]))) - other).ravel()

    v = least_squares(residuals, np.zeros(6), x_scale=0.3, xtol=1e-12, ftol=1e-12, gtol=1e-12).x
    first, last = rotation_as_moebius(rotation.as_matrix()), rotation_as_moebius(Rotation.from_rotvec(v[3:]).as_matrix())
    return last @ boost_matrix(in_ball(v[:3])) @ first


def rigid_motion(one: FloatArray, other: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation R (3, 3) and shift t (3,) for which R x + t of points x (n, 3) is nearest to others (n, 3) (Kabsch 1976).

    Least squares with weights (n,), 0 or more; no reflection.
    """
    weights = weights / weights.sum()
    middles = weights @ one, weights @ other
    left, _, right = np.linalg.svd(((other - middles[1]) * weights[:, None]).T @ (one - middles[0]))
    sign = np.sign(np.linalg.det(left @ right)) or 1.0
    rotation = left @ np.diag([1.0, 1.0, sign]) @ right
    return rotation, middles[1] - rotation @ middles[0]


# The disk ---------------------------------------------------------------------------------------------------------------------


def moved_in_plane(matrix: ComplexArray, z: ComplexArray) -> ComplexArray:
    """Points (n,) of the plane after a Moebius map."""
    return (matrix[0, 0] * z + matrix[0, 1]) / (matrix[1, 0] * z + matrix[1, 1])


def log_scale_in_plane(matrix: ComplexArray, z: ComplexArray) -> FloatArray:
    """Natural logarithm (n,) of how much a Moebius map of the plane lengthens at z (n,)."""
    return np.asarray(np.log(np.abs(np.linalg.det(matrix))) - 2.0 * np.log(np.abs(matrix[1, 0] * z + matrix[1, 1])))


def turn_of_disk(angle: float) -> ComplexArray:
    """The matrix (2, 2) of a turn of the disk, in radians."""
    return np.diag([np.exp(0.5j * angle), np.exp(-0.5j * angle)])


def shift_of_disk(alpha: complex) -> ComplexArray:
    """The matrix (2, 2) of the disk automorphism that takes alpha to 0, as ``mobius.shift_disk``."""
    return np.array([[1.0, -alpha], [-np.conj(alpha), 1.0]])


def centring_of_disk(z: ComplexArray, weights: FloatArray) -> ComplexArray:
    """The disk automorphism without rotation after which points z (n,) of the closed disk have the weighted mean 0.

    It takes to 0 the one point a where the sum of w log(|1 - conj(a) z|^2 / (1 - |a|^2)) is least. Within the disk that is a
    sum of log cosh^2(d / 2) of hyperbolic distances d, so it is convex along geodesics; on the circle it is what the
    conformal barycentre minimises.
    """
    weights, matrix = weights / weights.sum(), np.eye(2, dtype=np.complex128)
    for _ in range(_STEPS):
        moved = moved_in_plane(matrix, z)
        points = np.column_stack([moved.real, moved.imag])
        mean = weights @ points
        if not np.linalg.norm(mean) >= _BALANCED:
            break
        spread = (points * weights[:, None]).T @ points
        step = np.linalg.lstsq((1.0 + np.trace(spread)) * np.eye(2) - 2.0 * spread, mean, rcond=1e-12)[0]
        step = step if step @ mean > 0.0 else mean
        step *= min(1.0, _LONGEST_STEP / float(np.linalg.norm(step)))
        matrix = shift_of_disk(complex(*step)) @ matrix
        matrix = matrix / np.abs(matrix).max()
    return matrix


def disk_rings(radii: FloatArray, around: int) -> ComplexArray:
    """Points (rings, around) of the disk, on circles of these radii (rings,)."""
    return radii[:, None] * np.exp(2j * np.pi * np.arange(around) / around)


def turns_of_disk(one: FloatArray, other: FloatArray, count: int) -> FloatArray:
    """Angles (k,) in radians after which one function is most like another, best first, at most ``count``.

    one, other: values on ``disk_rings``, correlated on all circles at once by Fourier series.
    """
    waves = [np.fft.fft(values - values.mean(), axis=1) for values in (one, other)]
    scores = np.fft.ifft((waves[0].conj() * waves[1]).sum(axis=0)).real
    peaks = np.flatnonzero((scores >= np.roll(scores, 1)) & (scores >= np.roll(scores, -1)))
    best = peaks[np.argsort(scores[peaks])[::-1][:count]]
    return np.asarray(best * (2.0 * np.pi / len(scores)), np.float64)


def finer_turn_of_disk(
    start: float,
    z: ComplexArray,
    values: FloatArray,
    weights: FloatArray,
    field: Callable[[ComplexArray], FloatArray],
    most: int = 30,
) -> tuple[float, float]:
    """The angle near ``start`` by which a turn takes points z (n,) to where ``field`` has their values (n,).

    Least squares with weights (n,), in at most so many steps. Returns the angle in radians and the weighted mean of squared
    differences.
    """
    roots = np.sqrt(weights / weights.sum())

    def residuals(v: FloatArray) -> FloatArray:
        """Differences (n,) after a turn by the angle v (1,)."""
        return roots * (field(z * np.exp(1j * v[0])) - values)

    found = _least(residuals, np.array([start]), most)
    return float(found.x[0]), 2.0 * float(found.cost)


def landmarks_in_disk(one: ComplexArray, other: ComplexArray, is_rotation: bool) -> ComplexArray:
    """The turn, or the disk automorphism, with the least squares of distances from points (n,) to others after it.

    A turn is fixed by one point that is not the centre, an automorphism by two.
    """
    angle = float(np.angle(np.vdot(one, other)))
    if is_rotation:
        return turn_of_disk(angle)

    def matrix_of(v: FloatArray) -> ComplexArray:
        """A shift by v[:2] and a turn by v[2]."""
        return turn_of_disk(float(v[2])) @ shift_of_disk(complex(*in_ball(v[:2])))

    def residuals(v: FloatArray) -> FloatArray:
        """Distances after it."""
        away = moved_in_plane(matrix_of(v), one) - other
        return np.concatenate([away.real, away.imag])

    return matrix_of(least_squares(residuals, np.array([0.0, 0.0, angle]), xtol=1e-12, ftol=1e-12, gtol=1e-12).x)


def _least(residuals: Field, start: FloatArray, most: int) -> Any:
    """Least squares by slopes over a step that is not lost in the corners of a field that is linear on faces."""

    def slopes(v: FloatArray) -> FloatArray:
        """Jacobian (n, k) by central differences."""
        steps = _SLOPE_STEP * np.eye(len(v))
        return np.column_stack([(residuals(v + step) - residuals(v - step)) / (2.0 * _SLOPE_STEP) for step in steps])

    return least_squares(residuals, start, slopes, x_scale=0.1, xtol=1e-7, ftol=1e-9, max_nfev=most)
