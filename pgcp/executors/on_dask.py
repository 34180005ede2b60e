"""Tasks on dask workers, started here or elsewhere; lost ones run again."""

from __future__ import annotations

import atexit
import ctypes
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from pgcp.errors import InputError, LostFileError, SolveFailedError, StoppedError
from pgcp.executors.cluster import Security, at_scheduler, check_that_workers_can_start, silenced, start_cluster
from pgcp.executors.protocol import Item, Joining, Progress, Result, count, ignore, peak_bytes, silent
from pgcp.forks import prepare_forks
from pgcp.parallel import leave, limited_to

_LOOK_S = 2.0
_JOINS_FIRST, _SPARES_LAST = 1, -1  # of all tasks: what is joined at last waits for every join before it
_MOST_TRIES = 5
_RESTART_S = 10.0


def _warm_up_here(warm: Callable[[], None]) -> None:
    """Warm a worker up that was started here, and let it end at once when it has to."""
    atexit.register(leave, 0)
    warm()


def _give_memory_back() -> None:
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def _run_located(function: Callable[[Any], Any], item: Any, processors: int) -> tuple[str, float, Any]:
    """Where function(item) was computed, in how many seconds, and what it is."""
    from distributed import get_worker

    start = time.perf_counter()
    with threadpool_limits(1), limited_to(processors):
        result = function(item)
    return get_worker().address, time.perf_counter() - start, result


def _said(stage: str, problem: Exception) -> Exception:
    """What went wrong with a task, in this package's errors where they say it better."""
    from distributed.scheduler import KilledWorker

    said: Exception
    if isinstance(problem, KilledWorker):
        said = StoppedError(f"stage {stage}: workers died again and again, most likely for lack of memory ({problem})")
    elif isinstance(problem, MemoryError):
        said = SolveFailedError(f"stage {stage} ran out of memory on a worker")
    elif isinstance(problem, RuntimeError) and "deserialization" in str(problem):
        said = InputError(
            "the cluster cannot load this run's tasks: install pgcp, in one version, on its scheduler and workers"
        )
    else:
        return problem
    said.__cause__ = problem
    return said


@dataclass(slots=True, eq=False)
class _Task:
    """A function to be applied to an item, wanted under a name, on the worker that keeps something for its place."""

    stage: str
    name: int
    place: int
    function: Callable[[Any], Any]
    item: Any
    joining: Joining | None = None
    processors: int = 1
    tries: int = 0
    keeps: bool = False
    is_spare: bool = False


