"""A run on a dask cluster, with the timeline of its workers.

    python cluster.py [MESH]

The cluster is one that dask starts here; any other client does as well. Each row of the picture is a worker, each bar a
task. Welds go on beside the patches that are still being flattened.
"""

import sys

import matplotlib.pyplot as plt
from dask.distributed import Client, LocalCluster

import pgcp
from pgcp.surface.demo import demo_mesh

COLOURS = {"flatten": "tab:blue", "weld": "tab:orange", "prepare": "tab:gray", "solve": "tab:green"}

if __name__ == "__main__":  # worker processes import this file
    mesh = sys.argv[1] if len(sys.argv) > 1 else demo_mesh(330)
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        result = pgcp.parameterize(mesh, patches=12, client=client)
    print(result)
    tasks = result.report["timeline"]
    workers = sorted({task["worker"] for task in tasks})
    figure, axes = plt.subplots(figsize=(9, 2.4), layout="constrained")
    for stage in dict.fromkeys(task["stage"] for task in tasks):
        own = [task for task in tasks if task["stage"] == stage]
        rows = [workers.index(task["worker"]) for task in own]
        axes.barh(rows, [t["seconds"] for t in own], left=[t["begin"] for t in own], label=stage, color=COLOURS.get(stage))
    axes.set(yticks=range(len(workers)), yticklabels=[f"worker {k + 1}" for k in range(len(workers))], xlabel="seconds")
    axes.legend(ncols=6, loc="upper center", bbox_to_anchor=(0.5, 1.25), frameon=False)
    plt.savefig("cluster.png", dpi=150)
