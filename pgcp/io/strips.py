"""Strips of triangles, as triangles."""

from __future__ import annotations

import numpy as np

from pgcp.types import IntArray


def triangles_of_strips(corners: IntArray, sizes: IntArray) -> IntArray:
    """Triangles (F, 3) of strips one after the other; sizes (N,): corners of each, where a negative one begins it anew.

    Every second triangle of a strip is turned over. Triangles that use a vertex twice, which only lead on, are left out.
    """
    place = np.arange(len(corners))
    starts = np.zeros(len(corners) + 1, bool)
    starts[np.cumsum(sizes) - sizes] = True
    starts[np.flatnonzero(corners < 0) + 1] = True
    begin = np.maximum.accumulate(np.where(starts[:-1], place, 0))
    first = place[: max(len(corners) - 2, 0)]
    rows = corners[first[:, None] + np.arange(3)]
    good = (begin[first] == begin[first + 2]) & (rows >= 0).all(axis=1) & (rows != np.roll(rows, 1, axis=1)).all(axis=1)
    first, rows = first[good], rows[good]
    return np.where(((first - begin[first]) % 2 == 1)[:, None], rows[:, [1, 0, 2]], rows)
