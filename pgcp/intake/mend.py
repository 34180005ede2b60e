"""Repair a mesh's topology on request: only the steps it needs, each of them recorded, none of them moving a vertex."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pgcp.errors import NotManifoldError
from pgcp.intake.holes import chosen_holes, fill_loops, hole_shares, is_too_large
from pgcp.intake.manifold import (
    coincident,
    contracted,
    cut_edges,
    flattened_fins,
    proper_faces,
    sheets,
    split_fans,
    turn_faces,
    weld_open,
)
from pgcp.surface.operators import looked_at_areas
from pgcp.surface.topology import Topology, examine, pair_half_edges
from pgcp.types import BoolArray, FloatArray, IntArray, Mesh

_DONE = {
    "collapse": "collapsed",
    "drop": "dropped",
    "weld": "welded",
    "cut": "cut",
    "turn": "turned",
    "split": "split",
    "keep": "kept",
    "fill": "filled",
}
_LEAST_KEPT = 0.5


@dataclass(frozen=True, slots=True)
class Fix:
    """One step that was taken: its verb, on how many things, and on which."""

    step: str
    count: int
    what: str

    def as_record(self) -> dict[str, Any]:
        """Plain data for the report."""
        return {"step": self.step, "count": self.count, "message": f"{_DONE[self.step]} {self.what}"}


@dataclass(frozen=True, eq=False)
class Mended:
    """A mesh after the steps it needed; the last ``mesh.filler`` faces close holes, the others are those of the input.

    vertex_of (V',) and face_of (F',): the vertex and the face of the input that each vertex and face is; stands_for (V,)
    for every vertex of the input the one it was welded to, itself if none; obstacle: what no step can mend, if anything;
    known: the mesh's topology, where it was examined before.
    """

    mesh: Mesh
    vertex_of: IntArray
    face_of: IntArray
    stands_for: IntArray
    fixes: tuple[Fix, ...] = ()
    obstacle: str = ""
    known: Topology | None = None

    @cached_property
    def topology(self) -> Topology:
        """What the mesh is, its holes closed."""
        return examine(self.mesh.faces, len(self.mesh.vertices)) if self.known is None else self.known

    def vertex_now(self, vertex: int) -> int | None:
        """The mended mesh's vertex that a vertex of the input has become, the first of several; None where it is gone."""
        now = np.flatnonzero(self.vertex_of == self.stands_for[vertex])
        return int(now[0]) if len(now) else None


def unmended(mesh: Mesh, topology: Topology | None = None) -> Mended:
    """A mesh as it is, of this topology where it is known."""
    vertices = np.arange(len(mesh.vertices))
    return Mended(mesh, vertices, np.arange(len(mesh.bare.faces)), vertices, known=topology)


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {'vertices' if noun == 'vertex' else noun + 's'}"


def _repeat_a_vertex(faces: IntArray) -> BoolArray:
    return (faces == np.roll(faces, -1, axis=1)).any(axis=1)


