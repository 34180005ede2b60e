"""Read PLY, OBJ, STL, OFF and glTF, and files of cut edges."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pgcp.errors import BadFileError, InputError
from pgcp.types import FloatArray, IntArray, Mesh

_Arrays = tuple[FloatArray, IntArray]


def _read_ply(path: Path) -> _Arrays:
    from plyfile import PlyData, PlyListProperty

    with path.open("rb") as stream:
        header = PlyData._parse_header(stream)
    if "vertex" not in header or "face" not in header:
        missing = "vertex" if "vertex" not in header else "face"
        raise BadFileError(f"{path}: the PLY has no {missing} element, so no surface")
    lists = [p.name for p in header["face"].properties if isinstance(p, PlyListProperty)]
    names = [name for name in ("vertex_indices", "vertex_index") if name in lists]
    if not names:
        raise BadFileError(f"{path}: the PLY's face element has no list vertex_indices")
    if not {"x", "y", "z"} <= {p.name for p in header["vertex"].properties}:
        raise BadFileError(f"{path}: the PLY's vertices have no x, y, z")
    data: Any = PlyData.read(str(path), known_list_len={"face": {names[0]: 3}} if len(lists) == 1 else {})
    vertex, face = data["vertex"].data, data["face"].data[names[0]]
    vertices = np.column_stack([vertex["x"], vertex["y"], vertex["z"]]).astype(np.float64)
    if face.dtype == object:
        sizes = np.array([len(f) for f in face])
        if len(sizes) and (sizes != 3).any():
            bad = int(np.flatnonzero(sizes != 3)[0])
            raise BadFileError(_not_triangles(path, bad, int(sizes[bad]), int((sizes != 3).sum())))
        face = np.array(list(face), np.int64).reshape(-1, 3)
    return vertices, np.ascontiguousarray(face, np.int64)


def _not_triangles(path: Path, face: int, corners: int, count: int) -> str:
    return f"{path}: face {face} has {corners} corners and {count} faces in all are not triangles; triangulate the mesh first"


def _numbers(lines: list[bytes], path: Path, what: str) -> FloatArray:
    try:
        return np.array(b" ".join(lines).split(), dtype=np.float64)
    except ValueError as problem:
        raise BadFileError(f"{path}: a {what} line does not hold numbers: {problem}") from problem


def _read_obj(path: Path) -> _Arrays:
    lines = path.read_bytes().splitlines()
    vertex_lines = [line[2:] for line in lines if line[:2] in (b"v ", b"v\t")]
    face_rows = [(n, line[2:].split()) for n, line in enumerate(lines) if line[:2] in (b"f ", b"f\t")]
    if not vertex_lines:
        raise BadFileError(f"{path}: the file has no vertex lines; is it an OBJ file?")
    widths = {len(line.split()) for line in vertex_lines}
    if min(widths) < 3:
        raise BadFileError(f"{path}: a vertex line has fewer than three coordinates")
    if len(widths) > 1:
        vertex_lines = [b" ".join(line.split()[:3]) for line in vertex_lines]
        widths = {3}
    vertices = _numbers(vertex_lines, path, "vertex").reshape(len(vertex_lines), widths.pop())[:, :3]
    wrong = [(i, len(tokens)) for i, (_, tokens) in enumerate(face_rows) if len(tokens) != 3]
    if wrong:
        raise BadFileError(_not_triangles(path, wrong[0][0], wrong[0][1], len(wrong)))
    try:
        flat = [int(token.split(b"/", 1)[0]) for _, tokens in face_rows for token in tokens]
    except ValueError as problem:
        raise BadFileError(f"{path}: a face line does not hold vertex numbers: {problem}") from problem
    faces = np.array(flat, np.int64).reshape(-1, 3)
    if (faces == 0).any():
        bad = int(np.flatnonzero((faces == 0).any(axis=1))[0])
        raise BadFileError(f"{path}: face {bad} uses vertex 0, but OBJ numbers vertices from 1")
    if (faces < 0).any():
        vertex_rows = np.array([n for n, line in enumerate(lines) if line[:2] in (b"v ", b"v\t")])
        seen = np.searchsorted(vertex_rows, np.array([n for n, _ in face_rows]))
        faces = np.where(faces < 0, faces + seen[:, None] + 1, faces)
    return vertices, faces - 1


def _weld_duplicates(corners: FloatArray) -> _Arrays:
    """Faces from triangle soup (3F, 3): exactly equal positions are one vertex, in order of first use."""
    _, first, inverse = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int64)
    order = np.argsort(first)
    rank[order] = np.arange(len(first))
    return corners[first[order]], rank[inverse.reshape(-1)].reshape(-1, 3)


def _read_with_trimesh(path: Path) -> _Arrays:
    import trimesh

    loaded: Any = trimesh.load(str(path), process=False, force="mesh")
    if not isinstance(loaded, trimesh.Trimesh):
        raise BadFileError(f"{path}: the file holds no triangle mesh")
    return np.asarray(loaded.vertices, np.float64), np.asarray(loaded.faces, np.int64)


def _read_stl(path: Path) -> _Arrays:
    vertices, faces = _read_with_trimesh(path)
    return _weld_duplicates(vertices[faces.reshape(-1)])


_READERS: dict[str, Callable[[Path], _Arrays]] = {
    ".ply": _read_ply,
    ".obj": _read_obj,
    ".stl": _read_stl,
    ".off": _read_with_trimesh,
    ".glb": _read_with_trimesh,
    ".gltf": _read_with_trimesh,
}
READABLE = tuple(_READERS)


def read_mesh(path: str | Path) -> Mesh:
    """Read a triangle mesh by its file name's ending: .ply, .obj, .stl, .off, .glb, .gltf.

    Vertices and faces keep the file's order (STL has no vertices: exactly equal corners become one, in order of first
    use). Raises BadFileError where the file is no such mesh, InputError where its contents are no triangle mesh.
    """
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise BadFileError(f"{path}: cannot read {path.suffix or 'a file without ending'}; known are {', '.join(READABLE)}")
    if not path.is_file():
        raise BadFileError(f"{path}: there is no such file")
    if path.stat().st_size == 0:
        raise BadFileError(f"{path}: the file is empty")
    try:
        vertices, faces = reader(path)
    except InputError:
        raise
    except MemoryError as problem:
        raise BadFileError(f"{path}: the file claims more data than fits in memory") from problem
    except Exception as problem:  # any reader's complaint about a file is a bad file
        reason = str(problem).strip().splitlines()
        raise BadFileError(
            f"{path}: not a readable {path.suffix[1:].upper()} file ({reason[0] if reason else type(problem).__name__})"
        ) from problem
    return Mesh(vertices, faces, path.name)


def read_cuts(path: str | Path) -> IntArray:
    """Read cut edges (N, 2): one pair of vertex ids a line, from 0, blank or comma between; ``#`` starts a comment."""
    path = Path(path)
    if not path.is_file():
        raise BadFileError(f"{path}: there is no such file")
    rows = []
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        words = line.split("#", 1)[0].replace(",", " ").split()
        if not words:
            continue
        if len(words) != 2 or not all(word.lstrip("+").isdigit() for word in words):
            raise BadFileError(f"{path}: line {number} is not a pair of vertex ids: {line.strip()[:60]!r}")
        rows.append((int(words[0]), int(words[1])))
    if not rows:
        raise BadFileError(f"{path}: the file holds no cut edges")
    return np.array(rows, np.int64)
