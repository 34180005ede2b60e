"""What OBJ files say beside vertices and faces: objects, groups, materials, normals."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from pgcp.errors import BadFileError
from pgcp.io.formats import Beside
from pgcp.io.text import parse, table
from pgcp.types import FloatArray, IntArray

_WORDS = (b"o", b"g", b"s", b"usemtl", b"mtllib")
_HEADS = {b"o ", b"o\t", b"o", b"g ", b"g\t", b"g", b"s ", b"s\t", b"us", b"mt"}
_COLOURED = 6  # numbers of a vertex with a colour


def is_marked(heads: Collection[bytes]) -> bool:
    """Whether some of the lines that begin so may hold statements on objects, groups or materials."""
    return not _HEADS.isdisjoint(heads)


def marks_of(heads: Sequence[bytes], lines: Sequence[bytes], f: Sequence[int], before: int) -> list[tuple[int, bytes]]:
    """Statements on what faces belong to, with the number of the face that each stands before.

    f: which lines are faces; before: how many faces came earlier.
    """
    found = [i for i, head in enumerate(heads) if head in _HEADS]
    places = (before + np.searchsorted(f, found)).tolist()
    named = ((place, lines[i].split(None, 1)) for place, i in zip(places, found, strict=True))
    return [(place, b" ".join(words).strip()) for place, words in named if words and words[0] in _WORDS]


def parts_of(marks: Sequence[tuple[int, bytes]], count: int) -> tuple[tuple[str, ...], IntArray | None]:
    """Names of objects and groups, and which of them each face (count, 2) belongs to: object and group, -1 for none."""
    names: dict[str, int] = {}
    of_face = np.full((count, 2), -1)
    for level, kind in enumerate((b"o", b"g")):
        places, numbers = [-1], [-1]
        for place, line in marks:
            word, _, name = line.partition(b" ")
            if word == kind:
                label = name.strip().decode("utf-8", "replace")
                places.append(place)
                numbers.append(names.setdefault(label, len(names)) if label else -1)
        of_face[:, level] = np.array(numbers)[np.searchsorted(places, np.arange(count), "right") - 1]
    return (tuple(names), of_face) if names else ((), None)


def libraries_of(marks: Sequence[tuple[int, bytes]], beside: Beside) -> dict[str, bytes]:
    """Contents of the material files that are named and there."""
    out = {}
    for _, line in marks:
        if line.startswith(b"mtllib "):
            whole = line[7:].strip().decode("utf-8", "replace")
            for name in (whole, *whole.split()):
                if name in out or Path(name).name != name or not name.lower().endswith(".mtl"):
                    continue
                with suppress(BadFileError):  # the surface does without
                    out[name] = beside(name)
                    if name == whole:
                        break
    return out


def colours_of(numbers: Sequence[int], rows: list[bytes]) -> FloatArray | None:
    """Colours (n, 3) of vertex lines, where all have them."""
    if not rows or len(rows[0].split()) < _COLOURED or min(len(row.split()) for row in rows) < _COLOURED:
        return None
    return table(numbers, rows, _COLOURED, "vertex")[:, 3:]


def normals_of(rows: list[bytes], sizes: IntArray, before: IntArray) -> IntArray | None:
    """Numbers from 0 of the normals of corners, where all have one: what follows the second slash.

    sizes (N,): numbers of corners of faces; before (N,): how many normals stand before each.
    """
    letters = np.frombuffer(b" " + b" ".join(rows) + b" ", np.uint8)
    blank, slash = letters <= 32, letters == ord("/")
    slashes = np.cumsum(slash)
    since = slashes - slashes[np.maximum.accumulate(np.where(blank, np.arange(len(letters)), 0))]
    flat = parse([letters[blank | ((since == 2) & ~slash)].tobytes()], np.int64)
    if flat is None or len(flat) != int(sizes.sum()):
        return None
    return np.where(flat < 0, flat + np.repeat(before, sizes), flat - 1)
