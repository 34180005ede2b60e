"""Map a mesh, and where that fails or leaves folds try again: other welds, exact seams, another seed, fewer patches."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from pgcp.errors import BlurredError, CrowdedError, NumericalError, PartitionInputError, WeldFailedError
from pgcp.folds.repair import embedding_alone, repair_folds
from pgcp.methods.base import FAILURES, Attempt, Choice, Failure, Mapper, Method
from pgcp.options import AUTO
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts, discard, store_parts
from pgcp.patches.types import SeamPositions
from pgcp.plane.curves import crossings
from pgcp.plane.space import find_folds
from pgcp.plane.unfold import unfolded
from pgcp.retry.cut_open import evenest
from pgcp.retry.decide import Tried, next_attempt
from pgcp.retry.finished import (
    EMBED,
    Finished,
    are_few,
    finish,
    local_repairs,
    polished,
    repaired_at_last,
    surroundings,
    target_of,
)
from pgcp.retry.intrinsic import NOISY_DEG, may_help, solved_intrinsically
from pgcp.retry.polar import final_error, free_of, may_be_solved_in_logarithms, mean_error, solved_in_logarithms
from pgcp.targets.registry import TARGETS
from pgcp.types import ComplexArray, IntArray

_LISTED = 10
_LONGEST = 3000  # boundary vertices that there is a patch for, where fewer patches are tried: each is solved densely
_BEYOND_WELDS = 75.0  # log of a range of scales that no weld keeps: digits for half of it from either end
_SQUEEZED = 20.0  # log of a range of scales at which welds fail because parts are long and thin
_WRONG_DEG = 20.0  # mean angle error from which on a map without folds is not taken before others are tried
_LARGE_DEG = 8.0  # mean angle error from which on a map is compared with the one solved in logarithms
_SMALLER = "a map from welds, its boundary on a circle, has smaller angle errors"
_GOOD_DEG = 2.0  # mean angle error up to which a free map is not compared with another


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """A finished map, what was tried before it, where it overlaps itself, and why it is not the map that was asked for.

    is_embedding: the whole mesh was embedded at once, without welds.
    """

    done: Finished
    tried: tuple[Tried, ...] = ()
    overlap: dict[str, Any] | None = None
    fallback: dict[str, str] | None = None
    is_embedding: bool = False


class _Splits:
    """The splits of a mesh that attempts ask for: one is stored at a time, the one before it discarded."""

    def __init__(self, run: Run, method: Method) -> None:
        self._run, self._method = run, method
        self._parts: Parts | None = None
        self._mapper: Mapper | None = None
        self._key: tuple[int, int] | None = None

    def map(self, attempt: Attempt) -> Mapped | Failure:
        """The map of an attempt; raises PartitionInputError where the mesh cannot be split so."""
        key = attempt.patches, attempt.seed
        if self._mapper is None or self._key != key:
            self.discard()
            self._parts = store_parts(self._run, *key, self._run.cuts, f"{attempt.patches}-{attempt.seed}")
            self._mapper, self._key = self._method.mapper(self._run, self._parts), key
        return self._mapper(attempt.route)

    @property
    def parts(self) -> Parts | None:
        """The split at hand."""
        return self._parts

    def discard(self) -> None:
        """Remove the files of the split at hand."""
        if self._parts is not None:
            discard(self._parts)
        self._parts = self._mapper = None


def _choice(run: Run) -> Choice:
    """What attempts may be made of."""
    options = run.options
    count = max(run.fewest_patches, run.patch_count)
    fewest = max(run.fewest_patches, min(count, len(run.boundary) // _LONGEST))
    varies = options.cuts is None and count > fewest and options.seams != "exact"
    exact_first = options.seams == "exact" or (options.patches == 1 and run.is_closed)
    return Choice(count, options.seed, fewest, varies, exact_first)


def _best(run: Run, method: Method) -> tuple[Finished, tuple[Tried, ...]]:
    """The first map without folds, or the one with fewest, repaired by all means; and what was tried before it.

    A map with many folds is a wrong one, and is not repaired as long as there may be a better one; the last tier of repair
    waits as well. Raises _NothingError where no attempt led to a map worth repairing.
    """
    splits, choice = _Splits(run, method), _choice(run)
    history: list[Tried] = []
    best: Finished | None = None
    spare: Finished | None = None  # a map in logarithms
    problem: NumericalError | PartitionInputError | None = None
    while (attempt := next_attempt(method.attempts(choice), history)) is not None:
        try:
            found = splits.map(attempt)
        except PartitionInputError as refusal:
            if not history:
                raise
            problem = refusal.with_traceback(None)
            history.append(Tried(attempt, "split", str(refusal), stage="split"))
            continue
        if isinstance(found, Failure):
            if found.problem is not None and (problem is None or found.stage != "exact"):
                problem = found.problem.with_traceback(None)
            crowded, blurred = (isinstance(found.problem, kind) for kind in (CrowdedError, BlurredError))
            history.append(Tried(attempt, found.label, str(found.problem), None, found.stage, crowded, blurred))
        else:
            done = finish(run, method, found)
            if done.folds == 0 or method.to_target is None:
                return _compared(run, method, repaired_at_last(run, done), splits), _told(history)
            best = min(best or done, done, key=_by_folds)
            reason = f"{done.repaired.folds_before} folds, {done.folds} of them left after repair"
            history.append(Tried(attempt, found.route, reason, done.folds))
        if len(history) == 1 and (other := _in_logarithms(run, method, splits)) is not None:
            span = other.mapped.details["logarithms"]["range"]
            is_needed = span > _SQUEEZED or history[0].crowded or best is not None
            if is_needed and other.folds == 0 and mean_error(run, other) < _WRONG_DEG:
                return other, _told(history)
            spare = other if best is not None or other.folds == 0 else None
            if span > _BEYOND_WELDS:
                break
        if len(history) == 1 and (best is not None or history[0].crowded or history[0].blurred):
            other = _intrinsically(run, method, splits, NOISY_DEG)
            if other is not None and other.folds == 0:
                return other, _told(history)
    if spare is not None:
        best = min(best or spare, spare, key=_by_folds)
    splits.discard()
    is_wrong = best is not None and not are_few(run, best.folds) and not target_of(run.target).has_free_boundary
    if best is None or (is_wrong and EMBED in run.options.repairs):
        raise _NothingError(
            _told(history), problem or WeldFailedError(f"every map had folds, {best.folds if best else 0} and more")
        )
    return repaired_at_last(run, best), _told(history)


def _by_folds(done: Finished) -> tuple[int, int]:
    """What of several maps makes one the best."""
    return done.folds, done.repaired.folds_before


def _in_logarithms(run: Run, method: Method, splits: _Splits) -> Finished | None:
    """The map solved in logarithms, None where there is none or it is not wanted."""
    if splits.parts is None or not may_be_solved_in_logarithms(run, method):
        return None
    return solved_in_logarithms(run, method, splits.parts)


def _intrinsically(run: Run, method: Method, splits: _Splits, error: float) -> Finished | None:
    """The map that is harmonic on other triangles, None where there is none or it is not wanted beside one with this error."""
    if splits.parts is None or not may_help(run, method, error):
        return None
    return solved_intrinsically(run, method, splits.parts)


def _compared(run: Run, method: Method, done: Finished, splits: _Splits) -> Finished:
    """A map without folds, or of those found by other ways, each where it may be better, the one with the least errors."""
    if done.folds:
        return done
    error = mean_error(run, done)
    others = [_in_logarithms(run, method, splits) if error >= _LARGE_DEG else None, _intrinsically(run, method, splits, error)]
    able = [done, *(other for other in others if other is not None and other.folds == 0)]
    return min(able, key=partial(final_error, run)) if len(able) > 1 else replace(done, error=error)


class _NothingError(Exception):
    """No attempt led to a map that is worth repairing: what was tried, and the last problem."""

    def __init__(self, tried: tuple[Tried, ...], problem: Exception) -> None:
        super().__init__(tried, problem)
        self.tried, self.problem = tried, problem


def _told(history: list[Tried]) -> tuple[Tried, ...]:
    """What is told of a history: not that there was no further weld plan."""
    return tuple(tried for tried in history if tried.stage != "plan")


def _overlap(z: ComplexArray, boundary: IntArray) -> dict[str, Any]:
    """Where the boundary of a map z (V,) to the plane crosses itself: how often, and the first pairs of boundary edges."""
    found = crossings(z[boundary])
    after = np.roll(boundary, -1)
    edges = [[[int(boundary[i]), int(after[i])] for i in pair] for pair in found[:_LISTED].tolist()]
    return {"crossings": len(found), "edges": edges}


def embedded(run: Run, method: Method, tried: tuple[Tried, ...], reason: str) -> Outcome:
    """The whole mesh embedded at once, without welds: free of folds, but hardly conformal."""
    target = TARGETS.get(target_of(run.target).gives_way_to or run.target.name)
    here = surroundings(run, target)
    everything = np.arange(len(run.mesh.faces))
    parts = store_parts(run, run.fewest_patches, run.options.seed, None, "whole")
    fallback = {"from": run.target.name, "to": f"{target.name} (embedding)", "reason": reason}
    in_logarithms = None
    if may_be_solved_in_logarithms(run, method):
        in_logarithms = solved_in_logarithms(replace(run, target=target), method, parts, positive=True)
        if in_logarithms is not None and in_logarithms.folds == 0:
            return Outcome(in_logarithms, tried, None, fallback, True)
    with run.clock.stage("embed"):
        repaired = repair_folds(here, embedding_alone(here), local_repairs(run))
    if in_logarithms is not None and in_logarithms.folds < repaired.folds:
        return Outcome(in_logarithms, tried, None, fallback, True)
    none = np.empty(0, np.int64)
    nowhere = SeamPositions(none, repaired.points[none])
    mapped = Mapped(parts, target, repaired.points, np.zeros(len(everything), np.complex128), nowhere, [])
    done = Finished(mapped, replace(repaired, touched=everything))
    return Outcome(done, tried, None, fallback, True)


def may_be_embedded(run: Run, method: Method, outcome: Outcome) -> bool:
    """Whether the embedded mesh may take the place of a map that keeps folds."""
    return EMBED in run.options.repairs and method.to_target is not None and not outcome.is_embedding


def map_mesh(run: Run, method: Method) -> Outcome:
    """The polished map of a mesh; see ``_mapped``."""
    outcome = _mapped(run, method)
    return replace(outcome, done=polished(run, method, outcome.done))


def _mapped(run: Run, method: Method) -> Outcome:
    """Map a mesh to its target.

    A free map that is left with folds, or with overlaps where none are wanted, gives way to the map to the disk from the
    same welds, whose boundary is convex. Where all welds fail, or the disk has no room, the mesh is embedded as a whole. A
    method that gives no way to other maps returns its own.
    Raises NumericalError where there is no map, or none without overlaps.
    """
    try:
        done, tried = _best(run, method)
    except _NothingError as nothing:
        if EMBED not in run.options.repairs or method.to_target is None or not isinstance(nothing.problem, FAILURES):
            raise nothing.problem from None
        return embedded(run, method, nothing.tried, str(nothing.problem))
    if target_of(run.target).has_free_boundary:
        outcome = _free_or_other(run, method, evenest(run, method, _freest(run, method, done)), tried)
    else:
        outcome = Outcome(done, tried)
    if run.options.seams == "exact" and outcome.fallback is None and outcome.done.mapped.seams_by != "exact":
        reason = _SMALLER if done.mapped.seams_by == "exact" else tried[0].reason
        return replace(outcome, fallback={"from": "exact seams", "to": "welded ones", "reason": reason})
    return outcome


def _freest(run: Run, method: Method, done: Finished) -> Finished:
    """The best map with a free boundary that is at hand.

    A developable surface is unfolded: that is its conformal map, exact to rounding. Where the free map has large errors, as
    with a boundary of few vertices that the whole surface is squeezed into, the map to the target it gives way to may have
    smaller ones; it then is the free map. Not so of a surface that was cut open for even scales, which a disk has not.
    """
    if method.to_target is None:
        return done
    everything = np.arange(len(done.mapped.mu))
    flat = unfolded(run.mesh.vertices, run.mesh.faces, run.topology.twins)
    if flat is not None and not (run.options.no_overlap and len(crossings(flat[run.boundary]))):
        folds = len(find_folds(done.target.space, run.mesh.bare.faces, flat))
        if folds <= done.folds and run.options.moebius in (AUTO, "none"):
            return replace(done, repaired=replace(done.repaired, points=flat, touched=everything, folds=folds))
    other = target_of(run.target).gives_way_to
    error = mean_error(run, done) if done.error is None else done.error
    if other is None or done.folds or error < _GOOD_DEG or run.options.opens:
        return done
    try:
        mapped = method.to_target(replace(run, target=TARGETS.get(other)), done.mapped)
        found = repaired_at_last(run, finish(run, method, mapped))
    except (NumericalError, PartitionInputError):
        return done
    if found.folds > done.folds or (found.folds == done.folds and mean_error(run, found) >= error):
        return done
    return free_of(run, found)


def _free_or_other(run: Run, method: Method, done: Finished, tried: tuple[Tried, ...]) -> Outcome:
    """The free map, or the map to the target it gives way to, where folds are left or overlaps are not wanted."""
    overlap = _overlap(done.points, run.boundary)
    unwanted = run.options.no_overlap and overlap["crossings"] > 0
    other = target_of(run.target).gives_way_to
    is_needed = unwanted or (done.folds > 0 and EMBED in run.options.repairs)
    if not is_needed or other is None or method.to_target is None:
        return Outcome(done, tried, overlap)
    reason = f"the boundary crosses itself {overlap['crossings']} times" if unwanted else f"{done.folds} folds are left"
    elsewhere = replace(run, target=TARGETS.get(other))
    try:
        found = repaired_at_last(run, finish(run, method, method.to_target(elsewhere, done.mapped)))
    except NumericalError as problem:
        if unwanted and not done.folds:
            raise
        return embedded(run, method, tried, f"{reason}, and to the {other} {problem}")
    return Outcome(found, tried, None, {"from": run.target.name, "to": other, "reason": reason})
