"""What boundary first flattening does on the boundary alone (Sawhney, Crane 2018): scale factors, turning angles, the polygon.

A metric scaled by exp(2u) with the interior flat obeys L u = -K inside; eliminating the interior leaves

    turning angles = kappa + S u,    kappa = k - L_BI L_II^{-1} K,

S the Dirichlet-to-Neumann operator, K and k the surface's integrated curvatures inside and on the boundary.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from scipy.linalg import LinAlgError

from pgcp.elimination.sparse_boundary import AnySchur, pinned_solver
from pgcp.errors import SolveFailedError
from pgcp.methods.common.boundary_energy import goes_round_once
from pgcp.surface.operators import corner_weights
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray

_ROUNDS = 10
_STEPS = 100
_CLOSED = 1e-13
_SPAN = 300.0  # of logarithms of lengths


def integrated_curvature(
    vertices: FloatArray, faces: IntArray, boundary: IntArray, used: BoolArray, mollification: float = 0.0
) -> FloatArray:
    """2 pi less the sum of angles at each vertex (V,) in use, pi less it on the boundary (n_B,), 0 at vertices not in use.

    Angles are those whose cotangents the Laplacian has.
    """
    angles = np.arctan2(1.0, 2.0 * corner_weights(vertices, faces, mollification))
    sums = np.bincount(faces.reshape(-1), angles.reshape(-1), len(vertices))
    whole = np.where(used, 2.0 * np.pi, 0.0)
    whole[boundary] = np.pi
    return np.asarray(np.where(used, whole - sums, 0.0), np.float64)


class BoundaryFlattening:
    """A disk-like surface as its boundary sees it.

    schur S (n_B, n_B); kappa (n_B,): turning angles where nothing is scaled; lengths (n_B,) of the edges from each boundary
    vertex to the next, counter-clockwise.
    """

    def __init__(self, schur: AnySchur, kappa: FloatArray, lengths: FloatArray) -> None:
        self.schur, self.kappa, self.lengths = schur, kappa, lengths

    @cached_property
    def _solve(self) -> Callable[[FloatArray], FloatArray]:
        return pinned_solver(self.schur)

    def turning(self, factors: FloatArray) -> FloatArray:
        """Turning angles (n_B,) of the boundary whose scale factors u (n_B,) are given; their sum is 2 pi."""
        return np.asarray(self.kappa + (self.schur @ factors[:, None])[:, 0], np.float64)

    def factors(self, turning: FloatArray) -> FloatArray:
        """Scale factors u (n_B,) of mean 0 of the boundary with given turning angles (n_B,) that sum to 2 pi."""
        solved = np.concatenate([[0.0], self._solve((turning - self.kappa)[1:, None])[:, 0]])
        return np.asarray(solved - solved.mean(), np.float64)

    def scaled(self, factors: FloatArray) -> FloatArray:
        """Lengths (n_B,) of the edges under scale factors u (n_B,)."""
        return np.asarray(self.lengths * np.exp(np.clip(0.5 * (factors + np.roll(factors, -1)), -_SPAN, _SPAN)), np.float64)

    def polygon(self, lengths: FloatArray, turning: FloatArray) -> ComplexArray:
        """Vertices (n_B,) of the closed polygon with given turning angles and edges as near to given lengths as can be."""
        along = np.exp(1j * np.cumsum(turning))
        steps = closed_lengths(lengths, along, self.lengths) * along
        return np.asarray(np.concatenate([[0.0], np.cumsum(steps[:-1])]), np.complex128)

    def isometric(self) -> ComplexArray:
        """Positions (n_B,) of the boundary that keeps its lengths."""
        return self.polygon(self.lengths, self.kappa)

    def with_turning(self, turning: FloatArray) -> ComplexArray:
        """Positions (n_B,) of the boundary with given turning angles (n_B,) that sum to 2 pi."""
        return self.polygon(self.scaled(self.factors(turning)), turning)

    def with_lengths(self, lengths: FloatArray) -> ComplexArray:
        """Positions (n_B,) of the boundary with given lengths (n_B,) of its edges, up to a common factor.

        A vertex is scaled by what its two edges are, each counted by its length on the surface.
        """
        ratio = np.log(lengths / self.lengths)
        before, of_before = np.roll(self.lengths, 1), np.roll(ratio, 1)
        factors = (self.lengths * ratio + before * of_before) / (self.lengths + before)
        return self.polygon(lengths, self.turning(factors))

    def on_circle(self) -> ComplexArray:
        """Positions (n_B,) on the unit circle.

        The polygon of the iteration is not quite round: it is seen from its centre of mass, and where it does not go round that
        in order, its lengths are laid along the circle.
        """
        factors, turning = self.round_turning()
        scaled = self.scaled(factors)
        z = self.polygon(scaled, turning)
        weights = scaled + np.roll(scaled, 1)
        z = z - (z * weights).sum() / weights.sum()
        if not goes_round_once(z):
            # by length along the circle, which keeps any order
            z = np.exp(2j * np.pi * np.concatenate([[0.0], np.cumsum(scaled[:-1])]) / scaled.sum())
        return np.asarray(z / np.abs(z), np.complex128)

    def round_turning(self) -> tuple[FloatArray, FloatArray]:
        """Scale factors u (n_B,) that make the boundary a circle, and its turning angles, by a fixed-point iteration.

        Each vertex turns by its share of the length (Sawhney, Crane 2018, section 6.3).
        """
        factors = np.zeros(len(self.lengths))
        turning = self.kappa
        for _ in range(_ROUNDS):
            scaled = self.scaled(factors)
            around = 0.5 * (scaled + np.roll(scaled, 1))
            turning = 2.0 * np.pi * around / around.sum()
            factors = self.factors(turning)
        return factors, turning


def closed_lengths(lengths: FloatArray, along: ComplexArray, weights: FloatArray) -> FloatArray:
    """Lengths (n,) nearest to given ones for which edges in the directions ``along`` (n,) close up.

    Nearest by least squares, squares weighted by the inverse of ``weights`` (n,). Where that takes an edge below 0, nearest by
    relative entropy, which leaves all edges above. Raises SolveFailedError where no polygon has such directions.
    """
    try:
        found = _closed(lengths, np.stack([along.real, along.imag]), weights)
    except LinAlgError:  # all edges have one direction
        found = None
    if found is None:
        raise SolveFailedError(
            "the boundary cannot be closed with the turning angles that its scale factors ask for; choose --method pgcp or scp"
        )
    return found


def _closed(lengths: FloatArray, tangents: FloatArray, weights: FloatArray) -> FloatArray | None:
    """See ``closed_lengths``; tangents (2, n). None where steps run out."""
    weighted = tangents * weights
    nearest = lengths - weighted.T @ np.linalg.solve(weighted @ tangents.T, tangents @ lengths)
    if (nearest > 0.0).all():
        return np.asarray(nearest, np.float64)
    tilt = np.zeros(2)
    for _ in range(_STEPS):
        scaled = lengths * np.exp(np.clip(tilt @ tangents, -_SPAN, _SPAN))
        gap = tangents @ scaled
        if np.linalg.norm(gap) <= _CLOSED * scaled.sum():
            return np.asarray(scaled, np.float64)
        step = np.linalg.solve((tangents * scaled) @ tangents.T, gap)
        tilt = tilt - step * min(1.0, 1.0 / float(np.linalg.norm(step)))
    return None
