"""OBJ files: vertices and triangles; texture coordinates, normals, colours and all other statements are passed over."""

from __future__ import annotations

from collections.abc import Sequence
from typing import IO

import numpy as np

from pgcp.errors import BadFileError
from pgcp.io.formats import Arrays, Beside, Format, register
from pgcp.io.text import (
    CHUNK,
    as_lines,
    as_text,
    joined,
    line_blocks,
    nine_digits,
    not_triangles,
    parse,
    shown,
    table,
    widths,
)
from pgcp.types import FloatArray, IntArray

_FARTHEST = 2**53
_JOINT = b" \x0b"  # a continued line; its marks are counted to number the lines after it
_VERTEX, _FACE = (b"v ", b"v\t", b"v"), (b"f ", b"f\t", b"f")
_DIGITS = frozenset(b"0123456789+-.,")


def read_obj(data: bytes, _beside: Beside) -> tuple[FloatArray, IntArray]:
    """Vertices (V, 3) and faces (F, 3) of an OBJ file; raises BadFileError saying what is wrong and where."""
    text = as_text(data)
    continued = b"\\\n" in text
    if continued:
        text = text.replace(b"\\\n", _JOINT)
    vertices: list[FloatArray] = []
    faces: list[IntArray] = []
    sizes: list[IntArray] = []
    first_other: int | None = None
    seen = face_count = joints = 0
    for block_numbers, block_lines in line_blocks(text, comment=b"#"):
        numbers, joints = _numbered(block_numbers, block_lines, joints) if continued else (block_numbers, 0)
        heads, lines = _heads(numbers, block_lines)
        v = [i for i, head in enumerate(heads) if head in _VERTEX]
        f = [i for i, head in enumerate(heads) if head in _FACE]
        if v:
            vertices.append(table([numbers[i] for i in v], [lines[i][1:] for i in v], 3, "vertex"))
        if f:
            rows, places = [lines[i][1:] for i in f], [numbers[i] for i in f]
            sizes.append(np.array(widths(rows)))
            if (sizes[-1] != 3).any():
                first_other = first_other or places[int(np.argmax(sizes[-1] != 3))]
            elif first_other is None:
                faces.append(_faces(places, rows, seen + np.searchsorted(v, f), face_count))
        seen, face_count = seen + len(v), face_count + len(f)
    if not seen:
        raise BadFileError("the file has no vertex lines; is it an OBJ file?")
    if first_other is not None:
        raise not_triangles(np.concatenate(sizes), first_other)
    return joined(vertices, (0, 3), np.float64), joined(faces, (0, 3), np.int64)


def _numbered(numbers: Sequence[int], lines: list[bytes], joints: int) -> tuple[Sequence[int], int]:
    """Line numbers of the file before continued lines were joined, and the joints so far."""
    counts = np.cumsum([line.count(_JOINT) for line in lines])
    before = joints + np.concatenate([[0], counts[:-1]])
    return (np.asarray(numbers) + before).tolist(), joints + int(counts[-1])


def _heads(numbers: Sequence[int], lines: list[bytes]) -> tuple[list[bytes], list[bytes]]:
    """The first two bytes of every line, and the lines without indents; raises where one can be no statement."""
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
    return heads, lines


def _without_slashes(row: bytes) -> bytes:
    """Corners without what follows their first slash: all bytes between a slash and the next blank go."""
    letters = np.frombuffer(row, np.uint8)
    place = np.arange(1, len(letters) + 1, dtype=np.int32)
    blank = np.maximum.accumulate(np.where(letters <= 32, place, 0))
    slash = np.maximum.accumulate(np.where(letters == ord("/"), place, 0))
    return letters[blank >= slash].tobytes()


def _faces(numbers: Sequence[int], rows: list[bytes], before: IntArray, first: int) -> IntArray:
    """Vertex ids from 0 of triangles; ``before`` (N,) how many vertices stand before each of them."""
    corners = b" ".join(rows)
    plain = _without_slashes(corners) if b"/" in corners else corners
    flat = parse([plain], np.int64)
    if flat is None or len(flat) != 3 * len(rows) or ((flat > _FARTHEST) | (flat < -_FARTHEST)).any():
        raise _wrong_corner(numbers, rows)
    faces: IntArray = flat.reshape(-1, 3)
    if (faces == 0).any():
        bad = int(np.flatnonzero((faces == 0).any(axis=1))[0])
        raise BadFileError(f"line {numbers[bad]}: face {first + bad} uses vertex 0, but OBJ numbers vertices from 1")
    if (faces < 0).any():
        outside = (faces < 0) & (faces + before[:, None] < 0)
        if outside.any():
            bad = int(np.flatnonzero(outside.any(axis=1))[0])
            raise BadFileError(
                f"line {numbers[bad]}: face {first + bad} uses vertex {int(faces[bad].min())}, "
                f"counted backwards, but only {int(before[bad])} vertices stand before it"
            )
        faces = np.where(faces < 0, faces + before[:, None] + 1, faces)
    return faces - 1


def _wrong_corner(numbers: Sequence[int], rows: list[bytes]) -> BadFileError:
    for number, row in zip(numbers, rows, strict=True):
        for token in row.split():
            digits = token.split(b"/", 1)[0].lstrip(b"+-")
            if not digits.isdigit() or len(digits) > 15:
                return BadFileError(f"line {number}: the face line does not hold vertex numbers: {shown(token)}")
    return BadFileError(f"lines {numbers[0]} to {numbers[-1]}: the face lines do not hold vertex numbers")


def write_obj(stream: IO[bytes], arrays: Arrays) -> None:
    """Write an OBJ file with nine digits of every number; uv become ``vt``, numbered as the vertices or by "uv_faces".

    uv have all their digits where the arrays have a key "in_doubles".
    """
    for head, source in ((b"v", "vertices"), (b"vt", "uv")):
        points = arrays.get(source, np.empty((0, 2)))
        has_all_digits = source == "uv" and "in_doubles" in arrays
        for start in range(0, len(points), CHUNK):
            rows = points[start : start + CHUNK]
            stream.write(as_lines(head, rows if has_all_digits else nine_digits(rows)))
    numbers = [arrays["faces"], arrays.get("uv_faces", arrays["faces"])] if "uv" in arrays else [arrays["faces"]]
    between = b"/ / /" if "uv" in arrays else b" "
    for start in range(0, len(arrays["faces"]), CHUNK):
        corners = np.stack([ids[start : start + CHUNK] + 1 for ids in numbers], axis=2)
        stream.write(as_lines(b"f", corners.reshape(len(corners), -1), between))


def write_textured_obj(stream: IO[bytes], arrays: Arrays, stem: str, png: bytes) -> dict[str, bytes]:
    """Write an OBJ file with a material; returns the material's file and its picture, by name."""
    stream.write(f"mtllib {stem}.mtl\nusemtl texture\n".encode())
    write_obj(stream, arrays)
    material = f"newmtl texture\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nillum 1\nmap_Kd {stem}_texture.png\n"
    return {f"{stem}.mtl": material.encode(), f"{stem}_texture.png": png}


register(
    Format(
        name="obj",
        suffixes=(".obj",),
        summary="vertices and triangles; written with vt, the texture coordinates of the map",
        read=read_obj,
        write=write_obj,
        carries=("vertices", "uv", "uv_faces"),
        textured=write_textured_obj,
    )
)
