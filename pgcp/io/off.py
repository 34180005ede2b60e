"""OFF files in ascii, with comments, and with the colours, normals and texture coordinates of their kin."""

from __future__ import annotations

import re
from typing import IO, Any

import numpy as np

from pgcp.errors import BadFileError
from pgcp.io.formats import VERTICES, Arrays, Beside, Format, register
from pgcp.io.given import COLOURS, GivenParts
from pgcp.io.text import CHUNK, RowReader, as_lines, as_text, joined, nine_digits, shown, table, whole, widths
from pgcp.types import FloatArray, IntArray, Source

_MAGIC = re.compile(rb"(?:ST)?C?N?(4?n?)OFF\b[ \t]*(BINARY)?")

_BLANK = re.compile(rb"\s+|#[^\r\n]*")


def read_off(data: bytes, _beside: Beside) -> tuple[FloatArray, IntArray] | Source:
    """Vertices, polygons and colours by vertex of an OFF file; raises BadFileError saying what is wrong and where."""
    start = 3 if data.startswith(b"\xef\xbb\xbf") else 0
    while passed := _BLANK.match(data, start):
        start = passed.end()
    magic = _MAGIC.match(data, start)
    if magic is None:
        raise BadFileError(f"it does not begin with the word OFF but with {shown(data[:20])}")
    if magic[1] or magic[2]:
        raise BadFileError(f"it is of the kind {shown(magic[0].strip())}; known are OFF, COFF, NOFF and STOFF in ascii")
    text = as_text(data[magic.end() :])
    reader = RowReader(text, 1 + as_text(data[: magic.end()]).count(b"\n"), b"#")
    ((numbers, rows),) = reader.take(1, "lines of counts")
    words = rows[0].split()
    if not 2 <= len(words) <= 3 or not all(word.isdigit() and len(word) < 19 for word in words):
        raise BadFileError(f"line {numbers[0]}: not the numbers of vertices, faces and edges: {shown(rows[0].strip())}")
    vertex_count, face_count = int(words[0]), int(words[1])
    if 6 * vertex_count + 2 * face_count > len(text) + 1:
        raise BadFileError(
            f"line {numbers[0]} promises {vertex_count} vertices and {face_count} faces, "
            f"which do not fit into a file of {len(data)} bytes"
        )
    places, blocks, vertices = list[Any](), list[list[bytes]](), list[FloatArray]()
    for lines, rows in reader.take(vertex_count, "vertices"):
        vertices.append(table(lines, rows, 3, "vertex"))
        if magic[0].startswith((b"C", b"STC")):
            places.append(lines)
            blocks.append(rows)
    of_vertices = _colours(magic[0], places, blocks) if blocks else {}
    points: FloatArray = joined(vertices, (0, 3), np.float64)
    corners, sizes = _faces(reader, face_count)
    if (sizes == 3).all() and not of_vertices:
        return points, corners.reshape(-1, 3)
    return Source(points, corners, None if (sizes == 3).all() else np.append(0, np.cumsum(sizes)), of_vertices=of_vertices)


def _colours(kind: bytes, numbers: list[Any], rows: list[list[bytes]]) -> dict[str, np.ndarray]:
    """Colours by vertex, where a file of this kind has them on all its lines: after the place and the normal."""
    if b"C" not in kind.split(b"OFF")[0]:
        return {}
    first = 6 if b"N" in kind.split(b"OFF")[0] else 3
    if any(min(widths(block)) < first + 3 for block in rows):
        return {}
    values = np.concatenate([table(n, block, first + 3, "vertex")[:, first:] for n, block in zip(numbers, rows, strict=True)])
    if not (np.isfinite(values).all() and values.min() >= 0.0 and values.max() <= 255.0):
        return {}
    whole_numbers = (values == np.floor(values)).all() and values.max() > 1.0
    columns = values.astype(np.uint8) if whole_numbers else values
    return dict(zip(COLOURS, columns.T, strict=True))


def _faces(reader: RowReader, count: int) -> tuple[IntArray, IntArray]:
    """Corners (C,) of all faces, and how many each has."""
    corners: list[IntArray] = []
    sizes: list[IntArray] = []
    done = 0
    for numbers, rows in reader.take(count, "faces"):
        many = whole(table(numbers, rows, 1, "face")[:, 0], "face", done)
        if (many < 3).any():
            bad = int(np.argmax(many < 3))
            raise BadFileError(f"line {numbers[bad]}: face {done + bad} has {int(many[bad])} corners, which make no polygon")
        parts = []  # nothing is reserved before the numbers are seen to be there
        for size in np.unique(many).tolist():
            those = np.flatnonzero(many == size).tolist()
            alike = len(those) == len(rows)
            places, lines = (numbers, rows) if alike else ([numbers[i] for i in those], [rows[i] for i in those])
            parts.append((those, whole(table(places, lines, size + 1, "face")[:, 1:], "face", done + those[0])))
        flat, first = np.empty(int(many.sum()), np.int64), np.cumsum(many) - many
        for those, found in parts:
            flat[first[those][:, None] + np.arange(found.shape[1])] = found
        corners.append(flat)
        sizes.append(many)
        done += len(rows)
    return joined(corners, (0,), np.int64), joined(sizes, (0,), np.int64)


def write_off(stream: IO[bytes], arrays: Arrays) -> None:
    """Write an OFF file with nine digits of every coordinate, on the polygons of the input."""
    points, triangles = arrays["vertices"], arrays["faces"]
    given: GivenParts | None = arrays.get("given")
    polygons = given.polygons if given is not None and given.has_polygons else None
    count = len(triangles) if polygons is None else len(polygons.polygon_of)
    stream.write(f"OFF\n{len(points)} {count} 0\n".encode())
    for start in range(0, len(points), CHUNK):
        stream.write(as_lines(b"", nine_digits(points[start : start + CHUNK])))
    if polygons is None:
        for start in range(0, len(triangles), CHUNK):
            stream.write(as_lines(b"3", triangles[start : start + CHUNK]))
        return
    sizes, corners = np.diff(polygons.offsets), triangles.reshape(-1)[polygons.corner_at]
    ends = np.append(np.flatnonzero(sizes[1:] != sizes[:-1]) + 1, count)
    for begin, end in zip([0, *ends[:-1].tolist()], ends.tolist(), strict=True):
        for start in range(begin, end, CHUNK):
            stop = min(start + CHUNK, end)
            rows = corners[polygons.offsets[start] : polygons.offsets[stop]].reshape(stop - start, -1)
            stream.write(as_lines(b"%d" % sizes[start], rows))


register(
    Format(
        name="off",
        suffixes=(".off",),
        summary="vertices and polygons in ascii, with colours; normals and texture coordinates are passed over",
        read=read_off,
        write=write_off,
        carries=(VERTICES, "given"),
        looks=(rb"[A-Z]{0,3}OFF\s", "OFF"),
    )
)
