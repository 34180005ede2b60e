"""The header of PLY files: elements and their properties."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from pgcp.errors import BadFileError
from pgcp.io.text import shown

_KINDS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
STRUCT = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I"}  # types of numbers that count
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MOST_PROPERTIES = 1000


@dataclass(frozen=True, slots=True)
class Property:
    """One property; count_kind: the type of a list's length, None for a plain number."""

    name: str
    kind: str
    count_kind: str | None


@dataclass(slots=True)
class Element:
    """One kind of rows."""

    name: str
    count: int
    properties: list[Property]

    @property
    def has_lists(self) -> bool:
        """Whether rows differ in size."""
        return any(p.count_kind for p in self.properties)

    @property
    def least_bytes(self) -> int:
        """Bytes of a binary row whose lists are empty."""
        return sum(np.dtype(p.count_kind or p.kind).itemsize for p in self.properties)


def header_of(data: bytes) -> tuple[str, list[Element], int, int]:
    """Byte order, elements, where the data begin, and the number of header lines."""
    first = re.match(rb"ply[ \t]*(\r\n|\n|\r)", data)
    if first is None:
        raise BadFileError(f"it does not begin with the line 'ply' but with {shown(data[:20])}")
    end = first[1]
    last = re.compile(rb"%b[ \t]*end_header[ \t]*(?:%b|\Z)" % (end, end)).search(data, first.start(1))
    if last is None:
        raise BadFileError("the PLY header has no end: there is no line 'end_header'")
    lines = data[: last.start()].split(end)
    order, elements = None, list[Element]()
    for number, line in enumerate(lines[1:], 2):
        words = line.decode("utf-8", "backslashreplace").split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) >= 2 and words[1] in _ORDERS:
            order = _ORDERS[words[1]]
        elif words[0] == "element" and len(words) == 3 and words[2].isascii() and words[2].isdigit() and len(words[2]) < 19:
            elements.append(Element(words[1], int(words[2]), []))
        elif words[0] == "property" and elements and (found := _property(words)):
            elements[-1].properties.append(found)
            if len(elements[-1].properties) > _MOST_PROPERTIES:
                raise BadFileError(f"line {number}: the element {words[1]} has more than {_MOST_PROPERTIES} properties")
        else:
            raise BadFileError(f"line {number}: not a line of a PLY header: {shown(line)}")
    if order is None:
        raise BadFileError("the PLY header has no format line")
    names = [element.name for element in elements]
    if len(set(names)) < len(names):
        raise BadFileError("the PLY header has two elements of one name")
    bare = next((element for element in elements if element.count and not element.properties), None)
    if bare is not None:
        raise BadFileError(f"the PLY's element {shown(bare.name.encode())} has no properties")
    return order, elements, last.end(), len(lines) + 1


def _property(words: list[str]) -> Property | None:
    if len(words) == 3 and words[1] in _KINDS:
        return Property(words[2], _KINDS[words[1]], None)
    if len(words) == 5 and words[1] == "list" and words[2] in _KINDS and words[3] in _KINDS:
        count = _KINDS[words[2]]
        return Property(words[4], _KINDS[words[3]], count) if count in STRUCT else None
    return None


def place_of(element: Element, name: str) -> int:
    """Which of an element's properties has a name."""
    return next(i for i, p in enumerate(element.properties) if p.name == name)
