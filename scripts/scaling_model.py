#!/usr/bin/env python3
"""Predict how a run scales: task times measured on a mesh, replayed on up to 1,024 workers and a billion vertices.

usage: scaling_model.py [--patches 6,24,64,128] [--repeat 3] [--target auto] [--validate 6] [--vertices 1e6,1e7,1e8,1e9]
                        [--workers 1,2,4,...,1024] [--task-overhead-ms 5] [--latency-ms 0.5] [--bandwidth-gbit 10]
                        [--output-dir DIR] MESH [MESH ...]

measure   every mesh is mapped serially in each number of patches; every task is timed, and once more its memory looked at
fit       seconds and bytes as sums of powers of sizes, with factors that are not negative (see TERMS): flatten, prepare (the
          part of solve that idle workers do while others weld) and solve by
          the vertices and boundary edges of a patch, weld by the points of the seam and the union, driver stages by
          vertices and patches; what runs between the stages, planning the welds, also by the square of the patches. Of the
          terms of a weld that grow fastest, and are small on the measured mesh, a least factor is measured by themselves
simulate  list scheduling of flatten and the tree of welds, which go first when they can begin, with workers that are idle
          preparing patches, then solve; an overhead for every task; patches go through the store's link, curves and unions
          through the driver's, each of --bandwidth-gbit and used by one transfer at a time.
          Patches are as many as pgcp-run takes. The tree of welds is that of a flat square, planned by the package for up to
          256 parts, each halved further as needed
validate  the first mesh in --validate patches (0: not at all) on 1 and 2 worker processes that have been started before,
          against the measured times replayed (replay) and against the fits (model), without a network
predict   seconds, speedup over one worker, efficiency, memory of a worker and of the driver, and what takes longest
Writes scaling.tsv and scaling.png. Memory is measured on Linux only.
"""

from __future__ import annotations

import argparse
import ctypes
import functools
import heapq
import itertools
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from statistics import median
from typing import Any, ClassVar

import numpy as np
from benchmark import aligned, run_pgcp, stage_seconds, warm_up
from scipy.optimize import nnls
from speedup import PARALLEL, measure_started, numbers
from threadpoolctl import threadpool_limits

import pgcp
from pgcp import pipeline
from pgcp.executors import Joining, LocalExecutor, Progress, silent
from pgcp.natural import natural_boundary
from pgcp.parallel import limited_to
from pgcp.plan import DEFAULT_PATCHES, make_plan
from pgcp.split import cut_patches, plan_welds, split_mesh
from pgcp.tasks import prepare_task, solve_task
from pgcp.topology import examine
from pgcp.zipper import close_arcs, open_arc

PLANNED = 256  # parts of the tree that the package plans
_PART_VERTICES = 150
_PANELS = 1200  # panels of the natural boundary, as in pgcp.natural
_POINTS, _MOST_PARTS = 8000, 8  # points that all seams are subdivided to, as in pgcp.split
_LAST = 1e6  # a rank after all others
_PATCH_BYTES, _MAP_BYTES = 72.0, 48.0  # of a stored patch and its map, per vertex

Sizes = dict[str, Any]
Name = int | tuple[str, int]  # of a patch or union, or what is done for it
# n vertices of a patch, or nodes of a union; b boundary edges; s seam points; p panels; c patches in a union; V, K of the run
TERMS: dict[str, Callable[[Sizes], list[Any]]] = {
    "flatten": lambda x: [1.0, x["n"], x["n"] ** 1.5, x["b"] ** 3],
    "weld": lambda x: [1.0, x["n"], x["s"] * x["n"], x["s"] ** 2, x["n"] * x["p"], x["c"] ** 2 * x["n"]],
    "prepare": lambda x: [1.0, x["n"], x["n"] ** 1.5],
    "solve": lambda x: [1.0, x["n"], x["n"] ** 1.5],
    "driver": lambda x: [x["V"], x["K"]],
    "between stages": lambda x: [x["V"], x["K"], x["K"] ** 2],
    "flatten bytes": lambda x: [x["n"], x["b"] ** 2],
    "weld bytes": lambda x: [x["n"], x["c"] * x["n"], x["p"] ** 2],
    "union bytes": lambda x: [x["n"]],
}


# ----------------------------------------------------------------------------------------------------------------------- fits


def features(kind: str, sizes: Sizes) -> np.ndarray:
    """The terms of a kind, one in a column, for sizes that are numbers or arrays (N,)."""
    columns = np.broadcast_arrays(*TERMS[kind]({name: np.asarray(v, float) for name, v in sizes.items()}))
    return np.stack(columns, axis=-1)


