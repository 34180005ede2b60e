"""One run: what is mapped and on what, its stored patches, a finished pass through them, and where its time went."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import Any, TypeVar

import numpy as np

from pgcp.assemble import collect
from pgcp.errors import LostFileError
from pgcp.executors import Executor, Joining, LocalExecutor, ignore
from pgcp.options import Options
from pgcp.parallel import at_once
from pgcp.split import Split, cut_patch, cut_patches, faces_by_label, split_mesh, vertices_of
from pgcp.store import PatchStore
from pgcp.tasks import Job, SolveReport
from pgcp.topology import Topology
from pgcp.types import (
    ComplexArray,
    Component,
    IntArray,
    Mesh,
    PatchMap,
    PatchOutline,
    Positions,
    SeamPositions,
    WeldPlan,
)

Item = TypeVar("Item")
Record = TypeVar("Record")
_MOST_LOSSES = 5
_AT_ONCE = 2  # patches stored or read at the same time: each needs memory for every vertex


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


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One mesh to be mapped, and all that is known of it."""

    mesh: Mesh
    topology: Topology
    target: str
    mollification: float
    options: Options
    patch_count: int
    job: Job
    executor: Executor
    clock: Clock

    @property
    def boundary(self) -> IntArray:
        """The outer boundary, none where the surface is closed."""
        return self.topology.loops[0] if self.topology.loops else np.empty(0, np.int64)

    @property
    def exact_first(self) -> bool:
        """Whether seams are to be solved exactly rather than welded: on request, and for a closed surface in one piece."""
        return self.options.seams == "exact" or (self.options.patches == 1 and not self.topology.loops)

    @property
    def fewest_patches(self) -> int:
        """The least number of patches there can be."""
        return 1 if self.topology.loops else 2


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """The patches of one split, in the job's store."""

    split: Split
    patches: list[PatchOutline]
    job: Job
    seed: int

    @property
    def store(self) -> PatchStore:
        """Where they lie."""
        return PatchStore(self.job.directory)

    def has(self, kind: str, index: int) -> bool:
        """Whether a record is there; a curve only with the operator that is stored before it, where the job stores them."""
        if kind == "curve" and self.job.stores_operators and not self.store.has_array("operator", index):
            return False
        return self.store.has(kind, index)


@dataclass(frozen=True, slots=True, eq=False)
class Mapped:
    """One pass through all patches: positions, and mu (F,) of the patches as they were solved.

    pieces: how many pieces each patch was flattened in; plan, order and union: the welds, what a long seam costs in them,
    and what they made, None without welds; interface: the record of seams that were solved exactly; iterations: that of a
    descent, and whether it converged.
    """

    parts: Parts
    target: str
    pieces: list[int]
    solved: list[SolveReport]
    seams: SeamPositions
    points: Positions
    mu: ComplexArray
    plan: WeldPlan | None = None
    order: float = 0.0
    union: Component | None = None
    welds: tuple[dict[str, int], ...] = ()
    interface: dict[str, Any] | None = None
    iterations: tuple[dict[str, Any], ...] = ()
    converged: bool | None = None

    @property
    def seams_by(self) -> str | None:
        """How seams were treated: weld, relax or exact; None where there are none."""
        if self.union is None:
            return None if self.interface is None else "exact"
        return "weld" if self.interface is None else "relax"


