"""What of a file is mapped: split vertices joined, and one component of several chosen. Vertices keep their numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pgcp.errors import InputError
from pgcp.intake.join import joined_vertices
from pgcp.surface.operators import looked_at_areas
from pgcp.surface.topology import Topology, examine
from pgcp.types import FloatArray, IntArray, Mesh, Source

LARGEST, ALL = "largest", "all"
_LISTED = 4


class _Asked(Protocol):
    @property
    def closed(self) -> bool | None:
        """Whether a closed surface is asked for, an open one, or (None) either."""
        ...

    def takes(self, topology: Topology) -> bool:
        """Whether a surface is one that is asked for."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Named:
    """Objects, groups or nodes of a file: their names, and which of them each face (F, L) belongs to, -1 for none."""

    names: tuple[str, ...]
    of_face: IntArray


def named_parts(source: Source, corner_of: IntArray | None) -> Named | None:
    """The parts of a source by triangle, of corners (F, 3); None where it names none."""
    if source.part_of is None:
        return None
    if corner_of is None or source.offsets is None:
        return Named(source.parts, source.part_of)
    return Named(source.parts, source.part_of[np.searchsorted(source.offsets, corner_of[:, 0], "right") - 1])


@dataclass(frozen=True, slots=True, eq=False)
class Given:
    """The mesh that is mapped, in the input's vertex numbers, and what it was made from.

    joined (V,): the vertex that stands for each of the input, None where none was joined; face_of (F',): the input's face that
    each face is, None where there are all; notes: what report.json and the summary say of it; others: which component of how
    many it is and how to map another.
    """

    mesh: Mesh
    topology: Topology
    joined: IntArray | None = None
    face_of: IntArray | None = None
    notes: tuple[dict[str, Any], ...] = ()
    others: str = ""

    @property
    def is_whole(self) -> bool:
        """Whether it is the input as it is."""
        return self.joined is None and self.face_of is None

    def vertex_now(self, vertex: int) -> int:
        """The vertex that stands for one of the input."""
        return int(self.vertices_now(np.array([vertex]))[0])

    def vertices_now(self, vertices: IntArray) -> IntArray:
        """The vertices that stand for those of the input; numbers that it has not stay as they are."""
        if self.joined is None:
            return vertices
        known = (vertices >= 0) & (vertices < len(self.joined))
        return np.where(known, self.joined[np.where(known, vertices, 0)], vertices)

    def _noted(self, step: str, count: int, message: str) -> Given:
        return replace(self, notes=({"step": step, "count": count, "message": message}, *self.notes))


def take(
    mesh: Mesh,
    topology: Topology,
    asked: _Asked,
    distance: float | None = 0.0,
    component: str | None = LARGEST,
    named: Named | None = None,
) -> Given:
    """Join what is split and choose a component of a mesh of this topology.

    distance: how far apart joined vertices may be, as a share of the diagonal of all; None joins none. Where the mesh fits
    what is asked for and would not when joined, as a surface that was cut open on purpose, or where joining would make an edge
    of three faces, nothing is joined. component: the largest, the name of a part, a number from 1 by size, or None for all.
    Raises InputError where there is no such component.
    """
    split = Given(mesh, topology)
    whole = None if distance is None else _joined(split, distance)
    if whole is None:
        return _chosen(split, component, named)
    assert whole.joined is not None
    is_joined = whole.joined != np.arange(len(mesh.vertices))
    count = int(is_joined.sum())
    connected = whole.topology.component_count == topology.component_count
    if connected and _faults(whole.topology) > _faults(topology):
        apart = f"{_vertices(count)} at the places of others stay apart: joined, the surface would not be clean"
        return _chosen(split, component, named)._noted("apart", count, apart)
    one = _chosen(whole, component, named)
    if connected and not asked.takes(one.topology):
        cut = _chosen(split, component, named)
        if asked.takes(cut.topology):
            would = f"joined, it would be {one.topology.describe()}"
            return cut._noted("apart", count, f"{_vertices(count)} at the places of others stay apart: {would}")
    if one.face_of is not None:
        count = int(is_joined[np.unique(mesh.faces[one.face_of])].sum())
        if not count:
            return one
    said = f"{_vertices(count)} at the places of others joined for the map, and given back split as they were"
    return one._noted("join", count, f"{said} (--weld-distance none leaves them apart)")