def fit_terms(
    kind: str, sizes: Sizes, values: Sequence[float], relative: bool = True, least: Sequence[float] = ()
) -> np.ndarray:
    """Factors of the terms, none below ``least`` or else 0, of least squared error to values (N,), relative or not."""
    wanted = np.asarray(values, float)
    matrix = np.atleast_2d(features(kind, sizes))
    floor = np.asarray(least, float) if len(least) else np.zeros(matrix.shape[1])
    weight = 1.0 / np.maximum(wanted, 1e-9) if relative else np.ones(len(wanted))
    rest = (wanted - matrix @ floor) * weight
    matrix = matrix * weight[:, None]
    extent = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    found: np.ndarray = floor + nnls(matrix / extent, rest)[0] / extent
    return found


def evaluate(kind: str, factors: np.ndarray, sizes: Sizes) -> Any:
    """The sum of terms."""
    return features(kind, sizes) @ factors


# ----------------------------------------------------------------------------------------------------------------- simulation


@dataclass(frozen=True, slots=True)
class Task:
    """One task: seconds of work, tasks it waits for, and bytes from the store, from the driver and back to the driver.

    Those of less ``rank`` go first. One with ``spare_until`` is for workers that are idle, and not before the driver knows that
    they are, until that task is done; after that it is not begun.
    """

    name: Name
    seconds: float
    after: tuple[Name, ...] = ()
    store_bytes: float = 0.0
    in_bytes: float = 0.0
    out_bytes: float = 0.0
    rank: float = 0.0
    spare_until: Name | None = None


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


def simulate(jobs: Sequence[Task], workers: int, network: Network | None = None) -> dict[Name, float]:
    """Seconds until each task is done: by rank, then first come first served, when its turn has come and a worker is idle.

    A worker is busy from when a task is sent to it until it has computed; the result is then on its way to the driver, and
    tasks that wait for it can start when it is there. Raises ValueError where tasks wait for each other.
    """
    network = network or Network()
    store, driver = Link(network.bytes_per_s), Link(network.bytes_per_s)
    missing = {job.name: len(job.after) for job in jobs}
    followers: dict[Name, list[Task]] = {job.name: [] for job in jobs}
    for job in jobs:
        for name in job.after:
            followers[name].append(job)
    order = itertools.count()
    ready = [(job.rank, next(order), job) for job in jobs if not job.after]
    heapq.heapify(ready)
    idle, under_way, now, finished = workers, 0, 0.0, dict[Name, float]()
    events: list[tuple[float, int, bool, Task]] = []
    while ready or events:
        while ready and idle:
            spare_until = ready[0][2].spare_until
            if spare_until is not None and (spare_until in finished or under_way >= workers):
                break
            _, _, job = heapq.heappop(ready)
            idle, under_way = idle - 1, under_way + 1
            begin = store.carry(now + network.overhead_s + network.latency_s, job.store_bytes)
            begin = driver.carry(begin, job.in_bytes)
            heapq.heappush(events, (begin + job.seconds, next(order), False, job))
        if not events:
            break
        now, _, has_arrived, job = heapq.heappop(events)
        if not has_arrived:
            idle += 1
            there = driver.carry(now, job.out_bytes) + network.latency_s
            heapq.heappush(events, (there, next(order), True, job))
            continue
        under_way -= 1
        finished[job.name] = now
        for follower in followers[job.name]:
            missing[follower.name] -= 1
            if not missing[follower.name]:
                heapq.heappush(ready, (follower.rank, next(order), follower))
    left = sum(job.name not in finished for job in jobs if job.spare_until is None)
    if left:
        raise ValueError(f"{left} tasks wait for each other")
    return finished


def passes(
    flatten: Sequence[Task],
    welds: Sequence[Task],
    prepare: Sequence[Task],
    solve: Sequence[Task],
    workers: int,
    network: Network,
) -> list[float]:
    """Seconds of flatten, of the welds that are left after it, and of solve, which idle workers prepare meanwhile.

    Tasks of patch k are named k in every list; what has not been prepared when the last weld is done is a part of solve.
    """
    last = welds[-1].name if welds else None
    spares = [replace(t, name=("prepare", t.name), after=(t.name,), rank=_LAST, spare_until=last) for t in prepare if welds]
    done = simulate([*flatten, *welds, *spares], workers, network)
    flattened = max(done[job.name] for job in flatten)
    welded = max((done[job.name] for job in welds), default=flattened)
    rest: list[Task] = []
    for ahead, job in zip(prepare, solve, strict=True):
        end = done.get(("prepare", ahead.name))
        if end is None:
            rest.append(replace(job, seconds=ahead.seconds + job.seconds))
        elif end <= welded:
            rest.append(job)
        else:
            rest += [Task(("prepare", ahead.name), end - welded, rank=-1.0), replace(job, after=(("prepare", ahead.name),))]
    return [flattened, welded - flattened, max(simulate(rest, workers, network).values())]


