"""Quads from a lattice in the map that is halved where the map makes the surface small; squares stay square on the surface.

A quadtree: each square has a side about as long as is wanted there, and neighbours differ by a factor of two at most. Squares
whose neighbours are as large as they, or larger, are quads; triangles are along the boundary and where the size changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from pgcp.errors import InputError
from pgcp.finish.resample import Resampled, Sheet, triangulated_of_sphere, triangulated_within
from pgcp.plane.mobius import rotation_to_north, to_plane, to_sphere
from pgcp.types import FloatArray, IntArray, Source

_APART = 0.55  # of the wanted side from the boundary
_FINE = 12  # points of the boundary for each edge, to measure distances from it
_LEAN = 1e-3  # a shear of the lattice, so that its squares have one diagonal in which circles are empty
_DEEPEST = 48  # levels: a cell's number has to fit into the digits of a double
_GRADED = 0.67  # sides of squares grow with the distance from the middle, the wanted ones with its square: until so far
_RINGS, _CLEAR = 6, 0.7  # of triangles beyond that, and how far from squares they begin
_SAMPLES = 16  # of the surface for each square
_CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
_AROUND = np.array([[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1)])


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Squares of a quadtree: nodes (n, 2) in the plane, and the nodes (q, 4) of each square, counter-clockwise."""

    nodes: FloatArray
    squares: IntArray


