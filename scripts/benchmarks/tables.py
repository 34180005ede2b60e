#!/usr/bin/env python3
"""The tables of the papers PGCP, CDCP and CCEM, each row as it is printed beside ours.

usage: tables.py [--meshes DIR]... [--results FILE] [--table KEY]... [--format text|markdown|latex] [--limit N] [--repeat 1]
                 [--patience SECONDS] [--output FILE]
Keys are pgcp-1 to pgcp-8, cdcp-1, cdcp-2 and ccem-1; without --table all are made. What the papers print is in printed.json.
Ours are measured on the meshes in the folders DIR, with at most N vertices, by the method of the same name. A surface of the
paper is told by the name and the number of vertices of a file (names of the same model are in printed.json); where it is not
there, the nearest stands beside it, and this is said: another mesh of the same model, or one of nearly as many vertices (at
most twice or half). Of --repeat runs the least time counts; one that takes longer than --patience seconds is stopped, which is
said. --results FILE keeps what was measured: it is not measured again, and without --meshes nothing is.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from columns import aligned, as_latex, as_markdown, latex_text
from measured import Job, Measuring, Results, Surface, find_surfaces, is_closed, machine, say
from printed import ACCURACY, FAILED, Entry, Printed, Table, Verdict, compare, count_of, fits, load

SAME = "the same"
_MODEL_FACTOR, _SIZE_FACTOR = 20.0, 2.0
_SHOWN = {  # measures of ours: head, format
    "mean": ("mean", ".4f"),
    "sd": ("sd", ".4f"),
    "median": ("median", ".4f"),
    "iqr": ("iqr", ".4f"),
    "area": ("area", ".4f"),
    "energy": ("energy", ".5f"),
    "seconds": ("seconds", ".2f"),
    "folds": ("folds", "d"),
    "iterations": ("iterations", "d"),
}
_ALWAYS = ("mean", "sd", "seconds", "folds", "energy")


@dataclass(frozen=True, slots=True)
class Beside:
    """A printed entry, the surface of ours that it is compared on, how near that is, and the run; None where there is none."""

    entry: Entry
    surface: Surface | None
    relation: str
    run: Mapping[str, Any] | None

    @property
    def is_same(self) -> bool:
        """Whether ours was measured on the paper's own mesh."""
        return self.relation == SAME and self.run is not None


def nearest(printed: Printed, entry: Entry, surfaces: Sequence[Surface]) -> tuple[Surface, str] | None:
    """Which of our surfaces stands beside a printed one, and how near it is: see the text above."""
    fitting = [one for one in surfaces if one.closed == is_closed(entry.target)]
    named = [one for one in fitting if one.name in printed.names(entry.surface)]
    counted = count_of(entry.vertices)
    if same := [one for one in named if fits(entry.vertices, one.vertices)]:
        return same[0], SAME
    if counted is None:
        others = named or [one for one in fitting if one.name in printed.like.get(entry.surface, ())]
        return (
            (max(others, key=lambda one: one.vertices), "nearest, same model" if named else "nearest, alike")
            if others
            else None
        )

    def factor(one: Surface) -> float:
        """How many times more vertices the larger has."""
        return max(one.vertices / counted[0], counted[0] / one.vertices)

    for others, most, relation in ((named, _MODEL_FACTOR, "same model"), (fitting, _SIZE_FACTOR, "in size")):
        near = min(others, key=factor, default=None)
        if near is not None and factor(near) <= most:
            return near, relation
    return None


def put_beside(printed: Printed, table: Table, results: Results) -> list[Beside]:
    """Ours beside every entry of a table."""
    out = []
    for entry in table.entries:
        found = nearest(printed, entry, list(results.surfaces.values()))
        surface, relation = found or (None, "")
        out.append(Beside(entry, surface, relation, surface and results.run(surface, entry.target, entry.options)))
    return out


def shown(measure: str, run: Mapping[str, Any] | None) -> str:
    """A figure of ours, a dash where there is none."""
    value = None if run is None else run.get(measure)
    return "-" if value is None else format(value, _SHOWN[measure][1])


