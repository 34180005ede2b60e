"""What a mesh is, which target fits it, and what cannot be mapped at all: checked before any work is done."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numba
import numpy as np

from pgcp.errors import DegenerateError, InputError, NotManifoldError, NotSimplyConnectedError
from pgcp.intake.mend import Mended, mend
from pgcp.parallel import beside
from pgcp.surface import plain
from pgcp.surface.operators import looked_at_areas, needed_mollification
from pgcp.surface.topology import Topology, examine
from pgcp.types import FloatArray, IntArray, Mesh

_MOST_FLAT = 0.5
_PILLOW = (
    "the surface is two faces glued along all three edges, which no map to the sphere gives an area both; a closed surface "
    "needs four vertices"
)
_FAR = 1e4
_AWAY = 1.5  # sizes from the origin: there all coordinates are within a factor of two, and differ by numbers without error


class Asked(Protocol):
    """What surface is asked for."""

    @property
    def closed(self) -> bool | None:
        """A closed one, an open one, or (None) either."""
        ...

    def takes(self, topology: Topology) -> bool:
        """Whether a surface is one that is asked for."""
        ...

    def refusal(self, topology: Topology) -> str:
        """Why a surface that is another does not do, as the end of a sentence."""
        ...


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
    flat = int(np.count_nonzero(~(looked_at_areas(bare.vertices, bare.faces) > 0.0)))
    return Geometry(moved, unit, needed_mollification(moved.vertices, moved.faces), flat)


@dataclass(frozen=True, slots=True, eq=False)
class Inspection:
    """What a mesh is: its topology, its geometry where it was asked for, why it is refused, and the mesh mended.

    mended: None where mending does not help or is not needed. After ``inspect_mended`` all is said of the mended mesh, and
    ``advises`` is false.
    """

    topology: Topology
    geometry: Geometry | None
    problem: InputError | None
    mended: Mended | None = None
    advises: bool = True

    @property
    def cure(self) -> str:
        """The steps that would make the mesh fit, as a phrase; empty where they would not, or where none is needed."""
        return "" if self.mended is None else ", ".join(f"{fix.step} {fix.what}" for fix in self.mended.fixes)

    def accepted(self) -> tuple[Topology, Geometry]:
        """Topology and geometry of the mesh; raises what it is refused for, and says what ``--fix`` would do."""
        if self.problem is None and self.geometry is not None:
            return self.topology, self.geometry
        assert self.problem is not None
        raise type(self.problem)(f"{self.problem}; --fix would {self.cure}") if self.cure and self.advises else self.problem


def inspect(mesh: Mesh, asked: Asked) -> Inspection:
    """Examine a mesh, once; where it is not what is asked for, see what mending it would do."""
    return advised(mesh, asked, look(mesh, asked))


def look(mesh: Mesh, asked: Asked, topology: Topology | None = None) -> Inspection:
    """Examine a mesh, of this topology where it is known, and no more."""
    with beside(partial(measure, mesh)) as measured:
        topology = examine(mesh.faces, len(mesh.vertices)) if topology is None else topology
        return Inspection(topology, *_judged(mesh, asked, topology, measured))


def advised(mesh: Mesh, asked: Asked, seen: Inspection) -> Inspection:
    """What was seen of a mesh; where it is not what is asked for, with what mending it would do."""
    topology, geometry, problem = seen.topology, seen.geometry, seen.problem
    if problem is None:
        return seen
    try:
        mended, _, left = _mended(mesh, asked, topology)
    except NotManifoldError:
        return Inspection(topology, geometry, problem)
    return Inspection(topology, geometry, problem, mended if left is None and mended.fixes else None)


def inspect_mended(mesh: Mesh, asked: Asked, topology: Topology | None = None) -> Inspection:
    """Mend a mesh, of this topology where it is known, and examine the result; the problem says what could not be mended."""
    mended, geometry, problem = _mended(mesh, asked, topology)
    if isinstance(problem, (NotManifoldError, NotSimplyConnectedError)) and mended.obstacle:
        problem = type(problem)(f"{problem}; {mended.obstacle}")
    return Inspection(mended.topology, geometry, problem, mended, advises=False)


def _mended(mesh: Mesh, asked: Asked, topology: Topology | None) -> tuple[Mended, Geometry | None, InputError | None]:
    """A mesh mended, its geometry, and why it is refused still; edges of no length are collapsed where nothing less helps."""
    mended = mend(mesh, asked.closed, topology)
    geometry, problem = _judged_mended(mended, asked)
    if isinstance(problem, DegenerateError) and not _lost_digits(mesh):
        with contextlib.suppress(NotManifoldError):  # no face would be left
            collapsed = mend(mesh, asked.closed, topology, collapses=True)
            again = _judged_mended(collapsed, asked)
            if again[1] is None:
                return collapsed, *again
    return mended, geometry, problem


def _judged_mended(mended: Mended, asked: Asked) -> tuple[Geometry | None, InputError | None]:
    named = mended.mesh
    if mended.fixes:
        named = Mesh(named.vertices, named.faces, f"{named.name}, fixed,", named.filler)
    look = partial(measure, mended.mesh)
    if mended.known is not None:  # nothing to look for meanwhile
        return _judged(named, asked, mended.known, look)
    with beside(look) as measured:
        return _judged(named, asked, mended.topology, measured)


def _judged(
    mesh: Mesh, asked: Asked, topology: Topology, measured: Callable[[], Geometry]
) -> tuple[Geometry | None, InputError | None]:
    """The geometry of a mesh that can be mapped, or why it cannot."""
    if topology.defects:
        return None, NotManifoldError(f"{mesh.name}: {topology.defects[0].message}")
    if topology.is_sphere and topology.face_count == 2:
        return None, DegenerateError(f"{mesh.name}: {_PILLOW}")
    if not asked.takes(topology):
        return None, NotSimplyConnectedError(f"{mesh.name} is {topology.describe()}{asked.refusal(topology)}")
    try:
        return _solid(mesh, measured()), None
    except DegenerateError as problem:
        return None, problem


def _solid(mesh: Mesh, geometry: Geometry) -> Geometry:
    """The geometry of a mesh; raises DegenerateError where most of its faces have no area."""
    count = len(mesh.bare.faces)
    if geometry.flat_count == count:
        raise DegenerateError(f"{mesh.name}: all faces have zero area")
    if geometry.flat_count > _MOST_FLAT * count:
        raise DegenerateError(f"{mesh.name}: {geometry.flat_count} of {count} faces have zero area{_lost_digits(mesh)}")
    return geometry


def _lost_digits(mesh: Mesh) -> str:
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    far, size = float(np.maximum(np.abs(low), np.abs(high)).max()), float((high - low).max())
    if far > _FAR * size > 0:
        return f"; it lies {far / size:.0e} times its own size from the origin, where coordinates lose their digits"
    return ""


def unit_mesh(mesh: Mesh) -> tuple[Mesh, float]:
    """The mesh moved near the origin and scaled by a power of two to a size of about 1, and that power of two.

    Results then depend neither on the unit of length nor, but for rounding, on the place. Nothing is rounded here: along an
    axis on which the mesh is not far from the origin it stays where it is. Raises DegenerateError where all vertices coincide.
    """
    largest = float(max(mesh.vertices.max(), -mesh.vertices.min()))
    exponent = int(np.frexp(largest)[1])
    points = np.ldexp(mesh.vertices, -exponent)
    look = plain.extent if plain.is_few(mesh.faces, _extent) else _extent
    low, high = look(points, mesh.faces)
    size = float((high - low).max())
    if not size > 0.0:
        raise DegenerateError(f"{mesh.name}: all faces have zero area")
    more = int(np.frexp(size)[1])
    middle = 0.5 * (low + high)
    points -= np.where(np.abs(middle) > _AWAY * (high - low), middle, 0.0)
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
