"""What a mesh is, which target fits it, and what cannot be mapped at all: checked before any work is done."""

from __future__ import annotations

import numpy as np

from pgcp.errors import DegenerateError, InputError, NotManifoldError, NotSimplyConnectedError
from pgcp.operators import cotangents, face_areas
from pgcp.topology import Topology, examine
from pgcp.types import Mesh


def fitting_target(name: str, topology: Topology, target: str) -> str:
    """Which target is meant; raises NotSimplyConnectedError where the mesh does not allow it."""
    if topology.is_disk and target != "sphere":
        return "free" if target == "auto" else target
    if topology.is_sphere and target in ("auto", "sphere"):
        return "sphere"
    what = f"{name} is {topology.describe()}"
    if topology.is_disk:
        raise NotSimplyConnectedError(f"{what}, which the target sphere does not fit; use target free or disk")
    if topology.is_sphere:
        raise NotSimplyConnectedError(f"{what}, which the target {target} does not fit; use target sphere")
    raise NotSimplyConnectedError(
        f"{what}; no target fits it: free and disk need one open disk with one boundary loop, "
        "sphere one closed surface of genus 0"
    )


def check_mesh(mesh: Mesh, target: str = "auto") -> Topology:
    """Examine a mesh and refuse one that the target does not fit; auto takes open disks and closed spheres.

    Raises NotManifoldError, NotSimplyConnectedError or DegenerateError, saying what the mesh is and where it is wrong.
    """
    topology = examine(mesh.faces, len(mesh.vertices))
    if topology.defects:
        raise NotManifoldError(f"{mesh.name}: {topology.defects[0].message}")
    fitting_target(mesh.name, topology, target)
    areas = face_areas(mesh.vertices, mesh.faces)
    if not areas.sum() > 0:
        raise DegenerateError(f"{mesh.name}: all faces have zero area")
    return topology


def refuse_flat_faces(mesh: Mesh) -> None:
    """Raise DegenerateError, naming them, where faces have no area."""
    bad = np.flatnonzero(~np.isfinite(cotangents(mesh.vertices, mesh.faces)).all(axis=1))
    if len(bad):
        shown = ", ".join(str(f) for f in bad[:5].tolist())
        raise DegenerateError(f"{mesh.name}: {len(bad)} faces have zero area: faces {shown}{', ...' if len(bad) > 5 else ''}")


def check_centre(mesh: Mesh, centre: int | None, moebius: str, target: str) -> None:
    """Refuse a centre that the target or the mesh has not."""
    if centre is None:
        return
    if target == "free":
        raise InputError("the target free has no centre; --centre goes with the targets disk and sphere")
    if target == "disk" and moebius in ("area", "angle"):
        raise InputError("a vertex at the centre leaves no Moebius correction of the disk to choose")
    if centre >= len(mesh.vertices):
        raise InputError(f"{mesh.name}: the centre is vertex {centre}, but the mesh has {len(mesh.vertices)} vertices")
    if not (mesh.faces == centre).any():
        raise InputError(f"{mesh.name}: the centre is vertex {centre}, which no face uses")
