"""A map that is harmonic on the intrinsic Delaunay triangulation, as one more attempt, for meshes with needles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pgcp.errors import NumericalError, PartitionInputError
from pgcp.folds.embed import drawn_back
from pgcp.folds.repair import repair_folds
from pgcp.methods.base import Method
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts
from pgcp.retry.finished import EMBED, Finished, finish, surroundings
from pgcp.surface.intrinsic import intrinsic_delaunay, share_not_delaunay

LARGE_DEG = 3.0  # mean angle error from which on a map is compared with this one
NOISY_DEG = 1.0  # the same where many edges have negative weights
_MANY = 0.15  # share of such edges that is many
_FEW = 0.005  # share up to which it would be the same map
_MOST_VERTICES = 200_000  # one process holds the whole mesh's factor
_REPAIRS = ("average", "untangle")


def may_help(run: Run, method: Method, error: float) -> bool:
    """Whether such an attempt is wanted beside a map with this mean angle error in degrees.

    It is where another map may take that one's place, one process can solve it, and many edges have negative weights.
    """
    wanted = run.options.seams == "weld" and EMBED in run.options.repairs and method.to_target is not None
    if not wanted or error < NOISY_DEG or len(run.mesh.vertices) > _MOST_VERTICES:
        return False
    share = share_not_delaunay(run.mesh, run.topology.twins, run.mollification)
    return share > (_FEW if error >= LARGE_DEG else _MANY)


def solved_intrinsically(run: Run, method: Method, parts: Parts) -> Finished | None:
    """The finished map, with its seams solved exactly; None where it cannot be solved.

    Faces of the mesh may be folded though no triangle is. They are unfolded by positive weights, and the rest is then drawn
    back to where it was.
    """
    with run.clock.stage("intrinsic"):
        intrinsic = intrinsic_delaunay(run.mesh, run.topology.twins, run.mollification)
    try:
        mapped = run.target.solve_exactly(replace(run, intrinsic=intrinsic), parts)
        done = finish(run, method, replace(mapped, details={"intrinsic": {"flips": intrinsic.flips}}))
    except (NumericalError, PartitionInputError):
        return None
    if done.folds == 0:
        return done
    with run.clock.stage("repair"):
        here, wanted = surroundings(run, done.target), done.points
        repaired = repair_folds(here, wanted, tuple(name for name in _REPAIRS if name in run.options.repairs))
        if repaired.folds == 0:
            points = drawn_back(here.space, run.mesh.faces, repaired.points, wanted, here.fixed("average"))
            touched = np.arange(len(run.mesh.faces))
            repaired = replace(repaired, points=points, touched=touched)
        records = done.repaired.records + repaired.records
        return replace(done, repaired=replace(repaired, records=records, folds_before=done.repaired.folds_before))
