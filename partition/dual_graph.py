"""The graph of faces that share an edge, and the walk around a vertex that everything local needs.

A half-edge ``h = 3 f + i`` runs from ``faces[f, i]`` to ``faces[f, (i + 1) % 3]``; ``twins[h]`` is the half-edge on
the other side, or -1 on the surface's boundary. The mesh is assumed manifold and consistently oriented.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

IntArray = npt.NDArray[np.integer[Any]]
FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
AtOnce = Callable[..., list[Any]]  # calls functions in any order, or at the same time; returns what they return


def in_turn(*functions: Callable[[], Any]) -> list[Any]:
    """Call functions one after the other."""
    return [function() for function in functions]


@numba.njit(cache=True, nogil=True)
def edge_lengths(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Length of every half-edge (3F,)."""
    out = np.empty(3 * faces.shape[0])
    for f in range(faces.shape[0]):
        for i in range(3):
            a, b = faces[f, i], faces[f, (i + 1) % 3]
            dx = vertices[a, 0] - vertices[b, 0]
            dy = vertices[a, 1] - vertices[b, 1]
            dz = vertices[a, 2] - vertices[b, 2]
            out[3 * f + i] = np.sqrt(dx * dx + dy * dy + dz * dz)
    return out


@numba.njit(cache=True, nogil=True)
def vertex_starts(faces: IntArray, twins: IntArray, vertex_count: int) -> IntArray:
    """One outgoing half-edge per vertex (V,): the boundary one where there is one, -1 for unused vertices."""
    start = np.full(vertex_count, -1, np.int64)
    for h in range(twins.shape[0]):
        v = faces[h // 3, h % 3]
        if start[v] < 0 or twins[h] < 0:
            start[v] = h
    return start


@numba.njit(cache=True, nogil=True)
def _dual(twins: IntArray, lengths: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    face_count = twins.shape[0] // 3
    indptr = np.zeros(face_count + 1, np.int32)
    for h in range(twins.shape[0]):
        if twins[h] >= 0:
            indptr[h // 3 + 1] += 1
    for f in range(face_count):
        indptr[f + 1] += indptr[f]
    indices = np.empty(indptr[-1], np.int32)
    weights = np.empty(indptr[-1])
    n = 0
    for h in range(twins.shape[0]):
        if twins[h] >= 0:
            indices[n] = twins[h] // 3
            weights[n] = lengths[h]
            n += 1
    return indptr, indices, weights


def dual_graph(twins: IntArray, lengths: FloatArray) -> csr_array:
    """Dual graph (F, F) in CSR; the weight of an entry is the length of the shared edge."""
    indptr, indices, weights = _dual(twins, lengths)
    face_count = len(twins) // 3
    return csr_array((weights, indices, indptr), shape=(face_count, face_count))


@numba.njit(cache=True, nogil=True)
def _components(twins: IntArray, labels: IntArray) -> tuple[int, IntArray]:
    face_count = labels.shape[0]
    component = np.full(face_count, -1, np.int32)
    work = np.empty(face_count, np.int32)
    count = 0
    for seed in range(face_count):
        if component[seed] >= 0:
            continue
        component[seed], work[0], waiting = count, seed, 1
        while waiting > 0:
            waiting -= 1
            f = work[waiting]
            for i in range(3):
                twin = twins[3 * f + i]
                if twin >= 0 and component[twin // 3] < 0 and labels[twin // 3] == labels[f]:
                    component[twin // 3], work[waiting] = count, twin // 3
                    waiting += 1
        count += 1
    return count, component


def label_components(twins: IntArray, labels: IntArray) -> tuple[int, IntArray]:
    """Connected components of faces that share an edge and a label: count, component (F,), numbered by their first faces."""
    count, component = _components(twins, labels)
    return int(count), component


@numba.njit(cache=True, nogil=True)
def seam_half_edges(twins: IntArray, labels: IntArray) -> IntArray:
    """Half-edges between faces of different labels, the lower of each two, increasing."""
    found = [0 for _ in range(0)]
    for h in range(twins.shape[0]):
        if twins[h] > h and labels[h // 3] != labels[twins[h] // 3]:
            found.append(h)
    return np.array(found) if len(found) > 0 else np.empty(0, np.int64)
