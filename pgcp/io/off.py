"""OFF files in ascii, with comments, and with the colours, normals and texture coordinates of their kin."""

from __future__ import annotations

import re
from typing import IO

import numpy as np

from pgcp.errors import BadFileError
from pgcp.io.formats import Arrays, Beside, Format, register
from pgcp.io.text import CHUNK, RowReader, as_lines, as_text, joined, nine_digits, not_triangles, shown, table, whole
from pgcp.types import FloatArray, IntArray

_MAGIC = re.compile(rb"(?:ST)?C?N?(4?n?)OFF\b[ \t]*(BINARY)?")

_BLANK = re.compile(rb"\s+|#[^\r\n]*")


def read_off(data: bytes, _beside: Beside) -> tuple[FloatArray, IntArray]:
    """Vertices (V, 3) and faces (F, 3) of an OFF file; raises BadFileError saying what is wrong and where."""
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
    vertices = [table(lines, rows, 3, "vertex") for lines, rows in reader.take(vertex_count, "vertices")]
    return joined(vertices, (0, 3), np.float64), _faces(reader, face_count)


def _faces(reader: RowReader, count: int) -> IntArray:
    faces: list[IntArray] = []
    sizes: list[IntArray] = []
    first_other: int | None = None
    done = 0
    for numbers, rows in reader.take(count, "faces"):
        sizes.append(whole(table(numbers, rows, 1, "face")[:, 0], "face", done))
        if (sizes[-1] != 3).any():
            first_other = first_other or numbers[int(np.argmax(sizes[-1] != 3))]
        elif first_other is None:
            faces.append(whole(table(numbers, rows, 4, "face")[:, 1:], "face", done))
        done += len(rows)
    if first_other is not None:
        raise not_triangles(np.concatenate(sizes), first_other)
    return np.asarray(joined(faces, (0, 3), np.int64))


def write_off(stream: IO[bytes], arrays: Arrays) -> None:
    """Write an OFF file with nine digits of every coordinate."""
    points, triangles = arrays["vertices"], arrays["faces"]
    stream.write(f"OFF\n{len(points)} {len(triangles)} 0\n".encode())
    for start in range(0, len(points), CHUNK):
        stream.write(as_lines(b"", nine_digits(points[start : start + CHUNK])))
    for start in range(0, len(triangles), CHUNK):
        stream.write(as_lines(b"3", triangles[start : start + CHUNK]))


register(
    Format(
        name="off",
        suffixes=(".off",),
        summary="vertices and triangles in ascii; colours, normals and texture coordinates are passed over",
        read=read_off,
        write=write_off,
        looks=(rb"[A-Z]{0,3}OFF\s", "OFF"),
    )
)
