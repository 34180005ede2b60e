"""Seconds and peak memory of the stages of a run."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from pgcp.runtime.executors import Executor, LocalExecutor


class Clock:
    """Seconds and peak memory of the stages run so far; ``executor`` is asked for the memory of its processes."""

    def __init__(self) -> None:
        self.stages: list[dict[str, Any]] = []
        self.executor: Executor = LocalExecutor()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what is done inside."""
        start = time.perf_counter()
        try:
            yield
        finally:
            seconds = time.perf_counter() - start
            self.stages.append({"name": name, "seconds": round(seconds, 4), "peak_bytes": 0})
        self.stages[-1]["peak_bytes"] = self.executor.peak_bytes()
