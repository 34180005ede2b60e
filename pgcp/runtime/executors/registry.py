"""All executors by name: each is a file of this room that holds an ``EXECUTOR``, or was registered."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from pgcp.errors import InputError
from pgcp.options import AUTO, Running
from pgcp.registry import Registry

if TYPE_CHECKING:
    from pgcp.runtime.executors.base import Executor, ExecutorKind, Progress

EXECUTORS: Registry[ExecutorKind] = Registry(
    "executor",
    "pgcp.runtime.executors",
    "EXECUTOR",
    ("base", "cluster", "connection", "probe", "registry", "submission", "work"),
)


def make_executor(running: Running, run: str, progress: Progress, warm: Callable[[], None]) -> Executor:
    """Make the executor of a run, of that name: the one asked for, or the first that has workers if workers are asked for.

    ``warm`` loads what tasks need; workers call it before their first task. Raises InputError where there is no executor of
    the name, or workers are asked for and it has none, or it has workers and none are asked for.
    """
    wants_workers = running.workers > 0 or running.is_elsewhere
    if running.executor == AUTO:
        kind = next(kind for kind in EXECUTORS.all() if kind.has_workers == wants_workers)
    else:
        kind = EXECUTORS.get(running.executor)
    if wants_workers and not kind.has_workers:
        raise InputError(
            f"the executor {kind.name} has no workers and no scheduler; leave them out, or choose another executor"
        )
    if kind.has_workers and not wants_workers:
        raise InputError(f"the executor {kind.name} needs workers or a scheduler")
    return kind.make(running, run, progress, warm)


def may_have_workers(name: str) -> bool:
    """Whether the executor of this name, or one that auto may choose, has worker processes."""
    return name == AUTO or EXECUTORS.get(name).has_workers
