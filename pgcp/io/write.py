"""Write meshes and maps. Files are written under temporary names and renamed when they are whole."""

from __future__ import annotations

import gzip
import io
import json
from collections.abc import Collection, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np

from pgcp.errors import BadFileError, InputError
from pgcp.io.coordinates import coordinates_of, image_of
from pgcp.io.files import FileSet, replacing, replacing_together
from pgcp.io.formats import DEFAULT_OUTPUTS, VERTICES, Arrays, Format, of_name, outputs, suffixes_of, writable
from pgcp.io.given import GivenParts, given_parts, vertex_normals
from pgcp.types import FloatArray, IntArray, Layout, Mesh, Parameterization

DRAWN = (".png", ".html")  # what others draw of a map: the picture and the page
_REPORT = "report.json"
_BY_VERTEX = ("log_scale",)
_MEASURES = (*_BY_VERTEX, "angle_error", "area_ratio")
_BESIDE = (".mtl", "_texture.png")  # an OBJ file's material and texture
PACKED = ".gz"
_SMALL, _TIMES = 1_000_000, 4
_ALWAYS = ("faces", "in_doubles")


def _write(stream: IO[bytes], kind: Format, arrays: Arrays, stem: str = "", png: bytes | None = None) -> dict[str, bytes]:
    """Write those of the arrays that the format carries, textured if there is a picture; returns files to go beside it."""
    assert kind.write is not None
    always = _ALWAYS[: 1 if kind.is_exact else 2]
    carried = {name: values for name, values in arrays.items() if name in always or name in kind.carries}
    if png is not None and kind.textured is not None and "uv" in carried:
        return kind.textured(stream, carried, stem, png)
    kind.write(stream, carried)
    return {} if kind.beside is None else kind.beside(carried)


def write_mesh(path: str | Path, mesh: Mesh, uv: FloatArray | None = None, *, sphere: FloatArray | None = None) -> None:
    """Write a mesh in its own order, in the format of the file name's ending, with coordinates of a map if given.

    uv (V, 2): coordinates in the plane, the customary texture coordinates; sphere (V, 3): coordinates on the unit sphere.
    Raises BadFileError where the format has no place for them, InputError where they have another shape.
    """
    path = Path(path)
    kind, arrays = _of_mesh(path, mesh, uv, sphere)
    with replacing(path) as stream:
        _write(stream, kind, arrays)


def mesh_files(
    name: str,
    mesh: Mesh,
    uv: FloatArray | None = None,
    *,
    sphere: FloatArray | None = None,
    png: bytes | None = None,
    given: GivenParts | None = None,
) -> dict[str, bytes]:
    """The contents of the file that ``write_mesh`` writes, and of those that go beside it, by name.

    png: the texture's picture; given: polygons and values by vertex, for formats that have a place for them.

    Raises what ``write_mesh`` raises.
    """
    kind, arrays = _of_mesh(Path(name), mesh, uv, sphere)
    if given is not None:
        arrays["given"] = given
    stream = io.BytesIO()
    beside = _write(stream, kind, arrays, Path(name).stem, png)
    return {name: stream.getvalue(), **beside}


def _of_mesh(path: Path, mesh: Mesh, uv: FloatArray | None, sphere: FloatArray | None) -> tuple[Format, dict[str, Any]]:
    """The format of a file's name, and the arrays of a mesh for it."""
    kinds = [kind for kind in writable() if VERTICES in kind.carries]
    kind = of_name(path.name, kinds)
    if kind is None:
        other = of_name(path.name, writable())
        ending = (other.suffixes[0] if other else path.suffix) or "a file without ending"
        raise BadFileError(f"{path}: cannot write {ending}; known are {suffixes_of(kinds)}")
    kind.check_packages("writing")
    arrays: dict[str, Any] = {VERTICES: mesh.vertices, "faces": mesh.faces}
    for name, values, columns in (("uv", uv, 2), ("sphere", sphere, 3)):
        if values is None:
            continue
        if np.shape(values) != (len(mesh.vertices), columns):
            raise InputError(f"{path}: {name} has shape {np.shape(values)}, expected {(len(mesh.vertices), columns)}")
        if name not in kind.carries:
            able = suffixes_of([other for other in kinds if name in other.carries])
            raise BadFileError(f"{path}: a {kind.suffixes[0]} file has no place for the coordinates {name}; choose from {able}")
        arrays[name] = np.asarray(values, np.float64)
    if "normals" in kind.carries:
        arrays["normals"] = _normals(mesh.vertices, mesh.faces)
    return kind, arrays


