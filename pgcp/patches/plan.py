"""The patch graph, and the order in which patches are welded along its edges (PGCP section 4.3)."""

from __future__ import annotations

from collections.abc import Iterator

import networkx
import numpy as np

from pgcp.errors import PartitionInputError
from pgcp.partition import SeamTable
from pgcp.patches.split import Split
from pgcp.patches.types import WeldPlan, WeldStep

_TIE_DIGITS = 9
# seam-length penalties of the weld order, of open and of closed surfaces, tried one after the other
_CROWDING = {False: (0.0, 0.25, 1.0, 4.0, 16.0), True: (0.0, 1.0, 4.0, 16.0, 64.0)}
MOST_PLANS = len(_CROWDING[True])
_NECK = 1e-3
_SHORTEST = 1e-100
# of the cost, for each level below: flat trees are welded in parallel. Closed surfaces come out better from one growing union
_DEPTH = {False: 0.1, True: 0.0}


def patch_graph(table: SeamTable, patch_count: int) -> networkx.Graph:
    """Patches (0 to patch_count - 1) that share edges, with the ``edges`` and the ``length`` of what they share."""
    graph: networkx.Graph = networkx.empty_graph(patch_count)
    contacts = table.contacts(np.arange(patch_count))
    for (p, q), edges, length in zip(
        contacts.pairs.tolist(), contacts.edge_count.tolist(), contacts.length.tolist(), strict=True
    ):
        if edges:
            graph.add_edge(p, q, edges=edges, length=length)
    return graph


def weld_tree(plan: WeldPlan) -> networkx.DiGraph:
    """The welds as a tree: an edge from each component to the union it goes into, with the seam's edges."""
    tree: networkx.DiGraph = networkx.DiGraph()
    tree.add_nodes_from(range(plan.patch_count))
    for step in plan.steps:
        for part in (step.left, step.right):
            tree.add_edge(part, step.result, seam_edges=step.seam_edge_count)
    return tree


def check_plan(plan: WeldPlan, graph: networkx.Graph) -> None:
    """Raise PartitionInputError where a plan does not weld every patch into one union along the seams of the patch graph.

    Every component goes into one union, the last one into none; a weld joins two connected unions along all edges that they
    share, and comes after both.
    """
    tree = weld_tree(plan)
    if not networkx.is_arborescence(tree.reverse(copy=False)) or {v for v, n in tree.in_degree() if n == 0} != set(graph):
        raise PartitionInputError(f"the {len(plan.steps)} welds of {plan.patch_count} patches do not join each once")
    inside = {patch: {patch} for patch in graph}
    level = dict.fromkeys(graph, 0)
    for step in plan.steps:
        left, right = inside.pop(step.left), inside.pop(step.right)
        shared = sum(graph.edges[seam]["edges"] for seam in networkx.edge_boundary(graph, left, right))
        if shared == 0 or shared != step.seam_edge_count or step.level <= max(level[step.left], level[step.right]):
            what = f"of components {step.left} and {step.right} along {step.seam_edge_count} edges, where they share {shared}"
            raise PartitionInputError(f"the weld {what}, is out of order")
        inside[step.result], level[step.result] = left | right, step.level


def plan_welds(table: SeamTable, patch_count: int, closed: bool = False, crowding: float = 0.0) -> WeldPlan:
    """Plan all welds before any is run: a binary tree over the patch graph.

    A pair can be welded where its intersection is one arc. In a disk made of disks such a pair always exists, and the
    union is a disk again, so choosing greedily never runs into a dead end; the same holds on a closed surface until two
    disks are left, which share their whole boundary and are welded last. Chosen is the pair whose union has the
    shortest perimeter P left around it, so that unions stay round, plus ``crowding`` times s^2 / P for a seam of length s:
    a long seam behind a narrow neck crowds all that lies beyond. On an open surface, of pairs that cost about the same one
    whose welds before it are fewer levels deep is chosen. Raises PartitionInputError where no pair is left.
    """
    relabel = np.arange(patch_count)
    name = list(range(patch_count))  # representative label -> component id
    level = np.zeros(patch_count, np.int64)
    steps: list[WeldStep] = []
    for step in range(patch_count - 1):
        last = closed and step == patch_count - 2
        contacts = table.contacts(relabel)
        border = np.bincount(contacts.pairs.reshape(-1), np.repeat(contacts.length, 2), minlength=patch_count)
        usable = np.flatnonzero(contacts.is_circle if last else contacts.is_arc)
        if len(usable) == 0:
            left = sorted({name[label] for label in np.unique(relabel).tolist()})
            raise PartitionInputError(f"no two of the remaining components {left} share exactly one arc")
        pairs = contacts.pairs[usable]
        seam = contacts.length[usable]
        perimeter = np.maximum(border[pairs].sum(axis=1) - 2.0 * seam, _NECK * seam)
        total = max(float(border.sum()), _SHORTEST)
        perimeter = np.maximum(perimeter, _SHORTEST * total)  # edges may have no length
        levels = 1 + level[pairs].max(axis=1)
        cost = (perimeter + crowding * seam**2 / perimeter) * (1.0 + _DEPTH[closed] * levels)
        cost = np.round(cost / total, _TIE_DIGITS)  # ties fall the same way whatever rounding says
        best = int(np.lexsort((pairs[:, 1], pairs[:, 0], cost))[0])
        p, q = (int(v) for v in pairs[best])
        result = patch_count + step
        new_level = int(levels[best])
        steps.append(WeldStep(name[p], name[q], result, new_level, int(contacts.edge_count[usable[best]]), last))
        relabel[relabel == q] = p
        name[p], level[p] = result, new_level
    return WeldPlan(patch_count, tuple(sorted(steps, key=lambda s: (s.level, s.result))))


def plans(split: Split, closed: bool) -> Iterator[tuple[float, WeldPlan]]:
    """All different weld plans to try, best first, each with its seam-length penalty."""
    seen: list[tuple[WeldStep, ...]] = []
    graph = patch_graph(split.table, split.patch_count)
    for crowding in _CROWDING[closed]:
        plan = plan_welds(split.table, split.patch_count, closed, crowding)
        if plan.steps not in seen:
            check_plan(plan, graph)
            seen.append(plan.steps)
            yield crowding, plan
