"""PLY files: ascii, and binary of either byte order. The header is not believed before the data are seen to be there."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import IO

import numpy as np

from pgcp.errors import BadFileError
from pgcp.io.formats import Arrays, Beside, Format, register
from pgcp.io.text import CHUNK, RowReader, as_text, joined, not_a_number, not_triangles, parse, shown, table, whole, widths
from pgcp.types import FloatArray, IntArray

_KINDS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_STRUCT = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I"}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MOST_PROPERTIES = 1000
_RUN = 1024  # rows of lists of changing length that are read one by one at a time
_MOST_AHEAD = 1 << 22  # rows of one shape that are read at once
_LARGEST_ROW = 1 << 20
# vertex properties of a file that is written: where their values come from, their names and their type
_WRITTEN: dict[str, tuple[str, tuple[str, ...]]] = {
    "vertices": ("<f8", ("x", "y", "z")), "uv": ("<f4", ("s", "t")), "sphere": ("<f8", ("sx", "sy", "sz")),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Property:
    name: str
    kind: str
    count_kind: str | None


@dataclass(slots=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]

    @property
    def has_lists(self) -> bool:
        """Whether rows differ in size."""
        return any(p.count_kind for p in self.properties)

    @property
    def least_bytes(self) -> int:
        """Bytes of a binary row whose lists are empty."""
        return sum(np.dtype(p.count_kind or p.kind).itemsize for p in self.properties)


def read_ply(data: bytes, _beside: Beside) -> tuple[FloatArray, IntArray]:
    """Vertices (V, 3) and faces (F, 3) of a PLY file; raises BadFileError saying what is wrong and where."""
    order, elements, start, lines = _header(data)
    by_name = {element.name: element for element in elements}
    for name in ("vertex", "face"):
        if name not in by_name:
            raise BadFileError(f"the PLY has no {name} element, so no surface")
    lists = [p.name for p in by_name["face"].properties if p.count_kind]
    wanted = next((name for name in ("vertex_indices", "vertex_index") if name in lists), None)
    if wanted is None:
        raise BadFileError("the PLY's face element has no list vertex_indices")
    scalars = [p.name for p in by_name["vertex"].properties if not p.count_kind]
    if not {"x", "y", "z"} <= set(scalars):
        raise BadFileError("the PLY's vertices have no x, y, z")
    if len(scalars) < len(by_name["vertex"].properties):
        raise BadFileError("the PLY's vertices have a list property, which is not supported")
    if order:
        return _read_binary(data, start, elements, order, wanted)
    return _read_ascii(as_text(data[start:]), lines + 1, elements, wanted)


def _header(data: bytes) -> tuple[str, list[_Element], int, int]:
    """Byte order, elements, where the data begin, and the number of header lines."""
    first = re.match(rb"ply[ \t]*(\r\n|\n|\r)", data)
    if first is None:
        raise BadFileError(f"it does not begin with the line 'ply' but with {shown(data[:20])}")
    end = first[1]
    last = re.compile(rb"%b[ \t]*end_header[ \t]*(?:%b|\Z)" % (end, end)).search(data, first.start(1))
    if last is None:
        raise BadFileError("the PLY header has no end: there is no line 'end_header'")
    lines = data[: last.start()].split(end)
    order, elements = None, list[_Element]()
    for number, line in enumerate(lines[1:], 2):
        words = line.decode("utf-8", "backslashreplace").split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) >= 2 and words[1] in _ORDERS:
            order = _ORDERS[words[1]]
        elif words[0] == "element" and len(words) == 3 and words[2].isascii() and words[2].isdigit() and len(words[2]) < 19:
            elements.append(_Element(words[1], int(words[2]), []))
        elif words[0] == "property" and elements and (found := _property(words)):
            elements[-1].properties.append(found)
            if len(elements[-1].properties) > _MOST_PROPERTIES:
                raise BadFileError(f"line {number}: the element {words[1]} has more than {_MOST_PROPERTIES} properties")
        else:
            raise BadFileError(f"line {number}: not a line of a PLY header: {shown(line)}")
    if order is None:
        raise BadFileError("the PLY header has no format line")
    names = [element.name for element in elements]
    if len(set(names)) < len(names):
        raise BadFileError("the PLY header has two elements of one name")
    bare = next((element for element in elements if element.count and not element.properties), None)
    if bare is not None:
        raise BadFileError(f"the PLY's element {shown(bare.name.encode())} has no properties")
    return order, elements, last.end(), len(lines) + 1


def _property(words: list[str]) -> _Property | None:
    if len(words) == 3 and words[1] in _KINDS:
        return _Property(words[2], _KINDS[words[1]], None)
    if len(words) == 5 and words[1] == "list" and words[2] in _KINDS and words[3] in _KINDS:
        count = _KINDS[words[2]]
        return _Property(words[4], _KINDS[words[3]], count) if count in _STRUCT else None
    return None


def _read_binary(data: bytes, start: int, elements: list[_Element], order: str, wanted: str) -> tuple[FloatArray, IntArray]:
    vertices = faces = None
    for element in elements:
        least = element.count * element.least_bytes
        if least > len(data) - start:
            raise BadFileError(
                f"the header promises {element.count} of the element {element.name}, at least {least} bytes, "
                f"but only {len(data) - start} bytes follow"
            )
        if element.has_lists:
            rows = _Lists(data, start, element, order, wanted if element.name == "face" else "")
            start = rows.read()
            if element.name == "face":
                faces = rows.triangles()
        else:
            kinds = [(f"p{i}", order + p.kind) for i, p in enumerate(element.properties)]
            found = np.frombuffer(data, kinds, element.count, start) if element.count else np.empty(0, kinds)
            start += found.nbytes
            if element.name == "vertex":
                vertices = np.empty((element.count, 3))
                for axis, name in enumerate("xyz"):
                    vertices[:, axis] = found[f"p{_place(element, name)}"]
        if vertices is not None and faces is not None:
            return vertices, faces
    raise BadFileError("the PLY has no vertices or no faces")


def _place(element: _Element, name: str) -> int:
    return next(i for i, p in enumerate(element.properties) if p.name == name)


def _narrow(kind: np.dtype) -> type:
    """The smaller of two integer types that holds all values of a kind."""
    return np.int32 if np.can_cast(kind, np.int32) else np.int64


class _Lists:
    """Rows with lists: many of one shape at once, rows of changing shape one by one."""

    def __init__(self, data: bytes, start: int, element: _Element, order: str, wanted: str) -> None:
        self._data, self._start, self._element, self._order = data, start, element, order
        self._wanted = _place(element, wanted) if wanted else -1
        self._counts = [struct.Struct(order + _STRUCT[p.count_kind]) if p.count_kind else None for p in element.properties]
        self._items = [np.dtype(p.kind).itemsize for p in element.properties]
        self._row = 0
        self._ahead = _MOST_AHEAD
        self._sizes: list[IntArray] = []
        self._faces: list[IntArray] = []

    def read(self) -> int:
        """Read all rows; returns where they end."""
        while self._row < self._element.count:
            if self._same_shape() < _RUN // 16:
                self._one_by_one(min(_RUN, self._element.count - self._row))
        return self._start

    def triangles(self) -> IntArray:
        """The wanted lists as faces (F, 3)."""
        sizes = joined(self._sizes, (0,), np.int64)
        if (sizes != 3).any():
            raise not_triangles(sizes)
        return np.asarray(joined(self._faces, (0, 3), np.int32))

    def _keep(self, corners: np.ndarray) -> None:
        done = sum(map(len, self._faces))
        self._faces.append(
            whole(corners, "face", done) if corners.dtype.kind == "f" else corners.astype(_narrow(corners.dtype))
        )

    def _same_shape(self) -> int:
        """Read the rows from here on whose lists are as long as in the next row; returns how many."""
        lengths, size, _ = self._next_row()
        rows = min(self._element.count - self._row, (len(self._data) - self._start) // size, self._ahead)
        if size > _LARGEST_ROW:
            return 0
        kinds: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
        for i, (p, n) in enumerate(zip(self._element.properties, lengths, strict=True)):
            if p.count_kind:
                kinds += [(f"n{i}", self._order + p.count_kind), (f"p{i}", self._order + p.kind, (n,))]
            else:
                kinds.append((f"p{i}", self._order + p.kind))
        found = np.frombuffer(self._data, np.dtype(kinds), rows, self._start)
        same = np.ones(rows, bool)
        for i, n in enumerate(lengths):
            if self._counts[i]:
                same &= found[f"n{i}"] == n
        run = rows if same.all() else int(np.argmin(same))
        if self._wanted >= 0:
            self._sizes.append(np.full(run, lengths[self._wanted], np.uint32))
            if lengths[self._wanted] == 3:
                self._keep(found[f"p{self._wanted}"][:run])
        self._ahead = min(_MOST_AHEAD, 4 * run + _RUN)
        self._row += run
        self._start += run * size
        return run

    def _next_row(self) -> tuple[list[int], int, int]:
        """Lengths of the next row's lists (1 for plain numbers), its bytes, and where the wanted list's values are."""
        lengths, at, wanted = [], self._start, 0
        for i, (count, item) in enumerate(zip(self._counts, self._items, strict=True)):
            length = 1
            if count is not None:
                if at + count.size > len(self._data):
                    raise self._cut_off()
                (length,) = count.unpack_from(self._data, at)
                if length < 0:
                    name = f"{self._element.name} {self._row}, byte {at}: the list {self._element.properties[i].name}"
                    raise BadFileError(f"{name} has the length {length}, below zero")
                at += count.size
                if i == self._wanted:
                    wanted = at
            at += length * item
            lengths.append(length)
        if at > len(self._data):
            raise self._cut_off()
        return lengths, at - self._start, wanted

    def _cut_off(self) -> BadFileError:
        return BadFileError(
            f"the file ends within {self._element.name} {self._row} of {self._element.count}, "
            f"which begins at byte {self._start} of {len(self._data)}"
        )

    def _one_by_one(self, rows: int) -> None:
        sizes: list[int] = []
        corners = bytearray()
        for _ in range(rows):
            lengths, size, at = self._next_row()
            if self._wanted >= 0:
                sizes.append(lengths[self._wanted])
                if sizes[-1] == 3:
                    corners += self._data[at : at + 3 * self._items[self._wanted]]
            self._row += 1
            self._start += size
        if self._wanted >= 0:
            self._sizes.append(np.array(sizes, np.int64))
            self._keep(np.frombuffer(corners, self._order + self._element.properties[self._wanted].kind).reshape(-1, 3))


def _read_ascii(text: bytes, first_line: int, elements: list[_Element], wanted: str) -> tuple[FloatArray, IntArray]:
    reader = RowReader(text, first_line)
    vertices = faces = None
    for element in elements:
        if 2 * element.count * len(element.properties) > len(text) + 1:
            raise BadFileError(
                f"the header promises {element.count} of the element {element.name}, "
                f"which do not fit into the {len(text)} bytes that follow"
            )
        what = f"rows of the element {element.name}"
        if element.name == "face":
            faces = _ascii_faces(reader, element, wanted)
        elif element.name == "vertex":
            places = [_place(element, name) for name in "xyz"]
            parts = [
                table(numbers, rows, len(element.properties), "vertex", exact=True)[:, places]
                for numbers, rows in reader.take(element.count, what)
            ]
            vertices = joined(parts, (0, 3), np.float64)
        else:
            for _ in reader.take(element.count, what):
                pass
        if vertices is not None and faces is not None:
            return vertices, faces
    raise BadFileError("the PLY has no vertices or no faces")


def _ascii_faces(reader: RowReader, element: _Element, wanted: str) -> IntArray:
    place = _place(element, wanted)
    sizes, corners, lines = list[IntArray](), list[FloatArray](), list[int]()
    for numbers, rows in reader.take(element.count, "faces"):
        counts = widths(rows)
        flat = parse(rows)
        if flat is None or len(flat) != sum(counts):
            raise not_a_number(numbers, rows, "face")
        starts = np.cumsum(counts) - counts
        at = np.zeros(len(rows), np.int64)
        for i, p in enumerate(element.properties):
            _within(at < counts, numbers, rows)
            if p.count_kind:
                length = flat[starts + at]
                fits = (length >= 0) & (length == np.floor(length)) & (length < counts - at)
                _within(fits, numbers, rows)
                if i == place:
                    sizes.append(length.astype(np.int64))
                    lines += [numbers[k] for k in np.flatnonzero(length != 3)[:1]]
                    three = np.flatnonzero(length == 3)
                    corners.append(flat[(starts + at)[three, None] + [1, 2, 3]])
                at += length.astype(np.int64)
            at += 1
        _within(at == counts, numbers, rows)
    if lines:
        raise not_triangles(np.concatenate(sizes), lines[0])
    return whole(joined(corners, (0, 3), np.float64), "face")


def _within(fits: np.ndarray, numbers: object, rows: list[bytes]) -> None:
    if not fits.all():
        bad = int(np.argmin(fits))
        raise BadFileError(
            f"line {numbers[bad]}: the face's lists and numbers do not fill its line: {shown(rows[bad].strip())}"  # type: ignore[index]
        )


def _written_header(vertices: int, faces: int, fields: list[tuple[str, str]]) -> bytes:
    types = {"<f8": "double", "<f4": "float"}
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {vertices}"]
    header += [f"property {types[kind]} {name}" for name, kind in fields]
    header += [f"element face {faces}", "property list uchar int vertex_indices", "end_header", ""]
    return "\n".join(header).encode()


def _are_single(points: FloatArray) -> bool:
    """Whether all coordinates are numbers of single precision."""
    chunks = (points[start : start + CHUNK] for start in range(0, len(points), CHUNK))
    with np.errstate(over="ignore"):
        return all(np.array_equal(chunk, chunk.astype(np.float32)) for chunk in chunks)


def write_ply(stream: IO[bytes], arrays: Arrays) -> None:
    """Write a binary PLY file; uv become ``s, t``, coordinates on the sphere ``sx, sy, sz``.

    Vertices are written in single precision where that is exact. s and t are floats, or doubles where the arrays have a key
    "in_doubles".
    """
    count, triangles = len(arrays["vertices"]), arrays["faces"]
    single = {"vertices": "<f4"} if _are_single(arrays["vertices"]) else {}
    columns = [
        (name, single.get(source, "<f8" if "in_doubles" in arrays else kind), arrays[source][:, axis])
        for source, (kind, names) in _WRITTEN.items()
        if source in arrays
        for axis, name in enumerate(names)
    ]
    fields = [(name, kind) for name, kind, _ in columns]
    stream.write(_written_header(count, len(triangles), fields))
    for start in range(0, count, CHUNK):
        rows = slice(start, min(start + CHUNK, count))
        vertex = np.empty(rows.stop - start, fields)
        for name, _, values in columns:
            vertex[name] = values[rows]
        stream.write(vertex.view(np.uint8).data)
    for start in range(0, len(triangles), CHUNK):
        corners = triangles[start : start + CHUNK]
        face = np.empty(len(corners), [("n", "u1"), ("v", "<i4", (3,))])
        face["n"], face["v"] = 3, corners
        stream.write(face.view(np.uint8).data)


register(
    Format(
        name="ply",
        suffixes=(".ply",),
        summary="read in ascii and binary; written in binary, with the map as s, t or sx, sy, sz of the vertices",
        read=read_ply,
        write=write_ply,
        carries=tuple(_WRITTEN),
        looks=(rb"ply[ \t]*[\r\n]", "PLY"),
    )
)
