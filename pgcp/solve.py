"""The second pass: the harmonic map of one patch with its welded boundary, and its fold check (PGCP section 4.5)."""

from __future__ import annotations

import numpy as np

from pgcp.beltrami import beltrami_coefficients, folded_faces
from pgcp.dirichlet import DirichletFactor
from pgcp.errors import SolveFailedError
from pgcp.types import ComplexArray, Patch, PatchMap


def solve_patch(patch: Patch, boundary_z: ComplexArray, factor: DirichletFactor) -> PatchMap:
    """Extend boundary positions (n_B,) harmonically (PGCP eq. 4.22) and look for folds.

    A fold is a face whose image has no positive area; |mu| >= 1 says the same. Repairs of folds belong here.
    Raises SolveFailedError where a position is not finite.
    """
    z = factor.extend(boundary_z)
    if not np.isfinite(z).all():
        raise SolveFailedError(f"the harmonic map of patch {patch.index} is not finite")
    mu = beltrami_coefficients(patch.vertices, patch.faces, z)
    return PatchMap(
        patch=patch.index,
        z=z,
        mu=mu,
        fold_count=len(folded_faces(patch.faces, z)),
        mu_max=float(np.abs(mu).max()),
    )
