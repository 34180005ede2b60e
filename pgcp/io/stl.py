"""STL files, binary and ascii. What a file is decided by its length first: binary ones may begin with "solid" too."""

from __future__ import annotations

import struct
from typing import IO

import numpy as np

from pgcp.errors import BadFileError
from pgcp.io.formats import Arrays, Beside, Format, register
from pgcp.io.soup import weld_duplicates
from pgcp.io.text import CHUNK, as_text, line_blocks, shown, table
from pgcp.types import FloatArray, IntArray

_HEAD = 84
_FACET = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(data: bytes, _beside: Beside) -> tuple[FloatArray, IntArray]:
    """Vertices (V, 3) and faces (F, 3) of an STL file; exactly equal corners are one vertex, in order of first use.

    Raises BadFileError saying what is wrong and where.
    """
    promised = struct.unpack_from("<I", data, _HEAD - 4)[0] if len(data) >= _HEAD else 0
    held = max(0, len(data) - _HEAD) // _FACET.itemsize
    whole_facets = len(data) == _HEAD + _FACET.itemsize * promised
    start = data[:1024].lstrip(b"\xef\xbb\xbf \t\r\n")
    if not whole_facets and start[:5].lower() == b"solid" and b"\0" not in data:
        return weld_duplicates(_ascii_corners(as_text(data)))
    if len(data) < _HEAD:
        raise BadFileError(f"it has {len(data)} bytes and does not begin with 'solid': too short for a binary STL")
    if promised != held:
        raise BadFileError(
            f"it promises {promised} facets (bytes 80 to 83), but its {len(data)} bytes hold {held}"
            + ("" if start[:5].lower() == b"solid" else "; an ascii STL begins with 'solid'")
        )
    return weld_duplicates(np.frombuffer(data, _FACET, promised, _HEAD)["corners"].reshape(-1, 3).astype(np.float64))


def _ascii_corners(text: bytes) -> FloatArray:
    """Corners (3F, 3) of the facets of an ascii STL."""
    corners = [np.empty((0, 3))]
    held, line, ended = 3, 0, False
    for numbers, lines in line_blocks(text):
        rows = [row.strip() for row in lines]
        heads = [row[:6].lower() for row in rows]
        v = [i for i, head in enumerate(heads) if head == b"vertex"]
        f = np.array([i for i, head in enumerate(heads) if head == b"facet " or rows[i].lower() == b"facet"], np.int64)
        # vertices before the first facet of the block belong to the last one of the block before
        counts = np.diff(np.concatenate([[0], np.searchsorted(v, f), [len(v)]]))
        counts[0] += held
        places = [line, *(numbers[i] for i in f)]
        wrong = np.flatnonzero(counts[:-1] != 3)
        if len(wrong):
            raise _not_three(places[wrong[0]], int(counts[wrong[0]]))
        held, line = int(counts[-1]), places[-1]
        if v:
            corners.append(table([numbers[i] for i in v], [rows[i][6:] for i in v], 3, "vertex"))
        ended = any(head == b"endsol" for head in heads[-3:])
    if held != 3:
        raise _not_three(line, held)
    if not ended:
        raise BadFileError(f"it has no line 'endsolid' at its end: the file is cut off after {shown(text[-20:])}")
    return np.concatenate(corners)


def _not_three(line: int, count: int) -> BadFileError:
    return BadFileError(
        f"line {line}: a facet has {count} vertices where 3 belong" if line else f"{count - 3} vertices stand before any facet"
    )


def write_stl(stream: IO[bytes], arrays: Arrays) -> None:
    """Write a binary STL file, in 32-bit floats; a facet without area has the normal 0."""
    points, triangles = arrays["vertices"], arrays["faces"]
    stream.write(bytes(_HEAD - 4) + struct.pack("<I", len(triangles)))
    for start in range(0, len(triangles), CHUNK):
        corners = points[triangles[start : start + CHUNK]]
        sides = corners[:, 1:] - corners[:, :1]
        normals = np.cross(sides[:, 0], sides[:, 1])
        lengths = np.linalg.norm(normals, axis=1)[:, None]
        facets = np.zeros(len(corners), _FACET)
        facets["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
        facets["corners"] = corners
        stream.write(facets.view(np.uint8).data)


register(
    Format(
        name="stl",
        suffixes=(".stl",),
        summary="facets, read in ascii and binary: exactly equal corners become one vertex; written in binary",
        read=read_stl,
        write=write_stl,
        looks=(rb"solid\b[^\0]{0,200}facet", "ascii STL"),
    )
)
