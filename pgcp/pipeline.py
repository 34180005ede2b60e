"""The whole of it, reading like PGCP Algorithm 3: check, split, flatten, weld, solve, assemble, place, measure."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pgcp.elimination.dirichlet import choose_backend
from pgcp.elimination.sparse_boundary import stays_sparse
from pgcp.errors import InputError, PgcpError
from pgcp.finish.quality import measure_quality, single_precision_folds
from pgcp.intake.check import Geometry
from pgcp.intake.chosen import inspected
from pgcp.intake.give_back import give_back
from pgcp.intake.given import Given, named_parts
from pgcp.intake.mend import Mended, unmended
from pgcp.intake.opened import Opened, Opener
from pgcp.io.read import read_cuts
from pgcp.methods.base import Method
from pgcp.methods.registry import method_of
from pgcp.options import AUTO, Options, Running, plain_options
from pgcp.parallel import limited_to
from pgcp.patches.run import Run
from pgcp.patches.warm_up import warm_up
from pgcp.plane.space import map_coefficients
from pgcp.polygons.triangulate import Triangles, triangulated
from pgcp.report.record import cut_report, run_report
from pgcp.retry.course import Outcome, map_mesh
from pgcp.retry.cut_open import Evenness, evenness
from pgcp.retry.placed import place_outcome
from pgcp.runtime.address_space import check_address_space
from pgcp.runtime.cache import Owner, drop_run
from pgcp.runtime.clock import Clock
from pgcp.runtime.executors import Executor, LocalExecutor, Progress, make_executor
from pgcp.runtime.job import Job
from pgcp.runtime.resume import resumable, run_key
from pgcp.runtime.sizing import Plan, make_plan
from pgcp.runtime.versions import package_versions
from pgcp.surface.squeeze import at_vertices, measured_scales
from pgcp.surface.topology import Topology
from pgcp.targets.base import Target
from pgcp.targets.fitting import Asked, check_centre_is_inside, check_options
from pgcp.types import ComplexArray, FloatArray, IntArray, Mesh, Origin, Parameterization, Quality, Source

_CLOSER = 0.5  # of the scale ratio: what further cuts are to bring it to where the map overlaps itself
_ROUNDS = 4  # of maps, each of a surface that is cut otherwise
_OTHER_COSTS = 2  # of these, how many are cut by other costs of edges; the last goes through more tips


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

            def mapped(taken: _Taken, number: int) -> _Mapped:
                """The map of what was taken in."""
                plan, owner = _planned(taken, running, executor), f"{name}{number or ''}"
                clock.executor = executor
                key = run_key(taken.mesh, taken.options, taken.cuts, plan.patches, backend)
                directory = at_last.enter_context(resumable(running, key))
                job = Job(Owner(owner), directory, options.flatten, backend, plan.factor_cache_bytes)
                run = _run(taken, plan, job, clock)
                with _tidied(executor, owner):
                    return _Mapped(taken, run, *place_outcome(run, method, map_mesh(run, method)))

            found = _cut_until_good(mapped, taken, clock)
            taken, outcome, coordinates = found.taken, found.outcome, found.coordinates
            mu = _coefficients(found.run, outcome, coordinates)
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
        return _result(found, mu, quality, where)


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
    options: Options
    chosen: Target | None = None
    cuts: IntArray | None = None
    whole: Mended | None = None
    opener: Opener | None = None
    opened: Opened | None = None

    @property
    def target(self) -> Target:
        """Where it is mapped."""
        assert self.chosen is not None
        return self.chosen

    def cut_open(self, opened: Opened) -> _Taken:
        """The same, its surface (``whole``) cut open."""
        assert self.whole is not None
        geometry = replace(self.geometry, mesh=opened.mesh)
        mended = opened.after(self.whole)
        return replace(self, mesh=opened.mesh, topology=opened.topology, geometry=geometry, mended=mended, opened=opened)


@dataclass(frozen=True, slots=True, eq=False)
class _Mapped:
    """What was taken in, the run that mapped it, and the map with its coordinates (V, 2) or (V, 3)."""

    taken: _Taken
    run: Run
    outcome: Outcome
    coordinates: FloatArray
    rounds: int = 1


def _cut_until_good(map_taken: Callable[[_Taken, int], _Mapped], taken: _Taken, clock: Clock) -> _Mapped:
    """The map of what was taken in; where a cut was looked for and the map is not good, the best one of further cuts."""
    found = best = map_taken(taken, 0)
    bound = taken.options.scale_bound
    if taken.opener is None or taken.opened is None or not np.isfinite(bound):
        return best
    least = _evenness(best)
    for number in range(1, _ROUNDS):
        if _evenness(found).is_good or not found.outcome.done.target.has_free_boundary:
            break
        with clock.stage("cut"):
            opened = taken.opener.automatic(bound, number) if number <= _OTHER_COSTS else _further(best, taken.opener, bound)
        if opened is None:
            break
        found = replace(map_taken(taken.cut_open(opened), number), rounds=number + 1)
        if _evenness(found) < least:
            best, least = found, _evenness(found)
    return replace(best, rounds=found.rounds)


def _further(best: _Mapped, opener: Opener, bound: float) -> Opened | None:
    """A cut through more tips than that of a map, where the map squeezes most; None where there is nothing to cut."""
    mesh, opened, reached = best.taken.mesh, best.taken.opened, _evenness(best)
    assert opened is not None
    wanted = bound if reached.excess > 1.0 else max(_CLOSER * reached.ratio, 1.0 + _CLOSER)
    return opener.further(opened, at_vertices(mesh, *measured_scales(mesh, best.coordinates)), wanted)


def _evenness(found: _Mapped) -> Evenness:
    """How good a map is."""
    done, taken = found.outcome.done, found.taken
    return evenness(taken.mesh, found.coordinates, found.run.boundary, done.folds, taken.options.scale_bound)


def _taken_in(source_of: Callable[[], Mesh | Source], method: Method, options: Options, clock: Clock) -> _Taken:
    """Read the mesh, check or mend it, and see which target is meant."""
    with clock.stage("read"):
        found = source_of()
        cut = triangulated(found) if isinstance(found, Source) else Triangles(found)
        mesh, source = cut.mesh, found if isinstance(found, Source) and not found.is_plain else None
    with clock.stage("check"):
        asked_for = Asked(options.target, method.targets, options.opens)
        given, seen = inspected(mesh, asked_for, options, None if source is None else named_parts(source, cut.corner_of))
        topology, geometry = seen.accepted()
        mended = seen.mended or unmended(given.mesh)
    taken = _Taken(source, cut, geometry.mesh, topology, geometry, given, mended, options)
    if options.opens:
        with clock.stage("cut"):
            taken = _cut_open(taken, mended)
    topology, mended, target = taken.topology, taken.mended, asked_for.chosen(taken.topology)
    if options.centre is not None:
        options = replace(options, centre=given.vertex_now(options.centre))
    check_options(options, given.mesh, target)
    options = _renumbered(options, mended)
    check_centre_is_inside(options.centre, topology, target)
    cuts = None if options.cuts is None else given.vertices_now(read_cuts(options.cuts))
    return replace(taken, chosen=target, options=options, cuts=cuts)


def _cut_open(taken: _Taken, whole: Mended) -> _Taken:
    """What was taken in, ``whole``, cut open as asked for; raises InputError where a file names no such cut."""
    options, mesh = taken.options, taken.geometry.mesh
    opener = Opener(mesh, taken.topology, _polygons_of(taken, whole))
    taken = replace(taken, whole=whole, opener=opener)
    if options.cut == AUTO:
        return taken.cut_open(opener.automatic(options.scale_bound))
    path = Path(options.cut)
    pairs = taken.given.vertices_now(read_cuts(path))
    if not np.array_equal(whole.vertex_of, np.arange(len(whole.stands_for))):
        raise InputError(f"{path}: the cut edges name vertices that --fix renumbers; cut the mesh that it writes")
    return taken.cut_open(opener.along(pairs, path))


def _polygons_of(taken: _Taken, whole: Mended) -> IntArray | None:
    """Of which polygon each face of the surface is, filler of none; None where there are triangles only."""
    if taken.source is None or taken.source.offsets is None or taken.cut.corner_of is None:
        return None
    face_of = whole.face_of if taken.given.face_of is None else taken.given.face_of[whole.face_of]
    polygons = np.searchsorted(taken.source.offsets, taken.cut.corner_of[face_of, 0], "right") - 1
    return np.concatenate([polygons, -1 - np.arange(whole.mesh.filler)])


def _run(taken: _Taken, plan: Plan, job: Job, clock: Clock) -> Run:
    """The run of a mesh that was taken in."""
    relaxed = taken.options.seams == "relax"
    is_sparse = relaxed and stays_sparse(sum(map(len, taken.topology.loops)), len(taken.mesh.vertices))
    job = replace(job, stores_operators=relaxed and not is_sparse)
    mollification = taken.geometry.mollification
    asked = taken.options, taken.cuts, plan.patches
    return Run(taken.mesh, taken.topology, taken.target, mollification, *asked, job, clock.executor, clock)


def _result(found: _Mapped, mu: ComplexArray, quality: Quality, where: dict[str, Any]) -> Parameterization:
    """The map in the surface's own unit, with its report."""
    taken, outcome, coordinates = found.taken, found.outcome, found.coordinates
    unit, mended, target = taken.geometry.unit, taken.mended, outcome.done.target
    fixes = [fix.as_record() for fix in mended.fixes]
    coordinates = coordinates * unit if target.keeps_scale else coordinates
    in_single = single_precision_folds(target.space, taken.mesh.bare.faces, coordinates)
    report = run_report(taken.mesh.bare, outcome, quality, taken.geometry.mollification * unit, fixes, where)
    report["single_precision_folds"] = in_single
    report["input"], report["components"] = [*taken.cut.notes, *taken.given.notes], []
    patch = outcome.done.mapped.parts.split.labels[: len(mu)]
    if taken.opened is not None:
        report |= cut_report(taken.opened.record, mended.mesh, coordinates, taken.options.scale_bound, found.rounds)
    name = target.space.coordinates_name
    is_part = taken.options.fix or taken.given.face_of is not None or taken.opened is not None
    if taken.given.is_whole and taken.source is None and taken.opened is None:
        vertex_of, face_of = (mended.vertex_of, mended.face_of) if is_part else (None, None)
        return Parameterization(
            mended.mesh.bare, coordinates, patch, mu, quality, target.name, report, vertex_of, face_of, name
        )
    back = give_back(taken.cut.mesh, taken.given, mended)
    vertex_of, face_of = (back.vertex_of, back.face_of) if is_part else (None, None)
    if report["overlap"]:
        now = np.zeros(len(mended.vertex_of), np.int64)
        now[back.point_of] = np.arange(len(back.point_of))
        report["overlap"] = {**report["overlap"], "edges": now[report["overlap"]["edges"]].tolist()}
    point_of = back.point_of if taken.opened is None else taken.opened.vertex_of[back.point_of]
    origin = Origin(point_of, back.vertex_of, back.corners(taken.cut.corner_of), taken.source)
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
