"""What a report says, in sentences: what was repaired, what was tried again, and what else a user should know of a map."""

from __future__ import annotations

from typing import Any

from pgcp.types import Parameterization


def counted(count: int, one: str, many: str) -> str:
    """A number with its noun."""
    return f"{count} {one if count == 1 else many}"


def notes(report: dict[str, Any]) -> list[str]:
    """What a user should know of a map beside its quality: repairs, another map in its place, overlaps, lost digits."""
    helped = [r for r in report["repairs"] if r["folds_after"] < r["folds_before"]]
    lines = [f"repaired by {r['method']}: {r['folds_before']} folds to {r['folds_after']}" for r in helped]
    if report["fallback"]:
        lines.append(_given_way(**report["fallback"]))
    if report["overlap"] and report["overlap"]["crossings"]:
        crossings = counted(report["overlap"]["crossings"], "time", "times")
        lines.append(f"the boundary crosses itself {crossings}: the map overlaps itself (--no-overlap maps to the disk)")
    if report.get("cut"):
        lines += _of_cut(report["cut"], report["overlap"])
    texture = report.get("texture") or {}
    if texture.get("folds", 0) > 0:
        folds = counted(texture["folds"], "fold", "folds")
        lines.append(
            f"as texture coordinates, turned and moved, the map has {folds}: the npz file and --uv surface keep its own"
        )
    in_single = texture.get("single_precision_folds", report["single_precision_folds"])
    if in_single > 0:
        folds = counted(in_single, "fold", "folds")
        lines.append(f"rounded to 32-bit floats the map has {folds}: PLY and OBJ files hold all digits, GLB files do not")
    return lines


def _of_cut(cut: dict[str, Any], overlap: dict[str, Any] | None) -> list[str]:
    """What a user should know of a cut, and of the map's scales."""
    what = f"genus {cut['genus']}, {counted(cut['boundaries'], 'boundary', 'boundaries')}"
    if not cut["edges"]:
        lines = [f"no cut was needed ({what})"]
    else:
        tips = f", through {counted(cut['tips'], 'tip', 'tips')}" if cut["tips"] else ""
        edges = counted(cut["edges"], "edge", "edges")
        lines = [f"cut open along {edges}, {cut['length_by_diagonal']:.2f} times the diagonal{tips} ({what})"]
    bound, ratio = cut["bound"], cut["scale_ratio"]
    kept = "" if bound is None else f", {'within' if ratio <= bound else 'above'} the bound {bound:g}"
    tried = f" after {cut['rounds']} maps" if cut["rounds"] > 1 else ""
    lines.append(
        f"scale ratio {ratio:.3g}{kept}{tried}: areas are scaled by factors that differ by no more, lengths by "
        f"{ratio**0.5:.2g}, on 98 % of the surface"
    )
    if overlap is not None and not overlap["crossings"]:
        lines.append("the map does not overlap itself")
    return lines


def _given_way(reason: str, **names: str) -> str:
    """What took the place of the map that was asked for, and why."""
    asked, got = names["from"], names["to"]
    if got.startswith(f"{asked} "):
        return f"an embedding without folds, not conformal, took the place of the conformal map to the {asked}: {reason}"
    return f"instead of {asked}, mapped to {got}: {reason}"


def course(result: Parameterization) -> list[str]:
    """Sentences on how a map came about: the mesh mended, attempts, welds, corrections, repairs, polish."""
    report = result.report
    lines = [f"The mesh was mended: {fix['message']}" for fix in report.get("fixes", [])]
    if report.get("mollification"):
        lines.append(f"Edges of faces without area were taken to be longer by {report['mollification']:.2g}")
    lines += [_attempt(k, tried) for k, tried in enumerate(report.get("retries", []), 1)]
    patches, welds = len(report.get("patches", [])), len(report.get("welds", []))
    if welds:
        lines.append(
            f"{counted(patches, 'patch was', 'patches were')} flattened and joined by {counted(welds, 'weld', 'welds')}"
        )
    lines += _adjusted(report)
    lines += [line[0].upper() + line[1:] for line in notes({**_NOTHING, **report})]
    if not report.get("retries") and not report.get("repairs"):
        lines.append("The first attempt served; nothing had to be tried again or repaired")
    return [line if line.endswith((".", "!", "?")) else f"{line}." for line in lines]


def _attempt(number: int, tried: dict[str, Any]) -> str:
    """What was tried, and why it did not serve."""
    folds = "" if tried["folds"] is None else f", which left {counted(tried['folds'], 'fold', 'folds')}"
    patches = counted(tried["patches"], "patch", "patches")
    return f"Attempt {number}, with {patches} and seed {tried['seed']}{folds}, did not serve: {tried['reason']}"


_NOTHING: dict[str, Any] = {"repairs": [], "fallback": None, "overlap": None, "single_precision_folds": 0}


def _adjusted(report: dict[str, Any]) -> list[str]:
    """What was done to the map once it was there."""
    lines = []
    correction, polish = report.get("correction"), report.get("polish")
    if correction and correction["share"]:
        before, after = correction["log_area_before"], correction["log_area_after"]
        lines.append(
            f"A Moebius map, for least {correction['method']} distortion, took the mean log area ratio from {before:.4g} to "
            f"{after:.4g}, the mean angle error from {correction['angle_mean_before_deg']:.4g}° to "
            f"{correction['angle_mean_after_deg']:.4g}°"
        )
    elif correction:
        lines.append("A Moebius correction was looked for, and the map was left as it was")
    if polish and polish["steps"]:
        lines.append(
            f"A polish in {counted(polish['steps'], 'step', 'steps')} took the mean angle error from "
            f"{polish['angle_mean_before_deg']:.4g}° to {polish['angle_mean_after_deg']:.4g}°"
        )
    idle = [r["method"] for r in report.get("repairs", []) if r["folds_after"] >= r["folds_before"]]
    if idle:
        lines.append(f"Repairs that took no folds away: {', '.join(dict.fromkeys(idle))}")
    return lines
