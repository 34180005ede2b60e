"""Where tasks run: in this process, or on dask workers. The only import of dask.

An executor maps a function over items, or joins values along a tree, and reports progress. Results do not depend on the
order in which tasks finish, and each task computes with one BLAS thread wherever it runs: they do not depend on the executor.
"""

from pgcp.executors.cluster import Security, start_cluster
from pgcp.executors.local import LocalExecutor
from pgcp.executors.on_dask import DaskExecutor
from pgcp.executors.protocol import Executor, Join, Joining, Progress, Spare, ignore, silent

__all__ = [
    "DaskExecutor",
    "Executor",
    "Join",
    "Joining",
    "LocalExecutor",
    "Progress",
    "Security",
    "Spare",
    "ignore",
    "silent",
    "start_cluster",
]
