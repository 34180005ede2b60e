"""What is called from Python: one function with all options, one that takes them as objects, one that compares methods."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from pgcp.errors import FoldError, InputError, NumericalError
from pgcp.finish.side_by_side import beside_each_other
from pgcp.intake.check import inspect, inspect_mended
from pgcp.intake.given import ALL, LARGEST, Named, named_parts
from pgcp.intake.pieces import Pieces
from pgcp.io.objects import of_object
from pgcp.io.read import read_source
from pgcp.methods.registry import METHODS, check_own, only_own, own_options
from pgcp.options import AUTO, METHOD, NONE, REPAIRS, Options, Running, check_names
from pgcp.pipeline import map_surface
from pgcp.polygons.triangulate import Triangles, triangulated
from pgcp.report.comparison import Compared
from pgcp.report.record import fold_message
from pgcp.report.several import all_note, patches_of_all, quality_of_all, report_of_all
from pgcp.result import Result
from pgcp.runtime.executors import Progress, silent
from pgcp.surface.operators import face_areas
from pgcp.surface.topology import Topology
from pgcp.targets.fitting import Asked, fitting_names
from pgcp.targets.registry import TARGETS
from pgcp.types import Mesh, Origin, Parameterization, Source

_WORTH_WORKERS = 200_000  # faces of a component that worker processes are started for


def as_mesh(source: Any) -> Mesh:
    """Mesh from a path or an object; polygons are cut into triangles. See ``as_source``."""
    found = as_source(source)
    return triangulated(found).mesh if isinstance(found, Source) else found


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A surface as triangles: how it was cut into them, all else that its file holds, None for nothing, and its parts."""

    cut: Triangles
    source: Source | None
    named: Named | None


def surface_of(source: Any) -> Surface:
    """The surface of a mesh, a path, or an object with ``vertices`` and ``faces``, as it is; raises as ``read_mesh`` does."""
    found = as_source(source)
    if not isinstance(found, Source):
        return Surface(Triangles(found), None, None)
    cut, kept = triangulated(found), None if found.is_plain else found
    return Surface(cut, kept, None if kept is None else named_parts(kept, cut.corner_of))


def as_source(source: Any) -> Mesh | Source:
    """A Mesh as it is, all that the file of a path says, and what an object of another package holds (``io.objects``).

    Raises InputError, saying what was given, for anything else.
    """
    if isinstance(source, (Mesh, Source)):
        return source
    return read_source(source) if isinstance(source, (str, Path)) else of_object(source)


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
    if options.component == ALL:
        return _compute_all(source, options, running, progress)
    return Result.of(map_surface(lambda: as_source(source), options, running, progress))


def _compute_all(source: Any, options: Options, running: Running, progress: Progress) -> Result:
    """Map every component of a surface that fits the target, one after the other, and put the maps beside each other.

    Where the target is ``auto``, it is that of the largest component that can be mapped.
    """
    if options.centre is not None or options.cuts is not None or options.cut not in (NONE, AUTO):
        raise InputError("a centre, cuts and a cut along given edges are of one component; they do not go with component all")
    progress("read", 0, 0)
    surface = surface_of(source)
    name = surface.cut.mesh.name
    pieces = Pieces.of(surface.cut.mesh, options.weld_distance, surface.named)
    done, numbers, left, first = list[Parameterization](), list[int](), list[str](), None
    for number in range(pieces.count):
        target = done[0].target if done and options.target == AUTO else options.target
        each = replace(options, component=LARGEST, weld_distance=None, target=target)
        here = (
            running if len(pieces.faces_of(number)) >= _WORTH_WORKERS or running.is_elsewhere else replace(running, workers=0)
        )
        try:
            done.append(map_surface(lambda number=number: pieces.piece(number)[0], each, here, progress))  # type: ignore[misc]
            numbers.append(number)
        except (InputError, NumericalError) as problem:
            left.append(str(problem).removeprefix(f"{name}, "))
            first = first or problem
    if not done:
        assert first is not None
        raise first
    return _put_together(pieces, done, numbers, left, surface)


