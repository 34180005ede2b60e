"""What an executor is given: tasks over items, a tree of joins, and speculative work."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True, eq=False)
class Tasks(Generic[Item, Result]):
    """The tasks of a stage: one function over items.

    places: the patch that each item is about, by default the item's position. A task goes to the worker that has cached this
    patch, if there is one. caches: whether a task leaves its patch in the cache of its worker. done: how many more tasks of the
    stage were finished before; progress counts them.
    """

    stage: str
    function: Callable[[Item], Result]
    items: Sequence[Item]
    places: Sequence[int] | None = None
    caches: bool = True
    done: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Join:
    """One node of a tree: ``function((values[left], values[right]))`` becomes ``values[result]``."""

    left: int
    right: int
    result: int
    function: Callable[[tuple[Any, Any]], Any]


@dataclass(frozen=True, slots=True, eq=False)
class JoinTree:
    """The joins of a stage, in an order in which they can be done; ``done`` more were finished before."""

    stage: str
    joins: Sequence[Join]
    done: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Speculation:
    """Work ahead of the next task for a place, which a worker may do that would be idle.

    ``function(item)`` returns whether the worker has cached the patch of this place.
    """

    stage: str
    place: int
    function: Callable[[Any], bool]
    item: Any


class Joining:
    """A tree under way. ``put`` gives the values that it begins with; ``results`` waits for the joins that are left.

    Executors call ``take_ready`` and ``keep``, and set ``problem`` when a join has failed: then no other join begins.
    """

    def __init__(self, tree: JoinTree, finish: Callable[[Joining], None]) -> None:
        self.stage = tree.stage
        self.finished, self.total = tree.done, tree.done + len(tree.joins)
        self.values: dict[int, Any] = {}
        self.problem: Exception | None = None
        self.waiting = list(tree.joins)
        self._seen: set[int] = set()
        self._finish = finish

    def put(self, name: int, value: Any) -> None:
        """Give a value; one whose name was given before changes nothing."""
        if name not in self._seen:
            self._seen.add(name)
            self.values[name] = value

    def take_ready(self) -> list[tuple[Join, tuple[Any, Any]]]:
        """Take the joins whose two values are known, with these values."""
        if self.problem is not None:
            return []
        ready = [node for node in self.waiting if node.left in self.values and node.right in self.values]
        self.waiting = [node for node in self.waiting if node not in ready]
        return [(node, (self.values.pop(node.left), self.values.pop(node.right))) for node in ready]

    def keep(self, name: int, value: Any) -> None:
        """Take the value of a join."""
        self.put(name, value)
        self.finished += 1

    def results(self) -> dict[int, Any]:
        """Finish the joins; returns the values that no join has used. Raises the error of a join that failed."""
        self._finish(self)
        return self.values


def ignore(_result: object) -> None:
    """Do nothing with a result."""
