"""The command ``pgcp-run``: the only place that prints and that sets an exit status."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from pgcp.cli.compare import compared
from pgcp.cli.failures import answered, of_system
from pgcp.cli.parser import PAGE_VERTICES, options_of, outputs_of, parse, running_of
from pgcp.cli.progress import Silent, display, logged
from pgcp.cli.several import SEVERITY, check_several, each_alone, several
from pgcp.cli.summary import check_only, record, summary
from pgcp.cli.terminal import GOOD, NUMERICAL, Signals, complain, end_with, say
from pgcp.cli.usage import SHORT_HELP, UsageError
from pgcp.errors import InputError
from pgcp.options import AUTO, NONE, Options, Running
from pgcp.parallel import at_once, processor_count
from pgcp.runtime.address_space import check_address_space
from pgcp.runtime.compiled import cache_is_temporary, compile_all, compiled_together
from pgcp.runtime.executors import shared_workers
from pgcp.runtime.forks import prepare_forks
from pgcp.runtime.versions import package_versions

if TYPE_CHECKING:
    from pgcp.result import Result
    from pgcp.types import Layout

_NO_CACHE = (
    "no folder for compiled code can be written, neither beside the package nor in the home directory; what this run compiles "
    "is lost when it ends; NUMBA_CACHE_DIR may name a folder"
)


def _run(arguments: argparse.Namespace, signals: Signals) -> int:
    """Do what a command line asks for; returns the exit status."""
    started = time.perf_counter()
    with logged(arguments.log_file):
        with display(arguments.quiet) as shown:
            shown("start", 0, 0)
            check_address_space()
            options, running = options_of(arguments), running_of(arguments)
            if len(arguments.meshes) > 1:
                check_several(arguments)
            if arguments.check_only:
                return max((_checked(own, shown) for own in each_alone(arguments)), key=SEVERITY.index)
            if running.starts_workers:
                prepare_forks()
            if arguments.compare is not None:
                return compared(arguments, options, running, shown)
            if cache_is_temporary() and not arguments.quiet:
                complain(_NO_CACHE)
            with compiled_together(_usual(arguments.target), processor_count() - 1, shown):
                if len(arguments.meshes) > 1:
                    from pgcp.patches.warm_up import warm_up

                    with shared_workers(running, warm_up):
                        return several(arguments, lambda own: _mapped(own, options, running, signals, shown), signals, shown)
                result, directory, paths = _mapped(arguments, options, running, signals, shown)
        return _told(result, time.perf_counter() - started, directory, paths, arguments)


def _checked(arguments: argparse.Namespace, shown: Silent) -> int:
    """Say what a mesh is; returns the exit status."""
    from pgcp.api import surface_of
    from pgcp.surface.demo import demo_mesh

    shown("read", 0, 0)
    surface = surface_of(demo_mesh() if arguments.mesh is None else arguments.mesh)
    shown("check", 0, 0)
    opens = arguments.cut != NONE
    return check_only(surface, arguments.target, arguments.fix, arguments.weld_distance, arguments.component, opens)


def _mapped(
    arguments: argparse.Namespace, options: Options, running: Running, signals: Signals, shown: Silent
) -> tuple[Result, Path, list[Path]]:
    """The map of a mesh, the folder of the results, and the files written there."""
    from pgcp.api import compute
    from pgcp.io.files import claimed
    from pgcp.io.read import stem_of
    from pgcp.io.write import have_textures, said_of
    from pgcp.report.texture import as_png
    from pgcp.surface.demo import demo_mesh

    stem = "demo" if arguments.mesh is None else stem_of(arguments.mesh)
    beside = Path() if arguments.mesh is None else arguments.mesh.parent
    directory: Path = arguments.output_dir or beside / f"{stem}_pgcp"
    if directory.exists() and not directory.is_dir():
        raise InputError(f"{directory}: there is a file of this name where the results should go")
    if arguments.mesh is not None and directory.is_dir() and directory.samefile(beside):
        raise InputError(f"{directory}: results here would take the place of {arguments.mesh}; choose another --output-dir")
    kinds = outputs_of(arguments)
    _check_files(arguments)
    texture = None if arguments.texture is None else as_png(arguments.texture)
    shown("start", 1, 1)
    with claimed(directory) if _has_folder(arguments) else nullcontext():
        result = compute(demo_mesh() if arguments.mesh is None else arguments.mesh, options, running, shown)
        written = kinds if _has_folder(arguments) else ()
        layout = result.layout(arguments.uv, arguments.up) if have_textures(written, arguments.output) else None
        result = replace(result, report={**result.report, "texture": said_of(layout)})
        try:
            paths = _written(result, layout, directory / stem, kinds, texture, arguments, signals, shown)
        except OSError as problem:
            raise InputError(f"{directory}: cannot write the results: {of_system(problem)}") from problem
    return result, directory, paths


def _has_folder(arguments: argparse.Namespace) -> bool:
    """Whether the usual results are written into a folder."""
    return not arguments.output or arguments.output_dir is not None


def _check_files(arguments: argparse.Namespace) -> None:
    """Raise InputError where a file that is asked for has no format, or is the mesh."""
    from pgcp.io.write import kind_of

    for path in arguments.output:
        kind_of(path)
        if path.is_dir():
            raise InputError(f"{path}: there is a folder of this name where a result should go")
        if arguments.mesh is not None and path.exists() and arguments.mesh.exists() and path.samefile(arguments.mesh):
            raise InputError(f"{path}: this would take the place of the mesh; choose another --output")


def _written(
    result: Result,
    layout: Layout | None,
    place: Path,
    kinds: tuple[str, ...],
    texture: bytes | None,
    arguments: argparse.Namespace,
    signals: Signals,
    shown: Silent,
) -> list[Path]:
    """Draw and write what is asked for; ``place`` is the folder and the stem of the usual results. Returns the files."""
    from pgcp.io.write import within, write_files, write_outputs

    drawn = _drawn(result, arguments, shown)
    shown("write", 0, 0)
    paths = write_files(arguments.output, result, drawn, signals.held(), layout, texture) if arguments.output else []
    if _has_folder(arguments):
        if arguments.write is None and arguments.mesh is not None and arguments.mesh.exists():
            kinds = within(kinds, result, arguments.mesh.stat().st_size)
        usual = {suffix: data for suffix, data in drawn.items() if suffix in _usual_drawings(result, arguments)}
        paths += write_outputs(place.parent, place.name, result, usual, signals.held(), kinds, layout, texture)
    shown("write", 1, 1)
    return paths


def _usual_drawings(result: Result, arguments: argparse.Namespace) -> set[str]:
    """Suffixes of what is drawn into the folder of the usual results."""
    with_page = len(result.mesh.vertices) <= PAGE_VERTICES if arguments.html is None else arguments.html
    return {suffix for suffix, wanted in ((".png", not arguments.no_png), (".html", with_page)) if wanted}


def _drawn(result: Result, arguments: argparse.Namespace, shown: Silent) -> dict[str, bytes]:
    """The picture and the page, those that are wanted, by suffix."""
    from pgcp.report.page import page
    from pgcp.report.picture import draw

    wanted = {path.suffix.lower() for path in arguments.output}
    if _has_folder(arguments):
        wanted |= _usual_drawings(result, arguments)
    command = "pgcp-run", *arguments.words
    makers: dict[str, Callable[[], bytes]] = {".png": lambda: draw(result), ".html": lambda: page(result, command)}
    shown("draw", 0, 0)
    suffixes = [suffix for suffix in makers if suffix in wanted]
    drawn = dict(zip(suffixes, at_once(*(makers[suffix] for suffix in suffixes)), strict=True))
    shown("draw", 1, 1)
    return drawn


def _told(result: Result, seconds: float, directory: Path, paths: list[Path], arguments: argparse.Namespace) -> int:
    """Say what a map is like; returns the exit status."""
    from pgcp.report.record import fold_message

    where = str(directory) if _has_folder(arguments) else ", ".join(map(str, paths))

    if arguments.json:
        say(json.dumps(record(result, seconds, paths)))
    elif not arguments.quiet:
        say(summary(result, seconds, where))
    if not result.quality.folds:
        return GOOD
    marked = (
        f"The results in {where} are marked so (report.json: status folded)"
        if "report.json" in {path.name for path in paths}
        else f"The results are in {where}"
    )
    complain(f"{fold_message(result)}. {marked}")
    return NUMERICAL


def _usual(target: str) -> str:
    """The usual run that comes nearest to one with a target."""
    return "free" if target == AUTO else target


def _warm_up(quiet: bool) -> None:
    """Compile all that any run needs."""
    if cache_is_temporary():
        raise InputError(_NO_CACHE)
    with display(quiet) as shown:
        compile_all(processor_count(), shown)


def _asked(words: Sequence[str]) -> argparse.Namespace | None:
    """What a command line asks for, None where that has been said; raises UsageError where it cannot be understood."""
    arguments = parse(words)
    arguments.words = tuple(words)
    arguments.mesh = arguments.meshes[0] if arguments.meshes else None
    if arguments.version:
        versions = package_versions()
        say(json.dumps(versions) if arguments.json else f"pgcp-run {versions.get('pgcp', '(not installed)')}")
        return None
    if not words:
        say(SHORT_HELP)
        return None
    if arguments.warm_up:
        _warm_up(arguments.quiet)
        return None
    if arguments.mesh is None and not arguments.demo:
        raise UsageError("no mesh is named; name a file, or --demo for the built-in one")
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return answered(sys.argv[1:] if argv is None else argv, _asked, _run)


def run() -> NoReturn:
    """Run the command and end the process."""
    end_with(main)
