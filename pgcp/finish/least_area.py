"""The Moebius map of the disk, the plane or the sphere with the least area distortion (PGCP eq. 6.1-6.3)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pgcp.finish.descent import descend, refined
from pgcp.types import ComplexArray, FloatArray

_SMOOTH = 1e-2
_STEPS = 200
_LONGEST_STEP = 1.0
_GAIN = 1e-15


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


def _pulled_in(u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Point of the open unit ball for any vector u (k,), and its Jacobian (k, k)."""
    size = np.sqrt(1.0 + u @ u)
    return u / size, np.eye(len(u)) / size - np.outer(u, u) / size**3


def _least_area(sample: AreaSample, growth: Callable[[FloatArray], tuple[FloatArray, FloatArray]], k: int) -> FloatArray:
    """Vector (k,) in the unit ball that minimises the distortion; growth(b) gives log area factors and their gradient."""

    def objective(u: FloatArray) -> tuple[float, FloatArray]:
        """Value and gradient, unconstrained."""
        b, jacobian = _pulled_in(u)
        factor, slope = growth(b)
        value, gradient = sample.distortion(factor, slope)
        return value, gradient @ jacobian

    _, found = descend(objective, np.zeros(k), _LONGEST_STEP, _STEPS, _GAIN)
    return _pulled_in(refined(objective, found))[0]


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
