"""Time against the number of patches, as in PGCP Table 6.

    python speedup.py [MESH]

One worker process and two map the same mesh, cut into 2, 4, 8 and 16 patches. The paper's speedup compares n patches on n
processors with two on two. Here processors are few, so the picture shows both effects apart: patches and workers.
"""

import sys
from time import perf_counter

import matplotlib.pyplot as plt

import pgcp
from pgcp.surface.demo import demo_mesh

if __name__ == "__main__":  # worker processes import this file
    mesh = pgcp.read_mesh(sys.argv[1]) if len(sys.argv) > 1 else demo_mesh(400)
    counts, seconds = [2, 4, 8, 16], {1: [], 2: []}
    for workers, taken in seconds.items():
        pgcp.parameterize(mesh, patches=2, workers=workers)  # not counted: it loads what is compiled
        for patches in counts:
            began = perf_counter()
            pgcp.parameterize(mesh, patches=patches, workers=workers)
            taken.append(perf_counter() - began)
    print("patches  1 worker  2 workers  speedup")
    for k, patches in enumerate(counts):
        one, two = seconds[1][k], seconds[2][k]
        print(f"{patches:7}  {one:6.2f} s  {two:7.2f} s  {one / two:7.2f}")
    figure, axes = plt.subplots(figsize=(6, 3.4), layout="constrained")
    for workers, values in seconds.items():
        axes.plot(counts, values, "o-", label=f"{workers} worker{'s' if workers > 1 else ''}")
    axes.set(xlabel="patches", ylabel="seconds", xticks=counts, ylim=0)
    axes.legend()
    figure.savefig("speedup.png", dpi=150)
