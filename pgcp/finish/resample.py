"""A surface triangulated anew through its map: points spread evenly over the surface, triangulated where they lie in the map.

PGCP section 5.7.2. Lengths in the map are those on the surface times the map's scale, so that distances h on the surface are
wanted distances h exp(log_scale) in the map.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from pgcp.errors import NumericalError
from pgcp.plane.delaunay import enclosed, planar_delaunay, spherical_delaunay
from pgcp.plane.locate import Locator
from pgcp.plane.rim import Rim
from pgcp.plane.space import Space, find_folds
from pgcp.plane.spread import even_start, relaxed, shortened, to_centroids
from pgcp.surface.distortion import log_scales
from pgcp.surface.flips import flipped
from pgcp.surface.operators import face_areas
from pgcp.surface.topology import examine
from pgcp.types import BoolArray, FloatArray, IntArray

_SAMPLES = 16  # of the surface for each point
_STEPS = 15, 10  # by the map's scale, then by the surface itself
_ROUNDS = 40
_CLEAR = 0.51  # of a boundary edge's length from its middle, in the map: no other point is closer
_LEAST_RIM, _LEAST = 3, 12  # points of a boundary, and of a closed surface


@dataclass(frozen=True, slots=True, eq=False)
class Resampled:
    """A new mesh: points on the surface (N, 3) and in the map (N, d), faces (M, 3); the first ``rim`` points are its rim."""

    points: FloatArray
    image: FloatArray
    faces: IntArray
    rim: int


@dataclass(frozen=True, eq=False)
class Sheet:
    """A surface with its map: vertices (V, 3), faces (F, 3), image (V, d) in a space; a disk or a sphere without folds."""

    vertices: FloatArray
    faces: IntArray
    image: FloatArray
    space: Space

    @cached_property
    def areas(self) -> FloatArray:
        """Areas (F,) on the surface."""
        return face_areas(self.vertices, self.faces)

    @cached_property
    def log_scale(self) -> FloatArray:
        """Logarithm (V,) of length in the map over length on the surface, from the areas around each vertex."""
        flat = np.pad(self.image, ((0, 0), (0, 3 - self.image.shape[1])))
        return log_scales(self.areas, face_areas(flat, self.faces), self.faces, len(self.vertices))

    @cached_property
    def locator(self) -> Locator:
        """Finds points of the map."""
        return Locator(self.image, self.faces, self.space.closed)

    @cached_property
    def rim(self) -> Rim | None:
        """The boundary, counter-clockwise; None of a closed surface."""
        loops = examine(self.faces, len(self.vertices)).loops
        if self.space.closed:
            return None
        loop = loops[0]
        x, y = self.image[loop].T
        if np.dot(x, np.roll(y, -1)) < np.dot(y, np.roll(x, -1)):
            loop = loop[::-1]
        return Rim(self.vertices[loop], self.image[loop])

    def spacing_for(self, count: int) -> float:
        """Distance at which ``count`` points fill the surface as corners of equilateral triangles."""
        area, length = float(self.areas.sum()), 0.0 if self.rim is None else float(self.rim.ends[-1])
        # count = 2 area / (sqrt(3) h^2) + length / (2 h) + 1
        inner = max(count - (2 if self.rim is None else 1), 1)
        return float((length / 2 + np.sqrt(length**2 / 4 + 8.0 * inner * area / np.sqrt(3.0))) / (2 * inner))

    def count_for(self, spacing: float) -> int:
        """About how many points lie so far apart."""
        area, length = float(self.areas.sum()), 0.0 if self.rim is None else float(self.rim.ends[-1])
        return int(2.0 * area / (np.sqrt(3.0) * spacing**2) + length / (2.0 * spacing) + (2 if self.rim is None else 1) + 0.5)

    def samples(self, count: int, seed: int) -> FloatArray:
        """So many places (n, d) in the map, evenly by area on the surface; systematic and random."""
        rng = np.random.default_rng(seed)
        total = np.cumsum(self.areas)
        found = np.searchsorted(total, (np.arange(count) + rng.random(count)) / count * total[-1])
        weights = rng.dirichlet([1.0, 1.0, 1.0], count)
        corners = self.image[self.faces[np.minimum(found, len(self.faces) - 1)]]
        return self.on_space(np.einsum("nk,nkd->nd", weights, corners))

    def on_space(self, places: FloatArray) -> FloatArray:
        """Places of chords of the sphere, on the sphere; those of the plane as they are."""
        return places / np.linalg.norm(places, axis=1)[:, None] if self.space.closed else places

    def settled(self, before: FloatArray, after: FloatArray) -> FloatArray:
        """Where moved places come to lie: those that have left the map stay where they were."""
        after = self.on_space(after)
        inside = self.locator.find(after, self.vertices).inside
        return np.where(inside[:, None], after, before)

    def spacing_at(self, places: FloatArray, spacing: float) -> FloatArray:
        """Distances (n,) in the map that are ``spacing`` on the surface."""
        found = self.locator.find(places, self.vertices)
        return np.asarray(spacing * np.exp(np.einsum("nk,nk->n", found.weights, self.log_scale[self.faces[found.faces]])))

    def to_map(self, found: IntArray, ways: FloatArray) -> FloatArray:
        """Ways (n, 3) on faces (n,) of the surface as ways in the map (n, d)."""
        corners, image = self.vertices[self.faces[found]], self.image[self.faces[found]]
        one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        a, b, c = (np.einsum("nk,nk->n", *pair) for pair in ((one, one), (one, two), (two, two)))
        p, q = np.einsum("nk,nk->n", one, ways), np.einsum("nk,nk->n", two, ways)
        determinant = a * c - b * b
        good = determinant > 1e-12 * a * c
        safe = np.where(good, determinant, 1.0)
        x, y = np.where(good, (c * p - b * q) / safe, 0.0), np.where(good, (a * q - b * p) / safe, 0.0)
        return x[:, None] * (image[:, 1] - image[:, 0]) + y[:, None] * (image[:, 2] - image[:, 0])

    def upright(self, image: FloatArray) -> Callable[[IntArray], BoolArray]:
        """Whether faces (n, 3) of places (N, d) are not folded."""

        def are(faces: IntArray) -> BoolArray:
            """Whether each face is not folded."""
            good = np.ones(len(faces), bool)
            good[find_folds(self.space, faces, self.space.positions(image))] = False
            return good

        return are


def resampled(
    sheet: Sheet, spacing: float, count: int | None = None, seed: int = 0, steps: tuple[int, int] = _STEPS
) -> Resampled:
    """Triangulate a surface anew, with edges of about ``spacing`` on it; ``count``: points wanted, by the spacing else.

    Raises NumericalError where the points cannot be triangulated to one surface of the same kind.
    """
    lengths = np.empty(0) if sheet.rim is None else sheet.rim.spaced(spacing)
    wanted = sheet.count_for(spacing) if count is None else count
    inner = max(wanted - len(lengths), 0 if len(lengths) else _LEAST)
    rim = np.empty((0, sheet.space.dimension)) if sheet.rim is None else sheet.rim.at(lengths)[1]
    samples = sheet.samples(max(_SAMPLES * inner, 1), seed)
    image = np.vstack([rim, samples[even_start(samples, inner)]]) if inner else rim
    for moves, count_of in zip((_by_scale, _by_surface), steps, strict=True):
        image = relaxed(image, len(rim), moves(sheet, spacing, len(rim)), sheet.settled, count_of if inner else 0)
    if sheet.rim is not None:
        return triangulated_within(sheet, lengths, image[len(rim) :])
    return triangulated_of_sphere(sheet, image)


def _triangles(sheet: Sheet, image: FloatArray, spacing: FloatArray | None, rim: int) -> IntArray:
    """Delaunay triangles of places in the map."""
    if not sheet.space.closed:
        return enclosed(planar_delaunay(image), rim)[0]
    return spherical_delaunay(image, 0 if spacing is None else int(np.argmax(spacing)))


def _by_scale(sheet: Sheet, spacing: float, rim: int) -> Callable[[FloatArray], FloatArray]:
    """Ways to centroids of cells in the map, under the density that the map's scale gives."""

    def ways(image: FloatArray) -> FloatArray:
        """Ways in the map (N, d)."""
        wanted = sheet.spacing_at(image, spacing)
        return shortened(to_centroids(image, _triangles(sheet, image, wanted, rim), wanted), wanted)

    return ways


