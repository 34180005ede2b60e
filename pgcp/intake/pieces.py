"""A surface of several components taken apart, to be mapped one after the other, and the way back to all of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgcp.intake.give_back import GivenBack, give_back
from pgcp.intake.given import Given, Named, by_size, components_of, take
from pgcp.intake.mend import Mended
from pgcp.surface.topology import Topology, examine
from pgcp.types import IntArray, Mesh


class _Any:
    """Any surface is asked for."""

    closed = None

    def takes(self, topology: Topology) -> bool:
        """Whether a surface is one that can be mapped."""
        return topology.fits(None)


@dataclass(frozen=True, eq=False)
class Pieces:
    """Components of a mesh, those of most faces first.

    mesh: the input; whole: all of it, what is split joined; named: its parts.
    """

    mesh: Mesh
    whole: Given
    named: Named | None

    @classmethod
    def of(cls, mesh: Mesh, distance: float | None, named: Named | None) -> Pieces:
        """Take a mesh apart; vertices that are split, up to a share of the diagonal apart, are joined first."""
        topology = examine(mesh.faces, len(mesh.vertices))
        return cls(mesh, take(mesh, topology, _Any(), distance, None), named)

    @cached_property
    def _of_face(self) -> IntArray:
        return components_of(self.whole.mesh.faces, len(self.mesh.vertices))

    @cached_property
    def _order(self) -> IntArray:
        return by_size(self.mesh.vertices, self.whole.mesh.faces, self._of_face)

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self._order)

    def faces_of(self, number: int) -> IntArray:
        """The faces of one."""
        return np.flatnonzero(self._of_face == self._order[number])

    def piece(self, number: int) -> tuple[Mesh, IntArray]:
        """One of them as a mesh, and which vertices of all it has."""
        used, corners = np.unique(self.whole.mesh.faces[self.faces_of(number)], return_inverse=True)
        return Mesh(self.mesh.vertices[used], corners.reshape(-1, 3), f"{self.mesh.name}, {self.name(number)}"), used

    def name(self, number: int) -> str:
        """What one of them is called."""
        label = f"component {number + 1}"
        if self.named is None:
            return label
        parts = [part for part in self.named.of_face[self.faces_of(number)[0]].tolist() if part >= 0]
        return f"{label} {self.named.names[parts[0]]!r}" if parts else label

    def given_back(self, vertices: Sequence[IntArray], faces: Sequence[IntArray], face_of: Sequence[IntArray]) -> GivenBack:
        """The surface of maps of some components on the vertices and in the order of the input.

        vertices: of each map, (n,) vertices of all; faces: of each map, (m, 3) in its own numbers; face_of: (m,) faces of all.
        """
        starts = np.cumsum([0, *(len(one) for one in vertices)])
        together = np.concatenate([one + start for one, start in zip(faces, starts, strict=False)])
        own = np.concatenate(face_of)
        order = np.argsort(own, kind="stable")
        vertex_of = np.concatenate(vertices)
        stacked = Mesh(self.mesh.vertices[vertex_of], together[order], self.mesh.name)
        mended = Mended(stacked, vertex_of, own[order], np.arange(len(self.mesh.vertices)))
        part = Given(self.whole.mesh, self.whole.topology, self.whole.joined, np.arange(len(self.mesh.faces)))
        return give_back(self.mesh, part, mended)
