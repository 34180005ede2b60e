"""The command ``pgcp-run``: the only place that prints and that sets an exit status."""

from __future__ import annotations

import argparse
import errno
import json
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn

from pgcp.errors import InputError, NumericalError, PgcpError, StoppedError
from pgcp.forks import collect_seldom, prepare_forks
from pgcp.options import FLATTENERS, METHODS, MOEBIUS, REPAIRS, SEAMS, TARGETS, Options
from pgcp.parallel import leave, processor_count
from pgcp.types import Mesh, Parameterization

_LARGE_FILE = 20_000_000
GOOD, BUG, BAD_INPUT, NUMERICAL, STOPPED = 0, 1, 2, 3, 4
_STATUS = {InputError: BAD_INPUT, NumericalError: NUMERICAL, StoppedError: STOPPED}
_STOPPED = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}  # exit status 128 + the signal's number
_SYSTEM = {
    getattr(errno, name) for name in ("ENOSPC", "EFBIG", "EDQUOT", "EROFS", "EACCES", "EPERM", "EIO") if hasattr(errno, name)
}


def build_parser() -> argparse.ArgumentParser:
    """Build the command line's parser."""
    parser = argparse.ArgumentParser(
        prog="pgcp-run",
        description="Map a triangle mesh conformally to the plane, the disk or the sphere, patch by patch and in parallel.",
        epilog="Exit status: 0 good, 2 bad input or usage, 3 numerical failure or folds, 4 stopped by lost workers, scheduler "
        "or store, 1 a bug, 130 interrupted.",
    )
    parser.add_argument("mesh", nargs="?", type=Path, help="PLY, OBJ, STL, OFF, GLB or glTF file; without it, a built-in demo")
    parser.add_argument(
        "--patches", type=_number, metavar="K", help="number of patches; auto (default): by vertices, workers and memory"
    )
    parser.add_argument(
        "--workers",
        type=_number,
        metavar="N",
        help="worker processes here, and processors in all; 0 for none; auto (default): one a processor for files of 20 MB and "
        "more, else none",
    )
    parser.add_argument("--scheduler", metavar="ADDRESS", help="use the running dask scheduler at this address")
    parser.add_argument("--scheduler-file", type=Path, metavar="FILE", help="use the dask scheduler this file describes")
    parser.add_argument("--store", type=Path, metavar="DIR", help="directory for patch files that all workers can open")
    parser.add_argument("--resume", action="store_true", help="take up what an earlier run has finished; keep it when stopped")
    parser.add_argument("--tls-ca", type=Path, metavar="PEM", help="certificate of the authority, for a scheduler with TLS")
    parser.add_argument("--tls-cert", type=Path, metavar="PEM", help="own certificate, for a scheduler with TLS")
    parser.add_argument("--tls-key", type=Path, metavar="PEM", help="own key, for a scheduler with TLS")
    parser.add_argument(
        "--target", choices=TARGETS, default="auto", help="plane with free boundary, disk or sphere; auto: by the surface"
    )
    parser.add_argument("--centre", type=int, metavar="VERTEX", help="vertex at the disk's centre or the sphere's north pole")
    parser.add_argument(
        "--moebius", choices=MOEBIUS, default="auto", help="correct the finished map for least area or angle distortion"
    )
    parser.add_argument("--cuts", type=Path, metavar="FILE", help="cut along these edges: one pair of vertex ids a line")
    parser.add_argument(
        "--repairs",
        default="all",
        metavar="LIST",
        help="which tiers may take folds away: all, none, or some of " + ", ".join(REPAIRS),
    )
    parser.add_argument(
        "--no-overlap", action="store_true", help="where a free map overlaps itself, map to the disk instead, and say so"
    )
    parser.add_argument("--repair-cuts", action="store_true", help="mend parts that the cuts leave and that are no disks")
    parser.add_argument(
        "--fix", action="store_true", help="repair the topology of a mesh that would be refused: cut, split, weld, fill holes"
    )
    parser.add_argument(
        "--method",
        choices=METHODS,
        default="pgcp",
        help="pgcp; or the undivided mesh by dncp, scp (free), cdcp, cem or ccem (disk)",
    )
    parser.add_argument("--flatten", choices=FLATTENERS, default="dncp", help="how patches are flattened (default dncp)")
    parser.add_argument(
        "--seams", choices=SEAMS, default="weld", help="weld; solve them exactly inside the welded boundary; exact, no weld"
    )
    parser.add_argument("--backend", default="auto", help="how interiors are eliminated: auto, nested, pardiso or superlu")
    parser.add_argument("--seed", type=int, default=0, help="seed of the partition (default 0)")
    parser.add_argument(
        "--memory-limit", type=_bytes, metavar="SIZE", help="memory of all processes of this run together, such as 8GB"
    )
    parser.add_argument(
        "--factor-cache-mb", type=int, metavar="MB", help="factors a worker may keep (default 1500, less if memory is short)"
    )
    parser.add_argument("--output-dir", type=Path, metavar="DIR", help="where results go (default <stem>_pgcp beside the mesh)")
    parser.add_argument("--no-obj", action="store_true", help="write no OBJ file")
    parser.add_argument("--no-ply", action="store_true", help="write no PLY file")
    parser.add_argument("--no-png", action="store_true", help="draw no picture")
    parser.add_argument("--check-only", action="store_true", help="say what the mesh is and list its defects, then stop")
    parser.add_argument("--json", action="store_true", help="print one JSON object: the result, or the error")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")
    parser.add_argument("--debug", action="store_true", help="show tracebacks")
    parser.add_argument("--version", action="version", version=f"%(prog)s {_version()}")
    return parser


