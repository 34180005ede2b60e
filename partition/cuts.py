"""Labels from the user's cut edges (PGCP section 4.1): components of the dual graph without the cut edges."""

from __future__ import annotations

import numpy as np

from .dual_graph import IntArray, label_components
from .errors import PartitionError


def cut_labels(faces: IntArray, twins: IntArray, cut_edges: IntArray) -> IntArray:
    """One label per face (F,) from cut edges (N, 2), pairs of vertex ids in either direction.

    Raises PartitionError where a pair is not an edge of the mesh.
    """
    size = int(faces.max()) + 1
    cut_edges = np.asarray(cut_edges, np.int64)
    if cut_edges.ndim != 2 or cut_edges.shape[1] != 2:
        raise PartitionError(f"cut edges have shape {cut_edges.shape}, expected (N, 2)")
    tails = faces.reshape(-1).astype(np.int64)
    heads = faces[:, [1, 2, 0]].reshape(-1).astype(np.int64)
    keys = np.minimum(tails, heads) * size + np.maximum(tails, heads)
    low, high = cut_edges.min(axis=1), cut_edges.max(axis=1)
    in_range = (low >= 0) & (high < size)
    cut_keys = np.unique(low * size + high)
    missing = ~in_range | ~np.isin(low * size + high, keys)
    if missing.any():
        row = int(np.flatnonzero(missing)[0])
        a, b = cut_edges[row]
        raise PartitionError(f"cut {row + 1} ({a} {b}) is not an edge of the mesh; {int(missing.sum())} such cuts in all")
    closed = twins.copy()
    closed[np.isin(keys, cut_keys)] = -1
    _, labels = label_components(closed, np.zeros(len(faces), np.int32))
    return labels
