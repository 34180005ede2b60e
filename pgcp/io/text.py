"""Numbers in text files: rows of a huge file, read and written block by block, and where a row is wrong."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import orjson

from pgcp.errors import BadFileError
from pgcp.types import FloatArray, IntArray

_BLOCK = 1 << 22
_TENS = 10.0 ** np.arange(23)  # exact, all of them
CHUNK = 50_000  # rows that are written at once
_SHOWN = 40
_EXACT = 2.0**53  # whole numbers up to here are told from each other in float64
_DECIMAL_COMMA = re.compile(rb"[+-]?\d*,\d+(?:[eE][+-]?\d+)?,?")
Rows = tuple[Sequence[int], list[bytes]]  # line numbers from 1, and the lines


def shown(token: bytes) -> str:
    """A piece of a file as it can stand in a sentence."""
    text = token.decode("utf-8", "backslashreplace")
    return repr(text if len(text) <= _SHOWN else text[:_SHOWN] + "...")


def as_text(data: bytes) -> bytes:
    """Text with line ends ``\\n`` and without a byte order mark; raises BadFileError where bytes are no text."""
    if data.startswith(b"\xef\xbb\xbf"):
        data = data[3:]
    zero = data.find(b"\0")
    if zero >= 0:
        raise BadFileError(f"byte {zero} is zero: this is binary data, not text")
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return data


def line_blocks(text: bytes, first_line: int = 1, comment: bytes = b"") -> Iterator[Rows]:
    """Lines that are not blank, some megabytes at a time; what follows ``comment`` in a line is left out."""
    start, number = 0, first_line
    while start < len(text):
        end = text.find(b"\n", min(start + _BLOCK, len(text)))
        end = len(text) if end < 0 else end + 1
        lines = text[start:end].removesuffix(b"\n").split(b"\n")
        numbers: Sequence[int] = range(number, number + len(lines))
        if comment and text.find(comment, start, end) >= 0:
            lines = [line.split(comment, 1)[0] for line in lines]
        number, start = number + len(lines), end
        if not all(map(bytes.strip, lines)):
            kept = [(n, line) for n, line in zip(numbers, lines, strict=True) if line.strip()]
            numbers, lines = [n for n, _ in kept], [line for _, line in kept]
        if lines:
            yield numbers, lines


class RowReader:
    """Hands out the rows of a text in order."""

    def __init__(self, text: bytes, first_line: int = 1, comment: bytes = b"") -> None:
        self._blocks = line_blocks(text, first_line, comment)
        self._numbers: Sequence[int] = ()
        self._rows: list[bytes] = []

    def take(self, count: int, what: str) -> Iterator[Rows]:
        """Hand out the next ``count`` rows block by block; raises BadFileError where the text ends before."""
        left = count
        while left:
            if not self._rows:
                following = next(self._blocks, None)
                if following is None:
                    raise BadFileError(f"the file ends after {count - left} of the {count} {what} it promises")
                self._numbers, self._rows = following
            size = min(left, len(self._rows))
            yield self._numbers[:size], self._rows[:size]
            self._numbers, self._rows = self._numbers[size:], self._rows[size:]
            left -= size


def parse(rows: list[bytes], kind: Any = np.float64) -> np.ndarray | None:
    """All numbers of the rows, one after the other, or None where something is no number."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)
            return np.fromstring(b" ".join(rows), dtype=kind, sep=" ")  # type: ignore[call-overload]
    except (ValueError, DeprecationWarning):
        return None


def widths(rows: list[bytes]) -> list[int]:
    """How many values each row has."""
    return [len(row.split()) for row in rows]


