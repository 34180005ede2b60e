"""Read meshes and files of cut edges. A file is refused with one sentence, whatever it is."""

from __future__ import annotations

import os
import re
import stat
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from pgcp.errors import BadFileError
from pgcp.io.formats import Format, of_name, readable, suffixes_of
from pgcp.io.missing import explain_missing
from pgcp.io.text import as_text, shown
from pgcp.io.unpack import GZIP, unpacked_gzip
from pgcp.polygons.triangulate import triangulated
from pgcp.types import IntArray, Mesh, Source

STANDARD_INPUT = "-"
_PACKED = ".gz"
# what a file that cannot be read may be instead; the first that fits is named
_LOOKS = (
    (rb"\s*version https://git-lfs", "a git-LFS pointer and not the data; fetch them with 'git lfs pull'"),
    (rb"\s*<(?:!doctype html|html|head)", "an HTML page, perhaps that of a failed download"),
    (rb"\s*<\?xml|\s*<[a-z]", "XML or HTML text"),
    (rb"\x1f\x8b", "gzip data; let its name end in .gz"),
    (rb"PK\x03\x04", "a zip archive; unpack it first"),
    (rb"BZh|\xfd7zXZ|7z\xbc\xaf|\x28\xb5\x2f\xfd", "compressed data; unpack them first"),
    (rb"\xff\xfe|\xfe\xff", "UTF-16 text; save it as UTF-8 or ascii"),
    (rb"%PDF|\x89PNG|\xff\xd8\xff|GIF8", "a picture or a document"),
    (rb"\s*[{\[]", "JSON text, perhaps a server's answer"),
)


def _instead(data: bytes, kind: Format | None = None) -> str:
    """What a file looks like that is not of the format of its name, or nothing."""
    start = data[:1024].removeprefix(b"\xef\xbb\xbf")
    if kind is not None and kind.looks and re.match(kind.looks[0], start, re.IGNORECASE):
        return ""
    others = ((other.looks[0], f"{other.looks[1]}; name it {other.suffixes[0]}") for other in readable() if other.looks)
    return next((what for pattern, what in (*_LOOKS, *others) if re.match(pattern, start, re.IGNORECASE)), "")


def _refuse_other_things(path: Path) -> None:
    """Raise BadFileError where a path leads to no file, whatever its ending."""
    try:
        there, folder = os.path.lexists(path), path.is_dir()
    except (OSError, ValueError):
        return  # opening it says why
    if folder:
        raise BadFileError(f"{path}: it is a folder; name a file in it")
    if not there:
        raise BadFileError(f"{path}: {explain_missing(path)}")


def _contents(path: Path) -> bytes:
    """All bytes of a regular file; raises BadFileError where there is none, without waiting for pipes or devices."""
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except FileNotFoundError as problem:
        raise BadFileError(f"{path}: {explain_missing(path)}") from problem
    except (OSError, ValueError) as problem:
        reason = getattr(problem, "strerror", None) or str(problem)
        raise BadFileError(f"{str(path)!r}: the file cannot be opened: {reason}") from problem
    try:
        mode = os.fstat(handle).st_mode
        if not stat.S_ISREG(mode):
            what = "folder; name a file in it" if stat.S_ISDIR(mode) else "pipe or device, not a file"
            raise BadFileError(f"{path}: it is a {what}")
        with os.fdopen(handle, "rb", closefd=False) as stream:
            return stream.read()
    except OSError as problem:
        raise BadFileError(f"{path}: the file cannot be read: {problem.strerror}") from problem
    finally:
        os.close(handle)


def _beside(path: Path, name: str) -> bytes:
    """The bytes of a file in the folder of ``path``; raises BadFileError for any other."""
    folder = path.parent.resolve()
    try:
        other = (folder / name).resolve()
    except (OSError, ValueError) as problem:
        raise BadFileError(f"its buffer {shown(name.encode('utf-8', 'replace'))} has no possible name") from problem
    if other.parent != folder:
        raise BadFileError(f"its buffer {shown(name.encode('utf-8', 'replace'))} lies outside the mesh's folder")
    return _contents(other)


def read_mesh(path: str | Path) -> Mesh:
    """Read a mesh in the format of its file name's ending, one of ``formats.readable``; polygons are cut into triangles.

    Vertices and faces keep the file's order (where a format numbers no vertices, as STL, exactly equal corners become one,
    in order of first use). Raises BadFileError and InputError as ``read_source`` does.
    """
    return triangulated(read_source(path)).mesh


def stem_of(path: Path) -> str:
    """The name of a mesh's file without the suffix that says its format, and without .gz; whole where no format has it."""
    if str(path) == STANDARD_INPUT:
        return "stdin"
    name = path.name[: -len(_PACKED)] if path.suffix.lower() == _PACKED else path.name
    ends = [suffix for kind in readable() for suffix in kind.suffixes if name.lower().endswith(suffix)]
    return name[: -max(map(len, ends))] or name if ends else name


