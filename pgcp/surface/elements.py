"""Linear finite elements of a triangle mesh, with lumped masses: a domain for ``equations``."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csc_array, csr_array, dia_array
from scipy.sparse.linalg import splu

from pgcp.errors import SolveFailedError
from pgcp.surface.equations import Field
from pgcp.surface.operators import around_vertices, cotangent_laplacian, needed_mollification
from pgcp.types import BoolArray, FloatArray, IntArray

_TINY = 1e-12


def lumped_areas(areas: FloatArray, faces: IntArray, count: int) -> FloatArray:
    """Areas (V,) of vertices: a third of those (F,) of the faces around; never 0, but 1e-12 of the mean at the least."""
    out = around_vertices(areas, faces, count) / 3.0
    return np.maximum(out, _TINY * max(float(areas.sum()) / count, 1e-300))


def _factor(matrix: csr_array) -> Callable[[Field], Field]:
    """Solves of a sparse matrix, symmetric and positive definite but for a symmetric imaginary part."""
    try:
        solve = splu(csc_array(matrix), "MMD_AT_PLUS_A", 0.0, options={"SymmetricMode": True}).solve
    except RuntimeError as problem:
        raise SolveFailedError(f"SuperLU could not factor a matrix of {matrix.shape[0]} vertices: {problem}") from problem
    if np.issubdtype(matrix.dtype, np.complexfloating):
        return lambda load: solve(load.astype(np.complex128))

    def real(load: Field) -> Field:
        """Solves of a real matrix, for real and complex loads."""
        if np.issubdtype(load.dtype, np.complexfloating):
            return np.asarray(solve(np.ascontiguousarray(load.real)) + 1j * solve(np.ascontiguousarray(load.imag)))
        return np.asarray(solve(load))

    return real


class Elements:
    """Finite elements on triangles ``points`` (V, 3), faces (F, 3), with masses ``areas`` (V,) that may be of another surface.

    The stiffness is the cotangent Laplacian of the triangles, which a conformal map does not change. With the areas of a
    surface and the triangles of its map, these are the surface's equations solved on the map: an image's area times the ratio
    of areas is the surface's. ``held`` (V,): vertices where w is 0; nothing flows over other boundaries.
    """

    def __init__(self, points: FloatArray, faces: IntArray, areas: FloatArray, held: BoolArray | None = None) -> None:
        self.areas = areas
        self.stiffness = cotangent_laplacian(points, faces, needed_mollification(points, faces))
        self._free = np.arange(len(points)) if held is None else np.flatnonzero(~held)
        self.is_held = len(self._free) < len(points)

    def _spread(self, values: Field) -> Field:
        """Values (V,) that are 0 where they are held."""
        out = np.zeros(len(self.areas), values.dtype)
        out[self._free] = values
        return out

    def start(self, values: Field) -> Field:
        """The values, 0 where they are held."""
        return self._spread(values[self._free])

    def nodes(self, state: Field) -> Field:
        """The values: nodes are the vertices."""
        return state

    def at_vertices(self, state: Field) -> Field:
        """The values."""
        return state

    def gradient_energy(self, state: Field) -> float:
        """Integral of |grad w|^2."""
        return float(np.vdot(state, self.stiffness @ state).real)

    def stepper(self, coefficient: complex) -> Callable[[Field, Field], Field]:
        """Solves of (M + c K) w = M r."""
        c = coefficient if np.imag(coefficient) else float(np.real(coefficient))
        mass = dia_array((self.areas[None, :], [0]), shape=self.stiffness.shape)
        solve = _factor(csr_array(mass + c * self.stiffness)[self._free][:, self._free])
        return lambda _state, values: self._spread(solve((self.areas * values)[self._free]))

    def poisson(self, values: Field) -> Field:
        """Values of w with K w = M f; where none is held, f is taken less its mean, and the mean of w is 0."""
        if self.is_held:
            return self._spread(_factor(self.stiffness[self._free][:, self._free])((self.areas * values)[self._free]))
        load = self.areas * (values - self.areas @ values / self.areas.sum())
        out = np.zeros(len(values))
        out[1:] = _factor(self.stiffness[1:][:, 1:])(load[1:])
        return np.asarray(out - self.areas @ out / self.areas.sum())

    def smoothed(self, values: Field, length: float, times: int = 4) -> Field:
        """Values (V,) after the heat that flows in the time length^2 / 4, in some steps; their integral is kept."""
        advance = self.stepper(0.25 * length**2 / times)
        for _ in range(times):
            values = advance(values, values)
        return values
