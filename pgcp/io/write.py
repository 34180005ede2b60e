"""Write meshes and maps. Files are written under temporary names and renamed when they are whole."""

from __future__ import annotations

import json
from collections.abc import Collection
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import IO, Any

import numpy as np
import orjson

from pgcp.errors import BadFileError
from pgcp.files import replacing, replacing_together
from pgcp.types import FloatArray, IntArray, Mesh, Parameterization

_CHUNK = 50_000
_TENS = 10.0 ** np.arange(23)  # exact, all of them


def _nine_digits(values: FloatArray) -> FloatArray:
    """Values (n, d) rounded to nine digits, those between 1e-14 and 1e9: a whole number over an exact power of ten each."""
    with np.errstate(divide="ignore"):
        places = 8.0 - np.floor(np.log10(np.abs(values)))
    near = (places >= 0.0) & (places < len(_TENS))
    tens = _TENS[np.where(near, places, 0.0).astype(np.int8)]
    return np.where(near, np.rint(values * tens) / tens, values)


def _lines(head: bytes, rows: np.ndarray, between: bytes = b" ") -> bytes:
    """Rows (n, d) as lines of text, their numbers parted by the letters of ``between`` in turn."""
    head += b" "
    text = orjson.dumps(rows, option=orjson.OPT_SERIALIZE_NUMPY)[2:-2].replace(b"],[", b"\n" + head)
    letters = np.frombuffer(bytearray(text), np.uint8)
    commas = np.flatnonzero(letters == ord(","))
    for k, letter in enumerate(between):
        letters[commas[k :: len(between)]] = letter
    return head + letters.tobytes() + b"\n"


def _write_obj(stream: IO[bytes], mesh: Mesh, uv: FloatArray | None) -> None:
    for head, points in [(b"v", mesh.vertices)] + ([] if uv is None else [(b"vt", uv)]):
        for start in range(0, len(points), _CHUNK):
            stream.write(_lines(head, _nine_digits(points[start : start + _CHUNK])))
    times, between = (1, b" ") if uv is None else (2, b"/ / /")
    for start in range(0, len(mesh.faces), _CHUNK):
        numbers = mesh.faces[start : start + _CHUNK] + 1
        stream.write(_lines(b"f", np.repeat(numbers, times, axis=1), between))


def _ply_header(vertices: int, faces: int, fields: list[tuple[str, str]]) -> bytes:
    types = {"<f8": "double", "<f4": "float"}
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {vertices}"]
    header += [f"property {types[kind]} {name}" for name, kind in fields]
    header += [f"element face {faces}", "property list uchar int vertex_indices", "end_header", ""]
    return "\n".join(header).encode()


def _write_ply(stream: IO[bytes], mesh: Mesh, uv: FloatArray | None) -> None:
    names = () if uv is None else ("s", "t") if uv.shape[1] == 2 else ("sx", "sy", "sz")
    fields = [(name, "<f8") for name in "xyz"] + [(name, "<f8" if len(names) == 3 else "<f4") for name in names]
    stream.write(_ply_header(len(mesh.vertices), len(mesh.faces), fields))
    for start in range(0, len(mesh.vertices), _CHUNK):
        rows = slice(start, start + _CHUNK)
        vertex = np.empty(len(mesh.vertices[rows]), fields)
        for axis, name in enumerate("xyz"):
            vertex[name] = mesh.vertices[rows, axis]
        if uv is not None:
            for axis, name in enumerate(names):
                vertex[name] = uv[rows, axis]
        stream.write(vertex.view(np.uint8).data)
    for start in range(0, len(mesh.faces), _CHUNK):
        corners = mesh.faces[start : start + _CHUNK]
        face = np.empty(len(corners), [("n", "u1"), ("v", "<i4", (3,))])
        face["n"], face["v"] = 3, corners
        stream.write(face.view(np.uint8).data)


def write_mesh(path: str | Path, mesh: Mesh, uv: FloatArray | None = None) -> None:
    """Write a mesh as .obj or .ply, in its own order, with coordinates uv of a map if given.

    uv (V, 2) become ``vt`` or ``s, t``, the customary texture coordinates; uv (V, 3) on the sphere ``sx, sy, sz`` (.ply
    only).
    """
    path = Path(path)
    writers = {".obj": _write_obj, ".ply": _write_ply}
    if path.suffix.lower() not in writers:
        raise BadFileError(f"{path}: cannot write {path.suffix}; known are {', '.join(writers)}")
    if uv is not None and uv.shape[1] != 2 and path.suffix.lower() == ".obj":
        raise BadFileError(f"{path}: an OBJ file has place for planar texture coordinates only")
    with replacing(path) as stream:
        writers[path.suffix.lower()](stream, mesh, uv)


def write_outputs(
    directory: Path,
    stem: str,
    result: Parameterization,
    picture: bytes | None,
    switching: AbstractContextManager[object] | None = None,
    kinds: Collection[str] = ("obj", "ply"),
) -> list[Path]:
    """Write npz, obj, ply, png and report.json into a directory made as needed; returns the paths, the report last.

    Of obj and ply those in ``kinds``, a png where there is a picture; what an earlier run wrote of the others is removed.

    All are written and on the disk before the first takes the place of an earlier one, inside ``switching``; a failure
    before that leaves everything as it was.
    """
    faces: IntArray = result.mesh.faces
    key = "sphere" if result.target == "sphere" else "uv"
    arrays: dict[str, Any] = {key: result.coordinates, "faces": faces, "patch": result.patch, "mu": result.mu}
    if result.vertex_of is not None and result.face_of is not None:
        arrays |= {"vertex_of": result.vertex_of, "face_of": result.face_of}
    report = json.dumps(result.report, indent=2, allow_nan=False).encode() + b"\n"
    with replacing_together(directory) as files:
        np.savez(files.open(f"{stem}.npz"), **arrays)
        if "obj" in kinds and result.target == "sphere":
            _write_obj(files.open(f"{stem}.obj"), Mesh(result.coordinates, faces, stem), None)
        elif "obj" in kinds:
            _write_obj(files.open(f"{stem}.obj"), result.mesh, result.coordinates)
        if "ply" in kinds:
            _write_ply(files.open(f"{stem}.ply"), result.mesh, result.coordinates)
        if picture is not None:
            files.open(f"{stem}.png").write(picture)
        files.without(f"{stem}.{kind}" for kind in ("obj", "ply", "png") if kind not in (*kinds, "png" if picture else ""))
        files.open("report.json").write(report)
        files.sync()
        with switching or nullcontext():
            return files.switch()