def _put_together(
    pieces: Pieces, done: list[Parameterization], numbers: list[int], left: list[str], surface: Surface
) -> Result:
    """Maps of components of these numbers as one, on the vertices and in the order of the input."""
    target = TARGETS.get(done[0].target)
    maps = [one.coordinates for one in done]
    if not target.space.closed:
        surfaces = [float(face_areas(one.mesh.vertices, one.mesh.faces).sum()) for one in done]
        maps = beside_each_other([one.mesh for one in done], maps, None if target.keeps_scale else surfaces)
    vertices, face_of = [], []
    for one, number in zip(done, numbers, strict=True):
        used = pieces.piece(number)[1]
        vertices.append(used if one.vertex_of is None else used[one.vertex_of])
        faces = pieces.faces_of(number)
        face_of.append(faces if one.face_of is None else faces[one.face_of])
    back = pieces.given_back(vertices, [one.mesh.faces for one in done], face_of)
    order = np.argsort(np.concatenate(face_of), kind="stable")
    component_of = np.repeat(np.arange(len(done)), [len(one.mesh.faces) for one in done])[order]
    quality = quality_of_all(done)
    said = [*surface.cut.notes, *pieces.whole.notes, all_note(len(done), left)]
    report = report_of_all(done, [pieces.name(number) for number in numbers], said, quality)
    points, begin = [], 0
    for one in done:
        own = np.arange(len(one.coordinates)) if one.origin is None else one.origin.point_of
        points.append(begin + own)
        begin += len(one.coordinates)
    point_of = np.concatenate(points)[back.point_of]
    origin = Origin(point_of, back.vertex_of, back.corners(surface.cut.corner_of), surface.source, component_of)
    patch, mu = np.concatenate(patches_of_all(done))[order], np.concatenate([one.mu for one in done])[order]
    return Result(
        back.mesh, np.concatenate(maps)[back.point_of], patch, mu, quality, target.name, report, back.vertex_of, back.face_of,
        target.space.coordinates_name, origin,
    )  # fmt: skip


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
    asked = Asked(options.target, opens=options.opens)
    topology = inspect_mended(mesh, asked).topology if options.fix else inspect(mesh, asked).accepted()[0]
    targets = fitting_names(topology, options.opens) if options.target == AUTO else [options.target]
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
    weld_distance: float | None = 0.0,
    component: str = "largest",
    cut: str | Path = NONE,
    max_area_distortion: float | None = None,
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

    With a ``cut``, any connected oriented surface is opened to a disk and mapped to the plane; ``result.vertex_of`` (V,) says
    which vertex of the input each vertex, split along the cut, is.

    source: a path, (vertices, faces), a Mesh, or a mesh of trimesh, pyvista, meshio, nibabel or open3d.
    progress(stage, done, total) is called when a stage begins, with total 0 while its tasks are not counted, and as they
    finish; the logger ``pgcp`` hears of stages too. The other options are those of ``Options`` (what is computed) and
    ``Running`` (where and how), and those that only the method has.

    Raises InputError (and its kinds) for input that cannot be mapped, NumericalError where a step fails; FoldError, whose
    ``result`` holds the map, where that has folded faces; StoppedError where workers, scheduler or store are lost.
    """
    # long: a keyword for every option
    if own:
        check_names(own, [f.name for kind in (Options, Running) for f in fields(kind) if f.name != "own"] + [*own_options()])
    as_given = partial(cast, Any)  # options are made of the type they have where they are checked
    options = Options(
        patches, target, centre, moebius, as_given(cuts), repair_cuts, method, flatten, seams, backend, seed, repairs,
        no_overlap, fix, polish, weld_distance, component, as_given(cut), max_area_distortion, own,
    )  # fmt: skip
    running = Running(
        workers, scheduler, as_given(scheduler_file), executor, as_given(store), factor_cache_bytes, memory_limit_bytes, resume,
        as_given(tls_ca), as_given(tls_cert), as_given(tls_key), client,
    )  # fmt: skip
    result = compute(source, options, running, progress)
    if result.quality.folds:
        raise FoldError(fold_message(result), result)
    return result