def _normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Unit normals (V, 3) from the faces around a vertex, weighted by area; (0, 0, 1) where there is none."""
    corners = vertices[faces] - vertices[faces[0, 0]]
    size = max(float(np.abs(corners).max()), 1e-300)
    corners /= size
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    out = np.empty_like(vertices)
    for axis in range(3):
        out[:, axis] = sum(np.bincount(corner, across[:, axis], len(vertices)) for corner in faces.T)
    length = np.linalg.norm(out, axis=1)
    out[length == 0.0] = [0.0, 0.0, 1.0]
    out /= np.where(length > 0.0, length, 1.0)[:, None]
    return out


def _normals_of(result: Parameterization) -> FloatArray:
    """Unit normals (V, 3), smooth across vertices that the input splits."""
    if result.origin is None:
        return _normals(result.mesh.vertices, result.mesh.faces)
    point_of = result.origin.point_of
    first = np.unique(point_of, return_index=True)[1]
    numbers = np.empty(int(point_of.max()) + 1, np.int64)
    numbers[point_of[first]] = np.arange(len(first))
    return _normals(result.mesh.vertices[first], numbers[point_of[result.mesh.faces]])[numbers[point_of]]


def _uncut(result: Parameterization) -> tuple[IntArray, IntArray] | None:
    """The vertices of a map without the copies that its cut has made: first (n,) of each, and their numbers (V,).

    None where nothing was cut. Vertices stay in order.
    """
    if result.origin is None:
        return None
    pairs = np.column_stack([result.origin.vertex_of, result.origin.point_of])
    first, numbers = np.unique(pairs, axis=0, return_index=True, return_inverse=True)[1:]
    if len(first) == len(pairs):
        return None
    order = np.argsort(first)
    place = np.empty(len(first), np.int64)
    place[order] = np.arange(len(first))
    return first[order], place[numbers.reshape(-1)]


def _arrays_for(kind: Format, result: Parameterization, layout: Layout | None) -> dict[str, Any]:
    """What a file of a format can hold of a map."""
    key, coordinates = coordinates_of(result)
    mesh = result.mesh
    patch = result.patch.astype(np.promote_types(np.int16, np.min_scalar_type(int(result.patch.max()))), copy=False)
    arrays: dict[str, Any] = {"faces": mesh.faces, "patch": patch, "mu": result.mu}
    given = given_parts(result.origin, mesh.faces)
    if given is not None:
        arrays["given"] = given
        if given.has_polygons:
            arrays["polygon_of"] = given.polygon_of
    if result.origin is not None and result.origin.component_of is not None:
        arrays["component_of"] = result.origin.component_of
    if result.vertex_of is not None and result.face_of is not None:
        arrays |= {"vertex_of": result.vertex_of, "face_of": result.face_of}
    arrays |= {name: getattr(result, name) for name in _MEASURES if name in kind.carries and hasattr(result, name)}
    if "normals" in kind.carries:
        own = None if given is None else vertex_normals(given)
        arrays["normals"] = _normals_of(result) if own is None else own
    if "uv_faces" in kind.carries and (whole := _uncut(result)) is not None and key == "uv":
        first, numbers = whole
        points, uv_faces = (coordinates, mesh.faces) if layout is None else (layout.points, layout.faces)
        if given is not None:
            arrays["given"] = replace(given, vertex_of=given.vertex_of[first], faces=numbers[mesh.faces])
        arrays |= {"faces": numbers[mesh.faces], VERTICES: mesh.vertices[first], "uv": points, "uv_faces": uv_faces}
        if (result.report if layout is None else layout.record).get("single_precision_folds"):
            arrays["in_doubles"] = np.empty(0)
        return arrays
    on_texture = layout is not None and not kind.is_exact and "uv" in kind.carries and (key == "uv" or key not in kind.carries)
    said = result.report if layout is None or not on_texture else {**result.report, **layout.record}
    if said.get("single_precision_folds"):
        arrays["in_doubles"] = np.empty(0)
    if not on_texture or layout is None:
        arrays[key] = coordinates
        arrays[VERTICES] = mesh.vertices if key in kind.carries else image_of(coordinates, kind.sphere_radius)
        return arrays
    arrays |= {VERTICES: mesh.vertices, "uv": layout.points}
    if not len(layout.copies):
        return arrays
    if "uv_faces" in kind.carries:
        return {**arrays, "uv_faces": layout.faces}
    arrays["faces"] = layout.faces
    if given is not None:
        arrays["given"] = given.with_copies(layout.copies, layout.faces)
    repeated = [name for name in arrays if name in (VERTICES, "normals", *_BY_VERTEX)]
    return {**arrays, **{name: np.concatenate([arrays[name], arrays[name][layout.copies]]) for name in repeated}}


def _earlier(directory: Path, stem: str) -> set[str]:
    """Files of a stem that an earlier run's report says it wrote here."""
    names = {f"{stem}{suffix}" for kind in writable() for suffix in kind.suffixes[:1]} | {f"{stem}{end}" for end in _BESIDE}
    try:
        said = json.loads((directory / _REPORT).read_bytes())["files"]
        return names.intersection(name for name in said if isinstance(name, str))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return set()


