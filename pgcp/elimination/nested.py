"""Boundary-last elimination along a nested dissection of the faces: multifrontal Cholesky, every machine, no matrix assembled.

Every node of the dissection has a front, a dense symmetric matrix on the vertices eliminated there and on the later ones
its faces touch: the sum of its faces' element matrices or of its children's Schur complements (Duff, Reid 1983). It is
eliminated in place; what is left goes up. What the root leaves is the Dirichlet-to-Neumann operator on the kept
vertices.
"""

from __future__ import annotations

from collections.abc import Callable

import numba
import numpy as np

from pgcp.elimination.dissection import dissect
from pgcp.elimination.fronts import add_update, clear, eliminate, padded, store_update
from pgcp.errors import SolveFailedError
from pgcp.surface.operators import corner_weights
from pgcp.types import ComplexArray, FloatArray, IntArray


@numba.njit(cache=True, nogil=True)
def _factor(
    faces: IntArray, weights: FloatArray, order: IntArray, depth: int, children: IntArray, leaf: IntArray,
    first: IntArray, position: IntArray, starts: IntArray, others: IntArray,
    count_in: int, factor: FloatArray, stack: FloatArray, fronts: FloatArray,
) -> bool:  # fmt: skip
    """All fronts from the leaves up: rows of U into factor, unless that is empty; the root's Schur complement onto the stack.

    Positions from count_in on are in no front. Of a node's children the right one is eliminated just before it, and is added
    from its own front (of two, fronts (2, n)); the left one's update waits on the stack. False where a pivot is not positive.
    """
    # long: one compiled loop over all fronts; parts of it as functions would hand its arrays on at every front
    n = faces.shape[0]
    place = np.zeros(position.shape[0], np.int32)
    into = np.empty(position.shape[0], np.int32)
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
                    p1, p2 = position[faces[f, (i + 1) % 3]], position[faces[f, (i + 2) % 3]]
                    if p1 < count_in:
                        front[place[p1] * (stride + 1)] += weights[f, i]
                    if p2 < count_in:
                        front[place[p2] * (stride + 1)] += weights[f, i]
                    if p1 < count_in and p2 < count_in:
                        a, b = place[p1], place[p2]
                        front[min(a, b) * stride + max(a, b)] -= weights[f, i]
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
        if not eliminate(front, own, width):
            return False
        if factor.shape[0] > 0:
            for t in range(own):
                factor[done : done + width - t] = front[t * stride + t : t * stride + width]
                done += width - t
        if k + 1 < children.shape[0] and children[k + 1, 1] == k:
            which = 1 - which
        else:
            top = store_update(front, own, width, stack, top)
    return True


@numba.njit(cache=True, nogil=True)
def substitute_forward(factor: FloatArray, first: IntArray, starts: IntArray, others: IntArray, x: FloatArray) -> None:
    """Solve U^T y = x in place for the eliminated positions, x (2, n); kept positions get what is left of the load there."""
    row = 0
    for k in range(starts.shape[0] - 1):
        begin, end, start, stop = first[k], first[k + 1], starts[k], starts[k + 1]
        own, rest = end - begin, stop - start
        later = np.zeros((2, rest))
        for t in range(own):
            re, im = x[0, begin + t] / factor[row], x[1, begin + t] / factor[row]
            if re != 0.0 or im != 0.0:  # as near what is given
                x[0, begin + t], x[1, begin + t] = re, im
                u = factor[row : row + own - t]
                for b in range(1, own - t):
                    x[0, begin + t + b] -= u[b] * re
                    x[1, begin + t + b] -= u[b] * im
                u = factor[row + own - t : row + own - t + rest]
                for b in range(rest):
                    later[0, b] += u[b] * re
                    later[1, b] += u[b] * im
            row += own - t + rest
        for b in range(rest):
            x[0, others[start + b]] -= later[0, b]
            x[1, others[start + b]] -= later[1, b]


