"""The whole of it, reading like PGCP Algorithm 3: split, flatten, weld, solve, assemble, measure."""

from __future__ import annotations

import hashlib
import json
import platform
import uuid
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import asdict, fields, replace
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from pgcp.assemble import placed
from pgcp.attempts import map_mesh
from pgcp.beltrami import covering_degree, find_folds, map_coefficients
from pgcp.check import check_centre, check_mended, checked, fitting_target
from pgcp.dirichlet import choose_backend
from pgcp.distortion import conformal_energy
from pgcp.errors import FoldError, InputError, NumericalError, PgcpError, StoppedError
from pgcp.executors import DaskExecutor, Executor, LocalExecutor, Progress, Security, silent
from pgcp.files import run_directory
from pgcp.io import read_cuts, read_mesh
from pgcp.mend import Mended, mend, unmended
from pgcp.options import DISK_METHODS, RUNNING, Options
from pgcp.parallel import at_once, limited_to
from pgcp.plan import Plan, make_plan
from pgcp.quality import measure_quality
from pgcp.run import Clock, Mapped, Run
from pgcp.tasks import Job, drop_run, warm_up
from pgcp.topology import Topology
from pgcp.types import Mesh, Parameterization

_NO_BOUNDARY_TO_HOLD = (
    "seams cannot be relaxed on a sphere: a closed surface has no boundary to hold, and harmonic maps of all of it collapse; "
    "choose --seams weld or --seams exact"
)
_STORE_FORMAT = 2
_PACKAGES = ("pgcp", "numpy", "scipy", "numba", "dask", "distributed", "pymetis", "mkl")


def as_mesh(source: Any) -> Mesh:
    """Mesh from a Mesh, a path, or an object with ``vertices`` and ``faces`` (a trimesh.Trimesh)."""
    if isinstance(source, Mesh):
        return source
    if isinstance(source, (str, Path)):
        return read_mesh(source)
    if hasattr(source, "vertices") and hasattr(source, "faces"):
        return Mesh(np.asarray(source.vertices, np.float64), np.asarray(source.faces, np.int64))
    raise InputError(f"expected a mesh, a path or a trimesh, not {type(source).__name__}")


def _executor(options: Options, run: str, progress: Progress) -> LocalExecutor | DaskExecutor:
    if options.workers == 0 and options.scheduler is None and options.scheduler_file is None:
        return LocalExecutor(progress, None if options.memory_limit_bytes is None else 1)
    security = None if (files := options.tls_files) is None else Security(*files)
    return DaskExecutor(run, options.workers, options.scheduler, options.scheduler_file, progress, security, warm_up)


def _processors(options: Options) -> AbstractContextManager[None]:
    """N workers on this machine mean N processors, between the stages that run on them as well."""
    return limited_to(options.workers) if options.starts_workers else nullcontext()


def _planned(mesh: Mesh, topology: Topology, options: Options, executor: Executor) -> Plan:
    """Number of patches and size of the factor cache."""
    workers = options.workers or (0 if isinstance(executor, LocalExecutor) else executor.describe()["workers"])
    sizes = len(mesh.vertices), len(mesh.faces)
    fewest = 1 if topology.loops else 2
    return make_plan(*sizes, workers, options.patches, fewest, options.memory_limit_bytes, options.factor_cache_bytes)


def _digest(array: np.ndarray) -> bytes:
    digest = hashlib.blake2b(f"{array.shape} {array.dtype}".encode())
    digest.update(array.view(np.uint8).data)
    return digest.digest()


def _run_key(mesh: Mesh, options: Options, patch_count: int, backend: str) -> str:
    """What a run's results depend on, in short: the mesh, the options that matter, the versions. Stores are named by it."""
    matters = {name: value for name, value in _plain(options).items() if name not in RUNNING}
    digest = hashlib.blake2b(digest_size=12)
    digest.update(json.dumps([matters, patch_count, backend, _versions(), _STORE_FORMAT], sort_keys=True).encode())
    if options.cuts is not None:
        digest.update(read_cuts(options.cuts).tobytes())
    for array_digest in at_once(*(partial(_digest, array) for array in (mesh.vertices, mesh.faces))):
        digest.update(array_digest)
    return digest.hexdigest()


@contextmanager
def _resumable(options: Options, key: str) -> Iterator[Path]:
    """The run's directory, kept where the run can be resumed; the error then says so."""
    with run_directory(options.store, key, options.resume) as directory:
        try:
            yield directory.path
        except (StoppedError, OSError) as problem:
            directory.keep = any(directory.path.glob("*/*-*.npz"))
            if isinstance(problem, StoppedError) and directory.keep:
                where = f"what is finished is kept in {directory.path}; run again with --resume"
                raise StoppedError(f"{problem}; {where}") from problem
            raise
        except (InputError, NumericalError):
            raise
        except BaseException:
            directory.keep = options.resume
            raise


@cache
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
        raise FoldError(fold_message(result), result)
    return result


@contextmanager
def _tidied(executor: Executor, run: str) -> Iterator[None]:
    """Free what processes still hold of a run when it is done or has failed."""
    try:
        yield
    except PgcpError:
        executor.everywhere(partial(drop_run, run))
        raise
    executor.everywhere(partial(drop_run, run))


