"""Repair the folds of a finished map, tier by tier, each with more power and less regard for the rest than the one before.

    relax     the harmonic map of the surroundings of a fold, seams included (PGCP eq. 4.22)
    compose   composition with the quasi-conformal map that takes folds away (PGCP section 3.5, eq. 3.16)
    average   as relax, with positive weights, which cannot fold in a convex rim (Tutte 1963, Floater 2003)
    untangle  vertices around a fold are moved one by one to where the faces around them are best (Freitag, Plassmann 2000)
    embed     disk and sphere: a map that cannot fold, drawn back towards the folded one wherever that folds nothing

Before them, on the disk, faces with two edges on the boundary are lifted off the line that rounding leaves them on (``ears``).
The first three go over narrow surroundings of the folds first, then over wider ones, and after untangling over the whole mesh
with its outer boundary held. What a tier does is kept only where fewer folds are left.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pgcp.errors import SolveFailedError
from pgcp.folds.ears import lifted_ears
from pgcp.folds.embed import drawn_back, embed_disk, embed_sphere
from pgcp.folds.grid import grid_sphere
from pgcp.folds.grid_disk import grid_disk
from pgcp.folds.regions import Region, averaged, can_be_solved, composed, regions_around, relaxed, whole_regions
from pgcp.folds.untangle import untangle
from pgcp.plane.space import Space, find_folds
from pgcp.types import BoolArray, ComplexArray, IntArray, Mesh, Positions

_RINGS = (3, 12, 48)
_UNTANGLE_RINGS = 8
_EVERYTHING = -1
_SHORTEST = 1e-6
_SOLVERS: dict[str, Callable[[Mesh, Region, ComplexArray, float], ComplexArray]] = {
    "relax": relaxed,
    "compose": composed,
    "average": averaged,
}


@dataclass(frozen=True, slots=True)
class Repair:
    """What a tier did: folds before and after, vertices moved; within so many rings of the folds, -1 for the whole mesh."""

    method: str
    rings: int
    folds_before: int
    folds_after: int
    moved_vertices: int


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """What a repair needs to know of a map: its mesh, space, outer boundary (none on a sphere), and its mollification.

    has_free_boundary: whether single boundary vertices may be moved; such a map has no convex image to embed the mesh into.
    """

    mesh: Mesh
    space: Space
    boundary: IntArray
    mollification: float
    has_free_boundary: bool = False

    def fixed(self, method: str) -> BoolArray:
        """Which vertices (V,) a tier must not move: the boundary, but for single moves where it is free."""
        out = np.zeros(len(self.mesh.vertices), bool)
        out[self.boundary] = not (self.has_free_boundary and method == "untangle")
        return out

    def folds(self, points: Positions) -> IntArray:
        """Folded faces of the mesh, filler included."""
        return find_folds(self.space, self.mesh.faces, points)


def _improved(here: Surroundings, region: Region, points: Positions, method: str) -> Positions | None:
    """New positions of a region's vertices, or None where the method does not apply."""
    if method == "untangle":
        return untangle(here.space, here.mesh, region, points)
    chart = here.space.chart(points[region.vertex_ids])
    if not can_be_solved(region, chart):
        return None
    try:
        z = _SOLVERS[method](here.mesh, region, chart.z, here.mollification)
    except SolveFailedError:
        return None
    moved = chart.points(z)
    moved[region.held] = points[region.vertex_ids[region.held]]
    return moved if np.isfinite(z).all() else None


def _repaired_around(here: Surroundings, points: Positions, folded: IntArray, method: str, rings: int) -> Positions:
    """Apply a local tier to all faces within so many rings of the folds, each connected part by itself."""
    faces, fixed = here.mesh.faces, here.fixed(method)
    if rings == _EVERYTHING:
        regions = whole_regions(faces, fixed) if len(here.boundary) else []
    else:
        regions = regions_around(faces, folded, rings, fixed)
    out = points
    for region in regions:
        before = points[region.vertex_ids]
        moved = _improved(here, region, points, method)
        if moved is None:
            continue
        if len(find_folds(here.space, region.faces, moved)) < len(find_folds(here.space, region.faces, before)):
            out = points.copy() if out is points else out
            out[region.vertex_ids] = moved
    return out


def _steps(methods: tuple[str, ...]) -> list[tuple[str, int]]:
    """The tiers in the order they are applied, each with how far it reaches."""
    local = [method for method in methods if method in _SOLVERS]
    steps = [(method, rings) for rings in _RINGS for method in local]
    steps += [(method, _UNTANGLE_RINGS) for method in methods if method == "untangle"]
    steps += [(method, _EVERYTHING) for method in local]
    return steps + [(method, _EVERYTHING) for method in methods if method == "embed"]


