"""An executor that does one task after the other and records its place, seconds, memory, sizes, and what it waited for."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

import pgcp
from pgcp.runtime.executors import EXECUTORS, ExecutorKind, Joining, LocalExecutor, Speculation, Tasks, timed

Sizes = dict[str, Any]
SizesOf = Callable[[str, Any, Any], Sizes]
NAME = "recorder"


@dataclass(frozen=True, slots=True)
class Record:
    """One task: its stage, its place or the name of a join's value, what a join waited for, seconds, sizes, bytes it needed."""

    stage: str
    name: int
    after: tuple[int, ...]
    seconds: float
    sizes: Sizes
    memory_bytes: float


class Recorder(LocalExecutor):
    """Records tasks. Speculative work of a place is done directly before the next task of this place, as a task of its own.

    ``sizes_of(stage, item, result)`` says what is to be known of a task beside its seconds.
    """

    def __init__(self, sizes_of: SizesOf, looks_at_memory: bool) -> None:
        super().__init__(at_once=1)
        self.records: list[Record] = []
        self._sizes_of, self._looks_at_memory = sizes_of, looks_at_memory
        self._offers: dict[int, Speculation] = {}

    def speculate(self, work: Speculation) -> None:
        """See Executor."""
        self._offers[work.place] = work

    def run_tasks(self, tasks: Tasks[Any, Any], take: Callable[[int, Any], None]) -> None:
        """See Executor."""
        places: Sequence[int] = range(len(tasks.items)) if tasks.places is None else tasks.places
        with threadpool_limits(1):
            for position, (place, item) in enumerate(zip(places, tasks.items, strict=True)):
                if place in self._offers:
                    work = self._offers.pop(place)
                    self._recorded(work.stage, place, (), work.function, work.item)
                take(position, self._recorded(tasks.stage, place, (), tasks.function, item))

    def run_joins(self, joining: Joining) -> None:
        """See Executor."""
        with threadpool_limits(1):
            while ready := joining.take_ready():
                for node, pair in ready:
                    after = node.left, node.right
                    value = self._recorded(joining.stage, node.result, after, node.function, pair)
                    self.take_joined(joining, node.result, value)

    def _recorded(self, stage: str, name: int, after: tuple[int, ...], function: Callable[[Any], Any], item: Any) -> Any:
        before = forget_peak() if self._looks_at_memory else 0
        span, result = timed(function, item, 1)
        grown = resident_bytes("VmHWM") - before if self._looks_at_memory else 0
        result = self.counted(stage, span, result)
        self.records.append(Record(stage, name, after, span.seconds, self._sizes_of(stage, item, result), grown))
        return result


def recorded(
    mesh: pgcp.Mesh, options: pgcp.Options, sizes_of: SizesOf, looks_at_memory: bool
) -> tuple[pgcp.Parameterization, list[Record]]:
    """Map a mesh on a recorder; the map, and a record of every task."""
    recorder = Recorder(sizes_of, looks_at_memory)
    EXECUTORS.register(ExecutorKind(NAME, "one task after the other, recorded", lambda *_: recorder))
    try:
        return pgcp.compute(mesh, options, pgcp.Running(executor=NAME)), recorder.records
    finally:
        EXECUTORS.remove(NAME)


def resident_bytes(name: str) -> int:
    """VmRSS, resident now, or VmHWM, the most since it was forgotten; 0 where unknown."""
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith(name):
                return 1024 * int(line.split()[1])
    return 0


def forget_peak() -> int:
    """Return free memory to the system and begin anew to watch how much is resident; how much is now."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")
    return resident_bytes("VmRSS")
