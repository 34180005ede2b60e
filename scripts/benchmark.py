#!/usr/bin/env python3
"""Benchmark whole processes: pgcp-run beside other ways to map or solve, in turns, on every mesh.

usage: benchmark.py [--workers 2] [--patches K] [--target T] [--repeat 3] [--against pardiso,pardiso3,scipy,lscm]
                    [--external "COMMAND {mesh} {out}"] [--threads 2] [--output-dir DIR] MESH [MESH ...]

pardiso    the yardstick: one MKL PARDISO analysis (METIS), factorization and solve with two right-hand sides of the
           interior cotangent Laplacian of the whole mesh, on --threads threads; of a closed mesh one vertex is held
pardiso3   the same with the parallel METIS
scipy      DNCP of the whole mesh (PGCP section 4.2) by SciPy's sparse LU; open meshes only
lscm       igl.lscm of the whole mesh, where libigl's module igl is installed; open meshes only
external   any command; {mesh} is the mesh file, {out} a path in a folder that is removed afterwards
--against none leaves all of them out. Every contestant runs in processes of its own, A B C A B C ..., after one run of
pgcp-run on its demo that is not counted.

Measured are wall seconds; CPU seconds of all processes together; their peak memory together, looked at every 50 ms:
proportional set sizes (PSS), taken whenever resident sizes have grown by 2 %, or resident sizes where there are no others;
in the first of repeated runs only, since looking takes some time of those who are looked at.
Prints medians, of memory the most, also per million vertices, and the ratio of wall seconds to the yardstick's solve alone
(analysis, factorization, solve) and to its whole process. Writes benchmark.tsv, a row per run with its stages, and
benchmark.png.
"""

from __future__ import annotations

import argparse
import ctypes
import importlib.util
import json
import os
import shlex
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import psutil
from scipy.sparse import block_array, coo_array, csr_array, triu
from scipy.sparse.linalg import splu

import pgcp
from pgcp import dirichlet_pardiso
from pgcp.operators import cotangent_laplacian
from pgcp.topology import examine

KNOWN = ("pardiso", "pardiso3", "scipy", "lscm")
OPEN_ONLY = ("scipy", "lscm")
FIGURES = ("wall_s", "cpu_s", "peak_mb", "s_per_M", "mb_per_M", "to_solve", "to_process")
COLUMNS = ("mesh", "vertices", "contestant", "run", "status", "patches", "wall_s", "cpu_s", "peak_mb", "root_peak_mb")
SOLVE_ONLY = ("analysis", "factor", "substitute")
_LOOK_S = 0.05
_FIND_S = 0.3  # between two searches for children, which look at every process there is
_GROWTH = 1.02
_RESIDUAL = 1e-6


# ---------------------------------------------------------------------------------------------- one process and its children


@dataclass(frozen=True, slots=True)
class Measured:
    """One finished command: exit status, seconds, peak memory of the tree and of its root alone, the end of what it said."""

    status: int
    wall_s: float
    cpu_s: float
    peak_bytes: int
    root_peak_bytes: int
    output: str
    errors: str


class Watch:
    """Memory and CPU seconds of a process and all its children, as far as seen; what all hold together on request only."""

    def __init__(self, pid: int, looks_at_memory: bool) -> None:
        self._looks_at_memory = looks_at_memory
        self.root = psutil.Process(pid)
        self.peak_bytes = self.root_peak_bytes = 0
        self._resident = 0.0
        self._processes = [self.root]
        self._found = 0.0
        self._cpu: dict[tuple[int, float], float] = {}

    @property
    def cpu_s(self) -> float:
        """Seconds of all processes seen, up to when they were last seen."""
        return sum(self._cpu.values())

    def look(self) -> None:
        """Look once."""
        with suppress(psutil.Error):
            if time.monotonic() > self._found + _FIND_S:
                self._processes = [self.root, *self.root.children(recursive=True)]
                self._found = time.monotonic()
            sizes = [self._size(process) for process in self._processes]
            self.root_peak_bytes = max(self.root_peak_bytes, sizes[0])
            if self._looks_at_memory and sum(sizes) > _GROWTH * self._resident:
                self._resident = sum(sizes)
                self.peak_bytes = max(self.peak_bytes, sum(self._share(process) for process in self._processes))

    def _size(self, process: psutil.Process) -> int:
        with suppress(psutil.Error):
            times = process.cpu_times()
            self._cpu[process.pid, process.create_time()] = times.user + times.system
            return int(process.memory_info().rss)
        return 0

    @staticmethod
    def _share(process: psutil.Process) -> int:
        with suppress(psutil.Error):
            try:
                return int(process.memory_full_info().pss)
            except AttributeError:
                return int(process.memory_info().rss)
        return 0


