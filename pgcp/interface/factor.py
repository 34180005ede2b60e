"""The whole mesh's Laplacian, eliminated patch by patch on an executor: the seams solved exactly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import groupby
from typing import Any, TypeVar

import numpy as np

from pgcp.interface.merge import Merge, plan_merges
from pgcp.interface.puncture import Charts
from pgcp.interface.tasks import (
    Load,
    alternate_task,
    eliminate_task,
    extend_inside_task,
    extend_task,
    flatten_opened_task,
    flatten_whole_task,
    is_merged,
    merge_task,
    pack_load,
    reduce_inside_task,
    reduce_task,
    release_task,
    solve_inside_task,
    solve_load_task,
)
from pgcp.patches.types import PatchMap, SolveReport, WeldPlan
from pgcp.runtime.executors import Executor, Tasks
from pgcp.runtime.job import Job
from pgcp.runtime.made import digest_of
from pgcp.runtime.store import PatchStore
from pgcp.types import ComplexArray, FloatArray, IntArray, Positions

Result = TypeVar("Result")


class InterfaceFactor:
    """A DirichletFactor of the whole mesh: all vertices but ``kept`` (n_K,) eliminated, patch by patch and seam by seam.

    Operators lie in the job's store; only ids and values on boundaries and seams pass through the executor. ``levels``
    records for each level of the tree, the patches first, the merges, vertices eliminated, bytes stored and operations.
    """

    def __init__(
        self, executor: Executor, job: Job, patch_count: int, plan: WeldPlan, kept: IntArray, vertex_count: int
    ) -> None:
        self._executor, self._job, self._store = executor, job, PatchStore(job.directory)
        self._patches, self._kept, self._vertex_count = range(patch_count), kept, vertex_count
        self._local, self._ids, self._inner = [], [], 0
        for index in self._patches:
            vertex_ids, boundary = (self._store.read_field("patch", index, name) for name in ("vertex_ids", "boundary"))
            local = _kept_in(vertex_ids, boundary, kept)
            self._local.append(local)
            self._ids.append(vertex_ids[local])
            self._inner += len(vertex_ids) - len(local)
        self._merges = plan_merges(plan, self._ids, kept)
        self._root = self._merges[-1].result if self._merges else 0
        self._digests = _digests(self._merges, self._local)
        self._wanted, self._left = self._what_is_left()
        self.levels: list[dict[str, int]] = []

    def _what_is_left(self) -> tuple[set[int], list[Merge]]:
        """Patches whose operators are needed, and merges to be done: all, or what a run before this has not finished."""
        wanted, left = {self._root}, []
        for merge in reversed(self._merges):
            if not is_merged(self._store, merge, self._digests[merge.result], merge.result in wanted):
                left.append(merge)
                wanted |= {merge.left, merge.right}
        return wanted & set(self._patches), left[::-1]

    def _map(
        self, stage: str, task: Callable[[Job, Any], Result], items: Sequence[Any], places: Sequence[int] | None = None
    ) -> list[Result]:
        """Do a task of the job for every item."""
        return self._executor.map(Tasks(stage, partial(task, self._job), items, places))

    def _vertex_ids(self, patch: int) -> IntArray:
        ids: IntArray = self._store.read_field("patch", patch, "vertex_ids")
        return ids

    def eliminate_patches(self) -> None:
        """Eliminate the interiors of the patches whose operators are needed, where the flattening does not store them."""
        wanted = sorted(self._wanted)
        items = [(patch, self._local[patch]) for patch in wanted]
        self._map("eliminate", eliminate_task, items, wanted)

    def merge(self) -> None:
        """Eliminate the seams, level by level up the tree."""
        stored = sum(8 * len(ids) ** 2 for ids in self._ids)
        self.levels = [{"level": 0, "operators": len(self._ids), "eliminated": self._inner, "bytes": stored}]
        left = {merge.result for merge in self._left}
        for level, merges in _by_level(self._merges):
            items = [(merge, self._digests[merge.result]) for merge in merges if merge.result in left]
            self._map(f"merge {level}", merge_task, items)
            for merge in merges:
                for index in (merge.left, merge.right):
                    # those that the flattening has stored may be merged again in another order
                    if index >= len(self._ids) or not self._job.stores_operators:
                        self._store.drop_array("operator", index)
            counts = {
                "eliminated": sum(len(m.eliminated) for m in merges),
                "bytes": sum(m.nbytes for m in merges),
                "flops": sum(m.flops for m in merges),
            }
            self.levels.append({"level": level, "operators": len(merges), **counts})

    @property
    def schur(self) -> FloatArray:
        """Schur complement of the whole mesh's Laplacian on the kept vertices (n_K, n_K)."""
        return np.array(self._store.read_array("operator", self._root))

    @property
    def nbytes(self) -> int:
        """Bytes on disk of what is kept for extensions, and of the Schur complement."""
        inside = sum(len(m.eliminated) * (len(m.kept) + len(m.eliminated)) for m in self._merges)
        return 8 * (len(self._kept) ** 2 + inside)

    def free_boundary(self, positions: FloatArray) -> ComplexArray:
        """Free conformal positions z (n_K,) of the kept vertices, a disk's boundary; positions (n_K, 3) on the surface."""
        (z,) = self._map("flatten", flatten_whole_task, [(self._root, positions)])
        return z

    def opened_positions(self) -> ComplexArray:
        """Planar positions z (n_K,) of the kept vertices of an opened surface."""
        (z,) = self._map("flatten", flatten_opened_task, [self._root])
        return z

    def alternated(self, charts: Charts) -> Charts:
        """Kept vertices of an opened surface, harmonic in two charts."""
        (solved,) = self._map("alternate", alternate_task, [(self._root, charts)])
        return solved

    def extend_seams(self, values: Positions) -> Positions:
        """Values at kept and seam vertices in an array over all vertices (V, ...), from those at the kept ones (n_K, ...)."""
        out = np.zeros((self._vertex_count, *values.shape[1:]), values.dtype)
        out[self._kept] = values
        for level, merges in reversed(_by_level(self._merges)):
            items = [(merge.result, out[merge.kept]) for merge in merges]
            inside = self._map(f"extend {level}", extend_inside_task, items)
            for merge, part in zip(merges, inside, strict=True):
                out[merge.eliminated] = part
        return out

    def extend_patches(self, positions: ComplexArray) -> list[SolveReport]:
        """Extend values at kept and seam vertices, given in an array (V,), into every patch; the maps go to the store."""
        items = [(p, local, positions[ids]) for p, local, ids in zip(self._patches, self._local, self._ids, strict=True)]
        return self._map("solve", extend_task, items)

    def extend(self, boundary_values: ComplexArray) -> ComplexArray:
        """Values (V,) of the discrete harmonic function of the whole mesh with the given values at kept vertices (n_K,)."""
        out = self.extend_seams(np.asarray(boundary_values, np.complex128))
        for report in self.extend_patches(out):
            out[self._vertex_ids(report.patch)] = self._store.read("map", report.patch, PatchMap).points
        return out

    def _within(self, load: ComplexArray) -> list[Load]:
        """The part of a load (V,) that lies in the interior of each patch, in its local numbers."""
        parts = []
        for patch, local in zip(self._patches, self._local, strict=True):
            own = np.asarray(load[self._vertex_ids(patch)], np.complex128)
            own[local] = 0.0
            parts.append(pack_load(own))
        return parts

    def _reduced(self, load: ComplexArray) -> ComplexArray:
        """Load (V,) on kept and seam vertices, each with what those eliminated before it pass on; 0 elsewhere."""
        out = np.zeros(self._vertex_count, np.complex128)
        for ids in self._ids:
            out[ids] = load[ids]
        items = [(p, local, r) for p, local, r in zip(self._patches, self._local, self._within(load), strict=True)]
        for ids, part in zip(self._ids, self._map("reduce", reduce_task, items), strict=True):
            out[ids] += part
        for level, merges in _by_level(self._merges):
            passed = [(merge.result, out[merge.eliminated]) for merge in merges]
            parts = self._map(f"reduce {level}", reduce_inside_task, passed)
            for merge, part in zip(merges, parts, strict=True):
                out[merge.kept] += part
        return out

    def reduce(self, load: ComplexArray) -> ComplexArray:
        """Load (n_K,) on the kept vertices that does what a load (V,) on the whole does: S g = reduce(r) where L h = r."""
        return self._reduced(load)[self._kept]

    def solve(self, load: ComplexArray, boundary_values: ComplexArray) -> ComplexArray:
        """Values (V,) with the given ones at kept vertices (n_K,) and, at all others, the load (V,)."""
        reduced = self._reduced(load)
        out = np.zeros(self._vertex_count, np.complex128)
        out[self._kept] = boundary_values
        for level, merges in reversed(_by_level(self._merges)):
            items = [(merge.result, out[merge.kept], reduced[merge.eliminated]) for merge in merges]
            inside = self._map(f"solve {level}", solve_inside_task, items)
            for merge, part in zip(merges, inside, strict=True):
                out[merge.eliminated] = part
        tasks = [
            (p, local, r, out[ids])
            for p, local, r, ids in zip(self._patches, self._local, self._within(load), self._ids, strict=True)
        ]
        self._map("solve", solve_load_task, tasks)
        for patch in self._patches:
            out[self._vertex_ids(patch)] = self._store.read_array("values", patch)
            self._store.drop_array("values", patch)
        return out

    def release(self) -> None:
        """Remove what is stored, and free the patches' factors where they are held."""
        self._map("release", release_task, self._patches)
        self._store.drop_array("operator", self._root)
        for merge in self._merges:
            self._store.drop("merged", merge.result)
            self._store.drop_array("inside", merge.result)
            self._store.drop_array("pivot", merge.result)

    def record(self) -> dict[str, Any]:
        """What the report says of it."""
        return {"vertices": len(self._kept), "bytes": self.nbytes, "levels": self.levels}


def _kept_in(vertex_ids: IntArray, boundary: IntArray, kept: IntArray) -> IntArray:
    """Local ids of a patch's boundary, and of the kept vertices in its interior."""
    among = kept[np.isin(kept, vertex_ids)]
    local = np.searchsorted(vertex_ids, among)
    return np.concatenate([boundary, np.setdiff1d(local, boundary)])


def _by_level(merges: Sequence[Merge]) -> list[tuple[int, list[Merge]]]:
    return [(level, list(group)) for level, group in groupby(merges, key=lambda merge: merge.level)]


def _digests(merges: Sequence[Merge], local: Sequence[IntArray]) -> dict[int, str]:
    """A digest of what each union is made from: the kept vertices of its patches, and in which order they are joined."""
    out = {index: digest_of(kept) for index, kept in enumerate(local)}
    for merge in merges:
        ids = merge.left_ids, merge.right_ids, merge.kept, merge.eliminated
        out[merge.result] = digest_of(out[merge.left], out[merge.right], *ids)
    return out
