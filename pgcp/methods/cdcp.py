"""CDCP: the constructive disk conformal map of Liao, Yueh (2022), Algorithm 1.

The spherical harmonic map of the double cover, with its pole on the central face, takes the boundary close to a circle;
half of it is enough (Theorem 1), and of that only the boundary's equation S g = reduce(r). The geodesic algorithm takes the
boundary onto the circle, a Laplace solve with the same factor follows, and a Moebius map of the disk that lowers the mean
angle error ends it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgcp.elimination.sparse_boundary import AnyFactor
from pgcp.errors import SolveFailedError
from pgcp.methods.base import Method, whole
from pgcp.methods.common.disk import Disk, DiskMap, map_disk
from pgcp.methods.common.double_cover import circle_boundary, harmonic_boundary
from pgcp.options import AUTO
from pgcp.plane.mobius import are_apart, in_ball, shift_disk
from pgcp.plane.space import PLANE
from pgcp.surface.beltrami import folded_faces
from pgcp.surface.distortion import angle_errors, corner_angles
from pgcp.surface.operators import face_areas
from pgcp.types import ComplexArray, FloatArray, IntArray, Mesh

_SAMPLE = 100_000
_SIMPLEX = 0.05


def least_angle_shift(vertices: FloatArray, faces: IntArray, z: ComplexArray) -> complex:
    """Point omega of the disk whose Moebius map leaves the least mean angle error (CDCP eq. 20), by Nelder-Mead.

    vertices (V, 3), faces (F, 3), z (V,). Of more than 100,000 faces the mean is taken over a sample of so many.
    """
    count = len(faces)
    chosen = faces if count <= _SAMPLE else faces[np.random.default_rng(0).choice(count, _SAMPLE, False)]
    ids, corners = np.unique(chosen, return_inverse=True)
    corners = corners.reshape(-1, 3)
    surface, image = corner_angles(vertices[ids], corners), z[ids]

    def mean_error(v: FloatArray) -> float:
        """Mean |angle error| (radians) after the map."""
        points = PLANE.in_space(shift_disk(image, complex(*in_ball(v))))
        return float(np.abs(corner_angles(points, corners) - surface).mean())

    simplex = np.array([[0.0, 0.0], [_SIMPLEX, 0.0], [0.0, _SIMPLEX]])
    options = {"initial_simplex": simplex, "xatol": 1e-4, "fatol": 1e-8}
    from scipy.optimize import minimize

    return complex(*in_ball(minimize(mean_error, np.zeros(2), method="Nelder-Mead", options=options).x))


@dataclass(frozen=True, slots=True, eq=False)
class ConstructiveMap:
    """A CDCP map: z (V,) in the closed unit disk, and the omega of its Moebius correction, 0 where there was none."""

    z: ComplexArray
    omega: complex


def cdcp_map(mesh: Mesh, boundary: IntArray, factor: AnyFactor, centre: int, corrected: bool = True) -> ConstructiveMap:
    """Map a disk-like surface conformally to the unit disk (CDCP Algorithm 1, lines 5-11).

    boundary (n_B,) the loop, counter-clockwise; factor: the Laplacian's, boundary last; centre: the central face. The
    correction (lines 9-10, section 6.3) is kept where it lowers the mean angle error of all faces and folds none more.
    """
    z = factor.extend(circle_boundary(harmonic_boundary(mesh.vertices, mesh.faces[centre], factor)))
    if not np.isfinite(z).all():
        raise SolveFailedError("the disk map is not finite")
    if not corrected:
        return ConstructiveMap(z, 0.0j)
    omega = least_angle_shift(mesh.vertices, mesh.faces, z)
    moved = shift_disk(z, omega)
    moved *= np.conj(moved[boundary[0]]) / np.abs(moved[boundary[0]])
    moved[boundary] /= np.abs(moved[boundary])
    if not are_apart(moved, boundary) or len(folded_faces(mesh.faces, moved)) > len(folded_faces(mesh.faces, z)):
        return ConstructiveMap(z, 0.0j)
    solid = face_areas(mesh.vertices, mesh.faces) > 0.0
    after, before = (angle_errors(mesh, PLANE.coordinates(w))[solid].mean() for w in (moved, z))
    better = after < before
    return ConstructiveMap(moved, omega) if better else ConstructiveMap(z, 0.0j)


def _map(disk: Disk) -> DiskMap:
    corrected = disk.run.options.moebius == AUTO
    return DiskMap(cdcp_map(disk.run.mesh, disk.loop, disk.factor, disk.centre, corrected).z, {})


METHOD = Method(
    name="cdcp",
    targets=("disk",),
    summary="constructive: the double cover's harmonic map gives the boundary, the geodesic algorithm the circle, no iteration",
    guarantees="boundary on the circle, in order; no fold where all weights are positive",
    reference="Liao, Yueh 2022 (CDCP)",
    mapper=whole(lambda run, parts: map_disk(run, parts, _map)),
    moebius="none",
)
