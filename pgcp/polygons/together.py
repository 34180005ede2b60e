"""Triangles of a finished map put together again to the polygons they were cut from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgcp.types import BoolArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Polygons:
    """Polygons made of triangles (F, 3).

    offsets (P + 1,): where the corners of each begin; corner_at (C,): the corner of the triangles, ``3 f + i``, that each
    corner is; polygon_of (P,): the polygon of the source it is, or is a part of.
    """

    offsets: IntArray
    corner_at: IntArray
    polygon_of: IntArray


def polygons_of(faces: IntArray, corner_of: IntArray, offsets: IntArray) -> Polygons:
    """The polygons of a map's triangles, in their order.

    faces (F, 3): the map's triangles; corner_of (F, 3): corners of the source they have; offsets (P + 1,) of the source. Where
    triangles of a polygon are missing, no longer joined, or turned unlike, each stands for itself.
    """
    polygon = np.searchsorted(offsets, corner_of[:, 0], "right") - 1
    first = np.flatnonzero(np.append(True, polygon[1:] != polygon[:-1]))
    group = np.repeat(np.arange(len(first)), np.diff(np.append(first, len(polygon))))
    size = np.diff(offsets)[polygon[first]]
    at = np.full(int(offsets[-1]), -1)
    at[corner_of.reshape(-1)] = np.arange(corner_of.size)
    flat = faces.reshape(-1)
    turned = _are_odd(corner_of)
    like = (flat[at[corner_of]] == faces).all(axis=1) & (turned == turned[first][group])
    whole = np.logical_and.reduceat(like, first) & (np.bincount(group) == size - 2)
    # what is not whole comes as triangles, each a polygon
    alone = ~whole[group]
    kept = np.flatnonzero(alone | np.append(True, polygon[1:] != polygon[:-1]))
    sizes = np.where(alone[kept], 3, size[group[kept]])
    out = np.append(0, np.cumsum(sizes))
    step = np.arange(out[-1]) - np.repeat(out[:-1], sizes)
    owner = np.repeat(kept, sizes)
    around = np.where(turned[owner], -step % np.repeat(sizes, sizes), step)
    corner = np.where(alone[owner], 3 * owner + step, at[np.where(alone[owner], 0, offsets[polygon[owner]] + around)])
    return Polygons(out, corner, polygon[kept])


def _are_odd(corners: IntArray) -> BoolArray:
    """Whether corners (F, 3) are an odd permutation of their order."""
    a, b, c = corners.T
    return (a > b) ^ (b > c) ^ (a > c)
