"""Eliminate a patch's interior once, boundary last: Schur complement and harmonic extension from one factor.

Order the unknowns of the Laplacian as interior I and boundary B. Eliminating I leaves

    S = L_BB - L_BI L_II^{-1} L_IB        the Dirichlet-to-Neumann operator, dense (n_B, n_B)

and a factor with which ``L_II u_I = -L_IB u_B`` is one back-substitution (PGCP eq. 4.22). Three backends offer
the same ``DirichletFactor``: an elimination along a nested dissection of the faces, which takes a mesh; MKL PARDISO in
Schur mode where its wheel exists and SciPy SuperLU everywhere, which take any such matrix.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

import numpy as np
from scipy.sparse import csr_array

from pgcp.errors import InputError, SolveFailedError
from pgcp.options import AUTO, BACKENDS
from pgcp.surface.operators import cotangent_laplacian
from pgcp.types import ComplexArray, FloatArray, IntArray

_IN_ITS_PLACE = "superlu"  # for what the nested elimination cannot do: the same on every machine, with MKL or without
_NOT_FINITE = "the Laplacian has entries that are not finite: a face has zero area"
_LEAST_FOR_PARDISO = 16  # inner vertices: in Schur mode MKL 2026.2 crashes now and then where there are two or three


class DirichletSolver(Protocol):
    """A Laplacian that can be solved for given boundary values."""

    @property
    def nbytes(self) -> int:
        """Bytes it holds."""
        ...

    def extend(self, boundary_values: ComplexArray) -> ComplexArray:
        """Values at all n vertices of the discrete harmonic function with the given boundary values (n_B,)."""
        ...

    def release(self) -> None:
        """Free the factor's memory."""
        ...


class DirichletFactor(DirichletSolver, Protocol):
    """A Laplacian with its interior eliminated."""

    @property
    def schur(self) -> FloatArray:
        """Schur complement (n_B, n_B)."""
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


def available_backends() -> tuple[str, ...]:
    """Backends for any matrix that can run on this machine, best first."""
    from pgcp.elimination import pardiso as dirichlet_pardiso

    return ("pardiso", "superlu") if dirichlet_pardiso.is_available() else ("superlu",)


def choose_backend(name: str = "auto") -> str:
    """Resolve ``auto`` to the best backend; raise InputError where a named one is unknown or absent."""
    if name == AUTO:
        return BACKENDS[0]
    if name not in BACKENDS:
        raise InputError(f"unknown sparse backend {name!r}; choose from {AUTO}, {', '.join(BACKENDS)}")
    if name == "pardiso" and name not in available_backends():
        raise InputError("the pardiso backend is not installed here; install pgcp[mkl] or use --backend nested")
    return name


def eliminate_mesh(
    vertices: FloatArray,
    faces: IntArray,
    kept: IntArray,
    backend: str = "nested",
    mollification: float = 0.0,
    keeps: Callable[[int], bool] | None = None,
) -> DirichletFactor:
    """Factor the cotangent Laplacian of a mesh, vertices (n, 3) and faces (F, 3), with ``kept`` (n_K,) last.

    keeps(bytes), where the backend can do without, is asked whether the factor itself is wanted, or only the Schur complement;
    ``is_whole`` says which it was. Where rounding leaves the nested elimination without a positive pivot, as with needles,
    SuperLU does it. Raises SolveFailedError where the block to be eliminated is singular or a value is not finite.
    """
    if backend == "nested":
        from pgcp.elimination.nested import NestedFactor

        try:
            return _finite(NestedFactor(vertices, faces, kept, mollification, keeps))
        except SolveFailedError:
            backend = _IN_ITS_PLACE
    return eliminate_interior(cotangent_laplacian(vertices, faces, mollification), kept, backend)


def harmonic_solver(
    vertices: FloatArray,
    faces: IntArray,
    kept: IntArray,
    backend: str = "nested",
    mollification: float = 0.0,
    order: IntArray | None = None,
) -> DirichletSolver:
    """What extends values at ``kept`` (n_K,) harmonically and no more, in less time than ``eliminate_mesh``; raises alike.

    order (F,): how the nested backend has dissected the faces before.
    """
    if backend == "nested":
        from pgcp.elimination.nested import NestedSolver

        with suppress(SolveFailedError):
            return NestedSolver(vertices, faces, kept, mollification, order)
    return eliminate_mesh(vertices, faces, kept, _IN_ITS_PLACE if backend == "nested" else backend, mollification)


def extend_once(laplacian: csr_array, kept: IntArray, values: ComplexArray) -> ComplexArray:
    """Extend values (n_K,) at ``kept`` (n_K,) harmonically by any symmetric Laplacian (n, n), however many there are.

    Nothing dense is made, which ``eliminate_interior`` does of all kept vertices. Raises SolveFailedError where the interior
    block is singular or an entry is not finite.
    """
    from pgcp.elimination.superlu import harmonic_extension

    if not np.isfinite(laplacian.data).all():
        raise SolveFailedError(_NOT_FINITE)
    inner = np.ones(laplacian.shape[0], bool)
    inner[kept] = False
    return harmonic_extension(laplacian, np.flatnonzero(inner), kept, values)


def eliminate_interior(laplacian: csr_array, boundary: IntArray, backend: str = "superlu") -> DirichletFactor:
    """Factor any Laplacian (n, n), symmetric, with ``boundary`` (n_B,) kept last; nested stands for superlu.

    SuperLU also does what has few inner vertices, which PARDISO may not survive.

    Raises SolveFailedError where the interior block is singular or a value is not finite.
    """
    if not np.isfinite(laplacian.data).all():
        raise SolveFailedError(_NOT_FINITE)
    interior_mask = np.ones(laplacian.shape[0], bool)
    interior_mask[boundary] = False
    interior = np.flatnonzero(interior_mask)
    if backend == "nested":
        backend = _IN_ITS_PLACE
    if backend == "pardiso" and len(interior) >= _LEAST_FOR_PARDISO:
        from pgcp.elimination.pardiso import PardisoFactor

        return _finite(PardisoFactor(laplacian, interior, boundary))
    from pgcp.elimination.superlu import SuperLUFactor

    return _finite(SuperLUFactor(laplacian, interior, boundary))


def _finite(factor: DirichletFactor) -> DirichletFactor:
    if not np.isfinite(factor.schur).all():
        raise SolveFailedError("the Schur complement has entries that are not finite: the interior block is singular")
    return factor
