#!/usr/bin/env python3
"""Speedup by number of subdomains and of workers: the experiment of PGCP section 5.6, Table 6.

usage: speedup.py [--patches 2..6] [--workers 1..2] [--repeat 1] [--target auto] [--started] [--output-dir DIR] MESH
Numbers are lists and ranges, such as 2..6 or 2,4,8..10. Every run is a pgcp-run in processes of its own, after one on its demo
that is not counted; all are repeated --repeat times, in turns, and medians taken. With --started, runs are those of this
process on workers that have been started, and have mapped the mesh once, before: what is left is the computation.

Columns, for each number of workers w:
n          number of subdomains
V/n        average mesh size: vertices by n
T_n        seconds that pgcp-run says it took, from reading the mesh to writing the results; with --started nothing is written
S_n        speedup T_2 / T_n; where there is no n = 2, the least n takes its place
n/2        the subdomain ratio
E_n        efficiency S_n / (n/2)
parallel   seconds of the stages that run on the workers: flatten, which waits for workers that are starting and welds what it
           can meanwhile, weld, solve
S_w        speedup of the whole run over the least number of workers, with the same n
E_w        S_w by the ratio of the numbers of workers
S_w par.   the same speedup of the parallel stages alone
and the seconds of every stage. In the paper n subdomains had n workers: the rows with w = n are that experiment.
Writes speedup.tsv and speedup.png, the stages of every run.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from columns import aligned, draw_stacks, write_tsv
from processes import run_pgcp, stage_seconds, warm_up, watched

import pgcp
from pgcp.parallel import limited_to
from pgcp.runtime.executors import start_cluster
from pgcp.runtime.forks import prepare_forks

PARALLEL = ("flatten", "weld", "solve", "merge")
REST = "write and the rest"


@dataclass(frozen=True, slots=True)
class Run:
    """What runs with so many patches and workers took, medians: seconds in all and by stage, bytes of all processes."""

    patches: int
    workers: int
    vertices: int
    seconds: float
    stages: dict[str, float]
    peak_bytes: float = 0.0

    @property
    def parallel_s(self) -> float:
        """Seconds of the parallel stages."""
        return sum(self.stages.get(name, 0.0) for name in PARALLEL)


def numbers(text: str) -> list[int]:
    """The increasing numbers that a list of numbers and ranges names: 2..4,8 is [2, 3, 4, 8]."""
    out: set[int] = set()
    for part in text.split(","):
        first, _, last = part.partition("..")
        found = range(int(first), int(last or first) + 1)
        if not found:
            raise ValueError(f"the range {part} is empty")
        out |= set(found)
    return sorted(out)


def speedup(base: float, seconds: float, ratio: float) -> tuple[float, float]:
    """S = base / seconds, and the efficiency S / ratio."""
    return base / seconds, base / seconds / ratio


def table(runs: Sequence[Run]) -> list[list[str]]:
    """Table 6 for every number of workers, and the speedup between these."""
    stages = list(dict.fromkeys(name for run in runs for name in run.stages))
    heads = ["workers", "n", "V/n", "T_n", "S_n", "n/2", "E_n", "parallel", "S_w", "E_w", "S_w par.", "peak_mb", *stages]
    out = [heads]
    by = {(run.patches, run.workers): run for run in runs}
    patches = sorted({run.patches for run in runs})
    base = 2 if 2 in patches else patches[0]
    fewest = min(run.workers for run in runs)
    for run in sorted(runs, key=lambda r: (r.workers, r.patches)):
        n, w = run.patches, run.workers
        s_n, e_n = speedup(by[base, w].seconds, run.seconds, n / base)
        s_w, e_w = speedup(by[n, fewest].seconds, run.seconds, max(w, 1) / max(fewest, 1))
        s_parallel, _ = speedup(by[n, fewest].parallel_s, run.parallel_s, 1.0)
        figures = (run.seconds, s_n, n / base, e_n, run.parallel_s, s_w, e_w, s_parallel)
        seconds = [f"{run.stages.get(name, 0.0):.3f}" for name in stages]
        row = [str(w), str(n), f"{run.vertices / n:.0f}", *(f"{x:.2f}" for x in figures), f"{run.peak_bytes / 1e6:.0f}"]
        out.append(row + seconds)
    return out


def run_of(patches: int, workers: int, found: Sequence[tuple[dict[str, Any], float, int]]) -> Run:
    """Of equal runs medians over reports and seconds, and the peak memory, looked at in the first.

    Raises SystemExit where the patches are other ones.
    """
    stages = []
    for report, seconds, _ in found:
        if len(report["patches"]) != patches:
            raise SystemExit(f"{patches} patches on {workers} workers came to {len(report['patches'])}")
        by_stage = stage_seconds(report)
        stages.append({**by_stage, REST: max(0.0, seconds - sum(by_stage.values()))})
    names = dict.fromkeys(name for by_stage in stages for name in by_stage)
    middle = {name: median(by_stage.get(name, 0.0) for by_stage in stages) for name in names}
    vertices = found[0][0]["mesh"]["vertices"]
    return Run(patches, workers, vertices, median(f[1] for f in found), middle, max(f[2] for f in found))


def measure(mesh: Path, patches: Sequence[int], workers: Sequence[int], target: str, repeat: int) -> list[Run]:
    """Run pgcp-run so often on every number of patches and workers, in turns, and take medians.

    Raises SystemExit where one ends without a map.
    """
    found: dict[tuple[int, int], list[tuple[dict[str, Any], float, int]]] = {(n, w): [] for n in patches for w in workers}
    for number in range(repeat):
        for (n, w), runs in found.items():
            options = {"patches": n, "workers": w, "target": target}
            measured, report, seconds = run_pgcp(mesh, options, looks_at_memory=number == 0)
            if report is None:
                raise SystemExit(f"{mesh}: {n} patches on {w} workers: {measured.errors.strip()}")
            runs.append((report, seconds, measured.peak_bytes))
    return [run_of(n, w, runs) for (n, w), runs in found.items()]


def measure_started(path: Path, patches: Sequence[int], workers: int, target: str, repeat: int) -> list[Run]:
    """The same on workers that have been started, as pgcp-run starts its own, and have mapped the mesh once."""
    runs = []
    prepare_forks()
    with limited_to(workers), start_cluster(workers) as cluster:
        running = pgcp.Running(scheduler=cluster.scheduler_address)
        pgcp.compute(path, pgcp.Options(patches=patches[0], target=target), running)
        for count in patches:
            found = []
            for number in range(repeat):
                start = time.perf_counter()
                with watched(os.getpid(), looks_at_memory=number == 0) as watch:
                    result = pgcp.compute(path, pgcp.Options(patches=count, target=target), running)
                found.append((result.report, time.perf_counter() - start, watch.peak_bytes))
            runs.append(run_of(count, workers, found))
    return runs


def draw(runs: Sequence[Run], path: Path, title: str) -> None:
    """Stacked bars of stages."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 5), dpi=110, layout="constrained")
    axes = figure.subplots()
    ordered = sorted(runs, key=lambda r: (r.workers, r.patches))
    draw_stacks(axes, [run.stages for run in ordered], [f"n = {run.patches}, w = {run.workers}" for run in ordered])
    axes.set_title(title, fontsize=10)
    figure.savefig(path)


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", type=Path)
    parser.add_argument("--patches", type=numbers, default=numbers("2..6"))
    parser.add_argument("--workers", type=numbers, default=numbers("1..2"))
    parser.add_argument("--repeat", type=int, default=1)
    parser.add_argument("--target", default="auto")
    parser.add_argument("--started", action="store_true")
    parser.add_argument("--output-dir", type=Path, default=Path())
    arguments = parser.parse_args(words)
    mesh, target, repeat = arguments.mesh, arguments.target, arguments.repeat
    if arguments.started:
        runs = [run for w in arguments.workers for run in measure_started(mesh, arguments.patches, w, target, repeat)]
    else:
        warm_up({"workers": max(arguments.workers)})
        runs = measure(mesh, arguments.patches, arguments.workers, target, repeat)
    rows = table(runs)
    print(f"{arguments.mesh.stem}, {runs[0].vertices} vertices, medians of {arguments.repeat}")
    print(aligned(rows))
    write_tsv(arguments.output_dir / "speedup.tsv", rows)
    draw(runs, arguments.output_dir / "speedup.png", f"{arguments.mesh.stem}, {runs[0].vertices:,} vertices")


if __name__ == "__main__":
    main()