def store_parts(run: Run, count: int, seed: int, cuts: IntArray | None, name: str) -> Parts:
    """Split the mesh and store its patches, in a directory of their own of that name, which may be there from before."""
    job = replace(run.job, run=f"{run.job.run}-{name}", directory=run.job.directory / name)
    job.directory.mkdir(exist_ok=True)
    with run.clock.stage("split"):
        split = split_mesh(run.mesh, run.topology, count, seed, cuts, run.options.repair_cuts, run.mollification)
    store = PatchStore(job.directory)

    def stored(wanted: range) -> list[PatchOutline]:
        """Outlines of patches that are in the store then."""
        outlines = []
        for patch in cut_patches(run.mesh, run.topology, split, wanted):
            if not store.has("patch", patch.index):
                store.write_patch(patch)
            ids = patch.vertex_ids[patch.boundary]
            outlines.append(PatchOutline(patch.index, len(patch.vertices), len(patch.faces), ids))
        return outlines

    with run.clock.stage("store"):
        shares = [range(k, split.patch_count, _AT_ONCE) for k in range(_AT_ONCE)]
        outlines = chain.from_iterable(at_once(*(partial(stored, share) for share in shares)))
    return Parts(split, sorted(outlines, key=lambda outline: outline.index), job, seed)


def discard(parts: Parts) -> None:
    """Remove the files of a split that is done with, but for curves and unions: they are small, and dear."""
    for path in parts.job.directory.iterdir():
        if not path.name.startswith(("curve", "union")):
            path.unlink(missing_ok=True)


def restored(run: Run, parts: Parts, problem: LostFileError) -> None:
    """Store patches again whose files are lost; raises the problem where it is of another kind."""
    if problem.kind != "patch":
        raise problem
    for patch in parts.patches:
        if patch.index == problem.index or not parts.store.has("patch", patch.index):
            parts.store.write_patch(cut_patch(run.mesh, run.topology, parts.split, patch.index))


def mapped_through_store(
    run: Run,
    parts: Parts,
    stage: str,
    kind: str,
    record: type[Record],
    task: Callable[[Item], Record],
    items: dict[int, Item],
    order: Callable[[int], Any] | None = None,
    each: Callable[[Record], None] = ignore,
    beside: Joining | None = None,
) -> list[Record]:
    """Apply a task to an item for every patch, but where its record of that kind is in the store already.

    Patches that are missing there are stored again: each once, and a few once more. They run by ``order`` of the patch, or
    the largest first; ``each`` is called with every record, more than once where files were lost; for joins ``beside`` see
    Executor.
    """
    order = order or (lambda index: -parts.patches[index].vertex_count)
    found: dict[int, Record] = {}
    losses = 0
    while True:
        for index in items:
            if index not in found and parts.has(kind, index):
                before = parts.store.find(kind, index, record)
                if before is not None:
                    found[index] = before
                    each(before)
        left = sorted((index for index in items if index not in found), key=order)
        try:
            wanted, keeps = [items[index] for index in left], parts.job.stores_operators
            results = run.executor.map(stage, task, wanted, left, len(found), each, beside, keeps)
        except LostFileError as problem:
            losses += 1
            if losses == len(items) + _MOST_LOSSES:
                raise
            restored(run, parts, problem)
            continue
        found |= dict(zip(left, results, strict=True))
        return [found[index] for index in items]


def gathered(run: Run, parts: Parts, target: str, name: str = "") -> tuple[Positions, ComplexArray]:
    """Positions of all vertices and mu (F,) from the stored maps of the patches, those of that name."""
    order, starts = faces_by_label(parts.split.labels, parts.split.patch_count)

    def maps(some: Sequence[PatchOutline]) -> Iterator[tuple[IntArray, IntArray, PatchMap]]:
        """Patch by patch."""
        marks = np.zeros(len(run.mesh.vertices), np.bool_)
        for outline in some:
            face_ids = order[starts[outline.index] : starts[outline.index + 1]]
            yield vertices_of(run.mesh.faces, face_ids, marks), face_ids, parts.store.read_map(outline.index, name)

    return collect(run.mesh, [maps(parts.patches[k::_AT_ONCE]) for k in range(_AT_ONCE)], target)


def spread_out(seams: SeamPositions, vertex_count: int) -> Positions:
    """Positions of all seam and boundary vertices in an array over all vertices, complex (V,) or (V, 3)."""
    out = np.zeros((vertex_count, *seams.points.shape[1:]), seams.points.dtype)
    out[seams.vertex_ids] = seams.points
    return out