@contextmanager
def watched(pid: int, looks_at_memory: bool = True) -> Iterator[Watch]:
    """Look at a process and its children every 50 ms while what is inside runs."""
    watch, ended = Watch(pid, looks_at_memory), threading.Event()

    def keep_looking() -> None:
        while not ended.is_set():
            watch.look()
            ended.wait(_LOOK_S)

    thread = threading.Thread(target=keep_looking)
    thread.start()
    try:
        yield watch
    finally:
        ended.set()
        thread.join()


def run_measured(command: Sequence[str | Path], looks_at_memory: bool = True) -> Measured:
    """Run a command to its end and measure it with all processes it starts."""
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        start = time.perf_counter()
        process = subprocess.Popen([str(word) for word in command], stdout=output, stderr=errors, stdin=subprocess.DEVNULL)
        with watched(process.pid, looks_at_memory) as watch:
            _, status, usage = os.wait4(process.pid, 0)
            wall_s = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        texts = []
        for stream in (output, errors):
            stream.seek(0)
            texts.append(stream.read().decode(errors="replace"))
    # what the kernel adds up leaves out children that nobody has waited for
    cpu_s = max(usage.ru_utime + usage.ru_stime, watch.cpu_s)
    return Measured(process.returncode, wall_s, cpu_s, watch.peak_bytes, watch.root_peak_bytes, *texts)


# ------------------------------------------------------------------------------------------- contestants, in their own process


class Stopwatch:
    """Seconds of named parts."""

    def __init__(self) -> None:
        self.parts: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """Give the time since the last lap to a part."""
        now = time.perf_counter()
        self.parts[name] = now - self._last
        self._last = now


class Pardiso:
    """One symmetric positive definite system in MKL PARDISO; order 2 is METIS, 3 the parallel METIS."""

    def __init__(self, matrix: csr_array, order: int, threads: int) -> None:
        upper = csr_array(triu(matrix, format="csr"))
        upper.sort_indices()
        self._size = upper.shape[0]
        self._values = np.ascontiguousarray(upper.data, np.float64)
        self._starts, self._columns = upper.indptr.astype(np.int32), upper.indices.astype(np.int32)
        self._handle, self._settings = np.zeros(64, np.int64), np.zeros(64, np.int32)
        self._settings[[0, 1, 9, 34]] = 1, order, 8, 1  # no defaults; ordering; pivots perturbed by 1e-8; indices from zero
        self._order = np.zeros(self._size, np.int32)
        self._library = dirichlet_pardiso._library()
        self._library.MKL_Set_Num_Threads(ctypes.c_int(threads))

    def call(self, phase: int, right: np.ndarray, solution: np.ndarray) -> None:
        """Run a phase: 11 analysis, 22 factorization, 33 solve; right and solution (2, n)."""
        numbers = [ctypes.c_int32(v) for v in (1, 1, 2, phase, self._size, 2, 0, 0)]
        factors, matrix, kind, what, size, columns, quiet, status = (ctypes.byref(v) for v in numbers)

        def at(array: np.ndarray) -> ctypes.c_void_p:
            return ctypes.c_void_p(array.ctypes.data)

        self._library.pardiso(
            at(self._handle), factors, matrix, kind, what, size, at(self._values), at(self._starts), at(self._columns),
            at(self._order), columns, at(self._settings), quiet, at(right), at(solution), status,
        )  # fmt: skip
        if numbers[-1].value:
            raise SystemExit(f"PARDISO stopped in phase {phase} with {numbers[-1].value}")


