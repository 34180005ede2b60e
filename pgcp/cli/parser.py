"""The options of the command, and what they mean to the library."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pgcp.cli.usage import Parser
from pgcp.errors import InputError
from pgcp.io.formats import DEFAULT_OUTPUTS, outputs, readable, suffixes_of, writable
from pgcp.methods.registry import METHODS, own_options
from pgcp.options import (
    AUTO,
    BACKENDS,
    FLATTENERS,
    METHOD,
    MOEBIUS,
    NONE,
    POLISHES,
    REPAIRS,
    SCALE_RATIO,
    SEAMS,
    UPS,
    UVS,
    Options,
    Running,
)
from pgcp.parallel import processor_count
from pgcp.runtime.executors import EXECUTORS, may_have_workers
from pgcp.targets.registry import TARGETS

if TYPE_CHECKING:
    from pgcp.apps.base import App
    from pgcp.methods.base import Method, OwnOption

_LARGE_FILE = 20_000_000
PAGE_VERTICES = 2_000_000  # of meshes whose report page is made without being asked for: it costs a few percent of a run
_OWN = "own:"
ASKED = "What is asked for"  # title of the options that an application has of its own
_STATUSES = (
    "Exit status: 0 good, 2 bad input or usage, 3 numerical failure or folds, 4 stopped by lost workers, scheduler or store, "
    "1 a bug, 130 interrupted."
)


def parse(words: Sequence[str]) -> argparse.Namespace:
    """Parse a command line; methods are imported only where it may name an option of their own, or ask for help."""
    parser = _common_parser()
    asked = {word.partition("=")[0] for word in words if word.startswith("--")} - {"--"}
    if not asked - {*parser._option_string_actions} and not asked & {"--help"} and "-h" not in words:
        return parser.parse_intermixed_args(words)
    return build_parser().parse_intermixed_args(words)


def build_parser() -> argparse.ArgumentParser:
    """Build the command line's parser, with the options that methods have of their own."""
    parser = _common_parser()
    if found := own_options():
        _own_options(parser.add_argument_group("Options of single methods", "what only some methods ask for"), found)
    return parser


def _own_options(group: argparse._ArgumentGroup, found: dict[str, list[tuple[Method, OwnOption]]]) -> None:
    for name, having in found.items():
        own = having[0][1]
        same = all(other.choices == own.choices for _, other in having)
        group.add_argument(
            f"--{name.replace('_', '-')}",
            dest=f"{_OWN}{name}",
            metavar=own.metavar or (None if own.choices and same else name.upper()),
            choices=own.choices if same and own.choices else None,
            help="; ".join(f"{method.name}: {other.help} (default {other.default})" for method, other in having),
        )


def _own_of(arguments: argparse.Namespace) -> dict[str, Any]:
    """Options of methods' own that a command line names."""
    given = ((name.removeprefix(_OWN), value) for name, value in vars(arguments).items() if name.startswith(_OWN))
    return {name: value for name, value in given if value is not None}


def _common_parser() -> Parser:
    """Build the parser of what the command itself asks for."""
    parser = Parser(
        prog="pgcp-run",
        description="Map a triangle mesh conformally to the plane, the disk or the sphere, patch by patch and in parallel.",
        epilog=_STATUSES,
    )
    files = suffixes_of(readable())
    parser.add_argument(
        "meshes", metavar="mesh", nargs="*", type=Path,
        help=f"file of a mesh ({files}, packed with .gz too, or a FreeSurfer surface of any name); - for PLY on the standard "
        "input; several are mapped one after the other",
    )  # fmt: skip
    parser.add_argument("--demo", action="store_true", help="map the built-in demo surface where no mesh is named")
    parser.add_argument("--warm-up", action="store_true", help="compile for this machine all that any run needs, then stop")
    parser.add_argument("--version", action="store_true", help="print the version; with --json, those of the packages used too")
    _map_options(parser.add_argument_group("Map", "where the mesh is mapped, and how"))
    _output_options(parser.add_argument_group("Output", "what is written and printed"))
    _work_options(parser)
    return parser