def _by_surface(sheet: Sheet, spacing: float, rim: int) -> Callable[[FloatArray], FloatArray]:
    """Ways to centroids of cells of the triangles on the surface, which need no scale: where that differs within a face."""

    def ways(image: FloatArray) -> FloatArray:
        """Ways in the map (N, d)."""
        found = sheet.locator.find(image, sheet.vertices)
        wanted = np.full(len(image), spacing)
        on_surface = to_centroids(found.points, _triangles(sheet, image, None, rim), wanted)
        return sheet.to_map(found.faces, shortened(on_surface, wanted))

    return ways


def _finished(sheet: Sheet, image: FloatArray, points: FloatArray, faces: IntArray, rim: int) -> Resampled:
    """A mesh without unused points, its edges flipped; raises NumericalError where it is not of the surface's kind."""
    used = np.unique(faces)
    number = np.zeros(len(points), np.int64)
    number[used] = np.arange(len(used))
    image, points, faces = image[used], points[used], number[faces]
    faces = flipped(points, faces, sheet.upright(image))
    if not examine(faces.astype(np.int32), len(points)).fits(sheet.space.closed) or not sheet.upright(image)(faces).all():
        raise NumericalError("the points of the map cannot be triangulated to one surface; ask for more, or for another target")
    return Resampled(points, image, faces.astype(np.int32), rim)


