"""Spherical harmonic transforms on a Gauss-Legendre grid, by the package ducc0, and a domain for ``surface.equations``."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator, bicgstab, cg

from pgcp.errors import InputError
from pgcp.parallel import processor_count
from pgcp.plane.harmonics import degree_and_order, points_on_rings
from pgcp.surface.equations import Field
from pgcp.types import FloatArray

_TOLERANCE, _MOST = 1e-7, 400  # of the residual of a step; rounds of conjugate gradients
_EXACT = 1e-12  # of values at any points


def _ducc() -> Any:
    """The package ducc0; raises InputError where it is not installed."""
    try:
        import ducc0
    except ImportError as problem:
        raise InputError(
            "spherical harmonics need the package ducc0, which is not installed: pip install 'pgcp[harmonics]'"
        ) from problem
    return ducc0


class SphereGrid:
    """Real harmonics up to a degree L, and a grid with half as many rings again, on which cubes of functions barely alias.

    A function is a vector ((L + 1)^2,) of the coefficients of ``harmonics.real_harmonics``. points (n, 3), weights (n,) of the
    grid: their sum is 4 pi. degrees: l of each coefficient.
    """

    def __init__(self, degree: int) -> None:
        self._ducc, self._threads = _ducc(), processor_count()
        self.degree, self._rings = degree, 3 * degree // 2 + 2
        self._around = 2 * self._rings
        self.points = points_on_rings(self._ducc.misc.GL_thetas(self._rings), self._around)
        self.weights = np.repeat(np.asarray(self._ducc.misc.GL_weights(self._rings, self._around)), self._around)
        self.degrees = degree_and_order(degree)[0].astype(np.float64)
        # ducc0 has complex coefficients of orders 0, 1, ..., of each all degrees, with the factor (-1)^m
        orders = np.repeat(np.arange(degree + 1), np.arange(degree + 1, 0, -1))
        degrees = np.concatenate([np.arange(m, degree + 1) for m in range(degree + 1)])
        self._even, self._odd = degrees * (degrees + 1) + orders, degrees * (degrees + 1) - orders
        self._factor = np.where(orders > 0, np.sqrt(0.5) * (-1.0) ** orders, 1.0)

    def _packed(self, vector: FloatArray) -> np.ndarray:
        """Complex coefficients (1, a) as ducc0 has them."""
        out = self._factor * (vector[self._even] - 1j * vector[self._odd])
        out[: self.degree + 1] = vector[self._even[: self.degree + 1]]
        return out[None]

    def synthesis(self, vector: Field) -> Field:
        """Values (n,) on the grid."""
        if np.issubdtype(vector.dtype, np.complexfloating):
            return self.synthesis(vector.real) + 1j * self.synthesis(vector.imag)
        packed = self._packed(vector)
        values = self._ducc.sht.synthesis_2d(
            alm=packed, spin=0, lmax=self.degree, geometry="GL", ntheta=self._rings, nphi=self._around, nthreads=self._threads
        )
        return np.asarray(values).reshape(-1)

    def analysis(self, values: Field) -> Field:
        """Coefficients of the projection of values (n,) on the grid: the adjoint of the synthesis, with the grid's weights."""
        if np.issubdtype(values.dtype, np.complexfloating):
            return self.analysis(values.real) + 1j * self.analysis(values.imag)
        grid = np.ascontiguousarray(values).reshape(1, self._rings, self._around)
        packed = self._ducc.sht.analysis_2d(map=grid, spin=0, lmax=self.degree, geometry="GL", nthreads=self._threads)[0]
        packed = packed / self._factor
        out = np.empty(len(self.degrees))
        out[self._odd], out[self._even] = -packed.imag, packed.real
        return out

    def at(self, vector: Field, points: FloatArray) -> Field:
        """Values (N,) at unit vectors (N, 3)."""
        if np.issubdtype(vector.dtype, np.complexfloating):
            return self.at(vector.real, points) + 1j * self.at(vector.imag, points)
        colatitude = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
        places = np.column_stack([colatitude, np.arctan2(points[:, 1], points[:, 0]) % (2.0 * np.pi)])
        packed, threads = self._packed(vector), self._threads
        values = self._ducc.sht.synthesis_general(
            alm=packed, spin=0, lmax=self.degree, loc=places, epsilon=_EXACT, nthreads=threads
        )
        return np.asarray(values)[0]


