"""glTF 2.0, as .gltf (JSON) and .glb (binary): the triangles of its scene, where its nodes place them.

Every number of the file is checked before it is used; nothing is fetched, and no file outside the mesh's folder is read.
"""

from __future__ import annotations

import base64
import binascii
import json
import math
import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import Any
from urllib.parse import unquote

import numpy as np

from pgcp.errors import BadFileError
from pgcp.io.formats import Beside, Format, register
from pgcp.io.gltf_parts import Block, name_of, source_of
from pgcp.io.gltf_write import write_glb, write_textured_glb
from pgcp.io.strips import triangles_of_strips
from pgcp.io.text import joined, shown
from pgcp.types import FloatArray, IntArray, Source

_GLB_HEAD, _JSON, _BIN = 12, 0x4E4F534A, 0x004E4942
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_INDEX_KINDS = {5121: "<u1", 5123: "<u2", 5125: "<u4"}
_FLOAT = 5126
_UNITS = {5121: ("<u1", 255.0), 5123: ("<u2", 65535.0), 5126: ("<f4", 1.0)}
_SHAPES = {"VEC3": 3, "VEC4": 4}
_COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_mesh_quantization")
_MOST = 2**53


def read_gltf(data: bytes, beside: Beside) -> Source:
    """Vertices and triangles of a glTF scene, with names, materials, colours and normals; ``beside`` opens a file named in it.

    Primitives of one mesh that use the same positions share their vertices. Raises BadFileError saying what is wrong.
    """
    text, binary = _chunks(data) if data.startswith(b"glTF") else (data, None)
    return _Scene(_document(text), binary, beside, len(data)).read()


def _chunks(data: bytes) -> tuple[bytes, bytes | None]:
    """JSON text and binary chunk of a .glb file."""
    if len(data) < _GLB_HEAD + 8:
        raise BadFileError(f"the file ends after {len(data)} bytes, within the GLB header")
    _, version, length = struct.unpack_from("<4sII", data)
    if version != 2:
        raise BadFileError(f"it is of glTF version {version}; known is 2")
    if length > len(data):
        raise BadFileError(f"the GLB header promises {length} bytes, but the file has {len(data)}")
    chunks: list[tuple[int, bytes]] = []
    at = _GLB_HEAD
    while at + 8 <= length and len(chunks) < 2:
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > length:
            raise BadFileError(f"the GLB chunk at byte {at} promises {size} bytes, but only {length - at - 8} follow")
        chunks.append((kind, data[at + 8 : at + 8 + size]))
        at += 8 + size
    if not chunks or chunks[0][0] != _JSON:
        raise BadFileError(f"the first GLB chunk, at byte {_GLB_HEAD}, is not JSON")
    return chunks[0][1], chunks[1][1] if len(chunks) == 2 and chunks[1][0] == _BIN else None


def _document(text: bytes) -> dict[str, Any]:
    try:
        document = json.loads(text.decode("utf-8-sig"))
    except UnicodeDecodeError as problem:
        raise BadFileError(f"its JSON is not UTF-8 text (byte {problem.start})") from problem
    except RecursionError as problem:
        raise BadFileError("its JSON is nested too deeply") from problem
    except json.JSONDecodeError as problem:
        raise BadFileError(f"its JSON is wrong at line {problem.lineno}, column {problem.colno}: {problem.msg}") from problem
    except ValueError as problem:  # a number of thousands of digits
        raise BadFileError(f"its JSON is wrong: {problem}") from problem
    if not isinstance(document, dict) or not isinstance(document.get("asset"), dict):
        raise BadFileError("its JSON is not that of a glTF file: it has no asset")
    required = document.get("extensionsRequired", [])
    for name in required if isinstance(required, list) else []:
        if name in _COMPRESSED:
            raise BadFileError(f"its geometry is stored with {name}, which is not supported; export it without")
    return document


def _number(value: Any, what: str, default: int | None = None) -> int:
    """A whole number, not negative."""
    if value is None and default is not None:
        return default
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= _MOST:
        raise BadFileError(f"{what} is {_said(value)}, not a whole number from 0")
    return value


def _said(value: Any) -> str:
    return "missing" if value is None else shown(repr(value)[:100].encode("utf-8", "replace"))


