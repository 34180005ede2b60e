"""Tasks in this process, in threads of it: compiled code and BLAS let each other run."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager
from contextvars import copy_context
from functools import partial
from typing import Any

from threadpoolctl import threadpool_limits

from pgcp.errors import SolveFailedError
from pgcp.executors.protocol import Item, Joining, Progress, Result, count, ignore, peak_bytes, silent
from pgcp.parallel import limited_to, processor_count

_MOST_AT_ONCE = 4  # each needs memory for a patch
_LOOK_S, _GRACE_S = 0.1, 3.0


class LocalExecutor(AbstractContextManager["LocalExecutor"]):
    """So many tasks at a time in this process, as many as it has processors, up to four, or one after the other."""

    def __init__(self, progress: Progress = silent, at_once: int | None = None) -> None:
        self._progress = progress
        self._at_once = at_once or min(_MOST_AT_ONCE, processor_count())
        self.taken: dict[str, dict[str, float]] = {}

    def map(
        self,
        stage: str,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        places: Sequence[int] | None = None,
        done: int = 0,
        each: Callable[[Result], None] = ignore,
        beside: Joining | None = None,
        keeps: bool = True,
    ) -> list[Result]:
        """See Executor. Joins wait: this process is never idle."""
        total = done + len(items)
        out = dict[int, Result]()
        self._progress(stage, done, total)

        def take(k: int, result: Result) -> None:
            """A result has come in."""
            out[k] = result
            each(result)
            self._progress(stage, done + len(out), total)

        self._compute(stage, [(function, item) for item in items], take)
        return [out[k] for k in range(len(items))]

    def join(self, joining: Joining) -> dict[int, Any]:
        """See Executor."""
        self._progress(joining.stage, joining.finished, joining.total)
        while ready := joining.take_ready():

            def take(k: int, union: Any, ready: list[tuple[Any, Any]] = ready) -> None:
                """A union has come in."""
                joining.keep(ready[k][0].result, union)
                self._progress(joining.stage, joining.finished, joining.total)

            self._compute(joining.stage, [(node.function, pair) for node, pair in ready], take)
        return joining.values

    def _compute(self, stage: str, calls: Sequence[tuple[Callable[[Any], Any], Any]], take: Callable[[int, Any], None]) -> None:
        """Call functions with their items, and ``take`` with the position and the result of each as it comes in."""
        threads = min(self._at_once, len(calls))
        with threadpool_limits(1):
            if threads < 2:
                for k, call in enumerate(calls):
                    take(k, self._counted(stage, *_timed(*call)))
                return
            share = max(1, processor_count() // threads)
            pool = ThreadPoolExecutor(threads)
            begun: dict[Future[tuple[float, Any]], int] = {}
            try:
                for k, call in enumerate(calls):
                    begun[pool.submit(copy_context().run, partial(_timed, *call, share))] = k
                while begun:  # a signal that another thread gets does not end a wait
                    for future in wait(begun, _LOOK_S, FIRST_COMPLETED).done:
                        take(begun.pop(future), self._counted(stage, *future.result()))
            except BaseException as problem:
                pool.shutdown(wait=False, cancel_futures=True)
                running = [future for future in begun if not future.cancelled()]
                wait(running, None if isinstance(problem, Exception) else _GRACE_S)  # who interrupts does not wait long
                raise
            pool.shutdown()

    def _counted(self, stage: str, seconds: float, result: Any) -> Any:
        count(self.taken, stage, seconds)
        if isinstance(result, MemoryError):
            raise SolveFailedError(f"stage {stage} ran out of memory") from result
        return result

    def rest(self) -> None:
        """See Executor."""

    def everywhere(self, function: Callable[[], None]) -> None:
        """See Executor."""
        function()

    def describe(self) -> dict[str, Any]:
        """See Executor."""
        kind = "serial" if self._at_once == 1 else "threads"
        return {"kind": kind, "workers": 0, "threads_per_worker": self._at_once}

    def peak_bytes(self) -> int:
        """See Executor."""
        return peak_bytes()

    def __exit__(self, *_: object) -> None:
        return None


def _timed(function: Callable[[Item], Result], item: Item, processors: int | None = None) -> tuple[float, Result | MemoryError]:
    """Seconds that function(item) takes on so many processors, or all, and what it is."""
    start = time.perf_counter()
    result: Result | MemoryError
    try:
        with limited_to(processors or processor_count()):
            result = function(item)
    except MemoryError as problem:
        result = problem
    return time.perf_counter() - start, result