class _Plan:
    """The steps on their way through one mesh: faces and the input's vertices and faces they stem from.

    topology: of the faces as they are now, where they have been examined.
    """

    def __init__(self, points: FloatArray, faces: IntArray, name: str, topology: Topology) -> None:
        self.name = name
        self.points = points
        self.faces: IntArray = np.ascontiguousarray(faces, np.int64)
        self.vertex_of: IntArray = np.arange(len(points))
        self.face_of: IntArray = np.arange(len(faces))
        self.stands_for: IntArray = np.arange(len(points))
        self.filler: IntArray = np.empty((0, 3), np.int64)
        self.fixes: list[Fix] = []
        self.obstacle = ""
        self.topology: Topology | None = topology

    def _note(self, step: str, count: int, what: str) -> None:
        if count:
            self.fixes.append(Fix(step, count, what))
            self.topology = None

    def _select(self, kept: IntArray) -> None:
        self.faces, self.face_of = self.faces[kept], self.face_of[kept]

    def collapse(self) -> None:
        """Collapse edges of no length, and the faces of no area beside them; fins of no thickness that this leaves go too."""
        self.stands_for = contracted(self.points, self.faces)
        faces = self.stands_for[self.faces]
        gone = _repeat_a_vertex(faces) & ~_repeat_a_vertex(self.faces)
        count, flat = int((self.stands_for != np.arange(len(self.stands_for))).sum()), int(gone.sum())
        what = f"{_counted(count, 'vertex')} into neighbours at the same place, with {_counted(flat, 'face')} of no area"
        self._note("collapse", count, what)
        self.faces = faces
        self._select(np.flatnonzero(~gone))
        fins = flattened_fins(self.faces, len(self.vertex_of))
        self._note("drop", int(fins.sum()), f"{_counted(int(fins.sum()), 'face')} (back to back in pairs)")
        self._select(np.flatnonzero(~fins))

    def drop(self, same: IntArray | None = None) -> None:
        """Drop faces that use a vertex twice, and all but the first with the same vertices."""
        kept, repeated, again = proper_faces(self.faces, same)
        if len(kept) == 0:
            raise NotManifoldError(f"{self.name}: all faces use a vertex twice")
        reasons = [f"{n} {why}" for n, why in ((repeated, "using a vertex twice"), (again, "listed twice")) if n]
        count = repeated + again
        self._note("drop", count, f"{_counted(count, 'face')} ({', '.join(reasons)})")
        self._select(kept)

    def weld(self, same: IntArray) -> None:
        """Weld vertices at the same place that open edges end in."""
        self.drop(same)
        welded = weld_open(self.faces, same)
        count = int((welded != np.arange(len(welded))).sum())
        self.stands_for, self.faces = welded[self.stands_for], welded[self.faces]
        self._note("weld", count, f"{_counted(count, 'vertex')} to others at the same place")
        self.drop()

    def cut(self) -> None:
        """Cut edges of more than two faces."""
        self.faces, self.vertex_of, count = cut_edges(self.points, self.faces, self.vertex_of)
        self._note("cut", count, f"{_counted(count, 'edge')} of more than two faces")

    def split(self) -> None:
        """Split vertices where fans of faces touch."""
        twins = pair_half_edges(self.faces, len(self.vertex_of))
        self.faces, self.vertex_of, count = split_fans(self.faces, twins, self.vertex_of)
        self._note("split", count, f"{_counted(count, 'vertex')} where faces touch in the vertex only")

    def keep(self) -> None:
        """Keep the component with most faces, of several the one with most area."""
        twins = pair_half_edges(self.faces, len(self.vertex_of))
        component = sheets(self.points[self.vertex_of], self.faces, twins)[0]
        count = int(component.max()) + 1
        if count == 1:
            return
        sizes = np.bincount(component)
        areas = np.bincount(component, looked_at_areas(self.points[self.vertex_of], self.faces))
        largest = np.lexsort((-areas, -sizes))[0]
        what = f"the largest of {count} components ({sizes[largest]} of {len(self.faces)} faces)"
        self._note("keep", len(self.faces) - int(sizes[largest]), what)
        self._select(np.flatnonzero(component == largest))

    def turn(self) -> None:
        """Make faces agree in orientation."""
        twins = pair_half_edges(self.faces, len(self.vertex_of))
        turned = sheets(self.points[self.vertex_of], self.faces, twins)[1]
        count = int(turned.sum())
        self.faces = turn_faces(self.faces, turned)
        self._note("turn", count, f"{_counted(count, 'face')} to agree with the others")

    def compact(self, given: IntArray) -> None:
        """Leave out vertices that only the given faces, not those that are left, use."""
        wanted = np.ones(len(self.vertex_of), bool)
        wanted[given.reshape(-1)] = False
        wanted[len(self.points) :] = False
        wanted[self.faces.reshape(-1)] = True
        self.faces = (np.cumsum(wanted) - 1)[self.faces]
        self.vertex_of = self.vertex_of[wanted]

    def fill(self, closed: bool | None) -> None:
        """Fill the holes that are not to stay open, or say which is too large."""
        topology = self.topology = self.topology or examine(self.faces, len(self.vertex_of))
        if topology.defects:
            self.obstacle = "--fix cannot mend that"
        elif topology.genus:
            self.obstacle = "--fix does not change the genus"
        if self.obstacle or not topology.loops or topology.fits(closed):
            return
        points = self.points[self.vertex_of]
        shares = hole_shares(points, self.faces, topology.loops)
        chosen = chosen_holes(shares, closed)
        loops = [topology.loops[i] for i in chosen]
        reasons = [is_too_large(float(shares[i]), len(topology.loops[i])) for i in chosen]
        filled = [] if any(reasons) else fill_loops(points, self.faces, loops)
        reasons = reasons if any(reasons) else ["" if f is not None else "its vertices are joined already" for f in filled]
        for loop, reason in zip(loops, reasons, strict=True):
            if reason:
                where = f"the hole of {len(loop)} edges at vertex {self.vertex_of[loop.min()]}"
                self.obstacle = f"--fix does not fill {where}: {reason}"
                return
        self.filler = np.concatenate([f for f in filled if f is not None])
        sizes = ", ".join(str(len(loop)) for loop in loops[:5]) + (", ..." if len(loops) > 5 else "")
        self._note("fill", len(loops), f"{_counted(len(loops), 'hole')} ({sizes} edges) with {len(self.filler)} faces")

    def finished(self, mesh: Mesh) -> Mended:
        """The plan as a result."""
        vertices = mesh.vertices[self.vertex_of]
        mended = Mesh(vertices, np.concatenate([self.faces, self.filler]), mesh.name, len(self.filler))
        fixes = tuple(self.fixes)
        return Mended(mended, self.vertex_of, self.face_of, self.stands_for, fixes, self.obstacle, self.topology)


