"""Surfaces that other packages hold: told by what they have, so that none of these packages is imported."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pgcp.errors import InputError
from pgcp.types import FloatArray, IntArray, Mesh, Source

_KNOWN = "a path, (vertices, faces), a pgcp.Mesh, or a mesh of trimesh, pyvista, meshio, nibabel or open3d"


def of_object(given: Any) -> Mesh | Source:
    """The surface of a pair (vertices, faces), or of an object of trimesh, pyvista, meshio, nibabel or open3d.

    Raises InputError, saying what was given, where it is none of these, or its arrays have other shapes or types.
    """
    if isinstance(given, (tuple, list)):
        if len(given) != 2:
            raise InputError(f"a mesh is given as {type(given).__name__} of {len(given)}; expected two, vertices and faces")
        return _mesh(given[0], given[1], "mesh")
    kind = f"{type(given).__module__.partition('.')[0]}.{type(given).__name__}"
    if hasattr(given, "get_arrays_from_intent"):
        return _of_gifti(given, kind)
    if hasattr(given, "extract_surface") and not hasattr(given, "faces"):  # a grid of pyvista
        raise InputError(f"{kind}: it is no surface; give its extract_surface()")
    if hasattr(given, "points") and hasattr(given, "cells_dict"):  # meshio
        return _of_meshio(given, kind)
    if hasattr(given, "points") and hasattr(given, "faces"):  # pyvista
        return _of_pyvista(given, kind)
    if hasattr(given, "vertices") and hasattr(given, "faces"):  # trimesh
        return _mesh(given.vertices, given.faces, kind)
    if hasattr(given, "vertices") and hasattr(given, "triangles"):  # open3d
        return _mesh(given.vertices, given.triangles, kind)
    raise InputError(f"expected {_KNOWN}, not {_said(given)}")


def _said(given: Any) -> str:
    """What was given, in a few words."""
    if isinstance(given, np.ndarray):
        return f"an array of shape {given.shape} and type {given.dtype}"
    if isinstance(given, Mapping):
        return f"a {type(given).__name__} with the keys {', '.join(map(str, list(given)[:5])) or 'none'}"
    return f"an object of type {type(given).__name__}"


def _mesh(vertices: Any, faces: Any, name: str) -> Mesh:
    """A mesh of arrays of numbers and whole numbers."""
    try:
        points, corners = np.asarray(vertices), np.asarray(faces)
    except ValueError as problem:  # rows of different lengths
        raise InputError(f"{name}: vertices and faces are no tables of numbers: {problem}") from problem
    if points.dtype.kind not in "iuf":
        raise InputError(f"{name}: vertices are of type {points.dtype}, expected numbers")
    if corners.dtype.kind == "f" and corners.size and np.isfinite(corners).all() and (corners == np.rint(corners)).all():
        raise InputError(f"{name}: faces are of type {corners.dtype}, expected whole numbers; give faces.astype(int)")
    return Mesh(points.astype(np.float64, copy=False), corners, name)


def _of_gifti(given: Any, name: str) -> Mesh:
    points, triangles = (given.get_arrays_from_intent(f"NIFTI_INTENT_{kind}") for kind in ("POINTSET", "TRIANGLE"))
    if not points or not triangles:
        raise InputError(f"{name}: it holds no surface: an array of points or one of triangles is missing")
    return _mesh(points[0].data, triangles[0].data, name)


def _of_meshio(given: Any, name: str) -> Mesh | Source:
    """Triangles, quadrilaterals and polygons of a meshio.Mesh; lines and points are passed over."""
    corners: list[IntArray] = []
    sizes: list[IntArray] = []
    for block in given.cells:
        if block.type in ("vertex", "line"):
            continue
        if block.type not in ("triangle", "quad", "polygon"):
            raise InputError(f"{name}: it has cells of the kind {block.type}; expected triangles, quads and polygons")
        rows = (
            [np.asarray(row, np.int64) for row in block.data] if block.type == "polygon" else [np.asarray(block.data, np.int64)]
        )
        corners += [row.reshape(-1) for row in rows]
        sizes += [np.full(len(row) if row.ndim == 2 else 1, row.shape[-1]) for row in rows]
    return _of_polygons(_three(given.points), corners, sizes, name)


def _of_pyvista(given: Any, name: str) -> Mesh | Source:
    """Polygons of a pyvista.PolyData, whose faces are sizes and corners by turns."""
    faces = np.asarray(given.faces)
    if faces.ndim != 1:
        return _mesh(given.points, faces, name)
    if getattr(given, "n_strips", 0):
        raise InputError(f"{name}: it has strips of triangles; give its triangulate()")
    corners: list[IntArray] = []
    sizes: list[IntArray] = []
    if len(faces) % 4 == 0 and (faces[::4] == 3).all():
        corners, sizes = [faces.reshape(-1, 4)[:, 1:].reshape(-1)], [np.full(len(faces) // 4, 3)]
    else:
        at = 0
        while at < len(faces):
            size = int(faces[at])
            corners.append(faces[at + 1 : at + 1 + size])
            sizes.append(np.array([size]))
            at += size + 1
    return _of_polygons(_three(given.points), corners, sizes, name)


def _three(points: Any) -> FloatArray:
    """Points of the plane lie in space at z = 0."""
    out = np.asarray(points, np.float64)
    return np.column_stack([out, np.zeros(len(out))]) if out.ndim == 2 and out.shape[1] == 2 else out


def _of_polygons(points: FloatArray, corners: list[IntArray], sizes: list[IntArray], name: str) -> Mesh | Source:
    if not sizes or not sum(map(len, sizes)):
        raise InputError(f"{name}: it has no polygons")
    flat, many = np.concatenate(corners), np.concatenate(sizes)
    if (many == 3).all():
        return _mesh(points, flat.reshape(-1, 3), name)
    return Source(points, flat.astype(np.int64), np.append(0, np.cumsum(many)), name=name)
