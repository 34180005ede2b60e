"""Values at the vertices of a mesh: read from files, carried to a map's vertices, and written with the mesh."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pgcp.errors import BadFileError, InputError
from pgcp.io.given import GivenParts
from pgcp.io.ply_write import write_ply
from pgcp.io.vtk import write_vtp
from pgcp.result import Result
from pgcp.types import FloatArray, IntArray, Source


def read_values(path: Path) -> FloatArray:
    """Numbers (N, C) of a file: an array that numpy.save wrote, or text, a line for every vertex.

    Raises InputError where there is no such file, BadFileError where it holds something else.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    try:
        found = np.load(path, allow_pickle=False) if path.suffix == ".npy" else np.loadtxt(path, delimiter=_delimiter(path))
        values = np.asarray(found, np.float64)
    except (OSError, ValueError, EOFError, TypeError) as problem:
        raise BadFileError(f"{path}: it holds no table of numbers, a line for every vertex") from problem
    values = values.reshape(len(values), -1) if values.shape else values.reshape(1, 1)
    if not values.size or not np.isfinite(values).all():
        raise BadFileError(f"{path}: it must hold finite numbers, a line for every vertex")
    return values


def _delimiter(path: Path) -> str | None:
    with path.open(errors="replace") as stream:
        return "," if "," in stream.readline() else None


def on_the_map(values: FloatArray, result: Result, name: str) -> FloatArray:
    """Values (V, C) at a map's vertices of those (N, C) at its input's vertices; raises InputError where N is not right."""
    vertex_of = result.vertex_of
    if vertex_of is None and result.origin is not None:
        vertex_of = result.origin.vertex_of
    needed = len(result.mesh.vertices) if vertex_of is None else int(vertex_of.max()) + 1
    if len(values) < needed or (vertex_of is None and len(values) != needed):
        raise InputError(f"{name}: it holds {len(values)} lines, and the mesh has {needed} vertices")
    return values if vertex_of is None else values[vertex_of]


class Joined(NamedTuple):
    """A mapped surface without split or unused vertices.

    vertices (n, 3), faces (F, 3), image (n, 2) or (n, 3): coordinates of the map; number (V,): of each of the result's
    vertices, -1 where no face uses it; first (n,): one of the result's vertices of each.
    """

    vertices: FloatArray
    faces: IntArray
    image: FloatArray
    number: IntArray
    first: IntArray

    def given_back(self, values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        """Values (..., V) of those (..., n), 0 where no face uses a vertex."""
        return np.where(self.number >= 0, values[..., self.number], 0)


def joined(result: Result) -> Joined:
    """The surface of a map as one piece; raises InputError where several components were mapped."""
    if result.origin is not None and result.origin.component_of is not None:
        raise InputError("this takes the map of one component; --component all has mapped several")
    count = len(result.mesh.vertices)
    point_of = np.arange(count) if result.origin is None else result.origin.point_of
    used = np.zeros(int(point_of.max()) + 1, bool)
    used[point_of[result.faces.reshape(-1)]] = True
    place = np.where(used, np.cumsum(used) - 1, -1)
    number = place[point_of]
    first = np.full(int(used.sum()), -1, np.int64)
    corners = result.faces.reshape(-1)[::-1]
    first[number[corners]] = corners
    return Joined(result.mesh.vertices[first], number[result.faces], result.coordinates[first], number, first)


def field_files(name: str, result: Result, fields: dict[str, np.ndarray[Any, Any]]) -> dict[str, bytes]:
    """Contents of a PLY or VTP file, by its name, with the surface, the map's coordinates and fields (V,) at its vertices.

    Complex fields are written as two, NAME_real and NAME_imag.
    """
    columns: dict[str, np.ndarray[Any, Any]] = {}
    for key, values in fields.items():
        if np.issubdtype(values.dtype, np.complexfloating):
            columns |= {f"{key}_real": values.real.copy(), f"{key}_imag": values.imag.copy()}
        else:
            columns[key] = np.asarray(values, np.float64)
    mesh = result.mesh
    source = Source(mesh.vertices, mesh.faces.reshape(-1), of_vertices=columns)
    given = GivenParts(source, np.arange(len(mesh.vertices)), np.arange(mesh.faces.size).reshape(-1, 3), mesh.faces)
    arrays = {"vertices": mesh.vertices, "faces": mesh.faces, result.coordinates_name: result.coordinates, "given": given}
    stream = io.BytesIO()
    (write_ply if name.lower().endswith(".ply") else write_vtp)(stream, arrays)
    return {name: stream.getvalue()}
