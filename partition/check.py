"""The invariants of a partition, in one place: every part a disk, contacts that a weld order exists for.

PGCP eq. 4.1, 4.2 and 4.4 hold by construction, since a partition is one label per face; what is checked is that
each part is connected, is not pinched at a vertex and has Euler characteristic 1, and how parts touch (eq. 4.3).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numba
import numpy as np

from .dual_graph import (
    AtOnce,
    BoolArray,
    FloatArray,
    IntArray,
    in_turn,
    label_components,
    seam_half_edges,
    vertex_starts,
)


@dataclass(frozen=True, slots=True, eq=False)
class PartReport:
    """Per part (K,): faces, components, Euler characteristic; and the vertices where a part touches itself."""

    face_count: IntArray
    component_count: IntArray
    euler_characteristic: IntArray
    pinched_vertices: IntArray
    pinched_parts: IntArray

    @property
    def is_valid(self) -> bool:
        """Whether every part is a disk."""
        return bool(
            (self.face_count > 0).all()
            and (self.component_count == 1).all()
            and (self.euler_characteristic == 1).all()
            and len(self.pinched_vertices) == 0
        )

    def problems(self) -> list[str]:
        """One sentence for every part that is not a disk."""
        out = []
        for part in range(len(self.face_count)):
            pinches = self.pinched_vertices[self.pinched_parts == part]
            if self.face_count[part] == 0:
                out.append(f"part {part} has no faces")
            elif self.component_count[part] != 1:
                out.append(f"part {part} is in {self.component_count[part]} pieces")
            elif len(pinches):
                out.append(f"part {part} touches itself at vertex {pinches[0]}")
            elif self.euler_characteristic[part] != 1:
                holes = 1 - self.euler_characteristic[part]
                what = "is closed" if holes < 0 else f"has {holes} hole{'s' if holes > 1 else ''}"
                out.append(f"part {part} is not a disk: it {what} ({self.face_count[part]} faces)")
        return out


@numba.njit(cache=True, nogil=True)
def _vertex_runs(faces: IntArray, twins: IntArray, labels: IntArray, starts: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """(vertex, label) once for each run of a label around a vertex with two labels or more."""
    vertices = []
    run_labels = []
    inner_only = np.zeros(labels.max() + 1, np.int64)  # vertices whose faces all carry this label
    mixed = np.zeros(starts.shape[0], np.bool_)
    for h in range(twins.shape[0]):
        if twins[h] >= 0 and labels[twins[h] // 3] != labels[h // 3]:
            mixed[faces[h // 3, h % 3]] = True
            mixed[faces[h // 3, (h % 3 + 1) % 3]] = True
    for v in range(starts.shape[0]):
        if starts[v] < 0:
            continue
        h = starts[v]
        first = labels[h // 3]
        if not mixed[v]:
            inner_only[first] += 1
            continue
        previous = first
        runs = 0
        while True:
            label = labels[h // 3]
            if label != previous:
                vertices.append(v)
                run_labels.append(previous)
                runs += 1
                previous = label
            before = h - 1 if h % 3 else h + 2
            h = twins[before]
            if h < 0 or h == starts[v]:
                break
        if h < 0 or previous != first or runs == 0:
            vertices.append(v)
            run_labels.append(previous)
        # else: the last run continues the first one around a closed fan, already counted
    n = len(vertices)
    out_vertices = np.empty(n, np.int64)
    out_labels = np.empty(n, np.int64)
    for i in range(n):
        out_vertices[i] = vertices[i]
        out_labels[i] = run_labels[i]
    return out_vertices, out_labels, inner_only


@numba.njit(cache=True, nogil=True)
def _inner_edges(twins: IntArray, labels: IntArray, part_count: int) -> IntArray:
    """Edges inside each part (K,)."""
    out = np.zeros(part_count, np.int64)
    for h in range(twins.shape[0]):
        if twins[h] > h and labels[twins[h] // 3] == labels[h // 3]:
            out[labels[h // 3]] += 1
    return out


def check_partition(
    faces: IntArray,
    twins: IntArray,
    labels: IntArray,
    part_count: int,
    starts: IntArray | None = None,
    at_once: AtOnce = in_turn,
) -> PartReport:
    """Examine every part of a partition. labels (F,) in [0, part_count). Nothing is changed.

    starts (V,) as from ``vertex_starts``, where they are there already.
    """
    if starts is None:
        starts = vertex_starts(faces, twins, int(faces.max()) + 1)
    (vertices, run_labels, inner), (count, components), inner_edges = at_once(
        partial(_vertex_runs, faces, twins, labels, starts),
        partial(label_components, twins, labels),
        partial(_inner_edges, twins, labels, part_count),
    )
    face_count = np.bincount(labels, minlength=part_count)
    pair = vertices * part_count + run_labels
    unique, counts = np.unique(pair, return_counts=True)
    vertex_count = np.bincount(unique % part_count, minlength=part_count)
    vertex_count[: len(inner)] += inner
    # edges of a part: 3F half-edges, those with the twin in the same part counted once
    euler = vertex_count - (3 * face_count - inner_edges) + face_count
    owner = np.empty(count, np.int64)
    owner[components] = labels
    pinched = unique[counts > 1]
    return PartReport(
        face_count=face_count,
        component_count=np.bincount(owner, minlength=part_count),
        euler_characteristic=euler,
        pinched_vertices=pinched // part_count,
        pinched_parts=pinched % part_count,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """How parts touch: ``pairs`` (N, 2) with p < q; shared edges, shared vertices, shared length of each pair.

    Two disks form a disk exactly where their intersection is one arc: one more shared vertex than shared edges.
    """

    pairs: IntArray
    edge_count: IntArray
    vertex_count: IntArray
    length: FloatArray

    @property
    def is_arc(self) -> BoolArray:
        """(N,) whether the intersection of the pair is a single arc of at least one edge."""
        return (self.edge_count > 0) & (self.vertex_count == self.edge_count + 1)

    @property
    def is_circle(self) -> BoolArray:
        """(N,) whether the intersection of the pair is one closed loop, given that the pair is all there is."""
        return (self.edge_count > 0) & (self.vertex_count == self.edge_count)


@dataclass(frozen=True, slots=True, eq=False)
class SeamTable:
    """Seam edges (labels (E, 2), lengths) and (vertex, label) incidences, enough to follow merges of parts."""

    edge_labels: IntArray
    lengths: FloatArray
    vertices: IntArray
    vertex_labels: IntArray

    def contacts(self, relabel: IntArray) -> Contacts:
        """Contacts between parts after ``relabel`` (K,) maps every part to the part it has been merged into."""
        ends = np.sort(relabel[self.edge_labels], axis=1)
        apart = ends[:, 0] != ends[:, 1]
        size = len(relabel)
        edge_keys = ends[apart, 0] * size + ends[apart, 1]
        incidences = np.unique(self.vertices * size + relabel[self.vertex_labels])
        vertex, label = incidences // size, incidences % size
        keys = []
        for shift in range(1, int(np.bincount(vertex).max(initial=1))):
            both = vertex[shift:] == vertex[:-shift]
            keys.append(label[:-shift][both] * size + label[shift:][both])
        vertex_keys = np.concatenate(keys) if keys else np.empty(0, np.int64)
        unique = np.unique(np.concatenate([edge_keys, vertex_keys]))
        edge_index = np.searchsorted(unique, edge_keys)
        n = len(unique)
        return Contacts(
            pairs=np.column_stack([unique // size, unique % size]),
            edge_count=np.bincount(edge_index, minlength=n),
            vertex_count=np.bincount(np.searchsorted(unique, vertex_keys), minlength=n),
            length=np.bincount(edge_index, self.lengths[apart], minlength=n).astype(np.float64),
        )


def seam_table(
    vertices: FloatArray, faces: IntArray, twins: IntArray, labels: IntArray, at_once: AtOnce = in_turn
) -> SeamTable:
    """Seam table of a valid partition (every part a disk)."""
    cut, starts = at_once(partial(seam_half_edges, twins, labels), partial(vertex_starts, faces, twins, len(vertices)))
    at, run_labels, _ = _vertex_runs(faces, twins, labels, starts)
    flat = faces.reshape(-1)
    return SeamTable(
        edge_labels=np.column_stack([labels[cut // 3], labels[twins[cut] // 3]]),
        lengths=np.linalg.norm(vertices[flat[cut]] - vertices[flat[cut - cut % 3 + (cut % 3 + 1) % 3]], axis=1),
        vertices=at,
        vertex_labels=run_labels,
    )
