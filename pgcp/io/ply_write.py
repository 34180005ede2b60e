"""PLY files, written in binary: the surface with the map at its vertices, on the input's polygons, with its properties."""

from __future__ import annotations

from typing import IO, Any

import numpy as np

from pgcp.io.formats import Arrays
from pgcp.io.given import COLOURS, GivenParts, as_unit, has_colours
from pgcp.io.text import CHUNK
from pgcp.types import Columns, FloatArray, IntArray

# vertex properties: where their values come from, their names and their type
WRITTEN: dict[str, tuple[str, tuple[str, ...]]] = {
    "vertices": ("<f8", ("x", "y", "z")), "uv": ("<f4", ("s", "t")), "sphere": ("<f8", ("sx", "sy", "sz")),
}  # fmt: skip
# properties of an input that say where it lies on a texture, as the map does now
_OF_TEXTURES = {"s", "t", "u", "v", "texture_u", "texture_v", "sx", "sy", "sz"}
_NAMES = {
    "i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint", "f4": "float", "f8": "double",
}  # fmt: skip
_Column = tuple[str, str, np.ndarray[Any, Any]]  # name, type and values


def write_ply(stream: IO[bytes], arrays: Arrays) -> None:
    """Write a binary PLY file; uv become ``s, t``, coordinates on the sphere ``sx, sy, sz``.

    Vertices are written in single precision where that is exact. s and t are floats, or doubles where the arrays have a key
    "in_doubles". With "given" faces are the polygons of the input, and its further properties stand after those of the map.
    """
    given: GivenParts | None = arrays.get("given")
    single = {"vertices": "<f4"} if _are_single(arrays["vertices"]) else {}
    columns: list[_Column] = [
        (name, single.get(source, "<f8" if "in_doubles" in arrays else kind), arrays[source][:, axis])
        for source, (kind, names) in WRITTEN.items()
        if source in arrays
        for axis, name in enumerate(names)
    ]
    by_face: list[_Column] = []
    if given is not None:
        columns += _further(given.of_vertices)
        of_polygon = given.polygons.polygon_of
        by_face = _further({name: values[of_polygon] for name, values in given.source.of_polygons.items()})
    has_polygons = given is not None and given.has_polygons
    offsets = given.polygons.offsets if given is not None and has_polygons else None
    corners = arrays["faces"].reshape(-1)
    corners = corners[given.polygons.corner_at] if given is not None and has_polygons else corners
    count = len(corners) // 3 if offsets is None else len(offsets) - 1
    wide = offsets is not None and len(offsets) > 1 and int(np.diff(offsets).max()) > np.iinfo(np.uint8).max
    size_kind = "<u4" if wide else "u1"
    stream.write(_header(len(arrays["vertices"]), count, columns, by_face, size_kind))
    for start in range(0, len(arrays["vertices"]), CHUNK):
        stream.write(_rows(columns, slice(start, min(start + CHUNK, len(arrays["vertices"])))))
    for start in range(0, count, CHUNK):
        some = slice(start, min(start + CHUNK, count))
        ends = 3 * np.arange(some.start, some.stop + 1) if offsets is None else offsets[some.start : some.stop + 1]
        stream.write(_faces(corners[ends[0] : ends[-1]], ends - ends[0], by_face, some, size_kind))


def _further(values: Columns) -> list[_Column]:
    """Further properties of an input; colours are whole numbers up to 255."""
    out = {name: column for name, column in values.items() if name not in _OF_TEXTURES}
    if has_colours(out) and out["red"].dtype.kind == "f":
        out |= dict(zip(COLOURS, np.rint(255.0 * as_unit(out)).astype(np.uint8).T, strict=True))
    return [(name, column.dtype.newbyteorder("<").str.replace("|", ""), column) for name, column in out.items()]


def _header(vertices: int, faces: int, columns: list[_Column], by_face: list[_Column], size_kind: str) -> bytes:
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {vertices}"]
    header += [f"property {_NAMES[kind[-2:]]} {name}" for name, kind, _ in columns]
    header += [f"element face {faces}", f"property list {_NAMES[size_kind[-2:]]} int vertex_indices"]
    header += [f"property {_NAMES[kind[-2:]]} {name}" for name, kind, _ in by_face]
    return "\n".join([*header, "end_header", ""]).encode()


def _rows(columns: list[_Column], some: slice) -> memoryview:
    """Rows of values."""
    rows = np.empty(some.stop - some.start, [(name, kind) for name, kind, _ in columns])
    for name, _, values in columns:
        rows[name] = values[some]
    return rows.view(np.uint8).data


def _faces(corners: IntArray, offsets: IntArray, by_face: list[_Column], some: slice, size_kind: str) -> bytes | memoryview:
    """Rows of faces of corners (C,), one after the other; offsets (P + 1,): where each begins."""
    sizes = np.diff(offsets)
    extra = [(name, kind) for name, kind, _ in by_face]
    spare = sum(np.dtype(kind).itemsize for _, kind in extra)
    lengths = np.dtype(size_kind).itemsize + 4 * sizes + spare
    ends = np.cumsum(lengths)
    out = np.empty(int(ends[-1]), np.uint8)
    for size in np.unique(sizes).tolist():
        those = np.flatnonzero(sizes == size)
        rows = np.empty(len(those), [("#", size_kind), ("@", "<i4", (size,)), *extra])
        rows["#"] = size
        alike = len(those) == len(sizes)
        rows["@"] = corners.reshape(-1, size) if alike else corners[offsets[those][:, None] + np.arange(size)]
        for name, _, values in by_face:
            rows[name] = values[some][those]
        flat = rows.view(np.uint8)
        if alike:
            return flat.data
        length = rows.dtype.itemsize
        out[(ends[those] - length)[:, None] + np.arange(length)] = flat.reshape(-1, length)
    return out.data


def _are_single(points: FloatArray) -> bool:
    """Whether all coordinates are numbers of single precision."""
    chunks = (points[start : start + CHUNK] for start in range(0, len(points), CHUNK))
    with np.errstate(over="ignore"):
        return all(np.array_equal(chunk, chunk.astype(np.float32)) for chunk in chunks)