def write_outputs(
    directory: Path,
    stem: str,
    result: Parameterization,
    drawn: Mapping[str, bytes],
    switching: AbstractContextManager[object] | None = None,
    kinds: Collection[str] = DEFAULT_OUTPUTS,
    layout: Layout | None = None,
    texture: bytes | None = None,
) -> list[Path]:
    """Write a map in formats of these names, drawings and report.json into a directory made as needed; returns the paths.

    Coordinates that would be folded in 32-bit floats are written as doubles where the format can hold them. drawn: contents of
    files by suffix, those of ``DRAWN`` that are wanted. What an earlier run wrote of these files and this one does not is
    removed; of formats that are not written by default those that its report names. The report is the last path and names all
    files.
    layout: texture coordinates, the map's own where there is none; texture: a PNG, for formats that have textures.

    All are written and on the disk before the first takes the place of an earlier one, inside ``switching``; a failure
    before that leaves everything as it was.
    """
    chosen = outputs(kinds)
    names = {f"{stem}{kind.suffixes[0]}": kind for kind in chosen}
    images = {f"{stem}{suffix}": data for suffix, data in drawn.items()}
    usual = {f"{stem}{suffix}" for suffix in (*DRAWN, *(kind.suffixes[0] for kind in outputs(DEFAULT_OUTPUTS)))}
    with replacing_together(directory) as files:
        beside = dict(images)
        for name, kind in names.items():
            beside |= _write(files.open(name), kind, _arrays_for(kind, result, layout), stem, texture)
        for name, data in beside.items():
            files.open(name).write(data)
        report = {**result.report, "texture": said_of(layout), "files": [*names, *beside, _REPORT]}
        files.without((usual | _earlier(directory, stem)) - set(report["files"]))
        files.open(_REPORT).write(json.dumps(report, indent=2, allow_nan=False).encode() + b"\n")
        files.sync()
        with switching or nullcontext():
            return files.switch()


def have_textures(kinds: Collection[str], paths: Sequence[Path]) -> bool:
    """Whether any of these formats, by name, or files has texture coordinates, and not only the map's own."""
    of_paths = [kind for kind, _ in map(kind_of, paths) if kind is not None]
    return any("uv" in kind.carries and not kind.is_exact for kind in (*outputs(kinds), *of_paths))


def said_of(layout: Layout | None) -> dict[str, Any]:
    """What the report says of texture coordinates."""
    return {"kind": "surface"} if layout is None else layout.record


