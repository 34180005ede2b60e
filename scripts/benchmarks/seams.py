#!/usr/bin/env python3
"""Compare how seams are treated: a row per mesh, target, patch count and treatment, tab separated, and a plot.

usage: seams.py [--targets free,disk] [--patches 2,6,12] [--plot FILE.png] MESH [MESH ...]
Columns: mesh, target, patches, seams (weld, relax, exact), mean |angle error| (degrees) over all faces, over those within two
rings of a seam, and over the rest; folds before any repair and after; seconds. No Moebius correction.
The plot shows the error near seams over that elsewhere, a point per row.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import pgcp
from pgcp.options import SEAMS
from pgcp.surface.distortion import angle_errors
from pgcp.surface.topology import rings_around

_RINGS = 2


def near_seams(result: pgcp.Parameterization) -> np.ndarray:
    """Which faces (F,) are within two rings of a seam."""
    faces, count = result.mesh.faces, len(result.mesh.vertices)
    corners, labels = faces.reshape(-1), np.repeat(result.patch, 3)
    low, high = np.full(count, len(faces)), np.full(count, -1)
    np.minimum.at(low, corners, labels)
    np.maximum.at(high, corners, labels)
    on_seam = np.flatnonzero((low < high)[faces].any(axis=1))
    return rings_around(faces, on_seam, _RINGS - 1, count)


def measure(mesh: pgcp.Mesh, target: str, patches: int, seams: str) -> dict[str, Any]:
    """One row."""
    start = time.perf_counter()
    result = pgcp.compute(mesh, pgcp.Options(patches=patches, target=target, seams=seams, moebius="none", polish="none"))
    seconds = time.perf_counter() - start
    errors = angle_errors(result.mesh, result.coordinates).mean(axis=1)
    near = near_seams(result)
    repairs = result.report["repairs"]
    return {
        "mesh": mesh.name, "target": target, "patches": patches, "seams": result.report["seams"],
        "mean_deg": errors.mean(), "near_deg": errors[near].mean(), "elsewhere_deg": errors[~near].mean(),
        "folds_before": repairs[0]["folds_before"] if repairs else 0, "folds": result.quality.folds, "seconds": seconds,
    }  # fmt: skip


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """The error near seams over that elsewhere."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 6), dpi=110, layout="constrained")
    axes = figure.subplots()
    for seams, colour in zip(SEAMS, ("#29528c", "#b5442c", "#4a8c3a"), strict=True):
        chosen = [row for row in rows if row["seams"] == seams and row["elsewhere_deg"] > 0]
        axes.loglog(
            [row["elsewhere_deg"] for row in chosen], [row["near_deg"] for row in chosen], ".", color=colour, label=seams
        )
    low, high = axes.get_xlim()
    axes.plot([low, high], [low, high], color="grey", linewidth=0.7)
    axes.set_xlabel("mean |angle error| elsewhere (degrees)")
    axes.set_ylabel(f"within {_RINGS} rings of a seam (degrees)")
    axes.legend()
    figure.savefig(path)


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+", type=Path)
    parser.add_argument("--targets", default="free,disk")
    parser.add_argument("--patches", default="2,6,12")
    parser.add_argument("--plot", type=Path)
    arguments = parser.parse_args(words)
    rows: list[dict[str, Any]] = []
    for path in arguments.meshes:
        mesh = pgcp.read_mesh(path)
        for target in arguments.targets.split(","):
            for patches in (int(k) for k in arguments.patches.split(",")):
                for seams in SEAMS:
                    rows.append(measure(mesh, target, patches, seams))
                    if len(rows) == 1:
                        print("\t".join(rows[0]))
                    print("\t".join(f"{v:.4f}" if isinstance(v, float) else str(v) for v in rows[-1].values()), flush=True)
    if arguments.plot is not None:
        plot(rows, arguments.plot)


if __name__ == "__main__":
    main()
