"""Where tasks run: in this process, or on dask workers. The only import of dask.

An executor maps a function over items and reports progress. Results come back in the order of the items, whatever
order they finish in, and each task computes with one BLAS thread wherever it runs: results do not depend on the executor.
"""

from __future__ import annotations

import logging
import multiprocessing
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any, Protocol, TypeVar

from threadpoolctl import threadpool_limits

from pgcp.errors import InputError, PgcpError, SolveFailedError

Item = TypeVar("Item")
Result = TypeVar("Result")
Progress = Callable[[str, int, int], None]


class Executor(Protocol):
    """Maps functions over items."""

    def map(self, stage: str, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """Apply function to every item. Items of later stages prefer the worker that had the same position before."""
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

    def map(self, stage: str, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """See Executor."""
        out = []
        self._progress(stage, 0, len(items))
        for item in items:
            try:
                with threadpool_limits(1):
                    out.append(function(item))
            except MemoryError as problem:
                raise SolveFailedError(f"stage {stage} ran out of memory") from problem
            self._progress(stage, len(out), len(items))
        return out

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


def _start_cluster(workers: int) -> Any:
    """Start worker processes here; raises InputError where the main script does not let them start."""
    from distributed import LocalCluster

    if getattr(multiprocessing.current_process(), "_inheriting", False):
        # this is such a process, importing a script that starts workers without asking whether it is the main one
        raise SystemExit(1)
    script = getattr(sys.modules["__main__"], "__file__", None)
    as_module = getattr(sys.modules["__main__"], "__spec__", None) is not None
    if script is not None and not as_module and not Path(script).exists():
        raise InputError(f"worker processes import the main script, but {script} is no file; put it into one or use workers=0")
    try:
        with _interrupts_for_this_process_only():
            return LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
            )
    except RuntimeError as problem:
        if script is None or "failed to start" not in str(problem):
            raise
        unguarded = "__main__" not in Path(script).read_text(encoding="utf-8", errors="replace")
        raise InputError(
            f"the worker processes did not start ({str(problem).rstrip('.')}); they import {script}, whose work must stand "
            'under `if __name__ == "__main__":`, or use workers=0'
        ) from (None if unguarded else problem)


def _run_located(function: Callable[[Any], Any], item: Any) -> tuple[str, Any]:
    from distributed import get_worker

    with threadpool_limits(1):
        return get_worker().address, function(item)


class DaskExecutor(AbstractContextManager["DaskExecutor"]):
    """Tasks on dask workers: a local cluster of processes, or a running cluster."""

    def __init__(
        self,
        run: str,
        workers: int = 0,
        scheduler: str | None = None,
        scheduler_file: Path | None = None,
        progress: Progress = silent,
    ) -> None:
        from distributed import Client

        self._run = run
        self._progress = progress
        self._places: dict[int, str] = {}
        self._calls = 0
        self._cluster: Any = None
        if scheduler is None and scheduler_file is None:
            self._cluster = _start_cluster(workers)
            self._client: Any = Client(self._cluster)
            return
        try:
            self._client = Client(
                address=scheduler, scheduler_file=str(scheduler_file) if scheduler_file else None, timeout="10s"
            )
        except (OSError, ValueError) as problem:
            raise InputError(f"no dask scheduler answers at {scheduler or scheduler_file}: {problem}") from problem

    def map(self, stage: str, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """See Executor."""
        from distributed import as_completed
        from distributed.scheduler import KilledWorker

        self._progress(stage, 0, len(items))
        self._calls += 1
        futures = []
        for position, item in enumerate(items):
            place = self._places.get(position)
            futures.append(
                self._client.submit(
                    _run_located,
                    function,
                    item,
                    key=f"pgcp-{self._run}-{self._calls}-{stage}-{position}",
                    workers=[place] if place else None,
                    allow_other_workers=place is not None,
                    pure=False,
                )
            )
        out: dict[Any, Any] = {}
        try:
            for future in as_completed(futures):
                out[future.key] = future.result()
                self._progress(stage, len(out), len(items))
        except KilledWorker as problem:
            raise SolveFailedError(f"stage {stage}: workers died, most likely for lack of memory ({problem})") from problem
        except MemoryError as problem:
            self._client.cancel(futures, force=True)
            raise SolveFailedError(f"stage {stage} ran out of memory on a worker") from problem
        except PgcpError:
            self._client.cancel(futures, force=True)
            raise
        except RuntimeError as problem:
            if "deserialization" in str(problem):
                message = "the cluster cannot load this run's tasks: install pgcp, in one version, on its scheduler and workers"
                raise InputError(message) from problem
            raise
        results = []
        for position, future in enumerate(futures):
            self._places[position], result = out[future.key]
            results.append(result)
        return results

    def everywhere(self, function: Callable[[], None]) -> None:
        """See Executor: workers started here end with it."""
        if self._cluster is None:
            self._client.run(function)

    def describe(self) -> dict[str, Any]:
        """See Executor."""
        return {
            "kind": "dask local cluster" if self._cluster is not None else "dask cluster",
            "workers": len(self._client.scheduler_info(n_workers=-1)["workers"]),
            "threads_per_worker": 1,
        }

    def peak_bytes(self) -> int:
        """See Executor."""
        return max([_peak_bytes(), *self._client.run(_peak_bytes).values()])

    def __exit__(self, *_: object) -> None:
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()
