"""Eliminate a patch's interior once, boundary last: Schur complement and harmonic extension from one factor.

Order the unknowns of the Laplacian as interior I and boundary B. Eliminating I leaves

    S = L_BB - L_BI L_II^{-1} L_IB        the Dirichlet-to-Neumann operator, dense (n_B, n_B)

and a factor with which ``L_II u_I = -L_IB u_B`` is one back-substitution (PGCP eq. 4.22). Two backends offer
the same ``DirichletFactor``: MKL PARDISO in Schur mode where its wheel exists, SciPy SuperLU everywhere.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy.sparse import csr_array

from pgcp.errors import InputError, SolveFailedError
from pgcp.types import ComplexArray, FloatArray, IntArray

BACKENDS = ("pardiso", "superlu")


class DirichletFactor(Protocol):
    """A Laplacian with its interior eliminated."""

    @property
    def schur(self) -> FloatArray:
        """Schur complement (n_B, n_B)."""
        ...

    @property
    def nbytes(self) -> int:
        """Bytes it holds."""
        ...

    def extend(self, boundary_values: ComplexArray) -> ComplexArray:
        """Values at all n vertices of the discrete harmonic function with the given boundary values (n_B,)."""
        ...

    def solve(self, load: ComplexArray, boundary_values: ComplexArray) -> ComplexArray:
        """Values (n,) with the given boundary values (n_B,) and, in the interior, the load: L_II u_I = r_I - L_IB u_B.

        load (n,); what it holds on the boundary does not count.
        """
        ...

    def reduce(self, load: ComplexArray) -> ComplexArray:
        """Load (n_B,) on the boundary that does what a load (n,) does on the whole: S g = reduce(r) where L h = r, g = h_B.

        It is r_B - L_BI L_II^{-1} r_I, the transpose of ``extend`` applied to r.
        """
        ...

    def release(self) -> None:
        """Free the factor's memory."""
        ...


def available_backends() -> tuple[str, ...]:
    """Backends that can run on this machine, best first."""
    from pgcp import dirichlet_pardiso

    return BACKENDS if dirichlet_pardiso.is_available() else ("superlu",)


def choose_backend(name: str = "auto") -> str:
    """Resolve ``auto`` to the best backend here; raise InputError where a named one is unknown or absent."""
    usable = available_backends()
    if name == "auto":
        return usable[0]
    if name not in BACKENDS:
        raise InputError(f"unknown sparse backend {name!r}; choose from auto, {', '.join(BACKENDS)}")
    if name not in usable:
        raise InputError(f"the {name} backend is not installed here; install pgcp[mkl] or use --backend superlu")
    return name


def eliminate_interior(laplacian: csr_array, boundary: IntArray, backend: str = "superlu") -> DirichletFactor:
    """Factor a Laplacian (n, n), symmetric, with ``boundary`` (n_B,) kept last.

    Raises SolveFailedError where the interior block is singular or a value is not finite.
    """
    if not np.isfinite(laplacian.data).all():
        raise SolveFailedError("the Laplacian has entries that are not finite: a face has zero area")
    interior_mask = np.ones(laplacian.shape[0], bool)
    interior_mask[boundary] = False
    interior = np.flatnonzero(interior_mask)
    factor: DirichletFactor
    if backend == "pardiso" and len(interior):
        from pgcp.dirichlet_pardiso import PardisoFactor

        factor = PardisoFactor(laplacian, interior, boundary)
    else:
        from pgcp.dirichlet_superlu import SuperLUFactor

        factor = SuperLUFactor(laplacian, interior, boundary)
    if not np.isfinite(factor.schur).all():
        raise SolveFailedError("the Schur complement has entries that are not finite: the interior block is singular")
    return factor
