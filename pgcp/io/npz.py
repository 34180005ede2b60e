"""NPZ files, for results only: every array of a map in full precision, under its name."""

from __future__ import annotations

from typing import IO

import numpy as np

from pgcp.io.formats import Arrays, Format, register


def write_npz(stream: IO[bytes], arrays: Arrays) -> None:
    """Write arrays for ``numpy.load``."""
    np.savez(stream, **dict(arrays))  # type: ignore[arg-type]


register(
    Format(
        name="npz",
        suffixes=(".npz",),
        summary="arrays for numpy.load: the map's coordinates, faces, patches and Beltrami coefficients in full precision",
        write=write_npz,
        carries=("uv", "sphere", "patch", "mu", "vertex_of", "face_of", "polygon_of", "component_of"),
        is_exact=True,
    )
)
