"""Triangle soup to oriented manifold: drop, weld, cut, turn and split, each a pure function on faces.

Vertices are never moved. ``vertex_of`` (n,) says which vertex of the input each vertex is: copies are appended to it.
"""

from __future__ import annotations

import numba
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pgcp.surface import plain
from pgcp.surface.operators import looked_at_areas
from pgcp.surface.topology import BOUNDARY, NON_MANIFOLD, pair_half_edges
from pgcp.types import BoolArray, FloatArray, IntArray

_MOST_FACES = 32
_FEW_PAIRS = 10_000
_TIE_DIGITS = 9
_OTHER_SHEET = np.pi


def proper_faces(faces: IntArray, same: IntArray | None = None) -> tuple[IntArray, int, int]:
    """Ids of the faces that use three vertices and are the first of their kind; how many are not, by either reason.

    Faces with the same vertices in any order are of one kind. With ``same`` (n,) vertices of equal number count as one
    where kinds are compared.
    """
    whole = np.flatnonzero((faces != np.roll(faces, -1, axis=1)).all(axis=1))
    corners = np.sort(faces[whole] if same is None else same[faces[whole]], axis=1)
    order = np.lexsort(corners.T[::-1])
    again = (corners[order[1:]] == corners[order[:-1]]).all(axis=1)
    if same is not None:
        again &= (corners[order[1:], :2] != corners[order[1:], 1:]).all(axis=1)
    kept = np.delete(whole, order[1:][again])
    return kept, len(faces) - len(whole), len(whole) - len(kept)


def coincident(vertices: FloatArray) -> IntArray:
    """For every vertex (V,) the lowest one at exactly the same place; -0.0 is 0.0."""
    columns = vertices + 0.0
    order = np.lexsort(columns.T[::-1])
    new = np.ones(len(order), bool)
    new[1:] = (columns[order[1:]] != columns[order[:-1]]).any(axis=1)
    group = np.cumsum(new) - 1
    lowest = np.minimum.reduceat(order, np.flatnonzero(new))
    out = np.empty(len(order), np.int64)
    out[order] = lowest[group]
    return out


def contracted(points: FloatArray, faces: IntArray) -> IntArray:
    """For every vertex (n,) the lowest of those that edges of no length join it to; points (n, 3)."""
    tails, heads = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    short = np.flatnonzero((points[tails] == points[heads]).all(axis=1))
    graph = coo_array((np.ones(len(short), np.int8), (tails[short], heads[short])), (len(points), len(points)))
    labels = connected_components(graph, directed=False)[1]
    lowest: IntArray = np.unique(labels, return_index=True)[1]
    return lowest[labels]


def flattened_fins(faces: IntArray, vertex_count: int) -> BoolArray:
    """Which faces (F,) lie back to back in pairs and are joined along an edge that no other face has: fins of no thickness.

    Without both, the surface closes up behind them. What such a pair uncovers may be one in its turn.
    """
    left = np.arange(len(faces))
    while len(left):
        here = faces[left].astype(np.int64)
        corners = np.sort(here, axis=1)
        order = np.lexsort(corners.T[::-1])
        same = (corners[order[1:]] == corners[order[:-1]]).all(axis=1)
        alone = same & ~np.append(False, same[:-1]) & ~np.append(same[1:], False)
        one, two = order[:-1][alone], order[1:][alone]
        turned = _is_odd(here[one]) != _is_odd(here[two])
        one, two = one[turned], two[turned]
        ends = np.sort(np.stack([here, np.roll(here, -1, axis=1)], axis=-1), axis=-1)
        _, edge, uses = np.unique(ends[..., 0] * vertex_count + ends[..., 1], return_inverse=True, return_counts=True)
        rim = (uses[edge.reshape(-1, 3)[one]] == 2).any(axis=1)
        if not rim.any():
            break
        left = np.delete(left, np.concatenate([one[rim], two[rim]]))
    fins = np.ones(len(faces), bool)
    fins[left] = False
    return fins


def _is_odd(faces: IntArray) -> BoolArray:
    """Whether the corners of faces (N, 3) are an odd permutation of their order."""
    a, b, c = faces.T
    return (a > b) ^ (b > c) ^ (a > c)


def weld_open(faces: IntArray, same: IntArray) -> IntArray:
    """For every vertex (V,) the one it becomes when vertices at one place are welded that open edges end in.

    same (V,) from ``coincident``. Vertices inside the surface have nothing to gain from a weld, and stay.
    """
    twins = pair_half_edges(faces, len(same))
    half_edges = np.flatnonzero(twins == BOUNDARY)
    flat = faces.reshape(-1)
    on_open_edge = np.zeros(len(same), bool)
    on_open_edge[flat[half_edges]] = on_open_edge[flat[_after(half_edges)]] = True
    ends = np.flatnonzero(on_open_edge)
    out = np.arange(len(same))
    first = np.full(len(same), len(same))
    np.minimum.at(first, same[ends], ends)
    out[ends] = first[same[ends]]
    return out


