"""Shorten seams by moving single faces across them, never breaking a disk."""

from __future__ import annotations

import numba
import numpy as np

from .dual_graph import FloatArray, IntArray


@numba.njit(cache=True, nogil=True)
def _has_label(faces: IntArray, twins: IntArray, labels: IntArray, start: int, label: int) -> bool:
    h = start
    while True:
        if labels[h // 3] == label:
            return True
        before = h - 1 if h % 3 else h + 2
        h = twins[before]
        if h < 0 or h == start:
            return False


@numba.njit(cache=True, nogil=True)
def _is_inside(faces: IntArray, twins: IntArray, labels: IntArray, start: int, label: int) -> bool:
    """Whether all faces around the vertex carry the label and the vertex is not on the surface's boundary."""
    h = start
    while True:
        if labels[h // 3] != label:
            return False
        before = h - 1 if h % 3 else h + 2
        h = twins[before]
        if h < 0:
            return False
        if h == start:
            return True


@numba.njit(cache=True, nogil=True)
def can_move(faces: IntArray, twins: IntArray, labels: IntArray, starts: IntArray, face: int, to: int) -> bool:
    """Whether face may change to label ``to`` with both its part and the other still disks.

    A disk minus a triangle is a disk where the triangle meets the disk's boundary in one arc, and a disk plus a
    triangle is one where they meet in one arc.
    """
    own = labels[face]
    outer, shared = 0, 0
    outer_edge, shared_edge = 0, 0
    for i in range(3):
        twin = twins[3 * face + i]
        if twin < 0 or labels[twin // 3] != own:
            outer += 1
            outer_edge = i
        if twin >= 0 and labels[twin // 3] == to:
            shared += 1
            shared_edge = i
    if outer in (0, 3) or shared in (0, 3):
        return False
    if outer == 1 and not _is_inside(faces, twins, labels, starts[faces[face, (outer_edge + 2) % 3]], own):
        return False
    opposite = starts[faces[face, (shared_edge + 2) % 3]]
    return shared == 2 or not _has_label(faces, twins, labels, opposite, to)


@numba.njit(cache=True, nogil=True)
def shorten_seams(
    faces: IntArray,
    twins: IntArray,
    lengths: FloatArray,
    starts: IntArray,
    labels: IntArray,
    part_count: int,
    max_size: int,
    rounds: int,
) -> int:
    """Move faces across seams in place while that shortens the seams; returns the number of moves.

    No part grows beyond ``max_size`` faces. Parts that are disks stay disks.
    """
    size = np.zeros(part_count, np.int64)
    for f in range(labels.shape[0]):
        size[labels[f]] += 1
    moves = 0
    active = np.ones(labels.shape[0], np.bool_)
    for _ in range(rounds):
        moved = 0
        for f in range(labels.shape[0]):
            if not active[f]:
                continue
            active[f] = False
            own = labels[f]
            for i in range(3):
                twin = twins[3 * f + i]
                if twin < 0 or labels[twin // 3] == own:
                    continue
                to = labels[twin // 3]
                gain = 0.0
                total = 0.0
                for j in range(3):
                    side = twins[3 * f + j]
                    total += lengths[3 * f + j]
                    if side >= 0 and labels[side // 3] == to:
                        gain += lengths[3 * f + j]
                    elif side >= 0 and labels[side // 3] == own:
                        gain -= lengths[3 * f + j]
                if gain <= 1e-9 * total or size[to] >= max_size or size[own] <= 1:
                    continue
                if not can_move(faces, twins, labels, starts, f, to):
                    continue
                labels[f] = to
                size[own] -= 1
                size[to] += 1
                moved += 1
                for j in range(3):
                    side = twins[3 * f + j]
                    if side >= 0:
                        active[side // 3] = True
                break
        moves += moved
        if moved == 0:
            break
    return moves
