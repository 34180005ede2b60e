"""GIFTI files of brain imaging: surfaces, the map's image as a surface, and values at vertices."""

from __future__ import annotations

import base64
import warnings
import zlib
from typing import IO

import numpy as np

from pgcp.errors import BadFileError
from pgcp.io.formats import Arrays, Beside, Format, register
from pgcp.types import FloatArray, IntArray

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


def read_surface(data: bytes, _beside: Beside) -> tuple[FloatArray, IntArray]:
    """Vertices (V, 3) and triangles (F, 3) of the first surface of a GIFTI file; no other file is opened.

    Raises BadFileError for what nibabel cannot read, and where the file holds values, but no surface.
    """
    if b"ExternalFileBinary" in data:
        raise BadFileError("its data lie in another file, which is not opened; wb_command -gifti-convert puts them inside")
    try:
        from nibabel.gifti import GiftiImage

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            image = GiftiImage.from_bytes(data)
        points, triangles = (image.get_arrays_from_intent(f"NIFTI_INTENT_{kind}") for kind in ("POINTSET", "TRIANGLE"))
    except MemoryError:
        raise
    except Exception as problem:
        reason = " ".join(str(problem).split())
        raise BadFileError(f"nibabel cannot read it: {type(problem).__name__}: {reason}"[:300]) from problem
    if not points or not triangles:
        raise BadFileError("it holds no surface: an array of points or one of triangles is missing")
    vertices, faces = np.asarray(points[0].data), np.asarray(triangles[0].data)
    if faces.dtype.kind not in "iu" or faces.ndim != 2 or vertices.ndim != 2:
        raise BadFileError(f"its points have shape {vertices.shape}, its triangles {faces.shape} of type {faces.dtype}")
    return vertices.astype(np.float64), faces


register(
    Format(
        name="surf.gii",
        suffixes=(".surf.gii",),
        summary="GIFTI surface, read by nibabel; written as the map's image, a sphere with radius 100",
        read=read_surface,
        write=write_surface,
        looks=(rb"\s*<\?xml[^>]*>\s*(?:<!DOCTYPE\s+GIFTI|<GIFTI)", "GIFTI"),
        needs=("nibabel",),
        extra="brain",
        writes_alone=True,
        sphere_radius=100.0,
    )
)
register(
    Format(
        name="gii",
        suffixes=(".gii",),
        summary="GIFTI file with a surface, read by nibabel",
        read=read_surface,
        needs=("nibabel",),
        extra="brain",
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
