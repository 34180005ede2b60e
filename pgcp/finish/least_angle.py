"""The Moebius map with the least mean angle error (CDCP eq. 20): on a sample of faces, by slopes."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from pgcp.finish.descent import descend, settled
from pgcp.finish.families import Family
from pgcp.plane.space import Space
from pgcp.surface.distortion import corner_angles
from pgcp.types import FloatArray, IntArray, Mesh, Positions

_TINY = 1e-300
_SCAN_SAMPLE = 500
_ROUGH_SAMPLE = 2000
_SCAN_DIRECTIONS = 12
_SCAN_AIMS = 48
_SCAN_DISTANCES = (0.5, 1.0, 2.0, 3.0, 4.5, 6.0)
_LONGEST_STEP = 0.7
_SCAN_STEPS, _ROUGH_STEPS, _STEPS = 8, 12, 40
_SCAN_GAIN, _ROUGH_GAIN, _GAIN = 1e-3, 1e-5, 1e-8
_FOLLOWED = 2  # of the least values of a scan


@numba.njit(cache=True, nogil=True, error_model="numpy")
def turned_error(points: FloatArray, faces: IntArray, surface: FloatArray, on_sphere: bool, slope: FloatArray) -> float:
    """Mean |angle in the image - angle on the surface|, radians; angles of a face that is turned over count as negative.

    points (n, 3), in the plane z = 0 or ``on_sphere``, where faces look outwards; surface (F, 3) angles. Its gradient goes to
    slope (n, 3), unless that is empty.
    """
    # long: one compiled loop over faces, whose edges all corners share
    total = 0.0
    u, v, n, across_u, across_v = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        for d in range(3):
            u[d], v[d] = points[b, d] - points[a, d], points[c, d] - points[a, d]
        n[0], n[1], n[2] = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
        side = n[0] * points[a, 0] + n[1] * points[a, 1] + n[2] * points[a, 2] if on_sphere else n[2]
        area = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        for i in range(3):
            a, b, c = faces[f, i], faces[f, (i + 1) % 3], faces[f, (i + 2) % 3]
            uu, vv, uv = 0.0, 0.0, 0.0
            for d in range(3):
                u[d], v[d] = points[b, d] - points[a, d], points[c, d] - points[a, d]
                uu += u[d] * u[d]
                vv += v[d] * v[d]
                uv += u[d] * v[d]
            turned = np.sign(side) * np.arctan2(area, uv)
            error = turned - surface[f, i]
            total += abs(error)
            if slope.shape[0] == 0 or not (area > 0.0 and uu > 0.0 and vv > 0.0):
                continue
            pull = np.sign(error) * np.sign(side) / area
            for d in range(3):
                e, g = (d + 1) % 3, (d + 2) % 3
                across_u[d] = -pull * (n[e] * u[g] - n[g] * u[e]) / uu
                across_v[d] = pull * (n[e] * v[g] - n[g] * v[e]) / vv
            for d in range(3):
                slope[b, d] += across_u[d]
                slope[c, d] += across_v[d]
                slope[a, d] -= across_u[d] + across_v[d]
    count = 3 * faces.shape[0]
    for k in range(slope.shape[0]):
        for d in range(3):
            slope[k, d] /= count
    return total / count


@dataclass(frozen=True, slots=True, eq=False)
class AngleSample:
    """Mean |angle error| (radians) of some faces of a map as a function of the vector of a Moebius map.

    positions (n,) of their vertices; faces (F', 3) in numbers of these; surface (F', 3) angles.
    """

    space: Space
    family: Family
    positions: Positions
    faces: IntArray
    surface: FloatArray

    def error(self, v: FloatArray) -> float:
        """At a vector v (k,)."""
        points = self.space.in_space(self.family.moved(self.positions, v))
        return float(turned_error(points, self.faces, self.surface, self.space.closed, np.empty((0, 3))))

    def with_slope(self, v: FloatArray) -> tuple[float, FloatArray]:
        """The same, and its gradient (k,)."""
        moved = self.family.moved(self.positions, v)
        points = self.space.in_space(moved)
        slope = np.zeros((len(points), 3))
        value = float(turned_error(points, self.faces, self.surface, self.space.closed, slope))
        return value, self.family.pulled(self.positions, moved, v, slope)


def sample_angles(mesh: Mesh, space: Space, family: Family, positions: Positions, face_ids: IntArray) -> AngleSample:
    """The sample of some faces; positions (V,) of all vertices."""
    ids, corners = np.unique(mesh.faces[face_ids], return_inverse=True)
    faces = np.ascontiguousarray(corners.reshape(-1, 3), np.int32)
    return AngleSample(space, family, positions[ids], faces, corner_angles(mesh.vertices[ids], faces))


def least_angle(mesh: Mesh, space: Space, positions: Positions, face_ids: IntArray, whole: AngleSample) -> FloatArray:
    """Vector (k,) of the least mean |angle error| of a sample of faces: a scan of the ball, then down the slope.

    The error may have several least values. They are looked for on few faces, in some directions and in those that spread
    out places of the map, as what is crowded opens up only when aimed at; the best are followed on more faces, the
    least on the ``whole`` sample of face_ids (n,).
    """
    family, k, rng = whole.family, whole.family.parameters, np.random.default_rng(1)
    few = sample_angles(mesh, space, family, positions, face_ids[:: max(1, len(face_ids) // _SCAN_SAMPLE)])
    more = sample_angles(mesh, space, family, positions, face_ids[:: max(1, len(face_ids) // _ROUGH_SAMPLE)])
    directions = rng.normal(size=(_SCAN_DIRECTIONS, k))
    places = positions[mesh.faces[rng.choice(len(mesh.faces), min(len(mesh.faces), _SCAN_AIMS), False), 0]]
    directions = np.vstack([directions, family.aims(space.in_space(places))])
    directions /= np.maximum(np.linalg.norm(directions, axis=1), _TINY)[:, None]
    starts = [np.zeros(k)] + [min((d * size for d in directions), key=few.error) for size in _SCAN_DISTANCES]
    found = [descend(few.with_slope, start, _LONGEST_STEP, _SCAN_STEPS, _SCAN_GAIN) for start in starts]
    best = sorted(found, key=lambda pair: pair[0])[:_FOLLOWED]
    found = [descend(more.with_slope, v, _LONGEST_STEP, _ROUGH_STEPS, _ROUGH_GAIN) for _, v in best]
    nearest = min(found, key=lambda pair: pair[0])[1]
    return settled(whole.error, descend(whole.with_slope, nearest, 0.1 * _LONGEST_STEP, _STEPS, _GAIN)[1])