class DaskExecutor(AbstractContextManager["DaskExecutor"]):
    """Tasks on dask workers: a local cluster of processes, or a running cluster.

    A local cluster is started in the background: whatever is called first waits for it. It has a processor a worker: joins
    that leave workers idle, and no spare work, use theirs. ``warm`` is called in each worker before its first task. A task
    whose worker is lost is run again, as are all but spare ones when the scheduler comes back after it was lost; where there
    is no scheduler or no worker for ``patience_s`` seconds the run is stopped. A file that one task finds lost is said when the
    others have finished.
    """

    patience_s = 30.0

    def __init__(
        self,
        run: str,
        workers: int = 0,
        scheduler: str | None = None,
        scheduler_file: Path | None = None,
        progress: Progress = silent,
        security: Security | None = None,
        warm: Callable[[], None] | None = None,
    ) -> None:
        self._run = run
        self._progress = progress
        self._workers_here = workers
        self._places: dict[int, str] = {}
        self._known: set[str] = set()
        self._counted, self._counted_at = 0, -_LOOK_S
        self._active: dict[Any, _Task] = {}
        self._behind: list[_Task] = []  # wait for spare work that is done for them
        self._submitted = 0
        self.taken: dict[str, dict[str, float]] = {}
        self._warm = warm
        self._warming: list[Any] = []
        self._cluster: Any = None
        self._held: Any = None
        self._problem: BaseException | None = None
        self._starting: threading.Thread | None = None
        self._reach: Callable[[], Any] | None = None
        self._closing = ExitStack()
        if scheduler is None and scheduler_file is None:
            check_that_workers_can_start()
            self._starting = threading.Thread(target=self._start, args=(workers,), daemon=True)
            self._starting.start()
        else:
            self._reach = partial(at_scheduler, scheduler, scheduler_file, security)
            self._held = self._reach()
            self._closing.enter_context(silenced())
            self._warm_up(self._held)

    def _start(self, workers: int) -> None:
        try:
            prepare_forks()
            from distributed import Client

            self._closing.enter_context(silenced())
            self._cluster = start_cluster(workers)
            self._held = Client(self._cluster)
            self._warm_up(self._held)
        except BaseException as problem:
            self._problem = problem

    def _warm_up(self, client: Any) -> None:
        """Have workers load what tasks need while nothing waits for it."""
        if self._warm is not None:
            warm = self._warm if self._cluster is None else partial(_warm_up_here, self._warm)
            for address in client.scheduler_info(n_workers=-1)["workers"]:
                key = f"pgcp-{self._run}-warm-{address}"
                self._warming.append(client.submit(warm, key=key, workers=[address], pure=False))

    def _await_start(self) -> None:
        """Wait for the thread that starts a cluster; it has imported all of dask then."""
        if self._starting is not None:
            self._starting.join()
            self._starting = None
        if self._problem is not None:
            problem, self._problem = self._problem, None
            raise problem

    @property
    def _is_reached(self) -> bool:
        """Whether there is a scheduler now."""
        return self._held is not None and self._held.status == "running"

    @property
    def _client(self) -> Any:
        """The client, once the cluster is there."""
        self._await_start()
        return self._held

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
        """See Executor."""
        self._await_start()
        numbers = range(len(items)) if places is None else places
        total, out = done + len(items), dict[int, Any]()
        lost: LostFileError | None = None
        self._progress(stage, done, total)
        with self._none_left_behind():
            placed = enumerate(zip(numbers, items, strict=True))
            self._submit_behind_spares([_Task(stage, k, place, function, item, keeps=keeps) for k, (place, item) in placed])
            self._begin_joins(beside)
            while self._behind or any(task.joining is None and not task.is_spare for task in self._active.values()):
                self._begin_spares(beside)
                for task, result, problem in self._results(stage):
                    if task.joining is not None:
                        self._take_joined(task.joining, task, result, problem)
                    elif isinstance(problem, LostFileError):
                        lost = problem
                    elif problem is not None:
                        raise problem
                    else:
                        out[task.name] = result
                        each(result)
                        self._progress(stage, done + len(out), total)
                    self._begin_joins(beside)
        if lost is not None:
            raise lost
        return [out[k] for k in range(len(items))]

    def join(self, joining: Joining) -> dict[int, Any]:
        """See Executor."""
        self._await_start()
        self._progress(joining.stage, joining.finished, joining.total)
        with self._none_left_behind():
            self._begin_joins(joining)
            while joining.problem is None and self._are_joining(joining):
                self._begin_spares(joining)
                for task, result, problem in self._results(joining.stage):
                    self._take_joined(joining, task, result, problem)
                    self._begin_joins(joining)
            if joining.problem is not None:
                raise joining.problem
        return joining.values

    def _begin_joins(self, joining: Joining | None) -> None:
        if joining is None:
            return
        ready = joining.take_ready()
        busy = len(self._active) + len(ready)
        share = max(1, self._workers_here // max(1, busy + min(len(joining.spares), max(0, self._workers_here - busy))))
        for node, pair in ready:
            self._submit(_Task(joining.stage, node.result, node.result, node.function, pair, joining, share))

    def _are_joining(self, joining: Joining) -> bool:
        return any(task.joining is joining and not task.is_spare for task in self._active.values())

    def _begin_spares(self, joining: Joining | None) -> None:
        """Give idle workers something to do as long as others join, or are going to."""
        if joining is None or joining.problem is not None or not (joining.waiting or self._are_joining(joining)):
            return
        joining.spares = [spare for spare in joining.spares if spare.place not in self._places]
        while joining.spares and self._worker_count() > len(self._active):
            place, function, item = joining.spares.pop()
            self._submit(_Task("prepare", place, place, function, item, joining, keeps=True, is_spare=True))

    def _worker_count(self) -> int:
        """Workers there are, or were a moment ago."""
        if not self._workers_here and time.monotonic() > self._counted_at + _LOOK_S:
            self._counted, self._counted_at = len(self._workers()), time.monotonic()
        return self._workers_here or self._counted

    def _end_spare(self, task: _Task, is_kept: bool) -> None:
        """Begin what has waited for it."""
        if task.joining is not None and not is_kept:
            task.joining.spares.clear()
        behind = [other for other in self._behind if other.place == task.place]
        self._behind = [other for other in self._behind if other.place != task.place]
        for other in behind:
            self._submit(other)

    def _submit_behind_spares(self, tasks: list[_Task]) -> None:
        """Submit tasks, those that spare work is being done for as soon as it is done."""
        begun = {task.place for task in self._active.values() if task.is_spare}
        for task in tasks:
            if task.place in begun:
                self._behind.append(task)
            else:
                self._submit(task)

    def _take_joined(self, joining: Joining, task: _Task, result: Any, problem: Exception | None) -> None:
        if problem is not None:
            joining.problem = joining.problem or problem
            return
        joining.keep(task.name, result)
        self._progress(joining.stage, joining.finished, joining.total)

    def _submit(self, task: _Task) -> None:
        if self._client.status != "running":
            self._await_cluster(task.stage, None)
        place = self._places.get(task.place)
        here = place is not None
        task.tries += 1
        self._submitted += 1
        future = self._client.submit(
            _run_located,
            task.function,
            task.item,
            task.processors,
            # of one group: dask hands what no worker is preferred for to the next that is free
            key=(f"pgcp-{self._run}-{task.stage}", self._submitted),
            workers=[place] if here else None,
            allow_other_workers=here,
            priority=_SPARES_LAST if task.is_spare else _JOINS_FIRST if task.joining is not None else 0,
            pure=False,
        )
        self._active[future] = task

    def _results(self, stage: str) -> Iterator[tuple[_Task, Any, Exception | None]]:
        """Tasks that are done, once there are some, with their results or their problems; those that are lost run again."""
        from distributed import CancelledError
        from distributed import TimeoutError as TooLateError

        for future in self._next_done(stage):
            task = self._active.pop(future)
            try:
                address, seconds, result = future.result(timeout=self.patience_s)
            except Exception as problem:
                if task.is_spare:  # who needs it does it again, and says what is wrong
                    self._end_spare(task, False)
                    continue
                if future.status == "error" or not isinstance(problem, (CancelledError, TooLateError, OSError)):
                    yield task, None, _said(task.stage, problem)  # the task's own
                    continue
                self._await_cluster(stage, problem)
                if task.tries >= _MOST_TRIES:
                    raise StoppedError(f"stage {stage}: the scheduler was lost {task.tries} times") from problem
                self._submit(task)
                continue
            future.release()  # now, whoever else still refers to it: what is wanted no more is not done again for a lost worker
            self._known.add(address)
            if task.keeps and (not task.is_spare or result):
                self._places[task.place] = address
            elif task.joining is None:
                self._places.pop(task.place, None)  # what was kept has been used
            count(self.taken, task.stage, seconds)
            if task.is_spare:
                self._end_spare(task, result)
                continue
            yield task, result, None

    @contextmanager
    def _none_left_behind(self) -> Iterator[None]:
        """Tasks still under way are cancelled where something goes wrong."""
        try:
            yield
        except BaseException:
            with suppress(Exception):  # there may be no scheduler that could
                self._client.cancel(list(self._active), force=True)
            self._active.clear()
            self._behind.clear()
            raise

    def _next_done(self, stage: str) -> list[Any]:
        """Futures that are done or cancelled, in the order of their names, once there is one."""
        from distributed import CancelledError, wait
        from distributed import TimeoutError as TooLateError

        while True:
            try:
                wait(list(self._active), timeout=_LOOK_S, return_when="FIRST_COMPLETED")
            except TooLateError:
                self._await_cluster(stage, None)
            except CancelledError:  # a lost scheduler cancels what is waited for
                pass
            done = [future for future in self._active if future.status in ("finished", "error", "cancelled")]
            if done:
                return sorted(done, key=lambda future: self._active[future].name)

    def _await_cluster(self, stage: str, problem: BaseException | None) -> None:
        """Wait until there are a scheduler and workers; raises StoppedError where there are none for too long."""
        until = time.monotonic() + self.patience_s
        while True:
            with suppress(Exception):
                if self._client.status == "closed" and self._reach is not None:  # it has given up before
                    self._held = self._reach()
                if self._client.status == "running" and self._workers():
                    return
            if time.monotonic() > until:
                what = "there is no worker" if self._client.status == "running" else "the scheduler does not answer"
                raise StoppedError(f"stage {stage}: {what} any more, for {self.patience_s:.0f} s") from problem
            time.sleep(0.2)

    def _workers(self) -> list[str]:
        """Addresses of the workers, or where the scheduler is lost, of those that have done something."""
        if self._client.status != "running":
            return list(self._known)
        return list(self._client.scheduler_info(n_workers=-1)["workers"])

    def rest(self) -> None:
        """See Executor."""
        if self._cluster is not None and self._is_reached:
            with suppress(Exception):  # a worker that is gone keeps nothing
                self._client.run(_give_memory_back, on_error="ignore")

    def everywhere(self, function: Callable[[], None]) -> None:
        """See Executor: workers started here end with it."""
        if self._cluster is None and self._starting is None and self._is_reached:
            with suppress(Exception):  # a worker that is gone holds nothing
                self._client.run(function, on_error="ignore")

    def describe(self) -> dict[str, Any]:
        """See Executor."""
        return {
            "kind": "dask local cluster" if self._cluster is not None else "dask cluster",
            "workers": len(self._workers()),
            "threads_per_worker": 1,
        }

    def peak_bytes(self) -> int:
        """See Executor."""
        own = peak_bytes()
        if self._starting is not None or not self._is_reached:
            return own
        with suppress(Exception):  # of workers that are gone nothing is known
            return max([own, *self._client.run(peak_bytes, on_error="ignore").values()])
        return own

    def __exit__(self, *_: object) -> None:
        if self._starting is not None:
            self._starting.join()
        if self._cluster is not None:
            with suppress(Exception):  # one that is closed while it is started again prints a traceback
                self._cluster.wait_for_workers(len(self._cluster.worker_spec), timeout=_RESTART_S)
        if self._held is not None:
            with suppress(Exception):
                self._held.close()
        if self._cluster is not None:
            self._cluster.close()
        self._closing.close()
