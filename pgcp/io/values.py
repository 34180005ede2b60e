"""Values at the vertices of a mesh, in files of their own: NPZ, NPY, CSV, text, and those of FreeSurfer."""

from __future__ import annotations

import io
import re
import struct
from pathlib import Path

import numpy as np

from pgcp.errors import BadFileError
from pgcp.io.text import as_text, shown
from pgcp.types import Columns, FloatArray

_CURV = b"\xff\xff\xff"  # begins FreeSurfer's files of values, as of its old surfaces
_CURV_HEAD = 15
_NPY = b"\x93NUMPY"
VALUE_FILES = "a file .npz, .npy, .csv, .txt, or FreeSurfer's"  # what is read, in a word of help
_NOT_A_NAME = re.compile(r"\W+")


def read_values(path: str | Path, count: int) -> dict[str, np.ndarray]:
    """Values (count, ...) of every vertex by name, as a file holds them.

    An NPZ file: its arrays of numbers with a row for every vertex. An NPY file: its array, a row for every vertex. FreeSurfer's
    values, such as lh.sulc. Else text: a line for every vertex, numbers parted by commas, semicolons or blanks, perhaps after a
    line of names; ``#`` starts a comment.
    Raises BadFileError where a file is none of these, has another number of values, or one that is not finite.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as problem:
        raise BadFileError(f"{path}: the values cannot be read: {problem.strerror or problem}") from problem
    try:
        if path.suffix.lower() == ".npz":
            found = _of_npz(data, count)
        elif data.startswith(_NPY):
            found = {"value": _of_npy(data)}
        elif data.startswith(_CURV):
            found = _of_freesurfer(data)
        else:
            found = _of_text(as_text(data))
        return {name: _checked(name, values, count) for name, values in found.items()}
    except BadFileError as problem:
        raise BadFileError(f"{path}: {problem}") from problem


def table_of(values: Columns) -> FloatArray:
    """All of them side by side (count, C), in their order."""
    return np.column_stack([each.reshape(len(each), -1) for each in values.values()]).astype(np.float64)


def _checked(name: str, values: np.ndarray, count: int) -> np.ndarray:
    """Values of every vertex, all of them finite."""
    if len(values) != count:
        raise BadFileError(f"it holds values of {len(values)} vertices, and the mesh has {count}")
    if not np.isfinite(values).all():
        bad = int(np.argwhere(~np.isfinite(values))[0][0])
        raise BadFileError(f"{name} of vertex {bad} is no finite number")
    return values


def _of_npz(data: bytes, count: int) -> dict[str, np.ndarray]:
    """Arrays with a row for every vertex."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            there = {name: arrays[name] for name in arrays.files}
    except Exception as problem:
        raise BadFileError(f"it is no readable NPZ file ({type(problem).__name__})") from problem
    found = {name: values for name, values in there.items() if values.dtype.kind in "iufb" and len(values.shape) in (1, 2)}
    found = {_named(name): values for name, values in found.items() if len(values) == count}
    if not found:
        shapes = ", ".join(f"{name} {values.shape}" for name, values in there.items()) or "nothing"
        raise BadFileError(f"no array has a row for each of the {count} vertices; it holds {shapes}")
    return found


def _of_npy(data: bytes) -> np.ndarray:
    """An array of numbers."""
    try:
        values = np.load(io.BytesIO(data), allow_pickle=False)
    except Exception as problem:
        raise BadFileError(f"it is no readable NPY file ({type(problem).__name__})") from problem
    if values.dtype.kind not in "iufb" or len(values.shape) not in (1, 2) or not values.size:
        raise BadFileError(f"its array has shape {values.shape} and type {values.dtype}, no rows of numbers")
    return np.asarray(values)


def _of_freesurfer(data: bytes) -> dict[str, np.ndarray]:
    """Values in single precision, one a vertex."""
    if len(data) < _CURV_HEAD:
        raise BadFileError(f"the file ends after {len(data)} bytes, before its values")
    count, _, each = struct.unpack_from(">iii", data, len(_CURV))
    if each != 1 or count < 0 or len(data) < _CURV_HEAD + 4 * count:
        raise BadFileError(f"it promises {each} values at each of {count} vertices, but the file has {len(data)} bytes")
    return {"value": np.frombuffer(data, ">f4", count, _CURV_HEAD).astype(np.float32)}


def _of_text(text: bytes) -> dict[str, np.ndarray]:
    """Columns of numbers, perhaps below their names."""
    lines = [line.split(b"#", 1)[0] for line in text.split(b"\n")]
    rows = [re.split(rb"[,;\s]+", line.strip(b" \t,;")) for line in lines if line.strip()]
    if not rows:
        raise BadFileError("the file holds no values")
    names = [_named(word.decode("utf-8", "replace").strip('"')) for word in rows[0]] if not _are_numbers(rows[0]) else []
    body = rows[1:] if names else rows
    for number, row in enumerate(body, 2 if names else 1):
        if len(row) != len(rows[0]) or not _are_numbers(row):
            said = shown(b" ".join(row))
            raise BadFileError(f"line {number} of its values is not {len(rows[0])} numbers: {said}")
    table = np.array([[float(word) for word in row] for row in body]).reshape(len(body), len(rows[0]))
    width = table.shape[-1]
    names = names or (["value"] if width == 1 else [f"value_{k + 1}" for k in range(width)])
    if len(set(names)) < len(names):
        raise BadFileError(f"two columns have one name: {', '.join(names)}")
    return dict(zip(names, table.T, strict=True))


def _are_numbers(words: list[bytes]) -> bool:
    try:
        return bool([float(word) for word in words])
    except ValueError:
        return False


def _named(name: str) -> str:
    """A name that files can hold."""
    return _NOT_A_NAME.sub("_", name).strip("_") or "value"
