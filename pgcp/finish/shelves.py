"""Boxes laid out beside each other on shelves, without overlap, in about a square (first-fit by decreasing height)."""

from __future__ import annotations

import numpy as np

from pgcp.types import FloatArray

_GAP = 0.02  # of the square's side, between boxes


def on_shelves(sizes: FloatArray) -> FloatArray:
    """Lower left corners (N, 2) of boxes with these widths and heights (N, 2).

    The highest come first; each goes to the lowest shelf that has room (Coffman, Garey, Johnson, Tarjan 1980). The width of
    the shelves is one for which all boxes fill about a square.
    """
    side = float(np.sqrt((sizes[:, 0] * sizes[:, 1]).sum()))
    gap = _GAP * max(side, 1e-300)
    best, least = np.zeros((len(sizes), 2)), np.inf
    for width in np.linspace(1.0, 1.6, 7) * side:
        places = _placed(sizes, max(width, float(sizes[:, 0].max())), gap)
        extent = float((places + sizes).max())
        if extent < least:
            best, least = places, extent
    return best


def _placed(sizes: FloatArray, width: float, gap: float) -> FloatArray:
    """Corners of boxes on shelves of this width."""
    places = np.zeros((len(sizes), 2))
    ends: list[float] = []  # where the boxes of each shelf end
    floors: list[float] = []
    top = 0.0
    for k in np.lexsort((-sizes[:, 0], -sizes[:, 1])).tolist():
        w, h = sizes[k].tolist()
        shelf = next((i for i, end in enumerate(ends) if end + w <= width * (1.0 + 1e-12)), len(ends))
        if shelf == len(ends):
            ends.append(0.0)
            floors.append(top)
            top += h + gap
        places[k] = ends[shelf], floors[shelf]
        ends[shelf] += w + gap
    return places