def depth_of(leaves: Sequence[int], joins: Iterable[tuple[int, int, int]]) -> dict[int, int]:
    """How deep in a tree of joins (left, right, result), in an order in which they can be done, each leaf is."""
    joined = list(joins)
    level: dict[int, int] = dict.fromkeys(leaves, 0)
    wanted = {}
    for left, right, result in joined:
        level[result] = 1 + max(level[left], level[right])
        wanted[left] = wanted[right] = level[result]
    return {leaf: wanted.get(leaf, 0) for leaf in leaves}


# ---------------------------------------------------------------------------------------------------------------- measurement


@dataclass(frozen=True, slots=True)
class Sample:
    """One task that has run: its stage and name, sizes, seconds, growth of memory, what it waited for, bytes of its result."""

    stage: str
    name: int
    sizes: Sizes
    seconds: float
    memory_bytes: float
    after: tuple[int, ...]
    result_bytes: float


@dataclass(frozen=True, slots=True)
class Trace:
    """One serial run: vertices, patches, its tasks, seconds of the driver's own work by stage."""

    vertices: int
    patches: int
    samples: list[Sample]
    driver: dict[str, float]

    def of(self, stage: str) -> list[Sample]:
        """Tasks of one stage."""
        return [sample for sample in self.samples if sample.stage == stage]


def resident_bytes(name: str) -> int:
    """VmRSS, resident now, or VmHWM, the most since it was forgotten; 0 where unknown."""
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith(name):
                return 1024 * int(line.split()[1])
    return 0


