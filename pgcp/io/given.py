"""What the input held beside vertices and triangles, in the numbers of a finished map: ready to be written."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pgcp.polygons.together import Polygons, polygons_of
from pgcp.types import Columns, FloatArray, IntArray, Origin, Source

COLOURS = ("red", "green", "blue")
_NORMALS = ("nx", "ny", "nz")


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


def vertex_normals(given: GivenParts) -> FloatArray | None:
    """Unit normals (V, 3) that the file has at vertices; None where it has none, or several at a vertex that a face uses."""
    columns = given.of_vertices
    count = len(given.vertex_of)
    if set(_NORMALS) <= set(columns):
        normals = np.column_stack([columns[name] for name in _NORMALS]).astype(np.float64)
    elif given.source.normals is not None and given.source.normal_of is not None:
        flat, number = given.faces.reshape(-1), given.source.normal_of[given.corner_of.reshape(-1)]
        of_vertex = np.full(count, -1)
        of_vertex[flat] = number
        if (of_vertex[flat] != number).any():
            return None
        normals = np.where((of_vertex >= 0)[:, None], given.source.normals[of_vertex], [0.0, 0.0, 1.0])
    else:
        return None
    length = np.linalg.norm(normals, axis=1)
    return normals / length[:, None] if (length > 0.0).all() else None


def materials_of(given: GivenParts) -> tuple[list[dict[str, Any]], IntArray]:
    """Materials as glTF has them, and which of them each triangle (F,) has, -1 for none."""
    source = given.source
    if source.material_of is not None:
        return list(source.materials), source.material_of[given.polygon_of]
    names: dict[str, int] = {}
    places, numbers = [-1], [-1]
    for place, line in source.marks:
        word, _, name = line.partition(b" ")
        if word == b"usemtl":
            places.append(place)
            numbers.append(names.setdefault(name.decode("utf-8", "replace"), len(names)))
    colours = _diffuse(source)
    plain = {"metallicFactor": 0.0, "roughnessFactor": 0.9}
    found: list[dict[str, Any]] = [
        {"name": name, "pbrMetallicRoughness": {**plain, **({"baseColorFactor": colours[name]} if name in colours else {})}}
        for name in names
    ]
    return found, np.array(numbers)[np.searchsorted(places, given.polygon_of, "right") - 1]


def _diffuse(source: Source) -> dict[str, list[float]]:
    """Diffuse colours (red, green, blue, alpha) of the materials in material files, by name."""
    out: dict[str, list[float]] = {}
    for data in source.libraries.values():
        name = ""
        for line in data.decode("utf-8", "replace").splitlines():
            words = line.split()
            if words[:1] == ["newmtl"]:
                name = line.strip()[6:].strip()
            elif words[:1] in (["Kd"], ["d"]) and name:
                with suppress(ValueError, OverflowError):
                    values = [min(max(float(word), 0.0), 1.0) for word in words[1:4]]
                    colour = out.setdefault(name, [1.0, 1.0, 1.0, 1.0])
                    if words[0] == "Kd" and len(values) == 3 and all(map(np.isfinite, values)):
                        colour[:3] = values
                    elif words[0] == "d" and len(values) == 1 and np.isfinite(values[0]):
                        colour[3] = values[0]
    return out


def as_unit(colours: Columns) -> FloatArray:
    """Colours (V, 3) from 0 to 1, of columns of whole numbers up to 255 or of numbers up to 1."""
    values = np.column_stack([colours[name] for name in COLOURS])
    return np.asarray(values / 255.0 if values.dtype.kind in "iu" else np.clip(values, 0.0, 1.0), np.float64)


def has_colours(columns: Columns) -> bool:
    """Whether there are colours among values by vertex."""
    return set(COLOURS) <= set(columns)
