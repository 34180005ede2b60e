"""A closed surface as a plane: open it at one face, and close it again on the sphere.

The surface without one face is a disk with three boundary vertices; its free conformal map fills a triangle, which the
inverse stereographic projection takes to the sphere (Haker et al. 2000; FLASH, Choi, Lam, Lui 2015, section 3.1). At the face
that chart is steep on the scale of the mesh, and what is wrong there is felt everywhere to first order. Two rings of vertices
around the face, farther and farther away, are therefore made harmonic in turn in two charts with poles on opposite sides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from pgcp.errors import SolveFailedError
from pgcp.plane.mobius import balance_sphere, rotation_to_north, to_plane, to_sphere
from pgcp.surface.distortion import corner_angles
from pgcp.surface.operators import cotangents, face_areas
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray, Mesh

_CENTRAL = 0.25
_LARGE = 0.9
_RINGS = (1.0 / 3.0, 2.0 / 3.0)
_TURNS = 4
_FARTHEST = 32
_MOST_STEPS = 100
_STRAIGHT = 1e-14


def puncture_face(mesh: Mesh) -> int:
    """The face nearest to equilateral, with the faces around it, of the quarter nearest to the surface's centre.

    Well-shaped faces resolve the opened surface best, and seen from the tip of a limb all the rest would be squeezed.
    """
    areas = face_areas(mesh.vertices, mesh.faces)
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    distance = np.linalg.norm(centres - np.average(centres, axis=0, weights=areas), axis=1)
    around = _bent_around(mesh, areas)
    return int(np.argmin(np.where(distance <= np.quantile(distance, _CENTRAL), around, np.inf)))


def _bent_around(mesh: Mesh, areas: FloatArray) -> FloatArray:
    """By how much the angles (F,) of a face, and of those around it, differ from 60 degrees at most, radians."""
    bent = np.abs(corner_angles(mesh.vertices, mesh.faces) - np.pi / 3.0).max(axis=1)
    bent[~(areas > 0.0)] = np.pi
    worst = np.zeros(len(mesh.vertices))
    np.maximum.at(worst, mesh.faces.reshape(-1), np.repeat(bent, 3))
    return np.asarray(worst[mesh.faces].max(axis=1), np.float64)


def large_faces(mesh: Mesh, count: int) -> IntArray:
    """Faces (count,) of the tenth with the largest areas, not the worst shaped of them, far from each other, the largest first.

    Where faces differ much in size, the largest are too coarse for any chart but one with its pole there.
    """
    areas = face_areas(mesh.vertices, mesh.faces)
    large = np.flatnonzero(areas >= np.quantile(areas, _LARGE))
    around = _bent_around(mesh, areas)
    shaped = large[around[large] <= np.median(around)]
    large = shaped if len(shaped) else large
    centres = mesh.vertices[mesh.faces[large]].mean(axis=1)
    chosen = [int(np.argmax(areas[large]))]
    distance = np.full(len(large), np.inf)
    while len(chosen) < min(count, len(large)):
        distance = np.minimum(distance, np.linalg.norm(centres - centres[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(distance)))
    return large[chosen[:count]]


@dataclass(frozen=True, slots=True, eq=False)
class Opened:
    """A closed surface opened at a face, and two rings around it, a third and two thirds of the area away.

    corners (3,), first, second: vertices around the face, along the orientation of the rest, and of the rings; near, far:
    which vertices (V,) lie on the face's side of the first ring and beyond the second. Either ring parts the surface in two.
    """

    corners: IntArray
    first: IntArray
    second: IntArray
    near: BoolArray
    far: BoolArray

    @property
    def kept(self) -> IntArray:
        """All of them, distinct, in the order in which operators and values on them are given."""
        return np.concatenate([self.corners, self.first, self.second])


def open_at(mesh: Mesh, face: int) -> Opened:
    """Open a surface at a face and find the two rings, by the number of edges from the face.

    Beyond a ring is the largest connected part of what is farther; the ring are its neighbours.
    """
    loop = mesh.faces[face][::-1].astype(np.int64)
    n = len(mesh.vertices)
    tails, heads = mesh.faces.reshape(-1), mesh.faces[:, [1, 2, 0]].reshape(-1)
    graph = csr_array((np.ones(len(tails), np.int8), (tails, heads)), shape=(n, n))
    distance = dijkstra(graph, unweighted=True, indices=loop, min_only=True)
    outermost = distance[mesh.faces].max(axis=1)
    order = np.argsort(outermost, kind="stable")
    areas = np.cumsum(face_areas(mesh.vertices, mesh.faces)[order])
    beyond = np.isfinite(distance)
    rings: list[IntArray] = []
    sides: list[BoolArray] = []
    level = 0.0
    for share in _RINGS:
        level = max(level + 1.0, float(outermost[order[int(np.searchsorted(areas, share * areas[-1]))]]))
        beyond = _largest_part(graph, beyond & (distance > level))
        ring = np.zeros(n, bool)
        ring[mesh.faces[beyond[mesh.faces].any(axis=1)]] = True
        ring &= ~beyond
        rings.append(np.flatnonzero(ring))
        sides.append(np.isfinite(distance) & ~(beyond | ring) if not sides else beyond)
    return Opened(loop, rings[0], rings[1], sides[0], sides[1])


def _largest_part(graph: csr_array, chosen: BoolArray) -> BoolArray:
    ids = np.flatnonzero(chosen)
    out = np.zeros_like(chosen)
    if len(ids):
        _, label = connected_components(graph[ids][:, ids], directed=False)
        out[ids[label == np.argmax(np.bincount(label))]] = True
    return out


def opened_positions(schur: FloatArray) -> ComplexArray:
    """Harmonic positions z (3 + n,) in the plane of the opened surface's corners, on a triangle, and of the two rings.

    schur (3 + n, 3 + n): operator of the closed surface on them. Another triangle would give an affine image of the same map;
    see ``straightened``. Raises SolveFailedError where the operator is not definite.
    """
    triangle = np.exp(2j * np.pi * np.arange(3) / 3.0)
    return np.concatenate([triangle, _between(schur, np.arange(3), np.arange(3, len(schur))) @ triangle])


def straightened(mesh: Mesh, z: ComplexArray, far: BoolArray) -> ComplexArray:
    """The affine image of a harmonic map z (V,) of the opened surface that is most conformal beyond the rings.

    A harmonic function of the opened surface is fixed by its three corner values, so an affine map z + nu conj(z) is all there
    is to choose. With a face's map p w + q conj(w), the mean of 2 p q / (|p|^2 + |q|^2), which says how much and which way
    the faces beyond are stretched, weighted by area on the surface, less where they are stretched much, becomes 0.
    """
    faces = mesh.faces[far[mesh.faces].any(axis=1)]
    areas = face_areas(mesh.vertices, faces)
    faces, areas = faces[areas > 0.0], areas[areas > 0.0]
    half_cotangents = 0.5 * cotangents(mesh.vertices, faces)
    for _ in range(_MOST_STEPS):
        sides = z[faces[:, [2, 0, 1]]] - z[faces[:, [1, 2, 0]]]
        size = np.maximum((half_cotangents * np.abs(sides) ** 2).sum(axis=1), np.finfo(np.float64).tiny)
        across = (half_cotangents * sides**2).sum(axis=1) / size
        trust = np.maximum(1.0 - np.abs(across) ** 2, 0.0) * areas
        stretch = complex((trust * across).sum() / max(trust.sum(), np.finfo(np.float64).tiny))
        nu = -stretch / (1.0 + np.sqrt(max(1.0 - abs(stretch) ** 2, 0.0)))
        z = z + nu * np.conj(z)
        if abs(nu) < _STRAIGHT:
            break
    return z


def close_on_sphere(mesh: Mesh, z: ComplexArray) -> FloatArray:
    """Unit vectors (V, 3) of the opened surface's planar map z (V,), their mean, weighted by area on the surface, at 0."""
    areas = np.repeat(face_areas(mesh.vertices, mesh.faces), 3)
    weights: FloatArray = np.bincount(mesh.faces.reshape(-1), areas, len(mesh.vertices)).astype(np.float64)
    used = np.flatnonzero(np.bincount(mesh.faces.reshape(-1), minlength=len(mesh.vertices)))
    points = np.tile([0.0, 0.0, 1.0], (len(mesh.vertices), 1))
    points[used], _ = balance_sphere(z[used], weights[used])
    if not np.isfinite(points).all():
        raise SolveFailedError("the map of the opened surface to the sphere is not finite")
    return points


