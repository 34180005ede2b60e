"""Seconds and peak memory of the stages of a run."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from pgcp.runtime.executors import Executor, LocalExecutor, Progress, silent

_LOGGER = logging.getLogger("pgcp")


class Clock:
    """Begin, seconds and peak memory of the stages run so far; ``executor`` is asked for the memory of its processes.

    ``progress`` hears of every stage as it begins and ends, and of the tasks that the executor counts. The logger ``pgcp``
    gets a line for each.
    """

    def __init__(self, progress: Progress = silent) -> None:
        self.stages: list[dict[str, Any]] = []
        self.executor: Executor = LocalExecutor()
        self._progress = progress
        self._counted: set[str] = set()
        self._start, self._time = time.perf_counter(), time.time()

    def progress(self, stage: str, done: int, total: int) -> None:
        """Pass on what an executor has done of a stage."""
        self._counted.add(stage)
        _LOGGER.debug("%s: %d of %d", stage, done, total)
        self._progress(stage, done, total)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what is done inside."""
        start = time.perf_counter()
        _LOGGER.info("%s: begun", name)
        self._progress(name, 0, 0)
        try:
            yield
            if name not in self._counted:
                self._progress(name, 1, 1)
        finally:
            seconds = time.perf_counter() - start
            _LOGGER.info("%s: %.2f s", name, seconds)
            begin = round(start - self._start, 4)
            self.stages.append({"name": name, "begin": begin, "seconds": round(seconds, 4), "peak_bytes": 0})
        self.stages[-1]["peak_bytes"] = self.executor.peak_bytes()

    def timeline(self, executor: Executor) -> list[dict[str, Any]]:
        """Every task of an executor: stage, number of its worker, when it began, seconds since the run did, and its seconds."""
        return [
            {"stage": stage, "worker": worker, "begin": round(span.begin - self._time, 4), "seconds": round(span.seconds, 4)}
            for stage, worker, span in executor.worked
        ]
