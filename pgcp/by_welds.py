"""Map patch by patch as PGCP does: flatten each, weld them along their seams, constrain the union, solve each."""

from __future__ import annotations

from functools import partial
from typing import Any

from pgcp.constrain import constrain_to_disk, constrain_to_sphere, keep_free
from pgcp.errors import LostFileError
from pgcp.exact import InterfaceFactor
from pgcp.executors import Join, Joining, Spare
from pgcp.run import Mapped, Parts, Run, gathered, mapped_through_store, spread_out
from pgcp.tasks import SolveReport, flatten_task, prepare_task, relax_task, solve_task, weld_task
from pgcp.types import BoundaryCurve, ComplexArray, Component, Positions, WeldPlan
from pgcp.weld import start_component

CONSTRAIN = {"free": keep_free, "disk": constrain_to_disk, "sphere": constrain_to_sphere}


class Welding(Joining):
    """The welds of a plan, those whose unions are not in the store already; ``put_curve`` gives a patch's boundary.

    Idle workers prepare the second pass of patches that are flattened.
    """

    def __init__(self, run: Run, parts: Parts, plan: WeldPlan, order: float) -> None:
        kind = f"union-{order:g}"
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
        super().__init__("weld", joins[::-1], len(plan.steps) - len(joins))
        for name, union in unions.items():
            self.put(name, union)
        self._vertices, self._edges = run.mesh.vertices, parts.split.edges
        self._prepare = partial(prepare_task, parts.job)
        # where seams are solved as well, the first pass keeps what it can
        can_keep = run.options.seams != "relax" and parts.job.factor_cache_bytes > 0
        self._unprepared = {patch.index for patch in parts.patches if can_keep}

    def put_curve(self, curve: BoundaryCurve) -> None:
        """Give a patch's boundary curve, where a weld needs it."""
        if curve.patch in self._needed:
            self.put(curve.patch, start_component(curve, self._vertices, self._edges))
        if curve.patch in self._unprepared:
            self._unprepared.remove(curve.patch)
            self.spares.append(Spare(curve.patch, self._prepare, curve.patch))


def flatten(run: Run, parts: Parts, plan: WeldPlan, welding: Welding) -> list[BoundaryCurve]:
    """Flatten all patches, and meanwhile weld by a plan what is there: first the patches that are at the bottom of its tree."""
    items = {patch.index: patch.index for patch in parts.patches}
    level = {leaf: step.level for step in plan.steps for leaf in (step.left, step.right)}
    with run.clock.stage("flatten"):
        return mapped_through_store(
            run, parts, "flatten", "curve", BoundaryCurve, partial(flatten_task, parts.job), items,
            lambda index: (level.get(index, 0), -parts.patches[index].vertex_count), welding.put_curve, welding,
        )  # fmt: skip


def weld(
    run: Run, parts: Parts, curves: list[BoundaryCurve], plan: WeldPlan, welding: Welding
) -> tuple[Component, tuple[dict[str, int], ...]]:
    """Do all welds of a plan that are left, each pair as soon as both are there; a single patch gets its natural boundary."""
    with run.clock.stage("weld"):
        for curve in curves:
            welding.put_curve(curve)
        if parts.split.patch_count == 1:
            (union,) = run.executor.map("weld", relax_task, list(welding.values.values()))
        else:
            (union,) = run.executor.join(welding).values()
    notes = [{"left": s.left, "right": s.right, "level": s.level, "seam_edges": s.seam_edge_count} for s in plan.steps]
    return union, tuple(notes)


def _solve_exactly(run: Run, parts: Parts, plan: WeldPlan, positions: Positions) -> tuple[list[SolveReport], dict[str, Any]]:
    """Solve the seams as well, the outer boundary held: the harmonic map of the whole mesh."""
    factor = InterfaceFactor(run.executor, parts.job, len(parts.patches), plan, run.boundary, len(run.mesh.vertices))
    with run.clock.stage("merge"):
        factor.merge()
    with run.clock.stage("solve"):
        solved = factor.extend_patches(factor.extend_seams(positions[run.boundary]))
    record = factor.record()
    factor.release()
    return solved, record


def solve(
    run: Run,
    parts: Parts,
    pieces: list[int],
    plan: WeldPlan,
    union: Component,
    welds: tuple[dict[str, int], ...],
    target: str,
    order: float,
) -> Mapped:
    """Constrain a union to the target, solve all patches, and put them together."""
    with run.clock.stage("constrain"):
        seams = CONSTRAIN[target](union)
        positions = spread_out(seams, len(run.mesh.vertices))
    record = None
    if run.options.seams == "relax":
        solved, record = _solve_exactly(run, parts, plan, positions)
        with run.clock.stage("assemble"):
            points, mu = gathered(run, parts, target)
    else:
        solved, points, mu = _solve_patches(run, parts, positions, target, f"-{order:g}-{target}")
    return Mapped(parts, target, pieces, solved, seams, points, mu, plan, order, union, welds, record)


def _solve_patches(
    run: Run, parts: Parts, positions: Positions, target: str, name: str
) -> tuple[list[SolveReport], Positions, ComplexArray]:
    """Solve all patches and put them together; a map that is lost meanwhile is solved again."""
    items = {patch.index: (patch.index, positions[patch.boundary_ids]) for patch in parts.patches}
    task = partial(solve_task, parts.job, name)
    lost: LostFileError | None = None
    for _ in parts.patches:
        with run.clock.stage("solve"):
            solved = mapped_through_store(run, parts, "solve", f"solved{name}", SolveReport, task, items)
            run.executor.rest()
        try:
            with run.clock.stage("assemble"):
                return solved, *gathered(run, parts, target, name)
        except LostFileError as problem:
            lost = problem
            parts.store.drop(f"solved{name}", problem.index)
    assert lost is not None
    raise lost
