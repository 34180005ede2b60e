"""Faces that have two edges on the boundary of the disk, where rounding leaves their three corners on one line."""

from __future__ import annotations

import numpy as np

from pgcp.surface.beltrami import folded_faces
from pgcp.types import ComplexArray, IntArray

_MOST_UNITS = 16


def ears_among(faces: IntArray, chosen: IntArray, boundary: IntArray) -> tuple[IntArray, IntArray]:
    """Those of the chosen faces (indices) that have a corner in no other face, all on the boundary; and these corners."""
    used = np.bincount(faces.reshape(-1))
    outside = np.isin(faces[chosen], boundary).all(axis=1)
    lone = used[faces[chosen]] == 1
    ears = outside & (lone.sum(axis=1) == 1)
    return chosen[ears], faces[chosen[ears]][lone[ears]]


def lifted_ears(z: ComplexArray, faces: IntArray, folded: IntArray, boundary: IntArray) -> ComplexArray:
    """Positions (V,) in which folded ears have an area: their tips are a few units in the last place outside the circle.

    On the circle itself, three points closer than 1e-8 lie on one line in double precision. No other face has the tip.
    """
    out = z
    for face, tip in zip(*ears_among(faces, folded, boundary), strict=True):
        for units in range(1, _MOST_UNITS + 1):
            tried = out.copy() if out is z else out
            tried[tip] = z[tip] * (1.0 + units * np.finfo(np.float64).eps)
            if len(folded_faces(faces[[face]], tried)) == 0:
                out = tried
                break
            if tried is out:
                tried[tip] = z[tip]
    return out
