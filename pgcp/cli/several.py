"""Several meshes in one command: each is mapped, whatever becomes of the others, and a table says how they came out."""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pgcp.cli.failures import of_a_bug, stopped, told_as
from pgcp.cli.progress import Silent
from pgcp.cli.summary import record
from pgcp.cli.terminal import BAD_INPUT, BUG, GOOD, NUMERICAL, STOPPED, Signals, complain, say
from pgcp.cli.usage import UsageError

if TYPE_CHECKING:
    from pgcp.result import Result

SEVERITY = (GOOD, BAD_INPUT, NUMERICAL, STOPPED, BUG)  # of exit statuses, the worst last
_OUTCOMES = {BAD_INPUT: "refused", NUMERICAL: "failed", STOPPED: "stopped", BUG: "a bug"}
_OF_ONE = ("output", "compare", "cuts", "centre")

One = Callable[[argparse.Namespace], "tuple[Result, Path, list[Path]]"]


def check_several(arguments: argparse.Namespace) -> None:
    """Raise UsageError for options that go with one mesh only."""
    for name in _OF_ONE:
        if getattr(arguments, name) not in (None, []):
            raise UsageError(f"--{name} goes with one mesh, and {len(arguments.meshes)} are named")


def names_of(meshes: list[Path]) -> list[str]:
    """A name for the results of each mesh: its stem; where others have it too, more of its path, or a number."""
    from pgcp.io.read import stem_of

    ways: list[Callable[[Path], str]] = [
        lambda mesh: mesh.name,
        lambda mesh: f"{mesh.absolute().parent.name}_{stem_of(mesh)}",
        lambda mesh: f"{mesh.absolute().parent.name}_{mesh.name}",
    ]
    names = [stem_of(mesh) for mesh in meshes]
    for way in ways:
        known = Counter(name.casefold() for name in names)
        names = [name if known[name.casefold()] == 1 else way(mesh) for mesh, name in zip(meshes, names, strict=True)]
    seen: Counter[str] = Counter()
    for k, name in enumerate(names):
        seen[name.casefold()] += 1
        names[k] = name if seen[name.casefold()] == 1 else f"{name}_{seen[name.casefold()]}"
    return names


def each_alone(arguments: argparse.Namespace) -> Iterator[argparse.Namespace]:
    """The arguments of a command for every mesh alone, with the folder of its results where there are several."""
    if len(arguments.meshes) < 2:
        yield arguments
        return
    for mesh, name in zip(arguments.meshes, names_of(arguments.meshes), strict=True):
        there = mesh.parent if arguments.output_dir is None else arguments.output_dir
        folder = f"{name}_pgcp" if arguments.output_dir is None else name
        yield argparse.Namespace(**{**vars(arguments), "mesh": mesh, "meshes": [mesh], "output_dir": there / folder})


def several(arguments: argparse.Namespace, one: One, signals: Signals, shown: Silent) -> int:
    """Map every mesh by ``one``, go on after a failure, and say how each came out; returns the worst exit status."""
    count = len(arguments.meshes)
    rows: list[dict[str, Any]] = []
    for number, own in enumerate(each_alone(arguments)):
        shown("meshes", number, count)
        began = time.perf_counter()
        try:
            result, directory, paths = one(own)
            row = {**record(result, time.perf_counter() - began, paths), "vertices": len(result.mesh.vertices)}
            row["results"] = str(directory)
        except KeyboardInterrupt:
            return stopped(signals, arguments.json, arguments.resume, f"{len(rows)} of {count} meshes were done")
        except Exception as problem:
            if arguments.debug:
                raise
            if signals.received:
                return stopped(signals, arguments.json, arguments.resume, f"{len(rows)} of {count} meshes were done")
            told, status = told_as(problem)
            message = of_a_bug(told) if status == BUG else str(told)
            row = {"status": status, "error": type(told).__name__, "message": message}
            row["seconds"] = round(time.perf_counter() - began, 3)
            complain(message)
        signals.listen()
        rows.append({"file": str(own.mesh), **row})
    shown("meshes", count, count)
    worst = max((row["status"] for row in rows), key=SEVERITY.index)
    if arguments.json:
        say(json.dumps({"status": worst, "meshes": rows}))
    elif not arguments.quiet:
        say(_table(rows))
    return worst


def _table(rows: list[dict[str, Any]]) -> str:
    """One line for each mesh, under a line of titles."""
    titles = ("mesh", "outcome", "target", "vertices", "mean angle error", "folds", "seconds")
    lines = [titles, *(_cells(row) for row in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(titles))]
    text = [
        "  ".join(
            cell.ljust(width) if k < 3 else cell.rjust(width) for k, (cell, width) in enumerate(zip(line, widths, strict=True))
        )
        for line in lines
    ]
    good = sum(row["status"] == GOOD for row in rows)
    return "\n".join([*(line.rstrip() for line in text), f"{good} of {len(rows)} meshes mapped"])


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    if "quality" not in row:
        return (row["file"], _OUTCOMES[row["status"]], "", "", "", "", f"{row['seconds']:.1f}")
    quality = row["quality"]
    outcome = "folded" if row["status"] else "mapped"
    error = f"{quality['angle_mean_deg']:.4f}"
    return (row["file"], outcome, row["target"], str(row["vertices"]), error, str(quality["folds"]), f"{row['seconds']:.1f}")
