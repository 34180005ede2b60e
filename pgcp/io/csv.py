"""CSV tables: a line for every vertex."""

from __future__ import annotations

from typing import IO

import numpy as np

from pgcp.io.formats import Arrays, Format, register
from pgcp.io.text import CHUNK, as_lines

_COLUMNS = {"vertices": ("x", "y", "z"), "uv": ("u", "v"), "sphere": ("sx", "sy", "sz"), "log_scale": ("log_scale",)}


def write_csv(stream: IO[bytes], arrays: Arrays) -> None:
    """Write a head and, for every vertex, numbers that read back as the same doubles."""
    there = [name for name in _COLUMNS if name in arrays]
    stream.write((",".join(column for name in there for column in _COLUMNS[name]) + "\n").encode())
    table = [arrays[name].reshape(len(arrays[name]), -1) for name in there]
    for start in range(0, len(table[0]), CHUNK):
        rows = np.hstack([values[start : start + CHUNK] for values in table]).astype(np.float64)
        stream.write(as_lines(b"", np.ascontiguousarray(rows), b","))


register(
    Format(
        name="csv",
        suffixes=(".csv",),
        summary="a table with a line for every vertex: place, coordinates in full precision, logarithm of the scale",
        write=write_csv,
        carries=tuple(_COLUMNS),
        is_exact=True,
    )
)