def within(kinds: Collection[str], result: Parameterization, size: int) -> tuple[str, ...]:
    """Those of the usual formats whose files together have no more than four times ``size`` bytes, that of the mesh's file.

    What is left out is OBJ, which holds twice as much as all others. Small files get all.
    """
    vertices, faces = len(result.mesh.vertices), len(result.mesh.faces)
    digits = len(str(vertices))
    about = {
        "npz": 20 * vertices + 30 * faces,
        "ply": 32 * vertices + 13 * faces,
        "obj": 62 * vertices + (6 * digits + 8) * faces,
    }
    if size < _SMALL or sum(about.get(name, 0) for name in kinds) <= _TIMES * size:
        return tuple(kinds)
    return tuple(name for name in kinds if name != "obj")


def kind_of(path: Path) -> tuple[Format | None, bool]:
    """The format that a file's name asks for, and whether it is to be packed; None for what is drawn.

    Raises BadFileError where the name says no format, InputError where its packages are missing.
    """
    name = path.name.lower()
    packed = name.endswith(PACKED)
    name = name.removesuffix(PACKED)
    if name.endswith(DRAWN) and not packed:
        return None, False
    kind = of_name(name, writable())
    if kind is None:
        known = f"{suffixes_of(writable())}, all with {PACKED} too, and {', '.join(DRAWN)}"
        raise BadFileError(f"{path}: its name does not say what to write; known are {known}")
    kind.check_packages("writing")
    return kind, packed


def map_files(name: str, result: Parameterization, layout: Layout, png: bytes) -> dict[str, bytes]:
    """The contents of a map's file of this name with a texture, and of those that go beside it, by name.

    layout: texture coordinates; png: the texture's picture. Raises BadFileError where the name says no format of textures.
    """
    kind = kind_of(Path(name))[0]
    if kind is None or kind.textured is None:
        raise BadFileError(f"{name}: files of this kind have no texture")
    stream = io.BytesIO()
    beside = _write(stream, kind, _arrays_for(kind, result, layout), Path(name).stem, png)
    return {name: stream.getvalue(), **beside}


def _is_other(path: Path, kind: Format, texture: bytes | None) -> bool:
    """Whether a material file of the input would take the place of a file that was there before."""
    return kind.beside is not None and texture is None and path.exists()


def write_files(
    paths: Sequence[Path],
    result: Parameterization,
    drawn: Mapping[str, bytes] | None = None,
    switching: AbstractContextManager[object] | None = None,
    layout: Layout | None = None,
    texture: bytes | None = None,
) -> list[Path]:
    """Write a map into files whose names say what they are; returns their paths, and those of files that belong to them.

    Names that end in .gz are packed. drawn: contents by suffix for names that end so. All are written before the first takes
    the place of an earlier one, inside ``switching``.
    Raises BadFileError where a name says no format.
    """
    sets: dict[Path, FileSet] = {}
    beside_of: set[Path] = set()
    with ExitStack() as stack:
        for path in paths:
            if path.parent not in sets:
                sets[path.parent] = stack.enter_context(replacing_together(path.parent))
            files, (kind, packed) = sets[path.parent], kind_of(path)
            if kind is None:
                files.open(path.name).write((drawn or {})[path.suffix.lower()])
                continue
            stem = path.name[: -len(PACKED)] if packed else path.name
            stem = stem[: -max(len(suffix) for suffix in kind.suffixes if stem.lower().endswith(suffix))]
            stream, arrays = files.open(path.name), _arrays_for(kind, result, layout)
            if packed:
                with gzip.GzipFile("", "wb", 6, stream, 0) as smaller:  # type: ignore[arg-type]
                    beside = _write(smaller, kind, arrays, stem, texture)  # type: ignore[arg-type]
            else:
                beside = _write(stream, kind, arrays, stem, texture)
            for name, data in beside.items():
                if path.parent / name not in beside_of and not _is_other(path.parent / name, kind, texture):
                    files.open(name).write(data)
            beside_of |= {path.parent / name for name in beside}
        for files in sets.values():
            files.sync()
        with switching or nullcontext():
            return [path for files in sets.values() for path in files.switch()]
