"""Moebius corrections of a finished map: least area distortion (PGCP eq. 6.1-6.3) or least angle error (CDCP eq. 20).

Moebius maps keep angles, but a piecewise linear map is carried by its vertices, so its angles change a little. A
correction is found on a sample of faces and checked on all of them; it is applied as far as it only helps, or not at all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pgcp.beltrami import find_folds
from pgcp.distortion import as_points, corner_angles, mean_distortion, mean_turned_error
from pgcp.mobius import (
    AreaSample,
    are_apart,
    bend_plane,
    boost,
    least_area_bend,
    least_area_boost,
    least_area_shift,
    shift_disk,
)
from pgcp.operators import face_areas
from pgcp.types import ComplexArray, FloatArray, IntArray, Mesh, Positions

Objective = Callable[[FloatArray], float]
_ANGLE_SAMPLE = 20_000
_SHARES = (1.0, 0.7, 0.5, 0.3, 0.15)
_ANGLE_LIMIT = 1.01
_SLACK = 1.003  # how far a sample may mislead
_FOLD_FRACTION = 0.0005
_WORTH, _PROMISING = 0.99, 0.995
_TINY = 1e-300
_LONGEST = 1.0 - 1e-12
_SCAN_SAMPLE = 2000
_SCAN_DIRECTIONS = 12
_SCAN_AIMS = 48
_SCAN_DISTANCES = (0.5, 1.0, 2.0, 3.0, 4.5, 6.0)
_SIMPLEX = 0.3
_DESCENT_STEPS = 80


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

    def undone(self) -> Correction:
        """The record of a correction that was taken back."""
        none = (0.0,) * len(self.parameter)
        before = self.log_area_before, self.angle_mean_before_deg
        return Correction(self.method, none, 0.0, before[0], before[0], before[1], before[1])


def _in_ball(v: FloatArray) -> FloatArray:
    """Point of the unit ball at hyperbolic distance 2 |v| from its centre, in the direction of v."""
    size = float(np.linalg.norm(v))
    return v * (np.tanh(size) / size) if size > 0 else v


def _family(positions: Positions, target: str, circle: tuple[complex, float] | None) -> Callable[[FloatArray], Positions]:
    """The target's Moebius maps of the positions, by a vector v; 0 is the identity. ``circle`` holds a free map."""
    if target == "sphere":
        return lambda v: boost(np.asarray(positions, np.float64), _in_ball(v))
    z = np.asarray(positions, np.complex128)
    if circle is None:
        return lambda v: shift_disk(z, complex(*_in_ball(v)))
    middle, radius = circle
    return lambda v: bend_plane((z - middle) / radius, complex(*_in_ball(v)))


def _circle_around(z: ComplexArray) -> tuple[complex, float]:
    """A circle that holds all points, not much larger than it must be."""
    middle = complex(0.5 * (z.real.min() + z.real.max()), 0.5 * (z.imag.min() + z.imag.max()))
    return middle, float(np.abs(z - middle).max())


def _least_area(mesh: Mesh, positions: Positions, target: str, used: IntArray) -> FloatArray:
    sample = AreaSample(face_areas(mesh.vertices, mesh.faces), face_areas(as_points(positions), mesh.faces))
    centres = positions[mesh.faces[sample.chosen]].mean(axis=1)
    if target == "sphere":
        b = least_area_boost(centres / np.linalg.norm(centres, axis=1)[:, None], sample)
    elif target == "disk":
        found = least_area_shift(centres, sample)
        b = np.array([found.real, found.imag])
    else:
        middle, radius = _circle_around(positions[used])
        found = least_area_bend((centres - middle) / radius, sample)
        b = np.array([found.real, found.imag])
    size = float(np.linalg.norm(b))
    return b * (np.arctanh(min(size, _LONGEST)) / size) if size > 0 else b


def _sampled(count: int) -> IntArray:
    """Faces that stand for all."""
    return np.arange(count) if count <= _ANGLE_SAMPLE else np.random.default_rng(0).choice(count, _ANGLE_SAMPLE, False)


def _angle_objective(mesh: Mesh, positions: Positions, target: str, used: IntArray, face_ids: IntArray) -> Objective:
    """Mean |angle error| (radians) of some faces as a function of the parameter."""
    ids, corners = np.unique(mesh.faces[face_ids], return_inverse=True)
    faces = corners.reshape(-1, 3)
    surface = corner_angles(mesh.vertices[ids], faces)
    move = _family(positions[ids], target, _circle_around(positions[used]) if target == "free" else None)

    def mean_error(v: FloatArray) -> float:
        """With the parameter v."""
        moved = move(v)
        points = moved if target == "sphere" else moved.view(np.float64).reshape(-1, 2)
        return float(mean_turned_error(points, faces, surface))

    return mean_error


