"""Load what tasks need, compiled code included."""

from __future__ import annotations

import numpy as np

from pgcp.patches.flatten import factor_patch, flatten_simply
from pgcp.patches.plan import plan_welds
from pgcp.patches.solve import solve_patch
from pgcp.patches.split import cut_patches, split_mesh
from pgcp.patches.weld import run_welds, start_component
from pgcp.plane.space import PLANE
from pgcp.surface.topology import examine
from pgcp.types import Mesh


def warm_up() -> None:
    """Load what tasks will need, by flattening, welding and solving next to nothing."""
    side = np.arange(7)
    x, y = (k.reshape(-1) for k in np.meshgrid(side, side, indexing="ij"))
    a = (7 * x + y)[(x < 6) & (y < 6)]
    faces = np.concatenate([np.column_stack([a, a + 7, a + 8]), np.column_stack([a, a + 8, a + 1])])
    mesh = Mesh(np.column_stack([x, y, 0.3 * np.sin(x) * y]), faces)
    topology = examine(mesh.faces, len(mesh.vertices))
    split = split_mesh(mesh, topology, 2)
    halves = {}
    for patch in cut_patches(mesh, topology, split):
        factor = factor_patch(patch, "nested")
        curve = flatten_simply(patch, factor, "dncp", "nested")
        halves[patch.index] = start_component(curve, mesh.vertices, split.edges)
        solve_patch(PLANE, patch, curve.z[np.cumsum(patch.parts) - patch.parts], factor, "nested")
    run_welds(halves, plan_welds(split.table, 2).steps)
