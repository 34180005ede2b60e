"""Where tasks run: in this process, or on dask workers. The only import of dask.

An executor maps a function over items, or joins values along a tree, and reports progress. Results do not depend on the
order in which tasks finish, and each task computes with one BLAS thread wherever it runs: they do not depend on the executor.
"""

from __future__ import annotations

import atexit
import logging
import multiprocessing
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar

from threadpoolctl import threadpool_limits

from pgcp.errors import InputError, LostFileError, SolveFailedError, StoppedError
from pgcp.parallel import leave

Item = TypeVar("Item")
Result = TypeVar("Result")
Progress = Callable[[str, int, int], None]
_ANSWER_S = "10s"
_WORKER_ENVIRONMENT = {
    "DASK_LOGGING__DISTRIBUTED": "critical",  # silence_logs ends before a worker
    "MALLOC_TRIM_THRESHOLD_": 1
    << 30,  # memory of one patch serves the next: fresh pages cost as much as the arithmetic on them
    "MALLOC_MMAP_THRESHOLD_": 1 << 25,
}
_LOOK_S = 2.0
_MOST_TRIES = 5
_RESTART_S = 10.0


class Join(NamedTuple):
    """One node of a tree: function((values[left], values[right])) becomes values[result]."""

    left: int
    right: int
    result: int
    function: Callable[[tuple[Any, Any]], Any]


@dataclass(frozen=True, slots=True)
class Security:
    """Files for TLS: certificate of the authority, own certificate and key, all PEM."""

    ca: Path
    certificate: Path
    key: Path


class Executor(Protocol):
    """Maps functions over items."""

    def map(
        self,
        stage: str,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        places: Sequence[int] | None = None,
        done: int = 0,
    ) -> list[Result]:
        """Apply function to every item. Items prefer the worker that had the same place (by default, position) before.

        ``done`` more items count as finished in what progress says.
        """
        ...

    def join(self, stage: str, joins: Sequence[Join], values: dict[int, Any], done: int = 0) -> dict[int, Any]:
        """Join values along a tree, each node as soon as what it needs is there; returns the values nothing is made of."""
        ...

    def everywhere(self, function: Callable[[], None]) -> None:
        """Call function once in every process that stays after this executor."""
        ...

    def describe(self) -> dict[str, Any]:
        """Kind, workers and threads, for the report."""
        ...

    def peak_bytes(self) -> int:
        """Largest resident size any process of this executor has had."""
        ...


def _peak_bytes() -> int:
    try:
        import resource
    except ImportError:
        import psutil

        return int(psutil.Process().memory_info().rss)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)


def silent(_stage: str, _done: int, _total: int) -> None:
    """Report no progress."""


class SerialExecutor(AbstractContextManager["SerialExecutor"]):
    """One task after the other in this process: the reference."""

    def __init__(self, progress: Progress = silent) -> None:
        self._progress = progress

    def map(
        self,
        stage: str,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        places: Sequence[int] | None = None,
        done: int = 0,
    ) -> list[Result]:
        """See Executor."""
        total = done + len(items)
        out = []
        self._progress(stage, done, total)
        for item in items:
            out.append(self._computed(stage, function, item))
            self._progress(stage, done + len(out), total)
        return out

    def join(self, stage: str, joins: Sequence[Join], values: dict[int, Any], done: int = 0) -> dict[int, Any]:
        """See Executor."""
        values, total = dict(values), done + len(joins)
        self._progress(stage, done, total)
        for number, node in enumerate(joins, 1):
            pair = values.pop(node.left), values.pop(node.right)
            values[node.result] = self._computed(stage, node.function, pair)
            self._progress(stage, done + number, total)
        return values

    @staticmethod
    def _computed(stage: str, function: Callable[[Item], Result], item: Item) -> Result:
        try:
            with threadpool_limits(1):
                return function(item)
        except MemoryError as problem:
            raise SolveFailedError(f"stage {stage} ran out of memory") from problem

    def everywhere(self, function: Callable[[], None]) -> None:
        """See Executor."""
        function()

    def describe(self) -> dict[str, Any]:
        """See Executor."""
        return {"kind": "serial", "workers": 0, "threads_per_worker": 1}

    def peak_bytes(self) -> int:
        """See Executor."""
        return _peak_bytes()

    def __exit__(self, *_: object) -> None:
        return None


