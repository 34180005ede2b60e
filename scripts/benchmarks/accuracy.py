#!/usr/bin/env python3
"""Accuracy against the one-piece map: a row per mesh and patch count, tab separated.

usage: accuracy.py [--target auto] [--patches 2,4,6,8,12] [--seeds 0] [--flatten dncp] MESH [MESH ...]
Columns: mesh, vertices, patches, seed, mean |angle error| (degrees), its ratio to --patches 1 (2 on a closed surface),
folds, seconds.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import pgcp


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+", type=Path)
    parser.add_argument("--patches", default="2,4,6,8,12")
    parser.add_argument("--seeds", default="0")
    parser.add_argument("--flatten", default="dncp")
    parser.add_argument("--target", default="auto")
    arguments = parser.parse_args(words)
    print("mesh\tvertices\tpatches\tseed\tangle_mean_deg\tratio\tfolds\tseconds", flush=True)
    for path in arguments.meshes:
        mesh = pgcp.read_mesh(path)
        fewest = 2 if pgcp.check_mesh(mesh, arguments.target).is_sphere else 1
        options = pgcp.Options(patches=fewest, flatten=arguments.flatten, target=arguments.target)
        whole = pgcp.compute(mesh, options).quality
        print(
            f"{path.stem}\t{len(mesh.vertices)}\t{fewest}\t-\t{whole.angle_mean_deg:.4f}\t1.000\t{whole.folds}\t-", flush=True
        )
        for patches in (int(k) for k in arguments.patches.split(",")):
            for seed in (int(s) for s in arguments.seeds.split(",")):
                start = time.perf_counter()
                row = f"{path.stem}\t{len(mesh.vertices)}\t{patches}\t{seed}\t"
                try:
                    options = pgcp.Options(patches=patches, seed=seed, flatten=arguments.flatten, target=arguments.target)
                    quality = pgcp.compute(mesh, options).quality
                except pgcp.PgcpError as problem:
                    print(f"{row}{problem}", flush=True)
                    continue
                ratio = quality.angle_mean_deg / whole.angle_mean_deg if whole.angle_mean_deg > 1e-9 else float("nan")
                seconds = time.perf_counter() - start
                print(f"{row}{quality.angle_mean_deg:.4f}\t{ratio:.3f}\t{quality.folds}\t{seconds:.1f}", flush=True)


if __name__ == "__main__":
    main()
