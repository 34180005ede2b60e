#!/usr/bin/env python3
"""Map meshes with many patch counts and seeds: a row per run, tab separated, and a count of what they needed at the end.

usage: matrix.py [--targets free,disk,sphere] [--patches 1,2,3,5,6,8,12,16,24,32] [--seeds 0,1,2] [--output FILE] MESH ...
Targets that do not fit a mesh are left out. Columns: mesh, target, patches, seed, mean |angle error| (degrees), folds left,
seams (weld or exact), patches mapped, attempts that failed, tiers of repair with folds before and after, fallback, seconds.
With --output, rows are added to the file, and runs that it holds already are not done again.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pgcp

FITTING = {True: ("free", "disk"), False: ("sphere",)}


def run(mesh: pgcp.Mesh, target: str, patches: int, seed: int) -> list[str]:
    """Columns of one run from the mean error on."""
    start = time.perf_counter()
    try:
        result = pgcp.compute(mesh, pgcp.Options(patches=patches, target=target, seed=seed))
    except pgcp.PgcpError as problem:
        return ["-", "-", "failed", "-", "-", str(problem).replace("\t", " "), "-", f"{time.perf_counter() - start:.1f}"]
    report = result.report
    repairs = " ".join(f"{r['method']}:{r['folds_before']}-{r['folds_after']}" for r in report["repairs"])
    return [
        f"{result.quality.angle_mean_deg:.4f}", str(result.quality.folds), str(report["seams"]), str(len(report["patches"])),
        str(len(report["retries"])), repairs or "-", report["fallback"]["to"] if report["fallback"] else "-",
        f"{time.perf_counter() - start:.1f}",
    ]  # fmt: skip


def tally(rows: list[list[str]]) -> str:
    """What the runs needed, and how they ended."""
    count = Counter(
        "failed" if row[6] == "failed"
        else "folded" if row[5] != "0"
        else f"embedded ({row[10]})" if row[10] != "-"
        else f"repaired by {row[9].split()[-1].split(':')[0]}" if row[9] != "-"
        else "mapped after other attempts" if row[8] != "0"
        else "mapped at once"
        for row in rows
    )  # fmt: skip
    return "; ".join(f"{what} {number}" for what, number in count.most_common())


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+", type=Path)
    parser.add_argument("--targets", default="free,disk,sphere")
    parser.add_argument("--patches", default="1,2,3,5,6,8,12,16,24,32")
    parser.add_argument("--seeds", default="0,1,2")
    parser.add_argument("--output", type=Path)
    arguments = parser.parse_args(words)
    rows = []
    if arguments.output is not None and arguments.output.exists():
        rows = [line.split("\t") for line in arguments.output.read_text().splitlines()]
    done = {tuple(row[:4]) for row in rows}
    for path in arguments.meshes:
        mesh = pgcp.read_mesh(path)
        fitting = FITTING[pgcp.check_mesh(mesh).is_disk]
        for target in (t for t in arguments.targets.split(",") if t in fitting):
            for patches in arguments.patches.split(","):
                for seed in arguments.seeds.split(","):
                    key = (path.stem, target, patches, seed)
                    if key in done:
                        continue
                    rows.append([*key, *run(mesh, target, int(patches), int(seed))])
                    line = "\t".join(rows[-1])
                    print(line, flush=True)
                    if arguments.output is not None:
                        with arguments.output.open("a") as stream:
                            stream.write(line + "\n")
    print(f"{len(rows)} runs: {tally(rows)}", file=sys.stderr)


if __name__ == "__main__":
    main()
