"""Parts of a mesh around given faces, and the maps that are solved again on them with their rims held."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from pgcp.elimination.dirichlet import extend_once
from pgcp.plane.space import Chart
from pgcp.surface.beltrami import beltrami_coefficients, folded_faces
from pgcp.surface.operators import cotangent_laplacian, positive_laplacian, triangle_laplacian
from pgcp.surface.topology import rings_around
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray, Mesh

_LEAST_WEIGHT = 0.1
_MOST_HELD = 8000
_CHOPPED = 0.6
_THIN = 1e-5
_COMPOSITIONS = 10


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """A connected part of a mesh: its faces and vertices in the mesh, faces (F', 3) in local numbers, and the held vertices.

    held (n,) marks the vertices that must stay: those on the rim, which faces outside use as well, and fixed ones.
    """

    face_ids: IntArray
    vertex_ids: IntArray
    faces: IntArray
    held: BoolArray


@numba.njit(cache=True, nogil=True)
def _held(faces: IntArray, chosen: BoolArray, fixed: BoolArray) -> BoolArray:
    """Which vertices (V,) are fixed or used by faces that are not chosen."""
    held = fixed.copy()
    for f in range(faces.shape[0]):
        if not chosen[f]:
            held[faces[f, 0]] = held[faces[f, 1]] = held[faces[f, 2]] = True
    return held


def regions_around(faces: IntArray, start: IntArray, rings: int, fixed: BoolArray) -> list[Region]:
    """Connected parts of the faces within so many rings of the given ones; fixed (V,) vertices are held in all of them."""
    return _connected_parts(faces, rings_around(faces, start, rings, len(fixed)), fixed)


def whole_regions(faces: IntArray, fixed: BoolArray) -> list[Region]:
    """All faces, as such parts."""
    return _connected_parts(faces, np.ones(len(faces), bool), fixed)


def _connected_parts(faces: IntArray, chosen: BoolArray, fixed: BoolArray) -> list[Region]:
    held = _held(faces, chosen, fixed)
    face_ids = np.flatnonzero(chosen)
    vertex_ids, local = np.unique(faces[face_ids], return_inverse=True)
    local = local.reshape(-1, 3)
    ends = local[:, [0, 1]].T.reshape(-1), local[:, [1, 2]].T.reshape(-1)
    links = coo_array((np.ones(len(ends[0]), np.int8), ends), (len(vertex_ids), len(vertex_ids)))
    count, part = connected_components(links, directed=False)
    of_face = part[local[:, 0]]
    order = np.argsort(of_face, kind="stable")
    out = []
    for own in np.split(order, np.searchsorted(of_face[order], np.arange(1, count))):
        ids, faces_here = np.unique(local[own], return_inverse=True)
        out.append(Region(face_ids[own], vertex_ids[ids], faces_here.reshape(-1, 3), held[vertex_ids[ids]]))
    return out


def can_be_solved(region: Region, chart: Chart) -> bool:
    """Whether the region's map can be solved again: something is held, and not too much, and something is free."""
    count = int(region.held.sum())
    return chart.usable and 0 < count <= min(_MOST_HELD, len(region.held) - 1)


def _extended(laplacian: csr_array, region: Region, z: ComplexArray) -> ComplexArray:
    """Positions with those of the held vertices kept and the rest harmonic."""
    rim = np.flatnonzero(region.held)
    moved: ComplexArray = z[rim[0]] + extend_once(laplacian, rim, z[rim] - z[rim[0]])
    moved[rim] = z[rim]
    return moved


def relaxed(mesh: Mesh, region: Region, z: ComplexArray, mollification: float) -> ComplexArray:
    """Discrete harmonic map of the region, seams in it included, with the held vertices kept (PGCP eq. 4.22)."""
    laplacian = cotangent_laplacian(mesh.vertices[region.vertex_ids], region.faces, mollification)
    return _extended(laplacian, region, z)


def averaged(mesh: Mesh, region: Region, z: ComplexArray, mollification: float) -> ComplexArray:
    """The same with weights made positive: every free vertex is a mean of its neighbours (Tutte 1963, Floater 2003)."""
    everywhere = np.ones(len(region.faces), bool)
    vertices = mesh.vertices[region.vertex_ids]
    laplacian, _ = positive_laplacian(vertices, region.faces, everywhere, _LEAST_WEIGHT, mollification)
    return _extended(laplacian, region, z)


def composed(mesh: Mesh, region: Region, z: ComplexArray, mollification: float) -> ComplexArray:
    """Compose the map with the quasi-conformal one that takes its folds away, again while fewer are left.

    PGCP section 3.5: by eq. 3.16 there is a map after which the Beltrami coefficient mu of the composition is any nu;
    wanted is nu = mu, but at most 0.6 in size. The composition is harmonic in the metric |dw + nu dw*|^2 on the surface (the
    linear Beltrami equation). Needs no ``mollification``: no face of that metric is degenerate.
    """
    del mollification
    vertices = mesh.vertices[region.vertex_ids]
    best, least = z, len(folded_faces(region.faces, z))
    for _ in range(_COMPOSITIONS):
        mu = beltrami_coefficients(vertices, region.faces, best)
        nu = mu * np.minimum(1.0, _CHOPPED / np.maximum(np.abs(mu), _CHOPPED))
        laplacian = triangle_laplacian(_deformed(vertices, region.faces, nu), region.faces, len(vertices))
        moved = _extended(laplacian, region, best)
        folds = len(folded_faces(region.faces, moved))
        if folds >= least:
            break
        best, least = moved, folds
        if folds == 0:
            break
    return best


def _deformed(vertices: FloatArray, faces: IntArray, nu: ComplexArray) -> ComplexArray:
    """Corners (F, 3) of every face, laid out in the plane with its first edge along the real axis, after w + nu conj(w)."""
    u, v = vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]]
    length = np.linalg.norm(u, axis=1)
    length = np.maximum(length, _THIN * np.linalg.norm(v, axis=1))
    length[length == 0.0] = 1.0  # a face that is a point has no shape
    x = (u * v).sum(axis=1) / length
    y = np.linalg.norm(np.cross(u, v), axis=1) / length
    w = np.column_stack([np.zeros(len(faces)), length, x + 1j * np.maximum(y, _THIN * length)])
    return w + nu[:, None] * w.conj()
