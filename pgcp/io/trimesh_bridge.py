"""The package trimesh: finished maps as its meshes, and the formats that are read and written through it.

trimesh is imported where it is used: runs that read and write the usual formats do without it.
"""

from __future__ import annotations

import io
import logging
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from pgcp.errors import BadFileError
from pgcp.io.coordinates import coordinates_of
from pgcp.io.formats import Arrays, Beside, Format, register
from pgcp.io.soup import weld_duplicates
from pgcp.io.text import joined
from pgcp.io.unpack import check_unpacked_size
from pgcp.types import FloatArray, IntArray, Parameterization

if TYPE_CHECKING:
    import trimesh

_COLLADA = ("dae", "zae")  # trimesh gives three vertices to each of their faces
_LONGEST = 200  # characters of another package's message
# what trimesh warns of and what has no bearing on the triangles
_HARMLESS = re.compile("texture|bumpmap|shininess|metadata")


def as_trimesh(arrays: Arrays) -> trimesh.Trimesh:
    """A trimesh of "vertices" and "faces" in their order, "uv" (V, 2) as its texture coordinates if they are there."""
    import trimesh

    visual = trimesh.visual.TextureVisuals(uv=np.asarray(arrays["uv"])) if "uv" in arrays else None
    return trimesh.Trimesh(np.asarray(arrays["vertices"]), np.asarray(arrays["faces"]), visual=visual, process=False)


def to_trimesh(result: Parameterization) -> trimesh.Trimesh:
    """The surface of a finished map as a trimesh, vertices and faces in their order.

    Coordinates in the plane are its texture coordinates, ``visual.uv``; coordinates on the sphere are in ``vertex_attributes``,
    as "sphere". ``face_attributes`` has "patch" and "mu".
    """
    name, values = coordinates_of(result)
    mesh = as_trimesh({"vertices": result.mesh.vertices, "faces": result.mesh.faces, name: values})
    if name != "uv":
        mesh.vertex_attributes[name] = values
    mesh.face_attributes.update(patch=result.patch, mu=result.mu)
    return mesh


def write_by_trimesh(stream: IO[bytes], arrays: Arrays, kind: str) -> None:
    """Write arrays in a format that trimesh exports; in glTF it writes 1 - v for v, which there points down."""
    data = as_trimesh(arrays).export(file_type=kind)
    stream.write(data if isinstance(data, bytes) else data.encode())


def read_by_trimesh(data: bytes, _beside: Beside, kind: str) -> tuple[FloatArray, IntArray]:
    """Vertices (V, 3) and faces (F, 3) of all meshes of a file, in the order and at the places of its scene.

    Where the format numbers no vertices, exactly equal corners are one, in order of first use. No other file is opened. Raises
    BadFileError with one sentence for what trimesh cannot read, and for what it would leave out.
    """
    check_unpacked_size(data)
    with _one_sentence():
        from trimesh.exchange.load import mesh_loaders

        collada = kind in _COLLADA
        options = {"ignore_broken": False} if collada else {}
        vertices, faces = _placed(mesh_loaders[kind](file_obj=io.BytesIO(data), file_type=kind, resolver=None, **options))
    return weld_duplicates(vertices[faces].reshape(-1, 3)) if collada else (vertices, faces)


def _placed(loaded: Mapping[str, Any]) -> tuple[FloatArray, IntArray]:
    """Vertices and faces of a mesh, or of a scene, as trimesh's loaders describe them."""
    import trimesh

    if "geometry" not in loaded:
        return np.asarray(loaded["vertices"], np.float64), np.asarray(loaded["faces"])
    # without process=False here, trimesh merges and drops vertices
    bare = {
        name: {"vertices": one["vertices"], "faces": one["faces"], "process": False} for name, one in loaded["geometry"].items()
    }
    scene = trimesh.load_scene({**loaded, "geometry": bare})
    vertices: list[FloatArray] = []
    faces: list[IntArray] = []
    count = 0
    for node in scene.graph.nodes_geometry:
        place, name = scene.graph[node]
        points = np.asarray(bare[name]["vertices"], np.float64).reshape(-1, 3)
        corners = np.asarray(bare[name]["faces"]).reshape(-1, 3)
        if len(corners) and not 0 <= corners.min() <= corners.max() < len(points):
            raise BadFileError(f"its mesh {name} uses vertices that it does not have")
        vertices.append(points @ place[:3, :3].T + place[:3, 3])
        faces.append((corners if np.linalg.det(place[:3, :3]) >= 0 else corners[:, ::-1]) + count)
        count += len(points)
    return joined(vertices, (0, 3), np.float64), joined(faces, (0, 3), np.int64)


class _Heard(logging.Handler):
    """Keeps what is said."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep one message."""
        self.messages.append(record.getMessage())


@contextmanager
def _one_sentence() -> Iterator[None]:
    """Make a BadFileError of whatever trimesh raises, and of its warnings that something is left out."""
    logger, heard = logging.getLogger("trimesh"), _Heard()
    passing, logger.propagate = logger.propagate, False
    logger.addHandler(heard)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", ".*could not be read to its end", DeprecationWarning)
            yield
    except (BadFileError, MemoryError):
        raise
    except Exception as problem:
        raise BadFileError(f"trimesh cannot read it: {_reason(problem)}") from problem
    finally:
        logger.removeHandler(heard)
        logger.propagate = passing
    lost = next((message for message in heard.messages if not _HARMLESS.search(message)), None)
    if lost is not None:
        raise BadFileError(f"trimesh cannot read all of it: {' '.join(lost.split())}")


def _reason(problem: Exception) -> str:
    """Kind and text of an error in one short line."""
    kind, text = type(problem).__name__, " ".join(str(problem).split())
    return f"{kind}: {text.removeprefix(f'{kind}: ')}"[:_LONGEST] if text else kind


def _through_trimesh(name: str, summary: str, needs: tuple[str, ...], carries: tuple[str, ...] = ()) -> Format:
    return Format(
        name=name,
        suffixes=(f".{name}",),
        summary=f"{summary}, through trimesh",
        read=partial(read_by_trimesh, kind=name),
        write=partial(write_by_trimesh, kind=name) if carries else None,
        carries=carries,
        looks=(rb"\s*<(?!!|html|head)" if name in ("dae", "xaml") else rb"PK\x03\x04", name.upper()),
        needs=needs,
        extra="formats",
    )


for _format in (
    _through_trimesh("3mf", "3D Manufacturing Format: vertices and triangles of all its objects", ("lxml",), ("vertices",)),
    _through_trimesh("dae", "COLLADA: exactly equal corners become one vertex", ("pycollada",), ("vertices", "uv")),
    _through_trimesh("zae", "COLLADA in a zip archive", ("pycollada",)),
    _through_trimesh("xaml", "the mesh geometries of a XAML scene", ("lxml",)),
):
    register(_format)