@numba.njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def substitute_back(factor: FloatArray, first: IntArray, starts: IntArray, others: IntArray, x: FloatArray) -> None:
    """Solve U u = x in place for the eliminated positions, x (2, n), kept positions given."""
    row = factor.shape[0]
    for k in range(starts.shape[0] - 2, -1, -1):
        begin, end, start, stop = first[k], first[k + 1], starts[k], starts[k + 1]
        own, width = end - begin, end - begin + stop - start
        real, imaginary = np.empty(width), np.empty(width)
        for b in range(own, width):
            real[b], imaginary[b] = x[0, others[start + b - own]], x[1, others[start + b - own]]
        for t in range(own - 1, -1, -1):
            row -= width - t
            u = factor[row : row + width - t]
            later_real, later_imaginary = real[t:], imaginary[t:]
            re, im = 0.0, 0.0
            for b in range(1, width - t):
                re += u[b] * later_real[b]
                im += u[b] * later_imaginary[b]
            real[t], imaginary[t] = (x[0, begin + t] - re) / u[0], (x[1, begin + t] - im) / u[0]
            x[0, begin + t], x[1, begin + t] = real[t], imaginary[t]


@numba.njit(cache=True, nogil=True)
def _mirrored(upper: FloatArray, n: int) -> FloatArray:
    """The symmetric matrix (n, n) with this upper triangle, by rows without gaps."""
    out = np.empty((n, n))
    at = 0
    for a in range(n):
        for b in range(a, n):
            out[a, b] = upper[at]
            out[b, a] = upper[at]
            at += 1
    return out


@numba.njit(cache=True, nogil=True)
def _load_of(faces: IntArray, weights: FloatArray, position: IntArray, values: FloatArray, inner: int) -> FloatArray:
    """-L_IB u_B (2, n_I) by position, from values (2, n_B) at kept positions, which begin at ``inner``."""
    out = np.zeros((2, inner))
    for f in range(faces.shape[0]):
        for i in range(3):
            p, q = position[faces[f, (i + 1) % 3]], position[faces[f, (i + 2) % 3]]
            if p > q:
                p, q = q, p
            if p < inner <= q:
                out[0, p] += weights[f, i] * values[0, q - inner]
                out[1, p] += weights[f, i] * values[1, q - inner]
    return out


def _apart(values: ComplexArray) -> FloatArray:
    """Real and imaginary parts (2, n)."""
    return np.stack([values.real, values.imag])


def _together(parts: FloatArray) -> ComplexArray:
    """The complex numbers (n,) of parts (2, n)."""
    out: ComplexArray = np.ascontiguousarray(parts.T).view(np.complex128)[:, 0]
    return out


class _Elimination:
    """A mesh's cotangent weights eliminated along a dissection; raises SolveFailedError where that cannot be done."""

    def __init__(
        self,
        vertices: FloatArray,
        faces: IntArray,
        kept: IntArray,
        mollification: float,
        without_kept: bool,
        keeps: Callable[[int], bool] | None = None,
        order: IntArray | None = None,
    ) -> None:
        self.faces = np.ascontiguousarray(faces, np.int32)
        tree = dissect(vertices, self.faces, kept, without_kept=without_kept, order=order)
        self.order = tree.order
        root = int(tree.starts[-1] - tree.starts[-2])
        if (tree.position < 0).any() or root != (0 if without_kept else len(kept)):
            raise SolveFailedError("the Laplacian is singular: a vertex is in no face, or is to be kept twice")
        self.weights = corner_weights(vertices, self.faces, mollification)
        if not np.isfinite(self.weights).all():
            raise SolveFailedError("the Laplacian has entries that are not finite: a face has zero area")
        self.is_kept = keeps is None or keeps(8 * tree.factor_size)
        self.factor = np.empty(tree.factor_size if self.is_kept else 0)
        self.stack = np.empty(tree.stack_size)
        self.first, self.starts, self.others, self.position = tree.first, tree.starts, tree.others, tree.position
        plan = tree.order, tree.depth, tree.children, tree.leaf, tree.first, tree.position, tree.starts, tree.others
        count_in = int(tree.first[-1]) if without_kept else len(vertices)
        fronts = np.empty((2, tree.widest * padded(tree.widest)))
        if not _factor(self.faces, self.weights, *plan, count_in, self.factor, self.stack, fronts):
            raise SolveFailedError(
                f"the elimination of a Laplacian of {len(vertices)} vertices met a pivot that is not positive"
            )


