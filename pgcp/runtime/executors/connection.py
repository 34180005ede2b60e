"""The dask cluster of an executor: its scheduler and workers, started here or reached elsewhere, and whether they answer."""

from __future__ import annotations

import atexit
import ctypes
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any

from pgcp.errors import StoppedError
from pgcp.parallel import leave
from pgcp.runtime.executors.cluster import check_that_workers_can_start, silenced, start_cluster
from pgcp.runtime.executors.probe import check_workers
from pgcp.runtime.forks import prepare_forks

_COUNT_S = 2.0  # between two counts of the workers
_RETRY_S = 0.2
_RESTART_S = 10.0

Warm = Callable[[], None]


class Connection:
    """A client of a scheduler. After ``patience_s`` seconds without a scheduler or a worker, a wait for them ends."""

    patience_s = 30.0
    kind = "dask cluster"
    workers_here = 0  # worker processes started here, a processor each

    def __init__(self, run: str, warm: Warm | None) -> None:
        self._run, self._warm = run, warm
        self._held: Any = None
        self._warming: list[Any] = []
        self._known: set[str] = set()
        self._counted, self._counted_at = 0, -_COUNT_S
        self._closing = ExitStack()

    def await_start(self) -> None:
        """Wait until the cluster has started."""

    @property
    def client(self) -> Any:
        """The client, when the cluster has started."""
        self.await_start()
        return self._held

    @property
    def is_reached(self) -> bool:
        """Whether the scheduler answers now."""
        return self._held is not None and self._held.status == "running"

    def _warm_up(self, client: Any) -> None:
        """Have workers load what tasks need before their first task."""
        if self._warm is not None:
            for address in client.scheduler_info(n_workers=-1)["workers"]:
                key = f"pgcp-{self._run}-warm-{address}"
                self._warming.append(client.submit(self._warm, key=key, workers=[address], pure=False))

    def has_worked(self, address: str) -> None:
        """Note a worker that has done a task."""
        self._known.add(address)

    def workers(self) -> list[str]:
        """Addresses of the workers; where the scheduler is lost, of those that have done a task."""
        if self.client.status != "running":
            return list(self._known)
        return list(self.client.scheduler_info(n_workers=-1)["workers"])

    def worker_count(self) -> int:
        """Number of workers, at most two seconds old."""
        if not self.workers_here and time.monotonic() > self._counted_at + _COUNT_S:
            self._counted, self._counted_at = len(self.workers()), time.monotonic()
        return self.workers_here or self._counted

    def reach_again(self) -> None:
        """Replace a client that has given up."""

    def await_workers(self, stage: str, problem: BaseException | None) -> None:
        """Wait until the scheduler answers and has workers; raises StoppedError after ``patience_s`` seconds."""
        until = time.monotonic() + self.patience_s
        while True:
            with suppress(Exception):
                if self.client.status == "closed":
                    self.reach_again()
                if self.client.status == "running" and self.workers():
                    return
            if time.monotonic() > until:
                what = "there is no worker" if self.client.status == "running" else "the scheduler does not answer"
                raise StoppedError(f"stage {stage}: {what} any more, for {self.patience_s:.0f} s") from problem
            time.sleep(_RETRY_S)

    def run(self, function: Callable[[], Any]) -> list[Any]:
        """Call a function once in every worker that answers; returns the results. None where the scheduler does not answer."""
        with suppress(Exception):
            if self.is_reached:
                return list(self._held.run(function, on_error="ignore").values())
        return []

    def close(self) -> None:
        """Close the client."""
        if self._held is not None:
            with suppress(Exception):
                self._held.close()
        self._closing.close()


class Reached(Connection):
    """A scheduler that runs elsewhere: ``reach`` makes a client of it. Its workers are asked for the store's folder first."""

    def __init__(self, run: str, reach: Callable[[], Any], warm: Warm | None, store: Path | None) -> None:
        super().__init__(run, warm)
        self._reach = reach
        self._held = reach()
        self._closing.enter_context(silenced())
        try:
            if store is not None:
                check_workers(self._held, self._held.scheduler_info(n_workers=-1)["workers"], store)
        except BaseException:
            self.close()
            raise
        self._warm_up(self._held)

    def reach_again(self) -> None:
        """See Connection."""
        self._held = self._reach()


class Given(Reached):
    """A client that somebody else has made and goes on to use."""

    def reach_again(self) -> None:
        """See Connection. Whoever closes the client means it."""

    def close(self) -> None:
        """See Connection; the client stays open."""
        self._warming.clear()
        self._closing.close()


class Started(Connection):
    """A local cluster of worker processes. A thread starts it, since the import of dask takes a second."""

    kind = "dask local cluster"

    def __init__(self, run: str, workers: int, warm: Warm | None) -> None:
        super().__init__(run, None if warm is None else partial(_warm_up_here, warm))
        self.workers_here = workers
        self._cluster: Any = None
        self._problem: BaseException | None = None
        check_that_workers_can_start()
        self._starting: threading.Thread | None = threading.Thread(target=self._start, daemon=True)
        self._starting.start()

    def _start(self) -> None:
        try:
            prepare_forks()
            from distributed import Client

            self._closing.enter_context(silenced())
            self._cluster = start_cluster(self.workers_here)
            self._held = Client(self._cluster)
            self._warm_up(self._held)
        except BaseException as problem:
            self._problem = problem

    def await_start(self) -> None:
        """See Connection. Raises the error of the thread."""
        if self._starting is not None:
            self._starting.join()
            self._starting = None
        if self._problem is not None:
            problem, self._problem = self._problem, None
            raise problem

    def run(self, function: Callable[[], Any]) -> list[Any]:
        """See Connection. No worker answers before one has been waited for."""
        return [] if self._starting is not None else super().run(function)

    def close(self) -> None:
        """See Connection; ends the workers."""
        if self._starting is not None:
            self._starting.join()
        if self._cluster is not None:
            with suppress(Exception):  # a worker that is closed while it is started again prints a traceback
                self._cluster.wait_for_workers(len(self._cluster.worker_spec), timeout=_RESTART_S)
        with self._closing:
            if self._held is not None:
                with suppress(Exception):
                    self._held.close()
            if self._cluster is not None:
                self._cluster.close()


def _warm_up_here(warm: Warm) -> None:
    """Warm a worker up that was started here, and let it end at once when it has to."""
    atexit.register(leave, 0)
    warm()


def return_memory() -> None:
    """Return free memory of this process to the system."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