def ours_on(row: Beside) -> str:
    """The surface of ours, and whether it is the paper's."""
    if row.surface is None:
        return "-"
    name, count = row.surface.name, f"{row.surface.vertices:,} vertices"
    return name if row.relation == SAME else f"nearest: {name}, {count} ({row.relation})"


def remark(row: Beside) -> str:
    """Why there is no map, or a map elsewhere."""
    return "" if row.run is None else row.run.get("problem") or row.run.get("remark", "")


def rows_of(table: Table, rows: Sequence[Beside]) -> list[list[str]]:
    """Heads and rows of a table: what is printed, then ours; what repeats the row above is left out."""
    measures = [*(name for name in table.columns if name not in _ALWAYS), *_ALWAYS]
    where = ["target"] if len(table.targets) > 1 else []
    heads = [*where, "surface", "vertices", "method", *table.columns.values(), "ours on"]
    out = [[*heads, *(f"our {_SHOWN[name][0]}" for name in measures), "remark"]]
    before: list[str] = []
    for row in rows:
        entry = row.entry
        first = [*([entry.target] if where else []), entry.surface, entry.vertices]
        figures = ["?" if value is None else value for value in entry.values.values()]
        on, repeats = ours_on(row), before[: len(first)] == first
        told = [""] * len(first) if repeats else first
        same_mesh = "as above" if repeats and before[-1] == on and on != "-" else on
        out.append([*told, entry.label, *figures, same_mesh, *(shown(name, row.run) for name in measures), remark(row)])
        before = [*first, on]
    return out


def speedup_rows(table: Table, rows: Sequence[Beside]) -> list[list[str]]:
    """Table 6 of PGCP: printed speedups, then ours."""
    out = [
        [*table.columns.values(), "ours on", "our workers", "our vertices / n", "our seconds", "our S_n", "our E_n", "remark"]
    ]
    base = next((row.run.get("seconds") for row in rows if row.run and row.entry.options["patches"] == 2), None)
    for row in rows:
        run, count = row.run or {}, row.entry.options["patches"]
        seconds, size = run.get("seconds"), row.surface and row.surface.vertices / count
        speed = base / seconds if base and seconds else None
        ours = [str(run.get("workers", "-")), f"{size:,.0f}" if size else "-", shown("seconds", run)]
        ours += ["-", "-"] if speed is None else [f"{speed:.2f}", f"{speed / (count / 2):.2f}"]
        out.append([*(value or "?" for value in row.entry.values.values()), ours_on(row), *ours, remark(row)])
    return out


def verdicts(rows: Sequence[Beside]) -> Iterator[tuple[Beside, str, str, Verdict]]:
    """Of entries on the same mesh: measure, printed figure, and how ours compares."""
    for row in rows:
        if row.is_same and row.run is not None:
            for measure, value in row.entry.values.items():
                if measure in ACCURACY and value and value != FAILED and row.run.get(measure) is not None:
                    yield row, measure, value, compare(value, row.run[measure])


def lost(rows: Sequence[Beside]) -> list[str]:
    """Methods that fail, fold or go elsewhere on the same mesh where the paper has a map, and the other way round."""
    out = []
    for row in rows:
        if row.is_same and row.run is not None:
            fails, failed = "problem" in row.run, FAILED in row.entry.values.values()
            name = f"{row.entry.table}, {row.entry.surface}, {row.entry.label}"
            if fails and not failed:
                out.append(f"{name}: ours has no map ({row.run['problem']})")
            if failed and not fails:
                out.append(f"{name}: the paper has no map, ours has")
            if row.run.get("folds"):
                out.append(f"{name}: {row.run['folds']} folds in ours")
    return out


def differences(rows: Sequence[Beside]) -> list[list[str]]:
    """What is better or worse than printed on the same mesh, the largest losses in last digits first."""
    found = [one for one in verdicts(rows) if not one[3].is_equal]
    out = [["table", "target", "surface", "method", "figure", "printed", "ours", "ours less printed", "ours is"]]
    for row, measure, value, verdict in sorted(found, key=lambda one: -one[3].more / one[3].unit):
        kind = "worse" if verdict.is_worse else "better"
        told = kind if verdict.is_clear else f"{kind}, by one in the last digit at most"
        names = [row.entry.table, row.entry.target, row.entry.surface, row.entry.label, measure]
        out.append([*names, value, shown(measure, row.run), f"{verdict.more:+.5f}", told])
    return out


