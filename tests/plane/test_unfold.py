"""Developable surfaces come back as they are."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import grid, lifted

import pgcp
from pgcp.plane.unfold import unfolded
from pgcp.surface.distortion import angle_errors
from pgcp.surface.topology import examine
from pgcp.types import Mesh


def bent(kind: str) -> Mesh:
    """A sheet of 60 by 30 cells bent into a developable surface."""
    flat = grid(60, 30)
    u, w = flat.vertices[:, 0], flat.vertices[:, 1]
    if kind == "plane":
        points = flat.vertices @ np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0].T + [30, -70, 11]
    elif kind == "graded":
        x = 10 ** (6 * u - 6)
        points = np.column_stack([x, 2 * x * w, 0 * x])
    else:  # a folded strip: developable in the mesh, not only in the limit
        points = np.column_stack([u, np.where(w > 0.25, 0.25, w), np.maximum(w - 0.25, 0.0)])
    return Mesh(points, flat.faces, kind)


@pytest.mark.parametrize("kind", ["plane", "graded", "folded"])
def test_a_developable_surface_comes_back_exactly(kind):
    mesh = bent(kind)
    result = pgcp.parameterize(mesh, target="free")
    limit = 1e-7 if kind == "plane" else 1e-9  # seventy sizes away its own coordinates are rounded
    assert angle_errors(mesh, result.coordinates).max() < limit
    assert result.quality.folds == 0
    assert result.quality.log_area_mean < 1e-9


def test_other_surfaces_are_not_unfolded():
    mesh = lifted(grid(10), 1e-3)
    assert unfolded(mesh.vertices, mesh.faces, examine(mesh.faces, len(mesh.vertices)).twins) is None
    flat = grid(10)
    z = unfolded(flat.vertices, flat.faces, examine(flat.faces, len(flat.vertices)).twins)
    assert z is not None
    assert np.ptp(z.real) * np.ptp(z.imag) > 0


def test_a_surface_that_overlaps_when_unfolded_is_welded_where_no_overlap_is_wanted():
    turns = grid(160, 2)  # a flat spiral staircase seen from above, its treads on top of each other
    angle, r = 10.0 * turns.vertices[:, 0], 1.0 + 10.0 * turns.vertices[:, 1]
    mesh = Mesh(np.column_stack([r * np.cos(angle), r * np.sin(angle), 0 * r]), turns.faces, "spiral")
    plain = pgcp.parameterize(mesh, target="free")
    assert plain.report["overlap"]["crossings"] > 0
    assert plain.quality.angle_max_deg < 1e-9
    apart = pgcp.parameterize(mesh, target="free", no_overlap=True)
    assert apart.quality.folds == 0
    assert apart.report["overlap"] is None or apart.report["overlap"]["crossings"] == 0
