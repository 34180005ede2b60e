"""Moebius corrections of a finished map: least area distortion (PGCP eq. 6.1-6.3) or least angle error (CDCP eq. 20).

Moebius maps keep angles, but a piecewise linear map is carried by its vertices, so its angles change a little. A
correction is found on a sample of faces and checked on all of them; it is applied as far as it only helps, or not at all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from pgcp.beltrami import folded_faces, folded_faces_on_sphere
from pgcp.distortion import angle_errors, as_points, corner_angles, log_area_ratios
from pgcp.errors import InputError
from pgcp.mobius import (
    AreaSample,
    bend_plane,
    boost,
    least_area_bend,
    least_area_boost,
    least_area_shift,
    rotation_to_north,
    shift_disk,
)
from pgcp.operators import face_areas
from pgcp.types import ComplexArray, FloatArray, IntArray, Mesh

_ANGLE_SAMPLE = 20_000
_SHARES = (1.0, 0.7, 0.5, 0.3, 0.15)
_ANGLE_LIMIT = 1.01
_LONGEST = 0.999
_CLOSEST = 1e-14

Positions = ComplexArray | FloatArray


@dataclass(frozen=True, slots=True)
class Correction:
    """What a correction did: its Moebius parameter in the unit ball, and what was measured on all faces before and after.

    ``share`` is the part of the way to the optimum that was gone: 0 where the map was left as it was.
    """

    method: str
    parameter: tuple[float, ...]
    share: float
    log_area_before: float
    log_area_after: float
    angle_mean_before_deg: float
    angle_mean_after_deg: float


def _family(positions: Positions, target: str, used: IntArray) -> Callable[[FloatArray], Positions]:
    """The target's Moebius maps of the positions, by a vector in the unit ball; 0 is the identity."""
    if target == "sphere":
        return lambda b: boost(np.asarray(positions, np.float64), b)
    z = np.asarray(positions, np.complex128)
    if target == "disk":
        return lambda b: shift_disk(z, complex(b[0], b[1]))
    middle, radius = _circle_around(z[used])
    return lambda b: bend_plane((z - middle) / radius, complex(b[0], b[1]))


def _circle_around(z: ComplexArray) -> tuple[complex, float]:
    """A circle that holds all points, not much larger than it must be."""
    middle = complex(0.5 * (z.real.min() + z.real.max()), 0.5 * (z.imag.min() + z.imag.max()))
    return middle, float(np.abs(z - middle).max())


def _least_area(mesh: Mesh, positions: Positions, target: str, used: IntArray) -> FloatArray:
    sample = AreaSample(face_areas(mesh.vertices, mesh.faces), face_areas(as_points(positions), mesh.faces))
    centres = positions[mesh.faces[sample.chosen]].mean(axis=1)
    if target == "sphere":
        return least_area_boost(centres / np.linalg.norm(centres, axis=1)[:, None], sample)
    if target == "disk":
        found = least_area_shift(centres, sample)
    else:
        middle, radius = _circle_around(positions[used])
        found = least_area_bend((centres - middle) / radius, sample)
    return np.array([found.real, found.imag])


def _least_angle(mesh: Mesh, positions: Positions, target: str, used: IntArray) -> FloatArray:
    """Nelder-Mead on the mean |angle error| of a sample of faces, as in CDCP section 4.3."""
    count = len(mesh.faces)
    chosen = np.arange(count) if count <= _ANGLE_SAMPLE else np.random.default_rng(0).choice(count, _ANGLE_SAMPLE, False)
    ids, corners = np.unique(mesh.faces[chosen], return_inverse=True)
    faces = corners.reshape(-1, 3)
    surface = corner_angles(mesh.vertices[ids], faces)
    if target == "free":
        move = _family(positions, target, used)
        moved_sample: Callable[[FloatArray], Positions] = lambda b: move(b)[ids]
    else:
        moved_sample = _family(positions[ids], target, np.arange(len(ids)))

    def objective(u: FloatArray) -> float:
        """Mean |angle error| of the sample, radians."""
        b = u / np.sqrt(1.0 + u @ u)
        return float(np.abs(corner_angles(as_points(moved_sample(b)), faces) - surface).mean())

    k = 3 if target == "sphere" else 2
    start = np.vstack([np.zeros(k), 0.2 * np.eye(k)])
    options = {"initial_simplex": start, "xatol": 1e-4, "fatol": 1e-9, "maxiter": 200}
    u = minimize(objective, np.zeros(k), method="Nelder-Mead", options=options).x
    found: FloatArray = u / np.sqrt(1.0 + u @ u)
    return found