def _mended(
    mesh: Mesh, topology: Topology, points: FloatArray, closed: bool | None, same: IntArray | None, collapses: bool
) -> Mended:
    """Every step in its order; ``same`` (V,) welds, None leaves vertices at one place apart."""
    plan = _Plan(points, mesh.faces, mesh.name, topology)
    if collapses:
        plan.collapse()
    plan.drop()
    if same is not None:
        plan.weld(same)
    plan.cut()
    plan.split()
    plan.keep()
    plan.turn()
    plan.compact(mesh.faces)
    plan.fill(closed)
    return plan.finished(mesh)


def mend(mesh: Mesh, closed: bool | None = None, topology: Topology | None = None, *, collapses: bool = False) -> Mended:
    """Repair the topology of a mesh as far as dropping, cutting and filling can, to a closed or an open surface, or either.

    In this order, each where it is needed: with ``collapses``, edges of no length are collapsed; faces that use a vertex
    twice or are listed twice are dropped; vertices at exactly the same place are welded; edges of more than two faces are
    cut; vertices where fans of faces touch are split; the component of most faces is kept; its faces are turned to agree;
    small holes are filled. Welding is done only where it saves faces from being left out or holes from being filled: a mesh
    may well have vertices that coincide. A mesh that fits comes back as it is unless it is to be collapsed. Raises
    NotManifoldError where no face is left; of what else cannot be mended ``obstacle`` and ``topology`` of the result tell.
    A ``topology`` that is given is not looked for again.
    """
    topology = examine(mesh.faces, len(mesh.vertices)) if topology is None else topology
    if topology.fits(closed) and not collapses:
        return unmended(mesh, topology)
    points = np.ldexp(mesh.vertices, -int(np.frexp(np.abs(mesh.vertices).max())[1]))
    plans = [_mended(mesh, topology, points, closed, None, collapses)]
    same = coincident(mesh.vertices)
    if (same != np.arange(len(same))).any():
        with contextlib.suppress(NotManifoldError):  # where no face would be left
            plans.append(_mended(mesh, topology, points, closed, same, collapses))
    most = max(len(plan.face_of) for plan in plans)
    good = [p for p in plans if p.topology.fits(closed) and len(p.face_of) >= _LEAST_KEPT * most]
    return min(good or plans, key=lambda plan: (-len(plan.face_of), plan.mesh.filler))
