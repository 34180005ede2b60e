"""All file formats by name: reading, writing, the choices of ``--write`` and the table in the docs come from here.

A format is registered by the file of this room that reads and writes it; these files are imported when formats are asked for.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from typing import IO, Any

from pgcp.errors import InputError
from pgcp.types import FloatArray, IntArray, Source

Beside = Callable[[str], bytes]
Arrays = Mapping[str, Any]
DEFAULT_OUTPUTS = ("npz", "obj", "ply")
VERTICES = "vertices"


@dataclass(frozen=True, slots=True)
class Format:
    """One kind of file, and how it is read and written.

    name: as ``--write`` has it; suffixes: in lower case with the dot, the first for files that are written; summary: a line
    for the documentation.
    read(data, beside): vertices (V, 3) float64 and faces (F, 3) integers from a file's bytes; ``beside(name)`` gives the bytes
    of another file of the same folder; raises BadFileError with a sentence. A Source is returned instead where a file holds
    polygons, or more than vertices and triangles. None where the format is not read.
    write(stream, arrays): writes "faces" (F, 3), and of the arrays named in ``carries`` those that there are. None where the
    format is not written. A key "in_doubles" says that coordinates should not be rounded to 32-bit floats.
    carries: which arrays a written file holds beside the faces: "vertices" (V, 3) of the surface; the map's coordinates, "uv"
    (V, 2) in the plane or "sphere" (V, 3); "patch" and "mu" (F,); "vertex_of" (V,) and "face_of" (F,) of a fixed mesh or a
    part; "polygon_of" and "component_of" (F,); what a
    Result measures by vertex or face, under its name; "normals" (V, 3) of the surface. Where a format has no place for the
    map's coordinates beside the vertices, they take the place of the vertices: the mesh is then the image of the map. With
    "uv_faces" (F, 3) a format numbers texture coordinates apart from vertices; without it vertices are repeated along cuts.
    "given" is a ``given.GivenParts``: polygons and all else that the input held.
    looks: a regular expression that matches how such files begin, and what they are called where their name is wrong.
    needs: packages, as they are installed, that reading or writing it needs and other formats do not; extra: the extra of
    pgcp that brings them; writes_alone: whether it is written without them.
    textured(stream, arrays, stem, png): writes the same with a picture as the surface's texture, in a file called ``stem``;
    returns the contents of files beside it by name. None where a format has no textures.
    beside(arrays): contents of files that go beside one without a picture, by name.
    is_told_by_content: whether a file whose name has a suffix of no format is one of these where it begins as ``looks`` says.
    is_exact: whether "uv" are the map's own coordinates, not those of the texture. sphere_radius: of the sphere, where the mesh
    is the image of the map.
    """

    name: str
    suffixes: tuple[str, ...]
    summary: str
    read: Callable[[bytes, Beside], tuple[FloatArray, IntArray] | Source] | None = None
    write: Callable[[IO[bytes], Arrays], None] | None = None
    carries: tuple[str, ...] = (VERTICES,)
    looks: tuple[bytes, str] | None = None
    needs: tuple[str, ...] = ()
    extra: str = ""
    writes_alone: bool = False
    textured: Callable[[IO[bytes], Arrays, str, bytes], dict[str, bytes]] | None = None
    beside: Callable[[Arrays], dict[str, bytes]] | None = None
    is_told_by_content: bool = False
    is_exact: bool = False
    sphere_radius: float = 1.0

    def check_packages(self, doing: str) -> None:
        """Raise InputError where a package is not installed that ``doing`` ("reading" or "writing") needs."""
        for name in () if doing == "writing" and self.writes_alone else self.needs:
            try:
                distribution(name)
            except PackageNotFoundError as problem:
                extra = f"'pgcp[{self.extra}]'" if self.extra else name
                raise InputError(
                    f"{doing} {self.suffixes[0]} needs the package {name}, which is not installed: pip install {extra}"
                ) from problem


FORMATS: dict[str, Format] = {}


def register(kind: Format) -> Format:
    """Add a format, or put it in the place of one of the same name; returns it."""
    for other in FORMATS.values():
        taken = set(kind.suffixes) & set(other.suffixes)
        if taken and other.name != kind.name:
            raise ValueError(f"the suffix {min(taken)} of the format {kind.name} is one of the format {other.name}")
    FORMATS[kind.name] = kind
    return kind


def formats() -> tuple[Format, ...]:
    """All formats, in the order of their names."""
    for module in pkgutil.iter_modules(importlib.import_module("pgcp.io").__path__):
        importlib.import_module(f"pgcp.io.{module.name}")
    return tuple(FORMATS[name] for name in sorted(FORMATS))


def readable() -> tuple[Format, ...]:
    """Formats that are read."""
    return tuple(kind for kind in formats() if kind.read is not None)


def writable() -> tuple[Format, ...]:
    """Formats that are written."""
    return tuple(kind for kind in formats() if kind.write is not None)


def of_name(name: str, kinds: Collection[Format]) -> Format | None:
    """The one of these formats that a file's name stands for: the longest suffix counts."""
    fitting = [(len(suffix), kind) for kind in kinds for suffix in kind.suffixes if name.lower().endswith(suffix)]
    return max(fitting, key=lambda found: found[0])[1] if fitting else None


def suffixes_of(kinds: Collection[Format]) -> str:
    """The suffixes of formats, as they can stand in a sentence."""
    return ", ".join(suffix for kind in kinds for suffix in kind.suffixes)


def outputs(names: Collection[str]) -> tuple[Format, ...]:
    """Formats to write, by name; raises InputError where there is no such format or its packages are missing."""
    known = {kind.name: kind for kind in writable()}
    chosen = []
    for name in names:
        if name not in known:
            raise InputError(f"unknown format {name!r} of results; choose from {', '.join(known)}")
        known[name].check_packages("writing")
        chosen.append(known[name])
    return tuple(chosen)
