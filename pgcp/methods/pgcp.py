"""Map patch by patch as PGCP does: flatten each, weld them along their seams, constrain the union, solve each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

from pgcp.elimination.sparse_boundary import SparseFactor, stays_sparse
from pgcp.errors import CrowdedError, LostFileError, SolveFailedError, WeldFailedError
from pgcp.interface.factor import InterfaceFactor
from pgcp.interface.whole_mesh import seen_on_the_final_map
from pgcp.methods.base import EXACT, FAILURES, Attempt, Choice, Failure, Method, Route
from pgcp.patches.mapped import Mapped, Weld
from pgcp.patches.plan import MOST_PLANS, plans
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts, gathered, mapped_through_store, spread_out
from pgcp.patches.tasks import flatten_task, prepare_task, relax_task, solve_task, weld_task
from pgcp.patches.types import BoundaryCurve, Component, SeamPositions, SolveReport, WeldPlan
from pgcp.patches.weld import start_component
from pgcp.plane.space import map_coefficients
from pgcp.runtime.executors import Join, JoinTree, Speculation, Tasks
from pgcp.surface.operators import cotangent_laplacian
from pgcp.surface.topology import used_vertices
from pgcp.types import ComplexArray, Positions

_SEEDS = 3
_LONGEST = 3000  # boundary vertices: exact seams need a dense matrix with two rows for each


class Welding:
    """The welds of a plan whose unions are not in the store, as the executor's present tree of joins.

    ``put_curve`` gives a patch's boundary. When a patch has been flattened, its second pass is prepared speculatively.
    """

    def __init__(self, run: Run, parts: Parts, plan: WeldPlan, crowding: float) -> None:
        kind = f"union-{crowding:g}"
        self._needed, unions, joins = {2 * parts.split.patch_count - 2}, dict[int, Component](), list[Join]()
        for step in reversed(plan.steps):
            if step.result not in self._needed:
                continue
            union = parts.store.find(kind, step.result, Component)
            if union is not None:
                unions[step.result] = union
                continue
            self._needed |= {step.left, step.right}
            task = partial(weld_task, parts.job, kind, step.result, step.closed)
            joins.append(Join(step.left, step.right, step.result, task))
        self._executor = run.executor
        self._joining = run.executor.join(JoinTree("weld", joins[::-1], len(plan.steps) - len(joins)))
        for name, union in unions.items():
            self._joining.put(name, union)
        self._vertices, self._edges = run.mesh.vertices, parts.split.edges
        self._prepare = partial(prepare_task, parts.job)
        # where seams are solved as well, the first pass has cached the factors
        can_cache = run.options.seams != "relax" and parts.job.factor_cache_bytes > 0
        self._unprepared = {patch.index for patch in parts.patches if can_cache}

    def put_curve(self, curve: BoundaryCurve) -> None:
        """Give a patch's boundary curve, where a weld needs it."""
        if curve.patch in self._needed:
            self._joining.put(curve.patch, start_component(curve, self._vertices, self._edges))
        if curve.patch in self._unprepared:
            self._unprepared.remove(curve.patch)
            self._executor.speculate(Speculation("prepare", curve.patch, self._prepare, curve.patch))

    @property
    def boundary(self) -> Component:
        """The boundary of a single patch, which nothing is welded to."""
        (boundary,) = self._joining.values.values()
        return boundary

    def union(self) -> Component:
        """Do the welds that are left; returns the union of all patches."""
        (union,) = self._joining.results().values()
        return union


def flatten(run: Run, parts: Parts, plan: WeldPlan, welding: Welding) -> list[BoundaryCurve]:
    """Flatten all patches, and meanwhile weld by a plan what is there: first the patches that are at the bottom of its tree."""
    items = {patch.index: patch.index for patch in parts.patches}
    level = {leaf: step.level for step in plan.steps for leaf in (step.left, step.right)}
    with run.clock.stage("flatten"):
        return mapped_through_store(
            run, parts, "flatten", "curve", BoundaryCurve, partial(flatten_task, parts.job), items,
            lambda index: (level.get(index, 0), -parts.patches[index].vertex_count), welding.put_curve,
        )  # fmt: skip