def fold_message(result: Parameterization) -> str:
    """How many folds are left, where, and what was tried."""
    points = result.coordinates if result.target == "sphere" else result.coordinates @ [1, 1j]
    folded = find_folds(result.mesh.faces, points)
    where = ", ".join(str(f) for f in folded[:5].tolist()) + (", ..." if len(folded) > 5 else "")
    patches = np.unique(result.patch[folded]).tolist()
    repairs = result.report["repairs"]
    least = {r["method"]: min(s["folds_after"] for s in repairs if s["method"] == r["method"]) for r in repairs}
    steps = ", ".join(f"{method} (to {folds})" for method, folds in least.items())
    tried = f"{steps} of {repairs[0]['folds_before']}" if repairs else "none"
    return (
        f"the map has {len(folded)} folded faces of {len(result.mesh.faces)}: faces {where} in "
        f"{'patch' if len(patches) == 1 else 'patches'} {', '.join(map(str, patches[:5]))}; repairs tried: {tried}"
    )


def _resolved(options: Options) -> Options:
    """Options with what a method other than pgcp means: exact seams, or the disk."""
    if options.method in ("dncp", "scp"):
        return replace(options, method="pgcp", seams="exact", flatten=options.method, target="free")
    return replace(options, target="disk") if options.method in DISK_METHODS else options


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


def compute(source: Any, options: Options, progress: Progress = silent) -> Parameterization:
    """As ``parameterize``, but a map with folds is returned like any other: its quality says so."""
    with _processors(options):
        return _computed(source, options, progress)


def _computed(source: Any, options: Options, progress: Progress) -> Parameterization:
    clock = Clock()
    asked, options = options, _resolved(options)
    name = uuid.uuid4().hex[:12]
    backend = choose_backend(options.backend)
    with _executor(options, name, progress) as executor:
        with clock.stage("read"):
            mesh = as_mesh(source)
        with clock.stage("check"):
            mended = mend(mesh, options.target) if options.fix else unmended(mesh)
            topology, geometry = check_mended(mended, options.target) if options.fix else checked(mesh, options.target)
            target = fitting_target(mesh.name, topology, options.target)
            if options.seams == "relax" and target == "sphere":
                raise InputError(_NO_BOUNDARY_TO_HOLD)
            check_centre(mesh, options.centre, options.moebius, target)
            options = _renumbered(options, mended)
            mesh, unit, mollification = geometry.mesh, geometry.unit, geometry.mollification
            plan = _planned(mesh, topology, options, executor)
            key = _run_key(mesh, options, plan.patches, backend)
        clock.executor = executor
        with _resumable(options, key) as directory:
            job = Job(name, directory, options.flatten, backend, plan.factor_cache_bytes, options.seams == "relax")
            run = Run(mesh, topology, target, mollification, options, plan.patches, job, executor, clock)
            with _tidied(executor, name):
                outcome = map_mesh(run)
        done, mapped = outcome.done, outcome.done.mapped
        target = mapped.target
        with clock.stage("place"):
            whole, mesh = mesh, mesh.bare
            coordinates = placed(mesh, done.points, target, run.boundary, options.centre)
            changed = done.changed_faces if options.centre is None else np.arange(len(mesh.faces))
            changed = changed[changed < len(mesh.faces)]
            mapped.mu[changed] = map_coefficients(mesh, mesh.faces[changed], coordinates)
        description = executor.describe()
    clock.executor = LocalExecutor()
    with clock.stage("measure"):
        mu, patch = mapped.mu[: len(mesh.faces)], mapped.parts.split.labels[: len(mesh.faces)]
        quality = measure_quality(mesh, coordinates, mu)
        if target == "disk":
            quality = replace(quality, conformal_energy=conformal_energy(mesh, coordinates[:, 0] + 1j * coordinates[:, 1]))
        if target == "sphere" and whole.filler:
            quality = replace(quality, degree=covering_degree(whole.faces, coordinates))
    if target == "free":
        coordinates = coordinates * unit
    report = {
        "mesh": {"name": mesh.name, "vertices": len(mesh.vertices), "faces": len(mesh.faces)},
        "versions": dict(_versions()),
        "options": _plain(asked),
        "seed": mapped.parts.seed,
        "backend": backend,
        "threads": description["threads_per_worker"],
        "executor": description,
        "stages": clock.stages,
        "tasks": executor.taken,
        "patches": _patch_rows(mapped),
        "welds": list(mapped.welds),
        "retries": outcome.failures,
        "mollification": mollification * unit,
        "seams": mapped.seams_by,
        "interface": mapped.interface,
        "iterations": list(mapped.iterations),
        "converged": mapped.converged,
        "boundary_points": int(mapped.parts.split.edges.parts.sum()),
        "target": target,
        "smallest_gap": mapped.seams.smallest_gap,
        "spread_points": mapped.seams.spread_count,
        "correction": asdict(done.correction) if done.correction is not None else None,
        "repairs": [asdict(repair) for repair in done.repaired.records],
        "overlap": outcome.overlap,
        "fallback": outcome.fallback,
        "fixes": [fix.as_record() for fix in mended.fixes],
        "quality": asdict(quality),
        "status": "good" if quality.folds == 0 else "folded",
    }
    lines_up = (mended.vertex_of, mended.face_of) if options.fix else (None, None)
    return Parameterization(mended.mesh.bare, coordinates, patch, mu, quality, target, report, *lines_up)


def _patch_rows(mapped: Mapped) -> list[dict[str, Any]]:
    """What the report says of every patch; of an embedding as a whole, which solves no patch, only what they are."""
    rows: list[dict[str, Any]] = [
        {"index": p.index, "vertices": p.vertex_count, "faces": p.face_count, "boundary": len(p.boundary_ids)}
        for p in mapped.parts.patches
    ]
    for row, pieces, solved in zip(rows, mapped.pieces, mapped.solved, strict=False):
        row |= {
            "pieces": pieces,
            "folds": solved.fold_count,
            "folds_before_raising": solved.first_fold_count,
            "raised_weights": solved.raised_weights,
            "mu_max": solved.mu_max,
            "reused_factor": solved.reused_factor,
        }
    return rows
