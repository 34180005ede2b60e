"""Write meshes and maps. Files are written under temporary names and renamed when they are whole."""

from __future__ import annotations

import json
from collections.abc import Collection
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import IO, Any

import numpy as np

from pgcp.errors import BadFileError
from pgcp.files import replacing, replacing_together
from pgcp.types import FloatArray, IntArray, Mesh, Parameterization

_CHUNK = 100_000


def _write_rows(stream: IO[bytes], form: str, rows: np.ndarray) -> None:
    for start in range(0, len(rows), _CHUNK):
        chunk = rows[start : start + _CHUNK]
        stream.write(((form * len(chunk)) % tuple(chunk.reshape(-1).tolist())).encode())


def _write_obj(stream: IO[bytes], mesh: Mesh, uv: FloatArray | None) -> None:
    _write_rows(stream, "v %.9g %.9g %.9g\n", mesh.vertices)
    numbers = mesh.faces.astype(np.int64) + 1
    if uv is None:
        _write_rows(stream, "f %d %d %d\n", numbers)
    else:
        _write_rows(stream, "vt %.9g %.9g\n", uv)
        _write_rows(stream, "f %d/%d %d/%d %d/%d\n", np.repeat(numbers, 2, axis=1))


def _write_ply(stream: IO[bytes], mesh: Mesh, uv: FloatArray | None) -> None:
    fields: list[tuple[str, str]] = [("x", "<f8"), ("y", "<f8"), ("z", "<f8")]
    names = () if uv is None else ("s", "t") if uv.shape[1] == 2 else ("sx", "sy", "sz")
    kind = "<f8" if len(names) == 3 else "<f4"
    fields += [(name, kind) for name in names]
    vertex = np.empty(len(mesh.vertices), fields)
    for axis, name in enumerate("xyz"):
        vertex[name] = mesh.vertices[:, axis]
    if uv is not None:
        for axis, name in enumerate(names):
            vertex[name] = uv[:, axis]
    face = np.empty(len(mesh.faces), [("n", "u1"), ("v", "<i4", (3,))])
    face["n"], face["v"] = 3, mesh.faces
    types = {"<f8": "double", "<f4": "float"}
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertex)}"]
    header += [f"property {types[kind]} {name}" for name, kind in fields]
    header += [f"element face {len(face)}", "property list uchar int vertex_indices", "end_header", ""]
    stream.write("\n".join(header).encode())
    stream.write(vertex.tobytes())
    stream.write(face.tobytes())


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
