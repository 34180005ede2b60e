"""Split a triangle mesh into patches that are topological disks: arrays in, labels out."""

from __future__ import annotations

import numpy as np

from partition.check import Contacts, PartReport, SeamTable, check_partition, seam_table
from partition.cuts import cut_labels
from partition.disks import make_disks
from partition.dual_graph import FloatArray, IntArray, dual_graph, edge_lengths, vertex_starts
from partition.errors import PartitionError
from partition.kway import has_metis, kway_labels
from partition.smooth import shorten_seams

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
    "seam_table",
]

_BALANCE = 1.15


def partition_faces(vertices: FloatArray, faces: IntArray, twins: IntArray, part_count: int, seed: int = 0) -> IntArray:
    """Split a connected, oriented, manifold mesh into ``part_count`` disks of about equal size with short seams.

    vertices (V, 3), faces (F, 3), twins (3F,) the half-edge pairing. Returns labels (F,). The same input and seed
    give the same labels. Raises PartitionError where the mesh cannot carry that many disks.
    """
    if part_count < 1:
        raise PartitionError(f"the number of patches is {part_count}, it must be at least 1")
    if part_count > len(faces):
        raise PartitionError(f"{part_count} patches were asked for, but the mesh has only {len(faces)} faces")
    lengths = edge_lengths(vertices, faces)
    labels = kway_labels(dual_graph(twins, lengths), part_count, seed)
    labels = make_disks(vertices, faces, twins, labels, part_count)
    sizes = np.bincount(labels)
    limit = max(int(_BALANCE * len(faces) / part_count), int(sizes.max()))
    shorten_seams(faces, twins, lengths, vertex_starts(faces, twins, len(vertices)), labels, part_count, limit, 100)
    return labels
