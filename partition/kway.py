"""Labels from the dual graph: METIS k-way, or a recursive geodesic bisection where pymetis has no wheel."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from .dual_graph import IntArray

_WEIGHT_RANGE = 1000


def has_metis() -> bool:
    """Whether pymetis can be imported."""
    try:
        import pymetis  # noqa: F401
    except ImportError:
        return False
    return True


def metis_labels(dual: csr_array, sizes: IntArray, part_count: int, seed: int) -> IntArray:
    """Balanced parts with short cuts: edge weights are the lengths of the shared mesh edges, as small integers."""
    import pymetis

    middle = float(np.median(dual.data)) or float(dual.data.mean()) or 1.0  # of a mesh whose edges mostly have no length
    weights = np.clip(np.rint(dual.data / middle * 32), 1, _WEIGHT_RANGE).astype(np.int32)
    options = pymetis.Options(seed=seed, contig=0, niter=20)
    _, labels = pymetis.part_graph(
        part_count,
        pymetis.CSRAdjacency(dual.indptr, dual.indices),
        eweights=weights,
        vweights=sizes.astype(np.int32),
        recursive=False,
        options=options,
    )
    return np.asarray(labels, np.int64)


def _far_face(dual: csr_array, source: int) -> tuple[int, np.ndarray]:
    distance = dijkstra(dual, directed=False, indices=source)
    distance[~np.isfinite(distance)] = -1.0
    return int(np.argmax(distance)), distance


def bisection_labels(dual: csr_array, part_count: int, sizes: IntArray | None = None) -> IntArray:
    """Balanced parts by recursive bisection: faces sorted by the difference of distances to two far faces."""
    labels = np.zeros(dual.shape[0], np.int64)
    sizes = np.ones(dual.shape[0], np.int64) if sizes is None else sizes
    work = [(np.arange(dual.shape[0]), 0, part_count)]
    while work:
        members, first, count = work.pop()
        labels[members] = first
        if count == 1 or len(members) < 2:
            continue
        part = dual[members][:, members]
        one, _ = _far_face(part, 0)
        other, from_one = _far_face(part, one)
        _, from_other = _far_face(part, other)
        order = np.argsort(from_one - from_other, kind="stable")
        left = count // 2
        before = np.cumsum(sizes[members[order]])
        cut = int(np.searchsorted(before, before[-1] * left // count, side="right"))
        cut = min(max(cut, 1), len(members) - 1)
        work.append((members[np.sort(order[:cut])], first, left))
        work.append((members[np.sort(order[cut:])], first + left, count - left))
    return labels


def kway_labels(dual: csr_array, part_count: int, seed: int, sizes: IntArray | None = None) -> IntArray:
    """One label per node of a graph (N,), parts of about equal size, deterministic for a seed. Parts need not be disks yet.

    sizes (N,): how many faces each node stands for, 1 by default.
    """
    if part_count == 1:
        return np.zeros(dual.shape[0], np.int64)
    if has_metis():
        return metis_labels(dual, np.ones(dual.shape[0], np.int64) if sizes is None else sizes, part_count, seed)
    return bisection_labels(dual, part_count, sizes)
