"""Put the maps of all patches together into one, at the surface's scale."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial

import numba
import numpy as np

from pgcp.parallel import at_once
from pgcp.patches.types import PatchMap
from pgcp.plane.space import Space
from pgcp.types import ComplexArray, FloatArray, IntArray, Mesh, Positions


@numba.njit(cache=True, nogil=True)
def _scatter(ids: IntArray, values: FloatArray, out: FloatArray) -> None:
    """Rows (n, k) of values to rows ids (n,) of out."""
    for i in range(ids.shape[0]):
        for d in range(values.shape[1]):
            out[ids[i], d] = values[i, d]


def _rows(values: Positions) -> FloatArray:
    """The same numbers (n, k), real and imaginary parts apart."""
    return values.view(np.float64).reshape(len(values), -1)


def collect(
    mesh: Mesh, shares: Sequence[Iterable[tuple[IntArray, IntArray, PatchMap]]], space: Space
) -> tuple[Positions, ComplexArray]:
    """One array of positions, complex (V,) or unit vectors (V, 3), and one of Beltrami coefficients mu (F,).

    shares: in each, for some patches, vertex_ids and face_ids in the mesh, and its map; they are taken at the same time.
    Vertices on seams have the same position in every patch that holds them. Vertices used by no face are at 0, on the sphere
    at the north pole.
    """
    points = space.origin(len(mesh.vertices))
    mu = np.zeros(len(mesh.faces), np.complex128)

    def put(share: Iterable[tuple[IntArray, IntArray, PatchMap]]) -> None:
        """Take the maps of one share."""
        for vertex_ids, face_ids, solved in share:
            _scatter(vertex_ids, _rows(solved.points), _rows(points))
            _scatter(face_ids, _rows(solved.mu), _rows(mu))

    at_once(*(partial(put, share) for share in shares))
    return points, mu
