"""An embedding of any open disk into the unit disk that hardly shrinks anything: weights taken from a drawing on a grid.

The boundary is joined to the three corners of a triangle around it, and all is drawn on a grid (``grid_coordinates``, Schnyder
1990). Seen from there every inner vertex is a mean of its neighbours, with positive weights (mean value coordinates, Floater
2003). With these weights, and the boundary moved to equal steps on the circle, the harmonic map folds nothing (Floater 2003),
and stays near the drawing: whatever the surface's shape, parts shrink with the square of the number of faces at most. Weights
that do not know of a drawing shrink a long limb exponentially.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from pgcp.errors import SolveFailedError
from pgcp.folds.grid import grid_coordinates
from pgcp.types import ComplexArray, FloatArray, IntArray


def _closed_off(faces: IntArray, vertex_count: int, boundary: IntArray) -> IntArray:
    """Faces of the disk and of what closes it: three more vertices, each joined to a third of the boundary. The lid is last."""
    n = len(boundary)
    ends = np.arange(1, 4) * n // 3
    owner = vertex_count + np.searchsorted(ends, np.arange(n), side="right")  # of the edge from each boundary vertex
    sides = np.column_stack([np.roll(boundary, -1), boundary, owner])
    corner = vertex_count + np.arange(3)
    gaps = np.column_stack([boundary[ends % n], corner, np.roll(corner, -1)])
    return np.concatenate([faces, sides, gaps, [corner[[0, 2, 1]]]])


def _mean_values(faces: IntArray, z: ComplexArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Mean value weights of a drawing z (V,), as rows, columns and values: of each vertex, those of its neighbours."""
    rows, columns, values = [], [], []
    for k in range(3):
        a, b, c = faces[:, k], faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        u, v = z[b] - z[a], z[c] - z[a]
        product = np.conj(u) * v
        half = product.imag / (np.abs(u) * np.abs(v) + product.real)  # tangent of half the angle
        rows += [a, a]
        columns += [b, c]
        values += [half / np.abs(u), half / np.abs(v)]
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(values)


def grid_disk(faces: IntArray, vertex_count: int, boundary: IntArray) -> ComplexArray:
    """Positions (V,) in the unit disk of an embedding without folds, the boundary (n,) counter-clockwise in equal steps.

    Every vertex is used by a face. Raises SolveFailedError where two edges join the same vertices, or the solve fails.
    """
    closed = _closed_off(faces, vertex_count, boundary)
    share = grid_coordinates(closed, vertex_count + 3, len(closed) - 1)[:vertex_count] / (len(closed) - 1)
    drawing = share @ np.exp(2j * np.pi * np.arange(3) / 3)
    rows, columns, values = _mean_values(faces, drawing)
    out = np.zeros(vertex_count, np.complex128)
    out[boundary] = np.exp(2j * np.pi * np.arange(len(boundary)) / len(boundary))
    number = np.full(vertex_count, -1)
    inner = np.setdiff1d(np.arange(vertex_count), boundary)
    if len(inner) == 0:
        return out
    number[inner] = np.arange(len(inner))
    wanted = number[rows] >= 0
    rows, columns, values = number[rows[wanted]], columns[wanted], values[wanted]
    values = values / np.bincount(rows, values, len(inner))[rows]
    held = number[columns] < 0
    right = np.zeros(len(inner), np.complex128)
    np.add.at(right, rows[held], values[held] * out[columns[held]])
    size = (len(inner), len(inner))
    means = csc_array(coo_array((values[~held], (rows[~held], number[columns[~held]])), size))
    matrix = csc_array(coo_array((np.ones(len(inner)), (np.arange(len(inner)), np.arange(len(inner)))), size) - means)
    try:
        factor = splu(matrix, "COLAMD", diag_pivot_thresh=0.0)
    except RuntimeError as problem:
        raise SolveFailedError(f"the embedding of {vertex_count} vertices could not be solved: {problem}") from problem
    found = np.zeros(len(inner), np.complex128)
    for _ in range(3):
        rest = right - (found - means @ found)
        found = found + factor.solve(rest.real) + 1j * factor.solve(rest.imag)
    out[inner] = found
    return out
