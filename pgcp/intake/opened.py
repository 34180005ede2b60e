"""Surfaces cut open to a disk, along edges that are chosen or given. Vertices are split, and nothing moves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pgcp.errors import InputError, NotSimplyConnectedError
from pgcp.intake.manifold import split_fans
from pgcp.intake.mend import Mended
from pgcp.surface.cutting import EdgeGraph, open_surface, opened_twins, spread_vertices, with_tips
from pgcp.surface.hidden import edge_costs, visibility
from pgcp.surface.operators import face_areas
from pgcp.surface.squeeze import Foretold, scale_ratio, tips_of
from pgcp.surface.topology import Topology, examine
from pgcp.types import BoolArray, FloatArray, IntArray, Mesh

_ROUNDS = 30  # of tips, before any map
_SAFE = 0.9  # of the bound, that is aimed at before there is a map
_ROOTS = 4
_INSIDE_POLYGONS = 1e4  # times dearer: polygons stay whole where that can be


@dataclass(frozen=True, slots=True, eq=False)
class Opened:
    """A surface cut open: the mesh with its topology, the vertex (V',) of the surface that each of its own is, and the cut.

    edges (n, 2): vertices of the surface, n edges that were not boundary before; tips: vertices that the cut was led to;
    length: of the cut, in the mesh's unit; record: what report.json says of it before there is a map.
    """

    mesh: Mesh
    topology: Topology
    vertex_of: IntArray
    edges: IntArray
    tips: IntArray
    record: dict[str, Any]

    def after(self, mended: Mended) -> Mended:
        """What a mended mesh, the surface, has become by the cut."""
        if not len(self.edges):
            return mended
        whole = mended.mesh
        mesh = Mesh(whole.vertices[self.vertex_of], self.mesh.faces, whole.name, whole.filler)
        return replace(mended, mesh=mesh, vertex_of=mended.vertex_of[self.vertex_of], known=self.topology)


class Opener:
    """A connected oriented surface that is to be cut open.

    mesh: of about unit size; topology: its own; polygon_of (F,): of which polygon each face is, where there are polygons; they
    stay whole where that can be.
    """

    def __init__(self, mesh: Mesh, topology: Topology, polygon_of: IntArray | None = None) -> None:
        self.mesh, self.topology = mesh, topology
        self._graph = EdgeGraph.of(mesh.faces, topology.twins, len(mesh.vertices))
        self._polygon_of = polygon_of
        self._costs: FloatArray = np.empty(0)
        self._base: BoolArray = np.empty(0, bool)
        self._spread: IntArray = np.empty(0, np.int64)
        self._seen: FloatArray = np.empty(0)
        self._foretold: Foretold | None = None

    def along(self, pairs: IntArray, path: Path) -> Opened:
        """The surface cut along edges, pairs (n, 2) of vertices, that a file names.

        Raises InputError where one is no edge, NotSimplyConnectedError where the cut leaves no disk.
        """
        numbers = self._graph.numbers(pairs)
        if (numbers < 0).any():
            wrong = pairs[np.argmin(numbers)]
            raise InputError(f"{path}: {wrong[0]}-{wrong[1]} is no edge of {self.mesh.name}")
        cut = np.zeros(len(self._graph.ends), bool)
        cut[numbers] = True
        opened = self._opened(cut, np.empty(0, np.int64))
        if not opened.topology.is_disk:
            left = opened.topology.describe()
            raise NotSimplyConnectedError(
                f"{path}: cut along its {len(opened.edges)} edges, {self.mesh.name} is {left}; a cut must leave one open disk "
                "with one boundary loop (--cut auto finds one)"
            )
        return opened

    def automatic(self, bound: float, kind: int = 0) -> Opened:
        """The surface cut by a short, hidden cut, with tips for which a scale ratio below the bound is foretold.

        kind: of the costs (``edge_costs``), which lead to other cuts.
        """
        self._look(kind)
        return self._with(self._first_tips(), bound)

    def further(self, opened: Opened, log_scale: FloatArray, bound: float) -> Opened | None:
        """A cut that goes through further tips: where a map of the opened mesh, by log_scale (V',), squeezes most.

        None where there is nothing left to cut.
        """
        assert self._foretold is not None
        areas = self._foretold.areas
        total = np.bincount(opened.vertex_of, minlength=len(areas))
        here = np.bincount(opened.vertex_of, log_scale, len(areas)) / np.maximum(total, 1)
        on_cut = self._on(self._graph.is_boundary)
        on_cut[opened.edges.reshape(-1)] = True
        more = tips_of(self._graph.ends, here, areas, on_cut, bound)
        if not len(more):
            return None
        return self._with(np.concatenate([opened.tips, more]), bound)

    def _look(self, kind: int) -> None:
        """Costs of all edges, and the cut that every other begins with: through handles and boundaries."""
        mesh, graph = self.mesh, self._graph
        if self._foretold is None:
            self._foretold = Foretold(mesh.vertices, mesh.faces)
            self._seen = visibility(mesh.vertices, mesh.faces)
        self._costs = edge_costs(mesh.vertices, mesh.faces, graph.ends, graph.halves, self._seen, kind)
        if self._polygon_of is not None:
            one, two = self._polygon_of[graph.halves // 3].T
            self._costs[(one == two) & ~graph.is_boundary] *= _INSIDE_POLYGONS
        self._spread = spread_vertices(graph, self._costs, self._foretold.areas > 0.0, _ROOTS)
        loops = np.array([loop[0] for loop in self.topology.loops], np.int64)
        self._base = open_surface(graph, self._costs, np.concatenate([loops[:1], self._spread]), loops)

    def _first_tips(self) -> IntArray:
        """Tips without which there is no cut: two far from each other where nothing opens the surface."""
        if self._base.any():
            return np.empty(0, np.int64)
        tips = self._spread[:2]
        if self._cut(tips).sum() < 2:  # a cut along one edge splits no vertex
            ends = self._graph.ends
            beside = ends[(ends == tips[0]).any(axis=1)].reshape(-1)
            tips = np.append(tips, np.setdiff1d(beside, tips)[0])
        return tips

    def _cut(self, tips: IntArray) -> BoolArray:
        return with_tips(self._graph, self._costs, self._base, tips)

    def _on(self, cut: BoolArray) -> BoolArray:
        return np.asarray(self._graph.degrees(cut) > 0)

    def _with(self, tips: IntArray, bound: float) -> Opened:
        """The surface cut through tips, and through more of them until the scale ratio that is foretold is below the bound."""
        assert self._foretold is not None
        cut, ratio = self._cut(tips), np.inf
        for _ in range(_ROUNDS):
            u = self._foretold.log_scale(self._on(cut))
            ratio = scale_ratio(u, self._foretold.areas)
            if ratio <= max(_SAFE * bound, 1.0):
                break
            more = tips_of(self._graph.ends, u, self._foretold.areas, self._on(cut), max(_SAFE * bound, 1.0))
            if not len(more):
                break
            tips = np.concatenate([tips, more])
            cut = self._cut(tips)
        opened = self._opened(cut, tips)
        return replace(opened, record={**opened.record, "foretold_scale_ratio": ratio})

    def _opened(self, cut: BoolArray, tips: IntArray) -> Opened:
        mesh, graph = self.mesh, self._graph
        inner = cut & ~graph.is_boundary
        edges = graph.ends[inner]
        length = float(np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1).sum())
        bare = mesh.bare
        area = float(face_areas(bare.vertices, bare.faces).sum())
        span = float(np.linalg.norm(np.ptp(bare.vertices[np.unique(bare.faces)], axis=0)))
        record = {
            "edges": len(edges),
            "length_by_diagonal": length / max(span, 1e-300),
            "length_by_root_of_area": length / max(area**0.5, 1e-300),
            "genus": self.topology.genus,
            "boundaries": len(self.topology.loops),
            "tips": len(tips),
        }
        if not len(edges):
            return Opened(mesh, self.topology, np.arange(len(mesh.vertices)), edges, tips, record)
        twins = opened_twins(graph, self.topology.twins, cut)
        faces, vertex_of, _ = split_fans(mesh.faces, twins, np.arange(len(mesh.vertices)))
        new = Mesh(mesh.vertices[vertex_of], faces, mesh.name, mesh.filler)
        return Opened(new, examine(new.faces, len(new.vertices)), vertex_of, edges, tips, record)
