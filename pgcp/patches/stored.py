"""The patches of a split in the store, and tasks mapped over them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Any, TypeVar

import numpy as np

from pgcp.errors import LostFileError
from pgcp.parallel import at_once
from pgcp.patches.assemble import collect
from pgcp.patches.run import Run
from pgcp.patches.split import Split, cut_patch, cut_patches, faces_by_label, split_mesh, vertices_of
from pgcp.patches.types import PatchMap, PatchOutline, SeamPositions
from pgcp.plane.space import Space
from pgcp.runtime.executors import Tasks, ignore
from pgcp.runtime.job import Job
from pgcp.runtime.store import PatchStore
from pgcp.types import ComplexArray, IntArray, Positions

Item = TypeVar("Item")


Record = TypeVar("Record")


_MOST_LOSSES = 5


_AT_ONCE = 2  # patches stored or read at the same time: each needs memory for every vertex


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


def store_parts(run: Run, count: int, seed: int, cuts: IntArray | None, name: str) -> Parts:
    """Split the mesh and store its patches, in a directory of their own of that name, which may be there from before."""
    job = run.job.of_split(name)
    job.directory.mkdir(exist_ok=True)
    with run.clock.stage("split"):
        split = split_mesh(run.mesh, run.topology, count, seed, cuts, run.options.repair_cuts, run.mollification)
    store = PatchStore(job.directory)

    def stored(wanted: range) -> list[PatchOutline]:
        """Outlines of patches that are in the store then."""
        outlines = []
        for patch in cut_patches(run.mesh, run.topology, split, wanted):
            if not store.has("patch", patch.index):
                store.write("patch", patch.index, patch)
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
            parts.store.write("patch", patch.index, cut_patch(run.mesh, run.topology, parts.split, patch.index))


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
) -> list[Record]:
    """Apply a task to an item for every patch, but where its record of that kind is in the store already.

    A patch whose file is lost is stored again; after n + 5 losses among n patches the error is raised. The tasks run by
    ``order`` of the patch, or the largest first; ``each`` is called with every record, more than once where files were lost.
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
            wanted = [items[index] for index in left]
            results = run.executor.map(Tasks(stage, task, wanted, left, parts.job.stores_operators, len(found)), each)
        except LostFileError as problem:
            losses += 1
            if losses == len(items) + _MOST_LOSSES:
                raise
            restored(run, parts, problem)
            continue
        found |= dict(zip(left, results, strict=True))
        return [found[index] for index in items]


def gathered(run: Run, parts: Parts, space: Space, name: str = "") -> tuple[Positions, ComplexArray]:
    """Positions of all vertices and mu (F,) from the stored maps of the patches, those of that name."""
    order, starts = faces_by_label(parts.split.labels, parts.split.patch_count)

    def maps(some: Sequence[PatchOutline]) -> Iterator[tuple[IntArray, IntArray, PatchMap]]:
        """Patch by patch."""
        marks = np.zeros(len(run.mesh.vertices), np.bool_)
        for outline in some:
            face_ids = order[starts[outline.index] : starts[outline.index + 1]]
            yield (
                vertices_of(run.mesh.faces, face_ids, marks),
                face_ids,
                parts.store.read(f"map{name}", outline.index, PatchMap),
            )

    return collect(run.mesh, [maps(parts.patches[k::_AT_ONCE]) for k in range(_AT_ONCE)], space)


def spread_out(seams: SeamPositions, vertex_count: int) -> Positions:
    """Positions of all seam and boundary vertices in an array over all vertices, complex (V,) or (V, 3)."""
    out = np.zeros((vertex_count, *seams.points.shape[1:]), seams.points.dtype)
    out[seams.vertex_ids] = seams.points
    return out
