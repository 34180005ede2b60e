"""The geodesic algorithm: a simple closed curve and what it encloses to the half-plane, and on to the unit disk.

PGCP section 3.4, CDCP section 2.2 (eq. 1-6). All boundary points are opened onto the imaginary axis by the zipper; the
square takes the quadrant that is left to the upper half-plane. Boundary points then lie on the real axis at
x = -1 / p^2, p their inverse heights, the first at infinity, the last at 0. The zipper carries the gaps between the p
with full relative precision, so angles between neighbours on the circle have it too, however crowded they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgcp.plane.mobius import balancing_step
from pgcp.plane.zipper import open_arc
from pgcp.types import ComplexArray, FloatArray

_STEPS = 300
_NEAREST = 1e-15
_LARGE = 1e150


@dataclass(frozen=True, slots=True, eq=False)
class HalfPlane:
    """A curve's points on the real axis and the points it encloses in the upper half-plane.

    x (n,) increasing, the first minus infinity; steps (n - 2,) the differences of the finite ones, precise by
    themselves; inside (m,).
    """

    x: FloatArray
    steps: FloatArray
    inside: ComplexArray

    def circle_gaps(self, centre: complex) -> FloatArray:
        """Angles (n,) from each boundary point to the next on the unit circle, when ``centre`` goes to 0."""
        a, b = centre.real, centre.imag
        u = self.x[1:] - a
        first = 2.0 * np.arctan2(b, -u[0])
        last = 2.0 * np.arctan2(b, u[-1])
        steps, size = self.steps, max(b, float(np.abs(u).max()))
        if size > _LARGE:  # products would be infinite
            u, b, steps = u / size, b / size, steps / size
        gaps = 2.0 * np.arctan2(b * steps, u[:-1] * u[1:] + b * b)
        return np.concatenate([[first], gaps, [last]])

    def circle(self, centre: complex) -> ComplexArray:
        """Boundary points (n,) on the unit circle (CDCP eq. 6), the first at 1."""
        u = self.x - centre
        with np.errstate(invalid="ignore"):
            z: ComplexArray = u / u.conj()
        z[0] = 1.0
        z /= np.abs(z)
        return z

    def disk(self, centre: complex) -> ComplexArray:
        """Enclosed points (m,) in the unit disk (CDCP eq. 6)."""
        return (self.inside - centre) / (self.inside - np.conj(centre))


def geodesic_map(boundary: ComplexArray, inside: ComplexArray) -> HalfPlane | int:
    """Map the domain in a simple closed curve (n,), counter-clockwise, to the upper half-plane.

    Returns the number of the boundary point that could not be opened where the curve is not simple, or of one that doubles
    cannot tell from its neighbour.
    """
    try:
        gaps, moved, stuck = open_arc(boundary, inside, 1.0)
    except ZeroDivisionError:  # an inner point has run into the boundary
        return 0
    if stuck >= 0:
        return stuck
    if not (gaps > 0.0).all():
        return int(np.argmin(gaps > 0.0)) + 1
    p = np.cumsum(gaps)
    if not (p[0] * p[:2][-1]) ** 2 > 0.0:  # it underflows; of three points there is one gap
        return 1
    x = np.concatenate([[-np.inf], -1.0 / p**2, [0.0]])
    # 1 / p^2 - 1 / r^2 = (r - p) (r + p) / (p r)^2
    steps = gaps[1:] * (p[:-1] + p[1:]) / (p[:-1] * p[1:]) ** 2
    return HalfPlane(x, np.append(steps, 1.0 / p[-1] ** 2), moved**2)


def _moved_centre(centre: complex, alpha: complex) -> complex:
    """Point of the half-plane that is at alpha in the disk in which ``centre`` is at 0."""
    return (centre - np.conj(centre) * alpha) / (1.0 - alpha)


def balanced_centre(plane: HalfPlane, weights: FloatArray) -> complex | None:
    """Point whose disk has the boundary points' weighted (n,) mean at 0: their conformal barycentre.

    None where the points are so crowded that the barycentre cannot be told from the real axis.
    """
    weights = weights / weights.sum()
    middle = float(np.median(plane.x[1:]))
    spread = float(np.median(np.abs(plane.x[1:] - middle)))
    centre = complex(middle, spread if spread > 0 else 1.0)
    for _ in range(_STEPS):
        on_circle = plane.circle(centre)
        step = balancing_step(np.column_stack([on_circle.real, on_circle.imag]), weights)
        if not step.any():
            break
        centre = _moved_centre(centre, complex(step[0], step[1]))
        if not (np.isfinite(centre) and centre.imag > _NEAREST * abs(centre.real)):
            return None
    return centre


def roomiest_centre(plane: HalfPlane, groups: np.ndarray, start: complex) -> complex:
    """Point whose disk keeps crowded boundary points apart: it minimises sum 1 / gap, found by steepest descent.

    groups (k,): position of the first boundary point of each group; gaps are between groups' first points.
    """

    def tightness(centre: complex) -> tuple[float, FloatArray]:
        """log sum 1 / gap, and the share of each gap."""
        gaps = np.add.reduceat(plane.circle_gaps(centre), groups)
        if not gaps.min() > 0.0:
            return np.inf, (gaps == gaps.min()) / np.count_nonzero(gaps == gaps.min())
        inverse = gaps.min() / gaps
        return float(np.log(inverse.sum()) - np.log(gaps.min())), inverse / inverse.sum()

    centre, step = start, 0.5
    value, share = tightness(centre)
    for _ in range(_STEPS):
        on_circle = plane.circle(centre)[groups]
        pull = complex(share @ (0.5 * (on_circle + np.roll(on_circle, -1))))
        if abs(pull) == 0.0 or step < 1e-6:
            break
        tried = _moved_centre(centre, pull / abs(pull) * step)
        new_value, new_share = tightness(tried)
        if new_value < value:
            centre, value, share, step = tried, new_value, new_share, min(0.9, 1.5 * step)
        else:
            step *= 0.5
    return centre
