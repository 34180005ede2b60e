"""What a file held, as it was, and the way back to it from a finished map. Nothing here computes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pgcp.types import FloatArray, IntArray

Columns = Mapping[str, np.ndarray[Any, Any]]


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A surface of polygons, with what a file says of it beside places and corners.

    vertices (V, 3) float64; corners (C,) vertices of all polygons, one polygon after the other; offsets (P + 1,): where each
    begins, None where all have three corners. part_of (P,): which of the ``parts``, the names of objects, groups or nodes, each
    polygon belongs to, -1 for none.
    of_vertices, of_polygons: further values (V, ...) and (P, ...) by name, in the types the file has them in; of a PLY file
    under the names of its properties. marks: statements of an OBJ file that stand before a polygon, as numbers of polygons and
    lines without their ends (``o``, ``g``, ``s``, ``usemtl``; ``mtllib`` before the first).
    normals (N, 3), normal_of (C,): normals by corner, -1 for none. materials: glTF materials as the file has them; material_of
    (P,): which of these, -1 for none. notes: what was said of polygons, as in the report.
    """

    vertices: FloatArray
    corners: IntArray
    offsets: IntArray | None = None
    parts: tuple[str, ...] = ()
    part_of: IntArray | None = None
    of_vertices: Columns = field(default_factory=dict)
    of_polygons: Columns = field(default_factory=dict)
    marks: tuple[tuple[int, bytes], ...] = ()
    normals: FloatArray | None = None
    normal_of: IntArray | None = None
    materials: tuple[dict[str, Any], ...] = ()
    material_of: IntArray | None = None
    name: str = "mesh"

    @property
    def polygon_count(self) -> int:
        """How many polygons there are."""
        return len(self.corners) // 3 if self.offsets is None else len(self.offsets) - 1

    @property
    def sizes(self) -> IntArray:
        """Numbers of corners (P,)."""
        return np.full(self.polygon_count, 3) if self.offsets is None else np.diff(self.offsets)


@dataclass(frozen=True, slots=True, eq=False)
class Origin:
    """Where a finished map's vertices and faces come from.

    point_of (V,): vertices of the same number are one point of the surface, split in the input; vertex_of (V,): the input's
    vertex; corner_of (F, 3): the corner of the source that each corner of a face is, None where faces are the source's
    triangles and all of them are there, in order. source: None where the file held nothing but vertices and triangles.
    """

    point_of: IntArray
    vertex_of: IntArray
    corner_of: IntArray | None = None
    source: Source | None = None
