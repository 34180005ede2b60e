"""What of a surface is mapped, by the options of the run, and whether it can be: looked at before any work is done."""

from __future__ import annotations

from dataclasses import replace

from pgcp.intake.check import Asked, Inspection, advised, inspect_mended, look
from pgcp.intake.given import LARGEST, Given, Named, take
from pgcp.options import Options
from pgcp.surface.topology import examine
from pgcp.types import Mesh


def inspected(mesh: Mesh, asked: Asked, options: Options, named: Named | None) -> tuple[Given, Inspection]:
    """What of a mesh is mapped, and what that is; where it is to be fixed, mending chooses the component."""
    if options.fix:
        component = None if options.component == LARGEST else options.component
        topology = examine(mesh.faces, len(mesh.vertices))
        given = take(mesh, topology, asked, options.weld_distance, component, named)
        return given, inspect_mended(given.mesh, asked, given.topology)
    seen = look(mesh, asked)
    given = take(mesh, seen.topology, asked, options.weld_distance, options.component, named)
    if given.mesh is not mesh:
        seen = look(given.mesh, asked, given.topology)
    seen = advised(given.mesh, asked, seen)
    if given.face_of is not None and seen.problem is not None:  # say of which component it is
        seen = replace(seen, problem=type(seen.problem)(f"{seen.problem}; {given.others}"))
    return given, seen
