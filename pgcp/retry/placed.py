"""A finished map in its place: the last check for folds, and their repair, on the coordinates that are given out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pgcp.finish.place import Unplaced
from pgcp.folds.repair import repair_folds
from pgcp.methods.base import Method
from pgcp.patches.run import Run
from pgcp.plane.space import find_folds
from pgcp.retry.course import Outcome, embedded, may_be_embedded
from pgcp.retry.finished import EMBED, Finished, are_few, local_repairs, surroundings
from pgcp.surface.topology import used_vertices
from pgcp.types import FloatArray, IntArray


def place_outcome(run: Run, method: Method, outcome: Outcome) -> tuple[Outcome, FloatArray]:
    """The outcome of a run, and its coordinates (V, 2) or (V, 3) in the target's customary place.

    Where folds are left in spite of all repairs, the mesh is embedded as a whole, if fewer are left then.
    """
    with run.clock.stage("place"):
        outcome, coordinates, folds = _placed(run, outcome)
    if folds and may_be_embedded(run, method, outcome):
        other = embedded(run, method, outcome.tried, f"{folds} {'fold is' if folds == 1 else 'folds are'} left")
        with run.clock.stage("place"):
            other, elsewhere, left = _placed(run, other)
        if left < folds:
            return other, elsewhere
    return outcome, coordinates


def _placed(run: Run, outcome: Outcome) -> tuple[Outcome, FloatArray, int]:
    """The outcome, its coordinates in their place, and how many folds are left.

    Placing rounds, which may fold faces that were not folded. A few folds are repaired where the map then lies. Where some are
    left, the map is placed by operations that do not round, and last repaired by all means. Repairs made here are recorded with
    the others.
    """
    done, mesh = outcome.done, run.mesh.bare
    target, unplaced = done.target, Unplaced(mesh, done.points, run.boundary, used_vertices(mesh))
    coordinates = target.place(unplaced, run.options.centre)
    folded = find_folds(target.space, mesh.faces, target.space.positions(coordinates))
    if len(folded) <= done.folds:
        return outcome, coordinates, len(folded)
    first = len(folded)
    if are_few(run, first):
        done, coordinates, folded = _repaired(run, done, coordinates, folded, local_repairs(run))
    if len(folded) and target.place_exactly is not None and run.options.centre is None:
        exact = target.place_exactly(unplaced)
        left = find_folds(target.space, mesh.faces, target.space.positions(exact))
        if len(left) < len(folded):
            coordinates, folded = exact, left
    if len(folded) and EMBED in run.options.repairs:
        done, coordinates, folded = _repaired(run, done, coordinates, folded, (EMBED,))
    return replace(outcome, done=done), coordinates, len(folded)


def _repaired(
    run: Run, done: Finished, coordinates: FloatArray, folded: IntArray, repairs: tuple[str, ...]
) -> tuple[Finished, FloatArray, IntArray]:
    """Repair folds of a map that is in its place; returns what is known of it then, its coordinates and its folds."""
    space, faces = done.target.space, run.mesh.bare.faces
    repaired = repair_folds(surroundings(run, done.target), space.positions(coordinates), repairs, folded)
    touched = np.union1d(done.repaired.touched, repaired.touched)
    records = done.repaired.records + repaired.records
    done = replace(done, repaired=replace(done.repaired, touched=touched, records=records))
    coordinates = space.coordinates(repaired.points)
    return done, coordinates, find_folds(space, faces, space.positions(coordinates))
