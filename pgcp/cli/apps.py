"""The command ``pgcp``: each application is a word after it, and ``pgcp run`` is ``pgcp-run``."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack, nullcontext
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from pgcp.apps.registry import APPS
from pgcp.cli.failures import answered, of_system, refused
from pgcp.cli.parser import app_parser, options_of, running_of
from pgcp.cli.progress import display, logged
from pgcp.cli.terminal import BAD_INPUT, COMMAND, GOOD, NUMERICAL, Signals, complain, end_with, say
from pgcp.cli.usage import UsageError
from pgcp.errors import InputError
from pgcp.parallel import processor_count
from pgcp.runtime.address_space import check_address_space
from pgcp.runtime.compiled import compiled_together
from pgcp.runtime.forks import prepare_forks
from pgcp.runtime.versions import package_versions

if TYPE_CHECKING:
    from pgcp.apps.base import App, Made

_RUN = "run"


def _help() -> str:
    """What ``pgcp`` alone says."""
    words = [(_RUN, "map a mesh; the same as pgcp-run"), *((app.name, app.summary) for app in APPS.all())]
    width = max(len(name) for name, _ in words)
    lines = "\n".join(f"  pgcp {name.ljust(width)}  {summary}" for name, summary in words)
    about = "pgcp maps a triangle mesh conformally, and puts the map to use."
    return f"{about}\n\n{lines}\n\npgcp COMMAND --help lists the options of a command."


def _asked(app: App, words: Sequence[str]) -> argparse.Namespace:
    """What a command line asks of an application; raises UsageError where it cannot be understood."""
    arguments = app_parser(app).parse_intermixed_args(words)
    arguments.given = _given(app, arguments)
    arguments.meshes = [value for value in arguments.given.values() if isinstance(value, Path)]
    for path in arguments.output:
        app.ending_of(path)
        if path.is_dir():
            raise InputError(f"{path}: there is a folder of this name where a result should go")
        for given in arguments.meshes:
            if path.exists() and given.exists() and path.samefile(given):
                raise InputError(f"{path}: this would take the place of what was given; choose another --output")
    return arguments


def _given(app: App, arguments: argparse.Namespace) -> dict[str, Any]:
    """Values of what an application asks for, by name, in the order in which it asks."""
    parser = argparse.ArgumentParser(add_help=False)
    app.arguments(parser.add_argument_group())
    return {action.dest: getattr(arguments, action.dest) for action in parser._actions}


def _has_folder(arguments: argparse.Namespace) -> bool:
    """Whether results are written into a folder of their own."""
    return not arguments.output or arguments.output_dir is not None


def _folder(app: App, arguments: argparse.Namespace) -> tuple[Path, str]:
    """The folder of the results, and the stem of their names; the first file that is given has them beside it."""
    from pgcp.io.read import stem_of

    first = next(iter(arguments.meshes), None)
    stem = "demo" if first is None else stem_of(first)
    folder: Path = arguments.output_dir or (Path() if first is None else first.parent) / f"{stem}_{app.name}"
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: there is a file of this name where the results should go")
    if first is not None and folder.is_dir() and folder.samefile(first.parent):
        raise InputError(f"{folder}: results here would stand among what was given; choose another --output-dir")
    return folder, stem


def _run(app: App, arguments: argparse.Namespace, signals: Signals) -> int:
    """Do what a command line asks for; returns the exit status."""
    from pgcp.apps.base import Call
    from pgcp.io.files import claimed

    started = time.perf_counter()
    with logged(arguments.log_file), display(arguments.quiet) as shown:
        shown("start", 0, 0)
        check_address_space()
        options, running = options_of(arguments), running_of(arguments)
        folder, stem = _folder(app, arguments)
        if running.starts_workers:
            prepare_forks()
        shown("start", 1, 1)
        with claimed(folder) if _has_folder(arguments) else nullcontext():
            with compiled_together("free", processor_count() - 1, shown):
                made = app.run(Call(arguments.given, options, running, shown))
            shown("write", 0, 0)
            paths = _written(app, made, arguments, folder / stem, signals)
            shown("write", 1, 1)
    return _told(app, made, time.perf_counter() - started, paths, arguments)


def _written(app: App, made: Made, arguments: argparse.Namespace, place: Path, signals: Signals) -> list[Path]:
    """Write the files that are asked for, all or none; ``place``: folder and stem of the usual ones. Returns their paths."""
    from pgcp.io.files import FileSet, replacing_together

    wanted = [(path, app.ending_of(path)) for path in arguments.output]
    for path, ending in wanted:
        if ending not in made.files:
            raise InputError(f"{path}: {app.name} makes no {ending} of what was given")
    contents = [(path.parent, made.files[ending](path.name)) for path, ending in wanted]
    if _has_folder(arguments):
        usual = [ending for ending in app.usual or app.writes if ending in made.files]
        contents += [(place.parent, made.files[ending](f"{place.name}{ending}")) for ending in usual]
        record = json.dumps({"command": app.name, **made.record}, indent=1, allow_nan=False)
        contents.append((place.parent, {f"{app.name}.json": record.encode()}))
    for path in (folder / name for folder, files in contents for name in files):
        if path.exists() and any(given.exists() and path.samefile(given) for given in arguments.meshes):
            raise InputError(f"{path}: this would take the place of what was given; choose another --output")
    sets: dict[Path, FileSet] = {}
    try:
        with ExitStack() as stack:
            for folder, files in contents:
                if folder not in sets:
                    sets[folder] = stack.enter_context(replacing_together(folder))
                for name, data in files.items():
                    sets[folder].open(name).write(data)
            for together in sets.values():
                together.sync()
            with signals.held():
                return [path for together in sets.values() for path in together.switch()]
    except OSError as problem:
        raise InputError(f"cannot write the results: {of_system(problem)}") from problem


def _told(app: App, made: Made, seconds: float, paths: list[Path], arguments: argparse.Namespace) -> int:
    """Say what was made; returns the exit status."""
    status = NUMERICAL if made.problem else GOOD
    if arguments.json:
        files = [str(path) for path in paths]
        said = {"status": status, "command": app.name, "seconds": round(seconds, 3), "results": files, **made.record}
        say(json.dumps(said, allow_nan=False))
    elif not arguments.quiet:
        say("\n".join([*made.lines, f"{seconds:.1f} s; results: {', '.join(map(str, paths))}"]))
    if made.problem:
        complain(made.problem)
    return status


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    if not words or words[0] in ("-h", "--help"):
        say(_help())
        return GOOD
    if words[0] == "--version":
        say(f"pgcp {package_versions().get('pgcp', '(not installed)')}")
        return GOOD
    if words[0] == _RUN:
        from pgcp.cli.main import main as map_mesh

        return map_mesh(words[1:])
    token = COMMAND.set("pgcp")
    try:
        if words[0] not in APPS.names():
            near = get_close_matches(words[0], [_RUN, *APPS.names()], 1, 0.6)
            meant = f"; did you mean {near[0]}?" if near else f"; choose from {', '.join([_RUN, *APPS.names()])}"
            return refused(UsageError(f"unknown command {words[0]!r}{meant}"), BAD_INPUT, "--json" in words)
        app = APPS.get(words[0])
        COMMAND.set(f"pgcp {app.name}")
        return answered(words[1:], partial(_asked, app), partial(_run, app))
    finally:
        COMMAND.reset(token)


def run() -> NoReturn:
    """Run the command and end the process."""
    end_with(main)
