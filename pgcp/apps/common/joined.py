"""The surface of a map as one piece: vertices that seams have split joined, those that no face uses left out."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pgcp.errors import InputError
from pgcp.result import Result
from pgcp.types import FloatArray, IntArray


class Joined(NamedTuple):
    """A mapped surface without split or unused vertices.

    vertices (n, 3), faces (F, 3), image (n, 2) or (n, 3): coordinates of the map; number (V,): of each of the result's
    vertices, -1 where no face uses it; first (n,): one of the result's vertices of each.
    """

    vertices: FloatArray
    faces: IntArray
    image: FloatArray
    number: IntArray
    first: IntArray

    def given_back(self, values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        """Values (..., V) of those (..., n), 0 where no face uses a vertex."""
        return np.where(self.number >= 0, values[..., self.number], 0)


def joined(result: Result) -> Joined:
    """The surface of a map as one piece; raises InputError where several components were mapped."""
    if result.origin is not None and result.origin.component_of is not None:
        raise InputError("this takes the map of one component; --component all has mapped several")
    count = len(result.mesh.vertices)
    point_of = np.arange(count) if result.origin is None else result.origin.point_of
    used = np.zeros(int(point_of.max()) + 1, bool)
    used[point_of[result.faces.reshape(-1)]] = True
    place = np.where(used, np.cumsum(used) - 1, -1)
    number = place[point_of]
    first = np.full(int(used.sum()), -1, np.int64)
    corners = result.faces.reshape(-1)[::-1]
    first[number[corners]] = corners
    return Joined(result.mesh.vertices[first], number[result.faces].astype(np.int32), result.coordinates[first], number, first)
