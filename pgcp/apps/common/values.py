"""Values at vertices: where they come from, how they are numbered on a map and carried to another surface, and written."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from pgcp.api import surface_of
from pgcp.errors import InputError
from pgcp.io.given import COLOURS, GivenParts, as_unit, given_parts, has_colours
from pgcp.io.write import mesh_files
from pgcp.plane.locate import Places
from pgcp.result import Result
from pgcp.types import Columns, FloatArray, IntArray, Mesh, Source

_OF_THE_SHAPE = {"x", "y", "z", "nx", "ny", "nz", "s", "t", "u", "v", "texture_u", "texture_v", "sx", "sy", "sz", "alpha"}
_KEPT = {"i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"}  # types that PLY files have


def own_values(result: Result) -> dict[str, np.ndarray]:
    """Values (V,) that the file of a map's mesh has at its vertices: colours and others, but for normals and texture places."""
    given = given_parts(result.origin, result.faces)
    found = {} if given is None else given.of_vertices
    return {name: values for name, values in found.items() if name not in _OF_THE_SHAPE and values.dtype.kind in "iufb"}


def source_of(given: Any) -> tuple[Mesh | Source, int]:
    """What a mesh that is given is mapped from, read once, and how many vertices it has; raises as ``surface_of`` does."""
    surface = surface_of(given)
    mesh = surface.cut.mesh
    return (mesh if surface.source is None else surface.source), len(mesh.vertices)


def of_input(result: Result, values: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Values by the input's vertices as values by those of the map."""
    some: Any = result.vertex_of
    if some is None:
        some = slice(None) if result.origin is None else result.origin.vertex_of
    return {name: np.asarray(one)[some] for name, one in values.items()}


def checked(values: Any, result: Result, called: str = "values", kinds: str = "iufb", most: int = 1) -> np.ndarray:
    """Values (V, ...) at a map's vertices as an array of at most so many dimensions, of numbers of these kinds.

    Raises InputError where it is no such array, or has what is no finite number.
    """
    found, count = np.asarray(values), len(result.mesh.vertices)
    if found.dtype.kind not in kinds or found.shape[:1] != (count,) or len(found.shape) > most:
        said = f"{called} have shape {found.shape} and type {found.dtype}"
        raise InputError(f"{said}, but {result.mesh.name} has {count} vertices, each of which needs a number")
    if not np.isfinite(found).all():
        raise InputError(f"{called} of {result.mesh.name} hold what is no finite number")
    return found


def carried(values: Any, faces: IntArray, places: Places) -> np.ndarray:
    """Values (V, ...) at vertices as values (N, ...) at places on faces (F, 3).

    Numbers are interpolated linearly; whole numbers and truth values are those of the corner with the most weight.
    """
    values = np.asarray(values)
    corners = faces[places.faces]
    if values.dtype.kind in "iub":
        return values[np.take_along_axis(corners, places.weights.argmax(axis=1)[:, None], axis=1)[:, 0]]
    return np.asarray(np.einsum("nk,nk...->n...", places.weights, values[corners]))


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
    """The same as single columns (V,) of types that PLY files have: ``name_1``, ``name_2`` where there were several.

    Complex ones are two, ``name_real`` and ``name_imag``.
    """
    out: dict[str, np.ndarray] = {}
    for name, values in columns.items():
        if values.dtype.kind == "c":
            out |= flat_columns({f"{name}_real": values.real, f"{name}_imag": values.imag})
            continue
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


def own_colours(result: Result) -> dict[str, np.ndarray]:
    """Colours of the vertices that the file of a map's mesh has, none where it has none."""
    own = own_values(result)
    return {name: own[name] for name in COLOURS} if has_colours(own) else {}


def colours_in(columns: Columns) -> FloatArray | None:
    """Colours (V, 3) from 0 to 1, None where there are none."""
    return as_unit(columns) if has_colours(columns) else None


def first_field(columns: Columns) -> tuple[str, FloatArray] | None:
    """Name and values (V,) of the first column that is no colour, None where there is none."""
    for name, values in flat_columns(columns).items():
        if not (has_colours(columns) and name in COLOURS):
            return name, values.astype(np.float64)
    return None


def mesh_with(name: str, mesh: Mesh, columns: Columns, **coordinates: FloatArray) -> dict[str, bytes]:
    """Contents of a PLY or VTP file, by its name, of a mesh with values at its vertices, and coordinates by their name."""
    source = Source(mesh.vertices, mesh.faces.reshape(-1), of_vertices=flat_columns(columns))
    corners = np.arange(mesh.faces.size).reshape(-1, 3)
    given = GivenParts(source, np.arange(len(mesh.vertices)), corners, mesh.faces)
    return mesh_files(name, mesh, given=given, **coordinates)  # type: ignore[arg-type]