def _rotation_from(points: FloatArray, region: BoolArray, ring: IntArray) -> FloatArray:
    """Rotation to the chart with its pole well within a region (V,) of points (V, 3) on the sphere, and away from its ring.

    The pole is the mean of the region's points, weighted by a high power of their distance from the ring.
    """
    from scipy.spatial import cKDTree

    distance = cKDTree(points[ring]).query(points[region])[0]
    if not distance.max() > 0.0:
        raise SolveFailedError("the map of the opened surface brings all of a part to its rim")
    pole = (distance / distance.max()) ** _FARTHEST @ points[region]
    return rotation_to_north(-pole / np.linalg.norm(pole))


@dataclass(frozen=True, slots=True, eq=False)
class Charts:
    """Positions of an opened surface's kept vertices on the sphere, and rotations to two charts.

    points (3 + n_1 + n_2, 3): corners, first ring, second ring, which starts at ``second``; the charts have their poles near
    the face and beyond the second ring.
    """

    points: FloatArray
    second: int
    pole_near: FloatArray
    pole_beyond: FloatArray

    def within(self) -> ComplexArray:
        """Positions z of all of them in the chart that shows the surface up to the second ring."""
        return to_plane(self.points @ self.pole_beyond.T)

    def beyond(self) -> ComplexArray:
        """The same in the chart that shows the surface beyond, where only those of the second ring matter."""
        ring = to_plane(self.points[self.second :] @ self.pole_near.T)
        return np.concatenate([np.full(self.second, ring.mean()), ring])


