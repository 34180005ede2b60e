"""NPZ files: a mesh as the arrays vertices and faces, and the arrays of a map in full precision, under their names."""

from __future__ import annotations

import io
from typing import IO

import numpy as np

from pgcp.errors import BadFileError
from pgcp.io.formats import Arrays, Beside, Format, register
from pgcp.io.unpack import check_unpacked_size
from pgcp.types import FloatArray, IntArray

_NAMES = (("vertices", "faces"), ("v", "f"), ("V", "F"))


def write_npz(stream: IO[bytes], arrays: Arrays) -> None:
    """Write arrays for ``numpy.load``."""
    np.savez(stream, **dict(arrays))  # type: ignore[arg-type]


def read_npz(data: bytes, _beside: Beside) -> tuple[FloatArray, IntArray]:
    """The arrays vertices (V, 3) and faces (F, 3), or v and f, of a file that numpy.savez has written; no other is unpacked.

    Raises BadFileError where they are missing or no numbers.
    """
    check_unpacked_size(data)
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            names = next((pair for pair in _NAMES if set(pair) <= set(file.files)), None)
            if names is None:
                held = ", ".join(file.files[:10]) or "nothing"
                raise BadFileError(f"it holds {held}; a mesh has the arrays vertices and faces")
            vertices, faces = (np.asarray(file[name]) for name in names)
    except (BadFileError, MemoryError):
        raise
    except Exception as problem:
        raise BadFileError(f"numpy cannot read it: {' '.join(str(problem).split())}"[:300]) from problem
    if vertices.dtype.kind not in "iuf" or faces.dtype.kind not in "iu":
        raise BadFileError(f"vertices are of type {vertices.dtype}, faces of type {faces.dtype}; expected floats and integers")
    return vertices.astype(np.float64), faces


register(
    Format(
        name="npz",
        suffixes=(".npz",),
        summary="arrays for numpy.load: of a mesh vertices and faces; of a map coordinates, faces, patches and Beltrami "
        "coefficients in full precision",
        read=read_npz,
        looks=(rb"PK\x03\x04", "NPZ"),
        write=write_npz,
        carries=("uv", "sphere", "patch", "mu", "vertex_of", "face_of", "polygon_of", "component_of"),
        is_exact=True,
    )
)
