"""FFGCM: the harmonic map to the sphere of Lai, Wen, Yin, Gu, Lui (2014), by descent from the Gauss map.

Every vertex goes to the sphere by its normal, and the Dirichlet energy is lowered along curves on the sphere. Where that
ends with folds, the descent starts again from a harmonic map in the plane, its most regular face held. The paper takes folds
away by eigenfunctions of a weighted Laplacian; that is left out.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pgcp.errors import SolveFailedError
from pgcp.methods.base import Method, whole
from pgcp.methods.common.kept import as_mapped
from pgcp.methods.common.sphere_descent import descend_on_sphere
from pgcp.methods.common.sphere_energy import start
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts
from pgcp.plane.mobius import to_sphere
from pgcp.plane.space import SPHERE, find_folds
from pgcp.surface.operators import cotangent_laplacian, face_areas
from pgcp.surface.topology import used_vertices
from pgcp.types import FloatArray, Mesh

_NORTH = np.array([0.0, 0.0, 1.0])


def gauss_map(mesh: Mesh) -> FloatArray:
    """Unit normals (V, 3), the mean of the faces' weighted by their areas; the north pole where there is none."""
    corners = mesh.vertices[mesh.faces]
    normals = np.repeat(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), 3, axis=0)
    flat, n = mesh.faces.reshape(-1), len(mesh.vertices)
    total = np.column_stack([np.bincount(flat, normals[:, k], n) for k in range(3)])
    size = np.linalg.norm(total, axis=1)[:, None]
    return np.where(size > 0.0, total / np.where(size > 0.0, size, 1.0), _NORTH)


def vertex_weights(mesh: Mesh) -> FloatArray:
    """Share of the surface's area (V,) around each vertex, a third of every face's."""
    areas = np.repeat(face_areas(mesh.vertices, mesh.faces), 3)
    shares = np.bincount(mesh.faces.reshape(-1), areas, len(mesh.vertices))
    return shares / shares.sum()


def _map(run: Run, parts: Parts) -> Mapped:
    mesh = run.mesh
    laplacian = cotangent_laplacian(mesh.vertices, mesh.faces, run.mollification)
    laplacian.sum_duplicates()
    weights, used = vertex_weights(mesh), used_vertices(mesh)
    starts: dict[str, Callable[[], FloatArray]] = {
        "gauss": lambda: gauss_map(mesh),
        "harmonic": lambda: to_sphere(start(run, parts)),
    }
    best, least = None, np.inf
    for name, begin in starts.items():
        points = np.where(used[:, None], begin(), _NORTH)
        with run.clock.stage("descend"):
            found = descend_on_sphere(laplacian, points, weights)
        if not np.isfinite(found.points).all():
            raise SolveFailedError("FFGCM led to positions that are not finite")
        folds = len(find_folds(SPHERE, mesh.faces, found.points))
        if folds < least:
            best, least, came_from = found, folds, name
        if folds == 0:
            break
    assert best is not None
    # the conformal energy is the Dirichlet energy less the sphere's area
    iterations = [
        {"method": f"ffgcm, {came_from}", "iteration": k, "energy": energy - 4.0 * np.pi, "gradient_norm": size}
        for k, (energy, size) in enumerate(best.steps)
    ]
    none = np.empty(0, np.int64)
    return as_mapped(run, parts, best.points, none, None, iterations=iterations, converged=best.converged)


METHOD = Method(
    name="ffgcm",
    targets=("sphere",),
    summary="harmonic map to the sphere by descent from the Gauss map, or else from a harmonic map in the plane",
    guarantees="the same map for any cuts; no folds promised",
    reference="Lai, Wen, Yin, Gu, Lui 2014 (FFGCM)",
    mapper=whole(_map),
    moebius="none",
)
