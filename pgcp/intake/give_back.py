"""A finished map given back on the vertices of the input: split where the input was split."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgcp.intake.given import Given
from pgcp.intake.mend import Mended
from pgcp.types import BoolArray, IntArray, Mesh


@dataclass(frozen=True, slots=True, eq=False)
class GivenBack:
    """The mapped surface as the input has it.

    mesh: the input's vertices and faces, those that were mapped; point_of (V',): the mended mesh's vertex at each; vertex_of
    (V',), face_of (F',): the input's vertex and face that each is; turned (F',): whether a face was turned over, so that
    its second and third corners are the input's third and second; is_all: whether it is the input itself.
    """

    mesh: Mesh
    point_of: IntArray
    vertex_of: IntArray
    face_of: IntArray
    turned: BoolArray
    is_all: bool = False

    def corners(self, corner_of: IntArray | None) -> IntArray | None:
        """Corners (F', 3) of the source; ``corner_of`` (F, 3) those of the input's faces.

        None stands for corners of triangles that are all there, in order.
        """
        if corner_of is None and self.is_all:
            return None
        here = 3 * self.face_of[:, None] + np.arange(3) if corner_of is None else corner_of[self.face_of]
        here[self.turned] = here[self.turned][:, [0, 2, 1]]
        return here


def give_back(mesh: Mesh, given: Given, mended: Mended) -> GivenBack:
    """The surface of a map in the input's vertices and faces.

    mesh: the input; given: what of it was taken; mended: what that became. Where a vertex of the input has become several
    points, as where ``--fix`` cuts, it is repeated; vertices that no face of the input uses stay, in their order, where no
    component was chosen.
    """
    if given.is_whole and mended.mesh is mesh:
        return _unchanged(mesh)
    bare = mended.mesh.bare.faces.astype(np.int64)
    face_of = mended.face_of if given.face_of is None else given.face_of[mended.face_of]
    here = mesh.faces[face_of].astype(np.int64)
    now = here if given.joined is None else given.joined[here]
    turned = (mesh.vertices[now] != mesh.vertices[mended.vertex_of[bare]]).any(axis=(1, 2))
    here[turned] = here[turned][:, [0, 2, 1]]
    count = len(mended.vertex_of)
    stray = _unused(mesh, mended) if given.face_of is None else np.empty(0, np.int64)
    keys, corners = np.unique(np.concatenate([(here * count + bare).reshape(-1), stray]), return_inverse=True)
    ordered, places = _copies_last(keys, corners.reshape(-1), count)
    vertex_of, point_of = ordered // count, ordered % count
    faces = places[: bare.size].reshape(bare.shape)
    return GivenBack(Mesh(mesh.vertices[vertex_of], faces, mesh.name), point_of, vertex_of, face_of, turned)


def _copies_last(keys: IntArray, corners: IntArray, count: int) -> tuple[IntArray, IntArray]:
    """Sorted keys (n,) with those after all others that are not the first of their vertex, and the places of corners then."""
    again = np.append(False, keys[1:] // count == keys[:-1] // count)
    order = np.argsort(again, kind="stable")
    place = np.empty(len(keys), np.int64)
    place[order] = np.arange(len(keys))
    return keys[order], place[corners]


def _unchanged(mesh: Mesh) -> GivenBack:
    """A mesh that was mapped as it is."""
    vertices = np.arange(len(mesh.vertices))
    return GivenBack(mesh, vertices, vertices, np.arange(len(mesh.faces)), np.zeros(len(mesh.faces), bool), True)


def _unused(mesh: Mesh, mended: Mended) -> IntArray:
    """Keys of vertices that no face of the input uses, at their own place in the mended mesh."""
    used = np.zeros(len(mesh.vertices), bool)
    used[mesh.faces.reshape(-1)] = True
    place = np.full(len(mesh.vertices), -1)
    place[mended.vertex_of[::-1]] = np.arange(len(mended.vertex_of))[::-1]
    stray = np.flatnonzero(~used & (place >= 0))
    return np.asarray(stray * len(mended.vertex_of) + place[stray])
