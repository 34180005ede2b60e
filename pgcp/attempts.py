"""Map the patches of a mesh, and where that fails or leaves folds try again: other welds, another seed, fewer patches."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from pgcp.assemble import collect, used_vertices
from pgcp.clock import Clock
from pgcp.constrain import constrain_to_disk, constrain_to_sphere, keep_free
from pgcp.correct import Correction, correct
from pgcp.curves import crossings
from pgcp.errors import NumericalError, SolveFailedError, WeldFailedError
from pgcp.executors import Executor
from pgcp.io import read_cuts
from pgcp.options import Options
from pgcp.repair import Repaired, Surroundings, embedding_alone, repair_folds
from pgcp.split import Split, cut_patch, plans, split_mesh
from pgcp.store import PatchStore
from pgcp.tasks import Job, SolveReport, flatten_task, relax_task, solve_task, weld_closed_task, weld_task
from pgcp.topology import Topology
from pgcp.types import (
    BoundaryCurve,
    ComplexArray,
    Component,
    IntArray,
    Mesh,
    Patch,
    PatchMap,
    Positions,
    SeamPositions,
    WeldPlan,
)
from pgcp.weld import start_component

_SEEDS = 3
_CONSTRAIN = {"free": keep_free, "disk": constrain_to_disk, "sphere": constrain_to_sphere}
_CORRECTION = {"free": "none", "disk": "auto", "sphere": "auto"}
_LISTED = 10
_FOLDED_MAPS = 2
_FEW_FOLDS = 50
_FEW_FRACTION = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class Task:
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


@dataclass(frozen=True, slots=True, eq=False)
class Flattened:
    """The patches of one split, each flattened."""

    split: Split
    patches: list[Patch]
    curves: list[BoundaryCurve]
    job: Job


@dataclass(frozen=True, slots=True, eq=False)
class Finished:
    """One finished map, and what was done on the way; mu (F,) is that of the solved patches."""

    flattened: Flattened
    union: Component
    welds: list[dict[str, int]]
    solved: list[SolveReport]
    seams: SeamPositions
    mu: ComplexArray
    repaired: Repaired
    correction: Correction | None
    seed: int
    target: str

    @property
    def points(self) -> Positions:
        """Positions of all vertices."""
        return self.repaired.points

    @property
    def folds(self) -> int:
        """Folds that are left."""
        return self.repaired.folds

    @property
    def is_good(self) -> bool:
        """Whether no folds are left, and there never were more than a few."""
        return self.folds == 0 and self.repaired.folds_before <= max(_FEW_FOLDS, _FEW_FRACTION * len(self.mu))

    @property
    def changed_faces(self) -> IntArray:
        """Faces whose image has changed since the patches were solved."""
        moved = self.correction is not None and self.correction.share
        return np.arange(len(self.mu)) if moved else self.repaired.touched


def _flatten(task: Task, count: int, seed: int, cuts: IntArray | None, number: int) -> Flattened:
    """Split the mesh, store its patches and flatten them."""
    clock, options = task.clock, task.options
    job = replace(task.job, run=f"{task.job.run}-{number}", directory=task.job.directory / str(number))
    job.directory.mkdir()
    with clock.stage("split"):
        split = split_mesh(task.mesh, task.topology, count, seed, cuts, options.repair_cuts, task.mollification)
    store = PatchStore(job.directory)
    patches = []
    with clock.stage("store"):
        for index in range(split.patch_count):
            patch = cut_patch(task.mesh, split, index)
            store.write_patch(patch)
            patches.append(patch)
    with clock.stage("flatten"):
        curves = task.executor.map("flatten", partial(flatten_task, job), range(split.patch_count))
    return Flattened(split, patches, curves, job)


def _weld_all(
    executor: Executor, mesh: Mesh, split: Split, plan: WeldPlan, curves: list[BoundaryCurve]
) -> tuple[Component, list[dict[str, int]]]:
    components = {c.patch: start_component(c, mesh.vertices, split.edges) for c in curves}
    notes: list[dict[str, int]] = []
    if split.patch_count == 1:
        (union,) = executor.map("weld", relax_task, list(components.values()))
        return union, notes
    for number, level in enumerate(plan.levels, 1):
        pairs = [(components.pop(step.left), components.pop(step.right)) for step in level]
        task = weld_closed_task if level[0].closed else weld_task
        for step, union in zip(level, executor.map(f"weld {number}", task, pairs), strict=True):
            components[step.result] = union
            notes.append({"left": step.left, "right": step.right, "level": step.level, "seam_edges": step.seam_edge_count})
    (union,) = components.values()
    return union, notes


def _welded(task: Task, flattened: Flattened, plan: WeldPlan, seed: int) -> Finished:
    """Weld flattened patches by a plan, and finish the map."""
    with task.clock.stage("weld"):
        union, welds = _weld_all(task.executor, task.mesh, flattened.split, plan, flattened.curves)
    return _finish(task, flattened, union, welds, seed, task.target)


def _spread_out(seams: SeamPositions, vertex_count: int) -> Positions:
    """Positions of all seam and boundary vertices in an array over all vertices, complex (V,) or (V, 3)."""
    out = np.zeros((vertex_count, *seams.points.shape[1:]), seams.points.dtype)
    out[seams.vertex_ids] = seams.points
    return out


def _solve(
    task: Task, flattened: Flattened, union: Component, target: str
) -> tuple[SeamPositions, list[SolveReport], Positions, ComplexArray]:
    """Constrain a union to the target, solve all patches, and put them together."""
    clock, patches = task.clock, flattened.patches
    with clock.stage("constrain"):
        seams = _CONSTRAIN[target](union)
        positions = _spread_out(seams, len(task.mesh.vertices))
    with clock.stage("solve"):
        items = [(p.index, positions[p.vertex_ids[p.boundary]]) for p in patches]
        solved = task.executor.map("solve", partial(solve_task, flattened.job), items)
    with clock.stage("assemble"):
        store = PatchStore(flattened.job.directory)
        maps = (PatchMap(s.patch, *store.read_map(s.patch), s.fold_count, s.mu_max) for s in solved)
        points, mu = collect(task.mesh, zip(patches, maps, strict=True), target)
    return seams, solved, points, mu


def _corrected(task: Task, points: Positions, target: str) -> tuple[Positions, Correction | None]:
    """The Moebius correction asked for; a vertex at the centre of the disk leaves none."""
    options = task.options
    method = _CORRECTION[target] if options.moebius == "auto" else options.moebius
    if method == "none" or (target == "disk" and options.centre is not None):
        return points, None
    bare = task.mesh.bare
    return correct(bare, points, target, method, task.boundary, np.flatnonzero(used_vertices(bare)))


def _surroundings(task: Task, target: str) -> Surroundings:
    return Surroundings(task.mesh, target, task.boundary, task.mollification, task.job.backend)


def _finish(
    task: Task, flattened: Flattened, union: Component, welds: list[dict[str, int]], seed: int, target: str
) -> Finished:
    """Solve a welded union, correct the map and repair its folds, but for the last tier: another weld may do better.

    A correction that leaves folds is taken back.
    """
    seams, solved, solved_points, mu = _solve(task, flattened, union, target)
    with task.clock.stage("correct"):
        points, correction = _corrected(task, solved_points, target)
    here, methods = _surroundings(task, target), task.options.repairs
    local = tuple(m for m in methods if m != "embed")
    with task.clock.stage("repair"):
        repaired = repair_folds(here, points, local)
        if repaired.folds and correction is not None and correction.share:
            repaired = repair_folds(here, solved_points, local)
            correction = correction.undone()
    return Finished(flattened, union, welds, solved, seams, mu, repaired, correction, seed, target)


def _embedded(task: Task, done: Finished) -> Finished:
    """Apply the last tier of repair, where it is wanted and needed."""
    if done.folds == 0 or "embed" not in task.options.repairs:
        return done
    with task.clock.stage("embed"):
        last = repair_folds(_surroundings(task, done.target), done.repaired.points, ("embed",))
    touched = np.union1d(done.repaired.touched, last.touched)
    records = done.repaired.records + last.records
    return replace(done, repaired=replace(last, touched=touched, records=records, folds_before=done.repaired.folds_before))


def _choices(options: Options, count: int, fewest: int) -> Iterator[tuple[int, range]]:
    """Patch counts and their seeds to try, one after the other: the count asked for with three seeds, then fewer patches."""
    alone = options.cuts is not None or count <= fewest
    yield count, range(options.seed, options.seed + (1 if alone else _SEEDS))
    while count > fewest and not alone:
        count = max(fewest, count // 2)
        yield count, range(options.seed, options.seed + 1)


def _map_with_retries(task: Task, failures: list[dict[str, Any]]) -> Finished:
    """Map the patches; where a weld fails or folds remain, try other weld orders, other seeds, and fewer patches.

    What did not serve is added to ``failures``: a map with many folds is a wrong one, even if they could all be repaired.
    After two such maps fewer patches are tried; the last tier of repair waits until nothing else is left. Raises
    WeldFailedError or SolveFailedError where nothing led to a map, CrowdedError where the disk has no room for it.
    """
    cuts = read_cuts(task.options.cuts) if task.options.cuts is not None else None
    fewest = 2 if task.target == "sphere" else 1
    best: Finished | None = None
    problem: WeldFailedError | SolveFailedError | None = None
    for count, seeds in _choices(task.options, task.options.patch_count(len(task.mesh.faces), fewest), fewest):
        folded = 0
        for seed, order, done in _maps(task, count, seeds, cuts, failures):
            if not isinstance(done, Finished):
                problem, reason = done, str(done)
            elif done.is_good:
                return done
            else:
                best = min(best or done, done, key=lambda d: (d.folds, d.repaired.folds_before))
                folded += 1
                reason = f"{done.repaired.folds_before} folds, {done.folds} of them left after repair"
            failures.append({"patches": count, "seed": seed, "weld_order": order, "reason": reason})
            if folded == _FOLDED_MAPS:
                break
    if best is None:
        raise problem if problem is not None else WeldFailedError("no weld order was tried")
    return _embedded(task, best)


def _maps(
    task: Task, count: int, seeds: range, cuts: IntArray | None, failures: list[dict[str, Any]]
) -> Iterator[tuple[int, float | None, Finished | WeldFailedError | SolveFailedError]]:
    """Maps of so many patches, one after the other, or what went wrong: each with its seed and weld order."""
    for seed in seeds:
        try:
            flattened = _flatten(task, count, seed, cuts, len(failures))
        except (WeldFailedError, SolveFailedError) as problem:
            yield seed, None, problem
            continue
        for order, plan in plans(flattened.split, closed=not task.topology.loops):
            try:
                yield seed, order, _welded(task, flattened, plan, seed)
            except (WeldFailedError, SolveFailedError) as problem:
                yield seed, order, problem


def _overlap(z: ComplexArray, boundary: IntArray) -> dict[str, Any]:
    """Where the boundary of a map z (V,) to the plane crosses itself: how often, and the first pairs of boundary edges."""
    found = crossings(z[boundary])
    after = np.roll(boundary, -1)
    edges = [[[int(boundary[i]), int(after[i])] for i in pair] for pair in found[:_LISTED].tolist()]
    return {"crossings": len(found), "edges": edges}


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """A finished map, what failed before it, where it overlaps itself, and why it is no free map if it should be one."""

    done: Finished
    failures: list[dict[str, Any]]
    overlap: dict[str, Any] | None = None
    fallback: dict[str, str] | None = None


def _alone(task: Task, target: str) -> Finished:
    """The whole mesh embedded at once, without welds: free of folds, but hardly conformal."""
    here = _surroundings(task, target)
    everything = np.arange(len(task.mesh.faces))
    with task.clock.stage("embed"):
        repaired = repair_folds(here, embedding_alone(here), task.options.repairs[:-1])
    split = split_mesh(task.mesh, task.topology, 2 if target == "sphere" else 1, mollification=task.mollification)
    patches = [cut_patch(task.mesh, split, index) for index in range(split.patch_count)]
    none, z = np.empty(0, np.int64), np.empty(0, np.complex128)
    nowhere = Component(none, z, none, none.reshape(0, 2), np.empty(0), 0)
    return Finished(
        Flattened(split, patches, [], task.job),
        nowhere,
        [],
        [],
        SeamPositions(none, repaired.points[none]),
        np.zeros(len(everything), np.complex128),
        replace(repaired, touched=everything),
        None,
        task.options.seed,
        target,
    )


def map_mesh(task: Task) -> Outcome:
    """Map a mesh to its target.

    A free map that is left with folds, or with overlaps where none are wanted, gives way to the map to the disk from the
    same welds, whose boundary is convex. Where all welds fail the mesh is embedded as a whole. Raises NumericalError where
    there is no map, or none without overlaps.
    """
    failures: list[dict[str, Any]] = []
    try:
        done = _map_with_retries(task, failures)
    except (WeldFailedError, SolveFailedError) as problem:
        if "embed" not in task.options.repairs:
            raise
        done = _alone(task, "sphere" if task.target == "sphere" else "disk")
        return Outcome(done, failures, None, {"from": task.target, "to": f"{done.target} (embedding)", "reason": str(problem)})
    if task.target != "free":
        return Outcome(done, failures)
    overlap = _overlap(done.points, task.boundary)
    unwanted = task.options.no_overlap and overlap["crossings"] > 0
    if not unwanted and not (done.folds and "embed" in task.options.repairs):
        return Outcome(done, failures, overlap)
    reason = f"the boundary crosses itself {overlap['crossings']} times" if unwanted else f"{done.folds} folds are left"
    try:
        disk = _finish(task, done.flattened, done.union, done.welds, done.seed, "disk")
    except NumericalError:
        if unwanted:
            raise
        return Outcome(done, failures, overlap)
    disk = _embedded(task, disk)
    if disk.folds >= done.folds > 0 and not unwanted:
        return Outcome(done, failures, overlap)
    return Outcome(disk, failures, None, {"from": "free", "to": "disk", "reason": reason})
