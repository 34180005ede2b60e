"""The second pass: the harmonic map of one patch with its welded boundary, and its fold check (PGCP section 4.5)."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgcp.elimination.dirichlet import DirichletFactor, DirichletSolver
from pgcp.elimination.sparse_boundary import either_factor
from pgcp.errors import SolveFailedError
from pgcp.patches.types import Patch, PatchMap
from pgcp.plane.mobius import rotation_to_north, to_plane, to_sphere
from pgcp.plane.space import Space
from pgcp.surface.beltrami import beltrami_coefficients, folded_faces
from pgcp.surface.operators import positive_laplacian
from pgcp.surface.topology import rings_around
from pgcp.types import ComplexArray, FloatArray, IntArray, Positions

_DIRECTIONS = 500
_FEW = 2
_FEW_FRACTION = 0.002
_FIRST_REACH = 2
_LEAST_WEIGHT = 0.1
_ENOUGH_DIGITS = np.log(1e-9)
_WORTH_DIGITS = np.log(10.0)
_WIDE = np.log(0.5)
_SOUTH = np.array([0.0, 0.0, -1.0])


def solve_patch(space: Space, patch: Patch, boundary: Positions, factor: DirichletSolver, backend: str) -> PatchMap:
    """Extend boundary positions harmonically (PGCP eq. 4.22) and look for folds.

    boundary: complex (n_B,) in the plane, or unit vectors (n_B, 3). The Laplace equation is solved in the chart
    1 / (z - c), c outside the patch, in which the scale of the patch's boundary varies least, or in z itself: a Moebius
    image of a harmonic map is as conformal, and squeezed parts are resolved better; on the sphere no patch is solved across
    infinity. A fold is a face whose image has no positive area; |mu| >= 1 says the same. Where there are more
    than a few, the patch is solved again with weights made positive around them, farther and farther. Raises SolveFailedError
    where no chart is found or a position is not finite.
    """
    chart: Any = _SphereChart(patch, boundary) if space.closed else _PlaneChart(patch, boundary)
    points = _solved(patch, chart, factor, boundary)
    folded = space.folded(patch.faces, points)
    first, raised = len(folded), 0
    reach: int | None = _FIRST_REACH
    while len(folded) > max(_FEW, _FEW_FRACTION * len(patch.faces)) and reach is not None:
        chosen = rings_around(patch.faces, folded, reach, len(patch.vertices))
        laplacian, count = positive_laplacian(patch.vertices, patch.faces, chosen, _LEAST_WEIGHT, patch.mollification)
        reach = None if chosen.all() else 4 * reach
        if count <= raised:
            continue
        other = either_factor(laplacian, patch.boundary, backend)
        tried = _solved(patch, chart, other, boundary)
        other.release()
        left = space.folded(patch.faces, tried)
        if len(left) < len(folded):
            points, folded, raised = tried, left, count
    mu = space.coefficients(patch.vertices, patch.faces, points)
    return PatchMap(patch.index, points, mu, len(folded), float(np.abs(mu).max()), first, raised)


def extend_patch(patch: Patch, kept: IntArray, values: ComplexArray, factor: DirichletFactor) -> PatchMap:
    """Extend values (n_K,) on kept vertices harmonically in the plane itself, whatever folds (PGCP eq. 4.22).

    With values that are harmonic across the seams this is, patch by patch, the harmonic map of the whole mesh. Raises
    SolveFailedError where a position is not finite.
    """
    start = values[int(np.argmin(np.abs(np.roll(values, -1) - values)))]
    points = start + factor.extend(values - start)
    points[kept] = values
    if not np.isfinite(points).all():
        raise SolveFailedError(f"the harmonic map of patch {patch.index} is not finite")
    mu = beltrami_coefficients(patch.vertices, patch.faces, points)
    count = len(folded_faces(patch.faces, points))
    return PatchMap(patch.index, points, mu, count, float(np.abs(mu).max()), count)


class _PlaneChart:
    """The chart for a patch in the plane: z itself, or 1 / (z - c)."""

    def __init__(self, patch: Patch, boundary_z: ComplexArray) -> None:
        middle = boundary_z.mean()
        radius = float(np.abs(boundary_z - middle).max())
        pole = _outside(patch, to_sphere((boundary_z - middle) / radius), _SOUTH)
        self._c = None if pole is _SOUTH else middle + radius * to_plane(pole[None, :])[0]
        self.boundary = boundary_z if self._c is None else 1.0 / (boundary_z - self._c)

    def points(self, z: ComplexArray) -> ComplexArray:
        """Positions in the target of chart positions."""
        if self._c is None:
            return z
        with np.errstate(divide="ignore", invalid="ignore"):
            return self._c + 1.0 / z


class _SphereChart:
    """The chart for a patch on the sphere: a stereographic projection."""

    def __init__(self, patch: Patch, boundary: FloatArray) -> None:
        self._rotation = rotation_to_north(-_outside(patch, boundary))
        self.boundary = to_plane(boundary @ self._rotation.T)

    def points(self, z: ComplexArray) -> FloatArray:
        """Positions in the target of chart positions."""
        return to_sphere(z) @ self._rotation


def _solved(patch: Patch, chart: Any, factor: DirichletSolver, given: Any) -> Any:
    """Harmonic extension in a chart, about the place where the boundary is most crowded: there most digits are needed."""
    start = chart.boundary[int(np.argmin(np.abs(np.roll(chart.boundary, -1) - chart.boundary)))]
    points = chart.points(start + factor.extend(chart.boundary - start))
    points[patch.boundary] = given
    if not np.isfinite(points).all():
        raise SolveFailedError(f"the harmonic map of patch {patch.index} is not finite")
    return points


def _even_directions(count: int) -> FloatArray:
    """Unit vectors (count, 3) spread evenly over the sphere (a Fibonacci spiral)."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)
    radius = np.sqrt(1.0 - height**2)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def _outside(patch: Patch, boundary: FloatArray, preferred: FloatArray | None = None) -> FloatArray:
    """Point of the sphere outside the patch from which its boundary is seen with the least variation of scale.

    The preferred point, if any, is one of those compared; the point opposite the boundary's mean otherwise.

    The stereographic projection from c takes a chord |p - q| to |p - q| / (|p - c| |q - c|) up to one scale. The
    boundary encloses the patch counter-clockwise in the chart exactly where c lies outside. Where the patch is so
    squeezed in one place that a chart keeps less than nine digits of its boundary's differences, one that keeps more is
    taken.
    """
    surface = patch.vertices[patch.boundary]
    lengths = np.maximum(np.linalg.norm(np.roll(surface, -1, axis=0) - surface, axis=1), patch.mollification)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_ratio = np.log(np.linalg.norm(np.roll(boundary, -1, axis=0) - boundary, axis=1) / lengths)
    candidates = _even_directions(_DIRECTIONS)
    middle = boundary.mean(axis=0)
    if preferred is not None:
        candidates = np.vstack([preferred, candidates])
    elif np.linalg.norm(middle) > 0:
        candidates = np.vstack([-middle / np.linalg.norm(middle), candidates])
    with np.errstate(divide="ignore"):
        near = 0.5 * np.log(np.maximum(2.0 - 2.0 * candidates @ boundary.T, 0.0))
    log_chord = log_ratio + np.log(lengths)
    scale = log_ratio - near - np.roll(near, -1, axis=1)
    # digits left in the chart: shortest edge to the farthest point, seen from where the boundary is most crowded
    crowded = int(np.argmin(log_chord))
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = 0.5 * np.log(np.maximum(2.0 - 2.0 * boundary @ boundary[crowded], 0.0)) - near
        digits = (scale + np.log(lengths)).min(axis=1) - (reach.max(axis=1) - near[:, crowded])
    mean = (scale @ lengths) / lengths.sum()
    with np.errstate(invalid="ignore"):
        variation = ((scale - mean[:, None]) ** 2) @ lengths
    # from closer than this an edge is seen wide, and is no longer a short piece of a smooth curve
    too_near = (log_chord - np.minimum(near, np.roll(near, -1, axis=1))).max(axis=1) > _WIDE
    best, most_digits = None, -np.inf
    for number in np.lexsort((variation, too_near)):
        if not np.isfinite(variation[number]):
            continue
        if digits[number] <= most_digits + _WORTH_DIGITS:
            continue
        z = to_plane(boundary @ rotation_to_north(-candidates[number]).T)
        if np.imag(np.conj(z) * np.roll(z, -1)).sum() > 0:
            best, most_digits = int(number), digits[number]
            if most_digits > _ENOUGH_DIGITS:
                break
    if best is None:
        raise SolveFailedError(f"no point of the sphere was found outside patch {patch.index}")
    return preferred if preferred is not None and best == 0 else candidates[best]
