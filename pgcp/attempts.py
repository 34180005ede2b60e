"""Map a mesh, and where that fails or leaves folds try again: other welds, exact seams, another seed, fewer patches."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pgcp.assemble import used_vertices
from pgcp.beltrami import find_folds
from pgcp.by_interface import map_exactly, map_to_disk
from pgcp.by_welds import Welding, flatten, solve, weld
from pgcp.correct import Correction, correct
from pgcp.curves import crossings
from pgcp.errors import CrowdedError, NumericalError, PartitionInputError, SolveFailedError, WeldFailedError
from pgcp.io import read_cuts
from pgcp.options import DISK_METHODS
from pgcp.repair import Repaired, Surroundings, embedding_alone, repair_folds
from pgcp.run import Mapped, Parts, Run, discard, store_parts
from pgcp.split import plans
from pgcp.types import BoundaryCurve, ComplexArray, IntArray, Positions, SeamPositions

_SEEDS = 3
_CORRECTION = {"free": "none", "disk": "auto", "sphere": "auto"}
_LISTED = 10
_FOLDED_MAPS = 2
_FEW_FOLDS = 50
_FEW_FRACTION = 0.005
_Problem = WeldFailedError | SolveFailedError | CrowdedError | PartitionInputError
_PROBLEMS = (WeldFailedError, SolveFailedError, CrowdedError)
_Attempt = tuple[dict[str, Any], Mapped | _Problem]


@dataclass(frozen=True, slots=True, eq=False)
class Finished:
    """One map after its correction and repair."""

    mapped: Mapped
    repaired: Repaired
    correction: Correction | None = None

    @property
    def points(self) -> Positions:
        """Positions of all vertices."""
        return self.repaired.points

    @property
    def folds(self) -> int:
        """Folds that are left."""
        return self.repaired.folds

    @property
    def changed_faces(self) -> IntArray:
        """Faces whose image has changed since the patches were solved."""
        moved = self.correction is not None and self.correction.share
        return np.arange(len(self.mapped.mu)) if moved else self.repaired.touched


def _corrected(run: Run, points: Positions, target: str) -> tuple[Positions, Correction | None]:
    """The Moebius correction asked for; a vertex at the centre of the disk leaves none, a disk method has its own."""
    options = run.options
    own = "none" if options.method in DISK_METHODS else _CORRECTION[target]
    method = own if options.moebius == "auto" else options.moebius
    if method == "none" or (target == "disk" and options.centre is not None):
        return points, None
    bare = run.mesh.bare
    return correct(bare, points, target, method, run.boundary, np.flatnonzero(used_vertices(bare)))


def _surroundings(run: Run, target: str) -> Surroundings:
    return Surroundings(run.mesh, target, run.boundary, run.mollification, run.job.backend)


def _local(run: Run) -> tuple[str, ...]:
    """The tiers of repair but the last."""
    return tuple(method for method in run.options.repairs if method != "embed")


def _few(run: Run) -> float:
    """How many folds are few: a map with more is a wrong one."""
    return max(_FEW_FOLDS, _FEW_FRACTION * len(run.mesh.faces))


def _finish(run: Run, mapped: Mapped) -> Finished:
    """Correct a map and repair a few folds, but not by the last tier: another weld may do better.

    A correction that leaves folds is taken back.
    """
    with run.clock.stage("correct"):
        points, correction = _corrected(run, mapped.points, mapped.target)
    here = _surroundings(run, mapped.target)
    with run.clock.stage("repair"):
        folded = find_folds(run.mesh.bare.faces, points)
        methods = () if len(folded) > _few(run) and run.options.seams != "exact" else _local(run)
        repaired = repair_folds(here, points, methods, folded)
        if repaired.folds and correction is not None and correction.share:
            repaired = repair_folds(here, mapped.points, methods)
            correction = correction.undone()
    return Finished(mapped, repaired, correction)


def _repaired_at_last(run: Run, done: Finished) -> Finished:
    """Repair a map to which there is no better one, by all tiers that are wanted and have not been tried."""
    methods = tuple(m for m in run.options.repairs if m == "embed" or not done.repaired.records)
    if done.folds == 0 or not methods:
        return done
    with run.clock.stage("repair at last"):
        last = repair_folds(_surroundings(run, done.mapped.target), done.points, methods)
    touched = np.union1d(done.repaired.touched, last.touched)
    records = done.repaired.records + last.records
    return replace(done, repaired=replace(last, touched=touched, records=records, folds_before=done.repaired.folds_before))


def _choices(run: Run) -> Iterator[tuple[int, range]]:
    """Patch counts and their seeds to try, one after the other: the count asked for with three seeds, then fewer patches."""
    options, fewest = run.options, run.fewest_patches
    count = max(fewest, run.patch_count)
    alone = options.cuts is not None or count <= fewest or options.seams == "exact"
    yield count, range(options.seed, options.seed + (1 if alone else _SEEDS))
    while count > fewest and not alone:
        count = max(fewest, count // 2)
        yield count, range(options.seed, options.seed + 1)


def _maps(run: Run, count: int, seeds: range, cuts: IntArray | None, failures: list[dict[str, Any]]) -> Iterator[_Attempt]:
    """Maps of so many patches, one after the other, or what went wrong: each with its seed and route.

    Routes are welds in several orders; and once, after the first or, where that is asked for, before, the seams solved exactly.
    """
    for seed in seeds:
        exact_is_new = all(failure["route"] != "exact" for failure in failures)
        if _are_enough(failures, count) and not exact_is_new:
            return
        try:
            parts = store_parts(run, count, seed, cuts, f"{count}-{seed}")
        except PartitionInputError as problem:
            if not failures:
                raise
            yield {"patches": count, "seed": seed, "route": "split"}, problem
            continue
        apart = replace(parts, job=replace(parts.job, run=f"{parts.job.run}-exact"))  # factors of the same patches, but others
        if run.exact_first:
            yield _exact_map(run, apart)
        yield from _welded_maps(run, parts, failures)
        if exact_is_new and not run.exact_first:
            yield _exact_map(run, apart)
        discard(parts)


def _are_enough(failures: list[dict[str, Any]], count: int) -> bool:
    """Whether enough maps of so many patches had folds."""
    return sum(f["patches"] == count and f["folds"] is not None for f in failures) >= _FOLDED_MAPS


def _note(parts: Parts, route: str | float) -> dict[str, Any]:
    return {"patches": parts.split.patch_count, "seed": parts.seed, "route": route}


def _exact_map(run: Run, parts: Parts) -> _Attempt:
    try:
        return _note(parts, "exact"), map_exactly(run, parts, run.target)
    except _PROBLEMS as problem:
        return _note(parts, "exact"), problem


def _welded_maps(run: Run, parts: Parts, failures: list[dict[str, Any]]) -> Iterator[_Attempt]:
    """Welds in several orders, until enough maps of so many patches had folds."""
    if _are_enough(failures, parts.split.patch_count):
        return
    curves: list[BoundaryCurve] | None = None
    for order, plan in plans(parts.split, closed=not run.topology.loops):
        if _are_enough(failures, parts.split.patch_count):
            return
        welding = Welding(run, parts, plan, order)
        if curves is None:
            try:
                curves = flatten(run, parts, plan, welding)
            except _PROBLEMS as problem:
                yield _note(parts, "flatten"), problem
                return
            pieces = [c.pieces for c in curves]
        try:
            union, welds = weld(run, parts, curves, plan, welding)
            yield _note(parts, order), solve(run, parts, pieces, plan, union, welds, run.target, order)
        except _PROBLEMS as problem:
            yield _note(parts, order), problem
            if isinstance(problem, CrowdedError):  # the map to the disk is unique: another order gives the same gaps
                return


def _cuts(run: Run) -> IntArray | None:
    return read_cuts(run.options.cuts) if run.options.cuts is not None else None


def _map_with_retries(run: Run, failures: list[dict[str, Any]]) -> Finished:
    """Map the patches; where that fails or leaves folds, try other weld orders, exact seams, other seeds, and fewer patches.

    What did not serve is added to ``failures``: a map with many folds is a wrong one, and is not repaired as long as there
    may be a better one. After two such maps fewer patches are tried; the last tier of repair waits as well. Raises
    WeldFailedError or SolveFailedError where nothing led to a map, CrowdedError where the disk has no room for it.
    """
    cuts = _cuts(run)
    best: Finished | None = None
    problem: _Problem | None = None
    for count, seeds in _choices(run):
        for note, mapped in _maps(run, count, seeds, cuts, failures):
            folds = None
            if not isinstance(mapped, Mapped):
                problem, reason = mapped.with_traceback(None), str(mapped)
            else:
                done = _finish(run, mapped)
                if done.folds == 0:
                    return done
                best = min(best or done, done, key=lambda d: (d.folds, d.repaired.folds_before))
                folds = done.folds
                reason = f"{done.repaired.folds_before} folds, {folds} of them left after repair"
            failures.append({**note, "folds": folds, "reason": reason})
        if isinstance(problem, CrowdedError) and best is None:
            raise problem
    if best is None or (best.folds > _few(run) and run.target != "free" and "embed" in run.options.repairs):
        raise problem if problem is not None else WeldFailedError(f"every map had folds, {best.folds if best else 0} and more")
    return _repaired_at_last(run, best)


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


def _alone(run: Run, failures: list[dict[str, Any]], reason: str) -> Outcome:
    """The whole mesh embedded at once, without welds: free of folds, but hardly conformal."""
    target = "sphere" if run.target == "sphere" else "disk"
    here = _surroundings(run, target)
    everything = np.arange(len(run.mesh.faces))
    with run.clock.stage("embed"):
        repaired = repair_folds(here, embedding_alone(here), _local(run))
    parts = store_parts(run, run.fewest_patches, run.options.seed, None, "whole")
    none = np.empty(0, np.int64)
    nowhere = SeamPositions(none, repaired.points[none])
    mapped = Mapped(parts, target, [], [], nowhere, repaired.points, np.zeros(len(everything), np.complex128))
    done = Finished(mapped, replace(repaired, touched=everything))
    return Outcome(done, failures, None, {"from": run.target, "to": f"{target} (embedding)", "reason": reason})


def _to_disk(run: Run, mapped: Mapped) -> Mapped:
    """From a map with a free boundary the map to the disk: from the same welds, or else from the first that succeed."""
    if mapped.union is not None and mapped.plan is not None:
        return solve(run, mapped.parts, mapped.pieces, mapped.plan, mapped.union, mapped.welds, "disk", mapped.order)
    parts = replace(mapped.parts, job=replace(mapped.parts.job, run=f"{mapped.parts.job.run}-disk"))
    problem: Exception | None = None
    for _, found in _welded_maps(replace(run, target="disk"), parts, []):
        if isinstance(found, Mapped):
            return found
        problem = found
    raise WeldFailedError(str(problem))


def map_mesh(run: Run) -> Outcome:
    """Map a mesh to its target.

    A free map that is left with folds, or with overlaps where none are wanted, gives way to the map to the disk from the
    same welds, whose boundary is convex. Where all welds fail, or the disk has no room, the mesh is embedded as a whole. A
    disk method of its own has no other to give way to. Raises NumericalError where there is no map, or none without overlaps.
    """
    failures: list[dict[str, Any]] = []
    if run.options.method in DISK_METHODS:
        parts = store_parts(run, run.patch_count, run.options.seed, _cuts(run), run.options.method)
        return Outcome(_repaired_at_last(run, _finish(run, map_to_disk(run, parts))), failures)
    try:
        done = _map_with_retries(run, failures)
    except (WeldFailedError, SolveFailedError, CrowdedError) as problem:
        if "embed" not in run.options.repairs:
            raise
        return _alone(run, failures, str(problem))
    outcome = Outcome(done, failures) if run.target != "free" else _free_or_disk(run, done, failures)
    if run.options.seams == "exact" and outcome.fallback is None and outcome.done.mapped.seams_by != "exact":
        return replace(outcome, fallback={"from": "exact seams", "to": "welded ones", "reason": failures[0]["reason"]})
    return outcome


def _free_or_disk(run: Run, done: Finished, failures: list[dict[str, Any]]) -> Outcome:
    """The free map, or the map to the disk where folds are left or overlaps are not wanted."""
    overlap = _overlap(done.points, run.boundary)
    unwanted = run.options.no_overlap and overlap["crossings"] > 0
    if not unwanted and not (done.folds and "embed" in run.options.repairs):
        return Outcome(done, failures, overlap)
    reason = f"the boundary crosses itself {overlap['crossings']} times" if unwanted else f"{done.folds} folds are left"
    try:
        disk = _repaired_at_last(run, _finish(run, _to_disk(run, done.mapped)))
    except NumericalError as problem:
        if unwanted and not done.folds:
            raise
        return _alone(run, failures, f"{reason}, and to the disk {problem}")
    return Outcome(disk, failures, None, {"from": "free", "to": "disk", "reason": reason})
