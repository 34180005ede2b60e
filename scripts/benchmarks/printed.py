"""The tables of three papers as they are printed, from printed.json, and how a figure of ours compares with a printed one."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

FILE = Path(__file__).with_name("printed.json")
FAILED = "failed"
ACCURACY = ("mean", "sd", "median", "iqr", "energy", "area")  # figures of which less is better, and that no machine changes
_SUFFIX = {"K": 1_000, "M": 1_000_000}


@dataclass(frozen=True, slots=True)
class Entry:
    """What a table prints of one surface and method.

    vertices: as printed, in brackets where another table of the paper prints them, empty where none does; label: the method as
    the paper calls it; options: the run of ours that stands beside it; values: printed figures by what they measure, None for
    one that is not legible, empty for one that this method has not.
    """

    table: str
    target: str
    surface: str
    vertices: str
    label: str
    options: Mapping[str, Any]
    values: Mapping[str, str | None]


@dataclass(frozen=True, slots=True)
class Table:
    """One table: heads of the printed columns by what they measure, its entries in the order of the paper, remarks on it."""

    key: str
    title: str
    columns: Mapping[str, str]
    entries: tuple[Entry, ...]
    notes: tuple[str, ...] = ()

    @property
    def is_speedup(self) -> bool:
        """Whether numbers of subdomains are compared instead of methods."""
        return "speedup" in self.columns

    @property
    def targets(self) -> list[str]:
        """Targets in the order of the table."""
        return list(dict.fromkeys(entry.target for entry in self.entries))


@dataclass(frozen=True, slots=True)
class Printed:
    """All tables by key; papers: what the beginning of a key stands for; models: names of files of the same model by surface;
    like: names of files of surfaces that are merely alike.
    """

    tables: Mapping[str, Table]
    papers: Mapping[str, str]
    models: Mapping[str, list[str]] = field(default_factory=dict)
    like: Mapping[str, list[str]] = field(default_factory=dict)

    def names(self, surface: str) -> list[str]:
        """Names that a file of this surface may have: its own in small letters, and those of the same model."""
        return [re.sub(r"\W+", "_", surface.lower()), *self.models.get(surface, [])]


def load(path: Path = FILE) -> Printed:
    """Read the data; raises ValueError where a row has not as many figures as its table has columns."""
    data = json.loads(path.read_text(encoding="utf-8"))
    tables = {key: (_speedups if "target" in one else _methods)(key, one) for key, one in data["tables"].items()}
    return Printed(tables, data["papers"], data["models"], data["like"])


def _methods(key: str, data: Mapping[str, Any]) -> Table:
    columns = {measure: head for head, measure in data["columns"]}
    entries, width = [], len(columns)
    for target, rows in data["rows"].items():
        for surface, vertices, *figures in rows:
            if len(figures) != width * len(data["methods"]):
                raise ValueError(f"{key}, {surface}: {len(figures)} figures for {len(data['methods'])} methods of {width}")
            for number, (label, options) in enumerate(data["methods"]):
                values = dict(zip(columns, figures[number * width : (number + 1) * width], strict=True))
                entries.append(Entry(key, target, surface, vertices, label, options, values))
    return Table(key, data["title"], columns, tuple(entries), tuple(data.get("notes", ())))


def _speedups(key: str, data: Mapping[str, Any]) -> Table:
    columns = {measure: head for head, measure in data["columns"]}
    entries = []
    for row in data["rows"]:
        values, count = dict(zip(columns, row, strict=True)), int(row[0])
        options = {"patches": count, "workers": count}
        entries.append(Entry(key, data["target"], data["surface"], data["vertices"], f"n = {count}", options, values))
    return Table(key, data["title"], columns, tuple(entries), tuple(data.get("notes", ())))


def count_of(vertices: str) -> tuple[int, int] | None:
    """A printed number of vertices and the unit of its last digit: 48K is (48000, 1000); None of an empty one."""
    bare = vertices.strip("()").replace(",", "").replace(" ", "")
    if not bare:
        return None
    unit = _SUFFIX.get(bare[-1], 1)
    return int(bare.rstrip("KM")) * unit, unit


def fits(vertices: str, count: int) -> bool:
    """Whether a mesh with so many vertices may be the printed one: the number rounds to what is printed."""
    printed = count_of(vertices)
    return printed is not None and abs(count - printed[0]) <= (printed[1] // 2)


@dataclass(frozen=True, slots=True)
class Verdict:
    """Ours beside a printed figure: what ours is more by, and the unit of the printed figure's last digit."""

    more: float
    unit: float

    @property
    def is_equal(self) -> bool:
        """Whether ours rounds to what is printed."""
        return abs(self.more) <= 0.5 * self.unit + 1e-12

    @property
    def is_worse(self) -> bool:
        """Whether ours is larger, and does not round to what is printed."""
        return self.more > 0 and not self.is_equal

    @property
    def is_clear(self) -> bool:
        """Whether the difference is more than one unit of the last digit."""
        return abs(self.more) > self.unit + 1e-12


def compare(printed: str, ours: float) -> Verdict:
    """How a figure of ours compares with a printed one; below a bound such as <0.1 they are equal."""
    bare = printed.lstrip("<")
    unit = 10.0 ** -len(bare.partition(".")[2])
    more = ours - float(bare)
    return Verdict(max(more, 0.0) if bare != printed else more, unit)