def weld(run: Run, parts: Parts, curves: list[BoundaryCurve], crowding: float, plan: WeldPlan, welding: Welding) -> Weld:
    """Do all welds of a plan that are left, each pair as soon as both are there; a single patch gets its natural boundary."""
    with run.clock.stage("weld"):
        for curve in curves:
            welding.put_curve(curve)
        if parts.split.patch_count == 1:
            (union,) = run.executor.map(Tasks("weld", relax_task, [welding.boundary]))
        else:
            union = welding.union()
    notes = [{"left": s.left, "right": s.right, "level": s.level, "seam_edges": s.seam_edge_count} for s in plan.steps]
    return Weld(plan, crowding, union, [curve.pieces for curve in curves], tuple(notes))


def solve(run: Run, parts: Parts, welded: Weld) -> Mapped:
    """Constrain a union to the target, solve all patches, and put them together."""
    with run.clock.stage("constrain"):
        seams = run.target.constrain(welded.union)
        positions = spread_out(seams, len(run.mesh.vertices))
    if run.options.seams != "relax":
        solved, points, mu = _solve_patches(run, parts, positions, f"-{welded.crowding:g}-{run.target.name}")
        return Mapped(parts, run.target, points, mu, seams, solved, welded)
    if not parts.job.stores_operators:
        return _relaxed_at_once(run, parts, welded, seams, positions)
    solved, record = _relax_seams(run, parts, welded.plan, positions)
    with run.clock.stage("assemble"):
        points, mu = gathered(run, parts, run.target.space)
    return Mapped(parts, run.target, points, mu, seams, solved, welded, {"interface": record})


def _relaxed_at_once(run: Run, parts: Parts, welded: Weld, seams: SeamPositions, positions: Positions) -> Mapped:
    """The same harmonic map by one sparse solve, where the boundary is too long for an operator on all of it."""
    mesh, loop = run.mesh, run.boundary
    with run.clock.stage("solve"):
        laplacian = cotangent_laplacian(mesh.vertices, mesh.faces, run.mollification)
        points = SparseFactor(laplacian, loop, used_vertices(mesh)).extend(positions[loop])
        mu = map_coefficients(run.target.space, mesh, mesh.faces, points)
    solved = seen_on_the_final_map(run, parts, [SolveReport(p.index, 0, 0, 0, 0.0) for p in parts.patches], points, mu)
    return Mapped(parts, run.target, points, mu, seams, solved, welded)


def _relax_seams(run: Run, parts: Parts, plan: WeldPlan, positions: Positions) -> tuple[list[SolveReport], dict[str, Any]]:
    """Solve the seams as well, the outer boundary held: the harmonic map of the whole mesh.

    Patches whose files were discarded, as when other splits were tried since, are stored and flattened again.
    """
    with run.clock.stage("flatten"):
        everything = {patch.index: patch.index for patch in parts.patches}
        mapped_through_store(run, parts, "flatten", "curve", BoundaryCurve, partial(flatten_task, parts.job), everything)
    factor = InterfaceFactor(run.executor, parts.job, len(parts.patches), plan, run.boundary, len(run.mesh.vertices))
    with run.clock.stage("merge"):
        factor.merge()
    with run.clock.stage("solve"):
        solved = factor.extend_patches(factor.extend_seams(positions[run.boundary]))
    record = factor.record()
    factor.release()
    return solved, record