def _after(half_edges: IntArray) -> IntArray:
    """The next half-edge of the same face: its corner is the head of this one."""
    return np.where(half_edges % 3 == 2, half_edges - 2, half_edges + 1)


def sheets(points: FloatArray, faces: IntArray, twins: IntArray) -> tuple[IntArray, BoolArray, BoolArray]:
    """Component of every face (F,), which faces (F,) to turn for all to agree, and which components are one-sided.

    By the components of the oriented double cover. In each the side with more area stays, the first face's in a tie.
    """
    count = len(faces)
    inner = np.flatnonzero(twins >= 0)
    flat = faces.reshape(-1)
    agree = flat[inner] != flat[twins[inner]]
    here, there = inner // 3, twins[inner] // 3
    rows = np.concatenate([here, here + count])
    columns = np.concatenate([np.where(agree, there, there + count), np.where(agree, there + count, there)])
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), (2 * count, 2 * count))
    labels = connected_components(graph, directed=False)[1]
    front, back = labels[:count], labels[count:]
    lower = np.minimum(front, back)
    component = (np.cumsum(np.bincount(lower) > 0) - 1)[lower]
    turned = front > back
    areas = looked_at_areas(points, faces)
    balance = np.bincount(component, np.where(turned, -areas, areas))
    one_sided = np.bincount(component, front == back) > 0
    return component, turned ^ (balance < 0.0)[component], one_sided


def turn_faces(faces: IntArray, turned: BoolArray) -> IntArray:
    """Faces with some of them (F,) turned over; the first corner stays the first."""
    return np.where(turned[:, None], faces[:, [0, 2, 1]], faces)


