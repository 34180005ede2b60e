"""OBJ files, written: the surface with texture coordinates, on the polygons, objects and materials that the input had."""

from __future__ import annotations

from typing import IO

import numpy as np

from pgcp.io.formats import Arrays
from pgcp.io.given import GivenParts, as_unit, has_colours
from pgcp.io.text import CHUNK, as_lines, nine_digits
from pgcp.types import IntArray

_OF_MATERIALS = (b"usemtl", b"mtllib")


def write_obj(stream: IO[bytes], arrays: Arrays, textured: bool = False) -> None:
    """Write an OBJ file with nine digits of every number; uv become ``vt``, numbered as the vertices or by "uv_faces".

    With "given" the polygons, objects, groups, materials, normals and colours of the input are written; ``textured``: without
    its materials. uv have all their digits where the arrays have a key "in_doubles".
    """
    given: GivenParts | None = arrays.get("given")
    vertices = arrays["vertices"]
    if given is not None and has_colours(given.of_vertices):
        vertices = np.column_stack([vertices, np.round(as_unit(given.of_vertices), 6)])
    points = [(b"v", vertices), (b"vt", arrays.get("uv", np.empty((0, 2))))]
    if given is not None and given.source.normals is not None:
        points.append((b"vn", given.source.normals))
    for head, values in points:
        has_all_digits = head == b"vt" and "in_doubles" in arrays
        for start in range(0, len(values), CHUNK):
            rows = values[start : start + CHUNK]
            stream.write(as_lines(head, rows if has_all_digits else nine_digits(rows)))
    numbers = [arrays["faces"], arrays.get("uv_faces", arrays["faces"])] if "uv" in arrays else [arrays["faces"]]
    if given is not None:
        _write_given(stream, given, numbers, textured)
        return
    between = b"/ / /" if "uv" in arrays else b" "
    for start in range(0, len(arrays["faces"]), CHUNK):
        corners = np.stack([ids[start : start + CHUNK] + 1 for ids in numbers], axis=2)
        stream.write(as_lines(b"f", corners.reshape(len(corners), -1), between))


def _write_given(stream: IO[bytes], given: GivenParts, numbers: list[IntArray], textured: bool) -> None:
    """Write the faces of the input, and its statements before them."""
    polygons, source = given.polygons, given.source
    columns = [ids.reshape(-1)[polygons.corner_at] for ids in numbers]
    between = b"/"
    if source.normal_of is not None:
        between = b"/" if len(numbers) == 2 else b"//"
        columns.append(source.normal_of[given.corner_of.reshape(-1)[polygons.corner_at]])
    marks = [m for m in source.marks if not (textured and m[1].startswith(_OF_MATERIALS))]
    places = np.searchsorted(polygons.polygon_of, [place for place, _ in marks]).tolist()
    places, marks = _in_force(places, marks, len(polygons.polygon_of))
    start = 0
    for place, (_, line) in [*zip(places, marks, strict=True), (len(polygons.polygon_of), (0, b""))]:
        while start < place:
            stop = min(place, start + CHUNK)
            some = slice(polygons.offsets[start], polygons.offsets[stop])
            corners = np.column_stack([column[some] + 1 for column in columns])
            stream.write(_polygon_lines(corners, polygons.offsets[start : stop + 1] - polygons.offsets[start], between))
            start = stop
        if line:
            stream.write(line + b"\n")


def _in_force(places: list[int], marks: list[tuple[int, bytes]], count: int) -> tuple[list[int], list[tuple[int, bytes]]]:
    """Statements without those that no face follows before another of their kind: of objects that are left out."""
    kept, seen, at = [], set[bytes](), -1
    for k in range(len(marks) - 1, -1, -1):
        word = marks[k][1].split(b" ", 1)[0]
        seen, at = (seen, at) if places[k] == at else (set(), places[k])
        if word == b"mtllib" or (word not in seen and places[k] < count):
            kept.append(k)
        seen.add(word)
    return [places[k] for k in reversed(kept)], [marks[k] for k in reversed(kept)]


def _polygon_lines(corners: IntArray, offsets: IntArray, between: bytes) -> bytes:
    """Lines of faces, of corners (C, k) one after the other; offsets (P + 1,): where each face begins."""
    text = as_lines(b"", corners, b"/")
    letters = np.frombuffer(bytearray(text), np.uint8)
    ends = np.flatnonzero(letters == ord("\n"))
    inner = np.ones(len(ends), bool)
    inner[offsets[1:] - 1] = False
    letters[ends[inner]] = ord(" ")
    lines = b"f " + letters[:-1].tobytes().replace(b"\n", b"\nf ") + b"\n"
    return lines if between == b"/" else lines.replace(b"/", between)


def libraries_beside(arrays: Arrays) -> dict[str, bytes]:
    """Material files of the input, by name, to go beside the file."""
    given: GivenParts | None = arrays.get("given")
    return {} if given is None else dict(given.source.libraries)


def write_textured_obj(stream: IO[bytes], arrays: Arrays, stem: str, png: bytes) -> dict[str, bytes]:
    """Write an OBJ file with a material; returns the material's file and its picture, by name."""
    stream.write(f"mtllib {stem}.mtl\nusemtl texture\n".encode())
    write_obj(stream, arrays, textured=True)
    material = f"newmtl texture\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nillum 1\nmap_Kd {stem}_texture.png\n"
    return {f"{stem}.mtl": material.encode(), f"{stem}_texture.png": png}
