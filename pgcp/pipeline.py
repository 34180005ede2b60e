"""The whole of it, reading like PGCP Algorithm 3: split, flatten, weld, solve, assemble, measure."""

from __future__ import annotations

import platform
import tempfile
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from pgcp.assemble import collect, placed, used_vertices
from pgcp.beltrami import map_coefficients
from pgcp.check import check_centre, check_mesh, fitting_target, unit_mesh
from pgcp.constrain import constrain_to_disk, constrain_to_sphere, keep_free
from pgcp.correct import Correction, correct
from pgcp.dirichlet import choose_backend
from pgcp.errors import FoldError, InputError, SolveFailedError, WeldFailedError
from pgcp.executors import DaskExecutor, Executor, Progress, SerialExecutor, silent
from pgcp.io import read_cuts, read_mesh
from pgcp.operators import needed_mollification
from pgcp.options import Options
from pgcp.quality import measure_quality
from pgcp.repair import Repair, repair_folds
from pgcp.split import CROWDING, Split, cut_patch, split_mesh
from pgcp.store import PatchStore
from pgcp.tasks import Job, SolveReport, flatten_task, relax_task, solve_task, weld_closed_task, weld_task
from pgcp.topology import Topology
from pgcp.types import (
    BoundaryCurve,
    ComplexArray,
    Component,
    IntArray,
    Mesh,
    Parameterization,
    Patch,
    PatchMap,
    Positions,
    SeamPositions,
)
from pgcp.weld import start_component

_SEEDS = 3
_CONSTRAIN = {"free": keep_free, "disk": constrain_to_disk, "sphere": constrain_to_sphere}
_CORRECTION = {"free": "none", "disk": "auto", "sphere": "auto"}
_PACKAGES = ("pgcp", "numpy", "scipy", "numba", "networkx", "dask", "distributed", "pymetis", "mkl")


