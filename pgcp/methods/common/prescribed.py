"""What a user prescribes on the boundary: turning angles or lengths, in a text file of a line each."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pgcp.errors import BadFileError, InputError
from pgcp.types import FloatArray, IntArray

ANGLES, LENGTHS = "angles", "lengths"
_CLOSED_DEG = 1e-6
_SHOWN = 60


def of_boundary(value: str, words: tuple[str, ...], files: tuple[str, ...]) -> tuple[str, Path | None]:
    """What an option such as ``isometric`` or ``angles:FILE`` says: its word, and its file where it names one.

    Raises InputError where it is none of the words, nor one of ``files`` with a file.
    """
    word, colon, name = value.partition(":")
    if word in words and not colon:
        return word, None
    if word in files and name:
        return word, Path(name)
    known = ", ".join([*words, *(f"{word}:FILE" for word in files)])
    raise InputError(f"unknown boundary {value!r}; choose from {known}")


def _rows(path: Path, ids: int, what: str) -> list[tuple[int, list[int], float]]:
    """Line number, vertex ids and value of each line: blank or comma between, ``#`` starts a comment."""
    try:
        lines = path.read_text().splitlines()
    except OSError as problem:
        raise BadFileError(f"{path}: {problem.strerror}") from problem
    except UnicodeDecodeError as problem:
        raise BadFileError(f"{path}: the file is no text") from problem
    rows = []
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            vertices, value = [int(word) for word in words[:ids]], float(words[ids])
            if len(words) != ids + 1 or not np.isfinite(value):
                raise ValueError
        except (ValueError, IndexError):
            shown = line.strip()[:_SHOWN]
            raise BadFileError(f"{path}: line {number} is not {what}: {shown!r}") from None
        rows.append((number, vertices, value))
    if not rows:
        raise BadFileError(f"{path}: the file is empty; each line must be {what}")
    return rows


def _places(path: Path, loop: IntArray) -> dict[int, int]:
    return {vertex: place for place, vertex in enumerate(loop.tolist())}


def read_turning(path: Path, loop: IntArray | None = None) -> FloatArray:
    """Turning angles (n_B,), radians, from a file with a vertex id and degrees a line; vertices not named do not turn.

    loop (n_B,): the boundary; without it only the file's form is checked. Raises BadFileError where a line is none, a vertex is
    not on the boundary or named twice, an angle is 180 degrees or more, or they do not add up to 360.
    """
    rows = _rows(path, 1, "a vertex id and an angle in degrees")
    if loop is None:
        return np.empty(0)
    places, turning = _places(path, loop), np.zeros(len(loop))
    named: set[int] = set()
    for number, (vertex,), degrees in rows:
        if vertex not in places or vertex in named:
            why = "named twice" if vertex in named else "not on the boundary"
            raise BadFileError(f"{path}: line {number}: vertex {vertex} is {why}")
        if abs(degrees) >= 180.0:
            raise BadFileError(f"{path}: line {number}: the boundary cannot turn by {degrees} degrees, it must be under 180")
        named.add(vertex)
        turning[places[vertex]] = np.radians(degrees)
    total = float(np.degrees(turning.sum()))
    if abs(total - 360.0) > _CLOSED_DEG:
        raise BadFileError(f"{path}: the angles add up to {total:.9g} degrees, a boundary turns by 360 in all")
    return np.asarray(turning * (2.0 * np.pi / turning.sum()), np.float64)


def read_lengths(path: Path, loop: IntArray | None = None) -> FloatArray:
    """Lengths (n_B,) of the edges from each boundary vertex to the next, from a file with two vertex ids and a length a line.

    loop (n_B,): the boundary; without it only the file's form is checked. Raises BadFileError where a line is none, a pair is
    no boundary edge or named twice, a length is not above 0, or an edge is missing.
    """
    rows = _rows(path, 2, "two vertex ids and a length")
    if loop is None:
        return np.empty(0)
    places, lengths = _places(path, loop), np.zeros(len(loop))
    count = len(loop)
    for number, (one, other), length in rows:
        first, second = places.get(one, -2), places.get(other, -2)
        ahead = first >= 0 and (first + 1) % count == second
        if not ahead and not (second >= 0 and (second + 1) % count == first):
            raise BadFileError(f"{path}: line {number}: {one} {other} is no edge of the boundary")
        place = first if ahead else second
        if not length > 0.0:
            raise BadFileError(f"{path}: line {number}: an edge cannot be {length} long")
        if lengths[place]:
            raise BadFileError(f"{path}: line {number}: the edge {one} {other} is named twice")
        lengths[place] = length
    if not lengths.all():
        place = int(np.argmin(lengths))
        missing = f"{loop[place]} {loop[(place + 1) % count]}"
        raise BadFileError(
            f"{path}: {int((lengths == 0.0).sum())} of {count} boundary edges have no length, the first is {missing}"
        )
    return lengths