@numba.njit(cache=True)
def _fans(faces: IntArray, twins: IntArray) -> IntArray:
    """Lowest corner (3F,) of the fan that every corner belongs to: corners joined across paired half-edges."""
    root = np.arange(twins.shape[0])
    for h in range(twins.shape[0]):
        t = twins[h]
        if t <= h:
            continue
        h_head, t_head = h + 1 if h % 3 < 2 else h - 2, t + 1 if t % 3 < 2 else t - 2
        opposite = faces[h // 3, h % 3] == faces[t_head // 3, t_head % 3]
        for side in range(2):
            a = h if side == 0 else h_head
            b = (t_head if side == 0 else t) if opposite else (t if side == 0 else t_head)
            while root[a] != a:
                root[a] = root[root[a]]
                a = root[a]
            while root[b] != b:
                root[b] = root[root[b]]
                b = root[b]
            root[max(a, b)] = min(a, b)
    for c in range(root.shape[0]):
        root[c] = root[root[c]]
    return root


def split_fans(
    faces: IntArray, twins: IntArray, vertex_of: IntArray, allowed: BoolArray | None = None
) -> tuple[IntArray, IntArray, int]:
    """Give every fan of faces around a vertex a vertex of its own; new faces, vertex_of, and how many vertices were split.

    The largest fan keeps the vertex, others get copies of it. allowed (n,): vertices that may be split, None for all.
    """
    faces = np.ascontiguousarray(faces, np.int64)
    root = (plain.fans if plain.is_few(faces, _fans) else _fans)(faces, twins)
    flat = faces.reshape(-1).astype(np.int64)
    first = np.flatnonzero(root == np.arange(len(root)))
    size = np.bincount(root, minlength=len(root))[first]
    order = np.lexsort((first, -size, flat[first]))
    vertex = flat[first[order]]
    extra = np.zeros(len(order), bool)
    extra[1:] = vertex[1:] == vertex[:-1]
    if allowed is not None:
        extra &= allowed[vertex]
    name = flat.copy()
    name[first[order[extra]]] = len(vertex_of) + np.arange(int(extra.sum()))
    copies = vertex_of[vertex[extra]]
    return name[root].reshape(-1, 3), np.concatenate([vertex_of, copies]), len(np.unique(vertex[extra]))


def _directions(points: FloatArray, faces: IntArray, half_edges: IntArray) -> FloatArray:
    """Unit vector (N, 3) at right angles to each half-edge into its face; 0 where there is none."""
    flat = faces.reshape(-1)
    head = _after(half_edges)
    tail, along = points[flat[half_edges]], points[flat[head]] - points[flat[half_edges]]
    inward = points[flat[_after(head)]] - tail
    square = np.maximum((along**2).sum(axis=1), 1e-300)
    inward = inward - along * ((inward * along).sum(axis=1) / square)[:, None]
    return inward / np.maximum(np.linalg.norm(inward, axis=1), 1e-300)[:, None]


def _pairs_at_edges(keys: IntArray) -> tuple[IntArray, IntArray]:
    """All pairs of positions with the same key, keys sorted; none where more than 32 have it."""
    starts = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    counts = np.diff(np.append(starts, len(keys)))
    one, two = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for k in np.unique(counts[counts <= _MOST_FACES]).tolist():
        rows = starts[counts == k][:, None] + np.arange(k)
        i, j = np.triu_indices(k, 1)
        one.append(rows[:, i].reshape(-1))
        two.append(rows[:, j].reshape(-1))
    return np.concatenate(one), np.concatenate(two)


@numba.njit(cache=True)
def _choose_pairs(
    one: IntArray, two: IntArray, odd: BoolArray, sheet: IntArray, edge: IntArray, sheet_count: int, most: int
) -> IntArray:
    """Partner (N,) of every half-edge, -1 for none: pairs are taken in order, at most ``most`` an edge.

    A pair that would make a one-sided surface of the sheets it joins is not taken: sheets are kept in a union-find
    structure with the parity of their orientations.
    """
    partner = np.full(sheet.shape[0], -1, np.int64)
    taken = np.zeros(edge.max() + 1, np.int64)
    parent, size = np.arange(sheet_count), np.ones(sheet_count, np.int64)
    parity = np.zeros(sheet_count, np.bool_)
    for p in range(one.shape[0]):
        i, j = one[p], two[p]
        if partner[i] >= 0 or partner[j] >= 0 or taken[edge[i]] == most:
            continue
        a, b, differ = sheet[i], sheet[j], odd[p]
        while parent[a] != a:
            differ ^= parity[a]
            a = parent[a]
        while parent[b] != b:
            differ ^= parity[b]
            b = parent[b]
        if a == b:
            if differ:
                continue
        else:
            if size[a] < size[b]:
                a, b = b, a
            parent[b], parity[b] = a, differ
            size[a] += size[b]
        partner[i], partner[j] = j, i
        taken[edge[i]] += 1
    return partner


def _best_pairs(points: FloatArray, faces: IntArray, twins: IntArray, crowded: IntArray, keys: IntArray, most: int) -> IntArray:
    """Partners (N,) among the half-edges ``crowded``, sorted by edge: the flattest pairs whose faces agree.

    What two sheets cost together is the mean over all edges where they meet, so that the choice is one along a curve.
    """
    component, turned, _ = sheets(points, faces, twins)
    one, two = _pairs_at_edges(keys)
    direction = _directions(points, faces, crowded)
    flat = faces.reshape(-1)
    forward = (flat[crowded] < flat[_after(crowded)]) ^ turned[crowded // 3]
    odd = forward[one] == forward[two]
    sheet = component[crowded // 3]
    turn = np.arccos(np.clip(-(direction[one] * direction[two]).sum(axis=1), -1.0, 1.0)) + np.pi * odd
    low, high = np.minimum(sheet[one], sheet[two]), np.maximum(sheet[one], sheet[two])
    pair = np.unique(low * (component.max() + 1) + high, return_inverse=True)[1].reshape(-1)
    mean = (np.bincount(pair, turn) / np.maximum(np.bincount(pair), 1))[pair]
    cost = np.where(low == high, turn, mean + _OTHER_SHEET)
    order = np.lexsort((two, one, np.round(cost, _TIE_DIGITS)))
    edge = np.unique(keys, return_inverse=True)[1].reshape(-1)
    # compiling takes longer than this takes without, where pairs are few
    choose = _choose_pairs.py_func if len(one) <= _FEW_PAIRS and plain.is_few(one, _choose_pairs) else _choose_pairs
    return choose(one[order], two[order], odd[order], sheet, edge, int(component.max()) + 1, most)


def _free(twins: IntArray, faces: IntArray) -> None:
    """Take some faces (ids) out of all pairs, in place."""
    half_edges = (3 * faces[:, None] + np.arange(3)).reshape(-1)
    others = twins[half_edges]
    twins[others[others >= 0]] = BOUNDARY
    twins[half_edges] = BOUNDARY


def cut_edges(points: FloatArray, faces: IntArray, vertex_of: IntArray) -> tuple[IntArray, IntArray, int]:
    """Cut the surface apart where more than two faces share an edge; new faces, vertex_of, and how many such edges were.

    points (n, 3). The faces of an edge are paired so that the surface turns least and they agree in orientation, those
    of one sheet before others; what is left over is cut off. Where a cut leaves both ends of an edge joined another way
    round, one pair of faces keeps it and the other faces come away altogether, so the end is always reached.
    """
    count, most = 0, _MOST_FACES
    while True:
        twins = pair_half_edges(faces, len(vertex_of))
        crowded = np.flatnonzero(twins == NON_MANIFOLD)
        if len(crowded) == 0:
            return faces, vertex_of, count
        flat = faces.reshape(-1).astype(np.int64)
        tails, heads = flat[crowded], flat[_after(crowded)]
        keys = np.minimum(tails, heads) * len(vertex_of) + np.maximum(tails, heads)
        order = np.argsort(keys, kind="stable")
        crowded, keys = crowded[order], keys[order]
        partner = _best_pairs(points[vertex_of], faces, twins, crowded, keys, most)
        twins[crowded] = np.where(partner >= 0, crowded[partner], BOUNDARY)
        allowed = np.zeros(len(vertex_of), bool)
        allowed[tails], allowed[heads] = True, True
        if most == 1:
            apart = np.unique(crowded[partner < 0] // 3)
            _free(twins, apart)
            allowed[faces[apart]] = True
        else:
            count, most = len(np.unique(keys)), 1
        faces, vertex_of, _ = split_fans(faces, twins, vertex_of, allowed)