def read_source(path: str | Path) -> Source:
    """Read all that a file says of a surface; polygons and vertices are as in the file.

    The ending of its name says the format, or its first bytes where no format has that ending. Files whose name ends in .gz
    are unpacked, and ``-`` stands for a PLY file on the standard input. Raises BadFileError where the file is no such mesh,
    InputError where its contents are no triangle mesh or a package is needed to read it.
    """
    path = Path(path)
    try:
        if str(path) == STANDARD_INPUT:
            return _parsed(Path("stdin.ply"), sys.stdin.buffer.read())
        _refuse_other_things(path)
        _kind_of(path, None)
        return _parsed(path, _contents(path))
    except MemoryError as problem:
        raise BadFileError(f"{path}: the file holds more than fits in memory") from problem


def _parsed(path: Path, data: bytes) -> Source:
    """What the bytes of a file of this name say."""
    if not data:
        raise BadFileError(f"{path}: the file is empty")
    packed = path.suffix.lower() == _PACKED
    bare = path.with_suffix("") if packed else path
    if packed:
        try:
            data = unpacked_gzip(data)
        except BadFileError as problem:
            instead = "" if data.startswith(GZIP) else _instead(data)
            raise BadFileError(f"{path}: {problem}{f'; it looks like {instead}' if instead else ''}") from problem
    kind = _kind_of(bare, data)
    assert kind is not None and kind.read is not None
    try:
        found = kind.read(data, partial(_beside, path))
    except BadFileError as problem:
        instead = _instead(data, kind)
        looks = f"; it looks like {instead}" if instead else ""
        suffix = bare.suffix if bare.suffix.lower() in kind.suffixes else kind.suffixes[0]
        what = f"a readable {suffix[1:].upper()} file" if not kind.is_told_by_content else "a readable FreeSurfer surface"
        raise BadFileError(f"{path}: not {what}: {problem}{looks}") from problem
    if isinstance(found, Source):
        return replace(found, name=bare.name)
    vertices, faces = found
    for what, values in (("vertices", vertices), ("faces", faces)):
        if values.ndim != 2 or values.shape[1] != 3:
            raise BadFileError(f"{path}: its {what} have the shape {values.shape}, expected three columns")
    return Source(vertices, faces.reshape(-1), name=bare.name)


def _kind_of(path: Path, data: bytes | None) -> Format | None:
    """The format of a file by its name, else by its first bytes, where they are known; its packages are there.

    Raises BadFileError where there is none, and where the name alone rules all out.
    """
    kinds = readable()
    name = path.name[: -len(_PACKED)] if path.suffix.lower() == _PACKED else path.name
    kind = of_name(name, kinds)
    told = [other for other in kinds if other.is_told_by_content and other.looks]
    if kind is None and data is not None:
        kind = next((other for other in told if other.looks and re.match(other.looks[0], data)), None)
    if kind is not None:
        kind.check_packages("reading")
    elif data is not None or not told:
        suffix = Path(name).suffix
        raise BadFileError(f"{path}: cannot read {suffix or 'a file without ending'}; known are {suffixes_of(kinds)}")
    return kind


def read_cuts(path: str | Path) -> IntArray:
    """Read cut edges (N, 2) as ``read_pairs`` does."""
    return read_pairs(path, "cut edges")


def read_pairs(path: str | Path, what: str) -> IntArray:
    """Read pairs of vertex ids (N, 2), ``what`` they are: one a line, from 0, blank or comma between; ``#`` starts a comment.

    Raises BadFileError where a line is no such pair, or there is none.
    """
    path = Path(path)
    data = _contents(path)
    try:
        lines = as_text(data).split(b"\n")
    except BadFileError as problem:
        instead = _instead(data)
        raise BadFileError(f"{path}: {problem}{f'; it looks like {instead}' if instead else ''}") from problem
    rows = []
    for number, line in enumerate(lines, 1):
        words = line.split(b"#", 1)[0].replace(b",", b" ").split()
        if not words:
            continue
        if len(words) != 2 or not all(word.removeprefix(b"+").isdigit() for word in words):
            raise BadFileError(f"{path}: line {number} is not a pair of vertex ids: {shown(line.strip())}")
        if max(map(len, words)) > 15:
            raise BadFileError(f"{path}: line {number} has a vertex id that no mesh has: {shown(line.strip())}")
        rows.append((int(words[0]), int(words[1])))
    if not rows:
        raise BadFileError(f"{path}: the file holds no {what}")
    return np.array(rows, np.int64)
