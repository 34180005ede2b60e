"""The interface operator: the patches' Schur complements, put together and eliminated up the weld tree.

Every patch's Laplacian with its interior eliminated is a dense operator S_k on the patch's boundary. Their sum on the
vertices they share is the exact Schur complement of the whole mesh's Laplacian on all seams and the outer boundary. Two
operators are joined by adding them on common vertices and eliminating those that lie inside the union:

    A = [[A_EE, A_EK], [A_KE, A_KK]],    S = A_KK - A_KE A_EE^{-1} A_EK,    W = -A_EE^{-1} A_EK

S is the union's operator, and u_E = W u_K the values inside once those around are known (nested dissection; George 1973). A_EE
is positive definite whatever the signs of the cotangent weights: the Laplacian is a sum of positive semi-definite forms,
one per face, and only constants are in its kernel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_solve, cholesky, solve_triangular

from pgcp.errors import SolveFailedError
from pgcp.patches.types import WeldPlan
from pgcp.types import ComplexArray, FloatArray, IntArray, Positions


@dataclass(frozen=True, slots=True, eq=False)
class Merge:
    """Join operators ``left`` and ``right`` into ``result``.

    Operators 0..K-1 are the patches'. Each lives on the vertex ids given for it; ``kept`` (n_K,) are those of the result,
    ``eliminated`` (n_E,) are in it no more.
    """

    left: int
    right: int
    result: int
    level: int
    left_ids: IntArray
    right_ids: IntArray
    kept: IntArray
    eliminated: IntArray

    @property
    def flops(self) -> int:
        """Floating-point operations of the elimination: a Cholesky, two triangular solves, a symmetric update."""
        e, k = len(self.eliminated), len(self.kept)
        return e**3 // 3 + 2 * e * e * k + e * k * k

    @property
    def nbytes(self) -> int:
        """Bytes of S, W and the factor of the eliminated block."""
        n, e = len(self.kept), len(self.eliminated)
        return 8 * (n * (n + e) + e * e)


def plan_merges(plan: WeldPlan, ids: Sequence[IntArray], kept: IntArray) -> tuple[Merge, ...]:
    """Plan all merges along a tree of welds.

    ids: for every patch the vertices (n_k,) its operator lives on; kept (n,): vertices never eliminated, on which the
    last operator lives, in this order. A vertex is eliminated as soon as all patches that hold it are in one union:
    where three patches meet, that is not when the first two of them are joined.
    """
    everywhere, holders = np.unique(np.concatenate(ids), return_counts=True)
    holders[np.searchsorted(everywhere, kept)] += 1  # the world outside holds them too
    held = {index: (np.asarray(own), np.ones(len(own), np.int64)) for index, own in enumerate(ids)}
    merges = []
    for step in plan.steps:
        (left, left_count), (right, right_count) = held.pop(step.left), held.pop(step.right)
        union, where = np.unique(np.concatenate([left, right]), return_inverse=True)
        count = np.bincount(where, np.concatenate([left_count, right_count])).astype(np.int64)
        inside = count == holders[np.searchsorted(everywhere, union)]
        stays = union[~inside]
        if step is plan.steps[-1]:
            stays, count = kept, np.ones(len(kept), np.int64)
        else:
            count = count[~inside]
        held[step.result] = stays, count
        merges.append(Merge(step.left, step.right, step.result, step.level, left, right, stays, union[inside]))
    return tuple(merges)


def _places(ids: IntArray, among: IntArray) -> IntArray:
    """Positions of ids in an array that holds each of them once."""
    order = np.argsort(among)
    return order[np.searchsorted(among, ids, sorter=order)]


def merge_operators(left: FloatArray, right: FloatArray, merge: Merge) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Schur complement S (n_K, n_K) of the union, W (n_E, n_K), which takes values on what is kept to the eliminated, and the
    lower Cholesky factor (n_E, n_E) of the eliminated block.

    Raises SolveFailedError where the block to be eliminated is not positive definite.
    """
    n = len(merge.eliminated)
    ids = np.concatenate([merge.eliminated, merge.kept])
    matrix = np.zeros((len(ids), len(ids)))
    for own, operator in ((merge.left_ids, left), (merge.right_ids, right)):
        places = _places(own, ids)
        matrix[np.ix_(places, places)] += operator
    if n == 0:
        return matrix, np.zeros((0, len(ids))), np.zeros((0, 0))
    try:
        factor = cholesky(matrix[:n, :n], lower=True, check_finite=False)
    except LinAlgError as problem:
        raise SolveFailedError(
            f"a seam of {n} vertices cannot be eliminated: its operator is not positive definite"
        ) from problem
    half = solve_triangular(factor, matrix[:n, n:], lower=True, check_finite=False)
    inside = -solve_triangular(factor, half, lower=True, trans="T", check_finite=False)
    schur = matrix[n:, n:] - half.T @ half
    if not (np.isfinite(schur).all() and np.isfinite(inside).all()):
        raise SolveFailedError(f"eliminating a seam of {n} vertices gave values that are not finite")
    return schur, inside, np.asarray(factor)


def extend_inside(inside: FloatArray, values: Positions) -> Positions:
    """Values (n_E, ...) on eliminated vertices from those on kept ones (n_K, ...), real or complex, any number of columns.

    Constants pass unchanged: values are taken relative to the first, so that a small, far piece keeps its digits.
    """
    start = values[:1]
    columns = np.ascontiguousarray(values - start)
    if np.iscomplexobj(columns):
        flat = inside @ columns.view(np.float64).reshape(len(columns), -1)
        moved = np.ascontiguousarray(flat).view(columns.dtype).reshape(len(inside), *columns.shape[1:])
    else:
        moved = (inside @ columns.reshape(len(columns), -1)).reshape(len(inside), *columns.shape[1:])
    return start + moved


def solve_inside(factor: FloatArray, load: ComplexArray) -> ComplexArray:
    """A_EE^{-1} r_E (n_E,): what a load on the eliminated vertices does there; factor: lower Cholesky factor of A_EE."""
    if len(load) == 0:
        return load
    columns = np.ascontiguousarray(load).view(np.float64).reshape(len(load), 2)
    solved: FloatArray = np.ascontiguousarray(cho_solve((np.asarray(factor), True), columns, check_finite=False))
    return solved.view(np.complex128).reshape(-1)
