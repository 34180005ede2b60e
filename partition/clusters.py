"""Small clusters of faces and the graph between them: a graph partition of these costs a fraction of one of the faces."""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import numba
import numpy as np
from scipy.sparse import csr_array

from .dual_graph import AtOnce, FloatArray, IntArray, in_turn

_PARTS = 8


@numba.njit(cache=True, nogil=True)
def grow_clusters(twins: IntArray, size: int) -> tuple[IntArray, IntArray, IntArray]:
    """Clusters of up to ``size`` faces: of every face (F,), faces ordered by it (F,), and where each begins in that order.

    Each cluster grows breadth first from a face beside an earlier one, so that clusters pack closely.
    """
    n = twins.shape[0] // 3
    cluster = np.full(n, -1, np.int32)
    order = np.empty(n, np.int32)
    rim = np.empty(3 * n, np.int32)
    starts = np.empty(n + 1, np.int32)
    taken, filled, done, count, lowest = 0, 0, 0, 0, 0
    starts[0] = 0
    while done < n:
        seed = -1
        while taken < filled and seed < 0:
            if cluster[rim[taken]] < 0:
                seed = rim[taken]
            taken += 1
        if seed < 0:
            while cluster[lowest] >= 0:
                lowest += 1
            seed = lowest
        begin, head = done, done
        cluster[seed], order[done] = count, seed
        done += 1
        while head < done and done - begin < size:
            f = order[head]
            head += 1
            for i in range(3):
                twin = twins[3 * f + i]
                if twin >= 0 and cluster[twin // 3] < 0 and done - begin < size:
                    cluster[twin // 3], order[done] = count, twin // 3
                    done += 1
        for p in range(begin, done):
            for i in range(3):
                twin = twins[3 * order[p] + i]
                if twin >= 0 and cluster[twin // 3] < 0:
                    rim[filled] = twin // 3
                    filled += 1
        count += 1
        starts[count] = done
    return cluster, order, starts[: count + 1].copy()


@numba.njit(cache=True, nogil=True)
def _rows(
    twins: IntArray, lengths: FloatArray, cluster: IntArray, order: IntArray, starts: IntArray, first: int, stop: int
) -> tuple[IntArray, IntArray, FloatArray]:
    """Rows first to stop of the graph of clusters: entries in each, columns, and the length of all edges two clusters share."""
    counts = np.zeros(stop - first, np.int32)
    room = 3 * (starts[stop] - starts[first])
    indices, weights = np.empty(room, np.int32), np.empty(room)
    slot = np.full(starts.shape[0] - 1, -1, np.int64)
    total = 0
    for c in range(first, stop):
        begin = total
        for p in range(starts[c], starts[c + 1]):
            for i in range(3):
                h = 3 * order[p] + i
                if twins[h] < 0 or cluster[twins[h] // 3] == c:
                    continue
                other = cluster[twins[h] // 3]
                if slot[other] < begin:
                    slot[other] = total
                    indices[total], weights[total] = other, 0.0
                    total += 1
                weights[slot[other]] += lengths[h]
        counts[c - first] = total - begin
    return counts, indices[:total].copy(), weights[:total].copy()


def cluster_graph(
    twins: IntArray,
    lengths: FloatArray,
    cluster: IntArray,
    order: IntArray,
    starts: IntArray,
    at_once: AtOnce = in_turn,
) -> csr_array:
    """The graph (C, C) of clusters, as from ``grow_clusters``; the weight of an entry is the length they share."""
    count = len(starts) - 1
    ends = np.linspace(0, count, _PARTS + 1).astype(np.int64).tolist()
    parts = at_once(*(partial(_rows, twins, lengths, cluster, order, starts, *part) for part in pairwise(ends)))
    counts, indices, weights = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    indptr = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    return csr_array((weights, indices, indptr), shape=(count, count))
