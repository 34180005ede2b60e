"""What the command says of a mesh and of a finished map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from pgcp.cli.terminal import BAD_INPUT, GOOD, NUMERICAL, say
from pgcp.report.words import counted, notes
from pgcp.types import Parameterization

if TYPE_CHECKING:
    from pgcp.api import Surface
    from pgcp.intake.check import Inspection
    from pgcp.surface.topology import Topology

_LOOPS = 20


def check_only(surface: Surface, target: str, fix: bool, distance: float | None, component: str, opens: bool = False) -> int:
    """Say what a mesh is and what is wrong with it, where it is to be cut open (``opens``) or not; returns the exit status."""
    from pgcp.intake.check import advised, inspect_mended, look
    from pgcp.intake.given import ALL, LARGEST, take
    from pgcp.surface.topology import examine
    from pgcp.targets.fitting import Asked, fitting_names

    asked, mesh = Asked(target, opens=opens), surface.cut.mesh
    seen = None if fix else look(mesh, asked)
    topology = examine(mesh.faces, len(mesh.vertices)) if seen is None else seen.topology
    chosen = None if component == ALL or (fix and component == LARGEST) else component
    given = take(mesh, topology, asked, distance, chosen, surface.named)
    if seen is not None:
        seen = advised(given.mesh, asked, seen if given.mesh is mesh else look(given.mesh, asked, given.topology))
    say(f"{mesh.name}: {topology.describe()}")
    say(
        f"  {topology.vertex_count} vertices, {topology.edge_count} edges, {topology.face_count} faces, "
        f"{topology.component_count} component{'s' if topology.component_count != 1 else ''}, "
        f"Euler characteristic {topology.euler_characteristic}, "
        f"boundary loops {_loops(topology)}"
    )
    if topology.unreferenced_count:
        say(f"  note: {topology.unreferenced_count} vertices are used by no face; they stay where they are in the order")
    for note in (*surface.cut.notes, *given.notes):
        say(f"  input: {note['message']}")
    if given.mesh is not mesh:
        say(f"  then it is {given.topology.describe()}")
    fitting = ", ".join(fitting_names(given.topology, opens)) or "none"
    say(f"  targets that fit: {fitting}{', once it is cut open' if opens else ''}")
    for defect in given.topology.defects:
        say(f"  defect: {defect.message}")
    if seen is None:
        return _say_mended(inspect_mended(given.mesh, asked, given.topology))
    if seen.cure:
        say(f"  --fix would {seen.cure}")
    if seen.problem is None:
        return GOOD
    say(f"  refused: {seen.problem}{f'; --fix would {seen.cure}' if seen.cure else ''}")
    return BAD_INPUT


def _loops(topology: Topology) -> str:
    """Numbers of edges of the boundary loops, the longest first."""
    sizes = [len(loop) for loop in topology.loops]
    if len(sizes) <= _LOOPS:
        return str(sizes) if sizes else "none"
    return f"[{', '.join(map(str, sizes[:_LOOPS]))}, ...] ({len(sizes)} in all)"


def _say_mended(seen: Inspection) -> int:
    """Say what was done to a mesh; raises what it is refused for even so."""
    for done in seen.mended.fixes if seen.mended is not None else ():
        say(f"  fixed: {done.as_record()['message']}")
    if seen.problem is not None:
        raise seen.problem
    say(f"  then it is {seen.topology.describe()}")
    return GOOD


def summary(result: Parameterization, seconds: float, where: str) -> str:
    """What the command says of a finished map."""
    q = result.quality
    stages = ", ".join(f"{s['name']} {s['seconds']:.2f}" for s in result.report["stages"])
    patches = counted(len(result.report["patches"]), "patch", "patches")
    fixes = "".join(f"  fixed: {fix['message']}\n" for fix in result.report["fixes"])
    taken = "".join(f"  {note['message']}\n" for note in result.report["input"])
    said = "".join(f"  {line}\n" for line in notes(result.report))
    return (
        f"{result.mesh.name}: {len(result.mesh.vertices)} vertices, target {result.target}, {patches}, "
        f"{seconds:.1f} s ({stages})\n"
        f"{taken}{fixes}"
        f"  |angle error| mean {q.angle_mean_deg:.4f}, sd {q.angle_sd_deg:.4f}, max {q.angle_max_deg:.2f} degrees; "
        f"folds {q.folds}{'' if q.degree is None else f', degree {q.degree:.0f}'}\n"
        f"{said}"
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
        "input": report["input"],
        "fixes": report["fixes"],
        "quality": report["quality"],
        "repairs": report["repairs"],
        "overlap": report["overlap"],
        "fallback": report["fallback"],
        "cut": report.get("cut"),
        "files": [str(path) for path in paths],
    }
