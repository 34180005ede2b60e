"""Polygons cut into triangles: convex quads by the shorter diagonal, others ear by ear in the plane that fits them best."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pgcp.errors import BadFileError
from pgcp.polygons.ears import clip_ears
from pgcp.types import BoolArray, FloatArray, IntArray, Mesh, Source

_WARPED = 0.1  # of a polygon's size: so far do its corners leave a plane
_FLAT = 1e-12  # of the square of a polygon's size: less area than that is none


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """A surface of polygons as triangles.

    corner_of (F, 3): the corner of the source that each corner of a triangle is, None where the source has triangles only;
    triangles of one polygon follow each other and run around it as it does. notes: what is said of polygons.
    """

    mesh: Mesh
    corner_of: IntArray | None = None
    notes: tuple[dict[str, Any], ...] = ()


def triangulated(source: Source) -> Triangles:
    """Cut the polygons of a surface into triangles; vertices stay as they are.

    A quad whose corners are all convex is cut by its shorter diagonal (the first in a tie), unless another edge of the surface
    has its ends. Every other polygon is projected into its best plane (that of Newell's normal) and clipped there, the ear
    with the shortest diagonal first. Raises BadFileError, with its number, for a polygon of fewer than three corners, one that
    has a vertex twice, one that uses a vertex the file has not, and one that crosses itself.
    """
    if source.offsets is None:
        return Triangles(Mesh(source.vertices, source.corners.reshape(-1, 3), source.name))
    offsets, corners, sizes = source.offsets, source.corners.astype(np.int64), source.sizes
    _check(corners, offsets, sizes, source)
    points = source.vertices[corners]
    cut = np.empty((int((sizes - 2).sum()), 3), np.int64)
    first = np.cumsum(sizes - 2) - (sizes - 2)  # triangle with which each polygon begins
    flat = warped = 0
    for size in np.unique(sizes).tolist():
        those = np.flatnonzero(sizes == size)
        rows = offsets[those][:, None] + np.arange(size)
        if size == 3:
            cut[first[those]] = rows
            continue
        local, plane = _cut(points[rows], those, source)
        flat, warped = flat + int(plane.flat.sum()), warped + int(plane.warped.sum())
        if size == 4:
            local = _without_double_edges(local, plane.may_turn, corners[rows], corners, offsets)
        cut[first[those][:, None] + np.arange(size - 2)] = rows[np.arange(len(rows))[:, None, None], local]
    mesh = Mesh(source.vertices, corners[cut], source.name)
    return Triangles(mesh, cut, _notes(sizes, flat, warped))


def _notes(sizes: IntArray, flat: int, warped: int) -> tuple[dict[str, Any], ...]:
    """What is said of polygons."""
    cut = int((sizes != 3).sum())
    quads = int((sizes == 4).sum())
    kinds = f"{_counted(quads, 'quad')}" if quads == cut else f"{_counted(cut, 'polygon')}, {quads} of them quads,"
    notes = [{"step": "triangulate", "count": cut, "message": f"{kinds} cut into triangles for the map"}] if cut else []
    if warped:
        said = f"{_counted(warped, 'polygon')} out of a plane by more than a tenth of the size"
        notes.append({"step": "warped", "count": warped, "message": said})
    if flat:
        notes.append({"step": "degenerate", "count": flat, "message": f"{_counted(flat, 'polygon')} without area"})
    return tuple(notes)


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _check(corners: IntArray, offsets: IntArray, sizes: IntArray, source: Source) -> None:
    """Raise BadFileError for the first polygon that is none."""
    if len(sizes) and sizes.min() < 3:
        bad = int(np.argmax(sizes < 3))
        raise BadFileError(f"{source.name}: face {bad} has {_counted(int(sizes[bad]), 'corner')}, which make no polygon")
    outside = (corners < 0) | (corners >= len(source.vertices))
    if outside.any():
        at = int(np.argmax(outside))
        bad = int(np.searchsorted(offsets, at, "right")) - 1
        raise BadFileError(
            f"{source.name}: face {bad} uses vertex {int(corners[at])}, "
            f"but the mesh has vertices 0 to {len(source.vertices) - 1}"
        )
    owner = np.repeat(np.arange(len(sizes)), sizes)
    order = np.lexsort((corners, owner))
    again = (corners[order[1:]] == corners[order[:-1]]) & (owner[order[1:]] == owner[order[:-1]])
    again &= sizes[owner[order[1:]]] > 3  # triangles are looked at with the topology
    if again.any():
        at = int(order[1:][again].min())
        raise BadFileError(f"{source.name}: face {int(owner[at])} has vertex {int(corners[at])} at two of its corners")


@dataclass(frozen=True, slots=True, eq=False)
class _Planes:
    """What polygons (K,) of one size are: without area, out of a plane, and whether the other diagonal of a quad would do."""

    flat: BoolArray
    warped: BoolArray
    may_turn: BoolArray


def _cut(points: FloatArray, numbers: IntArray, source: Source) -> tuple[IntArray, _Planes]:
    """Triangles (K, n - 2, 3) of polygons (K, n, 3), by numbers of their corners, and what the polygons are."""
    count, size = points.shape[:2]
    with np.errstate(over="ignore", invalid="ignore"):
        local = points - points.mean(axis=1, keepdims=True)
        span = np.abs(local).max(axis=(1, 2))
    local = local / np.where(span > 0.0, span, 1.0)[:, None, None]
    normals = np.cross(local, np.roll(local, -1, axis=1)).sum(axis=1)
    length = np.linalg.norm(normals, axis=1)
    flat = ~(length > _FLAT)
    normals = np.where(flat[:, None], [0.0, 0.0, 1.0], normals / np.where(flat, 1.0, length)[:, None])
    heights = np.einsum("kni,ki->kn", local, normals)
    warped = ~flat & (np.ptp(heights, axis=1) > 2.0 * _WARPED)
    if size == 4:
        triangles, may_turn, good = _cut_quads(local, normals)
    else:
        triangles, may_turn, good = np.empty((count, size - 2, 3), np.int64), np.zeros(count, bool), np.zeros(count, bool)
    rest = np.flatnonzero(~good)
    for start in range(0, len(rest), 4096):
        some = rest[start : start + 4096]
        ears, done = clip_ears(_projected(local[some], normals[some]))
        crossed = some[~done & ~flat[some]]
        if len(crossed):
            raise BadFileError(f"{source.name}: face {int(numbers[crossed[0]])} crosses itself in its plane")
        triangles[some] = ears
    return triangles, _Planes(flat, warped, may_turn)


def _projected(local: FloatArray, normals: FloatArray) -> FloatArray:
    """Places (K, n, 2) of points (K, n, 3) in planes with these normals, counter-clockwise seen from them."""
    axis = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    along = np.cross(axis, normals)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(normals, along)
    return np.stack([np.einsum("kni,ki->kn", local, along), np.einsum("kni,ki->kn", local, across)], axis=2)


_BY_FIRST, _BY_SECOND = np.array([[0, 1, 2], [0, 2, 3]]), np.array([[0, 1, 3], [1, 2, 3]])


def _cut_quads(points: FloatArray, normals: FloatArray) -> tuple[IntArray, BoolArray, BoolArray]:
    """Triangles (K, 2, 3) of quads (K, 4, 3); which of them could be cut by the other diagonal, and which are cut at all."""

    def upright(which: IntArray) -> BoolArray:
        """Whether both triangles face as the quad does."""
        a, b, c = (points[:, which[:, i]] for i in range(3))
        areas: FloatArray = np.einsum("kni,ki->kn", np.cross(b - a, c - a), normals)
        return np.asarray((areas > _FLAT).all(axis=1))

    first, second = upright(_BY_FIRST), upright(_BY_SECOND)
    lengths = [((points[:, i] - points[:, j]) ** 2).sum(axis=1) for i, j in ((0, 2), (1, 3))]
    by_first = np.where(first & second, lengths[0] <= lengths[1] * (1.0 + 1e-9), first)
    return np.where(by_first[:, None, None], _BY_FIRST, _BY_SECOND), first & second, first | second


def _without_double_edges(
    local: IntArray, may_turn: BoolArray, quads: IntArray, corners: IntArray, offsets: IntArray
) -> IntArray:
    """Triangles (K, 2, 3) of quads (K, 4), by the other diagonal where an edge, or that of another polygon, is the same."""
    count = int(corners.max()) + 1
    after = np.arange(1, len(corners) + 1)
    after[offsets[1:] - 1] = offsets[:-1]

    def keys(one: IntArray, two: IntArray) -> IntArray:
        """One number for an edge."""
        return np.asarray(np.minimum(one, two) * count + np.maximum(one, two))

    by_first = local[:, 0, 2] == 2
    diagonals = [keys(quads[:, 0], quads[:, 2]), keys(quads[:, 1], quads[:, 3])]
    chosen = np.where(by_first, *diagonals)
    edges = np.sort(keys(corners, corners[after]))  # sorting is many times as fast as np.unique and np.isin are
    double = _is_among(chosen, edges)
    order = np.argsort(chosen)
    same = chosen[order[1:]] == chosen[order[:-1]]
    double[order[1:][same]] = double[order[:-1][same]] = True
    if not (double & may_turn).any():
        return local
    other = np.where(by_first, diagonals[1], diagonals[0])
    turned = double & may_turn & ~_is_among(other, edges) & ~_is_among(other, np.sort(chosen))
    return np.where((by_first ^ turned)[:, None, None], _BY_FIRST, _BY_SECOND)


def _is_among(values: IntArray, ordered: IntArray) -> BoolArray:
    """Which values (n,) are among ordered ones."""
    place = np.minimum(np.searchsorted(ordered, values), len(ordered) - 1)
    return np.asarray(ordered[place] == values)