@contextmanager
def _interrupts_for_this_process_only() -> Iterator[None]:
    """Processes started inside never see Ctrl-C, which a terminal sends to all; one that arrives meanwhile waits."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # its start would unblock the signal in the thread that starts processes
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _check_that_workers_can_start() -> None:
    """Raise InputError where the main script is no file that worker processes could import."""
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        # this is such a process, importing a script that starts workers without asking whether it is the main one
        raise SystemExit(1)
    script = _script()
    if script is not None and not script.exists():
        raise InputError(f"worker processes import the main script, but {script} is no file; put it into one or use workers=0")


def _script() -> Path | None:
    """The file that worker processes import as the main module, if they do."""
    main = sys.modules["__main__"]
    name = getattr(main, "__file__", None)
    return None if name is None or getattr(main, "__spec__", None) is not None else Path(name)


def _start_cluster(workers: int) -> Any:
    """Start worker processes, reached from this machine only; raises InputError where the main script does not let them."""
    import dask
    from distributed import LocalCluster

    environment = {f"distributed.nanny.pre-spawn-environ.{name}": value for name, value in _WORKER_ENVIRONMENT.items()}
    try:
        with _interrupts_for_this_process_only(), dask.config.set(environment):
            return LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
            )
    except RuntimeError as problem:
        script = _script()
        if script is None or "failed to start" not in str(problem):
            raise
        unguarded = "__main__" not in script.read_text(encoding="utf-8", errors="replace")
        raise InputError(
            f"the worker processes did not start ({str(problem).rstrip('.')}); they import {script}, whose work must stand "
            'under `if __name__ == "__main__":`, or use workers=0'
        ) from (None if unguarded else problem)


def _warm_up_here(warm: Callable[[], None]) -> None:
    """Warm a worker up that was started here, and let it end at once when it has to."""
    atexit.register(leave, 0)
    warm()


def _run_located(function: Callable[[Any], Any], item: Any) -> tuple[str, Any]:
    from distributed import get_worker

    with threadpool_limits(1):
        return get_worker().address, function(item)


@contextmanager
def _silenced() -> Iterator[None]:
    """Have dask log nothing of workers and schedulers that come and go: errors say what matters."""
    import distributed  # noqa: F401  # it sets levels of its own

    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def _at_scheduler(scheduler: str | None, scheduler_file: Path | None, security: Security | None) -> Any:
    """A client of a running scheduler; raises InputError where none answers."""
    from distributed import Client
    from distributed.security import Security as DaskSecurity

    where = scheduler or scheduler_file
    if security is None and scheduler is not None and scheduler.startswith("tls://"):
        raise InputError(f"the scheduler at {scheduler} speaks TLS; give --tls-ca, --tls-cert and --tls-key")
    options: dict[str, Any] = {}
    if security is not None:
        files = (str(security.ca), str(security.certificate), str(security.key))
        names = ("tls_ca_file", "tls_client_cert", "tls_client_key")
        options["security"] = DaskSecurity(require_encryption=True, **dict(zip(names, files, strict=True)))
    try:
        return Client(
            address=scheduler, scheduler_file=str(scheduler_file) if scheduler_file else None, timeout=_ANSWER_S, **options
        )
    except (OSError, ValueError, RuntimeError, TypeError) as problem:
        raise InputError(f"no dask scheduler answers at {where}: {problem}") from problem


@dataclass(slots=True, eq=False)
class _Task:
    """A function to be applied to an item, wanted under a name, on the worker that has held its place before."""

    name: int
    place: int
    function: Callable[[Any], Any]
    item: Any
    tries: int = 0


class DaskExecutor(AbstractContextManager["DaskExecutor"]):
    """Tasks on dask workers: a local cluster of processes, or a running cluster.

    A local cluster is started in the background: whatever is called first waits for it. ``warm`` is called in each worker
    before its first task. A task whose worker is lost is run again, as are all when the scheduler comes back after it was lost;
    where there is no scheduler or no worker for ``patience_s`` seconds the run is stopped. A file that one task finds lost is
    said when the others have finished.
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
        self._places: dict[int, str] = {}
        self._calls = 0
        self._warm = warm
        self._warming: list[Any] = []
        self._cluster: Any = None
        self._held: Any = None
        self._problem: BaseException | None = None
        self._starting: threading.Thread | None = None
        self._reach: Callable[[], Any] | None = None
        self._closing = ExitStack()
        if scheduler is None and scheduler_file is None:
            _check_that_workers_can_start()
            self._starting = threading.Thread(target=self._start, args=(workers,), daemon=True)
            self._starting.start()
        else:
            self._reach = partial(_at_scheduler, scheduler, scheduler_file, security)
            self._held = self._reach()
            self._closing.enter_context(_silenced())
            self._warm_up(self._held)

    def _start(self, workers: int) -> None:
        from distributed import Client

        try:
            self._closing.enter_context(_silenced())
            self._cluster = _start_cluster(workers)
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
    ) -> list[Result]:
        """See Executor."""
        numbers = range(len(items)) if places is None else places
        tasks = [_Task(k, place, function, item) for k, (place, item) in enumerate(zip(numbers, items, strict=True))]
        out: dict[int, Any] = {}

        def keep(task: _Task, result: Any) -> list[_Task]:
            """Keep one result."""
            out[task.name] = result
            return []

        self._drive(stage, tasks, keep, done, done + len(tasks))
        return [out[k] for k in range(len(items))]

    def join(self, stage: str, joins: Sequence[Join], values: dict[int, Any], done: int = 0) -> dict[int, Any]:
        """See Executor."""
        values, waiting = dict(values), list(joins)

        def ready() -> list[_Task]:
            """What can be joined, with its values taken."""
            found = [node for node in waiting if node.left in values and node.right in values]
            for node in found:
                waiting.remove(node)
            return [
                _Task(node.result, node.result, node.function, (values.pop(node.left), values.pop(node.right)))
                for node in found
            ]

        def keep(task: _Task, result: Any) -> list[_Task]:
            """Keep a union; what can be joined now."""
            values[task.name] = result
            return ready()

        self._drive(stage, ready(), keep, done, done + len(joins))
        return values

    def _submit(self, stage: str, task: _Task) -> Any:
        if self._client.status != "running":
            self._await_cluster(stage, None)
        place = self._places.get(task.place)
        here = place is not None
        task.tries += 1
        return self._client.submit(
            _run_located,
            task.function,
            task.item,
            key=f"pgcp-{self._run}-{self._calls}-{stage}-{task.name}-{task.tries}",
            workers=[place] if here else None,
            allow_other_workers=here,
            pure=False,
        )

    def _drive(
        self, stage: str, tasks: list[_Task], then: Callable[[_Task, Any], list[_Task]], finished: int, total: int
    ) -> None:
        """Run tasks, and those that follow from their results, until none is left."""
        self._await_start()
        from distributed import CancelledError
        from distributed import TimeoutError as TooLateError
        from distributed.scheduler import KilledWorker

        self._calls += 1
        self._progress(stage, finished, total)
        active: dict[Any, _Task] = {}
        lost: LostFileError | None = None
        try:
            for task in tasks:
                active[self._submit(stage, task)] = task
            while active:
                for future in self._next_done(stage, active):
                    task = active.pop(future)
                    try:
                        self._places[task.place], result = future.result(timeout=self.patience_s)
                    except LostFileError as problem:
                        lost = problem
                        continue
                    except (CancelledError, TooLateError, OSError) as problem:
                        if future.status == "error":  # the task's own
                            raise
                        self._await_cluster(stage, problem)
                        if task.tries >= _MOST_TRIES:
                            raise StoppedError(f"stage {stage}: the scheduler was lost {task.tries} times") from problem
                        active[self._submit(stage, task)] = task
                        continue
                    finished += 1
                    self._progress(stage, finished, total)
                    for new in then(task, result):
                        active[self._submit(stage, new)] = new
        except KilledWorker as problem:
            raise StoppedError(
                f"stage {stage}: workers died again and again, most likely for lack of memory ({problem})"
            ) from problem
        except MemoryError as problem:
            raise SolveFailedError(f"stage {stage} ran out of memory on a worker") from problem
        except RuntimeError as problem:
            if "deserialization" in str(problem):
                message = "the cluster cannot load this run's tasks: install pgcp, in one version, on its scheduler and workers"
                raise InputError(message) from problem
            raise
        finally:
            if active:
                self._cancel(active)
        if lost is not None:
            raise lost

    def _cancel(self, futures: dict[Any, _Task]) -> None:
        with suppress(Exception):  # there may be no scheduler that could
            self._client.cancel(list(futures), force=True)

    def _next_done(self, stage: str, futures: dict[Any, _Task]) -> list[Any]:
        """Futures that are done or cancelled, in the order of their names, once there is one."""
        from distributed import CancelledError, wait
        from distributed import TimeoutError as TooLateError

        while True:
            try:
                wait(list(futures), timeout=_LOOK_S, return_when="FIRST_COMPLETED")
            except TooLateError:
                self._await_cluster(stage, None)
            except CancelledError:  # a lost scheduler cancels what is waited for
                pass
            done = [future for future in futures if future.status in ("finished", "error", "cancelled")]
            if done:
                return sorted(done, key=lambda future: futures[future].name)

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
            return list(set(self._places.values()))
        return list(self._client.scheduler_info(n_workers=-1)["workers"])

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
        own = _peak_bytes()
        if self._starting is not None or not self._is_reached:
            return own
        with suppress(Exception):  # of workers that are gone nothing is known
            return max([own, *self._client.run(_peak_bytes, on_error="ignore").values()])
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
