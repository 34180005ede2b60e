"""Triangles without vertex numbers."""

from __future__ import annotations

import numpy as np

from pgcp.types import FloatArray, IntArray


def weld_duplicates(corners: FloatArray) -> tuple[FloatArray, IntArray]:
    """Faces from triangle soup (3F, 3): exactly equal positions are one vertex, in order of first use."""
    _, first, inverse = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int64)
    order = np.argsort(first)
    rank[order] = np.arange(len(first))
    return corners[first[order]], rank[inverse.reshape(-1)].reshape(-1, 3)