def _least_angle(
    mesh: Mesh, positions: Positions, target: str, used: IntArray, sample: IntArray, on_sample: Objective
) -> tuple[FloatArray, float]:
    """Least mean |angle error| of a sample of faces: a scan of the ball, then Nelder-Mead (CDCP section 4.3).

    Returns where it is, and its ratio to that of the map as it is.
    """
    from scipy.optimize import minimize

    count, rng = len(mesh.faces), np.random.default_rng(1)
    rough = _angle_objective(mesh, positions, target, used, sample[:: max(1, len(sample) // _SCAN_SAMPLE)])
    k = 3 if target == "sphere" else 2
    directions = rng.normal(size=(_SCAN_DIRECTIONS, k))
    # away from places on the surface: what is crowded there opens up only when aimed at
    aims = as_points(positions)[mesh.faces[rng.choice(count, min(count, _SCAN_AIMS), False), 0], :k]
    directions = np.vstack([directions, -aims if target == "sphere" else aims])
    directions /= np.maximum(np.linalg.norm(directions, axis=1), 1e-300)[:, None]

    def descend(objective: Objective, start: FloatArray) -> tuple[float, FloatArray]:
        """Least value found from a start, and where."""
        simplex = np.vstack([start, start + _SIMPLEX * np.eye(k)])
        options = {"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-8, "maxiter": _DESCENT_STEPS}
        found = minimize(objective, start, method="Nelder-Mead", options=options)
        return float(found.fun), found.x

    starts = [np.zeros(k)] + [min((d * size for d in directions), key=rough) for size in _SCAN_DISTANCES]
    best = min((descend(rough, start) for start in starts), key=lambda pair: pair[0])[1]
    least, found = descend(on_sample, best)
    return found, least / max(on_sample(np.zeros(k)), _TINY)


def _try(
    mesh: Mesh,
    positions: Positions,
    target: str,
    method: str,
    vector: FloatArray,
    on_sample: Objective,
    boundary: IntArray,
    used: IntArray,
    before: tuple[float, float],
) -> tuple[Positions, Correction]:
    area_before, angle_before = before
    allowed = len(find_folds(mesh.faces, positions)) + int(_FOLD_FRACTION * len(mesh.faces))
    move = _family(positions, target, _circle_around(positions[used]) if target == "free" else None)
    most = (_ANGLE_LIMIT if method == "area" else 1.0) * _SLACK * on_sample(np.zeros(len(vector)))
    for share in _SHARES:
        if on_sample(share * vector) > most:
            continue
        moved = move(share * vector)
        if target == "disk":
            moved[boundary] /= np.abs(moved[boundary])
            if not are_apart(moved, boundary):
                continue
        if not np.isfinite(moved[used]).all() or len(find_folds(mesh.faces, moved)) > allowed:
            continue
        area, angle = mean_distortion(mesh, moved)
        better = area < area_before and angle <= _ANGLE_LIMIT * angle_before if method == "area" else angle < angle_before
        if better:
            parameter = tuple(_in_ball(share * vector).tolist())
            return moved, Correction(method, parameter, share, area_before, area, angle_before, angle)
    return positions, Correction(method, (0.0,) * len(vector), 0.0, area_before, area_before, angle_before, angle_before)


def correct(
    mesh: Mesh, positions: Positions, target: str, method: str, boundary: IntArray, used: IntArray
) -> tuple[Positions, Correction]:
    """Apply the Moebius map with the least area distortion (``area``) or the least angle error (``angle``).

    positions: complex (V,) or unit vectors (V, 3); boundary (B,) vertices of the loop, none on the sphere; used: ids of
    the vertices that faces use. The area correction is kept where it lowers the mean |d_area| of all faces, raises the
    mean |angle error| by no more than 1 % and folds next to nothing, the angle correction where it lowers the mean
    |angle error|; where the whole way does not do so, shorter ways are tried, but for those that a sample of the faces
    rules out. Folds are to be repaired after it. ``auto`` is the angle correction where that gains more than 1 %, else
    the area correction.
    """
    before = mean_distortion(mesh, positions)
    sample = _sampled(len(mesh.faces))
    on_sample = _angle_objective(mesh, positions, target, used, sample)
    if method != "area":
        vector, ratio = _least_angle(mesh, positions, target, used, sample, on_sample)
        if method == "angle" or ratio < _PROMISING:
            moved, correction = _try(mesh, positions, target, "angle", vector, on_sample, boundary, used, before)
            if method == "angle" or correction.angle_mean_after_deg < _WORTH * correction.angle_mean_before_deg:
                return moved, correction
    vector = _least_area(mesh, positions, target, used)
    return _try(mesh, positions, target, "area", vector, on_sample, boundary, used, before)