class _Clock:
    """Seconds and peak memory of the stages run so far."""

    def __init__(self) -> None:
        self.stages: list[dict[str, Any]] = []
        self.executor: Executor = SerialExecutor()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what is done inside."""
        start = time.perf_counter()
        yield
        seconds = time.perf_counter() - start
        self.stages.append({"name": name, "seconds": round(seconds, 4), "peak_bytes": self.executor.peak_bytes()})


def as_mesh(source: Any) -> Mesh:
    """Mesh from a Mesh, a path, or an object with ``vertices`` and ``faces`` (a trimesh.Trimesh)."""
    if isinstance(source, Mesh):
        return source
    if isinstance(source, (str, Path)):
        return read_mesh(source)
    if hasattr(source, "vertices") and hasattr(source, "faces"):
        return Mesh(np.asarray(source.vertices, np.float64), np.asarray(source.faces, np.int64))
    raise InputError(f"expected a mesh, a path or a trimesh, not {type(source).__name__}")


def _executor(options: Options, run: str, progress: Progress) -> SerialExecutor | DaskExecutor:
    if options.workers == 0 and options.scheduler is None and options.scheduler_file is None:
        return SerialExecutor(progress)
    return DaskExecutor(run, options.workers, options.scheduler, options.scheduler_file, progress)


def _weld_all(
    executor: Executor, mesh: Mesh, split: Split, curves: list[BoundaryCurve]
) -> tuple[Component, list[dict[str, int]]]:
    components = {c.patch: start_component(c, mesh.vertices, split.edges) for c in curves}
    notes: list[dict[str, int]] = []
    if split.patch_count == 1:
        (union,) = executor.map("weld", relax_task, list(components.values()))
        return union, notes
    for number, level in enumerate(split.plan.levels, 1):
        pairs = [(components.pop(step.left), components.pop(step.right)) for step in level]
        task = weld_closed_task if level[0].closed else weld_task
        for step, union in zip(level, executor.map(f"weld {number}", task, pairs), strict=True):
            components[step.result] = union
            notes.append({"left": step.left, "right": step.right, "level": step.level, "seam_edges": step.seam_edge_count})
    (union,) = components.values()
    return union, notes


def _spread_out(seams: SeamPositions, vertex_count: int) -> Positions:
    """Positions of all seam and boundary vertices in an array over all vertices, complex (V,) or (V, 3)."""
    out = np.zeros((vertex_count, *seams.points.shape[1:]), seams.points.dtype)
    out[seams.vertex_ids] = seams.points
    return out


def _versions() -> dict[str, str]:
    out = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            continue
    return out


def _plain(options: Options) -> dict[str, Any]:
    return {f.name: str(v) if isinstance(v := getattr(options, f.name), Path) else v for f in fields(Options)}


def parameterize(source: Any, *, progress: Progress = silent, **options: Any) -> Parameterization:
    """Map a simply connected surface conformally to the plane, the unit disk or the unit sphere (PGCP Algorithm 3).

    source: a Mesh, a path, or a trimesh.Trimesh. options: those of ``Options`` (patches, 6 or fewer on a small
    mesh; workers=0, target="auto", flatten="dncp", ...). progress(stage, done, total) is called as tasks finish.

    Raises InputError (and its kinds) for input that cannot be mapped, NumericalError where a step fails; FoldError,
    whose ``result`` holds the map, where the finished map has folded faces.
    """
    result = compute(source, Options(**options), progress)
    if result.quality.folds:
        raise FoldError(f"the map has {result.quality.folds} folded faces of {len(result.mesh.faces)}", result)
    return result


@dataclass(frozen=True, slots=True, eq=False)
class _Mapped:
    """One finished pass through all patches."""

    split: Split
    patches: list[Patch]
    curves: list[BoundaryCurve]
    solved: list[SolveReport]
    welds: list[dict[str, int]]
    seams: SeamPositions
    points: Positions
    mu: ComplexArray


def _map_patches(mesh: Mesh, split: Split, target: str, job: Job, executor: Executor, clock: _Clock) -> _Mapped:
    """Store, flatten, weld, constrain, solve and collect the patches of one split."""
    store = PatchStore(job.directory)
    patches = []
    with clock.stage("store"):
        for index in range(split.patch_count):
            patch = cut_patch(mesh, split, index)
            store.write_patch(patch)
            patches.append(patch)
    with clock.stage("flatten"):
        curves = executor.map("flatten", partial(flatten_task, job), range(split.patch_count))
    with clock.stage("weld"):
        union, welds = _weld_all(executor, mesh, split, curves)
    with clock.stage("constrain"):
        seams = _CONSTRAIN[target](union)
        positions = _spread_out(seams, len(mesh.vertices))
    with clock.stage("solve"):
        items = [(p.index, positions[p.vertex_ids[p.boundary]]) for p in patches]
        solved = executor.map("solve", partial(solve_task, job), items)
    with clock.stage("assemble"):
        maps = (PatchMap(s.patch, *store.read_map(s.patch), s.fold_count, s.mu_max) for s in solved)
        points, mu = collect(mesh, zip(patches, maps, strict=True), target)
    return _Mapped(split, patches, curves, solved, welds, seams, points, mu)


@dataclass(frozen=True, slots=True, eq=False)
class _Finished:
    """One finished map: positions, the faces whose image changed after the solve, what was corrected and repaired."""

    mapped: _Mapped
    points: Positions
    touched: IntArray
    correction: Correction | None
    repair: Repair | None
    seed: int

    @property
    def folds(self) -> int:
        """Folds that are left."""
        return self.repair.folds_after if self.repair is not None else 0


def _finish(
    mapped: _Mapped, mesh: Mesh, target: str, boundary: IntArray, seed: int, options: Options, clock: _Clock
) -> _Finished:
    """Correct a map and repair its folds; a correction that leaves folds is taken back."""
    with clock.stage("correct"):
        points, correction = _corrected(mesh, mapped.points, target, boundary, options)
    with clock.stage("repair"):
        fixed = boundary if target == "disk" else boundary[:0]
        points, touched, repair = repair_folds(mesh, points, fixed)
        if repair is not None and repair.folds_after and correction is not None and correction.share:
            points, touched, repair = repair_folds(mesh, mapped.points, fixed)
            correction = correction.undone()
    if (correction is not None and correction.share) or options.centre is not None:
        touched = np.arange(len(mesh.faces))
    return _Finished(mapped, points, touched, correction, repair, seed)


def _attempts(options: Options, closed: bool, count: int) -> list[tuple[int, float]]:
    """Seeds and weld orders to try, one after the other, until one gives a map without folds."""
    orders = CROWDING[closed]
    seeds = [options.seed] if options.cuts is not None else [options.seed + i for i in range(_SEEDS)]
    return [(seed, order) for seed in seeds for order in orders] if count > 2 else [(seed, orders[0]) for seed in seeds]


def _map_with_retries(
    mesh: Mesh,
    topology: Topology,
    target: str,
    mollification: float,
    options: Options,
    job: Job,
    executor: Executor,
    clock: _Clock,
) -> tuple[_Finished, list[dict[str, Any]]]:
    """Map the patches; where a weld fails or folds remain, try another weld order, then patches of another seed."""
    cuts = read_cuts(options.cuts) if options.cuts is not None else None
    count = options.patch_count(len(mesh.faces), 2 if target == "sphere" else 1)
    boundary = topology.loops[0] if topology.loops else np.empty(0, np.int64)
    failures: list[dict[str, Any]] = []
    best: _Finished | None = None
    problem: WeldFailedError | SolveFailedError | None = None
    for seed, order in _attempts(options, not topology.loops, count):
        with clock.stage("split"):
            split = split_mesh(mesh, topology, count, seed, cuts, options.repair_cuts, mollification, order)
        try:
            mapped = _map_patches(mesh, split, target, replace(job, run=f"{job.run}-{len(failures)}"), executor, clock)
        except (WeldFailedError, SolveFailedError) as caught:
            problem = caught
            failures.append({"seed": seed, "weld_order": order, "reason": str(caught)})
        else:
            finished = _finish(mapped, mesh, target, boundary, seed, options, clock)
            if best is None or finished.folds < best.folds:
                best = finished
            if finished.folds == 0:
                break
            failures.append({"seed": seed, "weld_order": order, "reason": f"{finished.folds} folds are left"})
        if split.patch_count == 1:
            break
    if best is None:
        raise problem if problem is not None else WeldFailedError("no weld order was tried")
    return best, failures


def _corrected(
    mesh: Mesh, points: Positions, target: str, boundary: IntArray, options: Options
) -> tuple[Positions, Correction | None]:
    """The Moebius correction asked for; a vertex at the centre of the disk leaves none."""
    method = _CORRECTION[target] if options.moebius == "auto" else options.moebius
    if method == "none" or (target == "disk" and options.centre is not None):
        return points, None
    return correct(mesh, points, target, method, boundary, np.flatnonzero(used_vertices(mesh)))


def compute(source: Any, options: Options, progress: Progress = silent) -> Parameterization:
    """As ``parameterize``, but a map with folds is returned like any other: its quality says so."""
    clock = _Clock()
    run = uuid.uuid4().hex[:12]
    backend = choose_backend(options.backend)
    with clock.stage("read"):
        mesh = as_mesh(source)
    with clock.stage("check"):
        topology = check_mesh(mesh, options.target)
        target = fitting_target(mesh.name, topology, options.target)
        check_centre(mesh, options.centre, options.moebius, target)
        original, (mesh, unit) = mesh, unit_mesh(mesh)
        mollification = needed_mollification(mesh.vertices, mesh.faces)
    with (
        tempfile.TemporaryDirectory(prefix="pgcp-", dir=options.store) as directory,
        _executor(options, run, progress) as executor,
    ):
        clock.executor = executor
        job = Job(run, Path(directory), options.flatten, backend, options.factor_cache_bytes)
        done, failures = _map_with_retries(mesh, topology, target, mollification, options, job, executor, clock)
        mapped = done.mapped
        with clock.stage("place"):
            boundary = topology.loops[0] if topology.loops else np.empty(0, np.int64)
            coordinates = placed(mesh, done.points, target, boundary, options.centre)
            mapped.mu[done.touched] = map_coefficients(mesh, mesh.faces[done.touched], coordinates)
        description = executor.describe()
    clock.executor = SerialExecutor()
    with clock.stage("measure"):
        quality = measure_quality(mesh, coordinates, mapped.mu)
    if target == "free":
        coordinates = coordinates * unit
    report = {
        "mesh": {"name": mesh.name, "vertices": len(mesh.vertices), "faces": len(mesh.faces)},
        "versions": _versions(),
        "options": _plain(options),
        "seed": done.seed,
        "backend": backend,
        "threads": description["threads_per_worker"],
        "executor": description,
        "stages": clock.stages,
        "patches": _patch_rows(mapped),
        "welds": mapped.welds,
        "retries": failures,
        "mollification": mollification * unit,
        "boundary_points": int(mapped.split.edges.parts.sum()),
        "target": target,
        "smallest_gap": mapped.seams.smallest_gap,
        "spread_points": mapped.seams.spread_count,
        "correction": asdict(done.correction) if done.correction is not None else None,
        "repairs": [asdict(done.repair)] if done.repair is not None else [],
        "quality": asdict(quality),
        "status": "good" if quality.folds == 0 else "folded",
    }
    return Parameterization(original, coordinates, mapped.split.labels, mapped.mu, quality, target, report)


def _patch_rows(mapped: _Mapped) -> list[dict[str, Any]]:
    return [
        {
            "index": p.index,
            "vertices": len(p.vertex_ids),
            "faces": len(p.face_ids),
            "boundary": len(p.boundary),
            "pieces": c.pieces,
            "folds": s.fold_count,
            "folds_before_raising": s.first_fold_count,
            "raised_weights": s.raised_weights,
            "mu_max": s.mu_max,
            "reused_factor": s.reused_factor,
        }
        for p, c, s in zip(mapped.patches, mapped.curves, mapped.solved, strict=True)
    ]
