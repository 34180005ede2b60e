"""Tasks in this process, or on dask workers, with the same bits: the only import of dask.

Imports the rest of runtime and the ground. Doors: the names below; an executor is a file that holds an ``EXECUTOR``.
"""

from pgcp.runtime.executors.base import Executor, ExecutorKind, Progress, silent, timed
from pgcp.runtime.executors.cluster import Security, start_cluster
from pgcp.runtime.executors.dask import DaskExecutor, shared_workers
from pgcp.runtime.executors.registry import EXECUTORS, make_executor, may_have_workers
from pgcp.runtime.executors.threads import LocalExecutor
from pgcp.runtime.executors.work import Join, Joining, JoinTree, Speculation, Tasks, ignore

__all__ = [
    "EXECUTORS",
    "DaskExecutor",
    "Executor",
    "ExecutorKind",
    "Join",
    "JoinTree",
    "Joining",
    "LocalExecutor",
    "Progress",
    "Security",
    "Speculation",
    "Tasks",
    "ignore",
    "make_executor",
    "may_have_workers",
    "shared_workers",
    "silent",
    "start_cluster",
    "timed",
]
