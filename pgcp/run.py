"""One run: what is mapped and on what, its stored patches, a finished pass through them, and where its time went."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pgcp.assemble import collect
from pgcp.executors import Executor, SerialExecutor
from pgcp.options import Options
from pgcp.split import Split, cut_patches, split_mesh
from pgcp.store import PatchStore
from pgcp.tasks import Job, SolveReport
from pgcp.topology import Topology
from pgcp.types import ComplexArray, Component, IntArray, Mesh, Patch, PatchMap, Positions, SeamPositions, WeldPlan


class Clock:
    """Seconds and peak memory of the stages run so far; ``executor`` is asked for the memory of its processes."""

    def __init__(self) -> None:
        self.stages: list[dict[str, Any]] = []
        self.executor: Executor = SerialExecutor()

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
    patches: list[Patch]
    job: Job
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class Mapped:
    """One pass through all patches: positions, and mu (F,) of the patches as they were solved.

    pieces: how many pieces each patch was flattened in; plan and union: the welds and what they made, None without welds;
    interface: the record of seams that were solved exactly; iterations: that of a descent, and whether
    it converged.
    """

    parts: Parts
    target: str
    pieces: list[int]
    solved: list[SolveReport]
    seams: SeamPositions
    points: Positions
    mu: ComplexArray
    plan: WeldPlan | None = None
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
    """Split the mesh and store its patches, in a directory of their own of that name."""
    job = replace(run.job, run=f"{run.job.run}-{name}", directory=run.job.directory / name)
    job.directory.mkdir()
    with run.clock.stage("split"):
        split = split_mesh(run.mesh, run.topology, count, seed, cuts, run.options.repair_cuts, run.mollification)
    store = PatchStore(job.directory)
    patches = []
    with run.clock.stage("store"):
        for patch in cut_patches(run.mesh, run.topology, split):
            store.write_patch(patch)
            patches.append(patch)
    return Parts(split, patches, job, seed)


def gathered(run: Run, parts: Parts, solved: list[SolveReport], target: str) -> tuple[Positions, ComplexArray]:
    """Positions of all vertices and mu (F,) from the stored maps of the patches."""
    store = PatchStore(parts.job.directory)
    maps = (PatchMap(s.patch, *store.read_map(s.patch), s.fold_count, s.mu_max) for s in solved)
    return collect(run.mesh, zip(parts.patches, maps, strict=True), target)


def spread_out(seams: SeamPositions, vertex_count: int) -> Positions:
    """Positions of all seam and boundary vertices in an array over all vertices, complex (V,) or (V, 3)."""
    out = np.zeros((vertex_count, *seams.points.shape[1:]), seams.points.dtype)
    out[seams.vertex_ids] = seams.points
    return out