def forget_peak() -> None:
    """Give free memory back, and begin anew to watch how much is resident."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")


def array_bytes(record: Any) -> float:
    """Bytes of the arrays in a dataclass."""
    values = (getattr(record, field.name) for field in fields(record))
    return float(sum(value.nbytes for value in values if isinstance(value, np.ndarray)))


def union_sizes(left: Any, right: Any, union: Any, patches: int) -> Sizes:
    """What the cost of a weld depends on."""
    corners = max(len(union.corners), 1)
    seam = len(left.nodes) + len(right.nodes) - len(union.nodes)
    return {"n": len(union.nodes), "s": seam, "p": panels(corners), "c": patches}


def panels(corners: float) -> float:
    """Panels of the natural boundary of a loop with so many mesh vertices."""
    return corners / np.ceil(corners / _PANELS)


def seconds_of(function: Callable[..., Any], *arguments: Any) -> float:
    """Seconds of a call on one BLAS thread, the lesser of two after one that may compile."""
    taken = []
    with threadpool_limits(1), limited_to(1):
        for _ in range(3):
            start = time.perf_counter()
            function(*arguments)
            taken.append(time.perf_counter() - start)
    return min(taken[1:])


def zipper_seconds(seam: int = 400, others: int = 50_000) -> float:
    """Seconds for opening and closing an arc, by its points and by the other points that move along."""
    arc = np.exp(1j * np.pi * np.arange(seam + 1) / seam)
    rest = np.exp(1j * np.pi * (1 + (0.5 + np.arange(others)) / others))
    gaps, moved, _ = open_arc(arc, rest, 1.0)
    both = seconds_of(open_arc, arc, rest, 1.0) + seconds_of(close_arcs, gaps, gaps, moved)
    alone = seconds_of(open_arc, arc, rest[:1], 1.0) + seconds_of(close_arcs, gaps, gaps, moved[:1])
    return max(both - alone, 0.0) / (seam * others)


def cycle_seconds(side: int = 24, steps: int = 16) -> float:
    """Seconds of the natural boundary by the square of the cycles and the nodes: of a square of side x side cells.

    The walls between its cells are cut into ``steps``; what its boundary costs is small beside them.
    """
    many = side * steps
    x, y = np.meshgrid(np.arange(many + 1), np.arange(many + 1), indexing="ij")
    on_wall = (x % steps == 0) | (y % steps == 0)
    number = np.where(on_wall, np.cumsum(on_wall).reshape(x.shape) - 1, -1)
    pairs = [
        np.column_stack([one[(one >= 0) & (two >= 0) & wall], two[(one >= 0) & (two >= 0) & wall]])
        for one, two, wall in (
            (number[:-1], number[1:], y[:-1] % steps == 0),
            (number[:, :-1], number[:, 1:], x[:, :-1] % steps == 0),
        )
    ]
    edges = np.concatenate(pairs)
    loop = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    z = (x + 1j * y)[on_wall] / many
    arguments = z, edges, np.ones(len(edges)), loop, np.arange(0, len(loop), steps)
    return seconds_of(natural_boundary, *arguments) / (side**4 * len(z))


class TimedExecutor(LocalExecutor):
    """Runs tasks serially and keeps what each took, whichever instance runs them; sizes of patches are filled in afterwards."""

    samples: ClassVar[list[Sample]] = []
    looks_at_memory: ClassVar[bool] = False

    def __init__(self, progress: Progress = silent, _at_once: int | None = None) -> None:
        super().__init__(progress, 1)
        self._inside: dict[int, int] = {}

    def _timed(self, stage: str, function: Callable[[Any], Any], name: int, after: tuple[int, ...]) -> Callable[[Any], Any]:
        def run(item: Any) -> Any:
            before = 0
            if self.looks_at_memory:
                forget_peak()
                before = resident_bytes("VmRSS")
            start = time.perf_counter()
            with limited_to(1):
                result = function(item)
            seconds = time.perf_counter() - start
            grown = resident_bytes("VmHWM") - before if self.looks_at_memory else 0
            sizes, size = self._sizes(stage, after, name, item, result), 0.0 if stage == "prepare" else array_bytes(result)
            self.samples.append(Sample(stage, name, sizes, seconds, grown, after, size))
            return result

        return run

    def _sizes(self, stage: str, after: tuple[int, ...], name: int, item: Any, result: Any) -> Sizes:
        if stage == "weld" and after:
            self._inside[name] = sum(self._inside.get(part, 1) for part in after)
            return union_sizes(*item, result, self._inside[name])
        if stage == "prepare":
            return {"patch": item}
        return (
            {"patch": result.patch, "points": len(result.z)} if stage == "flatten" else {"patch": getattr(result, "patch", 0)}
        )

    def map(self, stage: str, function: Any, items: Any, *more: Any, **options: Any) -> list[Any]:
        """See Executor. Patches are prepared, as by idle workers, before they are solved."""
        turns = itertools.count()

        def run(item: Any) -> Any:
            turn = next(turns)
            if getattr(function, "func", None) is solve_task:
                self._timed("prepare", functools.partial(prepare_task, function.args[0]), turn, ())(item[0])
            return self._timed(stage, function, turn, ())(item)

        return super().map(stage, run, items, *more, **options)

    def join(self, joining: Joining) -> dict[int, Any]:
        """See Executor."""
        joining.waiting = [
            j._replace(function=self._timed(joining.stage, j.function, j.result, (j.left, j.right))) for j in joining.waiting
        ]
        return super().join(joining)


def limit_threads() -> None:
    """What the executor does before a task: on workers a part of the overhead of a task."""
    with threadpool_limits(1):
        pass


def trace(mesh: pgcp.Mesh, patches: int, target: str, looks_at_memory: bool = False) -> Trace | None:
    """Map once, serially, and keep what every task took; None where it needed more than one attempt."""
    before, pipeline.LocalExecutor = pipeline.LocalExecutor, TimedExecutor
    TimedExecutor.looks_at_memory, TimedExecutor.samples = looks_at_memory, []
    start = time.perf_counter()
    try:
        result = pgcp.compute(mesh, pgcp.Options(patches=patches, target=target))
    finally:
        pipeline.LocalExecutor = before
    wall = time.perf_counter() - start
    if result.report["retries"] or len(result.report["patches"]) != patches:
        return None
    rows, samples = result.report["patches"], TimedExecutor.samples
    for sample in samples:
        if "patch" in sample.sizes:
            row = rows[sample.sizes["patch"]]
            sample.sizes.update(n=row["vertices"], b=row["boundary"])
    stages = stage_seconds(result.report)
    driver = {name: seconds for name, seconds in stages.items() if name not in PARALLEL}
    around = sum(stages.get(name, 0.0) for name in PARALLEL) - sum(sample.seconds for sample in samples)
    driver["around tasks"] = max(around - len(samples) * seconds_of(limit_threads), 0.0)
    driver["between stages"] = wall - sum(stages.values())
    return Trace(len(mesh.vertices), patches, samples, driver)


def middle(traces: Sequence[Trace], memory: Trace) -> Trace:
    """Of equal runs the medians of all seconds; memory of another."""
    samples = []
    for same, heavy in zip(zip(*(t.samples for t in traces), strict=True), memory.samples, strict=True):
        one = same[0]
        seconds = median(sample.seconds for sample in same)
        samples.append(Sample(one.stage, one.name, one.sizes, seconds, heavy.memory_bytes, one.after, one.result_bytes))
    driver = {name: median(t.driver.get(name, 0.0) for t in traces) for name in traces[0].driver}
    return Trace(traces[0].vertices, traces[0].patches, samples, driver)


def measure(path: Path, counts: Sequence[int], target: str, repeat: int) -> list[Trace]:
    """Traces of one mesh; numbers of patches that it is too small for, or that need several attempts, are left out."""
    start = time.perf_counter()
    mesh, out = pgcp.read_mesh(path), []
    read_s = time.perf_counter() - start
    for patches in (k for k in counts if 2 <= k <= len(mesh.faces) // 100):
        runs = [trace(mesh, patches, target, looks_at_memory) for looks_at_memory in [True] + repeat * [False]]
        good = [run for run in runs if run is not None]
        if len(good) == len(runs):
            out.append(middle(good[1:], good[0]))
            out[-1].driver["read"] = read_s
    if not out:
        raise SystemExit(f"{path}: no number of patches could be mapped at the first attempt")
    return out


# -------------------------------------------------------------------------------------------------------------------- the model


@dataclass(frozen=True, slots=True)
class Model:
    """All that has been fitted: factors by kind and driver stage; boundary edges by sqrt(n), points added to a patch's edges.

    spread: sizes of patches relative to their mean; bytes of a process that has mapped next to nothing, and of the driver
    per vertex.
    """

    factors: dict[str, np.ndarray]
    driver: dict[str, np.ndarray]
    boundary: float
    extra_points: float
    spread: np.ndarray
    base_bytes: float
    driver_bytes: float

    def of(self, kind: str, sizes: Sizes) -> Any:
        """Value of a fit."""
        return evaluate(kind, self.factors[kind], sizes)


def edge_parts(edges: float) -> int:
    """Into how many parts every edge of the seams is cut, away from their ends."""
    return int(np.clip(_POINTS // edges, 1, _MOST_PARTS))


def gathered(samples: Iterable[Sample]) -> Sizes:
    """Sizes of samples as arrays."""
    rows = [sample.sizes for sample in samples]
    return {name: np.array([row[name] for row in rows], float) for name in rows[0]} if rows else {}


def fit_model(traces: Sequence[Trace], base_bytes: float, driver_bytes: float) -> Model:
    """Fit all there is to fit."""
    pools = {stage: [s for t in traces for s in t.of(stage)] for stage in ("flatten", "weld", "prepare", "solve")}
    pools["weld"] = [s for s in pools["weld"] if s.after]
    least = {"weld": (0.0, 0.0, zipper_seconds(), 0.0, 0.0, cycle_seconds())}
    factors = {
        stage: fit_terms(stage, gathered(pool), [s.seconds for s in pool], least=least.get(stage, ()))
        for stage, pool in pools.items()
    }
    for kind, stage, value in (
        ("flatten bytes", "flatten", lambda s: s.memory_bytes),
        ("weld bytes", "weld", lambda s: s.memory_bytes), ("union bytes", "weld", lambda s: s.result_bytes),
    ):  # fmt: skip
        factors[kind] = fit_terms(kind, gathered(pools[stage]), [value(s) for s in pools[stage]], relative=False)
    runs = {"V": np.array([t.vertices for t in traces], float), "K": np.array([t.patches for t in traces], float)}
    driver = {
        name: fit_terms(driver_kind(name), runs, [max(t.driver.get(name, 0.0), 0.0) for t in traces], relative=False)
        for name in dict.fromkeys(name for t in traces for name in t.driver)
    }
    sizes = gathered(pools["flatten"])
    extra = []
    for t in traces:
        own = gathered(t.of("flatten"))
        extra.append((own["points"].sum() - edge_parts(own["b"].sum() / 2) * own["b"].sum()) / t.patches)
    largest = gathered(max(traces, key=lambda t: t.patches).of("flatten"))["n"]
    boundary = float(np.median(sizes["b"] / np.sqrt(sizes["n"])))
    return Model(
        factors, driver, boundary, max(float(np.median(extra)), 0.0), largest / largest.mean(), base_bytes, driver_bytes
    )


def driver_kind(name: str) -> str:
    """The terms of a stage of the driver."""
    return name if name in TERMS else "driver"


@dataclass(frozen=True, slots=True)
class Tree:
    """Welds in an order in which they can be done: (left, right, result, seam). Lengths are in mean perimeters of a patch."""

    perimeters: tuple[float, ...]
    steps: tuple[tuple[int, int, int, float], ...]


def square(side: int) -> pgcp.Mesh:
    """A flat square of side x side cells, its vertices moved about so that no two lengths are the same."""
    x, y = np.meshgrid(np.arange(side + 1.0), np.arange(side + 1.0), indexing="ij")
    shift = np.random.default_rng(0).uniform(-0.2, 0.2, (2, x.size))
    points = np.column_stack([x.ravel() + shift[0], y.ravel() + shift[1], np.zeros(x.size)])
    i, j = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    a = (i * (side + 1) + j).ravel()
    b, c, d = a + side + 1, a + side + 2, a + 1
    return pgcp.Mesh(points, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]))


@functools.cache
def planned(count: int) -> Tree:
    """The tree that the package plans for a flat square in so many parts."""
    if count == 1:
        return Tree((1.0,), ())
    mesh = square(int(np.sqrt(_PART_VERTICES * count)))
    topology = examine(mesh.faces, len(mesh.vertices))
    split = split_mesh(mesh, topology, count)
    lengths = np.array([len(patch.boundary) for patch in cut_patches(mesh, topology, split)], float)
    steps = sorted(plan_welds(split.table, count).steps, key=lambda step: step.level)
    seams = [(step.left, step.right, step.result, step.seam_edge_count / lengths.mean()) for step in steps]
    return Tree(tuple(lengths / lengths.mean()), tuple(seams))


def weld_tree(count: int) -> Tree:
    """The tree for any number of patches: beyond what is planned every part is halved until there are enough."""
    top = planned(min(count, PLANNED))
    parts = len(top.perimeters)
    sizes = [count // parts + (k < count % parts) for k in range(parts)]
    grown = np.sqrt(count / parts)
    names, steps = iter(range(count, 2 * count)), []
    perimeters = []
    now = {}  # part or union of the planned tree -> its number here
    for k, size in enumerate(sizes):
        first = len(perimeters)
        perimeters += size * [top.perimeters[k]]
        now[k] = halved(first, size, names, steps)
    for left, right, result, seam in top.steps:
        now[result] = next(names)
        steps.append((now[left], now[right], now[result], seam * grown))
    return Tree(tuple(perimeters), tuple(steps))


def halved(first: int, size: int, names: Any, steps: list[tuple[int, int, int, float]]) -> int:
    """Add the welds of patches first, first + 1, ... by halves, round unions; returns the union's number."""
    if size == 1:
        return first
    low = size // 2
    left, right = halved(first, low, names, steps), halved(first + low, size - low, names, steps)
    result = next(names)
    steps.append((left, right, result, 0.5 * (np.sqrt(low) + np.sqrt(size - low) - np.sqrt(size))))
    return result