def triangulated_of_sphere(sheet: Sheet, image: FloatArray) -> Resampled:
    """The mesh of places (n, 3) on the sphere; those where it is no surface, as some lie at one place, are left out.

    Raises NumericalError where the mesh is no sphere.
    """
    for _ in range(_ROUNDS):
        faces = _triangles(sheet, image, sheet.spacing_at(image, 1.0), 0)
        wrong = _wrong_points(faces, sheet.upright(image)(faces), len(image))
        if not wrong.any():
            break
        image = image[~wrong]
    return _finished(sheet, image, sheet.locator.find(image, sheet.vertices).points, faces, 0)


def _wrong_points(faces: IntArray, good: BoolArray, count: int) -> BoolArray:
    """Points (count,) that are in no face, in one that is not good, or at an edge that has not two faces."""
    wrong = np.ones(count, bool)
    wrong[faces] = False
    ends = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, times = np.unique(ends[:, 0].astype(np.int64) << 32 | ends[:, 1], return_counts=True)
    wrong[edges[times != 2] >> 32] = True
    wrong[faces[~good][:, 0]] = True
    return wrong


def triangulated_within(sheet: Sheet, lengths: FloatArray, inner: FloatArray) -> Resampled:
    """The mesh of places (n, 2) of the map within the boundary points at these lengths.

    Boundary edges that are missing are halved; inner points too close to the boundary are left out. Raises NumericalError where
    the boundary is too narrow, or the mesh is no disk.
    """
    assert sheet.rim is not None
    for _ in range(_ROUNDS):
        surface, rim = sheet.rim.at(lengths)
        after = np.roll(rim, -1, axis=0)
        if len(inner):
            reach = _CLEAR * np.linalg.norm(after - rim, axis=1)
            near = cKDTree(inner).query_ball_point(0.5 * (rim + after), reach)
            inner = np.delete(inner, np.unique(np.concatenate([np.asarray(some, np.int64) for some in near])), axis=0)
        image = np.vstack([rim, inner])
        faces, missing = enclosed(planar_delaunay(image), len(rim))
        if not len(missing):
            break
        following = np.append(lengths[1:], lengths[0] + sheet.rim.ends[-1])
        lengths = np.sort(np.concatenate([lengths, 0.5 * (lengths + following)[missing]]))
    else:
        raise NumericalError("the boundary of the map is too narrow to be triangulated; ask for another target")
    lifted = sheet.locator.find(inner, sheet.vertices).points if len(inner) else np.empty((0, 3))
    return _finished(sheet, image, np.vstack([surface, lifted]), faces, len(rim))