def _work_options(parser: Parser) -> None:
    """Add the groups of options that stand last in a help."""
    _mesh_options(parser.add_argument_group("Mesh", "what is done to the mesh before it is mapped"))
    _running_options(parser.add_argument_group("Running", "where the work is done"))
    _fine_options(parser.add_argument_group("Method in detail", "what the defaults choose well for most meshes"))


def app_parser(app: App) -> Parser:
    """Build the parser of an application's command: what it asks for, then how its meshes are mapped."""
    parser = Parser(prog=f"pgcp {app.name}", description=f"{app.summary[:1].upper()}{app.summary[1:]}.", epilog=_STATUSES)
    app.arguments(parser.add_argument_group(ASKED))
    group = parser.add_argument_group("Output", "what is written and printed")
    endings = "; ".join(f"{ending}: {what}" for ending, what in app.writes.items())
    group.add_argument(
        "-o", "--output", type=Path, action="append", default=[], metavar="FILE",
        help=f"write this file, what its name ends in, and no folder of results; may be repeated; {endings}",
    )  # fmt: skip
    group.add_argument(
        "--output-dir", type=Path, metavar="DIR", help=f"where results go (default <stem>_{app.name} beside the mesh)"
    )
    _said_options(group)
    _map_options(parser.add_argument_group("Map", "where the mesh is mapped, and how"))
    _work_options(parser)
    if found := own_options():
        _own_options(parser.add_argument_group("Options of single methods", "what only some methods ask for"), found)
    return parser


def _map_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--target",
        choices=(AUTO, *TARGETS.names()),
        default=AUTO,
        help="plane with free boundary, disk or sphere; auto: by the surface",
    )
    group.add_argument(
        "--method",
        choices=METHODS.names(),
        default=METHOD,
        help=f"how the mesh is mapped (default {METHOD}, which serves every target); the others map the undivided mesh",
    )
    group.add_argument(
        "--patches", type=_number, metavar="K", help="number of patches; auto (default): by vertices, workers and memory"
    )
    group.add_argument("--centre", type=int, metavar="VERTEX", help="vertex at the disk's centre or the sphere's north pole")
    group.add_argument(
        "--moebius", choices=MOEBIUS, default="auto", help="correct the finished map for least area or angle distortion"
    )
    group.add_argument(
        "--polish", choices=POLISHES, default="none", help="lower the angle errors of the finished map; auto: where it is quick"
    )
    group.add_argument(
        "--no-overlap", action="store_true", help="where a free map overlaps itself, map to the disk instead, and say so"
    )


def _output_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "-o", "--output", type=Path, action="append", default=[], metavar="FILE",
        help="write this file, what its suffix says (.obj, .glb, .vtp, .csv, .png, .html and others, .obj.gz too), and no "
        "folder of results where none is named; may be repeated",
    )  # fmt: skip
    group.add_argument("--output-dir", type=Path, metavar="DIR", help="where results go (default <stem>_pgcp beside the mesh)")
    group.add_argument(
        "--uv",
        choices=UVS,
        default=UVS[0],
        help="texture coordinates: unit, upright in the unit square; surface, the map's own",
    )
    group.add_argument("--up", choices=UPS, default=AUTO, help="the surface's axis that is up on the texture; auto: y or z")
    group.add_argument("--texture", metavar="PICTURE", help="put a picture on OBJ and GLB files: checker, or an image file")
    names = ", ".join(kind.name for kind in writable())
    group.add_argument(
        "--write",
        type=_names,
        metavar="LIST",
        help=f"formats of the results (default {','.join(DEFAULT_OUTPUTS)}; of a large binary mesh no obj), of {names}",
    )
    group.add_argument(
        "--compare",
        type=_names,
        metavar="LIST",
        help="map by several methods, all or a list of names, and print a table of the results instead of writing maps",
    )
    group.add_argument("--check-only", action="store_true", help="say what the mesh is and list its defects, then stop")
    group.add_argument("--no-obj", action="store_true", help="write no OBJ file")
    group.add_argument("--no-ply", action="store_true", help="write no PLY file")
    group.add_argument("--no-png", action="store_true", help="draw no picture")
    group.add_argument("--no-html", action="store_false", dest="html", default=None, help="write no report page")
    group.add_argument(
        "--html", action="store_true", default=None, help=f"write it of meshes with more than {PAGE_VERTICES:,} vertices too"
    )
    _said_options(group)


