"""Split a mesh into patches and plan how they are welded back (PGCP section 4.1). The only import of ``partition``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numba
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from pgcp.errors import PartitionInputError
from pgcp.parallel import at_once
from pgcp.partition import (
    PartitionError,
    SeamTable,
    check_partition,
    cut_labels,
    make_disks,
    partition_faces,
    seam_half_edges,
    seam_table,
)
from pgcp.patches.types import EdgeTable, Patch
from pgcp.surface.topology import Topology, loops_of
from pgcp.types import BoolArray, IntArray, Mesh

_BOUNDARY_POINTS = 8000
_MOST_PARTS = 8
_NEAR_ENDS = np.array([16, 12, 8, 6, 4, 4, 3, 3, 2, 2, 2, 2, 2, 2, 2, 2])


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """A valid partition: labels (F,), the number of patches, all seam and boundary edges, and which patches share them."""

    labels: IntArray
    patch_count: int
    edges: EdgeTable
    table: SeamTable


def _subdivision(tails: IntArray, heads: IntArray, vertex_count: int) -> IntArray:
    """Into how many parts each edge is cut for welding: few where there are many edges, more near the ends of seams.

    A weld is least smooth where a seam ends, at the boundary or at another seam: graded edges resolve it.
    """
    base = int(np.clip(_BOUNDARY_POINTS // len(tails), 1, _MOST_PARTS))
    ids, dense = np.unique(np.concatenate([tails, heads]), return_inverse=True)
    t, h = dense[: len(tails)], dense[len(tails) :]
    ends = np.flatnonzero(np.bincount(dense) > 2)
    parts = np.full(len(tails), base)
    if len(ends):
        graph = coo_array((np.ones(len(t)), (t, h)), shape=(len(ids), len(ids))).tocsr()
        distance = dijkstra(graph, directed=False, unweighted=True, indices=ends, min_only=True, limit=len(_NEAR_ENDS))
        near = np.minimum(distance[t], distance[h])
        close = near < len(_NEAR_ENDS)
        parts[close] = np.maximum(base, _NEAR_ENDS[near[close].astype(int)])
    return parts


def _edge_table(mesh: Mesh, twins: IntArray, labels: IntArray, mollification: float) -> EdgeTable:
    kept = np.concatenate([np.flatnonzero(twins < 0), seam_half_edges(twins, labels)])
    flat = mesh.faces.reshape(-1)
    tail = flat[kept].astype(np.int64)
    head = flat[kept - kept % 3 + (kept % 3 + 1) % 3].astype(np.int64)
    count = len(mesh.vertices)
    keys = np.sort(np.minimum(tail, head) * count + np.maximum(tail, head))
    return EdgeTable(keys, _subdivision(keys // count, keys % count, count), count, mollification)


def outer_edges(mesh: Mesh, topology: Topology, mollification: float = 0.0) -> EdgeTable:
    """Edges of the surface's own boundary alone, subdivided the same whatever the cuts."""
    return _edge_table(mesh, topology.twins, np.zeros(len(mesh.faces), np.int64), mollification)


def split_mesh(
    mesh: Mesh,
    topology: Topology,
    patch_count: int,
    seed: int = 0,
    cut_edges: IntArray | None = None,
    repair: bool = False,
    mollification: float = 0.0,
) -> Split:
    """Split a mesh into disks, by graph partition or along the user's cut edges (N, 2).

    Raises PartitionInputError where the mesh cannot carry that many patches, or where cut edges leave parts that are not
    disks and ``repair`` is not set. A closed mesh needs two patches at least.
    """
    closed = not topology.loops
    if closed and patch_count < 2 and cut_edges is None:
        raise PartitionInputError("a closed surface needs at least 2 patches")
    try:
        if cut_edges is not None:
            labels = cut_labels(mesh.faces, topology.twins, cut_edges)
            patch_count = int(labels.max()) + 1
            problems = check_partition(mesh.faces, topology.twins, labels, patch_count).problems()
            if problems and not repair:
                more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
                raise PartitionInputError(
                    f"the cut edges leave {patch_count} parts, and {problems[0]}{more}; --repair-cuts would mend this"
                )
            if problems:
                labels = make_disks(mesh.vertices, mesh.faces, topology.twins, labels, patch_count, at_once=at_once)
        else:
            labels = partition_faces(mesh.vertices, mesh.faces, topology.twins, patch_count, seed, at_once)
        table = seam_table(mesh.vertices, mesh.faces, topology.twins, labels, at_once)
    except PartitionError as problem:
        raise PartitionInputError(str(problem)) from problem
    return Split(labels, patch_count, _edge_table(mesh, topology.twins, labels, mollification), table)