class _Scene:
    """One glTF document and its buffers."""

    def __init__(self, document: dict[str, Any], binary: bytes | None, beside: Beside, size: int) -> None:
        self._document, self._binary, self._beside, self._size = document, binary, beside, size
        self._buffers: dict[int, bytes] = {}
        self._vertices: list[FloatArray] = []
        self._faces: list[IntArray] = []
        self._blocks: list[Block] = []
        self._colours: list[tuple[int, int, FloatArray]] = []
        self._normals: list[tuple[int, int, FloatArray]] = []
        self._placed = 0
        self._vertex_count = 0

    def read(self) -> Source:
        """All triangles, in the order of the nodes."""
        for name, mesh, place in self._nodes():
            self._add_mesh(name, mesh, place)
        if not self._faces:
            raise BadFileError("its scene has no triangles")
        vertices, faces = joined(self._vertices, (0, 3), np.float64), joined(self._faces, (0, 3), np.int64)
        materials = self._list(self._document, "materials", "the file")
        return source_of(vertices, faces, self._blocks, materials, self._colours, self._normals)

    def _item(self, kind: str, index: Any, what: str) -> dict[str, Any]:
        items = self._document.get(kind)
        number = _number(index, what)
        if not isinstance(items, list) or number >= len(items):
            have = len(items) if isinstance(items, list) else 0
            raise BadFileError(f"{what} is {number}, but the file has {have} {kind}")
        if not isinstance(items[number], dict):
            raise BadFileError(f"number {number} of the {kind} is no JSON object")
        return items[number]

    def _list(self, owner: dict[str, Any], key: str, what: str) -> list[Any]:
        value = owner.get(key, [])
        if not isinstance(value, list):
            raise BadFileError(f"{what} has {key} that are no list")
        return value

    def _nodes(self) -> Iterator[tuple[str, int, FloatArray]]:
        """Name, mesh number and transformation (4, 4) of every node with a mesh, parents before children."""
        nodes = self._list(self._document, "nodes", "the file")
        if "scenes" in self._document:
            scene = self._item("scenes", self._document.get("scene", 0), "the scene")
            roots = self._list(scene, "nodes", "the scene")
        else:
            children = {
                c for n in nodes if isinstance(n, dict) for c in self._list(n, "children", "a node") if isinstance(c, int)
            }
            roots = [i for i in range(len(nodes)) if i not in children]
        seen: set[int] = set()
        waiting = [(root, np.eye(4)) for root in reversed(roots)]
        while waiting:
            index, parent = waiting.pop()
            node = self._item("nodes", index, "a node's number")
            if index in seen:
                raise BadFileError(f"node {index} is reached twice: the nodes are no tree")
            seen.add(index)
            place = parent @ _transformation(node, f"node {index}")
            if "mesh" in node:
                yield name_of(node, ""), _number(node["mesh"], f"the mesh of node {index}"), place
            waiting += [(child, place) for child in reversed(self._list(node, "children", f"node {index}"))]

    def _add_mesh(self, name: str, index: int, place: FloatArray) -> None:
        mesh = self._item("meshes", index, "a node's mesh")
        first: dict[int, int] = {}
        for k, primitive in enumerate(self._list(mesh, "primitives", f"mesh {index}")):
            what = f"primitive {k} of mesh {index}"
            attributes = primitive.get("attributes") if isinstance(primitive, dict) else None
            if not isinstance(attributes, dict):
                raise BadFileError(f"{what} has no attributes")
            mode = _number(primitive.get("mode"), f"the mode of {what}", _TRIANGLES)
            if mode < _TRIANGLES:
                continue  # points and lines
            if mode > _FAN:
                raise BadFileError(f"{what} has mode {mode}, which glTF does not know")
            positions = _number(attributes.get("POSITION"), f"the POSITION of {what}")
            self._add_faces(primitive, positions, mode, first, place, what)
            material = primitive.get("material")
            known = len(self._list(self._document, "materials", "the file"))
            is_one = isinstance(material, int) and not isinstance(material, bool) and 0 <= material < known
            names = name_of(mesh, "") if name == "" else name, name_of(mesh, "")
            self._blocks.append(Block(len(self._faces[-1]), names, material if is_one else -1))

    def _add_faces(
        self, primitive: dict[str, Any], positions: int, mode: int, first: dict[int, int], place: FloatArray, what: str
    ) -> None:
        if positions not in first:
            points = self._positions(positions, what)
            first[positions] = self._vertex_count
            self._vertex_count += len(points)
            self._vertices.append(points @ place[:3, :3].T + place[:3, 3])
            self._add_attributes(primitive["attributes"], place, what)
        before = first[positions]
        count = self._item("accessors", positions, "a POSITION")["count"]
        corners = np.arange(count) if primitive.get("indices") is None else self._indices(primitive["indices"], what)
        if len(corners) and corners.max() >= count:
            raise BadFileError(f"{what} uses vertex {corners.max()}, but it has vertices 0 to {count - 1}")
        faces = _triangles(corners, mode, what) + before
        self._faces.append(faces if np.linalg.det(place[:3, :3]) >= 0 else faces[:, ::-1])

    def _add_attributes(self, attributes: dict[str, Any], place: FloatArray, what: str) -> None:
        """Keep colours and normals of the vertices that were added last; those that cannot be read are left out."""
        count = len(self._vertices[-1])
        begin, end = self._vertex_count - count, self._vertex_count
        for name, kept in (("COLOR_0", self._colours), ("NORMAL", self._normals)):
            with suppress(BadFileError):
                if name not in attributes:
                    continue
                number = _number(attributes[name], f"the {name} of {what}")
                entry = self._item("accessors", number, f"the {name} of {what}")
                component, shape = entry.get("componentType"), entry.get("type")
                if (
                    component not in _UNITS
                    or shape not in _SHAPES
                    or (name == "NORMAL" and (component, shape) != (_FLOAT, "VEC3"))
                ):
                    continue
                kind, unit = _UNITS[component]
                values = self._values(entry, number, kind, _SHAPES[shape])[:, :3].astype(np.float64) / unit
                if len(values) != count or not np.isfinite(values).all():
                    continue
                kept.append((begin, end, values if name == "COLOR_0" else _turned(values, place[:3, :3])))

    def _positions(self, accessor: int, what: str) -> FloatArray:
        entry = self._item("accessors", accessor, f"the POSITION of {what}")
        if entry.get("type") != "VEC3" or entry.get("componentType") != _FLOAT:
            raise BadFileError(f"the positions of {what} (accessor {accessor}) are not three 32-bit floats")
        return self._values(entry, accessor, "<f4", 3).astype(np.float64)

    def _indices(self, accessor: Any, what: str) -> IntArray:
        entry = self._item("accessors", accessor, f"the indices of {what}")
        kind = entry.get("componentType")
        if entry.get("type") != "SCALAR" or not isinstance(kind, int) or kind not in _INDEX_KINDS:
            raise BadFileError(f"the indices of {what} (accessor {accessor}) are not unsigned whole numbers")
        return self._values(entry, accessor, _INDEX_KINDS[kind], 1)[:, 0].astype(np.int64)

    def _values(self, entry: dict[str, Any], accessor: int, kind: str, columns: int) -> np.ndarray:
        """Values (count, columns) of an accessor, seen to lie within its buffer view before they are touched."""
        name = f"accessor {accessor}"
        count = _number(entry.get("count"), f"the count of {name}")
        sparse = entry.get("sparse")
        if sparse is None:
            return self._viewed(entry, count, name, kind, columns)
        if not isinstance(sparse, dict) or not all(isinstance(sparse.get(key), dict) for key in ("indices", "values")):
            raise BadFileError(f"{name} is sparse, but has no indices and values")
        if count > self._size:
            raise BadFileError(f"{name} promises {count} values, more than the file has bytes")
        values = self._viewed(entry, count, name, kind, columns) if "bufferView" in entry else np.zeros((count, columns), kind)
        some, number = sparse["indices"], _number(sparse.get("count"), f"the sparse count of {name}")
        if not isinstance(some.get("componentType"), int) or some["componentType"] not in _INDEX_KINDS:
            raise BadFileError(f"the sparse indices of {name} are not unsigned whole numbers")
        places = self._viewed(some, number, f"the sparse indices of {name}", _INDEX_KINDS[some["componentType"]], 1)[:, 0]
        if len(places) and places.max() >= count:
            raise BadFileError(f"{name} has {count} values, but its sparse indices name number {places.max()}")
        out = np.array(values)
        out[places] = self._viewed(sparse["values"], number, f"the sparse values of {name}", kind, columns)
        return out

    def _viewed(self, entry: dict[str, Any], count: int, name: str, kind: str, columns: int) -> np.ndarray:
        """Values (count, columns) of a buffer view that ``entry`` names."""
        if "bufferView" not in entry:
            raise BadFileError(f"{name} has no buffer view")
        offset = _number(entry.get("byteOffset"), f"the byteOffset of {name}", 0)
        view = self._item("bufferViews", entry["bufferView"], f"the bufferView of {name}")
        start = _number(view.get("byteOffset"), f"the byteOffset of the buffer view of {name}", 0)
        length = _number(view.get("byteLength"), f"the byteLength of the buffer view of {name}")
        item = np.dtype(kind).itemsize
        stride = _number(view.get("byteStride"), f"the byteStride of the buffer view of {name}", columns * item)
        if stride < columns * item:
            raise BadFileError(f"{name} has values of {columns * item} bytes, but a byteStride of {stride}")
        needed = offset + (count - 1) * stride + columns * item if count else 0
        if needed > length:
            raise BadFileError(f"{name} promises {count} values, {needed} bytes, but its buffer view has {length}")
        data = self._buffer(_number(view.get("buffer"), f"the buffer of the buffer view of {name}"))
        if start + length > len(data):
            raise BadFileError(f"the buffer view of {name} ends at byte {start + length} of a buffer of {len(data)}")
        self._placed += count
        if self._placed > self._size + sum(map(len, self._buffers.values())):
            raise BadFileError("its nodes and primitives use the same data again and again, more than the file has bytes")
        return (
            np.ndarray((count, columns), kind, data, start + offset, (stride, item)) if count else np.empty((0, columns), kind)
        )

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            entry = self._item("buffers", index, "a buffer's number")
            length = _number(entry.get("byteLength"), f"the byteLength of buffer {index}")
            data = self._source(entry.get("uri"), index)
            if length > len(data):
                raise BadFileError(f"buffer {index} promises {length} bytes, but there are {len(data)}")
            self._buffers[index] = data
        return self._buffers[index]

    def _source(self, uri: Any, index: int) -> bytes:
        if uri is None:
            if index or self._binary is None:
                raise BadFileError(f"buffer {index} has neither a uri nor a binary chunk")
            return self._binary
        if not isinstance(uri, str):
            raise BadFileError(f"the uri of buffer {index} is no text")
        inside = re.match(r"data:[^,]{0,100};base64,", uri)
        if inside:
            try:
                return base64.b64decode(uri[inside.end() :], validate=True)
            except (binascii.Error, ValueError) as problem:
                raise BadFileError(f"the base64 data of buffer {index} are wrong: {problem}") from problem
        if re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", uri):
            raise BadFileError(
                f"buffer {index} lies at {shown(uri.encode('utf-8', 'replace'))}; nothing is fetched: put it beside the mesh"
            )
        return self._beside(unquote(uri))


