"""Tasks one after the other in this process."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Any

from threadpoolctl import threadpool_limits

from pgcp.errors import SolveFailedError
from pgcp.executors.protocol import Item, Joining, Progress, Result, count, ignore, peak_bytes, silent


class SerialExecutor(AbstractContextManager["SerialExecutor"]):
    """One task after the other in this process: the reference."""

    def __init__(self, progress: Progress = silent) -> None:
        self._progress = progress
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
        """See Executor. Joins wait: there is one process, which is never idle."""
        total = done + len(items)
        out = []
        self._progress(stage, done, total)
        for item in items:
            out.append(self._computed(stage, function, item))
            each(out[-1])
            self._progress(stage, done + len(out), total)
        return out

    def join(self, joining: Joining) -> dict[int, Any]:
        """See Executor."""
        self._progress(joining.stage, joining.finished, joining.total)
        while ready := joining.take_ready():
            for node, pair in ready:
                joining.keep(node.result, self._computed(joining.stage, node.function, pair))
                self._progress(joining.stage, joining.finished, joining.total)
        return joining.values

    def _computed(self, stage: str, function: Callable[[Item], Result], item: Item) -> Result:
        start = time.perf_counter()
        try:
            with threadpool_limits(1):
                result = function(item)
        except MemoryError as problem:
            raise SolveFailedError(f"stage {stage} ran out of memory") from problem
        count(self.taken, stage, time.perf_counter() - start)
        return result

    def rest(self) -> None:
        """See Executor."""

    def everywhere(self, function: Callable[[], None]) -> None:
        """See Executor."""
        function()

    def describe(self) -> dict[str, Any]:
        """See Executor."""
        return {"kind": "serial", "workers": 0, "threads_per_worker": 1}

    def peak_bytes(self) -> int:
        """See Executor."""
        return peak_bytes()

    def __exit__(self, *_: object) -> None:
        return None
