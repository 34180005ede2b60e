"""Write meshes and maps. Files are written under temporary names and renamed when they are whole."""

from __future__ import annotations

import json
from collections.abc import Collection
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import IO

import numpy as np

from pgcp.errors import BadFileError, InputError
from pgcp.io.coordinates import coordinates_of, image_of
from pgcp.io.files import replacing, replacing_together
from pgcp.io.formats import DEFAULT_OUTPUTS, VERTICES, Arrays, Format, of_suffix, outputs, suffixes_of, writable
from pgcp.types import FloatArray, Mesh, Parameterization

_PICTURE, _REPORT = ".png", "report.json"
_ALWAYS = ("faces", "in_doubles")


def _write(stream: IO[bytes], kind: Format, arrays: Arrays) -> None:
    """Write those of the arrays that the format carries."""
    assert kind.write is not None
    kind.write(stream, {name: values for name, values in arrays.items() if name in _ALWAYS or name in kind.carries})


def write_mesh(path: str | Path, mesh: Mesh, uv: FloatArray | None = None, *, sphere: FloatArray | None = None) -> None:
    """Write a mesh in its own order, in the format of the file name's ending, with coordinates of a map if given.

    uv (V, 2): coordinates in the plane, the customary texture coordinates; sphere (V, 3): coordinates on the unit sphere.
    Raises BadFileError where the format has no place for them, InputError where they have another shape.
    """
    path = Path(path)
    kinds = [kind for kind in writable() if VERTICES in kind.carries]
    kind = of_suffix(path.suffix, kinds)
    if kind is None:
        raise BadFileError(f"{path}: cannot write {path.suffix or 'a file without ending'}; known are {suffixes_of(kinds)}")
    kind.check_packages("writing")
    arrays: dict[str, np.ndarray] = {VERTICES: mesh.vertices, "faces": mesh.faces}
    for name, values, columns in (("uv", uv, 2), ("sphere", sphere, 3)):
        if values is None:
            continue
        if np.shape(values) != (len(mesh.vertices), columns):
            raise InputError(f"{path}: {name} has shape {np.shape(values)}, expected {(len(mesh.vertices), columns)}")
        if name not in kind.carries:
            able = suffixes_of([other for other in kinds if name in other.carries])
            raise BadFileError(f"{path}: a {path.suffix} file has no place for the coordinates {name}; choose from {able}")
        arrays[name] = np.asarray(values, np.float64)
    with replacing(path) as stream:
        _write(stream, kind, arrays)


def _earlier(directory: Path, stem: str) -> set[str]:
    """Files of a stem that an earlier run's report says it wrote here."""
    names = {f"{stem}{suffix}" for kind in writable() for suffix in kind.suffixes[:1]}
    try:
        said = json.loads((directory / _REPORT).read_bytes())["files"]
        return names.intersection(name for name in said if isinstance(name, str))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return set()


def write_outputs(
    directory: Path,
    stem: str,
    result: Parameterization,
    picture: bytes | None,
    switching: AbstractContextManager[object] | None = None,
    kinds: Collection[str] = DEFAULT_OUTPUTS,
) -> list[Path]:
    """Write a map in formats of these names, png and report.json into a directory made as needed; returns the paths.

    Coordinates that would be folded in 32-bit floats are written as doubles where the format can hold them. A png is written
    where there is a picture. What an earlier run wrote of these files and this one does not is removed; of
    formats that are not written by default those that its report names. The report is the last path and names all files.

    All are written and on the disk before the first takes the place of an earlier one, inside ``switching``; a failure
    before that leaves everything as it was.
    """
    chosen = outputs(kinds)
    key, coordinates = coordinates_of(result)
    arrays: dict[str, np.ndarray] = {key: coordinates, "faces": result.mesh.faces, "patch": result.patch, "mu": result.mu}
    if result.vertex_of is not None and result.face_of is not None:
        arrays |= {"vertex_of": result.vertex_of, "face_of": result.face_of}
    if result.report.get("single_precision_folds"):
        arrays["in_doubles"] = np.empty(0)
    names = {f"{stem}{kind.suffixes[0]}": kind for kind in chosen}
    images = {} if picture is None else {f"{stem}{_PICTURE}": picture}
    report = {**result.report, "files": [*names, *images, _REPORT]}
    usual = {f"{stem}{suffix}" for suffix in (_PICTURE, *(kind.suffixes[0] for kind in outputs(DEFAULT_OUTPUTS)))}
    with replacing_together(directory) as files:
        for name, kind in names.items():
            surface = result.mesh.vertices if key in kind.carries else image_of(coordinates)
            _write(files.open(name), kind, {**arrays, VERTICES: surface})
        for name, image in images.items():
            files.open(name).write(image)
        files.without((usual | _earlier(directory, stem)) - set(report["files"]))
        files.open(_REPORT).write(json.dumps(report, indent=2, allow_nan=False).encode() + b"\n")
        files.sync()
        with switching or nullcontext():
            return files.switch()
