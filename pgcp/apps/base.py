"""What an application is: what it asks for, how it maps its meshes, and what it gives back to be written and said."""

from __future__ import annotations

import argparse
import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pgcp.errors import InputError
from pgcp.io.formats import readable, suffixes_of
from pgcp.options import AUTO, Options, Running

if TYPE_CHECKING:
    from pgcp.result import Result
    from pgcp.runtime.executors import Progress

Group = argparse._ArgumentGroup
Maker = Callable[[str], dict[str, bytes]]


@dataclass(frozen=True, slots=True)
class Call:
    """What a user asks of an application.

    arguments: values of what it asks for, by name; options, running: how its meshes are mapped, and where; shown(stage, done,
    total): tells the user what is being done.
    """

    arguments: Mapping[str, Any]
    options: Options
    running: Running
    shown: Progress

    def __getitem__(self, name: str) -> Any:
        """Value of one of the application's arguments."""
        return self.arguments[name]

    def mapped(self, source: Any, target: str = AUTO, **changes: Any) -> Result:
        """The map of a mesh, with the options asked for; ``target`` is the one that the application needs.

        Raises InputError where another target is asked for, and what ``pgcp.compute`` raises. A map with folds is returned.
        """
        from pgcp.api import compute

        if AUTO not in (target, self.options.target) and target != self.options.target:
            raise InputError(f"this needs a map to the target {target}, and --target {self.options.target} asks for another")
        wanted = self.options.target if target == AUTO else target
        return compute(source, replace(self.options, target=wanted, **changes), self.running, self.shown)


@dataclass(frozen=True, slots=True)
class Made:
    """What an application gives back.

    files: what makes its files, by the ending that ``App.writes`` names: called with the name of the first file, it returns
    the contents of that file, and of those that belong to it, by name. record: figures, as JSON has them. lines: what the user
    is told. problem: why the results are not good, nothing where they are.
    """

    files: Mapping[str, Maker]
    record: dict[str, Any] = field(default_factory=dict)
    lines: tuple[str, ...] = ()
    problem: str = ""


@dataclass(frozen=True, slots=True)
class App:
    """One application of maps: the command ``pgcp NAME``.

    summary: a line for help and documentation; reference: where it comes from, nothing where there is no source.
    writes: what its files are, by the ending of their names: ".glb", or "_density.png" where there are several of a suffix.
    usual: endings of the files that the folder of the results gets; all where it is empty.
    arguments(group): adds what it asks for, its meshes first, to a group of an argument parser; values that are of type Path
    and name a file are never overwritten. run(call): does the work; raises PgcpError where it cannot be done. It writes and
    prints nothing.
    """

    name: str
    summary: str
    writes: Mapping[str, str]
    arguments: Callable[[Group], None]
    run: Callable[[Call], Made]
    usual: tuple[str, ...] = ()
    reference: str = ""

    def ending_of(self, path: Path) -> str:
        """The ending of the application's files that a path asks for; raises InputError where it writes no such file."""
        name = path.name.lower()
        whole = [ending for ending in self.writes if name.endswith(ending)]
        alike = [
            ending for ending in self.writes if Path(ending).suffix == path.suffix.lower() or ending == path.suffix.lower()
        ]
        for found in (*sorted(whole, key=len, reverse=True), *alike):
            return found
        raise InputError(f"{path}: {self.name} writes no such file; it writes {', '.join(self.writes)}")


def add_mesh(group: Group, name: str = "mesh", about: str = "file of a mesh") -> None:
    """Add an argument for the file of a mesh."""
    group.add_argument(name, type=Path, help=f"{about} ({suffixes_of(readable())}, packed with .gz too)")


def number(text: str) -> float:
    """A number of the command line."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no number") from None


def whole_number(text: str) -> int:
    """A whole number of the command line."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number") from None


def npz_file(name: str, **arrays: Any) -> dict[str, bytes]:
    """The contents of an NPZ file of arrays, by its name."""
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return {name: stream.getvalue()}


def map_record(result: Result) -> dict[str, Any]:
    """Figures of a map, for the record of an application that made it."""
    quality = result.quality
    return {
        "name": result.mesh.name,
        "vertices": len(result.mesh.vertices),
        "faces": len(result.mesh.faces),
        "target": result.target,
        "angle_mean_deg": quality.angle_mean_deg,
        "folds": quality.folds,
    }


def folds_said(result: Result) -> str:
    """What is said of a map with folds, nothing where there is none."""
    from pgcp.report.record import fold_message

    return fold_message(result) if result.quality.folds else ""
