"""GIFTI files of brain imaging: the map's image as a surface, and values at vertices."""

from __future__ import annotations

import base64
import zlib
from typing import IO

import numpy as np

from pgcp.io.formats import Arrays, Format, register

_KINDS = {"<f4": "NIFTI_TYPE_FLOAT32", "<i4": "NIFTI_TYPE_INT32"}
_HEAD = (
    '<?xml version="1.0" encoding="UTF-8"?>\n<!DOCTYPE GIFTI SYSTEM "http://www.nitrc.org/frs/download.php/115/gifti.dtd">\n'
)
_PLACE = (
    "<CoordinateSystemTransformMatrix><DataSpace><![CDATA[NIFTI_XFORM_UNKNOWN]]></DataSpace><TransformedSpace>"
    "<![CDATA[NIFTI_XFORM_UNKNOWN]]></TransformedSpace><MatrixData>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</MatrixData>"
    "</CoordinateSystemTransformMatrix>"
)


def _array(values: np.ndarray, intent: str, kind: str, name: str = "") -> bytes:
    """One data array: compressed little-endian values in base64."""
    sizes = " ".join(f'Dim{k}="{n}"' for k, n in enumerate(values.shape))
    named = f"<MetaData><MD><Name><![CDATA[Name]]></Name><Value><![CDATA[{name}]]></Value></MD></MetaData>" if name else ""
    head = (
        f'<DataArray Intent="{intent}" DataType="{_KINDS[kind]}" ArrayIndexingOrder="RowMajorOrder" '
        f'Dimensionality="{values.ndim}" {sizes} Encoding="GZipBase64Binary" Endian="LittleEndian" '
        f'ExternalFileName="" ExternalFileOffset="">{named or "<MetaData/>"}{_PLACE if "POINTSET" in intent else ""}<Data>'
    )
    data = base64.b64encode(zlib.compress(np.ascontiguousarray(values, kind).tobytes(), 6))
    return head.encode() + data + b"</Data></DataArray>\n"


def _write(stream: IO[bytes], *data: bytes) -> None:
    stream.write(f'{_HEAD}<GIFTI Version="1.0" NumberOfDataArrays="{len(data)}"><MetaData/><LabelTable/>\n'.encode())
    for array in data:
        stream.write(array)
    stream.write(b"</GIFTI>\n")


def write_surface(stream: IO[bytes], arrays: Arrays) -> None:
    """Write vertices and triangles in single precision."""
    points = _array(arrays["vertices"], "NIFTI_INTENT_POINTSET", "<f4")
    _write(stream, points, _array(arrays["faces"], "NIFTI_INTENT_TRIANGLE", "<i4"))


def write_shape(stream: IO[bytes], arrays: Arrays) -> None:
    """Write the logarithm of the map's scale at every vertex in single precision."""
    _write(stream, _array(arrays["log_scale"], "NIFTI_INTENT_SHAPE", "<f4", "log_scale"))


register(
    Format(
        name="surf.gii",
        suffixes=(".surf.gii",),
        summary="GIFTI surface; written as the map's image, a sphere with radius 100",
        write=write_surface,
        sphere_radius=100.0,
    )
)
register(
    Format(
        name="shape.gii",
        suffixes=(".shape.gii",),
        summary="GIFTI values at vertices: the logarithm of the map's scale",
        write=write_shape,
        carries=("log_scale",),
    )
)