def quadtree(low: FloatArray, side: float, places: FloatArray, wanted: FloatArray) -> Lattice:
    """Halve a square until no place (n, 2) in it wants a side (n,) shorter than by the root of two, and it is balanced.

    low (2,): the corner of the square; all places lie in it. Neighbours differ by one halving at most.
    """
    split: list[IntArray] = []
    share = (places - low) / side
    share[:, 0] -= _LEAN * share[:, 1]
    while len(split) < _DEEPEST:
        level = len(split)
        share, wanted = (values[wanted * np.sqrt(2.0) < side / 2**level] for values in (share, wanted))
        if not len(share):
            break
        split.append(np.unique(np.clip((share * 2**level).astype(np.int64), 0, 2**level - 1), axis=0))
    split = split or [np.zeros((1, 2), np.int64)]
    for level in range(len(split) - 1, 0, -1):
        around = (split[level][:, None] + _AROUND).reshape(-1, 2)
        around = around[((around >= 0) & (around < 2**level)).all(axis=1)]
        split[level - 1] = np.unique(np.vstack([split[level - 1], around // 2]), axis=0)
    deepest, corners = len(split), []
    for level, cells in enumerate(split, 1):
        children = (2 * cells[:, None] + _CORNERS).reshape(-1, 2)
        if level < deepest:
            both = np.vstack([children, split[level]])
            first, times = np.unique(both, axis=0, return_index=True, return_counts=True)[1:]
            children = both[first[times == 1]]
        corners.append((children[:, None] + _CORNERS) * 2 ** (deepest - level))
    nodes, squares = np.unique(np.concatenate(corners).reshape(-1, 2), axis=0, return_inverse=True)
    flat = side * (nodes / 2.0**deepest)
    flat[:, 0] += _LEAN * flat[:, 1]
    return Lattice(low + flat, squares.reshape(-1, 4))


def quads_of_plane(sheet: Sheet, spacing: float, angle: float, seed: int = 0) -> tuple[Resampled, Source]:
    """Squares in the map with sides of about ``spacing`` on the surface, turned by ``angle`` (radians), triangles at the rim.

    Raises InputError where no square has room.
    """
    assert sheet.rim is not None
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    samples = sheet.samples(_SAMPLES * _count(sheet, spacing), seed)
    wanted = sheet.spacing_at(samples, spacing)
    turned = np.vstack([samples, sheet.rim.image]) @ turn.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    side = _multiple(float((high - low).max()) * (1.0 + 2.0 * _LEAN), float(np.median(wanted)))
    corner = 0.5 * (low + high) - 0.5 * side
    tree = quadtree(corner, side, samples @ turn.T, wanted)
    places = tree.nodes @ turn
    lengths = sheet.rim.spaced(spacing)
    fine = sheet.rim.at(np.linspace(0.0, sheet.rim.ends[-1], _FINE * len(lengths), endpoint=False))[1]
    inside = sheet.locator.find(places, sheet.vertices).inside
    kept = np.flatnonzero(inside)
    near = cKDTree(np.vstack([fine, sheet.rim.image])).query(places[kept])[0]
    kept = kept[near >= _APART * sheet.spacing_at(places[kept], spacing)]
    made = triangulated_within(sheet, lengths, places[kept])
    return made, _merged(made, Lattice(places[kept], _numbered(tree.squares, kept, len(places))))


def quads_of_sphere(sheet: Sheet, spacing: float, seed: int = 0) -> tuple[Resampled, Source]:
    """The same on the sphere: squares of the plane to which it is projected from where the map is largest."""
    samples = sheet.samples(_SAMPLES * _count(sheet, spacing), seed)
    wanted = sheet.spacing_at(samples, spacing)
    pole = int(np.argmax(wanted))
    turn = rotation_to_north(-samples[pole])
    apart = np.arange(len(samples)) != pole
    z = to_plane(samples[apart] @ turn.T)
    flat, flat_wanted = np.column_stack([z.real, z.imag]), wanted[apart] * 0.5 * (1.0 + np.abs(z) ** 2)
    side = 2.0 * _GRADED / float(wanted[pole])
    within = (np.abs(flat) < 0.5 * side).all(axis=1)
    tree = quadtree(np.full(2, -0.5 * side), side, flat[within], flat_wanted[within])
    places = to_sphere(tree.nodes[:, 0] + 1j * tree.nodes[:, 1]) @ turn
    made = triangulated_of_sphere(sheet, np.vstack([places, _around_pole(places, turn, float(wanted[pole]))]))
    return made, _merged(made, Lattice(places, tree.squares))


def _around_pole(nodes: FloatArray, turn: FloatArray, step: float) -> FloatArray:
    """Points (n, 3) of a hexagonal lattice around the pole that is turned to the south, where the squares' nodes have not come.

    step: how far they are apart, as an angle.
    """
    rings = min(_RINGS, int(0.5 * np.pi / step))
    ring = np.repeat(np.arange(rings + 1), [max(6 * k, 1) for k in range(rings + 1)])
    number = np.concatenate([np.arange(max(6 * k, 1)) for k in range(rings + 1)])
    angle, along = ring * step, 2.0 * np.pi * number / np.maximum(6 * ring, 1)
    points = np.column_stack([np.sin(angle) * np.cos(along), np.sin(angle) * np.sin(along), -np.cos(angle)]) @ turn
    covered = nodes @ turn.T
    reach = float(np.arccos(np.clip(-covered[:, 2].min(), -1.0, 1.0)))  # of the square's corners from the pole
    flat = to_plane(points[1:] @ turn.T)
    edge = np.abs(to_plane(covered))
    within = np.append(False, np.maximum(np.abs(flat.real), np.abs(flat.imag)) < edge.max() / np.sqrt(2.0))
    free = cKDTree(nodes).query(points)[0] > _CLEAR * step
    return np.asarray(points[~within & free & (angle <= np.sqrt(2.0) * reach + step)])


def _count(sheet: Sheet, spacing: float) -> int:
    """About how many squares there are."""
    return max(int(sheet.areas.sum() / spacing**2), 64)


def _multiple(extent: float, step: float) -> float:
    """The least power of two times ``step`` that is no less than the extent."""
    return float(step * 2.0 ** np.ceil(np.log2(max(extent / step, 1.0))))


def _numbered(squares: IntArray, kept: IntArray, count: int) -> IntArray:
    """Squares all of whose nodes are kept, in the numbers of these."""
    number = np.full(count, -1)
    number[kept] = np.arange(len(kept))
    found = number[squares]
    return found[(found >= 0).all(axis=1)]


def _keys(triangles: IntArray) -> IntArray:
    """One number for each triangle of less than 2^21 vertices, whatever its order."""
    a, b, c = np.sort(triangles.astype(np.int64), axis=1).T
    return np.asarray((a << 42) | (b << 21) | c)


def _merged(made: Resampled, lattice: Lattice) -> Source:
    """The mesh with quads for squares of the lattice that are two of its triangles, then all other triangles.

    Nodes are told by where they lie in the map.
    """
    if len(made.points) >= 1 << 21:
        raise InputError(f"the lattice has {len(made.points):,} nodes; less than {1 << 21:,} are made, so take longer edges")
    tree = cKDTree(made.image)
    distance, vertex = tree.query(lattice.nodes)
    there = distance == 0.0
    squares = np.where(there, vertex, -1)[lattice.squares]
    squares = squares[(squares >= 0).all(axis=1)]
    keys = _keys(made.faces)
    order = np.argsort(keys)
    rows = np.full(len(squares), -1), np.full(len(squares), -1)
    for pair in (((0, 1, 2), (0, 2, 3)), ((0, 1, 3), (1, 2, 3))):
        wanted = [_keys(squares[:, corners]) for corners in pair]
        places = [order[np.minimum(np.searchsorted(keys[order], key), len(keys) - 1)] for key in wanted]
        both = (keys[places[0]] == wanted[0]) & (keys[places[1]] == wanted[1])
        for row, place in zip(rows, places, strict=True):
            row[both] = place[both]
    quads = squares[rows[0] >= 0]
    if not len(quads):
        raise InputError("no square of the lattice has room in the map; take shorter edges or more vertices")
    others = np.delete(made.faces, np.concatenate([row[row >= 0] for row in rows]), axis=0)
    ends = np.cumsum(np.concatenate([np.full(len(quads), 4), np.full(len(others), 3)]))
    return Source(made.points, np.concatenate([quads.reshape(-1), others.reshape(-1)]), np.append(0, ends))
