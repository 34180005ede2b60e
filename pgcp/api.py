"""What is called from Python: one function with all options, one that takes them as objects, one that compares methods."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from pgcp.errors import FoldError, InputError, NumericalError
from pgcp.intake.check import inspect, inspect_mended
from pgcp.io.read import read_mesh
from pgcp.methods.registry import METHODS, check_own, only_own, own_options
from pgcp.options import AUTO, METHOD, REPAIRS, Options, Running, check_names
from pgcp.pipeline import map_surface
from pgcp.report.comparison import Compared
from pgcp.report.record import fold_message
from pgcp.result import Result
from pgcp.runtime.executors import Progress, silent
from pgcp.surface.topology import Topology
from pgcp.targets.fitting import Asked, fitting_names
from pgcp.types import Mesh


def as_mesh(source: Any) -> Mesh:
    """Mesh from a Mesh, a path, or an object with ``vertices`` and ``faces`` (a trimesh.Trimesh)."""
    if isinstance(source, Mesh):
        return source
    if isinstance(source, (str, Path)):
        return read_mesh(source)
    if hasattr(source, "vertices") and hasattr(source, "faces"):
        return Mesh(np.asarray(source.vertices, np.float64), np.asarray(source.faces, np.int64))
    raise InputError(f"expected a mesh, a path or a trimesh, not {type(source).__name__}")


def check_mesh(mesh: Mesh, target: str = AUTO) -> Topology:
    """Examine a mesh and refuse one that the target does not fit; auto takes open disks and closed spheres.

    Raises NotManifoldError, NotSimplyConnectedError or DegenerateError, saying what the mesh is and where it is wrong, and
    what ``--fix`` would do where that makes it fit.
    """
    return inspect(mesh, Asked(target)).accepted()[0]


def compute(source: Any, options: Options | None = None, running: Running | None = None, progress: Progress = silent) -> Result:
    """As ``parameterize``, but a map with folds is returned like any other: its quality says so."""
    options, running = Options() if options is None else options, Running() if running is None else running
    for name, given, kind in (("options", options, Options), ("running", running, Running)):
        if not isinstance(given, kind):
            raise InputError(f"{name} is {given!r}, it must be of type pgcp.{kind.__name__}")
    if not callable(progress):
        raise InputError(f"progress is {progress!r}, it must be a function of stage, done and total")
    return Result.of(map_surface(lambda: as_mesh(source), options, running, progress))


def compare(
    source: Any,
    methods: Sequence[str] | None = None,
    options: Options | None = None,
    running: Running | None = None,
    progress: Progress = silent,
) -> list[Compared]:
    """Map a surface by several methods and put the maps beside each other.

    methods: their names, None for all. options: as for every other map; where their target is ``auto``, each method maps to
    every target that it has and that fits the surface. A method that fails is a row that says why.
    Raises InputError where the surface cannot be mapped at all, or a method is unknown or has no such target.
    """
    options = options or Options()
    mesh = as_mesh(source)
    topology = inspect_mended(mesh, Asked(options.target)).topology if options.fix else check_mesh(mesh, options.target)
    targets = fitting_names(topology) if options.target == AUTO else [options.target]
    pairs = [
        (target, method)
        for target in targets
        for method in ([METHODS.get(name) for name in methods] if methods else METHODS.all())
        if method.targets is None or target in method.targets
    ]
    if not pairs:
        named = ", ".join(methods or METHODS.names())
        raise InputError(f"of the methods {named}, none maps to the target {' or '.join(targets)}")
    check_own(options, [method for _, method in pairs])
    rows = []
    for number, (target, method) in enumerate(pairs):
        progress("compare", number, len(pairs))
        started, result, problem = time.perf_counter(), None, ""
        try:
            result = compute(mesh, replace(only_own(options, method), target=target, method=method.name), running, progress)
        except (InputError, NumericalError) as failure:
            problem = str(failure)
        rows.append(Compared(method.name, target, time.perf_counter() - started, result, problem))
    progress("compare", len(pairs), len(pairs))
    return rows


def parameterize(
    source: Any,
    *,
    progress: Progress = silent,
    patches: int | None = None,
    target: str = AUTO,
    centre: int | None = None,
    moebius: str = AUTO,
    polish: str = "none",
    cuts: str | Path | None = None,
    repair_cuts: bool = False,
    method: str = METHOD,
    flatten: str = "dncp",
    seams: str = "weld",
    backend: str = AUTO,
    seed: int = 0,
    repairs: tuple[str, ...] = REPAIRS,
    no_overlap: bool = False,
    fix: bool = False,
    workers: int = 0,
    scheduler: str | None = None,
    scheduler_file: str | Path | None = None,
    executor: str = AUTO,
    store: str | Path | None = None,
    factor_cache_bytes: int | None = None,
    memory_limit_bytes: int | None = None,
    resume: bool = False,
    tls_ca: str | Path | None = None,
    tls_cert: str | Path | None = None,
    tls_key: str | Path | None = None,
    client: Any = None,
    **own: Any,
) -> Result:
    """Map a simply connected surface conformally to the plane, the unit disk or the unit sphere (PGCP Algorithm 3).

    source: a Mesh, a path, or a trimesh.Trimesh. progress(stage, done, total) is called when a stage begins, with total 0
    while its tasks are not counted, and as they finish; the logger ``pgcp`` hears of stages too. The other options are those
    of ``Options`` (what is computed) and ``Running`` (where and how), and those that only the method has.

    Raises InputError (and its kinds) for input that cannot be mapped, NumericalError where a step fails; FoldError,
    whose ``result`` holds the map, where the finished map has folded faces; StoppedError where workers, scheduler or store
    are lost.
    """
    if own:
        check_names(own, [f.name for kind in (Options, Running) for f in fields(kind) if f.name != "own"] + [*own_options()])
    as_given = partial(cast, Any)  # options are made of the type they have where they are checked
    options = Options(
        patches, target, centre, moebius, as_given(cuts), repair_cuts, method, flatten, seams, backend, seed, repairs,
        no_overlap, fix, polish, own,
    )  # fmt: skip
    running = Running(
        workers, scheduler, as_given(scheduler_file), executor, as_given(store), factor_cache_bytes, memory_limit_bytes, resume,
        as_given(tls_ca), as_given(tls_cert), as_given(tls_key), client,
    )  # fmt: skip
    result = compute(source, options, running, progress)
    if result.quality.folds:
        raise FoldError(fold_message(result), result)
    return result
