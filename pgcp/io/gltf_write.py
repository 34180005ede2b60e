"""GLB files, written: one mesh with texture coordinates and normals, with the input's colours and materials or a plain one."""

from __future__ import annotations

import json
import struct
from typing import IO, Any

import numpy as np

from pgcp.io.formats import Arrays
from pgcp.io.given import GivenParts, as_unit, has_colours, materials_of

_FLOAT, _SHORT, _INT = 5126, 5123, 5125  # component types
_VERTICES, _INDICES = 34962, 34963  # what a buffer view is for
_REPEAT, _CLAMP, _LINEAR, _MIPMAPS = 10497, 33071, 9729, 9987


class _Parts:
    """Parts of the binary chunk, each at a multiple of four bytes, and what the document says of them."""

    def __init__(self) -> None:
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self.blocks: list[bytes] = []
        self.size = 0

    def view(self, data: bytes, use: int | None = None) -> int:
        """Add bytes; returns the number of their buffer view."""
        entry = {"buffer": 0, "byteOffset": self.size, "byteLength": len(data)}
        self.views.append(entry if use is None else {**entry, "target": use})
        self.blocks.append(data + bytes(-len(data) % 4))
        self.size += len(self.blocks[-1])
        return len(self.views) - 1

    def rows(self, values: np.ndarray) -> int:
        """Add values (n, 2), (n, 3) or (n, 4) of vertices; returns the number of their accessor."""
        single = np.ascontiguousarray(values, "<f4")
        entry = {"bufferView": self.view(single.tobytes(), _VERTICES), "componentType": _FLOAT, "count": len(single)}
        ends = {"min": single.min(axis=0).tolist(), "max": single.max(axis=0).tolist()}
        self.accessors.append({**entry, "type": f"VEC{single.shape[1]}", **ends})
        return len(self.accessors) - 1

    def corners(self, faces: np.ndarray, count: int) -> int:
        """Add faces (F, 3) of so many vertices; returns the number of their accessor."""
        kind, code = ("<u2", _SHORT) if count < 2**16 else ("<u4", _INT)
        view = self.view(np.ascontiguousarray(faces, kind).tobytes(), _INDICES)
        self.accessors.append({"bufferView": view, "componentType": code, "count": faces.size, "type": "SCALAR"})
        return len(self.accessors) - 1


def write_glb(stream: IO[bytes], arrays: Arrays, png: bytes = b"") -> None:
    """Write a GLB file in single precision; v of texture coordinates points down there, so 1 - v is written."""
    parts = _Parts()
    attributes = {"POSITION": parts.rows(arrays["vertices"])}
    if "normals" in arrays:
        attributes["NORMAL"] = parts.rows(arrays["normals"])
    if "uv" in arrays:
        attributes["TEXCOORD_0"] = parts.rows(arrays["uv"] * [1.0, -1.0] + [0.0, 1.0])
    surface: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 0.9}
    materials: list[dict[str, Any]] = [{"pbrMetallicRoughness": surface, "doubleSided": False}]
    pieces = [(arrays["faces"], 0)]
    given: GivenParts | None = arrays.get("given")
    if given is not None and has_colours(given.of_vertices) and not png:
        attributes["COLOR_0"] = parts.rows(as_unit(given.of_vertices))
    if given is not None and not png:
        found, of_face = materials_of(given)
        materials += found
        pieces = [(arrays["faces"][of_face == k], k + 1) for k in np.unique(of_face).tolist()]
        if not any(k == 0 for _, k in pieces):
            materials, pieces = found, [(faces, k - 1) for faces, k in pieces]
    count = len(arrays["vertices"])
    primitives = [{"attributes": attributes, "indices": parts.corners(faces, count), "material": k} for faces, k in pieces]
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "pgcp"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": primitives}],
        "materials": materials,
    }
    if png:
        surface["baseColorTexture"] = {"index": 0}
        document["images"] = [{"bufferView": parts.view(png), "mimeType": "image/png"}]
        # longitudes go on beyond 1, latitudes end at the poles
        document["samplers"] = [{"wrapS": _REPEAT, "wrapT": _CLAMP, "magFilter": _LINEAR, "minFilter": _MIPMAPS}]
        document["textures"] = [{"source": 0, "sampler": 0}]
    document |= {"accessors": parts.accessors, "bufferViews": parts.views, "buffers": [{"byteLength": parts.size}]}
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    stream.write(struct.pack("<4sII", b"glTF", 2, 28 + len(text) + parts.size))
    stream.write(struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", parts.size, b"BIN\0"))
    for block in parts.blocks:
        stream.write(block)


def write_textured_glb(stream: IO[bytes], arrays: Arrays, _stem: str, png: bytes) -> dict[str, bytes]:
    """Write a GLB file with a picture inside."""
    write_glb(stream, arrays, png)
    return {}