def _said_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--json", action="store_true", help="print one JSON object: the result, or the error")
    group.add_argument("--log-file", type=Path, metavar="FILE", help="append the stages of the run, with times, to this file")
    group.add_argument("--quiet", action="store_true", help="print nothing but errors")
    group.add_argument("--debug", action="store_true", help="show tracebacks")


def _mesh_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--fix", action="store_true", help="repair the topology of a mesh that would be refused: cut, split, weld, fill holes"
    )
    group.add_argument(
        "--component",
        default="largest",
        metavar="WHICH",
        help="which of several separate surfaces is mapped: largest (default), all, a name, or a number, 1 for the largest",
    )
    group.add_argument(
        "--weld-distance", type=_distance, default=0.0, metavar="D",
        help="join vertices for the map that seams split and that lie so close, as a share of the diagonal (default 0: at the "
        "same place); none leaves all apart",
    )  # fmt: skip
    group.add_argument(
        "--cut", default=NONE, metavar="WHICH",
        help="open the surface to a disk before it is mapped to the plane, closed or with handles or several boundaries: auto "
        "(a short, hidden cut), none (default), or a file of the edges to cut along, one pair of vertex ids a line; the cut "
        "shows in the map only, as a seam",
    )  # fmt: skip
    group.add_argument(
        "--max-area-distortion", type=float, metavar="R",
        help=f"with --cut auto: cut through more tips until the map's scale ratio is R at most (default {SCALE_RATIO:g}): the "
        "factor by which areas are scaled that 99 %% of the surface stays below, over the one that 99 %% stays above",
    )  # fmt: skip
    group.add_argument(
        "--cuts", type=Path, metavar="FILE",
        help="seams between patches: split the work along these edges, one pair of vertex ids a line; they do not open the "
        "surface (see --cut)",
    )  # fmt: skip
    group.add_argument("--repair-cuts", action="store_true", help="mend patches that --cuts leaves and that are no disks")


def _running_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--workers",
        type=_number,
        metavar="N",
        help="worker processes here, and processors in all; 0 for none; auto (default): one a processor for files of 20 MB and "
        "more, else none",
    )
    group.add_argument("--resume", action="store_true", help="take up what an earlier run has finished; keep it when stopped")
    group.add_argument("--store", type=Path, metavar="DIR", help="directory for patch files that all workers can open")
    group.add_argument(
        "--memory-limit", type=_bytes, metavar="SIZE", help="memory of all processes of this run together, such as 8GB"
    )
    group.add_argument("--scheduler", metavar="ADDRESS", help="use the running dask scheduler at this address")
    group.add_argument("--scheduler-file", type=Path, metavar="FILE", help="use the dask scheduler this file describes")
    group.add_argument("--tls-ca", type=Path, metavar="PEM", help="certificate of the authority, for a scheduler with TLS")
    group.add_argument("--tls-cert", type=Path, metavar="PEM", help="own certificate, for a scheduler with TLS")
    group.add_argument("--tls-key", type=Path, metavar="PEM", help="own key, for a scheduler with TLS")
    group.add_argument(
        "--executor",
        choices=(AUTO, *EXECUTORS.names()),
        default=AUTO,
        help="what runs the tasks; "
        + "; ".join(f"{kind.name}: {kind.summary}" for kind in EXECUTORS.all())
        + "; auto (default): one with workers where there are workers or a scheduler",
    )
    group.add_argument(
        "--factor-cache-mb", type=int, metavar="MB", help="factors a worker may keep (default 1500, less if memory is short)"
    )


def _fine_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--flatten", choices=FLATTENERS, default="dncp", help="how patches are flattened (default dncp)")
    group.add_argument(
        "--seams", choices=SEAMS, default="weld", help="weld; solve them exactly inside the welded boundary; exact, no weld"
    )
    group.add_argument(
        "--backend", choices=(AUTO, *BACKENDS), default=AUTO, help="how interiors are eliminated; pardiso needs pgcp[mkl]"
    )
    group.add_argument("--seed", type=int, default=0, help="seed of the partition (default 0)")
    group.add_argument(
        "--repairs",
        default="all",
        metavar="LIST",
        help="which tiers may take folds away: all, none, or some of " + ", ".join(REPAIRS),
    )


