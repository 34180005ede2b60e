"""Components and patches made by hand."""

from __future__ import annotations

import numpy as np

from pgcp.patches.types import Component, Patch
from pgcp.surface.topology import examine


def cyclic_edges(count):
    """Edges (count, 2) of a closed polygon."""
    return np.column_stack([np.arange(count), np.roll(np.arange(count), -1)])


def polygon_component(z, lengths=None, inside=(), nodes=None, vertex_count=None):
    """A component with the closed polygon z (B,) as its loop, and further points that no edge joins.

    lengths (B,) on the surface, those in the plane if not given; all points are mesh vertices if nothing else is said.
    """
    lengths = np.abs(np.roll(z, -1) - z) if lengths is None else lengths
    points = np.concatenate([z, np.asarray(inside, complex)])
    nodes = np.arange(len(points)) if nodes is None else nodes
    count = len(points) if vertex_count is None else vertex_count
    return Component(nodes, points, np.arange(len(z)), cyclic_edges(len(z)), lengths, count)


def patch_of(mesh):
    """The whole of a disk-like mesh as one patch."""
    (loop,) = examine(mesh.faces, len(mesh.vertices)).loops
    vertex_ids, face_ids = np.arange(len(mesh.vertices)), np.arange(len(mesh.faces))
    return Patch(0, mesh.vertices, mesh.faces, vertex_ids, face_ids, loop, np.ones(len(loop), int))
