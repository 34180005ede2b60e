#!/usr/bin/env python3
"""One SVG of what benchmark.py and speedup.py have measured: time and memory by vertices, and time by patches and workers.

usage: figures.py [--speedup speedup.tsv] [--output docs/images/benchmark.svg] benchmark.tsv [benchmark.tsv ...]

Times are medians over runs of whole processes, memory is the most that all processes of a run held together; runs that failed
are left out. The last line of the picture has the day of the newest table, the machine, and the versions of the packages.
"""

from __future__ import annotations

import argparse
import csv
import platform
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from statistics import median

from pgcp.parallel import processor_count
from pgcp.runtime.versions import package_versions

ROOT = Path(__file__).resolve().parents[2]
NAMES = {
    "pgcp": "pgcp-run",
    "pardiso": "PARDISO, one Laplacian",
    "pardiso3": "PARDISO, parallel METIS",
    "scipy": "SciPy's sparse LU, DNCP",
    "lscm": "libigl, LSCM",
}
MARKS = ("o-", "s-", "^-", "D-", "v-", "P-", "X-")


def rows_of(paths: Sequence[Path]) -> list[dict[str, str]]:
    """Rows of tables with tabs; raises SystemExit where there is none."""
    rows = []
    for path in paths:
        with path.open(newline="") as stream:
            rows += list(csv.DictReader(stream, delimiter="\t"))
    if not rows:
        raise SystemExit("the tables have no rows")
    return rows


def by_contestant(rows: Sequence[dict[str, str]]) -> dict[str, list[tuple[int, float, float]]]:
    """Vertices, median seconds and largest memory (MB, nan where it is unknown) of each contestant's good runs, by size."""
    good = [row for row in rows if row["status"] == "0"]
    out: dict[str, list[tuple[int, float, float]]] = {}
    for name, vertices in sorted({(row["contestant"], int(row["vertices"])) for row in good}):
        own = [row for row in good if (row["contestant"], int(row["vertices"])) == (name, vertices)]
        memory = max((float(row["peak_mb"]) for row in own if row["peak_mb"]), default=float("nan"))
        out.setdefault(name, []).append((vertices, median(float(row["wall_s"]) for row in own), memory))
    return out


def said(paths: Sequence[Path]) -> str:
    """The day of the newest table, the machine, and the versions."""
    day = date.fromtimestamp(max(path.stat().st_mtime for path in paths)).isoformat()
    packages = {name: version for name, version in package_versions().items() if name != "distributed"}
    versions = ", ".join(f"{name} {version}" for name, version in packages.items())
    return f"{day}; {processor_count()} processors, {platform.machine()}, {platform.system()}; {versions}"


def draw(benchmarks: Sequence[Path], speedup: Path | None, output: Path) -> None:
    """Draw the picture."""
    import matplotlib
    from matplotlib.figure import Figure

    measured = by_contestant(rows_of(benchmarks))
    figure = Figure(figsize=(13 if speedup else 9, 4.2), layout="constrained")
    axes = figure.subplots(1, 3 if speedup else 2)
    for (name, points), mark in zip(measured.items(), MARKS * 4, strict=False):
        sizes, seconds, memory = zip(*points, strict=True)
        axes[0].loglog(sizes, seconds, mark, label=NAMES.get(name, name))
        axes[1].loglog(sizes, memory, mark, label=NAMES.get(name, name))
    axes[0].set(title="whole processes", xlabel="vertices", ylabel="seconds")
    axes[1].set(title="memory, all processes together", xlabel="vertices", ylabel="MB")
    axes[0].legend(fontsize=8)
    if speedup:
        rows = rows_of([speedup])
        for workers in sorted({int(row["workers"]) for row in rows}):
            own = sorted((int(row["n"]), float(row["T_n"])) for row in rows if int(row["workers"]) == workers)
            axes[2].plot(*zip(*own, strict=True), "o-", label=f"{workers} worker{'s' if workers != 1 else ''}")
        axes[2].set(title="patches and workers (PGCP Table 6)", xlabel="patches", ylabel="seconds", ylim=0)
        axes[2].legend(fontsize=8)
    for panel in axes:
        panel.grid(alpha=0.3)
    figure.supxlabel(said([*benchmarks, *([speedup] if speedup else [])]), fontsize=6.5, color="#555555")
    output.parent.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "pgcp"}):
        figure.savefig(output, format="svg", metadata={"Date": None})


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("benchmarks", nargs="+", type=Path, metavar="benchmark.tsv")
    parser.add_argument("--speedup", type=Path, metavar="speedup.tsv")
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "images" / "benchmark.svg")
    arguments = parser.parse_args(words)
    draw(arguments.benchmarks, arguments.speedup, arguments.output)
    print(f"drawn into {arguments.output}")


if __name__ == "__main__":
    main()
