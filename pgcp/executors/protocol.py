"""What an executor does, and joins along a tree."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")
Progress = Callable[[str, int, int], None]


class Join(NamedTuple):
    """One node of a tree: function((values[left], values[right])) becomes values[result]."""

    left: int
    right: int
    result: int
    function: Callable[[tuple[Any, Any]], Any]


class Spare(NamedTuple):
    """Work that an idle worker does ahead of a task for the same place; function(item) says whether it has kept the outcome."""

    place: int
    function: Callable[[Any], bool]
    item: Any


class Joining:
    """Joins along a tree, each to be done as soon as what it needs is there.

    ``put`` gives what they begin with, under names; ``values`` are those nothing has been made of yet, ``waiting`` the joins
    that have not begun. After a problem nothing more is begun. ``done`` more joins count as finished in what progress says.
    ``spares`` are for workers that are idle before all is joined, the next one last, until one is not kept.
    """

    def __init__(self, stage: str, joins: Sequence[Join], done: int = 0) -> None:
        self.stage = stage
        self.finished, self.total = done, done + len(joins)
        self.values: dict[int, Any] = {}
        self.problem: Exception | None = None
        self.waiting = list(joins)
        self.spares: list[Spare] = []
        self._seen: set[int] = set()

    def put(self, name: int, value: Any) -> None:
        """Give a value; one that was given before is not needed again."""
        if name not in self._seen:
            self._seen.add(name)
            self.values[name] = value

    def take_ready(self) -> list[tuple[Join, tuple[Any, Any]]]:
        """What can be joined now, with its values."""
        if self.problem is not None:
            return []
        ready = [node for node in self.waiting if node.left in self.values and node.right in self.values]
        self.waiting = [node for node in self.waiting if node not in ready]
        return [(node, (self.values.pop(node.left), self.values.pop(node.right))) for node in ready]

    def keep(self, name: int, value: Any) -> None:
        """Take what has been joined."""
        self.put(name, value)
        self.finished += 1


def silent(_stage: str, _done: int, _total: int) -> None:
    """Report no progress."""


def ignore(_result: object) -> None:
    """Do nothing with a result that has come in."""


class Executor(Protocol):
    """Maps functions over items."""

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
        """Apply function to every item. Items prefer the worker that keeps something for the same place (by default, position).

        With ``keeps`` workers keep something of these items. ``done`` more items count as finished in what progress says.
        ``each`` is called with every result as it comes in. Joins ``beside`` may be begun meanwhile, and spare work of theirs;
        ``join`` waits for them.
        """
        ...

    def join(self, joining: Joining) -> dict[int, Any]:
        """Do the joins that are left; returns the values nothing is made of, or raises the problem of one of them."""
        ...

    @property
    def taken(self) -> dict[str, dict[str, float]]:
        """How many tasks each stage had, and the seconds they took where they ran, added up."""
        ...

    def rest(self) -> None:
        """Have workers that were started here give back the memory that they keep for the next task."""
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


def count(taken: dict[str, dict[str, float]], stage: str, seconds: float) -> None:
    """Count a task of a stage, and its seconds, in what has been taken."""
    record = taken.setdefault(stage, {"count": 0, "seconds": 0.0})
    record["count"] += 1
    record["seconds"] = round(record["seconds"] + seconds, 4)


def peak_bytes() -> int:
    """Largest resident size this process has had."""
    try:
        import resource
    except ImportError:
        import psutil

        return int(psutil.Process().memory_info().rss)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)