def _number(text: str) -> int | None:
    """A whole number, None for auto."""
    if text == "auto":
        return None
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a whole number nor auto") from None


def _distance(text: str) -> float | None:
    """A number, None for none."""
    if text == "none":
        return None
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a number nor none") from None


def _automatic_workers(meshes: list[Path]) -> int:
    """One worker a processor where a mesh is so large that they gain more time than they take to start."""
    for mesh in meshes:
        with suppress(OSError):
            if mesh.stat().st_size >= _LARGE_FILE:
                return processor_count() if processor_count() > 1 else 0
    return 0


def _bytes(text: str) -> int:
    """A size in bytes, such as 500MB, 8GB or 7.5GiB."""
    words = re.fullmatch(r"(\d+\.?\d*|\.\d+)\s*([kmgt]?)(i?)b?", text.strip().lower())
    if words is None:
        raise argparse.ArgumentTypeError(f"{text!r} is no size such as 500MB, 8GB or 7.5GiB")
    return int(float(words[1]) * (1024 if words[3] else 1000) ** " kmgt".index(words[2] or " "))


def _repairs(text: str) -> tuple[str, ...]:
    """Tiers of repair named on the command line."""
    if text in ("all", "none"):
        return REPAIRS if text == "all" else ()
    return _names(text)


def _names(text: str) -> tuple[str, ...]:
    """Names parted by commas."""
    return tuple(name.strip() for name in text.split(","))


def outputs_of(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Names of the formats in which results are written."""
    left_out = {name for name, out in (("obj", arguments.no_obj), ("ply", arguments.no_ply)) if out}
    return tuple(kind.name for kind in outputs(arguments.write or DEFAULT_OUTPUTS) if kind.name not in left_out)


def _workers_of(arguments: argparse.Namespace) -> int:
    if arguments.workers is not None:
        return int(arguments.workers)
    elsewhere = arguments.scheduler is not None or arguments.scheduler_file is not None
    return 0 if elsewhere or not may_have_workers(arguments.executor) else _automatic_workers(arguments.meshes)


def options_of(arguments: argparse.Namespace) -> Options:
    """What a command line asks to be computed."""
    return Options(
        patches=arguments.patches,
        target=arguments.target,
        centre=arguments.centre,
        moebius=arguments.moebius,
        polish=arguments.polish,
        cut=arguments.cut,
        max_area_distortion=arguments.max_area_distortion,
        cuts=arguments.cuts,
        repair_cuts=arguments.repair_cuts,
        method=arguments.method,
        flatten=arguments.flatten,
        seams=arguments.seams,
        backend=arguments.backend,
        seed=arguments.seed,
        repairs=_repairs(arguments.repairs),
        no_overlap=arguments.no_overlap,
        fix=arguments.fix,
        weld_distance=arguments.weld_distance,
        component=arguments.component,
        own=_own_of(arguments),
    )


def running_of(arguments: argparse.Namespace) -> Running:
    """Where and how a command line asks to run; raises InputError where a file or folder it names is not there."""
    named = ((arguments.store, "store"), (arguments.scheduler_file, "scheduler file"), (arguments.tls_ca, "certificate"))
    for path, what in (*named, (arguments.tls_cert, "certificate"), (arguments.tls_key, "key")):
        if path is not None and not path.exists():
            raise InputError(f"{path}: there is no such {what}")
    if arguments.store is not None and not arguments.store.is_dir():
        raise InputError(f"{arguments.store}: the store is no directory")
    return Running(
        workers=_workers_of(arguments),
        scheduler=arguments.scheduler,
        scheduler_file=arguments.scheduler_file,
        executor=arguments.executor,
        store=arguments.store,
        factor_cache_bytes=None if arguments.factor_cache_mb is None else arguments.factor_cache_mb * 1024**2,
        memory_limit_bytes=arguments.memory_limit,
        resume=arguments.resume,
        tls_ca=arguments.tls_ca,
        tls_cert=arguments.tls_cert,
        tls_key=arguments.tls_key,
    )
