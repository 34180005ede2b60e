"""Map the whole mesh at once, patch by patch, with the seams solved exactly: the answer does not depend on the cuts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pgcp.elimination.sparse_boundary import stays_sparse
from pgcp.errors import NumericalError, WeldFailedError
from pgcp.interface.factor import InterfaceFactor
from pgcp.interface.one_piece import OnePieceFactor
from pgcp.interface.puncture import (
    Opened,
    charts_of,
    close_on_sphere,
    close_region,
    large_faces,
    open_at,
    puncture_face,
    straightened,
)
from pgcp.patches.mapped import Mapped
from pgcp.patches.plan import plan_welds
from pgcp.patches.run import Run
from pgcp.patches.split import outer_edges
from pgcp.patches.stored import Parts, gathered, spread_out
from pgcp.patches.types import BoundaryCurve, Component, SeamPositions, SolveReport
from pgcp.patches.weld import start_component, subdivide
from pgcp.plane.curves import crosses_itself
from pgcp.plane.space import PLANE, find_folds, map_coefficients
from pgcp.surface.distortion import angle_errors
from pgcp.surface.operators import cotangent_laplacian
from pgcp.surface.topology import used_vertices
from pgcp.types import ComplexArray, IntArray, Mesh, Positions

_ROUGH_DEG = 1.0  # mean angle error from which on a closed mesh is opened at other faces as well
_MOST_FACES, _WORK = 5, 20_000  # how many, and vertices of all those maps together
_LEAST_GAIN = 1e-3  # of the error: less may be rounding, and the map is to be the same for any cuts


def eliminated(run: Run, parts: Parts, kept: IntArray) -> InterfaceFactor:
    """The whole mesh's Laplacian with all but some vertices eliminated, patch by patch."""
    plan = plan_welds(parts.split.table, parts.split.patch_count, run.is_closed)
    factor = InterfaceFactor(run.executor, parts.job, len(parts.patches), plan, kept, len(run.mesh.vertices))
    with run.clock.stage("eliminate"):
        factor.eliminate_patches()
    with run.clock.stage("merge"):
        factor.merge()
    return factor


def _whole_factor(run: Run, parts: Parts, kept: IntArray) -> InterfaceFactor | OnePieceFactor:
    """The same; in one piece that of the intrinsic triangulation, where there is one, and where all stays sparse."""
    mesh, intrinsic = run.mesh, run.intrinsic
    if intrinsic is None and (run.is_closed or not stays_sparse(len(kept), len(mesh.vertices))):
        return eliminated(run, parts, kept)
    with run.clock.stage("eliminate"):
        if intrinsic is not None:
            laplacian = intrinsic.laplacian(len(mesh.vertices))
        else:
            laplacian = cotangent_laplacian(mesh.vertices, mesh.faces, run.mollification)
        used = None if run.is_closed else used_vertices(mesh)
        return OnePieceFactor(laplacian, kept, run.job.backend, run.job.flattener, used)


def _extended(
    run: Run, parts: Parts, factor: InterfaceFactor | OnePieceFactor, values: ComplexArray
) -> tuple[ComplexArray, ComplexArray, list[SolveReport]]:
    """Positions z (V,) in the plane, mu (F,) and what is seen of the patches, from values (n_K,) at the kept vertices."""
    if isinstance(factor, OnePieceFactor):
        with run.clock.stage("solve"):
            z = factor.extend(values)
            return z, map_coefficients(PLANE, run.mesh, run.mesh.faces, z), []
    with run.clock.stage("solve"):
        solved = factor.extend_patches(factor.extend_seams(values))
    with run.clock.stage("assemble"):
        return *gathered(run, parts, PLANE), solved


def map_open_exactly(run: Run, parts: Parts, place: Callable[[Run, ComplexArray], SeamPositions]) -> Mapped:
    """DNCP or SCP of a whole open mesh; ``place`` says where its free boundary z (n_B,) goes in the target."""
    factor = _whole_factor(run, parts, run.boundary)
    with run.clock.stage("flatten"):
        z = factor.free_boundary(run.mesh.vertices[run.boundary])
    with run.clock.stage("constrain"):
        seams = place(run, z)
    on_boundary = spread_out(seams, len(run.mesh.vertices))[run.boundary]
    points, mu, solved = _extended(run, parts, factor, on_boundary)
    factor.release()
    return Mapped(parts, run.target, points, mu, seams, solved, details={"interface": factor.record()})


