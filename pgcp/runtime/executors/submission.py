"""Tasks under way on dask workers: submitted, taken when they are done, submitted again when their worker is lost."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

from pgcp.errors import InputError, SolveFailedError, StoppedError
from pgcp.parallel import limited_to, one_blas_thread
from pgcp.runtime.executors.base import Span
from pgcp.runtime.executors.connection import Connection
from pgcp.runtime.executors.work import Joining

_LOOK_S = 2.0  # between two looks whether there still is a worker
_MOST_TRIES = 5


class Kind(IntEnum):
    """Kinds of tasks; the number is dask's priority. Joins are first: they are the critical path."""

    SPECULATIVE = -1
    MAPPED = 0
    JOINED = 1


@dataclass(slots=True, eq=False)
class Task:
    """A function of an item. ``place`` is its patch, ``processors`` are those it may use, ``tries`` its submissions so far."""

    kind: Kind
    stage: str
    name: int
    place: int
    function: Callable[[Any], Any]
    item: Any
    joining: Joining | None = None
    processors: int = 1
    caches: bool = False
    tries: int = 0


class Done(NamedTuple):
    """A task that is done: when it was computed, its result and the address of its worker; or the error that it raised."""

    task: Task
    span: Span
    result: Any
    problem: Exception | None
    address: str = ""


class Submission:
    """The tasks of an executor that are under way, and which worker has cached which patch.

    A task whose worker is lost is submitted again, at most five times; a speculative one is not.
    """

    def __init__(self, run: str, connection: Connection) -> None:
        self._run, self._connection = run, connection
        self._active: dict[Any, Task] = {}
        self._cached_at: dict[int, str] = {}
        self._submitted = 0

    def __len__(self) -> int:
        return len(self._active)

    def of(self, kind: Kind) -> list[Task]:
        """Tasks of a kind that are under way."""
        return [task for task in self._active.values() if task.kind is kind]

    def is_cached(self, place: int) -> bool:
        """Whether a worker has cached this patch."""
        return place in self._cached_at

    def submit(self, task: Task) -> None:
        """Submit a task, to the worker that has cached its patch if there is one; another worker that is idle may take it."""
        if self._connection.client.status != "running":
            self._connection.await_workers(task.stage, None)
        address = self._cached_at.get(task.place)
        task.tries += 1
        self._submitted += 1
        future = self._connection.client.submit(
            _run_located,
            task.function,
            task.item,
            task.processors,
            # tasks of one group: dask gives one without a preferred worker to the next worker that is idle
            key=(f"pgcp-{self._run}-{task.stage}", self._submitted),
            workers=None if address is None else [address],
            allow_other_workers=address is not None,
            priority=int(task.kind),
            pure=False,
        )
        self._active[future] = task

    def done(self, stage: str) -> Iterator[Done]:
        """Wait until a task is done; yields all that are. Tasks of lost workers are submitted again."""
        for future in self._next_done(stage):
            task = self._active.pop(future)
            try:
                address, span, result = future.result(timeout=self._connection.patience_s)
            except Exception as problem:
                if task.kind is Kind.SPECULATIVE or _is_of_task(future, problem):
                    yield Done(task, Span(0.0, 0.0), None, said(task.stage, problem))
                else:
                    self._submit_again(task, stage, problem)
                continue
            future.release()  # else dask does the task again when the worker that holds its result is lost
            self._connection.has_worked(address)
            self._note_cache(task, address, result)
            yield Done(task, span, result, None, address)

    def _submit_again(self, task: Task, stage: str, problem: Exception) -> None:
        self._connection.await_workers(stage, problem)
        if task.tries >= _MOST_TRIES:
            raise StoppedError(f"stage {stage}: the scheduler was lost {task.tries} times") from problem
        self.submit(task)

    def _note_cache(self, task: Task, address: str, result: Any) -> None:
        """Note which worker has cached the patch of a task. A task that does not cache it has used what was cached."""
        if task.caches and (task.kind is not Kind.SPECULATIVE or result):
            self._cached_at[task.place] = address
        elif task.kind is Kind.MAPPED:
            self._cached_at.pop(task.place, None)

    def _next_done(self, stage: str) -> list[Any]:
        """Futures that are done or cancelled, by the names of their tasks, as soon as there is one."""
        from distributed import CancelledError, wait
        from distributed import TimeoutError as TooLateError

        while True:
            try:
                wait(list(self._active), timeout=_LOOK_S, return_when="FIRST_COMPLETED")
            except TooLateError:
                self._connection.await_workers(stage, None)
            except CancelledError:  # dask cancels all futures of a lost scheduler
                pass
            done = [future for future in self._active if future.status in ("finished", "error", "cancelled")]
            if done:
                return sorted(done, key=lambda future: self._active[future].name)

    def cancel(self) -> None:
        """Cancel all tasks that are under way."""
        with suppress(Exception):  # there may be no scheduler that could
            self._connection.client.cancel(list(self._active), force=True)
        self._active.clear()


def _run_located(function: Callable[[Any], Any], item: Any, processors: int) -> tuple[str, Span, Any]:
    """Address of the worker that computes function(item), when it does, and the result."""
    from distributed import get_worker

    begin, start = time.time(), time.perf_counter()
    with one_blas_thread(), limited_to(processors):
        result = function(item)
    return get_worker().address, Span(begin, time.perf_counter() - start), result


def _is_of_task(future: Any, problem: Exception) -> bool:
    """Whether the task itself has failed, and not its worker or the scheduler."""
    from distributed import CancelledError
    from distributed import TimeoutError as TooLateError

    return future.status == "error" or not isinstance(problem, (CancelledError, TooLateError, OSError))


def said(stage: str, problem: Exception) -> Exception:
    """The error of a task as an error of this package, where that says more; else the error itself."""
    from distributed.scheduler import KilledWorker

    error: Exception
    if isinstance(problem, KilledWorker):
        error = StoppedError(f"stage {stage}: workers died again and again, most likely for lack of memory ({problem})")
    elif isinstance(problem, MemoryError):
        error = SolveFailedError(f"stage {stage} ran out of memory on a worker")
    elif isinstance(problem, RuntimeError) and "deserialization" in str(problem):
        error = InputError(
            "the cluster cannot load this run's tasks: install pgcp, in one version, on its scheduler and workers"
        )
    else:
        return problem
    error.__cause__ = problem
    return error