def _vertices(count: int) -> str:
    return f"{count} {'vertex' if count == 1 else 'vertices'}"


def _faults(topology: Topology) -> int:
    return sum(defect.count for defect in topology.defects)


def _joined(given: Given, distance: float) -> Given | None:
    """The mesh with its open edges joined, None where nothing is to join."""
    mesh = given.mesh
    span = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))) if distance else 0.0
    joined = joined_vertices(mesh.vertices, mesh.faces, given.topology.twins, distance * span)
    if joined is None:
        return None
    whole = Mesh(mesh.vertices, joined[mesh.faces], mesh.name)
    return Given(whole, examine(whole.faces, len(whole.vertices)), joined)


def _chosen(given: Given, component: str | None, named: Named | None) -> Given:
    """One component of a mesh."""
    names = () if named is None else named.names
    if component is None or (component == LARGEST and given.topology.component_count == 1):
        return given
    mesh = given.mesh
    of_face = components_of(mesh.faces, len(mesh.vertices))
    order = by_size(mesh.vertices, mesh.faces, of_face)
    if component == LARGEST:
        chosen = order[0]
    elif component in names:
        assert named is not None
        inside = np.bincount(of_face[(named.of_face == names.index(component)).any(axis=1)], minlength=len(order))
        chosen = int(np.lexsort((np.argsort(order), -inside))[0])
    elif component.isdigit() and 1 <= int(component) <= len(order):
        chosen = order[int(component) - 1]
    else:
        raise InputError(f"{mesh.name}: there is no component {component!r}; {_known(names, len(order))}")
    if len(order) == 1:
        return given
    kept = np.flatnonzero(of_face == chosen)
    one = Mesh(mesh.vertices, mesh.faces[kept], mesh.name)
    sizes = np.bincount(of_face)
    number = order.tolist().index(chosen) + 1
    left_out = _left_out(order, chosen, sizes, of_face, named)
    message = (
        f"component {number} of {len(order)} is mapped, {len(kept)} of {len(mesh.faces)} faces; left out: "
        f"{left_out} (--component all maps all, --component N or NAME another)"
    )
    others = f"it is component {number} of {len(order)}, the others are {left_out}; --component N or NAME maps another"
    chosen_one = Given(one, examine(one.faces, len(one.vertices)), given.joined, kept, given.notes, others)
    return chosen_one._noted("component", len(mesh.faces) - len(kept), message)


def _known(names: Sequence[str], count: int) -> str:
    """What may be chosen instead."""
    numbers = f"there are components 1 to {count}" if count > 1 else "the mesh is one component"
    listed = ", ".join(names[:_LISTED]) + (", ..." if len(names) > _LISTED else "")
    return f"{numbers}{f', and parts named {listed}' if names else ''}"


def _left_out(order: IntArray, chosen: int, sizes: IntArray, of_face: IntArray, named: Named | None) -> str:
    """Numbers, names and sizes of the components that are not mapped."""
    others = [(k + 1, c) for k, c in enumerate(order.tolist()) if c != chosen]
    said = []
    for number, c in others[:_LISTED]:
        name = ""
        if named is not None:
            parts = [part for part in named.of_face[int(np.argmax(of_face == c))].tolist() if part >= 0]
            name = f" {named.names[parts[0]]!r}" if parts else ""
        said.append(f"{number}{name} ({sizes[c]} face{'s' if sizes[c] != 1 else ''})")
    return ", ".join(said) + (f" and {len(others) - _LISTED} more" if len(others) > _LISTED else "")


def components_of(faces: IntArray, vertex_count: int) -> IntArray:
    """Component (F,) of every face: faces that share vertices, however few, are of one."""
    rows, columns = np.concatenate([faces[:, 0], faces[:, 1]]), np.concatenate([faces[:, 1], faces[:, 2]])
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), (vertex_count, vertex_count))
    labels = connected_components(graph, directed=False)[1]
    return np.unique(labels[faces[:, 0]], return_inverse=True)[1].reshape(-1)


def by_size(vertices: FloatArray, faces: IntArray, of_face: IntArray) -> IntArray:
    """Components, those of most faces first, of several those of most area."""
    areas = np.bincount(of_face, looked_at_areas(vertices, faces))
    order: IntArray = np.lexsort((-areas, -np.bincount(of_face)))
    return order
