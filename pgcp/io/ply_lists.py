"""Rows with lists in binary PLY files: many of one shape at once, rows of changing shape one by one."""

from __future__ import annotations

import struct

import numpy as np

from pgcp.errors import BadFileError
from pgcp.io.ply_header import STRUCT, Element, place_of
from pgcp.io.text import joined, whole
from pgcp.types import FloatArray, IntArray

_RUN = 1024  # rows of lists of changing length that are read one by one at a time
_MOST_AHEAD = 1 << 22  # rows of one shape that are read at once
_LARGEST_ROW = 1 << 20


def _narrow(kind: np.dtype) -> type:
    """The smaller of two integer types that holds all values of a kind."""
    return np.int32 if np.can_cast(kind, np.int32) else np.int64


class Lists:
    """Rows with lists: many of one shape at once, rows of changing shape one by one."""

    def __init__(self, data: bytes, start: int, element: Element, order: str, wanted: str) -> None:
        self._data, self._start, self._element, self._order = data, start, element, order
        self._wanted = place_of(element, wanted) if wanted else -1
        self._counts = [struct.Struct(order + STRUCT[p.count_kind]) if p.count_kind else None for p in element.properties]
        self._items = [np.dtype(p.kind).itemsize for p in element.properties]
        self._row = 0
        self._ahead = _MOST_AHEAD
        self._sizes: list[IntArray] = []
        self._corners: list[IntArray] = []
        self._corner_count = 0
        self._numbers = [i for i, p in enumerate(element.properties) if not p.count_kind and wanted]
        self._values: dict[int, list[np.ndarray]] = {i: [] for i in self._numbers}

    def read(self) -> int:
        """Read all rows; returns where they end."""
        while self._row < self._element.count:
            if self._same_shape() < _RUN // 16:
                self._one_by_one(min(_RUN, self._element.count - self._row))
        return self._start

    def held(self) -> tuple[IntArray, IntArray, dict[str, np.ndarray]]:
        """Corners (C,) of all wanted lists, their lengths (N,), and the plain numbers (N,) beside them by name."""
        names = [p.name for p in self._element.properties]
        numbers = {names[i]: joined(parts, (0,), self._element.properties[i].kind) for i, parts in self._values.items()}
        return joined(self._corners, (0,), np.int32), joined(self._sizes, (0,), np.uint32), numbers

    def _keep(self, corners: np.ndarray) -> None:
        """Keep the corners (n,) of whole rows."""
        if corners.dtype.kind == "f":
            self._corners.append(whole_corners(corners, self._corner_count, [*self._sizes]))
        else:
            self._corners.append(corners.astype(_narrow(corners.dtype)))
        self._corner_count += len(corners)

    def _same_shape(self) -> int:
        """Read the rows from here on whose lists are as long as in the next row; returns how many."""
        lengths, size, _ = self._next_row()
        rows = min(self._element.count - self._row, (len(self._data) - self._start) // size, self._ahead)
        if size > _LARGEST_ROW:
            return 0
        kinds: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
        for i, (p, n) in enumerate(zip(self._element.properties, lengths, strict=True)):
            if p.count_kind:
                kinds += [(f"n{i}", self._order + p.count_kind), (f"p{i}", self._order + p.kind, (n,))]
            else:
                kinds.append((f"p{i}", self._order + p.kind))
        found = np.frombuffer(self._data, np.dtype(kinds), rows, self._start)
        same = np.ones(rows, bool)
        for i, n in enumerate(lengths):
            if self._counts[i]:
                same &= found[f"n{i}"] == n
        run = rows if same.all() else int(np.argmin(same))
        if self._wanted >= 0:
            self._sizes.append(np.full(run, lengths[self._wanted], np.uint32))
            self._keep(found[f"p{self._wanted}"][:run].reshape(-1))
            for i in self._numbers:
                self._values[i].append(found[f"p{i}"][:run].astype(self._element.properties[i].kind))
        self._ahead = min(_MOST_AHEAD, 4 * run + _RUN)
        self._row += run
        self._start += run * size
        return run

    def _next_row(self) -> tuple[list[int], int, list[int]]:
        """Lengths of the next row's lists (1 for plain numbers), its bytes, and where the values of each are."""
        lengths, at, places = [], self._start, []
        for i, (count, item) in enumerate(zip(self._counts, self._items, strict=True)):
            length = 1
            if count is not None:
                if at + count.size > len(self._data):
                    raise self._cut_off()
                (length,) = count.unpack_from(self._data, at)
                if length < 0:
                    name = f"{self._element.name} {self._row}, byte {at}: the list {self._element.properties[i].name}"
                    raise BadFileError(f"{name} has the length {length}, below zero")
                at += count.size
            places.append(at)
            at += length * item
            lengths.append(length)
        if at > len(self._data):
            raise self._cut_off()
        return lengths, at - self._start, places

    def _cut_off(self) -> BadFileError:
        return BadFileError(
            f"the file ends within {self._element.name} {self._row} of {self._element.count}, "
            f"which begins at byte {self._start} of {len(self._data)}"
        )

    def _one_by_one(self, rows: int) -> None:
        sizes: list[int] = []
        kept = {i: bytearray() for i in (self._wanted, *self._numbers)}
        for _ in range(rows):
            lengths, size, places = self._next_row()
            if self._wanted >= 0:
                sizes.append(lengths[self._wanted])
                for i in kept:
                    kept[i] += self._data[places[i] : places[i] + lengths[i] * self._items[i]]
            self._row += 1
            self._start += size
        if self._wanted < 0:
            return
        self._sizes.append(np.array(sizes, np.uint32))
        properties = self._element.properties
        self._keep(np.frombuffer(kept[self._wanted], self._order + properties[self._wanted].kind))
        for i in self._numbers:
            self._values[i].append(np.frombuffer(kept[i], self._order + properties[i].kind).astype(properties[i].kind))


def whole_corners(corners: FloatArray, before: int, sizes: list[IntArray]) -> IntArray:
    """Corners (n,) that are floats in the file; sizes: numbers of corners of all rows up to the last of these."""
    try:
        return whole(corners, "corner")
    except BadFileError:
        good = np.isfinite(corners) & (corners == np.floor(np.where(np.isfinite(corners), corners, 0.5)))
        bad = int(np.argmin(good)) if not good.all() else int(np.argmax(np.abs(corners)))
        face = int(np.searchsorted(np.cumsum(np.concatenate(sizes)), before + bad, "right"))
        raise BadFileError(f"face {face} has {corners[bad]:.17g} for a vertex number, which is not one") from None