def _triangles(corners: IntArray, mode: int, what: str) -> IntArray:
    """Triangles (F, 3) of the corners of a primitive: three each, a strip or a fan."""
    if mode == _STRIP:
        return triangles_of_strips(corners, np.array([len(corners)]))
    if mode == _FAN:
        return np.column_stack([np.full(max(len(corners) - 2, 0), corners[:1].sum()), corners[1:-1], corners[2:]])
    if len(corners) % 3:
        raise BadFileError(f"{what} has {len(corners)} corners, which make no whole triangles")
    return corners.reshape(-1, 3)


def _turned(normals: FloatArray, place: FloatArray) -> FloatArray:
    """Unit normals (n, 3) where a node places its mesh: by the matrix of cofactors (3, 3)."""
    columns = [np.cross(place[:, (k + 1) % 3], place[:, (k + 2) % 3]) for k in range(3)]
    out = normals @ np.array(columns)
    length = np.linalg.norm(out, axis=1)
    out[length == 0.0] = [0.0, 0.0, 1.0]
    return np.asarray(out / np.where(length > 0.0, length, 1.0)[:, None])


def _transformation(node: dict[str, Any], what: str) -> FloatArray:
    """The node's own (4, 4): its matrix, or translation, rotation and scale."""
    if "matrix" in node:
        return _floats(node["matrix"], 16, f"the matrix of {what}").reshape(4, 4).T
    out = np.eye(4)
    x, y, z, w = _floats(node.get("rotation", [0, 0, 0, 1]), 4, f"the rotation of {what}")
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if not 0.5 < length < 2:
        raise BadFileError(f"the rotation of {what} is no unit quaternion")
    x, y, z, w = x / length, y / length, z / length, w / length
    out[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    out[:3, :3] *= _floats(node.get("scale", [1, 1, 1]), 3, f"the scale of {what}")
    out[:3, 3] = _floats(node.get("translation", [0, 0, 0]), 3, f"the translation of {what}")
    return out


def _floats(value: Any, count: int, what: str) -> FloatArray:
    good = isinstance(value, list) and len(value) == count
    good = good and all(isinstance(v, (int, float)) and not isinstance(v, bool) and abs(v) <= 1e300 for v in value)
    if not good:
        raise BadFileError(f"{what} is {_said(value)}, not {count} numbers")
    return np.array(value, np.float64)


register(
    Format(
        name="glb",
        suffixes=(".glb",),
        summary="the triangles of a binary glTF 2.0 scene; written in 32-bit floats with the map as TEXCOORD_0",
        read=read_gltf,
        write=write_glb,
        carries=("vertices", "uv", "normals", "given"),
        textured=write_textured_glb,
        looks=(rb"glTF", "GLB"),
    )
)
register(
    Format(
        name="gltf",
        suffixes=(".gltf",),
        summary="the triangles of a glTF 2.0 scene, with its buffers inside or in files of the same folder",
        read=read_gltf,
        looks=(rb"\s*[{\[]", "glTF"),
    )
)