@numba.njit(cache=True, nogil=True)
def faces_by_label(labels: IntArray, count: int) -> tuple[IntArray, IntArray]:
    """Faces sorted by label, and where each label begins."""
    starts = np.zeros(count + 1, np.int64)
    for f in range(labels.shape[0]):
        starts[labels[f] + 1] += 1
    for k in range(count):
        starts[k + 1] += starts[k]
    fill = starts.copy()
    order = np.empty(labels.shape[0], np.int32)
    for f in range(labels.shape[0]):
        order[fill[labels[f]]] = f
        fill[labels[f]] += 1
    return order, starts


@numba.njit(cache=True, nogil=True)
def vertices_of(faces: IntArray, face_ids: IntArray, marks: BoolArray) -> IntArray:
    """Sorted ids of the vertices that some faces use. marks (V,) are false everywhere, before and after."""
    used = np.empty(3 * face_ids.shape[0], np.int64)
    count = 0
    for f in face_ids:
        for i in range(3):
            v = faces[f, i]
            if not marks[v]:
                marks[v] = True
                used[count] = v
                count += 1
    ids = np.sort(used[:count])
    for v in ids:
        marks[v] = False
    return ids


@numba.njit(cache=True, nogil=True)
def _localise(faces: IntArray, face_ids: IntArray, ids: IntArray, local: IntArray) -> IntArray:
    """Faces (N, 3) in the numbers of sorted vertices; local (V,) is written to."""
    for k in range(ids.shape[0]):
        local[ids[k]] = k
    out = np.empty((face_ids.shape[0], 3), np.int32)
    for k in range(face_ids.shape[0]):
        for i in range(3):
            out[k, i] = local[faces[face_ids[k], i]]
    return out


@numba.njit(cache=True, nogil=True)
def _rim(twins: IntArray, labels: IntArray, face_ids: IntArray) -> IntArray:
    """Half-edges, numbered within the patch, that have no twin in it."""
    found = [np.int64(0) for _ in range(0)]
    for k in range(face_ids.shape[0]):
        for i in range(3):
            twin = twins[3 * np.int64(face_ids[k]) + i]
            if twin < 0 or labels[twin // 3] != labels[face_ids[k]]:
                found.append(np.int64(3 * k + i))
    return np.array(found)


def cut_patches(mesh: Mesh, topology: Topology, split: Split, wanted: Sequence[int] | None = None) -> Iterator[Patch]:
    """Cut patches out of the mesh one after the other, all or those wanted."""
    order, starts = faces_by_label(split.labels, split.patch_count)
    local, marks = np.empty(len(mesh.vertices), np.int32), np.zeros(len(mesh.vertices), np.bool_)
    for index in range(split.patch_count) if wanted is None else wanted:
        face_ids = order[starts[index] : starts[index + 1]]
        vertex_ids = vertices_of(mesh.faces, face_ids, marks)
        faces = _localise(mesh.faces, face_ids, vertex_ids, local)
        rim = _rim(topology.twins, split.labels, face_ids)
        flat = faces.reshape(-1)
        (boundary,) = loops_of(flat[rim], flat[rim - rim % 3 + (rim % 3 + 1) % 3])
        loop = vertex_ids[boundary]
        parts = split.edges.parts[split.edges.rank(loop, np.roll(loop, -1))]
        yield Patch(index, mesh.vertices[vertex_ids], faces, vertex_ids, face_ids, boundary, parts, split.edges.mollification)


def cut_patch(mesh: Mesh, topology: Topology, split: Split, index: int) -> Patch:
    """Cut one patch out of the mesh."""
    return next(cut_patches(mesh, topology, split, [index]))
