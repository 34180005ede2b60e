"""Maps to the sphere of little conformal energy, by harmonic maps of two overlapping caps in turn (Yueh, Lin, Wu, Yau 2017).

In the stereographic chart with one pole at infinity, the vertices within a circle somewhat larger than the equator are
made harmonic, those beyond it held; then the sphere is seen from the other pole. The caps overlap, so that this is the
alternating method of Schwarz for the harmonic map to the sphere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgcp.errors import SolveFailedError
from pgcp.methods.common.double_cover import dipole
from pgcp.methods.common.kept import as_mapped, harmonic_with, most_regular_face, rim_of
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts
from pgcp.plane.mobius import to_sphere
from pgcp.surface.operators import corner_weights, face_areas
from pgcp.surface.topology import used_vertices
from pgcp.types import ComplexArray, FloatArray, IntArray

CAP = 1.2
ITERATIONS = 20
TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class SphereEnergy:
    """The conformal energy of maps of a closed surface to the sphere: faces (F, 3), weights (F, 3), half of each cotangent."""

    faces: IntArray
    weights: FloatArray

    def of(self, points: FloatArray) -> float:
        """Dirichlet energy of a map, points (V, 3), less the area of its image of flat triangles."""
        corners = points[self.faces]
        opposite = np.roll(corners, -1, axis=1) - np.roll(corners, 1, axis=1)
        dirichlet = 0.5 * float((self.weights * (opposite**2).sum(axis=2)).sum())
        return dirichlet - float(face_areas(points, self.faces).sum())


def start(run: Run, parts: Parts) -> ComplexArray:
    """The first map z (V,): the most regular face on the values of a dipole, all else harmonic; half of it in the circle."""
    mesh = run.mesh
    face = mesh.faces[most_regular_face(mesh)]
    used = used_vertices(mesh)
    z = harmonic_with(run, parts, face, dipole(mesh.vertices[face]))[0]
    z = z - z[used].mean()
    return z / np.median(np.abs(z[used]))


def seen_from_the_other_pole(z: ComplexArray) -> ComplexArray:
    """1 / z (V,), finite: 0 becomes a point far out."""
    tiny = np.finfo(float).tiny ** 0.5
    out: ComplexArray = np.reciprocal(np.where(np.abs(z) > tiny, z, tiny + 0.0j))
    return out


def _step(run: Run, parts: Parts, z: ComplexArray) -> tuple[ComplexArray, dict[str, object]]:
    """The cap around infinity made harmonic: z (V,) seen from the other pole, half of it within the circle."""
    used = used_vertices(run.mesh)
    w = seen_from_the_other_pole(z)
    held = used & ~(np.abs(w) < CAP)
    if held.all() or not held.any():
        raise SolveFailedError("no vertices lie between the two caps of the sphere")
    rim = rim_of(held, run.mesh.faces)
    moved, record = harmonic_with(run, parts, rim, w[rim])
    moved[held] = w[held]
    return moved / np.median(np.abs(moved[used])), record


def map_by_caps(run: Run, parts: Parts) -> Mapped:
    """Minimise the conformal energy of a map to the sphere: up to 20 steps, until it falls by less than 1e-6.

    A step that raises it is undone. Raises SolveFailedError where a position is not finite.
    """
    mesh = run.mesh
    energy = SphereEnergy(mesh.faces, corner_weights(mesh.vertices, mesh.faces, run.mollification))
    z, record = start(run, parts), dict[str, object]()
    points = to_sphere(z)
    values = [energy.of(points)]
    converged = False
    while not converged and len(values) <= ITERATIONS:
        z, record = _step(run, parts, z)
        moved = to_sphere(z)
        values.append(energy.of(moved))
        if not values[-1] < values[-2]:
            break
        points, converged = moved, bool(values[-2] - values[-1] < TOLERANCE)
    if not np.isfinite(values).all():
        raise SolveFailedError("CEM on the sphere led to positions that are not finite")
    iterations = [{"method": "cem", "iteration": k, "energy": value} for k, value in enumerate(values)]
    return as_mapped(run, parts, points, np.empty(0, np.int64), record, iterations=iterations, converged=converged)
