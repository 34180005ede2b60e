"""What only tests need of the papers on CDCP and CCEM: descents on the angles themselves, and one step of heat diffusion."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from pgcp.methods.ccem import ITERATIONS, TOLERANCE, descend
from pgcp.methods.common.boundary_energy import apply_energy_matrix, on_circle
from pgcp.methods.common.descent import QuasiNewton
from pgcp.methods.common.double_cover import solve_symmetric

HEAT_TIME = 1e4


def curvature(schur, angles, direction):
    """Half the second derivative of E_C along a direction (n_B,) at angles (n_B,): c_2 of CCEM eq. 4.5."""
    z = on_circle(angles)
    moved = direction * z
    bent = np.vdot(moved, apply_energy_matrix(schur, moved)).real
    return 0.5 * float(bent - (direction**2 * np.conj(z) * apply_energy_matrix(schur, z)).real.sum())


class Angles:
    """The angles themselves as unknowns; the step tried first goes to the least point of the quadratic approximation.

    That is the first step only, or ``always`` (CCEM eq. 4.6).
    """

    def __init__(self, always):
        self._always = always

    def unknowns(self, angles):
        return angles

    def angles(self, x):
        return x

    def pull(self, x, gradient):
        return gradient

    def first_step(self, schur, x, gradient, direction, iteration):
        half = curvature(schur, x, direction) if iteration == 1 or self._always else 0.0
        return -float(gradient @ direction) / (2.0 * half) if half > 0.0 else 1.0


def descend_by_gradient(schur, start, iterations=ITERATIONS, tolerance=TOLERANCE):
    """Minimise E_C along its negative gradient (CCEM Algorithm 4.1)."""
    return descend(schur, start, Angles(True), lambda x, gradient: -gradient, iterations, tolerance)


def descend_by_quasi_newton(schur, start, iterations=ITERATIONS, tolerance=TOLERANCE):
    """Minimise E_C along quasi-Newton directions (CCEM Algorithm 4.2) with the steps of Algorithm 4.1 (Remark 4.2)."""
    return descend(schur, start, Angles(False), QuasiNewton(), iterations, tolerance)


def heat_matrix(laplacian, time=HEAT_TIME):
    """One implicit step of heat diffusion over ``time``: 1 + time L (n, n) (CDCP eq. 13)."""
    n = laplacian.shape[0]
    ids = np.arange(n)
    return csr_array(time * laplacian + csr_array((np.ones(n), (ids, ids)), shape=(n, n)))


def heat(factor):
    """Heat (n,) that one step brings from a boundary at 1 (CDCP eq. 13); factor: of ``heat_matrix``, boundary last."""
    on_boundary = solve_symmetric(factor.schur, np.ones((len(factor.schur), 1)))[:, 0]
    return np.asarray(factor.extend(on_boundary.astype(np.complex128)).real, np.float64)