def as_it_is(run: Run, z: ComplexArray) -> SeamPositions:
    """The free boundary z (n_B,) as it is."""
    return SeamPositions(run.boundary, z)


def whole_boundary(run: Run, z: ComplexArray) -> Component:
    """The surface's boundary as a component of its own, subdivided; raises WeldFailedError where it crosses itself."""
    if crosses_itself(z):
        raise WeldFailedError(
            "the free boundary of the whole surface crosses itself and cannot be brought to the disk; weld it"
        )
    table = outer_edges(run.mesh, run.topology, run.mollification)
    loop = run.boundary
    parts = table.parts[table.rank(loop, np.roll(loop, -1))]
    return start_component(BoundaryCurve(0, loop, subdivide(z, parts)), run.mesh.vertices, table)


def map_closed_exactly(run: Run, parts: Parts) -> Mapped:
    """A whole closed mesh, opened at a face, mapped to the plane and closed on the sphere.

    Where the errors are large and the mesh is small, it is opened at some of its largest faces as well, and the map of least
    mean angle error is taken, of those with fewest folds.
    """
    triangles = run.mesh if run.intrinsic is None else Mesh(run.mesh.vertices, run.intrinsic.faces)
    best = _opened_and_closed(run, parts, triangles, puncture_face(triangles))
    error, folds = _error(run, best)
    if error < _ROUGH_DEG:
        return best
    for face in large_faces(triangles, min(_MOST_FACES, _WORK // len(triangles.vertices))):
        try:
            other = _opened_and_closed(run, parts, triangles, int(face))
        except NumericalError:
            continue
        there, left = _error(run, other)
        if (left, there) < (folds, (1.0 - _LEAST_GAIN) * error):
            best, error, folds = other, there, left
    return best


def _error(run: Run, mapped: Mapped) -> tuple[float, int]:
    """Mean angle error of a map, degrees, and its folds."""
    space = run.target.space
    folds = len(find_folds(space, run.mesh.faces, mapped.points))
    return float(angle_errors(run.mesh, space.coordinates(mapped.points)).mean()), folds


def _opened_and_closed(run: Run, parts: Parts, triangles: Mesh, face: int) -> Mapped:
    """The map of a whole closed mesh that is opened at one of the triangles."""
    opened = open_at(triangles, face)
    factor = _whole_factor(run, parts, opened.kept)
    with run.clock.stage("flatten"):
        z = factor.opened_positions()
    seams = SeamPositions(opened.kept, z)
    planar, _, solved = _extended(run, parts, factor, z)
    with run.clock.stage("close"):
        points = _closed(run, planar, opened, factor)
        mu = map_coefficients(run.target.space, run.mesh, run.mesh.faces, points)
        solved = seen_on_the_final_map(run, parts, solved, points, mu)
    factor.release()
    return Mapped(parts, run.target, points, mu, seams, solved, details={"interface": factor.record()})


def _closed(run: Run, z: ComplexArray, opened: Opened, factor: InterfaceFactor | OnePieceFactor) -> Positions:
    """The opened surface's planar map on the sphere, both sides of the second ring solved again in charts of their own."""
    points = close_on_sphere(run.mesh, straightened(run.mesh, z, opened.far))
    if opened.far.any():
        charts = factor.alternated(charts_of(points, opened))
        points = close_region(points, ~opened.far, factor.extend(charts.within()), charts.pole_beyond)
        points = close_region(points, opened.far, factor.extend(charts.beyond()), charts.pole_near)
    return points


def seen_on_the_final_map(
    run: Run, parts: Parts, solved: list[SolveReport], points: Positions, mu: ComplexArray
) -> list[SolveReport]:
    """Reports of the patches with folds and largest |mu| counted again on the final map."""
    labels, count = parts.split.labels, parts.split.patch_count
    folds = np.bincount(labels[find_folds(run.target.space, run.mesh.faces, points)], minlength=count)
    largest = np.zeros(count)
    np.maximum.at(largest, labels, np.abs(mu))
    return [
        replace(s, fold_count=int(folds[s.patch]), first_fold_count=int(folds[s.patch]), mu_max=float(largest[s.patch]))
        for s in solved
    ]
