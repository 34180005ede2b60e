"""Split a triangle mesh into patches that are topological disks: arrays in, labels out."""

from __future__ import annotations

from functools import partial

import numpy as np

from .check import Contacts, PartReport, SeamTable, check_partition, seam_table
from .clusters import cluster_graph, grow_clusters
from .cuts import cut_labels
from .disks import make_disks
from .dual_graph import AtOnce, FloatArray, IntArray, edge_lengths, in_turn, seam_half_edges, vertex_starts
from .errors import PartitionError
from .kway import has_metis, kway_labels
from .smooth import shorten_seams
from .straighten import straighten_seams

__all__ = [
    "Contacts",
    "PartReport",
    "PartitionError",
    "SeamTable",
    "check_partition",
    "cut_labels",
    "has_metis",
    "make_disks",
    "partition_faces",
    "seam_half_edges",
    "seam_table",
]

_BALANCE = 1.15
_LARGEST_CLUSTER = 48
_CLUSTERS_PER_PART = 1000
_ROUNDS = 100
# seams are straightened within a band of so many rings, a part of the patches' width
_BAND, _NARROWEST, _WIDEST = 0.05, 2, 24
_STRAIGHTENINGS = 2


def partition_faces(
    vertices: FloatArray, faces: IntArray, twins: IntArray, part_count: int, seed: int = 0, at_once: AtOnce = in_turn
) -> IntArray:
    """Split a connected, oriented, manifold mesh into ``part_count`` disks of about equal size with short seams.

    vertices (V, 3), faces (F, 3), twins (3F,) the half-edge pairing. Returns labels (F,). The same input and seed
    give the same labels, whether ``at_once`` calls functions at the same time or in turn. Raises PartitionError where the
    mesh cannot carry that many disks.
    """
    if part_count < 1:
        raise PartitionError(f"the number of patches is {part_count}, it must be at least 1")
    if part_count > len(faces):
        raise PartitionError(f"{part_count} patches were asked for, but the mesh has only {len(faces)} faces")
    if part_count == 1:
        return np.zeros(len(faces), np.int32)
    size = int(np.clip(len(faces) // (_CLUSTERS_PER_PART * part_count), 1, _LARGEST_CLUSTER))
    (cluster, order, begins), lengths, starts = at_once(
        partial(grow_clusters, twins, size),
        partial(edge_lengths, vertices, faces),
        partial(vertex_starts, faces, twins, len(vertices)),
    )
    graph = cluster_graph(twins, lengths, cluster, order, begins, at_once)
    labels: IntArray = kway_labels(graph, part_count, seed, np.diff(begins)).astype(np.int32)[cluster]
    labels = make_disks(vertices, faces, twins, labels, part_count, lengths, starts, at_once)
    limit = max(int(_BALANCE * len(faces) / part_count), int(np.bincount(labels).max()))
    rings = int(np.clip(_BAND * np.sqrt(len(faces) / part_count), _NARROWEST, _WIDEST))
    for _ in range(_STRAIGHTENINGS):
        shorten_seams(faces, twins, lengths, starts, labels, part_count, limit, _ROUNDS)
        if straighten_seams(faces, twins, lengths, starts, labels, part_count, rings, at_once) == 0:
            break
    return labels