class NestedSolver:
    """Discrete harmonic functions of a mesh, given at ``kept`` (n_K,): the second pass alone, without a Schur complement.

    order (F,): the ``order`` of a factor of the same mesh, which saves time.
    """

    def __init__(
        self,
        vertices: FloatArray,
        faces: IntArray,
        kept: IntArray,
        mollification: float = 0.0,
        order: IntArray | None = None,
    ) -> None:
        e = _Elimination(vertices, faces, kept, mollification, without_kept=True, order=order)
        e.stack = np.empty(0)
        self._elimination = e
        self.nbytes = sum(a.nbytes for a in (e.factor, e.faces, e.weights, e.first, e.starts, e.others, e.position, e.order))

    def extend(self, boundary_values: ComplexArray) -> ComplexArray:
        """Discrete harmonic extension; see DirichletFactor."""
        e = self._elimination
        x = _load_of(e.faces, e.weights, e.position, _apart(boundary_values), int(e.first[-1]))
        substitute_forward(e.factor, e.first, e.starts, e.others, x)
        substitute_back(e.factor, e.first, e.starts, e.others, x)
        solved = np.concatenate([_together(x), boundary_values])
        out: ComplexArray = solved[e.position]
        return out

    def release(self) -> None:
        """Free the factor's memory."""
        self._elimination.factor = np.empty(0)


class NestedFactor:
    """The cotangent Laplacian of a mesh with all but the kept vertices eliminated; see DirichletFactor.

    vertices (n, 3), faces (F, 3), kept (n_K,); ``order`` (F,) is how the faces were dissected. keeps(bytes) is asked whether
    the factor is to be kept: without it there is the Schur complement and no more. Raises SolveFailedError where rounding
    leaves no positive pivot, or a vertex is in no face.
    """

    def __init__(
        self,
        vertices: FloatArray,
        faces: IntArray,
        kept: IntArray,
        mollification: float = 0.0,
        keeps: Callable[[int], bool] | None = None,
    ) -> None:
        e = _Elimination(vertices, faces, kept, mollification, without_kept=False, keeps=keeps)
        count = len(kept)
        self.order = e.order
        self.is_whole = e.is_kept
        self._factor, self._first, self._starts, self._others = e.factor, e.first, e.starts, e.others
        self._position, self._kept = e.position, np.array(kept)
        self.schur: FloatArray = _mirrored(e.stack, count)
        held = (self._factor, self.schur, self._first, self._starts, self._others, self._position)
        self.nbytes = sum(array.nbytes for array in held)

    def extend(self, boundary_values: ComplexArray) -> ComplexArray:
        """Discrete harmonic extension; see DirichletFactor."""
        return self._solved(np.zeros((2, len(self._position))), boundary_values)

    def solve(self, load: ComplexArray, boundary_values: ComplexArray) -> ComplexArray:
        """Interior values under a load; see DirichletFactor."""
        return self._solved(self._reduced(load), boundary_values)

    def reduce(self, load: ComplexArray) -> ComplexArray:
        """Load on the boundary in place of a load on the whole; see DirichletFactor."""
        return _together(self._reduced(load)[:, self._first[-1] :])

    def _reduced(self, load: ComplexArray) -> FloatArray:
        x = np.empty((2, len(load)))
        x[:, self._position] = _apart(load)
        substitute_forward(self._factor, self._first, self._starts, self._others, x)
        return x

    def _solved(self, x: FloatArray, boundary_values: ComplexArray) -> ComplexArray:
        x[:, self._first[-1] :] = _apart(boundary_values)
        substitute_back(self._factor, self._first, self._starts, self._others, x)
        out: ComplexArray = _together(x)[self._position]
        out[self._kept] = boundary_values
        return out

    def release(self) -> None:
        """Free the factor's memory."""
        self._factor = np.empty(0)
