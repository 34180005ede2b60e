"""The whole of it, reading like PGCP Algorithm 3: check, split, flatten, weld, solve, assemble, place, measure."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from pgcp.elimination.dirichlet import choose_backend
from pgcp.errors import InputError, PgcpError
from pgcp.finish.quality import measure_quality, single_precision_folds
from pgcp.intake.check import Geometry
from pgcp.intake.chosen import inspected
from pgcp.intake.give_back import give_back
from pgcp.intake.given import Given, named_parts
from pgcp.intake.mend import Mended, unmended
from pgcp.io.read import read_cuts
from pgcp.methods.base import Method
from pgcp.methods.registry import method_of
from pgcp.options import Options, Running, plain_options
from pgcp.parallel import limited_to
from pgcp.patches.run import Run
from pgcp.patches.warm_up import warm_up
from pgcp.plane.space import map_coefficients
from pgcp.polygons.triangulate import Triangles, triangulated
from pgcp.report.record import run_report
from pgcp.retry.course import Outcome, map_mesh
from pgcp.retry.placed import place_outcome
from pgcp.runtime.address_space import check_address_space
from pgcp.runtime.cache import Owner, drop_run
from pgcp.runtime.clock import Clock
from pgcp.runtime.executors import Executor, LocalExecutor, Progress, make_executor
from pgcp.runtime.job import Job
from pgcp.runtime.resume import resumable, run_key
from pgcp.runtime.sizing import Plan, make_plan
from pgcp.runtime.versions import package_versions
from pgcp.surface.topology import Topology
from pgcp.targets.base import Target
from pgcp.targets.fitting import Asked, check_centre_is_inside, check_options
from pgcp.types import ComplexArray, FloatArray, IntArray, Mesh, Origin, Parameterization, Quality, Source


def map_surface(
    source_of: Callable[[], Mesh | Source], asked: Options, running: Running, progress: Progress
) -> Parameterization:
    """Map a simply connected surface conformally to a target (PGCP Algorithm 3); ``source_of`` reads it.

    Split, flatten, weld and solve are the method's (``methods.pgcp``), constrain and place the target's.
    """
    with limited_to(running.workers) if running.starts_workers else nullcontext():
        clock, name = Clock(progress), uuid.uuid4().hex[:12]
        method, options = method_of(asked)
        backend = choose_backend(options.backend)
        # what tasks write to goes when no worker writes any more
        with ExitStack() as at_last, make_executor(running, name, clock.progress, warm_up) as executor:
            taken = _taken_in(source_of, method, options, clock)
            plan = _planned(taken, running, executor)
            clock.executor = executor
            key = run_key(taken.mesh, taken.options, taken.cuts, plan.patches, backend)
            directory = at_last.enter_context(resumable(running, key))
            run = _run(taken, plan, Job(Owner(name), directory, options.flatten, backend, plan.factor_cache_bytes), clock)
            with _tidied(executor, name):
                outcome, coordinates = place_outcome(run, method, map_mesh(run, method))
            mu = _coefficients(run, outcome, coordinates)
            description = executor.describe()
        clock.executor = LocalExecutor()
        with clock.stage("measure"):
            quality = _measured(taken.mesh, outcome.done.target, coordinates, mu)
        where = {
            "versions": dict(package_versions()),
            "options": {**plain_options(replace(asked, own=options.own)), **plain_options(running)},
            "backend": backend,
            "threads": description["threads_per_worker"],
            "executor": description,
            "stages": clock.stages,
            "tasks": executor.taken,
            "timeline": clock.timeline(executor),
        }
        return _result(taken, outcome, coordinates, mu, quality, where)


@dataclass(frozen=True, slots=True, eq=False)
class _Taken:
    """A mesh that can be mapped, of about unit size at the origin, and what it was made from."""

    source: Source | None
    cut: Triangles
    mesh: Mesh
    topology: Topology
    geometry: Geometry
    given: Given
    mended: Mended
    target: Target
    options: Options
    cuts: IntArray | None


def _taken_in(source_of: Callable[[], Mesh | Source], method: Method, options: Options, clock: Clock) -> _Taken:
    """Read the mesh, check or mend it, and see which target is meant."""
    with clock.stage("read"):
        found = source_of()
        cut = triangulated(found) if isinstance(found, Source) else Triangles(found)
        mesh, source = cut.mesh, found if isinstance(found, Source) and not found.is_plain else None
    with clock.stage("check"):
        asked_for = Asked(options.target, method.targets)
        given, seen = inspected(mesh, asked_for, options, None if source is None else named_parts(source, cut.corner_of))
        topology, geometry = seen.accepted()
        mended, target = seen.mended or unmended(given.mesh), asked_for.chosen(topology)
        if options.centre is not None:
            options = replace(options, centre=given.vertex_now(options.centre))
        check_options(options, given.mesh, target)
        options = _renumbered(options, mended)
        check_centre_is_inside(options.centre, topology, target)
        cuts = None if options.cuts is None else given.vertices_now(read_cuts(options.cuts))
        return _Taken(source, cut, geometry.mesh, topology, geometry, given, mended, target, options, cuts)


def _run(taken: _Taken, plan: Plan, job: Job, clock: Clock) -> Run:
    """The run of a mesh that was taken in."""
    job = replace(job, stores_operators=taken.options.seams == "relax")
    mollification = taken.geometry.mollification
    asked = taken.options, taken.cuts, plan.patches
    return Run(taken.mesh, taken.topology, taken.target, mollification, *asked, job, clock.executor, clock)


def _result(
    taken: _Taken, outcome: Outcome, coordinates: FloatArray, mu: ComplexArray, quality: Quality, where: dict[str, Any]
) -> Parameterization:
    """The map in the surface's own unit, with its report."""
    unit, mended, target = taken.geometry.unit, taken.mended, outcome.done.target
    fixes = [fix.as_record() for fix in mended.fixes]
    coordinates = coordinates * unit if target.keeps_scale else coordinates
    in_single = single_precision_folds(target.space, taken.mesh.bare.faces, coordinates)
    report = run_report(taken.mesh.bare, outcome, quality, taken.geometry.mollification * unit, fixes, where)
    report["single_precision_folds"] = in_single
    report["input"], report["components"] = [*taken.cut.notes, *taken.given.notes], []
    patch = outcome.done.mapped.parts.split.labels[: len(mu)]
    name, is_part = target.space.coordinates_name, taken.options.fix or taken.given.face_of is not None
    if taken.given.is_whole and taken.source is None:
        vertex_of, face_of = (mended.vertex_of, mended.face_of) if is_part else (None, None)
        return Parameterization(
            mended.mesh.bare, coordinates, patch, mu, quality, target.name, report, vertex_of, face_of, name
        )
    back = give_back(taken.cut.mesh, taken.given, mended)
    vertex_of, face_of = (back.vertex_of, back.face_of) if is_part else (None, None)
    origin = Origin(back.point_of, back.vertex_of, back.corners(taken.cut.corner_of), taken.source)
    coordinates = coordinates[back.point_of]
    return Parameterization(back.mesh, coordinates, patch, mu, quality, target.name, report, vertex_of, face_of, name, origin)