def weld_tasks(model: Model, tree: Tree, edges: float, points: float) -> tuple[list[Task], list[Sizes]]:
    """Tasks of a tree of welds whose patches have so many boundary edges and points, and the sizes of their unions."""
    loop = {k: points * p for k, p in enumerate(tree.perimeters)}
    nodes, inside = dict(loop), dict.fromkeys(loop, 1)
    bytes_of = {k: float(model.of("union bytes", {"n": n})) for k, n in nodes.items()}
    jobs, sizes = [], []
    for left, right, result, share in tree.steps:
        seam = min(points * share, loop[left], loop[right])
        nodes[result] = nodes[left] + nodes[right] - seam
        loop[result] = max(loop[left] + loop[right] - 2 * seam, 1.0)
        inside[result] = inside[left] + inside[right]
        corners = max(loop[result] * edges / points, 1.0)
        sizes.append({"n": nodes[result], "s": seam, "p": panels(corners), "c": inside[result]})
        bytes_of[result] = float(model.of("union bytes", sizes[-1]))
        in_bytes = bytes_of[left] + bytes_of[right]
        seconds = float(model.of("weld", sizes[-1]))
        jobs.append(Task(result, seconds, (left, right), in_bytes=in_bytes, out_bytes=bytes_of[result], rank=-1.0))
    return jobs, sizes