def _number(text: str) -> int | None:
    """A whole number, None for auto."""
    if text == "auto":
        return None
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a whole number nor auto") from None


def _automatic_workers(mesh: Path | None) -> int:
    """One worker a processor where the mesh is so large that they gain more time than they take to start."""
    with suppress(OSError):
        if mesh is not None and mesh.stat().st_size >= _LARGE_FILE:
            return processor_count() if processor_count() > 1 else 0
    return 0


def _bytes(text: str) -> int:
    """A size in bytes, such as 500MB, 8GB or 7.5GiB."""
    words = re.fullmatch(r"(\d+\.?\d*|\.\d+)\s*([kmgt]?)(i?)b?", text.strip().lower())
    if words is None:
        raise argparse.ArgumentTypeError(f"{text!r} is no size such as 500MB, 8GB or 7.5GiB")
    return int(float(words[1]) * (1024 if words[3] else 1000) ** " kmgt".index(words[2] or " "))


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("pgcp")
    except PackageNotFoundError:
        return "(not installed)"


def _say(text: str) -> None:
    """Print; a reader that has left is no failure, a full disk is one."""
    try:
        print(text, flush=True)
    except OSError as problem:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(problem, BrokenPipeError):
            raise InputError(f"cannot print: {problem.strerror}") from problem


