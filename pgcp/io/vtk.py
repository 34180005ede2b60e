"""VTP files of VTK and ParaView: the surface with arrays at vertices and faces, in XML with appended binary data."""

from __future__ import annotations

import struct
from typing import IO

import numpy as np

from pgcp.io.formats import Arrays, Format, register

_KINDS = {"<f4": "Float32", "<f8": "Float64", "<i4": "Int32", "<i8": "Int64"}
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


def write_vtp(stream: IO[bytes], arrays: Arrays) -> None:
    """Write a VTP file, points and coordinates in double precision; uv are its texture coordinates."""
    data = _Appended()
    known = {**arrays, **({"mu_abs": np.abs(arrays["mu"])} if "mu" in arrays else {})}
    count, faces = len(arrays["vertices"]), arrays["faces"]

    def those(names: tuple[str, ...]) -> str:
        """Elements of the arrays of these names."""
        return "".join(
            data.array(name, known[name], "<i4" if known[name].dtype.kind in "iu" else "<f8") for name in names if name in known
        )

    coordinates = ' TCoords="uv"' if "uv" in arrays else ""
    parts = [
        '<?xml version="1.0"?>\n<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
        "<PolyData>",
        f'<Piece NumberOfPoints="{count}" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" NumberOfPolys="{len(faces)}">',
        f"<PointData{coordinates}>{those(_BY_VERTEX)}</PointData><CellData>{those(_BY_FACE)}</CellData>",
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
        summary="VTK and ParaView: the surface with the map and its measures as arrays",
        write=write_vtp,
        carries=("vertices", *_BY_VERTEX, *(name for name in _BY_FACE if name != "mu_abs"), "mu"),
    )
)
