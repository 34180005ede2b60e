"""Tasks in this process, in threads of it: compiled code and BLAS let each other run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextvars import copy_context
from functools import partial
from typing import Any

from pgcp.options import Running
from pgcp.parallel import one_blas_thread, processor_count
from pgcp.runtime.executors.base import Executor, ExecutorKind, Progress, Span, Take, silent, timed
from pgcp.runtime.executors.work import Joining, Tasks

_MOST_AT_ONCE = 4  # each needs memory for a patch
_LOOK_S, _GRACE_S = 0.1, 3.0


class LocalExecutor(Executor):
    """So many tasks at a time in this process: by default as many as it has processors, up to four.

    Joins wait for ``results``, and speculative work is never done: while there are tasks, this process is not idle.
    """

    def __init__(self, progress: Progress = silent, at_once: int | None = None) -> None:
        super().__init__(progress)
        self._at_once = at_once or min(_MOST_AT_ONCE, processor_count())

    def run_tasks(self, tasks: Tasks[Any, Any], take: Take) -> None:
        """See Executor."""
        self._compute(tasks.stage, [(tasks.function, item) for item in tasks.items], take)

    def run_joins(self, joining: Joining) -> None:
        """See Executor."""
        while ready := joining.take_ready():
            names = [node.result for node, _ in ready]

            def take(position: int, value: Any, names: list[int] = names) -> None:
                """A value has arrived."""
                self.take_joined(joining, names[position], value)

            self._compute(joining.stage, [(node.function, pair) for node, pair in ready], take)

    def _compute(self, stage: str, calls: Sequence[tuple[Callable[[Any], Any], Any]], take: Take) -> None:
        """Call functions with their items, and ``take`` with the position and the result of each when it arrives."""
        threads = min(self._at_once, len(calls))
        with one_blas_thread():
            if threads < 2:
                for k, call in enumerate(calls):
                    take(k, self.counted(stage, *timed(*call)))
                return
            share = max(1, processor_count() // threads)
            pool = ThreadPoolExecutor(threads)
            begun: dict[Future[tuple[Span, Any]], int] = {}
            try:
                for k, call in enumerate(calls):
                    begun[pool.submit(copy_context().run, partial(timed, *call, share))] = k
                while begun:  # a signal that another thread gets does not end a wait
                    for future in wait(begun, _LOOK_S, FIRST_COMPLETED).done:
                        take(begun.pop(future), self.counted(stage, *future.result()))
            except BaseException as problem:
                pool.shutdown(wait=False, cancel_futures=True)
                running = [future for future in begun if not future.cancelled()]
                wait(running, None if isinstance(problem, Exception) else _GRACE_S)  # who interrupts does not wait long
                raise
            pool.shutdown()

    def describe(self) -> dict[str, Any]:
        """See Executor."""
        kind = "serial" if self._at_once == 1 else "threads"
        return {"kind": kind, "workers": 0, "threads_per_worker": self._at_once}


def _make(running: Running, _run: str, progress: Progress, _warm: Callable[[], None]) -> Executor:
    return LocalExecutor(progress, None if running.memory_limit_bytes is None else 1)


EXECUTOR = ExecutorKind("threads", "threads of this process", _make)
