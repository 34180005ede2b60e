"""Least squares of a mesh with two unknowns a vertex: the normal matrix, face by face, eliminated along a nested dissection.

As ``nested``, whose tree and fronts serve here: a vertex stands for two rows.
"""

from __future__ import annotations

import numba
import numpy as np

from pgcp.elimination.dissection import EliminationTree, dissect
from pgcp.elimination.fronts import add_update, clear, eliminate, padded, store_update
from pgcp.elimination.nested import substitute_back, substitute_forward
from pgcp.errors import SolveFailedError
from pgcp.types import FloatArray, IntArray


@numba.njit(cache=True, nogil=True)
def _factor_squares(
    faces: IntArray, rows: FloatArray, damping: float, order: IntArray, depth: int, children: IntArray, leaf: IntArray,
    first: IntArray, position: IntArray, starts: IntArray, others: IntArray,
    factor: FloatArray, stack: FloatArray, fronts: FloatArray,
) -> bool:  # fmt: skip
    """As ``nested._factor``, with the sum of J^T J over faces, J = rows[f] (3, 6), and damping on the diagonal.

    first, starts and others count and name unknowns, position (n,) vertices; False where a pivot is not positive.
    """
    # long: one compiled loop over all fronts; parts of it as functions would hand its arrays on at every front
    n = faces.shape[0]
    place = np.zeros(2 * position.shape[0], np.int32)
    into = np.empty(2 * position.shape[0], np.int32)
    local = np.empty(6, np.int32)
    top, done, which = 0, 0, 0
    for k in range(children.shape[0]):
        begin, end, start = first[k], first[k + 1], starts[k]
        own, rest = end - begin, starts[k + 1] - start
        width = own + rest
        stride = padded(width)
        front = fronts[which]
        clear(front, width)
        if leaf[k] >= 0:
            for t in range(own):
                place[begin + t] = t
            for t in range(rest):
                place[others[start + t]] = own + t
            for p in range((n * leaf[k]) >> depth, (n * (leaf[k] + 1)) >> depth):
                f = order[p]
                for i in range(3):
                    at = 2 * position[faces[f, i]]
                    local[2 * i], local[2 * i + 1] = place[at], place[at + 1]
                for a in range(6):
                    for b in range(a, 6):
                        x, y = min(local[a], local[b]), max(local[a], local[b])
                        front[x * stride + y] += (
                            rows[f, 0, a] * rows[f, 0, b] + rows[f, 1, a] * rows[f, 1, b] + rows[f, 2, a] * rows[f, 2, b]
                        )
        else:
            for side in (1, 0):
                child = children[k, side]
                size = starts[child + 1] - starts[child]
                q = 0
                for t in range(size):
                    later = others[starts[child] + t]
                    if later < end:
                        into[t] = later - begin
                    else:
                        while others[start + q] < later:
                            q += 1
                        into[t] = own + q
                if side == 1:
                    gone = first[child + 1] - first[child]
                    step = padded(gone + size) + 1
                    add_update(front, width, into[:size], fronts[1 - which], gone * step, step, 0)
                else:
                    top -= size * (size + 1) // 2
                    add_update(front, width, into[:size], stack, top, size, 1)
        for t in range(own):
            front[t * (stride + 1)] += damping
        if not eliminate(front, own, width):
            return False
        for t in range(own):
            factor[done : done + width - t] = front[t * stride + t : t * stride + width]
            done += width - t
        if k + 1 < children.shape[0] and children[k + 1, 1] == k:
            which = 1 - which
        else:
            top = store_update(front, own, width, stack, top)
    return True


def _doubled(tree: EliminationTree) -> tuple[IntArray, IntArray, IntArray, int, int, int]:
    """first, starts and others of unknowns; sizes of the factor and the stack, and rows of the largest front."""
    first, starts = 2 * tree.first, 2 * tree.starts
    others = (2 * np.repeat(tree.others, 2)).reshape(-1, 2)
    others[:, 1] += 1
    own, rest = np.diff(first), np.diff(starts)
    factor = int((own * (own + 1) // 2 + own * rest).sum())
    stack = 4 * tree.stack_size + 8  # a triangle of twice the rows has less than four times the numbers
    return first, starts, np.ascontiguousarray(others.reshape(-1), np.int32), factor, stack, 2 * tree.widest


class SquaresSolver:
    """Solves (sum over faces of J^T J + damping) x = right for two unknowns a vertex, all of which faces (F, 3) use.

    vertices (n, 3) say where faces lie, for the dissection alone. Between calls of ``factor`` the same dissection serves.
    """

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        self._faces = np.ascontiguousarray(faces, np.int32)
        tree = dissect(vertices, self._faces, np.empty(0, np.int64))
        self._tree = tree
        self._first, self._starts, self._others, factor, stack, widest = _doubled(tree)
        self._factor, self._stack = np.empty(factor), np.empty(stack)
        self._fronts = np.empty((2, widest * padded(widest)))

    def factor(self, rows: FloatArray, damping: float) -> None:
        """Eliminate with rows (F, 3, 6): of each face three equations in the two unknowns of its three corners.

        Raises SolveFailedError where a pivot is not positive.
        """
        tree = self._tree
        plan = tree.order, tree.depth, tree.children, tree.leaf, self._first, tree.position, self._starts, self._others
        if not _factor_squares(self._faces, rows, damping, *plan, self._factor, self._stack, self._fronts):
            raise SolveFailedError(f"the normal matrix of {len(tree.position)} vertices has a pivot that is not positive")

    def solve(self, right: FloatArray) -> FloatArray:
        """The unknowns (n, 2) of a right-hand side (n, 2)."""
        position = self._tree.position
        x = np.zeros((2, 2 * len(position)))
        ordered = np.empty((len(position), 2))
        ordered[position] = right
        x[0] = ordered.reshape(-1)
        substitute_forward(self._factor, self._first, self._starts, self._others, x)
        substitute_back(self._factor, self._first, self._starts, self._others, x)
        out: FloatArray = x[0].reshape(-1, 2)[position]
        return out
