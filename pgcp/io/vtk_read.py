"""Surfaces of VTK and ParaView, read by the package vtk: legacy .vtk, .vtp and .vtu files."""

from __future__ import annotations

import re
import warnings
from functools import partial
from typing import Any

import numpy as np

from pgcp.errors import BadFileError
from pgcp.io.formats import Beside, Format, register
from pgcp.io.strips import triangles_of_strips
from pgcp.types import FloatArray, IntArray, Source

_WHERE = r"^.*?, line \d+ (?:vtk\w+ \(0x\w+\): )?"  # in VTK's own code
_LINES = (0, 1, 2, 3, 4)  # cells without area: nothing, points and lines
_TRIANGLE, _STRIP, _POLYGON, _PIXEL, _QUAD = 5, 6, 7, 8, 9


def read_vtk(data: bytes, _beside: Beside, kind: str) -> Source:
    """Points, polygons and values at points of a VTK surface; triangles of strips follow the polygons.

    kind: vtk, vtp or vtu. Lines and points are passed over. Raises BadFileError for what VTK cannot read, for cells with a
    volume, and for curved ones.
    """
    from vtkmodules.util.numpy_support import vtk_to_numpy

    found = _read(data, kind)
    if found is None or not found.IsA("vtkPointSet") or found.GetPoints() is None:
        raise BadFileError("it holds no surface of points and polygons")
    if found.IsA("vtkPolyData"):
        corners, sizes = _listed(found.GetPolys())
        strips = triangles_of_strips(*_listed(found.GetStrips()))
    elif found.IsA("vtkUnstructuredGrid"):
        corners, sizes, strips = _of_grid(found)
    else:
        raise BadFileError(f"it holds a {found.GetClassName()} and no surface of polygons")
    corners = np.concatenate([corners, strips.reshape(-1)])
    sizes = np.concatenate([sizes, np.full(len(strips), 3)])
    if not len(sizes):
        raise BadFileError("it holds no polygons")
    points: FloatArray = vtk_to_numpy(found.GetPoints().GetData()).astype(np.float64)
    offsets = None if (sizes == 3).all() else np.append(0, np.cumsum(sizes))
    return Source(points, corners, offsets, of_vertices=_columns(found.GetPointData(), len(points)))


def _read(data: bytes, kind: str) -> Any:
    """What VTK makes of a file's bytes; its complaints are not printed, the first is raised."""
    from vtkmodules.vtkCommonCore import vtkLogger, vtkOutputWindow, vtkStringOutputWindow
    from vtkmodules.vtkIOLegacy import vtkGenericDataObjectReader
    from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLUnstructuredGridReader

    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    window, before = vtkStringOutputWindow(), vtkOutputWindow.GetInstance()
    vtkOutputWindow.SetInstance(window)
    try:
        reader: Any = {
            "vtk": vtkGenericDataObjectReader,
            "vtp": vtkXMLPolyDataReader,
            "vtu": vtkXMLUnstructuredGridReader,
        }[kind]()
        reader.ReadFromInputStringOn()
        if kind == "vtk":
            reader.SetBinaryInputString(data, len(data))
        else:
            reader.SetInputString(data)
        reader.Update()
        heard = window.GetOutput()
        said = " ".join((heard.decode("ascii", "replace") if isinstance(heard, bytes) else heard).split())
    finally:
        vtkOutputWindow.SetInstance(before)
    if "rror" in said:
        first = next(part for part in re.split(r"(?:ERROR|(?:Generic )?Warning):", said) if part.strip())
        raise BadFileError(f"VTK cannot read it: {re.sub(_WHERE, '', first).strip()[:200]}")
    return reader.GetOutput()


def _columns(values: Any, count: int) -> dict[str, np.ndarray]:
    """Arrays of one number at each of so many points, by name."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    out = {}
    for k in range(values.GetNumberOfArrays()):
        array = values.GetArray(k)
        if array is None or array.GetNumberOfComponents() != 1 or array.GetNumberOfTuples() != count or not array.GetName():
            continue
        column = vtk_to_numpy(array).copy()
        if np.isfinite(column).all():
            out[str(array.GetName())] = column
    return out


def _listed(cells: Any) -> tuple[IntArray, IntArray]:
    """Corners (C,) and sizes (N,) of VTK's cells."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    if cells is None or cells.GetNumberOfCells() == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    offsets = vtk_to_numpy(cells.GetOffsetsArray()).astype(np.int64)
    return vtk_to_numpy(cells.GetConnectivityArray()).astype(np.int64), np.diff(offsets)


def _of_grid(grid: Any) -> tuple[IntArray, IntArray, IntArray]:
    """Corners (C,) and sizes (N,) of the polygons of an unstructured grid, and triangles (F, 3) of its strips."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the newest VTK has another name for it
        kinds = vtk_to_numpy(grid.GetCellTypesArray()) if grid.GetNumberOfCells() else np.empty(0, np.int64)
    others = np.setdiff1d(kinds, [*_LINES, _TRIANGLE, _STRIP, _POLYGON, _PIXEL, _QUAD])
    if len(others):
        raise BadFileError(
            f"it has {int(np.isin(kinds, others).sum())} cells that are no flat polygons (VTK's type {int(others[0])}); "
            "extract its surface first"
        )
    connectivity, sizes = _listed(grid.GetCells())
    third = (np.cumsum(sizes) - sizes)[kinds == _PIXEL] + 2  # a pixel's corners are by rows
    connectivity[third], connectivity[third + 1] = connectivity[third + 1], connectivity[third]
    of_cell = np.repeat(kinds, sizes)
    polygons, strips = np.isin(kinds, (_TRIANGLE, _POLYGON, _PIXEL, _QUAD)), kinds == _STRIP
    triangles = triangles_of_strips(connectivity[of_cell == _STRIP], sizes[strips])
    return connectivity[np.isin(of_cell, kinds[polygons])], sizes[polygons], triangles


for _name, _what, _looks in (
    ("vtk", "legacy VTK file of polygons", (rb"# vtk DataFile", "a VTK file")),
    ("vtu", "VTK unstructured grid of polygons", (rb"\s*(?:<\?xml[^>]*>\s*)?<VTKFile[^>]*UnstructuredGrid", "VTU")),
):
    register(
        Format(
            name=_name,
            suffixes=(f".{_name}",),
            summary=f"{_what}, read by the package vtk",
            read=partial(read_vtk, kind=_name),
            looks=_looks,
            needs=("vtk",),
            extra="vtk",
        )
    )
