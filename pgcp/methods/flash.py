"""FLASH: the landmark-free spherical conformal map in two Laplace solves (Choi, Lam, Lui 2015).

North-pole step: the most regular face is held on a similar triangle, and all else is harmonic in the plane. South-pole step:
the tenth of the vertices around the south pole is held, and all else is harmonic in the plane seen from there. The paper
corrects by a quasi-conformal map whose coefficient is that of the inverse; its generalized Laplacian is the cotangent
Laplacian of the surface itself, so that the second step is a harmonic map too.
"""

from __future__ import annotations

import numpy as np

from pgcp.errors import SolveFailedError
from pgcp.methods.base import Method, whole
from pgcp.methods.common.kept import as_mapped, first_of, harmonic_with, most_regular_face, rim_of
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts
from pgcp.surface.topology import used_vertices
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray

HELD = 10  # one vertex in so many is held in the south-pole step


def similar_triangle(corners: FloatArray) -> ComplexArray:
    """A triangle (3,) in the plane, similar to one in space (3, 3), its first edge from 0 to 1, anticlockwise."""
    one, other = corners[1] - corners[0], corners[2] - corners[0]
    square = one @ one
    return np.array([0.0, 1.0, (one @ other + 1j * np.linalg.norm(np.cross(one, other))) / square], np.complex128)


def balanced(z: ComplexArray, faces: IntArray, pole: int) -> ComplexArray:
    """Scale z (V,) so that the face ``pole`` and the one nearest 0 have equal size, each seen from the pole opposite to it."""
    near = np.abs(z)[faces].sum(axis=1)
    near[pole] = np.inf
    least = z[faces[near.argmin()]]
    if not (np.abs(least) > 0.0).all():
        raise SolveFailedError("a vertex lies at the south pole, and the map cannot be balanced")
    outer, inner = _mean_edge(z[faces[pole]]), _mean_edge(least / np.abs(least) ** 2)
    return z * np.sqrt(inner / outer)


def _mean_edge(corners: ComplexArray) -> float:
    return float(np.abs(np.roll(corners, -1) - corners).mean())


def held_in_the_south(z: ComplexArray, used: BoolArray) -> BoolArray:
    """The vertices (V,) held in the south-pole step: the tenth of those in use with the least |z|, 3 at least."""
    distance = np.where(used, np.abs(z), np.inf)
    count = max(int(used.sum()) // HELD, 3)
    held = np.zeros(len(z), bool)
    held[first_of(distance, count)] = True
    return held


def _map(run: Run, parts: Parts) -> Mapped:
    mesh = run.mesh
    pole = most_regular_face(mesh)
    used = used_vertices(mesh)
    z = harmonic_with(run, parts, mesh.faces[pole], similar_triangle(mesh.vertices[mesh.faces[pole]]))[0]
    z = balanced(z - z[used].mean(), mesh.faces, pole)
    held = held_in_the_south(z, used)
    rim = rim_of(held, mesh.faces)
    from_south = np.zeros_like(z)
    from_south[held] = z[held] / np.maximum(np.abs(z[held]), np.finfo(float).tiny) ** 2
    w, record = harmonic_with(run, parts, rim, from_south[rim])
    w[held] = from_south[held]
    square = np.abs(w) ** 2
    points = np.column_stack([2.0 * w.real, 2.0 * w.imag, 1.0 - square]) / (1.0 + square)[:, None]
    if not np.isfinite(points[used]).all():
        raise SolveFailedError("FLASH led to positions that are not finite")
    return as_mapped(run, parts, points, rim, record)


METHOD = Method(
    name="flash",
    targets=("sphere",),
    summary="spherical conformal map without landmarks: two harmonic maps, one from each pole",
    guarantees="the same map for any cuts; no folds promised",
    reference="Choi, Lam, Lui 2015 (FLASH)",
    mapper=whole(_map),
)