def _solve_patches(
    run: Run, parts: Parts, positions: Positions, name: str
) -> tuple[list[SolveReport], Positions, ComplexArray]:
    """Solve all patches and put them together; a map that is lost meanwhile is solved again."""
    items = {patch.index: (patch.index, positions[patch.boundary_ids]) for patch in parts.patches}
    task = partial(solve_task, parts.job, run.target.space, name)
    lost: LostFileError | None = None
    for _ in parts.patches:
        with run.clock.stage("solve"):
            solved = mapped_through_store(run, parts, "solve", f"solved{name}", SolveReport, task, items)
            run.executor.rest()
        try:
            with run.clock.stage("assemble"):
                return solved, *gathered(run, parts, run.target.space, name)
        except LostFileError as problem:
            lost = problem
            parts.store.drop(f"solved{name}", problem.index)
    assert lost is not None
    raise lost


class Welds:
    """Maps of one split: its patches are flattened once and welded by one plan after another, or its seams solved exactly."""

    def __init__(self, run: Run, parts: Parts) -> None:
        self._run, self._parts = run, parts
        self._plans = plans(parts.split, run.is_closed)
        self._curves: list[BoundaryCurve] | None = None

    def __call__(self, route: Route) -> Mapped | Failure:
        """The map by exact seams, or by the next weld plan, or why there is none."""
        if route == EXACT:
            return self._exact()
        found = next(self._plans, None)
        if found is None:
            return Failure("plan")
        crowding, plan = found
        stage: float | str = "flatten"
        welding = Welding(self._run, self._parts, plan, crowding)
        try:
            if self._curves is None:
                self._curves = flatten(self._run, self._parts, plan, welding)
            stage = crowding
            welded = weld(self._run, self._parts, self._curves, crowding, plan, welding)
            return solve(self._run, self._parts, welded)
        except FAILURES as problem:
            return Failure("flatten" if stage == "flatten" else "weld", problem, stage)

    def _exact(self) -> Mapped | Failure:
        boundary, count = len(self._run.boundary), len(self._run.mesh.vertices)
        if boundary > _LONGEST and not stays_sparse(boundary, count) and self._run.options.seams != EXACT:
            reason = f"a boundary of {boundary} vertices is too long for all of it to be solved at once"
            return Failure("exact", SolveFailedError(reason), EXACT)
        apart = replace(self._parts, job=self._parts.job.for_use(EXACT))  # other factors of the same patches
        try:
            exact: Mapped = self._run.target.solve_exactly(self._run, apart)
            return exact
        except FAILURES as problem:
            return Failure("exact", problem, EXACT)


def to_target(run: Run, mapped: Mapped) -> Mapped:
    """The map to the run's target from the welds of a map to another, or else from the first that succeed."""
    if mapped.weld is not None:
        return solve(run, mapped.parts, mapped.weld)
    parts = replace(mapped.parts, job=mapped.parts.job.for_use(run.target.name))
    welds, problem = Welds(run, parts), None
    for number in range(MOST_PLANS):
        found = welds(number)
        if isinstance(found, Mapped):
            return found
        problem = found.problem or problem
        if found.stage != "weld" or isinstance(found.problem, CrowdedError):
            break
    raise WeldFailedError(str(problem))


def welds_and_exact(choice: Choice) -> Iterator[Attempt]:
    """Per seed every weld plan, then exact seams; first three seeds with the patches asked for, then half as many and so on."""
    count, seeds = choice.patches, range(choice.seed, choice.seed + (_SEEDS if choice.varies else 1))
    while True:
        for seed in seeds:
            exact = Attempt(count, seed, EXACT)
            if choice.exact_first:
                yield exact
            for number in range(MOST_PLANS):
                yield Attempt(count, seed, number)
            if not choice.exact_first:
                yield exact
        if count <= choice.fewest or not choice.varies:
            return
        count, seeds = max(choice.fewest, count // 2), range(choice.seed, choice.seed + 1)


METHOD = Method(
    name="pgcp",
    targets=None,
    summary="patches flattened in parallel, welded along their seams by boundary points only, and solved again",
    guarantees="no folds: what is left after repair gives way to another weld, another split, or an embedding",
    reference="Choi, Leung-Liu, Gu, Lui 2020 (PGCP)",
    mapper=Welds,
    attempts=welds_and_exact,
    chooses_seams=True,
    is_polished=True,
    to_target=to_target,
)
