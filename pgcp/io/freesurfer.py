"""FreeSurfer surfaces in their binary triangle format."""

from __future__ import annotations

import struct
from typing import IO

import numpy as np

from pgcp.io.formats import Arrays, Format, register

_MAGIC = b"\xff\xff\xfe"


def write_freesurfer(stream: IO[bytes], arrays: Arrays) -> None:
    """Write vertices in single precision and triangles, both big-endian."""
    stream.write(_MAGIC + b"created by pgcp\n\n")
    stream.write(struct.pack(">ii", len(arrays["vertices"]), len(arrays["faces"])))
    stream.write(np.ascontiguousarray(arrays["vertices"], ">f4").tobytes())
    stream.write(np.ascontiguousarray(arrays["faces"], ">i4").tobytes())


register(
    Format(
        name="sphere",
        suffixes=(".sphere",),
        summary="FreeSurfer surface such as lh.sphere; written as the map's image, a sphere with radius 100",
        write=write_freesurfer,
        sphere_radius=100.0,
    )
)
