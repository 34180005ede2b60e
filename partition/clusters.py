"""Small clusters of faces and the graph between them: a graph partition of these costs a fraction of one of the faces."""

from __future__ import annotations

import numba
import numpy as np
from scipy.sparse import csr_array

from partition.dual_graph import FloatArray, IntArray


@numba.njit(cache=True, nogil=True)
def _grow(twins: IntArray, size: int) -> tuple[IntArray, IntArray, IntArray]:
    """Cluster of every face (F,), faces ordered by cluster (F,), and where each cluster begins in that order.

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
def _graph(
    twins: IntArray, lengths: FloatArray, cluster: IntArray, order: IntArray, starts: IntArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """CSR of the graph of clusters; the weight of an entry is the length of all edges that two clusters share."""
    count = starts.shape[0] - 1
    indptr = np.zeros(count + 1, np.int32)
    room = 0
    for h in range(twins.shape[0]):
        if twins[h] >= 0 and cluster[h // 3] != cluster[twins[h] // 3]:
            room += 1
    indices, weights = np.empty(room, np.int32), np.empty(room)
    slot = np.full(count, -1, np.int64)
    total = 0
    for c in range(count):
        first = total
        for p in range(starts[c], starts[c + 1]):
            for i in range(3):
                h = 3 * order[p] + i
                if twins[h] < 0 or cluster[twins[h] // 3] == c:
                    continue
                other = cluster[twins[h] // 3]
                if slot[other] < first:
                    slot[other] = total
                    indices[total], weights[total] = other, 0.0
                    total += 1
                weights[slot[other]] += lengths[h]
        indptr[c + 1] = total
    return indptr, indices[:total].copy(), weights[:total].copy()


def cluster_graph(twins: IntArray, lengths: FloatArray, size: int) -> tuple[IntArray, IntArray, csr_array]:
    """Clusters of up to ``size`` faces: cluster (F,) of each face, faces in each (C,), and their graph (C, C)."""
    cluster, order, starts = _grow(twins, size)
    indptr, indices, weights = _graph(twins, lengths, cluster, order, starts)
    count = len(starts) - 1
    return cluster, np.diff(starts), csr_array((weights, indices, indptr), shape=(count, count))
