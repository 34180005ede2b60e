"""Tasks on dask workers: mapped, joined along a tree beside them, and speculative on workers that would be idle."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from typing import Any

from pgcp.errors import LostFileError
from pgcp.options import Running
from pgcp.runtime.executors.base import Executor, ExecutorKind, Progress, Take, peak_bytes, silent
from pgcp.runtime.executors.cluster import Security, at_scheduler, checked_client
from pgcp.runtime.executors.connection import Connection, Given, Reached, Started, return_memory
from pgcp.runtime.executors.registry import may_have_workers
from pgcp.runtime.executors.submission import Done, Kind, Submission, Task
from pgcp.runtime.executors.work import Joining, Speculation, Tasks
from pgcp.runtime.run_directory import store_parent


class DaskExecutor(Executor):
    """Tasks on dask workers: a local cluster of processes, or a running cluster.

    The latter is that of a client, of a scheduler's address or of a scheduler file; its workers are asked first whether they
    see the folder ``store``, where one is given, and have this version of the package: InputError says which does not.
    A local cluster starts in the background; the first tasks wait for it. It has a processor for each worker; joins share the
    processors of workers for which there is no other work. ``warm`` is called in each worker before its first task. A task
    whose worker is lost runs again, except a speculative one; so do all when a lost scheduler comes back. Where there is no
    scheduler or no worker for ``Connection.patience_s`` seconds, the run stops. A LostFileError of one task is raised when all
    others have finished.
    """

    def __init__(
        self,
        run: str,
        workers: int = 0,
        scheduler: str | None = None,
        scheduler_file: Path | None = None,
        progress: Progress = silent,
        security: Security | None = None,
        warm: Callable[[], None] | None = None,
        client: Any = None,
        store: Path | None = None,
    ) -> None:
        super().__init__(progress)
        self._connection: Connection
        self._is_shared = False
        if client is not None:
            self._connection = Given(run, partial(checked_client, client), warm, store)
        elif scheduler is None and scheduler_file is None:
            shared = _SHARED.get()
            self._is_shared = shared is not None and shared.workers_here == workers
            self._connection = shared if shared is not None and self._is_shared else Started(run, workers, warm)
        else:
            self._connection = Reached(run, partial(at_scheduler, scheduler, scheduler_file, security), warm, store)
        self._submission = Submission(run, self._connection)
        self._offers: list[Speculation] = []
        self._numbers: dict[str, int] = {}  # of workers, by address
        self._behind: list[Task] = []  # wait for speculative work for the same place

    def end_tree(self) -> None:
        """See Executor; offers lapse."""
        super().end_tree()
        self._offers.clear()

    def speculate(self, work: Speculation) -> None:
        """See Executor."""
        self._offers.append(work)

    def run_tasks(self, tasks: Tasks[Any, Any], take: Take) -> None:
        """See Executor."""
        self._connection.await_start()
        lost: LostFileError | None = None
        with self._none_left_behind():
            self._submit_mapped(tasks)
            self._begin_joins()
            while self._behind or self._submission.of(Kind.MAPPED):
                self._begin_speculative()
                for done in self._arrived(tasks.stage):
                    if done.task.joining is not None:
                        self._take_join(done.task.joining, done)
                    elif isinstance(done.problem, LostFileError):
                        lost = done.problem
                    elif done.problem is not None:
                        raise done.problem
                    else:
                        take(done.task.name, done.result)
                    self._begin_joins()
        if lost is not None:
            raise lost

    def run_joins(self, joining: Joining) -> None:
        """See Executor."""
        self._connection.await_start()
        with self._none_left_behind():
            self._begin_joins()
            while self._is_joining():
                self._begin_speculative()
                for done in self._arrived(joining.stage):
                    self._take_join(done.task.joining or joining, done)
                    self._begin_joins()
            if joining.problem is not None:
                raise joining.problem

    def _submit_mapped(self, tasks: Tasks[Any, Any]) -> None:
        """Submit tasks. One whose patch a speculative task is about waits for this task."""
        places = range(len(tasks.items)) if tasks.places is None else tasks.places
        begun = {task.place for task in self._submission.of(Kind.SPECULATIVE)}
        for name, (place, item) in enumerate(zip(places, tasks.items, strict=True)):
            task = Task(Kind.MAPPED, tasks.stage, name, place, tasks.function, item, caches=tasks.caches)
            if place in begun:
                self._behind.append(task)
            else:
                self._submission.submit(task)

    def _begin_joins(self) -> None:
        """Submit the joins that are ready. They share the processors that neither tasks nor offers need."""
        joining = self.joining
        if joining is None:
            return
        ready, workers = joining.take_ready(), self._connection.workers_here
        busy = len(self._submission) + len(ready)
        share = max(1, workers // max(1, busy + min(len(self._offers), max(0, workers - busy))))
        for node, pair in ready:
            self._submission.submit(
                Task(Kind.JOINED, joining.stage, node.result, node.result, node.function, pair, joining, share)
            )

    def _is_joining(self) -> bool:
        """Whether joins of the present tree are under way, and none has failed."""
        if self.joining is None or self.joining.problem is not None:
            return False
        return any(task.joining is self.joining for task in self._submission.of(Kind.JOINED))

    def _take_join(self, joining: Joining, done: Done) -> None:
        if done.problem is not None:
            joining.problem = joining.problem or done.problem
        else:
            self.take_joined(joining, done.task.name, done.result)

    def _begin_speculative(self) -> None:
        """Submit offers for idle workers, as long as joins are under way or wait for their values."""
        joining = self.joining
        if joining is None or joining.problem is not None or not (joining.waiting or self._is_joining()):
            return
        self._offers = [work for work in self._offers if not self._submission.is_cached(work.place)]
        while self._offers and self._connection.worker_count() > len(self._submission):
            work = self._offers.pop()
            self._submission.submit(
                Task(Kind.SPECULATIVE, work.stage, work.place, work.place, work.function, work.item, caches=True)
            )

    def _arrived(self, stage: str) -> Iterator[Done]:
        """Tasks that are done, as soon as one is; speculative ones are not among them."""
        for done in self._submission.done(stage):
            if done.problem is None:
                worker = self._numbers.setdefault(done.address, len(self._numbers) + 1)
                self.counted(done.task.stage, done.span, done.result, worker)
            if done.task.kind is Kind.SPECULATIVE:
                self._end_speculative(done)
            else:
                yield done

    def _end_speculative(self, done: Done) -> None:
        """Submit the tasks that waited for speculative work. An error of this work is theirs to raise again."""
        if not done.result:  # the cache of a worker is full, or the work has failed
            self._offers.clear()
        behind = [task for task in self._behind if task.place == done.task.place]
        self._behind = [task for task in self._behind if task.place != done.task.place]
        for task in behind:
            self._submission.submit(task)

    @contextmanager
    def _none_left_behind(self) -> Iterator[None]:
        """After an error, cancel the tasks that are under way."""
        try:
            yield
        except BaseException:
            self._submission.cancel()
            self._behind.clear()
            raise

    def rest(self) -> None:
        """See Executor."""
        if self._connection.workers_here:
            self._connection.run(return_memory)

    def everywhere(self, function: Callable[[], None]) -> None:
        """See Executor: in workers that stay. Those started for this run end with this executor."""
        if not self._connection.workers_here or self._is_shared:
            self._connection.run(function)

    def describe(self) -> dict[str, Any]:
        """See Executor."""
        return {"kind": self._connection.kind, "workers": len(self._connection.workers()), "threads_per_worker": 1}

    def peak_bytes(self) -> int:
        """See Executor."""
        return max([peak_bytes(), *self._connection.run(peak_bytes)])

    def __exit__(self, *_: object) -> None:
        if not self._is_shared:
            self._connection.close()


_SHARED: ContextVar[Started | None] = ContextVar("shared", default=None)


@contextmanager
def shared_workers(running: Running, warm: Callable[[], None]) -> Iterator[None]:
    """Start worker processes once for all runs inside that ask for as many; nothing where none are asked for."""
    if not running.starts_workers or not may_have_workers(running.executor):
        yield
        return
    connection = Started("shared", running.workers, warm)
    before = _SHARED.set(connection)
    try:
        yield
    finally:
        _SHARED.reset(before)
        connection.close()


def _make(running: Running, run: str, progress: Progress, warm: Callable[[], None]) -> Executor:
    security = None if running.tls_files is None else Security(*running.tls_files)
    where = running.workers, running.scheduler, running.scheduler_file
    return DaskExecutor(run, *where, progress, security, warm, running.client, store_parent(running.store))


EXECUTOR = ExecutorKind("dask", "dask workers, started here or of a running cluster", _make, has_workers=True)
