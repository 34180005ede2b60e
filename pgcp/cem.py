"""CEM: conformal energy minimisation by a fixed-point iteration (Yueh, Lin, Wu, Yau 2017), the start of CCEM.

One step moves every boundary vertex to where it is harmonic, the interior held, L_BB w = -L_BI f_I, and puts the boundary
back on the circle, its mean at 0, so that it cannot shrink to a point. With the interior harmonic, -L_BI f_I is
(L_BB - S) f_B. There is no line search: the energy may rise, and the boundary may lose its order.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import splu

from pgcp.boundary_energy import (
    Descent,
    Step,
    energy_and_gradient,
    goes_round_once,
    increasing_angles,
    on_circle,
)
from pgcp.types import FloatArray

ITERATIONS = 20
TOLERANCE = 1e-6


def cem_boundary(
    schur: FloatArray, block: csr_array, start: FloatArray, iterations: int = ITERATIONS, tolerance: float = TOLERANCE
) -> Descent:
    """Iterate from increasing angles (n_B,) until the energy changes by less than ``tolerance``.

    schur S and block L_BB (n_B, n_B). Ends before that where the boundary loses its order. Returns the iterate of least
    energy; the record holds all.
    """
    solver = splu(csc_array(block))
    best = angles = start
    energy, gradient = energy_and_gradient(schur, angles)
    least = energy
    steps = [Step("cem", 0, energy, float(np.linalg.norm(gradient)))]
    for iteration in range(1, iterations + 1):
        z = on_circle(angles)
        plane = np.column_stack([z.real, z.imag])
        plane -= solver.solve(schur @ plane)
        plane -= plane.mean(axis=0)
        z = plane[:, 0] + 1j * plane[:, 1]
        if not (np.isfinite(z).all() and goes_round_once(z)):
            return Descent(best, tuple(steps), False)
        angles, before = increasing_angles(z), energy
        energy, gradient = energy_and_gradient(schur, angles)
        steps.append(Step("cem", iteration, energy, float(np.linalg.norm(gradient))))
        if energy < least:
            best, least = angles, energy
        if abs(energy - before) < tolerance:
            return Descent(best, tuple(steps), True)
    return Descent(best, tuple(steps), False)
