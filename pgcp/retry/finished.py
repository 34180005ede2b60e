"""One map after its correction, repair and polish."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pgcp.finish.correct import Correction, Setting, correct
from pgcp.finish.polish import BALANCED, LEAST_MEAN, Polish, is_quick, polish
from pgcp.folds.repair import Repaired, Surroundings, repair_folds
from pgcp.methods.base import Method
from pgcp.options import AUTO
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Goal, Run
from pgcp.plane.curves import crossings
from pgcp.plane.space import find_folds
from pgcp.surface.topology import used_vertices
from pgcp.targets.base import Target
from pgcp.targets.registry import TARGETS
from pgcp.types import IntArray, Positions

EMBED = "embed"
_FEW_FOLDS = 50
_FEW_FRACTION = 0.005
CROWDED = 20.0  # log of the range of scales from which on tips lose digits anywhere but at 0


@dataclass(frozen=True, slots=True, eq=False)
class Finished:
    """One map after its correction, repair and polish; error: its mean angle error in degrees, where that is known."""

    mapped: Mapped
    repaired: Repaired
    correction: Correction | None = None
    polish: Polish | None = None
    error: float | None = None

    @property
    def target(self) -> Target:
        """Where it goes."""
        return target_of(self.mapped.target)

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
        moved = (self.correction is not None and self.correction.share) or (self.polish is not None and self.polish.steps)
        return np.arange(len(self.mapped.mu)) if moved else self.repaired.touched


def target_of(goal: Goal) -> Target:
    """All of the target that a run or a map knows a part of."""
    return TARGETS.get(goal.name)


def are_few(run: Run, folds: int) -> bool:
    """Whether so many folds are worth repairing: a map with more is a wrong one."""
    return folds <= max(_FEW_FOLDS, _FEW_FRACTION * len(run.mesh.faces))


def surroundings(run: Run, target: Target) -> Surroundings:
    """What repairs need to know of a map to a target."""
    return Surroundings(run.mesh, target.space, run.boundary, run.mollification, target.has_free_boundary)


def local_repairs(run: Run) -> tuple[str, ...]:
    """The tiers of repair but the last."""
    return tuple(method for method in run.options.repairs if method != EMBED)


def _corrected(run: Run, method: Method, target: Target, mapped: Mapped) -> tuple[Positions, Correction | None]:
    """The Moebius correction asked for; a vertex at the centre of the disk leaves none, nor do tips that must stay at 0."""
    options, bare, points = run.options, run.mesh.bare, mapped.points
    if mapped.details.get("logarithms", {"range": 0.0})["range"] > CROWDED:
        return points, None
    wanted = method.moebius or target.moebius if options.moebius == AUTO else options.moebius
    if wanted == "none" or (target.centre_is_all and options.centre is not None):
        return points, None
    used = np.flatnonzero(used_vertices(bare))
    return correct(Setting(bare, target.space, points, target.family(points[used]), run.boundary, used), wanted)


def finish(run: Run, method: Method, mapped: Mapped) -> Finished:
    """Correct a map and repair a few folds, but not by the last tier: another weld may do better.

    A correction that leaves folds is taken back.
    """
    target = target_of(mapped.target)
    with run.clock.stage("correct"):
        points, correction = _corrected(run, method, target, mapped)
    here = surroundings(run, target)
    with run.clock.stage("repair"):
        folded = find_folds(target.space, run.mesh.bare.faces, points)
        repairs = local_repairs(run) if are_few(run, len(folded)) or run.options.seams == "exact" else ()
        repaired = repair_folds(here, points, repairs, folded)
        if repaired.folds and correction is not None and correction.share:
            repaired = repair_folds(here, mapped.points, repairs)
            correction = correction.undone()
    return Finished(mapped, repaired, correction)


def repaired_at_last(run: Run, done: Finished) -> Finished:
    """Repair a map to which there is no better one, by all tiers that are wanted and have not been tried."""
    repairs = tuple(m for m in run.options.repairs if m == EMBED or not done.repaired.records)
    if done.folds == 0 or not repairs:
        return done
    with run.clock.stage("repair at last"):
        last = repair_folds(surroundings(run, done.target), done.points, repairs)
    touched = np.union1d(done.repaired.touched, last.touched)
    records = done.repaired.records + last.records
    return replace(done, repaired=replace(last, touched=touched, records=records, folds_before=done.repaired.folds_before))


def polished(run: Run, method: Method, done: Finished) -> Finished:
    """Polish a finished map where that is asked for; it has no more folds and overlaps than before.

    ``auto`` does so where it takes less time than the map, and where not that map itself is asked for: one by a method of
    others, or one that is to be the same for any cuts.
    """
    options = run.options
    is_wanted = method.is_polished and options.seams != "exact" and is_quick(run.mesh)
    if options.polish == "none" or (options.polish == AUTO and not is_wanted):
        return done
    space = done.target.space
    with run.clock.stage("polish"):
        aim = BALANCED if options.polish == AUTO else LEAST_MEAN
        points, record = polish(run.mesh, space, done.points, run.boundary, done.target.has_free_boundary, aim)
        if done.target.has_free_boundary and record.steps:
            before, after = (len(crossings(z[run.boundary])) for z in (done.points, points))
            if after > before:
                return done
        folds = len(find_folds(space, run.mesh.bare.faces, points)) if record.steps else done.folds
    return replace(done, repaired=replace(done.repaired, points=points, folds=folds), polish=record)
