"""What the input held beside vertices and triangles, in the numbers of a finished map: ready to be written."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgcp.polygons.together import Polygons, polygons_of
from pgcp.types import Columns, FloatArray, IntArray, Origin, Source

COLOURS = ("red", "green", "blue")


@dataclass(frozen=True, eq=False)
class GivenParts:
    """What a file held beside its triangles, for a map of V vertices and F triangles.

    source: the file; vertex_of (V,): its vertices; corner_of (F, 3): its corners; faces (F, 3): the map's triangles.
    """

    source: Source
    vertex_of: IntArray
    corner_of: IntArray
    faces: IntArray

    @cached_property
    def polygons(self) -> Polygons:
        """The polygons that the triangles make, triangles where the file has nothing else."""
        if self.source.offsets is not None:
            return polygons_of(self.faces, self.corner_of, self.source.offsets)
        count = len(self.faces)
        return Polygons(3 * np.arange(count + 1), np.arange(3 * count), self.corner_of[:, 0] // 3)

    @property
    def has_polygons(self) -> bool:
        """Whether some face of the file is no triangle."""
        return self.source.offsets is not None

    @cached_property
    def polygon_of(self) -> IntArray:
        """The file's polygon (F,) of every triangle."""
        first = self.corner_of[:, 0]
        return first // 3 if self.source.offsets is None else np.searchsorted(self.source.offsets, first, "right") - 1

    @cached_property
    def of_vertices(self) -> Columns:
        """The file's values by vertex (V, ...)."""
        return {name: values[self.vertex_of] for name, values in self.source.of_vertices.items()}

    @property
    def of_triangles(self) -> Columns:
        """The file's values by polygon, for every triangle (F, ...)."""
        return {name: values[self.polygon_of] for name, values in self.source.of_polygons.items()}

    def with_copies(self, copies: IntArray, faces: IntArray) -> GivenParts:
        """The same where vertices ``copies`` are repeated after all others, and faces (F, 3) use them."""
        return GivenParts(self.source, np.concatenate([self.vertex_of, self.vertex_of[copies]]), self.corner_of, faces)


def given_parts(origin: Origin | None, faces: IntArray) -> GivenParts | None:
    """What the input of a map with these faces held, None where there was nothing but triangles."""
    if origin is None or origin.source is None:
        return None
    corner_of = np.arange(faces.size).reshape(-1, 3) if origin.corner_of is None else origin.corner_of
    return GivenParts(origin.source, origin.vertex_of, corner_of, faces)


def as_unit(colours: Columns) -> FloatArray:
    """Colours (V, 3) from 0 to 1, of columns of whole numbers up to 255 or of numbers up to 1."""
    values = np.column_stack([colours[name] for name in COLOURS])
    return np.asarray(values / 255.0 if values.dtype.kind in "iu" else np.clip(values, 0.0, 1.0), np.float64)


def has_colours(columns: Columns) -> bool:
    """Whether there are colours among values by vertex."""
    return set(COLOURS) <= set(columns)