@dataclass(frozen=True, slots=True)
class Prediction:
    """Seconds by part, and memory, of one run."""

    vertices: float
    patches: int
    workers: int
    driver: dict[str, float]
    flatten_s: float
    weld_s: float
    solve_s: float
    last_weld_s: float
    worker_bytes: float
    driver_bytes: float

    @property
    def serial_s(self) -> float:
        """Seconds of the driver's own work."""
        return sum(self.driver.values())

    @property
    def parallel_s(self) -> float:
        """Seconds of the parallel stages."""
        return self.flatten_s + self.weld_s + self.solve_s

    @property
    def total_s(self) -> float:
        """Seconds of the whole run."""
        return self.serial_s + self.parallel_s

    @property
    def dominant(self) -> str:
        """The part that takes longest and its share of the whole."""
        stage, most = max(self.driver.items(), key=lambda item: item[1])
        parts = {f"driver, most of it {stage}" if most > 0.5 * self.serial_s else "driver": self.serial_s}
        parts |= {"flatten": self.flatten_s, "solve": self.solve_s}
        share = self.last_weld_s / self.weld_s if self.weld_s else 0.0
        parts[f"welds, the last one {share:.0%} of them"] = self.weld_s
        name = max(parts, key=lambda part: parts[part])
        return f"{parts[name] / self.total_s:.0%} {name}"


def default_patches(vertices: float, workers: int) -> int:
    """How many patches a run is taken to have."""
    return make_plan(int(vertices), 2 * int(vertices), workers).patches


