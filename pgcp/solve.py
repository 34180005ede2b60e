"""The second pass: the harmonic map of one patch with its welded boundary, and its fold check (PGCP section 4.5)."""

from __future__ import annotations

import numpy as np

from pgcp.beltrami import (
    beltrami_coefficients,
    beltrami_coefficients_on_sphere,
    folded_faces,
    folded_faces_on_sphere,
)
from pgcp.dirichlet import DirichletFactor
from pgcp.errors import SolveFailedError
from pgcp.mobius import rotation_to_north, to_plane, to_sphere
from pgcp.types import ComplexArray, FloatArray, Patch, PatchMap

_DIRECTIONS = 500


def solve_patch(patch: Patch, boundary_z: ComplexArray, factor: DirichletFactor) -> PatchMap:
    """Extend boundary positions (n_B,) harmonically (PGCP eq. 4.22) and look for folds.

    A fold is a face whose image has no positive area; |mu| >= 1 says the same. Raises SolveFailedError where a position
    is not finite.
    """
    z = _extended(patch, boundary_z, factor)
    mu = beltrami_coefficients(patch.vertices, patch.faces, z)
    return PatchMap(patch.index, z, mu, len(folded_faces(patch.faces, z)), float(np.abs(mu).max()))


def solve_patch_on_sphere(patch: Patch, boundary: FloatArray, factor: DirichletFactor) -> PatchMap:
    """Extend boundary positions on the sphere (n_B, 3) harmonically in a stereographic chart and look for folds.

    The chart's pole lies outside the patch, so the patch is not solved across infinity. Raises SolveFailedError where no
    such chart is found or a position is not finite.
    """
    rotation = rotation_to_north(-_outside(patch, boundary))
    z = _extended(patch, to_plane(boundary @ rotation.T), factor)
    points = to_sphere(z) @ rotation
    points[patch.boundary] = boundary
    mu = beltrami_coefficients_on_sphere(patch.vertices, patch.faces, points)
    return PatchMap(patch.index, points, mu, len(folded_faces_on_sphere(patch.faces, points)), float(np.abs(mu).max()))


def _extended(patch: Patch, boundary_z: ComplexArray, factor: DirichletFactor) -> ComplexArray:
    """Harmonic extension, about the place where the boundary is most crowded: there most digits are needed."""
    origin = boundary_z[int(np.argmin(np.abs(np.roll(boundary_z, -1) - boundary_z)))]
    z = origin + factor.extend(boundary_z - origin)
    if not np.isfinite(z).all():
        raise SolveFailedError(f"the harmonic map of patch {patch.index} is not finite")
    z[patch.boundary] = boundary_z
    return z


def _even_directions(count: int) -> FloatArray:
    """Unit vectors (count, 3) spread evenly over the sphere (a Fibonacci spiral)."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)
    radius = np.sqrt(1.0 - height**2)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def _outside(patch: Patch, boundary: FloatArray) -> FloatArray:
    """Point of the sphere outside the patch from which its boundary is seen with the least variation of scale.

    The stereographic projection from c takes a chord |p - q| to |p - q| / (|p - c| |q - c|) up to one scale. The
    boundary encloses the patch counter-clockwise in the chart exactly where c lies outside.
    """
    surface = patch.vertices[patch.boundary]
    lengths = np.linalg.norm(np.roll(surface, -1, axis=0) - surface, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_ratio = np.log(np.linalg.norm(np.roll(boundary, -1, axis=0) - boundary, axis=1) / lengths)
    candidates = _even_directions(_DIRECTIONS)
    middle = boundary.mean(axis=0)
    if np.linalg.norm(middle) > 0:
        candidates = np.vstack([-middle / np.linalg.norm(middle), candidates])
    with np.errstate(divide="ignore"):
        near = 0.5 * np.log(np.maximum(2.0 - 2.0 * candidates @ boundary.T, 0.0))
    scale = log_ratio - near - np.roll(near, -1, axis=1)
    mean = (scale @ lengths) / lengths.sum()
    with np.errstate(invalid="ignore"):
        variation = ((scale - mean[:, None]) ** 2) @ lengths
    variation[~np.isfinite(variation)] = np.inf
    for number in np.argsort(variation, kind="stable"):
        z = to_plane(boundary @ rotation_to_north(-candidates[number]).T)
        if np.isfinite(variation[number]) and np.imag(np.conj(z) * np.roll(z, -1)).sum() > 0:
            return candidates[number]
    raise SolveFailedError(f"no point of the sphere was found outside patch {patch.index}")