def in_short(rows: Sequence[Beside]) -> list[str]:
    """How many figures on the same meshes are better and worse, and how the seconds compare, as sentences."""
    found = [verdict for *_, verdict in verdicts(rows)]
    worse, better = [v for v in found if v.is_worse], [v for v in found if not v.is_equal and not v.is_worse]
    equal = len(found) - len(worse) - len(better)
    out = [
        f"On the same meshes, {len(found)} printed figures of accuracy have one of ours beside them. Rounded as printed, ours "
        f"is equal in {equal}, better in {len(better)} and worse in {len(worse)}. By more than one unit of the last digit it "
        f"is better in {sum(v.is_clear for v in better)} and worse in {sum(v.is_clear for v in worse)}."
    ]
    by_table: dict[str, list[float]] = {}
    for row in rows:
        value = row.entry.values.get("seconds")
        if row.is_same and row.run is not None and "problem" not in row.run and value and value != FAILED:
            by_table.setdefault(f"{row.entry.table}, {row.entry.label}", []).append(row.run["seconds"] / float(value))
    if by_table:
        ratios = "; ".join(f"{name} {median(values):.2f}" for name, values in by_table.items())
        out.append(f"Seconds of ours by those printed, medians over the same meshes, on another machine: {ratios}.")
    return [*out, *lost(rows)]


_SAID = (
    "Every run is one call of `pgcp.compute` on a mesh in memory, in threads of one process, after an uncounted run "
    "on the smallest mesh. The method is ours of the same name: bff, ccem, cdcp, cem, cetm, fdcp, ffgcm, flash, ldm "
    "(for LDM and LDCP), pgcp, scp. Moebius corrections are off (`--moebius none`), but for CDCP, whose algorithm has "
    "one, and for the last method of PGCP Table 7 (`--moebius area`).",
    "Mean and sd are those of the absolute angle errors in degrees, over all corners (PGCP eq. 5.1, CDCP eq. 7). Area "
    "is the mean of |d_area| over all faces (PGCP eq. 6.1). Energy is E_C = E_D - A on the unit disk (CCEM eq. 2.4 "
    "and 3.4); that of a map with a free boundary is scaled to the area of the unit disk, and a map to the sphere has "
    "none. Folds are faces whose area in the map is not positive.",
    "A file named alone under *ours on* is the paper's own mesh, as far as its name and the number of vertices, "
    "rounded as printed, tell. Other rows do not compare accuracy: *same model* is another mesh of the model, *in "
    "size* another surface of nearly as many vertices, *alike* one of the same kind. A dash says that no mesh is "
    "near, or that it was not measured; a question mark, that the copy of the paper is not legible. Numbers of "
    "vertices in brackets are printed in another table of the paper.",
)


def how_measured(results: Results, rows: Sequence[Beside], papers: Sequence[str]) -> list[str]:
    """What the reader has to know, as paragraphs."""
    said = ["Made by `scripts/benchmarks/tables.py`. The printed figures are those of " + "; ".join(papers) + "."]
    runs, here = [row.run for row in rows if row.run is not None], results.machine
    if not runs:
        return [*said, "Nothing of ours was measured."]
    dates, loads = sorted({run["date"] for run in runs}), sorted(run["load"] for run in runs)
    when = dates[0] if len(dates) == 1 else f"{dates[0]} to {dates[-1]}"
    versions = ", ".join(f"{name} {number}" for name, number in here["versions"].items())
    where = f"{here['processor']}, {here['processors']} processors, {here['system']}; {versions}"
    spread = f"{loads[0]} to {loads[-1]}, {median(loads)} in the middle"
    load = f"The load, a mean over a minute that counts the run itself, was {spread}."
    busy = (
        " Above the number of processors others took a share, and the seconds are too many."
        if loads[-1] > here["processors"]
        else ""
    )
    return [*said, f"Ours were measured on {where}; {when}. {load}{busy}", *_SAID]


