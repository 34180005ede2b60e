"""VTP files of VTK and ParaView: the surface with arrays at vertices and faces, in XML with appended binary data."""

from __future__ import annotations

import struct
from functools import partial
from typing import IO

import numpy as np

from pgcp.io.formats import Arrays, Format, register
from pgcp.io.given import COLOURS, GivenParts, as_unit, has_colours, materials_of, vertex_normals
from pgcp.io.vtk_read import read_vtk
from pgcp.types import Columns

_KINDS = {"<f4": "Float32", "<f8": "Float64", "<i4": "Int32", "<i8": "Int64", "u1": "UInt8"}
_BY_VERTEX, _BY_FACE = ("uv", "sphere", "log_scale"), ("patch", "mu_abs", "angle_error", "area_ratio")


class _Appended:
    """Data after the XML: eight bytes of length before each array."""

    def __init__(self) -> None:
        self.blocks: list[np.ndarray] = []
        self._size = 0

    def array(self, name: str, values: np.ndarray, kind: str) -> str:
        """The element of an array, whose data are appended."""
        columns = values.shape[1] if values.ndim == 2 else 1
        block = np.ascontiguousarray(values, kind)
        head = f'<DataArray type="{_KINDS[kind]}" Name="{name}" NumberOfComponents="{columns}"'
        text = f'{head} format="appended" offset="{self._size}"/>'
        self.blocks.append(block)
        self._size += 8 + block.nbytes
        return text


def _kind_of(values: np.ndarray) -> str:
    """The type that values are written in."""
    if values.dtype.kind not in "iu":
        return "<f8"
    return "u1" if values.dtype == np.uint8 else "<i4" if np.can_cast(values.dtype, np.int32) else "<i8"


def _word(name: str) -> str:
    """A name as it can stand in an attribute of XML."""
    return "".join(letter if letter.isalnum() or letter in "_-." else "_" for letter in name)


def write_vtp(stream: IO[bytes], arrays: Arrays) -> None:
    """Write a VTP file, points and coordinates in double precision; uv are its texture coordinates."""
    data = _Appended()
    known = {**arrays, **({"mu_abs": np.abs(arrays["mu"])} if "mu" in arrays else {})}
    given: GivenParts | None = arrays.get("given")
    of_vertices, of_faces = ({}, {}) if given is None else (dict(given.of_vertices), dict(given.of_triangles))
    if given is not None and has_colours(of_vertices):
        known["RGB"] = np.rint(255.0 * as_unit(of_vertices)).astype(np.uint8)
        of_vertices = {name: values for name, values in of_vertices.items() if name not in COLOURS}
    if given is not None and (own := vertex_normals(given)) is not None:
        known["Normals"] = own
        of_vertices = {name: values for name, values in of_vertices.items() if name not in ("nx", "ny", "nz")}
    if given is not None and given.has_polygons:
        of_faces["polygon_of"] = given.polygon_of
    if given is not None and len(materials_of(given)[0]):
        of_faces["material"] = materials_of(given)[1]
    count, faces = len(arrays["vertices"]), arrays["faces"]

    def those(names: tuple[str, ...]) -> str:
        """Elements of the arrays of these names."""
        return "".join(
            data.array(name, known[name], "<i4" if known[name].dtype == np.int64 else _kind_of(known[name]))
            for name in names
            if name in known
        )

    def further(columns: Columns) -> str:
        """Elements of what the input has beside them."""
        return "".join(
            data.array(_word(name), values, _kind_of(values)) for name, values in columns.items() if name not in known
        )

    coordinates = ' TCoords="uv"' if "uv" in arrays else ""
    by_vertex = those((*_BY_VERTEX, "RGB", "Normals")) + further(of_vertices)
    by_face = those(_BY_FACE) + further(of_faces)
    parts = [
        '<?xml version="1.0"?>\n<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
        "<PolyData>",
        f'<Piece NumberOfPoints="{count}" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" NumberOfPolys="{len(faces)}">',
        f"<PointData{coordinates}>{by_vertex}</PointData><CellData>{by_face}</CellData>",
        f"<Points>{data.array('Points', arrays['vertices'], '<f8')}</Points><Polys>",
        data.array("connectivity", faces.reshape(-1), "<i4"),
        data.array("offsets", 3 * np.arange(1, len(faces) + 1), "<i8"),
        '</Polys></Piece></PolyData><AppendedData encoding="raw">_',
    ]
    stream.write("".join(parts).encode())
    for block in data.blocks:
        stream.write(struct.pack("<Q", block.nbytes))
        stream.write(block.data.cast("B") if block.size else b"")
    stream.write(b"</AppendedData></VTKFile>\n")


register(
    Format(
        name="vtp",
        suffixes=(".vtp",),
        summary="VTK and ParaView: polygons, read by the package vtk; written with the map and its measures as arrays",
        read=partial(read_vtk, kind="vtp"),
        write=write_vtp,
        looks=(rb"\s*(?:<\?xml[^>]*>\s*)?<VTKFile[^>]*PolyData", "VTP"),
        needs=("vtk",),
        extra="vtk",
        writes_alone=True,
        carries=("vertices", *_BY_VERTEX, *(name for name in _BY_FACE if name != "mu_abs"), "mu", "given"),
    )
)
