"""Moebius corrections of a finished map: least area distortion (PGCP eq. 6.1-6.3) or least angle error (CDCP eq. 20).

Moebius maps keep angles, but a piecewise linear map is carried by its vertices, so its angles change a little. A
correction is found on a sample of faces and checked on all of them; it is applied as far as it only helps, or not at all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pgcp.finish.families import Family
from pgcp.finish.least_angle import least_angle, sample_angles
from pgcp.finish.least_area import AreaSample
from pgcp.plane.mobius import in_ball
from pgcp.plane.space import Space, find_folds
from pgcp.surface.distortion import mean_distortion
from pgcp.surface.operators import face_areas
from pgcp.types import FloatArray, IntArray, Mesh, Positions

Objective = Callable[[FloatArray], float]
_ANGLE_SAMPLE = 20_000
_SHARES = (1.0, 0.7, 0.5, 0.3, 0.15)
_ANGLE_LIMIT = 1.01
_SLACK = 1.003  # how far a sample may mislead
_FOLD_FRACTION = 0.0005
_WORTH, _PROMISING = 0.99, 0.995
_TINY = 1e-300
_DIGITS = 6  # of a vector: maps that differ by rounding get the same correction
_LONGEST = 1.0 - 1e-12


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


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """What a correction works on: a map of a mesh into a space, and the Moebius maps it may choose from.

    positions (V,); boundary (B,) vertices of the loop, none on the sphere; used: ids of the vertices that faces use.
    """

    mesh: Mesh
    space: Space
    positions: Positions
    family: Family
    boundary: IntArray
    used: IntArray

    def distortion(self, positions: Positions) -> tuple[float, float]:
        """Mean |d_area| and mean |angle error| (degrees) of all faces."""
        return mean_distortion(self.mesh, self.space.in_space(positions))

    def folds(self, positions: Positions) -> int:
        """Number of folded faces."""
        return len(find_folds(self.space, self.mesh.faces, positions))


def _least_area(here: Setting) -> FloatArray:
    mesh, positions = here.mesh, here.positions
    surface, image = (face_areas(points, mesh.faces) for points in (mesh.vertices, here.space.in_space(positions)))
    if not ((surface > 0.0) & (image > 0.0)).any():  # all images are too small for an area
        return np.zeros(here.family.parameters)
    sample = AreaSample(surface, image)
    b = here.family.least_area(positions[mesh.faces[sample.chosen]].mean(axis=1), sample)
    size = float(np.linalg.norm(b))
    return b * (np.arctanh(min(size, _LONGEST)) / size) if size > 0 else b


def _sampled(count: int) -> IntArray:
    """Faces that stand for all."""
    return np.arange(count) if count <= _ANGLE_SAMPLE else np.random.default_rng(0).choice(count, _ANGLE_SAMPLE, False)


def _try(
    here: Setting, method: str, vector: FloatArray, on_sample: Objective, before: tuple[float, float]
) -> tuple[Positions, Correction]:
    area_before, angle_before = before
    allowed = here.folds(here.positions) + int(_FOLD_FRACTION * len(here.mesh.faces))
    most = (_ANGLE_LIMIT if method == "area" else 1.0) * _SLACK * on_sample(np.zeros(len(vector)))
    for share in _SHARES:
        if on_sample(share * vector) > most:
            continue
        moved = here.family.moved(here.positions, share * vector)
        if not here.family.keeps(moved, here.boundary):
            continue
        if not np.isfinite(moved[here.used]).all() or here.folds(moved) > allowed:
            continue
        area, angle = here.distortion(moved)
        better = area < area_before and angle <= _ANGLE_LIMIT * angle_before if method == "area" else angle < angle_before
        if better:
            parameter = tuple(in_ball(share * vector).tolist())
            return moved, Correction(method, parameter, share, area_before, area, angle_before, angle)
    unchanged = Correction(method, (0.0,) * len(vector), 0.0, area_before, area_before, angle_before, angle_before)
    return here.positions, unchanged


def correct(here: Setting, method: str) -> tuple[Positions, Correction]:
    """Apply the Moebius map with the least area distortion (``area``) or the least angle error (``angle``).

    The area correction is kept where it lowers the mean |d_area| of all faces, raises the
    mean |angle error| by no more than 1 % and folds next to nothing, the angle correction where it lowers the mean
    |angle error|; where the whole way does not do so, shorter ways are tried, but for those that a sample of the faces
    rules out. Folds are to be repaired after it. ``auto`` is the angle correction where that gains more than 1 %, else
    the area correction.
    """
    before = here.distortion(here.positions)
    sample = _sampled(len(here.mesh.faces))
    whole = sample_angles(here.mesh, here.space, here.family, here.positions, sample)
    on_sample = whole.error
    if method != "area":
        vector = np.round(least_angle(here.mesh, here.space, here.positions, sample, whole), _DIGITS)
        ratio = on_sample(vector) / max(on_sample(np.zeros(len(vector))), _TINY)
        if method == "angle" or ratio < _PROMISING:
            moved, correction = _try(here, "angle", vector, on_sample, before)
            if method == "angle" or correction.angle_mean_after_deg < _WORTH * correction.angle_mean_before_deg:
                return moved, correction
    return _try(here, "area", np.round(_least_area(here), _DIGITS), on_sample, before)