Block = tuple[str, Any]  # title, section, text, list or table, and what it holds


def document(printed: Printed, results: Results, keys: Sequence[str]) -> list[Block]:
    """What is written, block by block."""
    papers = [text for name, text in printed.papers.items() if any(key.startswith(name) for key in keys)]
    beside = {key: put_beside(printed, printed.tables[key], results) for key in keys}
    everything = [row for rows in beside.values() for row in rows]
    out: list[Block] = [("title", "Tables of the papers, printed and ours")]
    out += [("text", paragraph) for paragraph in how_measured(results, everything, papers)]
    for key, rows in beside.items():
        table = printed.tables[key]
        out += [("section", table.title), *(("text", note) for note in table.notes)]
        out.append(("table", speedup_rows(table, rows) if table.is_speedup else rows_of(table, rows)))
    out += [("section", "Better and worse"), ("list", in_short(everything))]
    found = differences(everything)
    return [*out, ("table", found)] if len(found) > 1 else out


def written(blocks: Sequence[Block], form: str) -> str:
    """The blocks as text, Markdown or LaTeX."""
    ways: dict[str, dict[str, Callable[[Any], str]]] = {
        "text": {"title": str, "section": str, "text": _plain, "table": aligned, "list": _plain_list},
        "markdown": {"title": "# {}".format, "section": "## {}".format, "text": _escaped, "table": as_markdown, "list": _list},
        "latex": {
            "title": lambda held: rf"\section*{{{_latex_text(held)}}}",
            "section": lambda held: rf"\subsection*{{{_latex_text(held)}}}",
            "text": _latex_text,
            "table": as_latex,
            "list": _latex_list,
        },
    }
    return "\n\n".join(ways[form][kind](held) for kind, held in blocks) + "\n"


def _plain(text: str) -> str:
    return text.replace("`", "").replace("*", "")


def _escaped(text: str) -> str:
    return text.replace("|", "\\|")


def _latex_text(text: str) -> str:
    return latex_text(_plain(text))


def _list(lines: Sequence[str]) -> str:
    return "\n".join(f"- {_escaped(line)}" for line in lines)


def _plain_list(lines: Sequence[str]) -> str:
    return "\n".join(f"- {_plain(line)}" for line in lines)


def _latex_list(lines: Sequence[str]) -> str:
    return "\n".join([r"\begin{itemize}", *(rf"\item {_latex_text(line)}" for line in lines), r"\end{itemize}"])


def measure(printed: Printed, keys: Sequence[str], results: Results, arguments: argparse.Namespace) -> None:
    """Find the surfaces, and run what is missing, first what is compared on the paper's own meshes."""
    files = find_surfaces(arguments.meshes, arguments.limit)
    results.surfaces |= {surface.name: surface for surface in files}
    results.machine = machine()
    own, others = list[Job](), list[Job]()
    for key in keys:
        for entry in printed.tables[key].entries:
            if found := nearest(printed, entry, list(results.surfaces.values())):
                (own if found[1] == SAME else others).append((found[0], entry.target, entry.options))
    measuring = Measuring(files, results, arguments.repeat, arguments.patience, say)
    measuring.run(own, arguments.results)
    measuring.run(others, arguments.results)


def main(words: Sequence[str] | None = None) -> None:
    printed = load()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=Path, action="append", default=[])
    parser.add_argument("--results", type=Path)
    parser.add_argument("--table", choices=list(printed.tables), action="append")
    parser.add_argument("--format", choices=("text", "markdown", "latex"), default="text")
    parser.add_argument("--limit", type=int)
    parser.add_argument("--repeat", type=int, default=1)
    parser.add_argument("--patience", type=float)
    parser.add_argument("--output", type=Path)
    arguments = parser.parse_args(words)
    keys = [key for key in printed.tables if arguments.table is None or key in arguments.table]
    results = Results.read(arguments.results)
    if arguments.meshes:
        measure(printed, keys, results, arguments)
    text = written(document(printed, results, keys), arguments.format)
    if arguments.output is None:
        print(text, end="")
    else:
        arguments.output.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