def predict(model: Model, vertices: float, patches: int, workers: int, network: Network) -> Prediction:
    """Predict one run."""
    n = vertices / patches * np.resize(model.spread, patches)
    mean = vertices / patches
    b = model.boundary * np.sqrt(n)
    edges = model.boundary * np.sqrt(mean)
    points = edge_parts(patches * edges / 2) * edges + model.extra_points
    flatten = model.of("flatten", {"n": n, "b": b})
    prepare, solve = (model.of(kind, {"n": n}) for kind in ("prepare", "solve"))
    tree = weld_tree(patches)
    depth = depth_of(range(patches), (step[:3] for step in tree.steps))
    first = [Task(k, t, (), _PATCH_BYTES * n[k], 0.0, 16.0 * points, depth[k]) for k, t in enumerate(flatten)]
    ahead = [Task(k, t, (), _PATCH_BYTES * n[k]) for k, t in enumerate(prepare)]
    last = [Task(k, t, (), (_PATCH_BYTES + _MAP_BYTES) * n[k], 16.0 * b[k], 100.0) for k, t in enumerate(solve)]
    welds, unions = weld_tasks(model, tree, edges, points)
    seconds = passes(first, welds, ahead, last, workers, network)
    weld_bytes = max((float(model.of("weld bytes", sizes)) for sizes in unions), default=0.0)
    work = max(float(model.of("flatten bytes", {"n": mean, "b": edges})), weld_bytes)
    union = float(model.of("union bytes", unions[-1])) if unions else 0.0
    driver = {name: float(evaluate(driver_kind(name), f, {"V": vertices, "K": patches})) for name, f in model.driver.items()}
    return Prediction(
        vertices, patches, workers, driver, *seconds, welds[-1].seconds if welds else 0.0,
        model.base_bytes + work,
        model.base_bytes + model.driver_bytes * vertices + 2 * union,
    )  # fmt: skip


# ------------------------------------------------------------------------------------------------------- validation and output


def replay(run: Trace, workers: int, network: Network) -> tuple[float, float]:
    """Seconds of the parallel stages, and of the whole, when measured tasks run on so many workers."""
    flatten = [Task(s.sizes["patch"], s.seconds) for s in run.of("flatten")]
    welds = [Task(s.name, s.seconds, s.after, rank=-1.0) for s in run.of("weld") if s.after]
    prepare, solve = ([Task(s.sizes["patch"], s.seconds) for s in run.of(stage)] for stage in ("prepare", "solve"))
    parallel = sum(passes(flatten, welds, prepare, solve, workers, network))
    return parallel, parallel + sum(run.driver.values())


def validation(path: Path, run: Trace, model: Model, target: str, repeat: int, network: Network) -> list[list[str]]:
    """Real runs on 1 and 2 started workers, the measured tasks replayed, and the model; errors in percent."""
    rows = [["workers", "what", "real_s", "replay_s", "error", "model_s", "error"]]
    local = Network(network.overhead_s)
    for workers in (1, 2):
        (real,) = measure_started(path, [run.patches], workers, target, repeat)
        replayed = replay(run, workers, local)
        guess = predict(model, run.vertices, run.patches, workers, local)
        lines = ("parallel stages", real.parallel_s, guess.parallel_s), ("whole run", real.seconds, guess.total_s)
        for (what, seconds, modelled), again in zip(lines, replayed, strict=True):
            errors = [f"{100 * (x / seconds - 1):+.0f}%" for x in (again, modelled)]
            rows.append([str(workers), what, f"{seconds:.2f}", f"{again:.2f}", errors[0], f"{modelled:.2f}", errors[1]])
    return rows


def table(predictions: Sequence[Prediction]) -> list[list[str]]:
    """A row per prediction; speedup is over the least number of workers for the same mesh."""
    heads = ["vertices", "patches", "workers", "driver_s", "flatten_s", "weld_s", "solve_s", "total_s", "speedup", "efficiency"]
    rows = [[*heads, "worker_gb", "driver_gb", "most of it"]]
    for p in predictions:
        base = min((q for q in predictions if q.vertices == p.vertices), key=lambda q: q.workers)
        gain = base.total_s / p.total_s
        seconds = [f"{x:.1f}" for x in (p.serial_s, p.flatten_s, p.weld_s, p.solve_s, p.total_s)]
        gains = [f"{gain:.2f}", f"{gain * base.workers / p.workers:.3f}"]
        memory = [f"{p.worker_bytes / 1e9:.1f}", f"{p.driver_bytes / 1e9:.1f}"]
        rows.append([f"{p.vertices:.0f}", str(p.patches), str(p.workers), *seconds, *gains, *memory, p.dominant])
    return rows


