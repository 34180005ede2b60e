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
import importlib.util
import json
import shlex
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import contestants
import numpy as np
from columns import aligned, draw_stacks, write_tsv
from contestants import KNOWN, OPEN_ONLY, SOLVE_ONLY
from processes import Measured, run_measured, run_pgcp, stage_seconds, warm_up

import pgcp
from pgcp.elimination import pardiso
from pgcp.surface.topology import examine

FIGURES = ("wall_s", "cpu_s", "peak_mb", "s_per_M", "mb_per_M", "to_solve", "to_process")
COLUMNS = ("mesh", "vertices", "contestant", "run", "status", "patches", "wall_s", "cpu_s", "peak_mb", "root_peak_mb")


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
            command = [sys.executable, contestants.__file__, name, path, out, "--threads", str(arguments.threads)]
            measured = run_measured(command, looks_at_memory)
            return measured, None, json.loads(out.read_text()) if out.exists() else {}
        command = arguments.named[name].replace("{mesh}", shlex.quote(str(path))).replace("{out}", shlex.quote(str(out)))
        return run_measured(shlex.split(command), looks_at_memory), None, {}


def installed(names: Sequence[str]) -> list[str]:
    """Contestants that can run here; says which cannot."""
    out = []
    for name in names:
        if name == "lscm" and importlib.util.find_spec("igl") is None:
            print("lscm is left out: the module igl (package libigl) is not installed", file=sys.stderr)
        elif name.startswith("pardiso") and not pardiso.is_available():
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


def every_run(rows: Sequence[Row]) -> list[list[str]]:
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
    return lines


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
    arguments = parser.parse_args(words)
    against = [] if arguments.against == "none" else arguments.against.split(",")
    unknown = [name for name in against if name not in KNOWN]
    if unknown:
        parser.error(f"unknown contestant {unknown[0]!r}; choose from {', '.join(KNOWN)}, or none")
    arguments.chosen = installed(against)
    arguments.named = {f"{Path(shlex.split(c)[0]).name} ({k})": c for k, c in enumerate(arguments.external, 1)}
    return arguments


def main(words: Sequence[str] | None = None) -> None:
    arguments = parsed(words)
    warm_up({"workers": arguments.workers})
    rows = [row for path in arguments.meshes for row in run_all(path, arguments)]
    print(aligned(summary(rows)))
    write_tsv(arguments.output_dir / "benchmark.tsv", every_run(rows))
    draw(rows, arguments.output_dir / "benchmark.png")
    print(f"\nevery run is in {arguments.output_dir / 'benchmark.tsv'}, a picture in {arguments.output_dir / 'benchmark.png'}")


if __name__ == "__main__":
    main()
