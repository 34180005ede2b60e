"""Map the whole mesh at once, patch by patch, with the seams solved exactly: the answer does not depend on the cuts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from pgcp.assemble import used_vertices
from pgcp.beltrami import find_folds, map_coefficients
from pgcp.boundary_energy import plain_steps
from pgcp.ccem import ccem_map, cem_map
from pgcp.cdcp import cdcp_map, central_face, harmonic_boundary, late_heat, start_angles
from pgcp.constrain import constrain_to_disk
from pgcp.curves import crosses_itself
from pgcp.errors import WeldFailedError
from pgcp.exact import InterfaceFactor
from pgcp.operators import cotangent_laplacian
from pgcp.puncture import Opened, charts_of, close_on_sphere, close_region, open_at, puncture_face, straightened
from pgcp.run import Mapped, Parts, Run, gathered, spread_out
from pgcp.split import outer_edges, plan_welds
from pgcp.tasks import SolveReport
from pgcp.types import BoundaryCurve, ComplexArray, Component, IntArray, Positions, SeamPositions
from pgcp.weld import start_component, subdivide

_MINIMISE = {"cem": cem_map, "ccem": ccem_map}


def _eliminated(run: Run, parts: Parts, kept: IntArray) -> InterfaceFactor:
    """The whole mesh's Laplacian with all but some vertices eliminated."""
    plan = plan_welds(parts.split.table, parts.split.patch_count, not run.topology.loops)
    factor = InterfaceFactor(run.executor, parts.job, len(parts.patches), plan, kept, len(run.mesh.vertices))
    with run.clock.stage("eliminate"):
        factor.eliminate_patches()
    with run.clock.stage("merge"):
        factor.merge()
    return factor


def map_exactly(run: Run, parts: Parts, target: str) -> Mapped:
    """DNCP or SCP of the whole mesh, on the disk brought to the circle and on the sphere closed, by the interface operator."""
    mesh, clock = run.mesh, run.clock
    opened = open_at(mesh, puncture_face(mesh)) if target == "sphere" else None
    kept = run.boundary if opened is None else opened.kept
    factor = _eliminated(run, parts, kept)
    with clock.stage("flatten"):
        z = factor.opened_positions() if target == "sphere" else factor.free_boundary(mesh.vertices[kept])
    with clock.stage("constrain"):
        seams = SeamPositions(kept, z) if target != "disk" else constrain_to_disk(_whole_boundary(run, z))
    with clock.stage("solve"):
        solved = factor.extend_patches(factor.extend_seams(spread_out(seams, len(mesh.vertices))[kept]))
    points: Positions
    with clock.stage("assemble"):
        points, mu = gathered(run, parts, "free")
    if opened is not None:
        with clock.stage("close"):
            points = _closed(run, points, opened, factor)
            mu = map_coefficients(mesh, mesh.faces, points)
            solved = _seen_again(run, parts, solved, points, mu)
    factor.release()
    return Mapped(parts, target, [1] * len(parts.patches), solved, seams, points, mu, interface=factor.record())


def map_to_disk(run: Run, parts: Parts) -> Mapped:
    """CDCP, CEM or CCEM of the whole mesh, by the interface operator."""
    mesh, clock, loop = run.mesh, run.clock, run.boundary
    factor = _eliminated(run, parts, loop)
    with clock.stage("centre"):
        centre = central_face(mesh.vertices, mesh.faces, late_heat(loop, used_vertices(mesh), factor))
    iterations: tuple[dict[str, Any], ...] = ()
    converged = None
    with clock.stage("map"):
        if run.options.method == "cdcp":
            z = cdcp_map(mesh, loop, factor, centre, run.options.moebius == "auto").z
        else:
            start = start_angles(harmonic_boundary(mesh.vertices, mesh.faces[centre], factor))
            found = _MINIMISE[run.options.method](factor, _boundary_block(run), start)
            z, iterations, converged = found.z, tuple(plain_steps(found.steps)), found.converged
    record = factor.record()
    factor.release()
    mu = map_coefficients(mesh, mesh.faces, np.column_stack([z.real, z.imag]))
    pieces = [1] * len(parts.patches)
    solved = _seen_again(run, parts, [SolveReport(p.index, 0, 0, 0, 0.0, False) for p in parts.patches], z, mu)
    place = SeamPositions(loop, z[loop])
    return Mapped(parts, "disk", pieces, solved, place, z, mu, interface=record, iterations=iterations, converged=converged)


def _boundary_block(run: Run) -> csr_array:
    """The rows and columns of the Laplacian (n_B, n_B) at boundary vertices."""
    mesh, loop = run.mesh, run.boundary
    near = np.zeros(len(mesh.vertices), bool)
    near[loop] = True
    faces = mesh.faces[near[mesh.faces].any(axis=1)]
    return csr_array(cotangent_laplacian(mesh.vertices, faces, run.mollification)[loop][:, loop])


def _closed(run: Run, z: ComplexArray, opened: Opened, factor: InterfaceFactor) -> Positions:
    """The opened surface's planar map on the sphere, both sides of the second ring solved again in charts of their own."""
    points = close_on_sphere(run.mesh, straightened(run.mesh, z, opened.far))
    if opened.far.any():
        charts = factor.alternated(charts_of(points, opened))
        points = close_region(points, ~opened.far, factor.extend(charts.within()), charts.pole_beyond)
        points = close_region(points, opened.far, factor.extend(charts.beyond()), charts.pole_near)
    return points


def _seen_again(run: Run, parts: Parts, solved: list[SolveReport], points: Positions, mu: ComplexArray) -> list[SolveReport]:
    """What is said of every patch, for its final place."""
    labels, count = parts.split.labels, parts.split.patch_count
    folds = np.bincount(labels[find_folds(run.mesh.faces, points)], minlength=count)
    largest = np.zeros(count)
    np.maximum.at(largest, labels, np.abs(mu))
    return [
        replace(s, fold_count=int(folds[s.patch]), first_fold_count=int(folds[s.patch]), mu_max=float(largest[s.patch]))
        for s in solved
    ]


def _whole_boundary(run: Run, z: ComplexArray) -> Component:
    """The surface's boundary as a component of its own, subdivided."""
    if crosses_itself(z):
        raise WeldFailedError(
            "the free boundary of the whole surface crosses itself and cannot be brought to the disk; weld it"
        )
    table = outer_edges(run.mesh, run.topology, run.mollification)
    loop = run.boundary
    parts = table.parts[table.rank(loop, np.roll(loop, -1))]
    return start_component(BoundaryCurve(0, loop, subdivide(z, parts)), run.mesh.vertices, table)