class _Bars(AbstractContextManager["_Bars"]):
    """A bar per stage, on a terminal; nothing elsewhere."""

    def __init__(self, shown: bool) -> None:
        self._bars: Any = None
        self._tasks: dict[str, Any] = {}
        if shown:
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

            columns = (TextColumn("{task.description:<10}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
            self._bars = Progress(*columns, console=Console(stderr=True))

    def __call__(self, stage: str, done: int, total: int) -> None:
        if self._bars is None:
            return
        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(stage, total=total)
        self._bars.update(self._tasks[stage], completed=done, total=total)

    def __enter__(self) -> _Bars:
        if self._bars is not None:
            self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bars is not None:
            self._bars.stop()


class _Signals(AbstractContextManager["_Signals"]):
    """Signals that end a run are KeyboardInterrupts, so that everything is tidied; only the first counts."""

    def __init__(self) -> None:
        self._before: dict[int, Any] = {}
        self.name = "SIGINT"
        self.received = False

    def __enter__(self) -> _Signals:
        if threading.current_thread() is threading.main_thread():
            numbers = [getattr(signal, name) for name in _STOPPED if hasattr(signal, name)]
            # one that is ignored, as under nohup, stays so
            self._before = {n: old for n in numbers if (old := signal.getsignal(n)) not in (signal.SIG_IGN, None)}
            self._set(self._stop)
        return self

    def __exit__(self, *_: object) -> None:
        for number, old in self._before.items():
            signal.signal(number, old)

    def _set(self, handler: Any) -> None:
        for number in self._before:
            signal.signal(number, handler)

    def _stop(self, number: int, _frame: object) -> None:
        self._set(signal.SIG_IGN)
        self.name, self.received = signal.Signals(number).name, True
        raise KeyboardInterrupt

    @contextmanager
    def held(self) -> Iterator[None]:
        """Ignore them while results take the place of earlier ones; afterwards they end the process at once."""
        self._set(signal.SIG_IGN)
        yield
        self._set(signal.SIG_DFL)


def _check_only(mesh: Mesh, target: str, fix: bool) -> int:
    from pgcp.check import check_mended, check_mesh, what_fix_would_do
    from pgcp.mend import mend
    from pgcp.topology import examine

    topology = examine(mesh.faces, len(mesh.vertices))
    _say(f"{mesh.name}: {topology.describe()}")
    _say(
        f"  {topology.vertex_count} vertices, {topology.edge_count} edges, {topology.face_count} faces, "
        f"{topology.component_count} component{'s' if topology.component_count != 1 else ''}, "
        f"Euler characteristic {topology.euler_characteristic}, "
        f"boundary loops {[len(loop) for loop in topology.loops] or 'none'}"
    )
    if topology.unreferenced_count:
        _say(f"  note: {topology.unreferenced_count} vertices are used by no face; they stay where they are in the order")
    fitting = "free, disk" if topology.is_disk else "sphere" if topology.is_sphere else "none"
    _say(f"  targets that fit: {fitting}")
    for defect in topology.defects:
        _say(f"  defect: {defect.message}")
    if fix:
        mended = mend(mesh, target)
        for done in mended.fixes:
            _say(f"  fixed: {done.as_record()['message']}")
        check_mended(mended, target)
        _say(f"  then it is {mended.topology.describe()}")
        return GOOD
    cure = what_fix_would_do(mesh, target)
    if cure:
        _say(f"  --fix would {cure}")
    try:
        check_mesh(mesh, target)
    except InputError as problem:
        _say(f"  refused: {problem}")
        return BAD_INPUT
    return GOOD


def _counted(count: int, one: str, many: str) -> str:
    return f"{count} {one if count == 1 else many}"


def _notes(report: dict[str, Any]) -> str:
    """Lines on what a user should know of a map beside its quality."""
    helped = [r for r in report["repairs"] if r["folds_after"] < r["folds_before"]]
    lines = [f"repaired by {r['method']}: {r['folds_before']} folds to {r['folds_after']}" for r in helped]
    if report["fallback"]:
        lines.append(
            f"instead of {report['fallback']['from']}, mapped to {report['fallback']['to']}: {report['fallback']['reason']}"
        )
    if report["overlap"] and report["overlap"]["crossings"]:
        crossings = _counted(report["overlap"]["crossings"], "time", "times")
        lines.append(f"the boundary crosses itself {crossings}: the map overlaps itself (--no-overlap maps to the disk)")
    return "".join(f"  {line}\n" for line in lines)


def _summary(result: Parameterization, seconds: float, directory: Path) -> str:
    q = result.quality
    stages = ", ".join(f"{s['name']} {s['seconds']:.2f}" for s in result.report["stages"])
    patches = _counted(len(result.report["patches"]), "patch", "patches")
    fixes = "".join(f"  fixed: {fix['message']}\n" for fix in result.report["fixes"])
    return (
        f"{result.mesh.name}: {len(result.mesh.vertices)} vertices, target {result.target}, {patches}, "
        f"{seconds:.1f} s ({stages})\n"
        f"{fixes}"
        f"  |angle error| mean {q.angle_mean_deg:.4f}, sd {q.angle_sd_deg:.4f}, max {q.angle_max_deg:.2f} degrees; "
        f"folds {q.folds}{'' if q.degree is None else f', degree {q.degree:.0f}'}\n"
        f"{_notes(result.report)}"
        f"  results in {directory}"
    )


def _record(result: Parameterization, seconds: float, paths: list[Path]) -> dict[str, Any]:
    """What ``--json`` says of a finished map."""
    report = result.report
    return {
        "status": NUMERICAL if result.quality.folds else GOOD,
        "mesh": report["mesh"],
        "target": result.target,
        "patches": len(report["patches"]),
        "seconds": round(seconds, 3),
        "fixes": report["fixes"],
        "quality": report["quality"],
        "repairs": report["repairs"],
        "overlap": report["overlap"],
        "fallback": report["fallback"],
        "files": [str(path) for path in paths],
    }


def _repairs(text: str) -> tuple[str, ...]:
    """Tiers of repair named on the command line."""
    if text in ("all", "none"):
        return REPAIRS if text == "all" else ()
    return tuple(name.strip() for name in text.split(","))


def _workers_of(arguments: argparse.Namespace) -> int:
    if arguments.workers is not None:
        return int(arguments.workers)
    elsewhere = arguments.scheduler is not None or arguments.scheduler_file is not None
    return 0 if elsewhere else _automatic_workers(arguments.mesh)


def _options(arguments: argparse.Namespace) -> Options:
    return Options(
        patches=arguments.patches,
        workers=_workers_of(arguments),
        target=arguments.target,
        centre=arguments.centre,
        moebius=arguments.moebius,
        scheduler=arguments.scheduler,
        scheduler_file=arguments.scheduler_file,
        cuts=arguments.cuts,
        repair_cuts=arguments.repair_cuts,
        method=arguments.method,
        flatten=arguments.flatten,
        seams=arguments.seams,
        backend=arguments.backend,
        seed=arguments.seed,
        store=arguments.store,
        repairs=_repairs(arguments.repairs),
        no_overlap=arguments.no_overlap,
        factor_cache_bytes=None if arguments.factor_cache_mb is None else arguments.factor_cache_mb * 1024**2,
        memory_limit_bytes=arguments.memory_limit,
        fix=arguments.fix,
        resume=arguments.resume,
        tls_ca=arguments.tls_ca,
        tls_cert=arguments.tls_cert,
        tls_key=arguments.tls_key,
    )


def _run(arguments: argparse.Namespace, signals: _Signals) -> int:
    options = _options(arguments)
    named = ((arguments.store, "store"), (arguments.scheduler_file, "scheduler file"), (arguments.tls_ca, "certificate"))
    for path, what in (*named, (arguments.tls_cert, "certificate"), (arguments.tls_key, "key")):
        if path is not None and not path.exists():
            raise InputError(f"{path}: there is no such {what}")
    if arguments.store is not None and not arguments.store.is_dir():
        raise InputError(f"{arguments.store}: the store is no directory")
    if options.starts_workers and not arguments.check_only:
        prepare_forks()
    from pgcp.demo import demo_mesh
    from pgcp.io import read_mesh

    started = time.perf_counter()
    if arguments.check_only:
        mesh = demo_mesh() if arguments.mesh is None else read_mesh(arguments.mesh)
        return _check_only(mesh, arguments.target, arguments.fix)
    from pgcp.io import write_outputs
    from pgcp.pipeline import compute, fold_message
    from pgcp.report import draw

    stem = "demo" if arguments.mesh is None else arguments.mesh.stem
    beside = Path() if arguments.mesh is None else arguments.mesh.parent
    directory: Path = arguments.output_dir or beside / f"{stem}_pgcp"
    if directory.exists() and not directory.is_dir():
        raise InputError(f"{directory}: there is a file of this name where the results should go")
    if arguments.mesh is not None and directory.is_dir() and directory.samefile(beside):
        raise InputError(f"{directory}: results here would take the place of {arguments.mesh}; choose another --output-dir")
    with _Bars(sys.stderr.isatty() and not arguments.quiet) as bars:
        result = compute(demo_mesh() if arguments.mesh is None else arguments.mesh, options, bars)
    try:
        picture = None if arguments.no_png else draw(result)
        kinds = [kind for kind, left_out in (("obj", arguments.no_obj), ("ply", arguments.no_ply)) if not left_out]
        paths = write_outputs(directory, stem, result, picture, signals.held(), kinds)
    except OSError as problem:
        raise InputError(f"{directory}: cannot write the results: {problem}") from problem
    if arguments.json:
        _say(json.dumps(_record(result, time.perf_counter() - started, paths)))
    elif not arguments.quiet:
        _say(_summary(result, time.perf_counter() - started, directory))
    if result.quality.folds:
        print(
            f"pgcp-run: {fold_message(result)}. The results in {directory} are marked so (report.json: status folded)",
            file=sys.stderr,
        )
        return NUMERICAL
    return GOOD


def _refused(problem: Exception, status: int, as_json: bool) -> int:
    if as_json:
        _say(json.dumps({"status": status, "error": type(problem).__name__, "message": str(problem)}))
    print(f"pgcp-run: {problem}", file=sys.stderr)
    return status


def _stopped(signals: _Signals, as_json: bool, resume: bool) -> int:
    status: int = 128 + getattr(signal, signals.name)
    message = f"{_STOPPED[signals.name]}; nothing was written"
    if resume:
        message += "; what is finished is kept for --resume"
    if as_json:
        _say(json.dumps({"status": status, "error": "KeyboardInterrupt", "message": message}))
    print(f"pgcp-run: {message}", file=sys.stderr)
    return status


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    arguments = build_parser().parse_args(argv)
    with _Signals() as signals:
        try:
            return _run(arguments, signals)
        except PgcpError as problem:
            if arguments.debug:
                raise
            status = next(status for kind, status in _STATUS.items() if isinstance(problem, kind))
            return _refused(problem, status, arguments.json)
        except KeyboardInterrupt:
            return _stopped(signals, arguments.json, arguments.resume)
        except Exception as problem:
            if signals.received:  # compiled code makes another exception of the interrupt
                return _stopped(signals, arguments.json, arguments.resume)
            if arguments.debug:
                raise
            if isinstance(problem, OSError) and problem.errno in _SYSTEM:
                return _refused(problem, BAD_INPUT, arguments.json)
            if arguments.json:
                _say(json.dumps({"status": BUG, "error": type(problem).__name__, "message": str(problem)}))
            print(f"pgcp-run: a bug: {type(problem).__name__}: {problem} (--debug shows where)", file=sys.stderr)
            return BUG


def run() -> NoReturn:
    """Run the command and end the process."""
    collect_seldom()
    status = main()
    with suppress(OSError):
        sys.stdout.flush()
        sys.stderr.flush()
    leave(status)
    raise SystemExit(status)
