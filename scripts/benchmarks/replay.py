"""Replay tasks of known seconds on any number of workers: list scheduling, speculative parts of tasks, and a network."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

Name = int | tuple[str, int]  # of a patch or union, or what is done for it


@dataclass(frozen=True, slots=True)
class Task:
    """One task: seconds of work, tasks it waits for, and bytes from the store, from the driver and back to the driver.

    Those of less ``rank`` go first. A speculative task is a part of the task ``ahead_of`` which it is: idle workers begin it,
    the one that is ready last first, when the driver knows that they are idle, and as long as the whole waits for others.
    If it has not begun then, its seconds are added to those of the whole.
    """

    name: Name
    seconds: float
    after: tuple[Name, ...] = ()
    store_bytes: float = 0.0
    in_bytes: float = 0.0
    out_bytes: float = 0.0
    rank: float = 0.0
    ahead_of: Name | None = None


@dataclass(frozen=True, slots=True)
class Network:
    """What every task costs beside its work; the store and the driver have a link each."""

    overhead_s: float = 0.0
    latency_s: float = 0.0
    bytes_per_s: float = float("inf")


class Link:
    """Carries one transfer after the other, in the order in which they are asked for."""

    def __init__(self, bytes_per_s: float) -> None:
        self._speed, self._free_at = bytes_per_s, 0.0

    def carry(self, now: float, size: float) -> float:
        """When a transfer that is asked for now is through."""
        if size == 0.0:
            return now
        self._free_at = max(now, self._free_at) + size / self._speed
        return self._free_at


class Queue:
    """Tasks that are ready, by rank and then by when they became so; ``finished`` holds when tasks were done."""

    def __init__(self, tasks: Sequence[Task]) -> None:
        self.finished: dict[Name, float] = {}
        self._begun: set[Name] = set()
        self._order = itertools.count()
        self._ready: list[tuple[float, int, Task]] = []
        self._parts = {task.ahead_of: task for task in tasks if task.ahead_of is not None}
        self._missing = {task.name: len(task.after) for task in tasks}
        self._followers: dict[Name, list[Task]] = {task.name: [] for task in tasks}
        for task in tasks:
            for name in task.after:
                self._followers[name].append(task)
            if not task.after:
                self._add(task)

    def _add(self, task: Task) -> None:
        part = self._parts.get(task.name)
        if part is not None and part.name not in self._begun:
            task = replace(task, seconds=part.seconds + task.seconds)
        elif part is not None and part.name not in self.finished:
            self._missing[task.name] = 1
            self._followers[part.name].append(task)
            return
        place = next(self._order)
        entry = (task.rank, place, task) if task.ahead_of is None else (float("inf"), -place, task)
        heapq.heappush(self._ready, entry)

    def pop(self, idle_is_known: bool) -> Task | None:
        """The task that begins next; a speculative one only where the driver knows of an idle worker."""
        while self._ready:
            whole = self._ready[0][2].ahead_of
            if whole is not None and not idle_is_known:
                return None
            task = heapq.heappop(self._ready)[2]
            if whole is None or self._missing[whole]:
                self._begun.add(task.name)
                return task
        return None

    def finish(self, task: Task, now: float) -> None:
        """Note that a task is done; add those that waited for it."""
        self.finished[task.name] = now
        for follower in self._followers[task.name]:
            self._missing[follower.name] -= 1
            if not self._missing[follower.name]:
                self._add(follower)

    def left(self) -> int:
        """How many tasks wait for others."""
        return sum(count > 0 for count in self._missing.values())


def simulate(tasks: Sequence[Task], workers: int, network: Network | None = None) -> dict[Name, float]:
    """Seconds until each task is done: by rank, then first come first served, when its turn has come and a worker is idle.

    A worker is busy from when a task is sent to it until it has computed; the result is then on its way to the driver, and
    tasks that wait for it can start when it is there. Raises ValueError where tasks wait for each other.
    """
    network = network or Network()
    store, driver = Link(network.bytes_per_s), Link(network.bytes_per_s)
    queue, order = Queue(tasks), itertools.count()
    idle, under_way, now = workers, 0, 0.0
    events: list[tuple[float, int, bool, Task]] = []
    while True:
        while idle and (task := queue.pop(under_way < workers)) is not None:
            idle, under_way = idle - 1, under_way + 1
            begin = store.carry(now + network.overhead_s + network.latency_s, task.store_bytes)
            begin = driver.carry(begin, task.in_bytes)
            heapq.heappush(events, (begin + task.seconds, next(order), False, task))
        if not events:
            break
        now, _, has_arrived, task = heapq.heappop(events)
        if has_arrived:
            under_way -= 1
            queue.finish(task, now)
        else:
            idle += 1
            there = driver.carry(now, task.out_bytes) + network.latency_s
            heapq.heappush(events, (there, next(order), True, task))
    if queue.left():
        raise ValueError(f"{queue.left()} tasks wait for each other")
    return queue.finished


def passes(
    flatten: Sequence[Task],
    welds: Sequence[Task],
    prepare: Sequence[Task],
    solve: Sequence[Task],
    workers: int,
    network: Network,
) -> list[float]:
    """Seconds of flatten, of the welds that are left after it, and of solve, which idle workers prepare beside the welds.

    Tasks of patch k are named k in every list.
    """
    last = tuple(task.name for task in (welds[-1:] or flatten))
    ahead = [replace(t, name=("prepare", t.name), after=(t.name,), ahead_of=("solve", t.name)) for t in prepare]
    if not welds:
        ahead, solve = [], [replace(t, seconds=p.seconds + t.seconds) for p, t in zip(prepare, solve, strict=True)]
    done = simulate(
        [*flatten, *welds, *ahead, *(replace(t, name=("solve", t.name), after=last) for t in solve)], workers, network
    )
    flattened = max(done[task.name] for task in flatten)
    welded = max(done[name] for name in last)
    return [flattened, welded - flattened, max(done["solve", task.name] for task in solve) - welded]


def depth_of(leaves: Sequence[int], joins: Iterable[tuple[int, int, int]]) -> dict[int, int]:
    """How deep in a tree of joins (left, right, result), in an order in which they can be done, each leaf is."""
    level: dict[int, int] = dict.fromkeys(leaves, 0)
    wanted: dict[int, int] = {}
    for left, right, result in joins:
        level[result] = 1 + max(level[left], level[right])
        wanted[left] = wanted[right] = level[result]
    return {leaf: wanted.get(leaf, 0) for leaf in leaves}
