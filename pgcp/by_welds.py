"""Map patch by patch as PGCP does: flatten each, weld them along their seams, constrain the union, solve each."""

from __future__ import annotations

from functools import partial
from typing import Any

from pgcp.constrain import constrain_to_disk, constrain_to_sphere, keep_free
from pgcp.exact import InterfaceFactor
from pgcp.run import Mapped, Parts, Run, gathered, spread_out
from pgcp.tasks import SolveReport, flatten_task, relax_task, solve_task, weld_closed_task, weld_task
from pgcp.types import BoundaryCurve, Component, Positions, WeldPlan
from pgcp.weld import start_component

CONSTRAIN = {"free": keep_free, "disk": constrain_to_disk, "sphere": constrain_to_sphere}


def flatten(run: Run, parts: Parts) -> list[BoundaryCurve]:
    """Flatten all patches."""
    with run.clock.stage("flatten"):
        return run.executor.map("flatten", partial(flatten_task, parts.job), range(parts.split.patch_count))


def weld(run: Run, parts: Parts, curves: list[BoundaryCurve], plan: WeldPlan) -> tuple[Component, tuple[dict[str, int], ...]]:
    """Weld all patches by a plan, level by level; a single one gets its natural boundary."""
    components = {c.patch: start_component(c, run.mesh.vertices, parts.split.edges) for c in curves}
    notes: list[dict[str, int]] = []
    with run.clock.stage("weld"):
        if parts.split.patch_count == 1:
            components = dict(enumerate(run.executor.map("weld", relax_task, list(components.values()))))
        for number, level in enumerate(plan.levels, 1):
            pairs = [(components.pop(step.left), components.pop(step.right)) for step in level]
            task = weld_closed_task if level[0].closed else weld_task
            for step, union in zip(level, run.executor.map(f"weld {number}", task, pairs), strict=True):
                components[step.result] = union
                notes.append({"left": step.left, "right": step.right, "level": step.level, "seam_edges": step.seam_edge_count})
    (union,) = components.values()
    return union, tuple(notes)


def _solve_exactly(run: Run, parts: Parts, plan: WeldPlan, positions: Positions) -> tuple[list[SolveReport], dict[str, Any]]:
    """Solve the seams as well, the outer boundary held: the harmonic map of the whole mesh."""
    factor = InterfaceFactor(run.executor, parts.job, parts.patches, plan, run.boundary, len(run.mesh.vertices))
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
) -> Mapped:
    """Constrain a union to the target, solve all patches, and put them together."""
    with run.clock.stage("constrain"):
        seams = CONSTRAIN[target](union)
        positions = spread_out(seams, len(run.mesh.vertices))
    record = None
    if run.options.seams == "relax":
        solved, record = _solve_exactly(run, parts, plan, positions)
    else:
        with run.clock.stage("solve"):
            items = [(p.index, positions[p.vertex_ids[p.boundary]]) for p in parts.patches]
            solved = run.executor.map("solve", partial(solve_task, parts.job), items)
    with run.clock.stage("assemble"):
        points, mu = gathered(run, parts, solved, target)
    return Mapped(parts, target, pieces, solved, seams, points, mu, plan, union, welds, record)
