"""Values at vertices that go from one surface to another: where they come from, and how they are written."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from pgcp.io.given import COLOURS, GivenParts, as_unit, given_parts, has_colours
from pgcp.io.ply_write import write_ply
from pgcp.result import Result
from pgcp.types import Columns, FloatArray, Mesh, Source

_OF_THE_SHAPE = {"x", "y", "z", "nx", "ny", "nz", "s", "t", "u", "v", "texture_u", "texture_v", "sx", "sy", "sz", "alpha"}
_KEPT = {"i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"}  # types that PLY files have


def own_values(result: Result) -> dict[str, np.ndarray]:
    """Values (V,) that the file of a map's mesh has at its vertices: colours and others, but for normals and texture places."""
    given = given_parts(result.origin, result.faces)
    found = {} if given is None else given.of_vertices
    return {name: values for name, values in found.items() if name not in _OF_THE_SHAPE and values.dtype.kind in "iufb"}


def of_input(result: Result, values: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Values by the input's vertices as values by those of the map."""
    some = slice(None) if result.vertex_of is None else result.vertex_of
    return {name: np.asarray(one)[some] for name, one in values.items()}


def carried_columns(columns: Columns, carry: Callable[[Any], np.ndarray]) -> dict[str, np.ndarray]:
    """Values carried to another surface; colours are mixed, whatever numbers they are, other whole numbers are not."""
    out = {}
    for name, values in columns.items():
        if has_colours(columns) and name in COLOURS and values.dtype.kind in "iu":
            out[name] = np.rint(carry(values.astype(np.float64))).astype(values.dtype)
        else:
            out[name] = carry(values)
    return out


def flat_columns(columns: Columns) -> dict[str, np.ndarray]:
    """The same as single columns (V,) of types that PLY files have: ``name_1``, ``name_2`` where there were several."""
    out = {}
    for name, values in columns.items():
        own = f"value_{name}" if name in _OF_THE_SHAPE else name
        rows = values.reshape(len(values), -1)
        kind = rows.dtype.str[1:]
        simple = kind if kind in _KEPT else {"f": "f4" if kind == "f2" else "f8", "b": "u1"}.get(kind[0], "i4")
        for k, column in enumerate(rows.T):
            out[own if len(rows.T) == 1 else f"{own}_{k + 1}"] = np.ascontiguousarray(column, simple)
    return out


def place_colours(points: FloatArray) -> dict[str, np.ndarray]:
    """Colours that tell places (V, 3) apart: red, green and blue grow along x, y and z."""
    low, span = points.min(axis=0), np.maximum(np.ptp(points, axis=0), 1e-300)
    shares = np.rint(255.0 * (0.12 + 0.86 * (points - low) / span)).astype(np.uint8)
    return dict(zip(COLOURS, shares.T, strict=True))


def colours_of(columns: Columns) -> FloatArray | None:
    """Colours (V, 3) from 0 to 1, None where there are none."""
    return as_unit(columns) if has_colours(columns) else None


def first_field(columns: Columns) -> tuple[str, FloatArray] | None:
    """Name and values (V,) of the first column that is no colour, None where there is none."""
    for name, values in flat_columns(columns).items():
        if not (has_colours(columns) and name in COLOURS):
            return name, values.astype(np.float64)
    return None


def ply_of(mesh: Mesh, columns: Columns) -> bytes:
    """A binary PLY file of a mesh with values at its vertices."""
    count = len(mesh.vertices)
    source = Source(mesh.vertices, mesh.faces.reshape(-1), of_vertices=flat_columns(columns))
    corners = np.arange(mesh.faces.size).reshape(-1, 3)
    given = GivenParts(source, np.arange(count), corners, mesh.faces)
    stream = io.BytesIO()
    write_ply(stream, {"vertices": mesh.vertices, "faces": mesh.faces, "given": given})
    return stream.getvalue()