class HarmonicDomain:
    """A closed surface as its map to the sphere: Lap is 1/rho that of the sphere, rho (n,) the ratio of areas on the grid.

    A state is a vector of coefficients. vertices (V, 3): unit vectors of the mesh's vertices. to_grid(values): values (n,) of
    those (V,) at vertices. rounds: how many rounds the steps took.

    A step is that of Galerkin's method, (rho - c Lap) w = rho r projected on the harmonics. It begins with the semi-implicit
    step, in which a constant k = max(1/rho)/2 stands for 1/rho and the rest is explicit, and conjugate gradients end it; for
    complex c BiCGSTAB. Both take a diagonal in the harmonics that is nearly the matrix as their preconditioner.
    """

    def __init__(self, grid: SphereGrid, rho: FloatArray, vertices: FloatArray, to_grid: Callable[[Field], Field]) -> None:
        self.grid, self.rho, self.areas = grid, rho, grid.weights * rho
        self._vertices, self._to_grid = vertices, to_grid
        self.rounds: list[int] = []
        self.unsolved = 0

    @cached_property
    def _eigenvalues(self) -> FloatArray:
        return self.grid.degrees * (self.grid.degrees + 1.0)

    def start(self, values: Field) -> Field:
        """Coefficients of the values."""
        return self.grid.analysis(self._to_grid(values))

    def nodes(self, state: Field) -> Field:
        """Values on the grid."""
        return self.grid.synthesis(state)

    def at_vertices(self, state: Field) -> Field:
        """Values at the mesh's vertices."""
        return self.grid.at(state, self._vertices)

    def gradient_energy(self, state: Field) -> float:
        """Integral of |grad w|^2, which a conformal map keeps."""
        return float(self._eigenvalues @ np.abs(state) ** 2)

    def stepper(self, coefficient: complex) -> Callable[[Field, Field], Field]:
        """Solves of rho (w - r) = c Lap w by rounds."""
        c = coefficient if np.imag(coefficient) else float(np.real(coefficient))
        grid, rho, eigenvalues = self.grid, self.rho, self._eigenvalues
        kind, constant = np.dtype(type(c)), 0.5 * float((1.0 / rho).max())
        solve = cg if kind == np.float64 else bicgstab
        size = (len(eigenvalues), len(eigenvalues))

        def multiplied(w: Field) -> Field:
            """The operator of the step."""
            return grid.analysis(rho * grid.synthesis(w)) + c * eigenvalues * w

        middle = float(np.exp(np.average(np.log(rho), weights=self.grid.weights)))
        nearly = 1.0 / (middle + c * eigenvalues)

        def advance(state: Field, values: Field) -> Field:
            """The state after a step."""
            laplacian = grid.synthesis(-eigenvalues * state)
            first = grid.analysis(values + c * (1.0 / rho - constant) * laplacian) / (1.0 + c * constant * eigenvalues)
            load, count = grid.analysis(rho * values), [0]

            def counted(_w: Field) -> None:
                """One more round."""
                count[0] += 1

            dtype = np.result_type(load.dtype, kind)
            operator = LinearOperator(size, lambda w: multiplied(w.ravel()), dtype=dtype)
            near = LinearOperator(size, lambda w: nearly * w.ravel(), dtype=dtype)
            out, failed = solve(
                operator, load.astype(dtype), first.astype(dtype), rtol=_TOLERANCE, maxiter=_MOST, M=near, callback=counted
            )
            self.rounds.append(count[0])
            self.unsolved += failed != 0
            return np.asarray(out)

        return advance

    def poisson(self, values: Field) -> Field:
        """Coefficients of w with -Lap w = f less its mean: one division by l (l + 1); the mean of w over the surface is 0."""
        load = self.grid.analysis(self.rho * self._to_grid(values))
        out = np.where(self._eigenvalues > 0.0, load, 0.0) / np.maximum(self._eigenvalues, 1.0)
        mean = self.areas @ self.nodes(out) / self.areas.sum()
        out[0] -= mean * np.sqrt(4.0 * np.pi)
        return np.asarray(out)