def charts_of(points: FloatArray, opened: Opened) -> Charts:
    """Charts for a first map of the surface to the sphere, points (V, 3)."""
    pole_near = _rotation_from(points, opened.near, opened.first)
    pole_beyond = _rotation_from(points, opened.far, opened.second)
    return Charts(points[opened.kept], 3 + len(opened.first), pole_near, pole_beyond)


def alternated(charts: Charts, schur: FloatArray) -> Charts:
    """Make the kept vertices harmonic in the two charts in turn (Schwarz 1870).

    From the first ring on, the surface is harmonic in the chart with its pole near the face; up to the second, in the one with
    its pole beyond. Each gives the other its boundary, and what is not conformal in it decays with every turn.
    schur (n_K, n_K): the closed surface's operator. Raises SolveFailedError where it is not definite.
    """
    own, near, far = charts.points.copy(), np.arange(charts.second), np.arange(charts.second, len(schur))
    first = near[3:]
    outwards, inwards = _between(schur, first, far), _between(schur, far, near)
    for _ in range(_TURNS):
        own[far] = to_sphere(outwards @ to_plane(own[first] @ charts.pole_near.T)) @ charts.pole_near
        own[near] = to_sphere(inwards @ to_plane(own[far] @ charts.pole_beyond.T)) @ charts.pole_beyond
    if not np.isfinite(own).all():
        raise SolveFailedError("the map of the closed surface is not finite")
    return replace(charts, points=own)


def _between(schur: FloatArray, held: IntArray, moved: IntArray) -> FloatArray:
    """What takes values on held vertices to those of the harmonic function on moved ones."""
    try:
        factor = cho_factor(schur[np.ix_(moved, moved)], check_finite=False)
    except LinAlgError as problem:
        raise SolveFailedError("the operator of the opened surface is not definite") from problem
    return np.asarray(-cho_solve(factor, schur[np.ix_(moved, held)], check_finite=False))


def close_region(points: FloatArray, region: BoolArray, z: ComplexArray, rotation: FloatArray) -> FloatArray:
    """Positions on the sphere (V, 3), those of a region (V,) from positions z (V,) in a chart."""
    closed = points.copy()
    closed[region] = to_sphere(z[region]) @ rotation
    return closed
