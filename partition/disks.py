"""Repair until every part is a disk: join pieces, undo pinches, split rings, merge back to the count asked for."""

from __future__ import annotations

import numba
import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from .check import check_partition, seam_table
from .dual_graph import (
    AtOnce,
    BoolArray,
    FloatArray,
    IntArray,
    dual_graph,
    edge_lengths,
    in_turn,
    label_components,
    vertex_starts,
)
from .errors import PartitionError
from .kway import bisection_labels

_ROUNDS = 50


def _drop_empty(labels: IntArray) -> IntArray:
    used = np.zeros(int(labels.max()) + 1, bool)
    used[labels] = True
    if used.all():
        return labels
    dense: IntArray = (np.cumsum(used) - 1).astype(np.int32)[labels]
    return dense


@numba.njit(cache=True, nogil=True)
def _sizes_and_owners(labels: IntArray, pieces: IntArray, count: int) -> tuple[IntArray, IntArray]:
    """Number of faces, and label, of every piece."""
    sizes, owner = np.zeros(count, np.int64), np.empty(count, np.int64)
    for f in range(labels.shape[0]):
        sizes[pieces[f]] += 1
        owner[pieces[f]] = labels[f]
    return sizes, owner


@numba.njit(cache=True, nogil=True)
def _borders(twins: IntArray, pieces: IntArray, is_fragment: BoolArray) -> IntArray:
    """Half-edges from a fragment, any piece of a part but its largest, to a piece that is none."""
    found = [np.int64(0) for _ in range(0)]
    for f in range(pieces.shape[0]):
        if is_fragment[pieces[f]]:
            for i in range(3):
                twin = twins[3 * f + i]
                if twin >= 0 and not is_fragment[pieces[twin // 3]]:
                    found.append(np.int64(3 * f + i))
    return np.array(found)


@numba.njit(cache=True, nogil=True)
def _relabel(labels: IntArray, pieces: IntArray, owner: IntArray) -> None:
    for f in range(labels.shape[0]):
        labels[f] = owner[pieces[f]]


def _join_pieces(twins: IntArray, lengths: FloatArray, labels: IntArray) -> IntArray:
    """Give every piece but the largest of each part to the neighbour with the longest common border."""
    labels = labels.copy()
    part_count = int(labels.max()) + 1
    while True:
        count, pieces = label_components(twins, labels)
        sizes, owner = _sizes_and_owners(labels, pieces, count)
        largest = np.full(part_count, -1, np.int64)
        for piece in np.argsort(-sizes, kind="stable"):
            if largest[owner[piece]] < 0:
                largest[owner[piece]] = piece
        is_fragment = np.ones(count, bool)
        is_fragment[largest[largest >= 0]] = False
        if not is_fragment.any():
            return labels
        border = _borders(twins, pieces, is_fragment)  # a fragment that touches fragments only waits for the next turn
        here, there = pieces[border // 3].astype(np.int64), pieces[twins[border] // 3]
        key = here * part_count + owner[there]
        unique, index = np.unique(key, return_inverse=True)
        total = np.bincount(index, lengths[border])
        order = np.lexsort((unique, -total, unique // part_count))
        fragments, first = np.unique(unique[order] // part_count, return_index=True)
        owner[fragments] = unique[order][first] % part_count
        _relabel(labels, pieces, owner)


def _undo_pinches(
    faces: IntArray, twins: IntArray, labels: IntArray, vertices: IntArray, parts: IntArray, starts: IntArray
) -> IntArray:
    """Around each pinched vertex keep the longest run of the part, give the others to the run beside them."""
    labels = labels.copy()
    for vertex, part in zip(vertices.tolist(), parts.tolist(), strict=True):
        fan, h = [], int(starts[vertex])
        while True:
            fan.append(h // 3)
            h = int(twins[h - 1 if h % 3 else h + 2])
            if h < 0 or h == starts[vertex]:
                break
        closed = h >= 0
        around = labels[fan]
        inside = around == part
        if inside.all() or not inside.any():
            continue
        shift = int(np.flatnonzero(~inside)[0]) if closed else 0
        fan = fan[shift:] + fan[:shift]
        around, inside = np.roll(around, -shift), np.roll(inside, -shift)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
        runs = edges.reshape(-1, 2)
        keep = int(np.argmax(runs[:, 1] - runs[:, 0]))
        for r, (start, stop) in enumerate(runs):
            if r != keep:
                beside = around[start - 1] if start > 0 else around[stop]
                labels[fan[start:stop]] = beside
    return labels


def _loops_of(tails: IntArray, heads: IntArray) -> list[list[int]]:
    """Closed loops of directed edges, at most one leaving any vertex."""
    follower = dict(zip(tails.tolist(), heads.tolist(), strict=True))
    loops = []
    for start in sorted(follower):
        loop, vertex = [], start
        while vertex in follower:
            loop.append(vertex)
            vertex = follower.pop(vertex)
        if loop:
            loops.append(loop)
    return loops


def _split_closed(dual: csr_array) -> BoolArray:
    """Faces of a closed surface nearer to one far face than to the one farthest from it."""
    first = int(np.argmax(dijkstra(dual, directed=False, indices=0)))
    from_first = dijkstra(dual, directed=False, indices=first)
    from_other = dijkstra(dual, directed=False, indices=int(np.argmax(from_first)))
    nearer: BoolArray = from_other < from_first
    return nearer


def _shortest_cut(tails: IntArray, heads: IntArray, steps: FloatArray, loops: list[list[int]]) -> IntArray:
    """Vertices of the shortest path from the nearest other loop to the longest one."""
    used = np.zeros(int(max(tails.max(), heads.max())) + 1, bool)
    used[tails] = used[heads] = True
    ids = np.flatnonzero(used)
    dense = np.cumsum(used, dtype=np.int32) - 1
    graph = coo_array((steps, (dense[tails], dense[heads])), shape=(len(ids), len(ids))).tocsr()
    main = max(loops, key=len)
    distance, previous, _ = dijkstra(
        graph, directed=False, indices=dense[np.array(main)], min_only=True, return_predecessors=True
    )
    goals = dense[np.array([v for loop in loops if loop is not main for v in loop])]
    place = int(goals[np.argmin(distance[goals])])
    path = [int(ids[place])]
    while previous[place] >= 0:
        place = int(previous[place])
        path.append(int(ids[place]))
    return np.array(path)


def _are_on(path: IntArray, tails: IntArray, heads: IntArray) -> BoolArray:
    """Which edges, from tails to heads (N,), are steps of a path."""
    after = np.full(int(max(tails.max(), heads.max(), path.max())) + 1, -1, np.int64)
    after[path[:-1]] = path[1:]
    on: BoolArray = after[tails] == heads
    return on


def _rings_to_halves(
    vertices: FloatArray, faces: IntArray, twins: IntArray, lengths: FloatArray, labels: IntArray, part: int
) -> IntArray:
    """Cut a part with holes along a shortest path between two of its loops, and along the points halfway round.

    Faces nearer (across faces of the part, not through the path) to the left side of the path form one half.
    A part without boundary (a closed surface) is split in two by distance from two far faces.
    """
    members = np.flatnonzero(labels == part)
    n = len(members)
    local = np.full(len(labels), -1, np.int32)
    local[members] = np.arange(n)
    half = (3 * members[:, None] + np.arange(3)).reshape(-1)
    rows = np.repeat(np.arange(n), 3)
    across = np.where(twins[half] >= 0, local[np.maximum(twins[half], 0) // 3], -1)
    own = faces[members]
    tails, heads = own.reshape(-1), own[:, [1, 2, 0]].reshape(-1)
    labels = labels.copy()
    new_label = int(labels.max()) + 1
    rim = across < 0
    loops = _loops_of(tails[rim], heads[rim])
    if len(loops) == 0:
        labels[members[_split_closed(dual_graph(twins, lengths)[members][:, members])]] = new_label
        return labels
    if len(loops) < 2:
        raise PartitionError(f"part {part} is neither a disk nor a ring: the surface has a handle")
    cut = _shortest_cut(tails, heads, lengths[half], loops)
    forward, backward = _are_on(cut, tails, heads), _are_on(cut, heads, tails)
    free = ~rim & ~forward & ~backward
    here, there = rows[free], across[free]
    centre = vertices[own[:, 0]] + vertices[own[:, 1]] + vertices[own[:, 2]]
    gap = np.sqrt(((centre[here] - centre[there]) ** 2).sum(axis=1))
    walk = coo_array((gap + 1e-12 * gap.max(), (here, there)), shape=(n, n)).tocsr()
    left = np.zeros(n, bool)
    left[rows[forward]] = True
    sides = np.unique(rows[forward | backward])
    _, _, nearest = dijkstra(walk, directed=False, indices=sides, min_only=True, return_predecessors=True)
    labels[members[~left[nearest]]] = new_label
    return labels


def _merge_to(vertices: FloatArray, faces: IntArray, twins: IntArray, labels: IntArray, part_count: int) -> IntArray:
    """Merge the pair of disks with the smallest union, among those whose union is a disk, until the count is met."""
    table = seam_table(vertices, faces, twins, labels)
    count = int(labels.max()) + 1
    relabel = np.arange(count)
    sizes = np.bincount(labels, minlength=count)
    for _ in range(count - part_count):
        contacts = table.contacts(relabel)
        usable = np.flatnonzero(contacts.is_arc)
        if len(usable) == 0:
            raise PartitionError(f"no two of {len(np.unique(relabel))} parts form a disk together")
        pairs = contacts.pairs[usable]
        best = int(np.lexsort((-contacts.length[usable], sizes[pairs].sum(axis=1)))[0])
        keep, gone = pairs[best]
        relabel[relabel == gone] = keep
        sizes[keep] += sizes[gone]
    return _drop_empty(relabel[labels])


def _split_largest(twins: IntArray, lengths: FloatArray, labels: IntArray) -> IntArray:
    """Bisect the part with the most faces."""
    sizes = np.bincount(labels)
    part = int(np.argmax(sizes))
    if sizes[part] < 2:
        raise PartitionError(f"the mesh has only {len(labels)} faces, too few for more than {len(sizes)} patches")
    members = np.flatnonzero(labels == part)
    labels = labels.copy()
    halves = bisection_labels(dual_graph(twins, lengths)[members][:, members], 2)
    labels[members[halves == 1]] = len(sizes)
    return labels


def make_disks(
    vertices: FloatArray,
    faces: IntArray,
    twins: IntArray,
    labels: IntArray,
    part_count: int,
    lengths: FloatArray | None = None,
    starts: IntArray | None = None,
    at_once: AtOnce = in_turn,
) -> IntArray:
    """Labels near the given ones whose parts are all disks, ``part_count`` of them. Deterministic.

    lengths and starts as from ``edge_lengths`` and ``vertex_starts``, where they are there already. Raises PartitionError where
    the surface cannot carry that many disks.
    """
    if starts is None:
        starts = vertex_starts(faces, twins, len(vertices))
    labels = _drop_empty(labels.astype(np.int32))
    for _ in range(_ROUNDS):
        count = int(labels.max()) + 1
        report = check_partition(faces, twins, labels, count, starts, at_once)
        if report.is_valid and count >= part_count:
            break
        if lengths is None:
            lengths = edge_lengths(vertices, faces)
        if (report.component_count != 1).any():
            labels = _drop_empty(_join_pieces(twins, lengths, labels))
            continue
        if len(report.pinched_vertices):
            labels = _undo_pinches(faces, twins, labels, report.pinched_vertices, report.pinched_parts, starts)
            continue
        for part in np.flatnonzero(report.euler_characteristic != 1):
            labels = _rings_to_halves(vertices, faces, twins, lengths, labels, int(part))
        if report.is_valid:
            labels = _split_largest(twins, lengths, labels)
    else:
        raise PartitionError(f"could not make {part_count} disks in {_ROUNDS} rounds of repair")
    return _merge_to(vertices, faces, twins, labels, part_count) if count > part_count else labels
