"""What report.json says of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from pgcp.patches.mapped import Mapped
from pgcp.patches.plan import patch_graph
from pgcp.plane.space import find_folds
from pgcp.retry.course import Outcome
from pgcp.surface.squeeze import LARGEST, extremes, measured_scales, scale_ratio
from pgcp.targets.registry import TARGETS
from pgcp.types import FloatArray, Mesh, Parameterization, Quality


def fold_message(result: Parameterization) -> str:
    """How many folds are left, where, and what was tried."""
    space = TARGETS.get(result.target).space
    folded = find_folds(space, result.mesh.faces, space.positions(result.coordinates))
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


def _patch_rows(mapped: Mapped) -> list[dict[str, Any]]:
    """What is said of every patch; of an embedding as a whole, which solves no patch, only what they are."""
    graph = patch_graph(mapped.parts.split.table, mapped.parts.split.patch_count)
    rows: list[dict[str, Any]] = [
        {
            "index": p.index,
            "vertices": p.vertex_count,
            "faces": p.face_count,
            "boundary": len(p.boundary_ids),
            "neighbours": sorted(graph[p.index]),
        }
        for p in mapped.parts.patches
    ]
    pieces = [1] * len(mapped.solved) if mapped.weld is None else mapped.weld.pieces
    for row, count, solved in zip(rows, pieces, mapped.solved, strict=False):
        row |= {
            "pieces": count,
            "folds": solved.fold_count,
            "folds_before_raising": solved.first_fold_count,
            "raised_weights": solved.raised_weights,
            "mu_max": solved.mu_max,
            "reused_factor": solved.reused_factor,
        }
    return rows


def cut_report(found: Mapping[str, Any], mesh: Mesh, image: FloatArray, bound: float, rounds: int) -> dict[str, Any]:
    """What the report of a run says of a cut: ``cut``.

    found: what is known of the cut before there is a map; mesh: cut open; image (V, 2): the map in the surface's unit;
    bound: of the scale ratio, infinite for none; rounds: how often the surface was mapped.
    """
    scales, areas = measured_scales(mesh, image)
    low, high = extremes(scales, areas)
    known = scales[areas > 0.0]
    return {
        "cut": {
            **found,
            "scale_ratio": scale_ratio(scales, areas),
            "length_scales": [float(np.exp(low)), float(np.exp(high))],
            "largest_scale_ratio": float(np.exp(min(2.0 * float(np.ptp(known)), LARGEST))),
            "bound": bound if np.isfinite(bound) else None,
            "rounds": rounds,
        }
    }


def run_report(
    mesh: Mesh,
    outcome: Outcome,
    quality: Quality,
    mollification: float,
    fixes: Sequence[Mapping[str, Any]],
    where: Mapping[str, Any],
) -> dict[str, Any]:
    """The report of a run as plain data.

    mesh: as it was mapped; mollification in the surface's unit; fixes: what was done to the mesh;
    where: what is known of how the run ran: versions, options, backend, executor, stages, tasks.
    """
    done, mapped = outcome.done, outcome.done.mapped
    return {
        "mesh": {"name": mesh.name, "vertices": len(mesh.vertices), "faces": len(mesh.faces)},
        **where,
        "seed": mapped.parts.seed,
        "patches": _patch_rows(mapped),
        "welds": list(mapped.weld.notes) if mapped.weld is not None else [],
        "retries": [tried.record() for tried in outcome.tried],
        "mollification": mollification,
        "seams": mapped.seams_by,
        "interface": mapped.details.get("interface"),
        "logarithms": mapped.details.get("logarithms"),
        "intrinsic": mapped.details.get("intrinsic"),
        "iterations": mapped.details.get("iterations", []),
        "converged": mapped.details.get("converged"),
        "boundary_points": int(mapped.parts.split.edges.parts.sum()),
        "target": mapped.target.name,
        "smallest_gap": mapped.seams.smallest_gap,
        "spread_points": mapped.seams.spread_count,
        "correction": asdict(done.correction) if done.correction is not None else None,
        "polish": asdict(done.polish) if done.polish is not None else None,
        "repairs": [asdict(repair) for repair in done.repaired.records],
        "cut": None,
        "overlap": outcome.overlap,
        "fallback": outcome.fallback,
        "fixes": list(fixes),
        "quality": asdict(quality),
        "status": "good" if quality.folds == 0 else "folded",
    }
