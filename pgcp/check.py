"""What a mesh is, which target fits it, and what cannot be mapped at all: checked before any work is done."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numba
import numpy as np

from pgcp.errors import DegenerateError, InputError, NotManifoldError, NotSimplyConnectedError
from pgcp.mend import Mended, mend
from pgcp.operators import face_areas, needed_mollification
from pgcp.parallel import beside
from pgcp.topology import Topology, examine
from pgcp.types import FloatArray, IntArray, Mesh

_MOST_FLAT = 0.5
_FAR = 1e4


def fitting_target(name: str, topology: Topology, target: str) -> str:
    """Which target is meant; raises NotSimplyConnectedError where the mesh does not allow it."""
    if topology.fits(target):
        return "sphere" if topology.is_sphere else "free" if target == "auto" else target
    what = f"{name} is {topology.describe()}"
    if topology.is_disk:
        raise NotSimplyConnectedError(f"{what}, which the target sphere does not fit; use target free or disk")
    if topology.is_sphere:
        raise NotSimplyConnectedError(f"{what}, which the target {target} does not fit; use target sphere")
    raise NotSimplyConnectedError(
        f"{what}; no target fits it: free and disk need one open disk with one boundary loop, "
        "sphere one closed surface of genus 0"
    )


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """A mesh at the origin and of about unit size; that unit; the mollification it needs there, and its faces without area."""

    mesh: Mesh
    unit: float
    mollification: float
    flat_count: int


def measure(mesh: Mesh) -> Geometry:
    """Move a mesh to the origin and scale it, and see what its faces are; raises DegenerateError where they are one point."""
    moved, unit = unit_mesh(mesh)
    bare = moved.bare
    flat = int(np.count_nonzero(~(face_areas(bare.vertices, bare.faces) > 0.0)))
    return Geometry(moved, unit, needed_mollification(moved.vertices, moved.faces), flat)


def check_mesh(mesh: Mesh, target: str = "auto") -> Topology:
    """Examine a mesh and refuse one that the target does not fit; auto takes open disks and closed spheres.

    Raises NotManifoldError, NotSimplyConnectedError or DegenerateError, saying what the mesh is and where it is wrong, and
    what ``--fix`` would do where that makes it fit.
    """
    return checked(mesh, target)[0]


def checked(mesh: Mesh, target: str = "auto") -> tuple[Topology, Geometry]:
    """As ``check_mesh``; topology and geometry, looked at at the same time."""
    with beside(partial(measure, mesh)) as geometry:
        topology = examine(mesh.faces, len(mesh.vertices))
        try:
            return _check(mesh, target, topology, geometry)
        except (NotManifoldError, NotSimplyConnectedError) as problem:
            cure = what_fix_would_do(mesh, target)
            raise type(problem)(f"{problem}; --fix would {cure}" if cure else str(problem)) from None


def check_mended(mended: Mended, target: str = "auto") -> tuple[Topology, Geometry]:
    """The same of a mesh that has been mended: says what could not be."""
    mesh = mended.mesh
    if mended.fixes:
        mesh = Mesh(mesh.vertices, mesh.faces, f"{mesh.name}, fixed,", mesh.filler)
    with beside(partial(measure, mended.mesh)) as geometry:
        try:
            return _check(mesh, target, mended.topology, geometry)
        except (NotManifoldError, NotSimplyConnectedError) as problem:
            raise type(problem)(f"{problem}; {mended.obstacle}" if mended.obstacle else str(problem)) from None


def what_fix_would_do(mesh: Mesh, target: str = "auto") -> str:
    """The steps that would make a mesh fit the target, as a phrase; empty where they would not, or where none is needed."""
    try:
        mended = mend(mesh, target)
        check_mended(mended, target)
    except InputError:
        return ""
    return ", ".join(f"{fix.step} {fix.what}" for fix in mended.fixes)


def _check(mesh: Mesh, target: str, topology: Topology, measured: Callable[[], Geometry]) -> tuple[Topology, Geometry]:
    if topology.defects:
        raise NotManifoldError(f"{mesh.name}: {topology.defects[0].message}")
    fitting_target(mesh.name, topology, target)
    geometry, count = measured(), len(mesh.bare.faces)
    if geometry.flat_count == count:
        raise DegenerateError(f"{mesh.name}: all faces have zero area")
    if geometry.flat_count > _MOST_FLAT * count:
        raise DegenerateError(f"{mesh.name}: {geometry.flat_count} of {count} faces have zero area{_lost_digits(mesh)}")
    return topology, geometry


def _lost_digits(mesh: Mesh) -> str:
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    far, size = float(np.maximum(np.abs(low), np.abs(high)).max()), float((high - low).max())
    if far > _FAR * size > 0:
        return f"; it lies {far / size:.0e} times its own size from the origin, where coordinates lose their digits"
    return ""


def unit_mesh(mesh: Mesh) -> tuple[Mesh, float]:
    """The mesh moved to the origin and scaled by a power of two to a size of about 1, and that power of two.

    Results then depend neither on the unit of length nor on the place. Raises DegenerateError where all vertices coincide.
    """
    largest = float(max(mesh.vertices.max(), -mesh.vertices.min()))
    exponent = int(np.frexp(largest)[1])
    points = np.ldexp(mesh.vertices, -exponent)
    low, high = _extent(points, mesh.faces)
    size = float((high - low).max())
    if not size > 0.0:
        raise DegenerateError(f"{mesh.name}: all faces have zero area")
    more = int(np.frexp(size)[1])
    points -= 0.5 * (low + high)
    np.ldexp(points, -more, out=points)
    return Mesh(points, mesh.faces, mesh.name, mesh.filler), float(np.ldexp(1.0, exponent + more))


@numba.njit(cache=True, nogil=True)
def _extent(points: FloatArray, faces: IntArray) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest coordinates (3,) of the points that faces use."""
    used = np.zeros(points.shape[0], np.bool_)
    for f in range(faces.shape[0]):
        for i in range(3):
            used[faces[f, i]] = True
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for v in range(points.shape[0]):
        if used[v]:
            for d in range(3):
                low[d], high[d] = min(low[d], points[v, d]), max(high[d], points[v, d])
    return low, high


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
