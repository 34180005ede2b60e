"""Maps of several components of one surface as one map, and what is said of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from pgcp.types import Parameterization, Quality

_LISTS = ("patches", "welds", "retries", "iterations", "repairs", "fixes")
_SUMS = ("boundary_points", "spread_points", "single_precision_folds")


def quality_of_all(done: Sequence[Parameterization]) -> Quality:
    """Quality of maps together: means by faces, largest values, and folds of all.

    Median and 99th percentile are means of those of the maps by faces. A degree is that of the map that differs most from 1.
    """
    count = np.array([len(one.mesh.faces) for one in done], np.float64)
    share = count / count.sum()

    def mean(name: str) -> float:
        """Mean by faces."""
        return float(share @ [getattr(one.quality, name) for one in done])

    middle = mean("angle_mean_deg")
    squares = [one.quality.angle_sd_deg**2 + (one.quality.angle_mean_deg - middle) ** 2 for one in done]
    degrees = [one.quality.degree for one in done if one.quality.degree is not None]
    energies = [one.quality.conformal_energy for one in done if one.quality.conformal_energy is not None]
    return Quality(
        angle_mean_deg=middle,
        angle_sd_deg=float(np.sqrt(share @ squares)),
        angle_median_deg=mean("angle_median_deg"),
        angle_p99_deg=mean("angle_p99_deg"),
        angle_max_deg=max(one.quality.angle_max_deg for one in done),
        mu_mean=mean("mu_mean"),
        mu_max=max(one.quality.mu_max for one in done),
        folds=sum(one.quality.folds for one in done),
        log_area_mean=mean("log_area_mean"),
        degree=max(degrees, key=lambda degree: abs(degree - 1.0)) if degrees else None,
        conformal_energy=sum(energies) if len(energies) == len(done) else None,
    )


def report_of_all(
    done: Sequence[Parameterization], names: Sequence[str], notes: Sequence[dict[str, Any]], quality: Quality
) -> dict[str, Any]:
    """The report of maps together: that of the first, lists one after the other, and a row for each component.

    Patches are numbered through all components.
    """
    report = dict(done[0].report)
    for name in _LISTS:
        report[name] = [entry for one in done for entry in one.report[name]]
    report["patches"] = [{**row, "index": index} for index, row in enumerate(report["patches"])]
    for name in _SUMS:
        report[name] = sum(one.report[name] for one in done)
    stages: dict[str, dict[str, Any]] = {}
    for one in done:
        for stage in one.report["stages"]:
            known = stages.setdefault(stage["name"], {**stage, "seconds": 0.0})
            known["seconds"] += stage["seconds"]
    report |= {
        "mesh": {
            "name": done[0].mesh.name.split(", ")[0],
            "vertices": sum(len(one.mesh.vertices) for one in done),
            "faces": sum(len(one.mesh.faces) for one in done),
        },
        "stages": list(stages.values()),
        "input": list(notes),
        "components": [
            {"name": name, "target": one.target, "faces": len(one.mesh.faces), "quality": asdict(one.quality)}
            for one, name in zip(done, names, strict=True)
        ],
        "cut": cuts_of_all([one.report["cut"] for one in done if one.report.get("cut")]),
        "overlap": next((one.report["overlap"] for one in done if (one.report["overlap"] or {}).get("crossings")), None),
        "fallback": next((one.report["fallback"] for one in done if one.report["fallback"]), None),
        "quality": asdict(quality),
        "status": "good" if quality.folds == 0 else "folded",
    }
    return report


def cuts_of_all(cuts: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """What is said of the cuts of several components: sums of numbers, and the worst of what measures the maps; None of none.

    Lengths are sums too, each by the size of its own component.
    """
    if not cuts:
        return None
    sums = ("edges", "length_by_diagonal", "length_by_root_of_area", "genus", "boundaries", "tips")
    worst = ("scale_ratio", "largest_scale_ratio", "rounds")
    out = {**cuts[0], **{name: sum(cut[name] for cut in cuts) for name in sums}}
    out |= {name: max(cut[name] for cut in cuts) for name in worst}
    out.pop("foretold_scale_ratio", None)
    scales = np.array([cut["length_scales"] for cut in cuts])
    return {**out, "length_scales": [float(scales[:, 0].min()), float(scales[:, 1].max())]}


def all_note(count: int, left: Sequence[str]) -> dict[str, Any]:
    """What is said of components: how many were mapped, and why some were not."""
    others = "; ".join(left[:3]) + (f"; and {len(left) - 3} more" if len(left) > 3 else "")
    message = f"{count} of {count + len(left)} components are mapped{f'; left out: {others}' if left else ''}"
    return {"step": "components", "count": count, "message": message}


def patches_of_all(done: Sequence[Parameterization]) -> list[np.ndarray]:
    """Patches (F,) of the faces of each map, numbered through all."""
    first, out = 0, []
    for one in done:
        out.append(one.patch + first)
        first += int(one.patch.max()) + 1
    return out
