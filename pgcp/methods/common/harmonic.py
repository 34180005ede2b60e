"""The frame of methods that find some vertices' positions on the undivided mesh, all others being harmonic."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pgcp.errors import SolveFailedError
from pgcp.interface.whole_mesh import seen_on_the_final_map
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts
from pgcp.patches.types import SeamPositions, SolveReport
from pgcp.plane.space import map_coefficients
from pgcp.surface.topology import used_vertices
from pgcp.types import IntArray, Positions


def mapped_whole(run: Run, parts: Parts, points: Positions, kept: IntArray, details: Mapping[str, Any]) -> Mapped:
    """The map of the undivided mesh with positions (V, ...), those of ``kept`` vertices (n_K,) found first.

    details: what the report says. Raises SolveFailedError where a position is not finite.
    """
    mesh = run.mesh
    if not np.isfinite(points[used_vertices(mesh)]).all():
        raise SolveFailedError(f"{run.options.method} led to positions that are not finite")
    mu = map_coefficients(run.target.space, mesh, mesh.faces, points)
    untouched = [SolveReport(patch.index, 0, 0, 0, 0.0) for patch in parts.patches]
    solved = seen_on_the_final_map(run, parts, untouched, points, mu)
    return Mapped(parts, run.target, points, mu, SeamPositions(kept, points[kept]), solved, details=details)