def _safe(here: Surroundings, points: Positions, uniform: bool) -> Positions | None:
    """The map that cannot fold, near the given positions; None where it cannot be solved."""
    try:
        if here.space.closed:
            out: Positions = embed_sphere(here.mesh, points, here.mollification, uniform)
        else:
            out = embed_disk(here.mesh, points, here.boundary, here.mollification, uniform)
    except SolveFailedError:
        return None
    return out if np.isfinite(out).all() else None


def _embedded(here: Surroundings, points: Positions) -> Positions:
    """The map that cannot fold, drawn back towards the folded one.

    Rounding may fold it even so, where parts are so long and thin that they shrink to nothing: then with uniform weights.
    """
    for uniform in (False, True):
        safe = _safe(here, points, uniform)
        if safe is not None and len(here.folds(safe)) == 0:
            return drawn_back(here.space, here.mesh.faces, safe, points, here.fixed("embed"))
    safe = _on_grid(here)
    if safe is not None and len(here.folds(safe)) == 0:
        return drawn_back(here.space, here.mesh.faces, safe, points, here.fixed("embed"))
    return points


def _on_grid(here: Surroundings) -> Positions | None:
    """The embedding by a drawing on a grid, which rounding does not fold; None where there is none."""
    used, local = np.unique(here.mesh.faces, return_inverse=True)
    faces, out = local.reshape(-1, 3), here.space.origin(len(here.mesh.vertices))
    try:
        if here.space.closed:
            out[used] = grid_sphere(faces, len(used), 0)
        else:
            out[used] = grid_disk(faces, len(used), np.searchsorted(used, here.boundary))
    except SolveFailedError:
        return None
    return out


def embedding_alone(here: Surroundings) -> Positions:
    """A map without folds from nothing but the mesh, as near to conformal as positive weights make it.

    The sphere's starts from directions seen from the surface's middle, the disk's from its boundary laid around the circle by
    length.
    """
    mesh = here.mesh
    if here.space.closed:
        away = mesh.vertices - mesh.vertices[mesh.faces].mean(axis=(0, 1))
        size = np.linalg.norm(away, axis=1)
        start: Positions = np.where(size[:, None] > 0, away / np.where(size > 0, size, 1.0)[:, None], [0.0, 0.0, 1.0])
    else:
        loop = mesh.vertices[here.boundary]
        lengths = np.maximum(np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=1), here.mollification)
        lengths = np.maximum(lengths, _SHORTEST * lengths.sum())
        start = np.zeros(len(mesh.vertices), np.complex128)
        start[here.boundary] = np.exp(2j * np.pi * (np.cumsum(lengths) - lengths[0]) / lengths.sum())
    wanted = _safe(here, start, False)
    if wanted is not None and len(here.folds(wanted)) == 0:
        return wanted
    safe = _safe(here, start, True)
    if safe is None or len(here.folds(safe)) > 0:
        grid = _on_grid(here)
        safe = safe if grid is None else grid
    if safe is None:
        raise SolveFailedError("the embedding with uniform weights is not finite")
    if wanted is None or len(here.folds(safe)) > 0:
        return safe
    return drawn_back(here.space, mesh.faces, safe, wanted, here.fixed("embed"))


@dataclass(frozen=True, slots=True, eq=False)
class Repaired:
    """A map after its repair: positions, the faces (sorted) whose image changed, what each tier did, folds before and after."""

    points: Positions
    touched: IntArray
    records: list[Repair]
    folds_before: int
    folds: int


def repair_folds(here: Surroundings, points: Positions, methods: tuple[str, ...], folded: IntArray | None = None) -> Repaired:
    """Take folds away with the given tiers, until none is left.

    points: complex (V,) in the plane or unit vectors (V, 3); ``folded``: its folds, where they are known. No tier is called,
    and nothing recorded, where there is no fold; folds of filler do not count.
    """
    faces = here.mesh.bare.faces
    start = points
    folded = find_folds(here.space, faces, points) if folded is None else folded
    before = len(folded)
    records: list[Repair] = []
    if before and methods and len(here.boundary) and not here.has_free_boundary:
        lifted = lifted_ears(points, faces, folded, here.boundary)
        if lifted is not points:
            folded = find_folds(here.space, faces, lifted)
            records.append(Repair("lift", 0, before, len(folded), int((lifted != points).sum())))
            points = lifted
    for method, rings in _steps(methods):
        if len(folded) == 0:
            break
        if method == "embed" and here.has_free_boundary:
            continue
        tried = _embedded(here, points) if method == "embed" else _repaired_around(here, points, folded, method, rings)
        left = find_folds(here.space, faces, tried)
        if len(left) < len(folded):
            moved = int((tried != points).reshape(len(points), -1).any(axis=1).sum())
            records.append(Repair(method, rings, len(folded), len(left), moved))
            points, folded = tried, left
        else:
            records.append(Repair(method, rings, len(folded), len(folded), 0))
    touched = np.empty(0, np.int64)
    if points is not start:
        changed = (points != start).reshape(len(points), -1).any(axis=1)
        touched = np.flatnonzero(changed[faces].any(axis=1))
    return Repaired(points, touched, records, before, len(folded))