def table(numbers: Sequence[int], rows: list[bytes], columns: int, what: str, exact: bool = False) -> FloatArray:
    """The first ``columns`` numbers of every row (N, columns); with ``exact`` a row has no more than these.

    Raises BadFileError naming the first line that does not hold them.
    """
    counts = widths(rows)
    if min(counts) < columns or (exact and max(counts) > columns):
        bad = next(i for i, c in enumerate(counts) if c < columns or (exact and c > columns))
        few = "fewer than three coordinates" if columns == 3 and not exact else f"{counts[bad]} values where {columns} belong"
        reason = f"line {numbers[bad]}: a {what} line with {few}: {shown(rows[bad].strip())}"
        raise BadFileError(_comma(rows[bad], numbers[bad]) or reason)
    if min(counts) == max(counts):
        flat = parse(rows)
        if flat is not None and len(flat) == len(rows) * counts[0]:
            return flat.reshape(len(rows), counts[0])[:, :columns]
    rows = [b" ".join(row.split()[:columns]) for row in rows]
    flat = parse(rows)
    if flat is not None and len(flat) == len(rows) * columns:
        return flat.reshape(len(rows), columns)
    raise not_a_number(numbers, rows, what)


def not_a_number(numbers: Sequence[int], rows: list[bytes], what: str) -> BadFileError:
    """The error that names the first value that is no number, and its line."""
    for number, row in zip(numbers, rows, strict=True):
        for token in row.split():
            if not _is_number(token):
                return BadFileError(
                    _comma(token, number) or f"line {number}: the {what} line does not hold numbers: {shown(token)}"
                )
    return BadFileError(f"lines {numbers[0]} to {numbers[-1]}: the {what} lines do not hold numbers")


def _is_number(token: bytes) -> bool:
    try:
        float(token)
    except ValueError:
        return False
    return b"_" not in token


def _comma(row: bytes, number: int) -> str:
    token = next((t for t in row.split() if _DECIMAL_COMMA.fullmatch(t)), None)
    if token is None:
        return ""
    return f"line {number}: {shown(token)} looks like a number with a decimal comma; numbers here have a decimal point"


def joined(parts: list[Any], shape: tuple[int, ...], kind: Any) -> Any:
    """Parts of an array one after the other; without any, an empty array of this shape and kind."""
    return parts[0] if len(parts) == 1 else np.concatenate([np.empty(shape, kind), *parts])


def whole(values: FloatArray, what: str, first: int = 0) -> IntArray:
    """Whole numbers from floats, row by row; raises BadFileError naming the first row with another number."""
    good = np.isfinite(values) & (np.abs(values) <= _EXACT)
    good &= np.where(good, values, 0.5) == np.floor(np.where(good, values, 0.5))
    if not good.all():
        bad = int(np.flatnonzero(~good.reshape(len(good), -1).all(axis=1))[0])
        seen = np.atleast_1d(values[bad])[~np.atleast_1d(good[bad])][0]
        raise BadFileError(f"{what} {first + bad} has {seen:.17g} for a vertex number, which is not one")
    return values.astype(np.int64)


def ragged(starts: IntArray, sizes: IntArray) -> IntArray:
    """Places (C,) of rows of these sizes, one after the other, that begin at these places."""
    step = np.arange(int(sizes.sum())) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return np.asarray(np.repeat(starts, sizes) + step)


def nine_digits(values: FloatArray) -> FloatArray:
    """Values (n, d) rounded to nine digits, those between 1e-14 and 1e9: a whole number over an exact power of ten each."""
    with np.errstate(divide="ignore"):
        places = 8.0 - np.floor(np.log10(np.abs(values)))
    near = (places >= 0.0) & (places < len(_TENS))
    tens = _TENS[np.where(near, places, 0.0).astype(np.int8)]
    return np.where(near, np.rint(values * tens) / tens, values)


def as_lines(head: bytes, rows: np.ndarray, between: bytes = b" ") -> bytes:
    """Rows (n, d) as lines of text after the word ``head``, their numbers parted by the letters of ``between`` in turn."""
    head += b" " if head else b""
    text = orjson.dumps(rows, option=orjson.OPT_SERIALIZE_NUMPY)[2:-2].replace(b"],[", b"\n" + head)
    letters = np.frombuffer(bytearray(text), np.uint8)
    commas = np.flatnonzero(letters == ord(","))
    for k, letter in enumerate(between):
        letters[commas[k :: len(between)]] = letter
    return head + letters.tobytes() + b"\n"