def held_values(mesh: pgcp.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Vertices that are held and where (n, 2): the boundary around a circle, or the first vertex of a closed mesh at 1."""
    loops = examine(mesh.faces, len(mesh.vertices)).loops
    if not loops:
        return np.array([0]), np.ones((1, 2))
    along = np.linalg.norm(np.roll(mesh.vertices[loops[0]], -1, axis=0) - mesh.vertices[loops[0]], axis=1)
    angle = 2 * np.pi * (np.cumsum(along) - along) / along.sum()
    return np.asarray(loops[0]), np.column_stack([np.cos(angle), np.sin(angle)])


def solve_by_pardiso(path: Path, watch: Stopwatch, order: int, threads: int) -> np.ndarray:
    """The yardstick: the harmonic map (V, 2) with the boundary on a circle."""
    mesh = pgcp.read_mesh(path)
    watch.lap("read")
    laplacian = cotangent_laplacian(mesh.vertices, mesh.faces)
    held, values = held_values(mesh)
    inside = np.setdiff1d(np.arange(len(mesh.vertices)), held)
    matrix = csr_array(laplacian[inside][:, inside])
    right = np.ascontiguousarray(-(laplacian[inside][:, held] @ values).T)
    solution = np.zeros_like(right)
    solver = Pardiso(matrix, order, threads)
    watch.lap("matrix")
    for name, phase in zip(SOLVE_ONLY, (11, 22, 33), strict=True):
        solver.call(phase, right, solution)
        watch.lap(name)
    residual = np.abs(matrix @ solution.T - right.T).max() / np.abs(right).max()
    if not residual < _RESIDUAL:
        raise SystemExit(f"PARDISO left a residual of {residual:.1e}")
    out = np.zeros((len(mesh.vertices), 2))
    out[held], out[inside] = values, solution.T
    return out


def dncp(mesh: pgcp.Mesh, watch: Stopwatch) -> np.ndarray:
    """Discrete natural conformal map (V, 2) of an open mesh in one piece, two boundary vertices pinned (PGCP section 4.2).

    The energy 1/2 x'Lx + 1/2 y'Ly - area, area = x'Ky with K = 1/2, -1/2 along boundary edges, is least where its gradient
    is zero.
    """
    count = len(mesh.vertices)
    loop = np.asarray(examine(mesh.faces, count).loops[0])
    after = np.roll(loop, -1)
    laplacian = cotangent_laplacian(mesh.vertices, mesh.faces)
    half = np.full(len(loop), 0.5)
    entries = (np.concatenate([half, -half]), (np.concatenate([loop, after]), np.concatenate([after, loop])))
    area = coo_array(entries, shape=(count, count))
    system = csr_array(block_array([[laplacian, -area], [area, laplacian]]))
    first = loop[0]
    second = loop[np.argmax(np.linalg.norm(mesh.vertices[loop] - mesh.vertices[first], axis=1))]
    out = np.zeros(2 * count)
    out[second] = np.linalg.norm(mesh.vertices[second] - mesh.vertices[first])
    free = np.setdiff1d(np.arange(2 * count), [first, second, first + count, second + count])
    rows = system[free]
    matrix, right = rows[:, free].tocsc(), -(rows @ out)
    watch.lap("matrix")
    factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    watch.lap("factor")
    out[free] = factor.solve(right)
    watch.lap("substitute")
    return out.reshape(2, count).T


def map_by_scipy(path: Path, watch: Stopwatch) -> np.ndarray:
    """DNCP of a mesh file."""
    mesh = pgcp.read_mesh(path)
    watch.lap("read")
    return dncp(mesh, watch)


def map_by_lscm(path: Path, watch: Stopwatch) -> np.ndarray:
    """igl.lscm of a mesh file, two boundary vertices pinned."""
    import igl

    mesh = pgcp.read_mesh(path)
    watch.lap("read")
    loop = np.asarray(examine(mesh.faces, len(mesh.vertices)).loops[0])
    far = loop[np.argmax(np.linalg.norm(mesh.vertices[loop] - mesh.vertices[loop[0]], axis=1))]
    pins = np.array([loop[0], far], np.int64)
    found = igl.lscm(mesh.vertices, mesh.faces.astype(np.int64), pins, np.array([[0.0, 0.0], [1.0, 0.0]]))
    watch.lap("lscm")
    arrays = (part for part in (found if isinstance(found, tuple) else (found,)) if np.shape(part) == (len(mesh.vertices), 2))
    return next(arrays)


def be_child(name: str, path: Path, out: Path, threads: int) -> None:
    """Be a contestant: map or solve one mesh and write the seconds of its parts."""
    watch = Stopwatch()
    if name == "scipy":
        positions = map_by_scipy(path, watch)
    elif name == "lscm":
        positions = map_by_lscm(path, watch)
    else:
        positions = solve_by_pardiso(path, watch, 3 if name == "pardiso3" else 2, threads)
    if not np.isfinite(positions).all():
        raise SystemExit(f"{name}: positions are not finite")
    out.write_text(json.dumps(watch.parts))


# ------------------------------------------------------------------------------------------------------------------- the runs


@dataclass(frozen=True, slots=True)
class Row:
    """One run of one contestant."""

    mesh: str
    vertices: int
    name: str
    number: int
    measured: Measured
    patches: int | None = None
    stages: dict[str, float] = field(default_factory=dict)

    @property
    def solve_s(self) -> float:
        """Seconds of the solve alone, for the yardstick."""
        return sum(self.stages.get(name, 0.0) for name in SOLVE_ONLY)


def stage_seconds(report: dict[str, Any]) -> dict[str, float]:
    """Seconds by stage of a report of pgcp-run; what was tried again is added up."""
    out: dict[str, float] = {}
    for stage in report["stages"]:
        out[stage["name"]] = out.get(stage["name"], 0.0) + stage["seconds"]
    return out


def pgcp_command(mesh: Path | None, out: Path, options: dict[str, Any]) -> list[str]:
    """The command for one run, of the demo where there is no mesh, without pictures; options that are None are left out."""
    words = [f"--{name}={value}" for name, value in options.items() if value is not None]
    words += ["--no-obj", "--no-ply", "--no-png", f"--output-dir={out}"]
    return [sys.executable, "-m", "pgcp", *([] if mesh is None else [str(mesh)]), *words]


def run_pgcp(
    path: Path, options: dict[str, Any], looks_at_memory: bool = True
) -> tuple[Measured, dict[str, Any] | None, float]:
    """Run pgcp-run once: its report, and the seconds it says it took; None and nan where it has failed."""
    with tempfile.TemporaryDirectory() as folder:
        measured = run_measured([*pgcp_command(path, Path(folder), options), "--json", "--quiet"], looks_at_memory)
        report = Path(folder) / "report.json"
        if not report.exists():
            return measured, None, float("nan")
        return measured, json.loads(report.read_text()), float(json.loads(measured.output)["seconds"])


def warm_up(options: dict[str, Any]) -> Measured:
    """Let pgcp-run map its demo once, so that nothing is compiled in the runs that count."""
    with tempfile.TemporaryDirectory() as folder:
        return run_measured(pgcp_command(None, Path(folder), options))


def run_contestant(
    name: str, path: Path, arguments: argparse.Namespace, looks_at_memory: bool
) -> tuple[Measured, int | None, dict[str, float]]:
    """Run a contestant once; its number of patches and stages, where it has some."""
    if name == "pgcp":
        options = {"workers": arguments.workers, "patches": arguments.patches, "target": arguments.target}
        measured, report, _ = run_pgcp(path, options, looks_at_memory)
        return measured, *((len(report["patches"]), stage_seconds(report)) if report else (None, {}))
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        if name in KNOWN:
            words = ["--child", name, "--child-output", out, "--threads", str(arguments.threads)]
            measured = run_measured([sys.executable, Path(__file__), *words, path], looks_at_memory)
            return measured, None, json.loads(out.read_text()) if out.exists() else {}
        command = arguments.named[name].replace("{mesh}", shlex.quote(str(path))).replace("{out}", shlex.quote(str(out)))
        return run_measured(shlex.split(command), looks_at_memory), None, {}


def installed(names: Sequence[str]) -> list[str]:
    """Contestants that can run here; says which cannot."""
    out = []
    for name in names:
        if name == "lscm" and importlib.util.find_spec("igl") is None:
            print("lscm is left out: the module igl (package libigl) is not installed", file=sys.stderr)
        elif name.startswith("pardiso") and not dirichlet_pardiso.is_available():
            print(f"{name} is left out: the package mkl is not installed", file=sys.stderr)
        else:
            out.append(name)
    return out


def run_all(path: Path, arguments: argparse.Namespace) -> list[Row]:
    """All runs on one mesh, the contestants in turns."""
    mesh = pgcp.read_mesh(path)
    is_open = bool(examine(mesh.faces, len(mesh.vertices)).loops)
    count = len(mesh.vertices)
    del mesh
    names = ["pgcp", *(n for n in arguments.chosen if is_open or n not in OPEN_ONLY), *arguments.named]
    rows = []
    for number in range(arguments.repeat):
        for name in names:
            measured, patches, stages = run_contestant(name, path, arguments, looks_at_memory=number == 0)
            rows.append(Row(path.stem, count, name, number, measured, patches, stages))
            if measured.status:
                said = measured.errors.strip().splitlines()[-1:]
                print(f"{path.stem}: {name} ended with status {measured.status}: {' '.join(said)}", file=sys.stderr)
    return rows


# ---------------------------------------------------------------------------------------------------- tables and the picture


def middle(rows: Sequence[Row], what: Callable[[Row], float]) -> float:
    """Median over runs, nan where there are none."""
    return median(map(what, rows)) if rows else float("nan")


def summary_line(vertices: int, wall: float, cpu: float, memory: float, yard: Sequence[Row]) -> list[str]:
    """Medians of one contestant, the same per million vertices, and ratios to the yardstick's runs; - where not known."""
    millions = vertices / 1e6
    ratios = wall / middle(yard, lambda r: r.solve_s), wall / middle(yard, lambda r: r.measured.wall_s)
    figures = [(wall, 2), (cpu, 2), (memory, 0), (wall / millions, 2), (memory / millions, 0), (ratios[0], 2), (ratios[1], 2)]
    return ["-" if np.isnan(figure) else f"{figure:.{digits}f}" for figure, digits in figures]


def summary(rows: Sequence[Row]) -> list[list[str]]:
    """Medians by mesh and contestant, the yardstick's solve alone in a line of its own; runs that failed do not count."""
    table = [["mesh", "vertices", "contestant", "runs", *FIGURES]]
    good = [row for row in rows if row.measured.status == 0]
    for mesh, vertices, name in dict.fromkeys((row.mesh, row.vertices, row.name) for row in rows):
        own = [row for row in good if (row.mesh, row.name) == (mesh, name)]
        yard = [row for row in good if (row.mesh, row.name) == (mesh, "pardiso")]
        wall, cpu = middle(own, lambda r: r.measured.wall_s), middle(own, lambda r: r.measured.cpu_s)
        memory = max((r.measured.peak_bytes / 1e6 for r in own if r.measured.peak_bytes), default=float("nan"))
        head = [mesh, str(vertices), name, str(len(own))]
        table.append([*head, *summary_line(vertices, wall, cpu, memory, yard)])
        if name.startswith("pardiso"):
            head[2] += " (solve)"
            table.append([*head, *summary_line(vertices, middle(own, lambda r: r.solve_s), np.nan, np.nan, yard)])
    return table


def aligned(table: Sequence[Sequence[str]]) -> str:
    """A table in columns: the first to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(w) if k == 0 else cell.rjust(w) for k, (cell, w) in enumerate(zip(line, widths, strict=True)))
        for line in table
    )


def tsv(rows: Sequence[Row]) -> str:
    """A row per run, a column per stage."""
    stages = list(dict.fromkeys(stage for row in rows for stage in row.stages))
    lines = [[*COLUMNS, *(f"{stage}_s" for stage in stages)]]
    for row in rows:
        m = row.measured
        peak = f"{m.peak_bytes / 1e6:.1f}" if m.peak_bytes else ""
        numbers = [f"{m.wall_s:.4f}", f"{m.cpu_s:.4f}", peak, f"{m.root_peak_bytes / 1e6:.1f}"]
        seconds = [f"{row.stages[stage]:.4f}" if stage in row.stages else "" for stage in stages]
        patches = "" if row.patches is None else str(row.patches)
        lines.append([row.mesh, str(row.vertices), row.name, str(row.number), str(m.status), patches, *numbers, *seconds])
    return "".join("\t".join(line) + "\n" for line in lines)


def draw_stacks(axes: Any, stacks: Sequence[dict[str, float]], labels: Sequence[str]) -> None:
    """Stacked bars, one colour per part; parts that are never more than a hundredth of a bar are drawn as one."""
    from matplotlib import colormaps

    tall = max((sum(stack.values()) for stack in stacks), default=0.0)
    names = list(dict.fromkeys(name for stack in stacks for name, seconds in stack.items() if seconds > 0.01 * tall))
    floor = np.zeros(len(stacks))
    for k, name in enumerate([*names, "small parts"]):
        heights = [
            stack.get(name, 0.0) if name in names else sum(v for part, v in stack.items() if part not in names)
            for stack in stacks
        ]
        axes.bar(range(len(stacks)), heights, bottom=floor, color=colormaps["tab20"](k % 20), label=name, width=0.8)
        floor += heights
    axes.set_xticks(range(len(stacks)), labels, rotation=90, fontsize=8)
    axes.set_ylabel("seconds")
    axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def draw(rows: Sequence[Row], path: Path) -> None:
    """A picture of stages per mesh, contestants side by side; a mesh has a panel of its own."""
    from matplotlib.figure import Figure

    meshes = list(dict.fromkeys(row.mesh for row in rows))
    figure = Figure(figsize=(8, 4 * len(meshes)), dpi=110, layout="constrained")
    for axes, mesh in zip(figure.subplots(len(meshes), squeeze=False)[:, 0], meshes, strict=True):
        stacks, labels = [], []
        for name in dict.fromkeys(row.name for row in rows if row.mesh == mesh):
            own = [row for row in rows if (row.mesh, row.name) == (mesh, name)]
            stack = {stage: median(row.stages.get(stage, 0.0) for row in own) for stage in own[0].stages}
            rest = middle(own, lambda r: r.measured.wall_s) - sum(stack.values())
            stacks.append({**stack, "start, write and the rest": max(rest, 0.0)})
            labels.append(name)
        draw_stacks(axes, stacks, labels)
        axes.set_title(f"{mesh}, {next(row.vertices for row in rows if row.mesh == mesh):,} vertices", fontsize=10)
    figure.savefig(path)


def parsed(words: Sequence[str] | None = None) -> argparse.Namespace:
    """Arguments; ``chosen`` are the contestants that can run, ``named`` the external ones by name."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--patches")
    parser.add_argument("--target", default="auto")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--against", default=",".join(KNOWN))
    parser.add_argument("--external", action="append", default=[], metavar="COMMAND")
    parser.add_argument("--output-dir", type=Path, default=Path())
    parser.add_argument("--child", choices=KNOWN, help=argparse.SUPPRESS)
    parser.add_argument("--child-output", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args(words)
    against = [] if arguments.against == "none" else arguments.against.split(",")
    unknown = [name for name in against if name not in KNOWN]
    if unknown:
        parser.error(f"unknown contestant {unknown[0]!r}; choose from {', '.join(KNOWN)}, or none")
    arguments.chosen = against if arguments.child else installed(against)
    arguments.named = {f"{Path(shlex.split(c)[0]).name} ({k})": c for k, c in enumerate(arguments.external, 1)}
    return arguments


def main() -> None:
    arguments = parsed()
    if arguments.child:
        be_child(arguments.child, arguments.meshes[0], arguments.child_output, arguments.threads)
        return
    warm_up({"workers": arguments.workers})
    rows = [row for path in arguments.meshes for row in run_all(path, arguments)]
    print(aligned(summary(rows)))
    arguments.output_dir.mkdir(parents=True, exist_ok=True)
    (arguments.output_dir / "benchmark.tsv").write_text(tsv(rows))
    draw(rows, arguments.output_dir / "benchmark.png")
    print(f"\nevery run is in {arguments.output_dir / 'benchmark.tsv'}, a picture in {arguments.output_dir / 'benchmark.png'}")


if __name__ == "__main__":
    main()
