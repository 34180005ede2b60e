"""OBJ files, read: vertices, polygons, normals, colours, objects, groups and materials; texture coordinates are passed over."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pgcp.errors import BadFileError
from pgcp.io.formats import Beside, Format, register
from pgcp.io.given import COLOURS
from pgcp.io.obj_parts import colours_of, is_marked, libraries_of, marks_of, normals_of, parts_of
from pgcp.io.obj_write import libraries_beside, write_obj, write_textured_obj
from pgcp.io.text import as_text, joined, line_blocks, parse, shown, table, widths
from pgcp.types import FloatArray, IntArray, Source

_FARTHEST = 2**53
_JOINT = b" \x0b"  # a continued line; its marks are counted to number the lines after it
_VERTEX, _FACE = (b"v ", b"v\t", b"v"), (b"f ", b"f\t", b"f")
_DIGITS = frozenset(b"0123456789+-.,")


def read_obj(data: bytes, beside: Beside) -> tuple[FloatArray, IntArray] | Source:
    """All that an OBJ file says of its surface; raises BadFileError saying what is wrong and where."""
    text = as_text(data)
    continued = b"\\\n" in text
    if continued:
        text = text.replace(b"\\\n", _JOINT)
    reader, joints = _Reader(), 0
    for block_numbers, block_lines in line_blocks(text, comment=b"#"):
        numbers, joints = _numbered(block_numbers, block_lines, joints) if continued else (block_numbers, 0)
        heads, lines, kinds = _heads(numbers, block_lines)
        reader.add(numbers, heads, lines, kinds)
    return reader.finished(beside)


class _Reader:
    """Collects what the blocks of a file hold."""

    def __init__(self) -> None:
        self._vertices: list[FloatArray] = []
        self._colours: list[FloatArray | None] = []
        self._normals: list[FloatArray] = []
        self._sizes: list[IntArray] = []
        self._corners: list[IntArray] = []
        self._normal_of: list[IntArray | None] = []
        self._marks: list[tuple[int, bytes]] = []
        self._vertex_count = self._normal_count = self._face_count = 0

    def add(self, numbers: Sequence[int], heads: list[bytes], lines: list[bytes], kinds: set[bytes]) -> None:
        """Take the lines of a block; kinds: which heads there are."""
        v = [i for i, head in enumerate(heads) if head in _VERTEX]
        f = [i for i, head in enumerate(heads) if head in _FACE]
        n = [i for i, head in enumerate(heads) if head == b"vn"] if b"vn" in kinds else []
        if v:
            rows, places = [lines[i][1:] for i in v], [numbers[i] for i in v]
            self._vertices.append(table(places, rows, 3, "vertex"))
            self._colours.append(colours_of(places, rows))
        if n:
            self._normals.append(table([numbers[i] for i in n], [lines[i][2:] for i in n], 3, "normal"))
        if f:
            rows, places = [lines[i][1:] for i in f], [numbers[i] for i in f]
            sizes = _sizes(places, rows, self._face_count)
            self._sizes.append(sizes)
            before = self._vertex_count + np.searchsorted(v, f)
            self._corners.append(_corners(places, rows, sizes, before, self._face_count))
            self._normal_of.append(
                normals_of(rows, sizes, self._normal_count + np.searchsorted(n, f)) if self._normals else None
            )
        if is_marked(kinds):
            self._marks += marks_of(heads, lines, f, self._face_count)
        self._vertex_count += len(v)
        self._normal_count += len(n)
        self._face_count += len(f)

    def finished(self, beside: Beside) -> tuple[FloatArray, IntArray] | Source:
        """What was read."""
        if not self._vertices:
            raise BadFileError("the file has no vertex lines; is it an OBJ file?")
        vertices: FloatArray = joined(self._vertices, (0, 3), np.float64)
        corners: IntArray = joined(self._corners, (0,), np.int64)
        sizes = joined(self._sizes, (0,), np.int32)
        offsets = None if (sizes == 3).all() else np.append(0, np.cumsum(sizes, dtype=np.int64))
        colours = [part for part in self._colours if part is not None]
        of_vertices = dict(zip(COLOURS, np.concatenate(colours).T, strict=True)) if len(colours) == len(self._colours) else {}
        normals, normal_of = self._with_normals(len(corners))
        if offsets is None and normals is None and not self._marks and not of_vertices:
            return vertices, corners.reshape(-1, 3)
        parts, part_of = parts_of(self._marks, self._face_count)
        return Source(
            vertices, corners, offsets, parts, part_of, of_vertices, marks=tuple(self._marks),
            libraries=libraries_of(self._marks, beside), normals=normals, normal_of=normal_of,
        )  # fmt: skip

    def _with_normals(self, corner_count: int) -> tuple[FloatArray | None, IntArray | None]:
        """Normals, and which of them each corner has; None where not all have one."""
        found = [part for part in self._normal_of if part is not None]
        if not self._normals or len(found) < len(self._normal_of) or not found:
            return None, None
        normals: FloatArray = joined(self._normals, (0, 3), np.float64)
        normal_of: IntArray = joined(found, (0,), np.int64)
        if len(normal_of) != corner_count or normal_of.min() < 0 or normal_of.max() >= len(normals):
            return None, None
        return (normals, normal_of) if np.isfinite(normals).all() else (None, None)


def _sizes(numbers: Sequence[int], rows: list[bytes], first: int) -> IntArray:
    """Numbers of corners; raises BadFileError for a face of fewer than three."""
    sizes = np.array(widths(rows), np.int32)
    if (sizes < 3).any():
        bad = int(np.argmax(sizes < 3))
        raise BadFileError(f"line {numbers[bad]}: face {first + bad} has {int(sizes[bad])} corners: {shown(rows[bad].strip())}")
    return sizes


def _numbered(numbers: Sequence[int], lines: list[bytes], joints: int) -> tuple[Sequence[int], int]:
    """Line numbers of the file before continued lines were joined, and the joints so far."""
    counts = np.cumsum([line.count(_JOINT) for line in lines])
    before = joints + np.concatenate([[0], counts[:-1]])
    return (np.asarray(numbers) + before).tolist(), joints + int(counts[-1])


def _heads(numbers: Sequence[int], lines: list[bytes]) -> tuple[list[bytes], list[bytes], set[bytes]]:
    """The first two bytes of every line, the lines without indents, and which beginnings there are; raises for others."""
    heads = [line[:2] for line in lines]
    kinds = set(heads)
    if any(head[:1].isspace() for head in kinds):
        lines = [line.lstrip() for line in lines]
        heads = [line[:2] for line in lines]
        kinds = set(heads)
    wrong = {head for head in kinds if head[0] in _DIGITS or (head[0] in b"vf" and head[1:] and head[1] in _DIGITS)}
    if wrong:
        bad = next(i for i, head in enumerate(heads) if head in wrong)
        raise BadFileError(f"line {numbers[bad]} begins with no OBJ statement: {shown(lines[bad].strip())}")
    return heads, lines, kinds


def _without_slashes(row: bytes) -> bytes:
    """Corners without what follows their first slash: all bytes between a slash and the next blank go."""
    letters = np.frombuffer(row, np.uint8)
    place = np.arange(1, len(letters) + 1, dtype=np.int32)
    blank = np.maximum.accumulate(np.where(letters <= 32, place, 0))
    slash = np.maximum.accumulate(np.where(letters == ord("/"), place, 0))
    return letters[blank >= slash].tobytes()


def _corners(numbers: Sequence[int], rows: list[bytes], sizes: IntArray, before: IntArray, first: int) -> IntArray:
    """Vertex ids (C,) from 0 of faces with these numbers of corners; ``before`` (N,) how many vertices stand before each."""
    text = b" ".join(rows)
    flat = parse([_without_slashes(text) if b"/" in text else text], np.int64)
    if flat is None or len(flat) != int(sizes.sum()) or ((flat > _FARTHEST) | (flat < -_FARTHEST)).any():
        raise _wrong_corner(numbers, rows)
    if (flat > 0).all():
        return np.asarray(flat - 1)
    owner = np.repeat(np.arange(len(rows)), sizes)
    if (flat == 0).any():
        bad = int(owner[np.argmax(flat == 0)])
        raise BadFileError(f"line {numbers[bad]}: face {first + bad} uses vertex 0, but OBJ numbers vertices from 1")
    outside = (flat < 0) & (flat + before[owner] < 0)
    if outside.any():
        bad = int(owner[np.argmax(outside)])
        raise BadFileError(
            f"line {numbers[bad]}: face {first + bad} uses vertex {int(flat[owner == bad].min())}, "
            f"counted backwards, but only {int(before[bad])} vertices stand before it"
        )
    return np.where(flat < 0, flat + before[owner], flat - 1)


def _wrong_corner(numbers: Sequence[int], rows: list[bytes]) -> BadFileError:
    for number, row in zip(numbers, rows, strict=True):
        for token in row.split():
            digits = token.split(b"/", 1)[0].lstrip(b"+-")
            if not digits.isdigit() or len(digits) > 15:
                return BadFileError(f"line {number}: the face line does not hold vertex numbers: {shown(token)}")
    return BadFileError(f"lines {numbers[0]} to {numbers[-1]}: the face lines do not hold vertex numbers")


register(
    Format(
        name="obj",
        suffixes=(".obj",),
        summary="vertices and polygons; written with vt, the texture coordinates of the map, and with the same polygons",
        read=read_obj,
        write=write_obj,
        carries=("vertices", "uv", "uv_faces", "given"),
        textured=write_textured_obj,
        beside=libraries_beside,
    )
)
