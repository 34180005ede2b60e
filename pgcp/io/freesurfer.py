"""FreeSurfer surfaces in their binary triangle format, told by their first bytes: lh.pial, rh.white and others."""

from __future__ import annotations

import struct
from typing import IO

import numpy as np

from pgcp.errors import BadFileError
from pgcp.io.formats import Arrays, Beside, Format, register
from pgcp.types import FloatArray, IntArray

_MAGIC = b"\xff\xff\xfe"
_OLD = (b"\xff\xff\xff", b"\xff\xff\xfd")
_LONGEST_HEAD = 10_000


def write_freesurfer(stream: IO[bytes], arrays: Arrays) -> None:
    """Write vertices in single precision and triangles, both big-endian."""
    stream.write(_MAGIC + b"created by pgcp\n\n")
    stream.write(struct.pack(">ii", len(arrays["vertices"]), len(arrays["faces"])))
    stream.write(np.ascontiguousarray(arrays["vertices"], ">f4").tobytes())
    stream.write(np.ascontiguousarray(arrays["faces"], ">i4").tobytes())


def read_freesurfer(data: bytes, _beside: Beside) -> tuple[FloatArray, IntArray]:
    """Vertices (V, 3) and triangles (F, 3); raises BadFileError saying what is wrong."""
    if data[:3] in _OLD:
        raise BadFileError("it is an old FreeSurfer file of quadrangles, or one of values; mris_convert writes triangles")
    if not data.startswith(_MAGIC):
        raise BadFileError("it does not begin with the bytes FF FF FE of a FreeSurfer surface")
    line = data.find(b"\n", 3, _LONGEST_HEAD)
    begin = data.find(b"\n", line + 1, _LONGEST_HEAD) + 1
    if line < 0 or begin == 0:
        raise BadFileError("it has no two lines that say who made it, after its first three bytes")
    if len(data) < begin + 8:
        raise BadFileError(f"the file ends after {len(data)} bytes, before the numbers of vertices and triangles")
    vertex_count, face_count = struct.unpack_from(">ii", data, begin)
    needed = begin + 8 + 12 * (vertex_count + face_count)
    if vertex_count < 0 or face_count < 0 or needed > len(data):
        raise BadFileError(
            f"it promises {vertex_count} vertices and {face_count} triangles, {needed} bytes, but the file has {len(data)}"
        )
    vertices = np.frombuffer(data, ">f4", 3 * vertex_count, begin + 8).reshape(-1, 3).astype(np.float64)
    faces = np.frombuffer(data, ">i4", 3 * face_count, begin + 8 + 12 * vertex_count).reshape(-1, 3).astype(np.int32)
    return vertices, faces


register(
    Format(
        name="sphere",
        suffixes=(".sphere",),
        summary="FreeSurfer surface such as lh.pial, told by its content; written as the map's image, a sphere with radius 100",
        read=read_freesurfer,
        write=write_freesurfer,
        looks=(rb"\xff\xff\xfe", "a FreeSurfer surface"),
        is_told_by_content=True,
        sphere_radius=100.0,
    )
)