def _measured(mesh: Mesh, positions: Positions) -> tuple[float, float]:
    """Mean |d_area| and mean |angle error| (degrees) of all faces."""
    return float(np.abs(log_area_ratios(mesh, positions)).mean()), float(angle_errors(mesh, positions).mean())


def _folds(mesh: Mesh, positions: Positions) -> int:
    fold = folded_faces if positions.ndim == 1 else folded_faces_on_sphere
    return len(fold(mesh.faces, positions))


def _is_in_order(z: Positions, boundary: IntArray) -> bool:
    """Whether boundary vertices (B,) of a disk are far enough from their neighbours to be told apart."""
    return bool(np.abs(np.roll(z[boundary], -1) - z[boundary]).min() > _CLOSEST)


def correct(
    mesh: Mesh, positions: Positions, target: str, method: str, boundary: IntArray, used: IntArray
) -> tuple[Positions, Correction]:
    """Apply the Moebius map with the least area distortion (``area``) or the least angle error (``angle``).

    positions: complex (V,) or unit vectors (V, 3); boundary (B,) vertices of the loop, none on the sphere; used: ids of
    the vertices that faces use. The area correction is kept where it lowers the mean |d_area| of all faces, raises the
    mean |angle error| by no more than 1 % and folds nothing, the angle correction where it lowers the mean |angle error|;
    where the whole way does not do so, shorter ways are tried.
    """
    area_before, angle_before = _measured(mesh, positions)
    folds_before = _folds(mesh, positions)
    parameter = (_least_area if method == "area" else _least_angle)(mesh, positions, target, used)
    size = float(np.linalg.norm(parameter))
    parameter = parameter * min(1.0, _LONGEST / max(size, _LONGEST))
    move = _family(positions, target, used)
    for share in _SHARES:
        moved = move(share * parameter)
        if target == "disk":
            moved[boundary] /= np.abs(moved[boundary])
            if not _is_in_order(moved, boundary):
                continue
        if not np.isfinite(moved[used]).all() or _folds(mesh, moved) > folds_before:
            continue
        area, angle = _measured(mesh, moved)
        better = area < area_before and angle <= _ANGLE_LIMIT * angle_before if method == "area" else angle < angle_before
        if better:
            along = tuple((share * parameter).tolist())
            return moved, Correction(method, along, share, area_before, area, angle_before, angle)
    return positions, Correction(
        method, (0.0,) * len(parameter), 0.0, area_before, area_before, angle_before, angle_before
    )


def centre_on(positions: Positions, vertex: int, boundary: IntArray) -> Positions:
    """Bring a vertex to the centre of the disk, or to the north pole of the sphere.

    Raises InputError where the vertex is on the boundary, or so close to it that boundary vertices would coincide.
    """
    if positions.ndim == 2:
        return positions @ rotation_to_north(positions[vertex]).T
    if abs(positions[vertex]) >= 1.0 - _CLOSEST or vertex in boundary:
        raise InputError(f"vertex {vertex} is on the boundary: it cannot be the centre of the disk")
    moved = shift_disk(positions, complex(positions[vertex]))
    moved[boundary] /= np.abs(moved[boundary])
    if not _is_in_order(moved, boundary):
        raise InputError(f"with vertex {vertex} at the centre of the disk, boundary vertices could not be told apart")
    return moved