def _planned(taken: _Taken, running: Running, executor: Executor) -> Plan:
    """Number of patches and size of the factor cache."""
    workers = running.workers or executor.describe()["workers"]
    sizes, fewest = (len(taken.mesh.vertices), len(taken.mesh.faces)), 1 if taken.topology.loops else 2
    limits = running.memory_limit_bytes, running.factor_cache_bytes
    plan = make_plan(*sizes, workers, taken.options.patches, fewest, *limits)
    check_address_space(*sizes, plan.patches, 0 if workers else 1)
    return plan


@contextmanager
def _tidied(executor: Executor, run: str) -> Iterator[None]:
    """Free what processes still hold of a run when it is done or has failed."""
    try:
        yield
    except PgcpError:
        executor.everywhere(partial(drop_run, run))
        raise
    executor.everywhere(partial(drop_run, run))


def _renumbered(options: Options, mended: Mended) -> Options:
    """Options in the numbers of the mended mesh's vertices."""
    if np.array_equal(mended.vertex_of, np.arange(len(mended.stands_for))):
        return options
    if options.cuts is not None:
        raise InputError(f"{options.cuts}: the cut edges name vertices that --fix renumbers; cut the mesh that it writes")
    if options.centre is None:
        return options
    centre = mended.vertex_now(options.centre)
    if centre is None:
        raise InputError(f"the centre is vertex {options.centre}, which --fix leaves out")
    return replace(options, centre=centre)


def _coefficients(run: Run, outcome: Outcome, coordinates: FloatArray) -> ComplexArray:
    """Beltrami coefficients (F,) of all faces but filler, of the map in its place."""
    done, mesh, centre = outcome.done, run.mesh.bare, run.options.centre
    space = done.target.space
    mu = done.mapped.mu[: len(mesh.faces)].copy()
    changed = done.changed_faces if centre is None else np.arange(len(mesh.faces))
    changed = changed[changed < len(mesh.faces)]
    mu[changed] = map_coefficients(space, mesh, mesh.faces[changed], space.positions(coordinates))
    return mu


def _measured(mesh: Mesh, target: Target, coordinates: FloatArray, mu: ComplexArray) -> Quality:
    """Quality of a map of the mesh without its filler; that is part of what covers a sphere."""
    quality = measure_quality(mesh.bare, target.space, coordinates, mu)
    if target.energy is not None:
        quality = replace(quality, conformal_energy=target.energy(mesh.bare, coordinates))
    if mesh.filler:
        quality = replace(quality, degree=target.space.degree(mesh.faces, target.space.positions(coordinates)))
    return quality
