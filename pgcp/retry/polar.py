"""A map solved in logarithms, from the tips of long thin parts, as one more attempt beside the welds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pgcp.errors import CrowdedError, SolveFailedError
from pgcp.folds.polar import disk_of, polar_map, sphere_of
from pgcp.methods.base import Method
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts
from pgcp.patches.types import SeamPositions
from pgcp.plane.mobius import balancing_step, boost, shift_disk
from pgcp.plane.space import map_coefficients
from pgcp.retry.finished import CROWDED, EMBED, Finished, finish, target_of
from pgcp.surface.distortion import angle_errors
from pgcp.surface.operators import face_areas
from pgcp.targets.registry import TARGETS
from pgcp.types import FloatArray, Mesh, Positions

_STEPS = 50
_SAMPLE = 100_000  # faces that tell a mean
_MOST_VERTICES = 400_000  # one process holds the whole mesh's factor


def may_be_solved_in_logarithms(run: Run, method: Method) -> bool:
    """Whether such an attempt is wanted: where maps may take the place of others, and one process can."""
    wanted = run.options.seams == "weld" and EMBED in run.options.repairs
    return wanted and method.to_target is not None and len(run.mesh.vertices) <= _MOST_VERTICES


def solved_in_logarithms(run: Run, method: Method, parts: Parts, positive: bool = False) -> Finished | None:
    """The finished map, its boundary on the unit circle if it has one; None where it cannot be solved."""
    mesh, space = run.mesh, run.target.space
    with run.clock.stage("logarithms"):
        try:
            polar = polar_map(mesh, run.boundary, run.mollification, run.job.backend, positive)
        except (SolveFailedError, CrowdedError):
            return None
        points: Positions = sphere_of(polar, mesh) if space.closed else disk_of(polar)
        finite: FloatArray = polar.w.real[np.isfinite(polar.w.real)]
        if np.ptp(finite) <= CROWDED:
            points = _balanced(run, points)
        details = {"logarithms": {"range": float(np.ptp(finite)), "positive_weights": positive}}
        none = np.empty(0, np.int64)
        mu = map_coefficients(space, mesh, mesh.faces, points)
    asked = target_of(run.target)
    goal = TARGETS.get(asked.gives_way_to) if asked.has_free_boundary and asked.gives_way_to else asked
    done = finish(run, method, Mapped(parts, goal, points, mu, SeamPositions(none, points[none]), [], None, details))
    return done if goal is asked else free_of(run, done)


def _balanced(run: Run, points: Positions) -> Positions:
    """A map after the Moebius map that balances it: of a sphere all vertices by area, of a disk its boundary by length."""
    mesh, space, loop = run.mesh, run.target.space, run.boundary
    if space.closed:
        share = np.bincount(mesh.faces.reshape(-1), np.repeat(face_areas(mesh.vertices, mesh.faces), 3), len(mesh.vertices))
        for _ in range(_STEPS):
            step = balancing_step(points, share / share.sum())
            if not step.any():
                break
            points = boost(points, -step)
        return points
    steps = np.linalg.norm(np.roll(mesh.vertices[loop], -1, axis=0) - mesh.vertices[loop], axis=1)
    weights = (steps + np.roll(steps, 1)) / (2.0 * steps.sum())
    for _ in range(_STEPS):
        step = balancing_step(np.column_stack([points[loop].real, points[loop].imag]), weights)
        if not step.any():
            break
        points = shift_disk(points, complex(step[0], step[1]))
        points[loop] /= np.abs(points[loop])
    return points


def free_of(run: Run, done: Finished) -> Finished:
    """A map to another target as the free map: with its correction, which is not one of the free map."""
    return replace(done, mapped=replace(done.mapped, target=run.target), correction=None)


def mean_error(run: Run, done: Finished) -> float:
    """Mean angle error of a map, degrees: after its repair, or before its correction, on which the choice should not depend."""
    return _mean_error(run, done, done.points if done.repaired.folds_before else done.mapped.points)


def final_error(run: Run, done: Finished) -> float:
    """Mean angle error of a map, degrees, after all."""
    return _mean_error(run, done, done.points)


def _mean_error(run: Run, done: Finished, points: Positions) -> float:
    mesh = run.mesh.bare
    sample = Mesh(mesh.vertices, mesh.faces[:: len(mesh.faces) // _SAMPLE | 1])
    return float(angle_errors(sample, done.target.space.coordinates(points)).mean())
