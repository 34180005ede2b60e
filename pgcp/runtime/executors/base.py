"""The base class of executors: map tasks, join along a tree, speculate; with progress and counts of tasks."""

from __future__ import annotations

import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, NamedTuple

from pgcp.errors import LostFileError, SolveFailedError
from pgcp.options import Running
from pgcp.parallel import limited_to, one_blas_thread, processor_count
from pgcp.runtime.executors.work import Item, Joining, JoinTree, Result, Speculation, Tasks, ignore

Progress = Callable[[str, int, int], None]
Take = Callable[[int, Any], None]


def silent(_stage: str, _done: int, _total: int) -> None:
    """Report no progress."""


class Span(NamedTuple):
    """When a task was computed: the time of day, in seconds since 1970 by the clock of its machine, and how many seconds."""

    begin: float
    seconds: float


class Executor(AbstractContextManager["Executor"], ABC):
    """Runs tasks. A subclass says how, in ``run_tasks``, ``run_joins`` and ``describe``; ``compute`` does one task here.

    ``progress(stage, done, total)`` is called when a stage begins and after each of its tasks. ``taken`` holds for each stage
    how many tasks it had and their seconds, added up, where they ran; ``worked`` every task: its stage, its worker's number, 0
    for this process, and its span. ``joining`` is the present tree, if any.
    """

    def __init__(self, progress: Progress = silent) -> None:
        self._progress = progress
        self.taken: dict[str, dict[str, float]] = {}
        self.worked: list[tuple[str, int, Span]] = []
        self.joining: Joining | None = None

    def map(self, tasks: Tasks[Item, Result], each: Callable[[Result], None] = ignore) -> list[Result]:
        """Do tasks; returns their results in the order of the items. ``each`` is called with every result when it arrives.

        An error of a task is raised, LostFileError when all other tasks have finished; any other ends the present tree.
        """
        total = tasks.done + len(tasks.items)
        out = dict[int, Result]()
        self._progress(tasks.stage, tasks.done, total)

        def take(position: int, result: Result) -> None:
            """A result has arrived."""
            out[position] = result
            each(result)
            self._progress(tasks.stage, tasks.done + len(out), total)

        try:
            self.run_tasks(tasks, take)
        except LostFileError:
            raise
        except BaseException:
            self.end_tree()
            raise
        return [out[k] for k in range(len(tasks.items))]

    def join(self, tree: JoinTree) -> Joining:
        """Begin a tree of joins. Its joins may run beside tasks that are mapped later; ``results`` of it waits for all.

        There is one tree at a time: a new one ends the one before it, whose joins do not begin any more.
        """
        self.end_tree()
        self.joining = Joining(tree, self._finish)
        return self.joining

    def _finish(self, joining: Joining) -> None:
        if joining is not self.joining:
            raise ValueError("this tree of joins has ended")
        self._progress(joining.stage, joining.finished, joining.total)
        try:
            self.run_joins(joining)
        finally:
            self.end_tree()

    def end_tree(self) -> None:
        """Begin no more joins."""
        self.joining = None

    def take_joined(self, joining: Joining, name: int, value: Any) -> None:
        """Take the value of a join that has arrived."""
        joining.keep(name, value)
        self._progress(joining.stage, joining.finished, joining.total)

    def speculate(self, work: Speculation) -> None:  # nothing, where no worker is ever idle
        """Offer speculative work. It begins on a worker that would be idle while the present tree is joined, or never.

        The offer made last begins first. All offers lapse when the tree ends, or when a worker has not cached its patch.
        """

    @abstractmethod
    def run_tasks(self, tasks: Tasks[Any, Any], take: Take) -> None:
        """Do tasks, and call ``take`` with the position and the result of each."""

    @abstractmethod
    def run_joins(self, joining: Joining) -> None:
        """Do the joins that are left, those of ``joining.take_ready()`` until there are none; ``take_joined`` each value."""

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Kind, workers and threads_per_worker, for the report."""

    def rest(self) -> None:  # nothing, where there are no workers
        """Have workers that were started here return the memory that they hold for their next task."""

    def everywhere(self, function: Callable[[], None]) -> None:
        """Call a function once in every process that stays after this executor."""
        function()

    def peak_bytes(self) -> int:
        """Largest resident size that any process of this executor has had."""
        return peak_bytes()

    def compute(self, stage: str, function: Callable[[Item], Result], item: Item) -> Result:
        """Do one task in this process and count it. BLAS has one thread, as on all executors: results have the same bits."""
        with one_blas_thread():
            return self.counted(stage, *timed(function, item))

    def counted(self, stage: str, span: Span, result: Result | MemoryError, worker: int = 0) -> Result:
        """Count a task of a stage, and its seconds. Returns its result; raises SolveFailedError for a MemoryError."""
        self.worked.append((stage, worker, span))
        record = self.taken.setdefault(stage, {"count": 0, "seconds": 0.0})
        record["count"] += 1
        record["seconds"] = round(record["seconds"] + span.seconds, 4)
        if isinstance(result, MemoryError):
            raise SolveFailedError(f"stage {stage} ran out of memory") from result
        return result

    def __exit__(self, *_: object) -> None:
        return None


@dataclass(frozen=True, slots=True)
class ExecutorKind:
    """An executor that runs can have: its name for ``--executor``, a line of help, and what makes one.

    ``make(running, run, progress, warm)``: see ``make_executor``. has_workers: whether it has worker processes.
    """

    name: str
    summary: str
    make: Callable[[Running, str, Progress, Callable[[], None]], Executor]
    has_workers: bool = False


def timed(function: Callable[[Item], Result], item: Item, processors: int = 0) -> tuple[Span, Result | MemoryError]:
    """When function(item) is computed, on so many processors, 0 for all, and its result, or the MemoryError it raises."""
    begin, start = time.time(), time.perf_counter()
    result: Result | MemoryError
    try:
        with limited_to(processors or processor_count()):
            result = function(item)
    except MemoryError as problem:
        result = problem
    return Span(begin, time.perf_counter() - start), result


def peak_bytes() -> int:
    """Largest resident size that this process has had."""
    try:
        import resource
    except ImportError:
        import psutil

        return int(psutil.Process().memory_info().rss)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)
