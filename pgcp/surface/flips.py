"""Edges of a triangle mesh in space flipped where that makes the angles opposite to them less obtuse."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pgcp.surface.distortion import corner_angles
from pgcp.types import BoolArray, FloatArray, IntArray

_SLACK = 1e-3  # of the sum of two cotangents
_ROUNDS = 30


def _pairs(faces: IntArray) -> IntArray:
    """Pairs (n, 2) of half-edges that are one edge; a half-edge is three times its face, and which corner it starts from."""
    tails, heads = faces.reshape(-1).astype(np.int64), faces[:, [1, 2, 0]].reshape(-1).astype(np.int64)
    forward = np.flatnonzero(tails < heads)
    backward = np.flatnonzero(tails > heads)
    keys = heads[backward] << 32 | tails[backward]
    order = np.argsort(keys)
    wanted = tails[forward] << 32 | heads[forward]
    place = np.minimum(np.searchsorted(keys[order], wanted), len(keys) - 1)
    found = keys[order[place]] == wanted
    return np.column_stack([forward[found], backward[order[place[found]]]])


def flipped(points: FloatArray, faces: IntArray, allowed: Callable[[IntArray], BoolArray]) -> IntArray:
    """The same surface with edges flipped until opposite angles add up to no more than a half turn, where that is allowed.

    points (N, 3) in space; allowed(faces (n, 3)): which faces there may be. No edge is made that there is already. As many
    edges at once as have no face in common, the worst first.
    """
    faces = faces.astype(np.int64)
    for _ in range(_ROUNDS):
        pairs = _pairs(faces)
        cotangents = 1.0 / np.tan(np.maximum(corner_angles(points, faces.astype(np.int32)), 1e-12))
        opposite = cotangents[:, [2, 0, 1]].reshape(-1)  # of the half-edge from a corner on
        gain = -(opposite[pairs[:, 0]] + opposite[pairs[:, 1]])
        better = gain > _SLACK
        pairs, gain = pairs[better], gain[better]
        if not len(pairs):
            break
        flat = faces.reshape(-1)
        (a, b), (left, right) = (flat[pairs].T, (flat[half - half % 3 + (half + 2) % 3] for half in pairs.T))
        one, two = np.column_stack([left, a, right]), np.column_stack([right, b, left])
        tails, heads = flat, faces[:, [1, 2, 0]].reshape(-1)
        known = np.minimum(tails, heads) << 32 | np.maximum(tails, heads)
        good = (left != right) & ~np.isin(np.minimum(left, right) << 32 | np.maximum(left, right), known)
        good[good] = allowed(one[good]) & allowed(two[good])
        rows = np.flatnonzero(good)
        rows = rows[np.argsort(-gain[rows], kind="stable")]
        first = np.full(len(faces), len(rows))
        touched = pairs[rows] // 3
        for column in touched.T:
            np.minimum.at(first, column, np.arange(len(rows)))
        alone = (first[touched] == np.arange(len(rows))[:, None]).all(axis=1)
        rows, touched = rows[alone], touched[alone]
        if not len(rows):
            break
        new_edges = np.minimum(left[rows], right[rows]) << 32 | np.maximum(left[rows], right[rows])
        once = np.unique(new_edges, return_index=True)[1]
        rows, touched = rows[once], touched[once]
        faces[touched[:, 0]], faces[touched[:, 1]] = one[rows], two[rows]
    return faces