def bounds(predictions: Sequence[Prediction]) -> list[str]:
    """What no number of workers can improve on (Amdahl): a sentence per mesh size."""
    out = []
    for vertices in dict.fromkeys(p.vertices for p in predictions):
        own = [p for p in predictions if p.vertices == vertices]
        one, best = own[0], min(own, key=lambda p: p.total_s)
        share = (one.serial_s + one.last_weld_s) / one.total_s
        out.append(
            f"{vertices:.0f} vertices: the driver's own work and the last weld are {share:.0%} of the run on {one.workers} "
            f"workers, which bounds the speedup by {1 / share:.1f}; best is {one.total_s / best.total_s:.1f}, on {best.workers}"
        )
    return out


def draw(predictions: Sequence[Prediction], path: Path) -> None:
    """Total seconds by workers, and the parts of the largest mesh."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.5), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2)
    for vertices in dict.fromkeys(p.vertices for p in predictions):
        own = [p for p in predictions if p.vertices == vertices]
        workers = np.array([p.workers for p in own], float)
        (line,) = left.loglog(workers, [p.total_s for p in own], "o-", markersize=3, label=f"{vertices:.0e} vertices")
        left.loglog(workers, own[0].total_s * workers[0] / workers, ":", linewidth=0.8, color=line.get_color())
    left.set_xlabel("workers (dotted: ideal)")
    left.set_ylabel("seconds")
    left.legend(fontsize=8)
    largest = max(p.vertices for p in predictions)
    own = [p for p in predictions if p.vertices == largest]
    floor = np.zeros(len(own))
    for name in ("serial", "flatten", "weld", "solve"):
        share = np.array([getattr(p, f"{name}_s") / p.total_s for p in own])
        right.bar(range(len(own)), share, bottom=floor, label="driver" if name == "serial" else name)
        floor += share
    right.set_xticks(range(len(own)), [str(p.workers) for p in own])
    right.set_xlabel(f"workers, {largest:.0e} vertices")
    right.set_ylabel("share of the run")
    right.legend(fontsize=8)
    figure.savefig(path)


def process_bytes(path: Path, target: str, vertices: int) -> tuple[float, float]:
    """Bytes of a process that has mapped next to nothing, and bytes per vertex that the driver of one worker needs more."""
    small = warm_up({"workers": 1}).root_peak_bytes
    whole, report, _ = run_pgcp(path, {"workers": 1, "target": target})
    if report is None:
        raise SystemExit(f"{path}: {whole.errors.strip()}")
    return float(small), max(whole.root_peak_bytes - small, 0) / vertices


def parsed(words: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+", type=Path)
    parser.add_argument("--patches", type=numbers, default=numbers("6,24,64,128"))
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--target", default="auto")
    parser.add_argument("--validate", type=int, default=DEFAULT_PATCHES, metavar="K")
    parser.add_argument("--vertices", default="1e6,1e7,1e8,1e9")
    parser.add_argument("--workers", type=numbers, default=[2**k for k in range(11)])
    parser.add_argument("--task-overhead-ms", type=float, default=5.0)
    parser.add_argument("--latency-ms", type=float, default=0.5)
    parser.add_argument("--bandwidth-gbit", type=float, default=10.0)
    parser.add_argument("--output-dir", type=Path, default=Path())
    return parser.parse_args(words)


def main() -> None:
    arguments = parsed()
    network = Network(arguments.task_overhead_ms / 1e3, arguments.latency_ms / 1e3, arguments.bandwidth_gbit * 1e9 / 8)
    counts = sorted({*arguments.patches, *([arguments.validate] if arguments.validate else [])})
    first, target = arguments.meshes[0], arguments.target
    trace(pgcp.read_mesh(first), counts[0], target)  # compiles what has to be
    by_mesh = [measure(path, counts, target, arguments.repeat) for path in arguments.meshes]
    model = fit_model([t for traces in by_mesh for t in traces], *process_bytes(first, target, by_mesh[0][0].vertices))
    print("fitted to " + ", ".join(f"{t.vertices} vertices in {t.patches}" for traces in by_mesh for t in traces))
    for kind, factors in (model.factors | model.driver).items():
        print(f"  {kind}: " + " ".join(f"{x:.2e}" for x in factors))
    run = next((t for t in by_mesh[0] if t.patches == arguments.validate), None)
    if run is not None:
        print(aligned(validation(first, run, model, target, arguments.repeat, network)))
    predictions = [
        predict(model, v, default_patches(v, w), w, network)
        for v in map(float, arguments.vertices.split(","))
        for w in arguments.workers
    ]
    rows = table(predictions)
    print(aligned(rows))
    print("\n".join(bounds(predictions)))
    arguments.output_dir.mkdir(parents=True, exist_ok=True)
    (arguments.output_dir / "scaling.tsv").write_text("".join("\t".join(row) + "\n" for row in rows))
    draw(predictions, arguments.output_dir / "scaling.png")


if __name__ == "__main__":
    main()
