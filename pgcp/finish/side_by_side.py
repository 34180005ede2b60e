"""Maps of several components beside each other: in the plane by area, and spheres' longitudes and latitudes in one square."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pgcp.finish.shelves import on_shelves
from pgcp.finish.unit_square import MARGIN, upright_angle
from pgcp.surface.topology import used_vertices
from pgcp.types import FloatArray, IntArray, Layout, Mesh


def beside_each_other(
    meshes: Sequence[Mesh], maps: Sequence[FloatArray], areas: Sequence[float] | None = None
) -> list[FloatArray]:
    """Maps to the plane (V, 2) of surfaces, upright and without overlap.

    areas: of the surfaces, where each map is scaled to have its surface's; None leaves all in the surfaces' unit.
    """
    turned = []
    for k, (mesh, uv) in enumerate(zip(meshes, maps, strict=True)):
        angle = upright_angle(mesh, uv)[0]
        along, across = np.cos(angle), np.sin(angle)
        points = np.column_stack([along * uv[:, 0] - across * uv[:, 1], across * uv[:, 0] + along * uv[:, 1]])
        if areas is not None:
            a, b, c = (points[mesh.faces[:, i]] for i in range(3))
            u, v = b - a, c - a
            image = 0.5 * float((u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum())
            points *= np.sqrt(areas[k] / image) if image > 0.0 and areas[k] > 0.0 else 1.0
        turned.append(points)
    used = [points[used_vertices(mesh)] for mesh, points in zip(meshes, turned, strict=True)]
    low = np.array([points.min(axis=0) for points in used])
    places = on_shelves(np.array([points.max(axis=0) for points in used]) - low)
    return [points + (place - corner) for points, place, corner in zip(turned, places, low, strict=True)]


def globes_in_square(layout: Layout, component_of: IntArray, areas: FloatArray) -> Layout:
    """Longitudes and latitudes of several spheres in [0, 1]^2, 2 % margin: each in a box of its surface's share of the area.

    component_of (F,): of which sphere each face is; areas (N,) of their surfaces.
    """
    of_point = np.zeros(len(layout.points), np.int64)
    of_point[layout.faces] = component_of[:, None]
    used = np.zeros(len(layout.points), bool)
    used[layout.faces] = True
    scale = np.sqrt(areas / 2.0)
    points = layout.points * np.array([2.0, 1.0]) * scale[of_point][:, None]
    low, high = np.full((len(areas), 2), np.inf), np.full((len(areas), 2), -np.inf)
    np.minimum.at(low, of_point[used], points[used])
    np.maximum.at(high, of_point[used], points[used])
    places = on_shelves(high - low)
    points += (places - low)[of_point]
    extent = float((places + high - low).max())
    points = np.clip(MARGIN + (1.0 - 2.0 * MARGIN) * points / max(extent, 1e-300), 0.0, 1.0)
    record = {**layout.record, "kind": "longitudes and latitudes in the unit square", "components": len(areas)}
    return replace(layout, points=points, record=record)
