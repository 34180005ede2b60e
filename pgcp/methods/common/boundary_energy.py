"""The conformal energy of a disk map as a function of its boundary angles, and the record of a descent on it.

With the interior harmonic, E_C = 1/2 z^* S z - area of the polygon z, z = exp(i theta) (CCEM eq. 3.17; their matrix A of
eq. 3.15 is the Schur complement S). In complex form it is 1/2 z^* H z, H = S + iK, K the cyclic skew matrix of the area.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pgcp.elimination.sparse_boundary import AnyFactor, AnySchur
from pgcp.errors import SolveFailedError
from pgcp.types import ComplexArray, FloatArray

CLOSEST = 2e-14
_CONFORMAL = 1e-3


@dataclass(frozen=True, slots=True)
class Step:
    """One iterate: method cem or ccem, its number, the energy and the norm of its gradient by the angles there.

    step: how far along the descent direction it was reached, 0 where there is none (the start, and all of CEM).
    """

    method: str
    iteration: int
    energy: float
    gradient_norm: float
    step: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Descent:
    """Boundary angles (n_B,), increasing through one turn, and how they were reached.

    converged: the energy changed by less than the tolerance in the last iteration, not that iterations ran out.
    """

    angles: FloatArray
    steps: tuple[Step, ...]
    converged: bool


def plain_steps(steps: tuple[Step, ...]) -> list[dict[str, Any]]:
    """Return the record as plain data, one dict for each iterate, in order."""
    return [asdict(step) for step in steps]


def angles_by_length(corners: FloatArray) -> FloatArray:
    """Angles (n_B,) from 0 of a closed polygon in space (n_B, 3) put on the circle by its edge lengths."""
    lengths = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    return np.concatenate([[0.0], np.cumsum(lengths[:-1])]) * (2.0 * np.pi / lengths.sum())


def on_circle(angles: FloatArray) -> ComplexArray:
    """Points exp(i theta) (n_B,) of the unit circle."""
    z: ComplexArray = np.exp(1j * angles)
    return z


def angle_gaps(z: ComplexArray) -> FloatArray:
    """Signed angles (n_B,) in (-pi, pi] from each point of a closed polygon to the next, seen from 0."""
    return np.asarray(np.angle(np.roll(z, -1) * z.conj()), np.float64)


def goes_round_once(z: ComplexArray) -> bool:
    """Whether a closed polygon (n_B,) turns about 0 once, counter-clockwise, each point beyond the one before."""
    gaps = angle_gaps(z)
    return bool((gaps > 0.0).all()) and abs(float(gaps.sum()) - 2.0 * np.pi) < 1.0


def increasing_angles(z: ComplexArray) -> FloatArray:
    """Angles (n_B,) from 0 of points that ``goes_round_once``."""
    gaps = angle_gaps(z)
    return np.concatenate([[0.0], np.cumsum(gaps[:-1])])


def apply_energy_matrix(schur: AnySchur, z: ComplexArray) -> ComplexArray:
    """H z (n_B,), the gradient of 1/2 z^* H z by the real and imaginary parts of z."""
    product = schur @ np.column_stack([z.real, z.imag])
    out: ComplexArray = product[:, 0] + 1j * product[:, 1] + 0.5j * (np.roll(z, -1) - np.roll(z, 1))
    return out


def energy_and_gradient(schur: AnySchur, angles: FloatArray) -> tuple[float, FloatArray]:
    """E_C and its gradient (n_B,) by the angles (CCEM eq. 3.17, 4.1): Im(conj(z) H z)."""
    z = on_circle(angles)
    pulled = np.conj(z) * apply_energy_matrix(schur, z)
    return 0.5 * float(pulled.real.sum()), np.asarray(pulled.imag, np.float64)


def circle_gaps(angles: FloatArray) -> FloatArray:
    """Gaps (n_B,) from each angle to the next, the last to the first a turn later."""
    return np.diff(np.append(angles, angles[0] + 2.0 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class EnergyMap:
    """A map of little conformal energy: z (n,) in the closed unit disk, the record of its descent, whether it converged."""

    z: ComplexArray
    steps: tuple[Step, ...]
    converged: bool


def _is_conformal(schur: AnySchur, angles: FloatArray) -> bool:
    """Whether the conformal energy is small beside the area inside the boundary, as that of an obtuse triangle is."""
    z = on_circle(angles)
    area = 0.5 * float(np.imag(z.conj() * np.roll(z, -1)).sum())
    return energy_and_gradient(schur, angles)[0] < _CONFORMAL * area


def extended(factor: AnyFactor, angles: FloatArray) -> ComplexArray:
    """Positions (n,) from boundary angles; neighbours in order but too close to be told apart are spread out."""
    gaps = circle_gaps(angles)
    if gaps.max() > np.pi and not _is_conformal(factor.schur, angles):
        raise SolveFailedError(f"a boundary of {len(gaps)} vertices shrank to one side of the circle")
    gaps = np.where(gaps > 0.0, np.maximum(gaps, CLOSEST), gaps)
    angles = np.concatenate([[0.0], np.cumsum(gaps[:-1])]) * (2.0 * np.pi / gaps.sum())
    z = factor.extend(on_circle(angles))
    if not np.isfinite(z).all():
        raise SolveFailedError("the disk map is not finite")
    return z
