"""What glTF files say beside triangles: names of nodes and meshes, materials, colours and normals of vertices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgcp.io.given import COLOURS
from pgcp.types import Columns, FloatArray, IntArray, Source

_LIBRARY, _NONE = "materials.mtl", "none"  # the material of faces without one


@dataclass(frozen=True, slots=True)
class Block:
    """Faces of one primitive: how many, the names of its node and its mesh, and its material, -1 for none."""

    count: int
    names: tuple[str, str]
    material: int


def name_of(item: Any, otherwise: str) -> str:
    """The name of a node, a mesh or a material, in one line."""
    name = item.get("name") if isinstance(item, dict) else None
    return " ".join(name.split()) or otherwise if isinstance(name, str) else otherwise


def without_pictures(material: Any, number: int) -> dict[str, Any]:
    """A material without its pictures, which lie on other texture coordinates, and without extensions, which may have some."""
    kept: dict[str, Any] = {"name": name_of(material, f"material {number}")}
    for key in ("emissiveFactor", "alphaMode", "alphaCutoff", "doubleSided"):
        if isinstance(material, dict) and key in material:
            kept[key] = material[key]
    surface = material.get("pbrMetallicRoughness") if isinstance(material, dict) else None
    if isinstance(surface, dict):
        factors = {key: surface[key] for key in ("baseColorFactor", "metallicFactor", "roughnessFactor") if key in surface}
        kept["pbrMetallicRoughness"] = factors
    return kept


def source_of(
    vertices: FloatArray,
    faces: IntArray,
    blocks: Sequence[Block],
    materials: Sequence[Any],
    colours: Sequence[tuple[int, int, FloatArray]],
    normals: Sequence[tuple[int, int, FloatArray]],
) -> Source:
    """A source of triangles; colours (n, 3) and normals (n, 3) of vertices from a number to before another."""
    counts = [block.count for block in blocks]
    names: dict[str, int] = {}
    rows = [[names.setdefault(name, len(names)) if name else -1 for name in block.names] for block in blocks]
    part_of = np.repeat(np.array(rows, np.int64), counts, axis=0)
    material_of = np.repeat([block.material for block in blocks], counts)
    kept = tuple(without_pictures(material, number) for number, material in enumerate(materials))
    has_material = bool((material_of >= 0).any())
    of_vertices: Columns = {}
    if colours:
        painted = np.ones((len(vertices), 3))
        for begin, end, values in colours:
            painted[begin:end] = values
        of_vertices = dict(zip(COLOURS, painted.T, strict=True))
    whole = np.full((len(vertices), 3), np.nan)
    for begin, end, values in normals:
        whole[begin:end] = values
    has_normals = bool(np.isfinite(whole).all())
    return Source(
        vertices, faces.reshape(-1), None, tuple(names), part_of if names else None, of_vertices,
        marks=_marks(blocks, kept), libraries={_LIBRARY: _library(kept)} if has_material else {},
        normals=whole if has_normals else None, normal_of=faces.reshape(-1) if has_normals else None,
        materials=kept if has_material else (), material_of=material_of if has_material else None,
    )  # fmt: skip


def _marks(blocks: Sequence[Block], materials: Sequence[dict[str, Any]]) -> tuple[tuple[int, bytes], ...]:
    """Objects and materials as statements of an OBJ file."""
    marks: list[tuple[int, bytes]] = []
    if any(block.material >= 0 for block in blocks):
        marks.append((0, f"mtllib {_LIBRARY}".encode()))
    first, name, material = 0, "", -1
    for block in blocks:
        if block.names[0] and block.names[0] != name:
            name = block.names[0]
            marks.append((first, f"o {name}".encode("utf-8", "replace")))
        if block.material != material:
            material = block.material
            name_now = materials[material]["name"] if material >= 0 else _NONE
            marks.append((first, f"usemtl {name_now}".encode("utf-8", "replace")))
        first += block.count
    return tuple(marks)


def _library(materials: Sequence[dict[str, Any]]) -> bytes:
    """Materials as a file beside an OBJ file."""
    lines = []
    for material in (*materials, {"name": _NONE}):
        colour = material.get("pbrMetallicRoughness", {}).get("baseColorFactor")
        good = isinstance(colour, list) and len(colour) == 4 and all(isinstance(c, (int, float)) for c in colour)
        red, green, blue, alpha = colour if good else (1.0, 1.0, 1.0, 1.0)
        lines += [f"newmtl {material['name']}", f"Kd {red:g} {green:g} {blue:g}", f"d {alpha:g}", ""]
    return "\n".join(lines).encode("utf-8", "replace")
