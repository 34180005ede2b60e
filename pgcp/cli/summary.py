"""What the command says of a mesh and of a finished map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from pgcp.cli.terminal import BAD_INPUT, GOOD, NUMERICAL, say
from pgcp.types import Mesh, Parameterization

if TYPE_CHECKING:
    from pgcp.intake.check import Inspection


def check_only(mesh: Mesh, target: str, fix: bool) -> int:
    """Say what a mesh is and what is wrong with it; returns the exit status."""
    from pgcp.intake.check import inspect, inspect_mended
    from pgcp.surface.topology import examine
    from pgcp.targets.fitting import Asked, fitting_names

    asked = Asked(target)
    seen = None if fix else inspect(mesh, asked)
    topology = examine(mesh.faces, len(mesh.vertices)) if seen is None else seen.topology
    say(f"{mesh.name}: {topology.describe()}")
    say(
        f"  {topology.vertex_count} vertices, {topology.edge_count} edges, {topology.face_count} faces, "
        f"{topology.component_count} component{'s' if topology.component_count != 1 else ''}, "
        f"Euler characteristic {topology.euler_characteristic}, "
        f"boundary loops {[len(loop) for loop in topology.loops] or 'none'}"
    )
    if topology.unreferenced_count:
        say(f"  note: {topology.unreferenced_count} vertices are used by no face; they stay where they are in the order")
    say(f"  targets that fit: {', '.join(fitting_names(topology)) or 'none'}")
    for defect in topology.defects:
        say(f"  defect: {defect.message}")
    if seen is None:
        return _say_mended(inspect_mended(mesh, asked, topology))
    if seen.cure:
        say(f"  --fix would {seen.cure}")
    if seen.problem is None:
        return GOOD
    say(f"  refused: {seen.problem}{f'; --fix would {seen.cure}' if seen.cure else ''}")
    return BAD_INPUT


def _say_mended(seen: Inspection) -> int:
    """Say what was done to a mesh; raises what it is refused for even so."""
    for done in seen.mended.fixes if seen.mended is not None else ():
        say(f"  fixed: {done.as_record()['message']}")
    if seen.problem is not None:
        raise seen.problem
    say(f"  then it is {seen.topology.describe()}")
    return GOOD


def _counted(count: int, one: str, many: str) -> str:
    return f"{count} {one if count == 1 else many}"


def _given_way(reason: str, **names: str) -> str:
    """What took the place of the map that was asked for, and why."""
    asked, got = names["from"], names["to"]
    if got.startswith(f"{asked} "):
        return f"an embedding without folds, not conformal, took the place of the conformal map to the {asked}: {reason}"
    return f"instead of {asked}, mapped to {got}: {reason}"


def _notes(report: dict[str, Any]) -> str:
    """Lines on what a user should know of a map beside its quality."""
    helped = [r for r in report["repairs"] if r["folds_after"] < r["folds_before"]]
    lines = [f"repaired by {r['method']}: {r['folds_before']} folds to {r['folds_after']}" for r in helped]
    if report["fallback"]:
        lines.append(_given_way(**report["fallback"]))
    if report["overlap"] and report["overlap"]["crossings"]:
        crossings = _counted(report["overlap"]["crossings"], "time", "times")
        lines.append(f"the boundary crosses itself {crossings}: the map overlaps itself (--no-overlap maps to the disk)")
    texture = report.get("texture", {})
    if texture.get("folds", 0) > 0:
        folds = _counted(texture["folds"], "fold", "folds")
        lines.append(
            f"as texture coordinates, turned and moved, the map has {folds}: the npz file and --uv surface keep its own"
        )
    in_single = texture.get("single_precision_folds", report["single_precision_folds"])
    if in_single > 0:
        folds = _counted(in_single, "fold", "folds")
        lines.append(f"rounded to 32-bit floats the map has {folds}: PLY and OBJ files hold all digits, GLB files do not")
    return "".join(f"  {line}\n" for line in lines)


def summary(result: Parameterization, seconds: float, where: str) -> str:
    """What the command says of a finished map."""
    q = result.quality
    stages = ", ".join(f"{s['name']} {s['seconds']:.2f}" for s in result.report["stages"])
    patches = _counted(len(result.report["patches"]), "patch", "patches")
    fixes = "".join(f"  fixed: {fix['message']}\n" for fix in result.report["fixes"])
    return (
        f"{result.mesh.name}: {len(result.mesh.vertices)} vertices, target {result.target}, {patches}, "
        f"{seconds:.1f} s ({stages})\n"
        f"{fixes}"
        f"  |angle error| mean {q.angle_mean_deg:.4f}, sd {q.angle_sd_deg:.4f}, max {q.angle_max_deg:.2f} degrees; "
        f"folds {q.folds}{'' if q.degree is None else f', degree {q.degree:.0f}'}\n"
        f"{_notes(result.report)}"
        f"  results in {where}"
    )


def record(result: Parameterization, seconds: float, paths: list[Path]) -> dict[str, Any]:
    """What ``--json`` says of a finished map."""
    report = result.report
    return {
        "status": NUMERICAL if result.quality.folds else GOOD,
        "mesh": report["mesh"],
        "target": result.target,
        "patches": len(report["patches"]),
        "seconds": round(seconds, 3),
        "fixes": report["fixes"],
        "quality": report["quality"],
        "repairs": report["repairs"],
        "overlap": report["overlap"],
        "fallback": report["fallback"],
        "files": [str(path) for path in paths],
    }
