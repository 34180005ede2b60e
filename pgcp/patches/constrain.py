"""Where the welded points go in the target: the plane, the unit disk or the unit sphere (PGCP section 4.4)."""

from __future__ import annotations

import numpy as np

from pgcp.errors import CrowdedError, WeldFailedError
from pgcp.patches.types import Component, SeamPositions
from pgcp.plane.curves import crosses_itself
from pgcp.plane.geodesic import balanced_centre, geodesic_map, roomiest_centre
from pgcp.plane.mobius import balance_sphere
from pgcp.surface.topology import loop_edges

_CROWDED = 1e-12
_FLOOR = 2e-14
_LOST = 1e-18
_TRIANGLE = 3
_TOO_LONG = (
    "the surface has parts so long and thin that they would span less of the unit circle than double precision can tell; "
    "target free can map it"
)


def keep_free(union: Component) -> SeamPositions:
    """Positions as welded: the boundary stays free."""
    on_mesh = union.nodes < union.vertex_count
    return SeamPositions(union.nodes[on_mesh], union.z[on_mesh])


def constrain_to_disk(union: Component) -> SeamPositions:
    """Map the union to the unit disk by the geodesic algorithm (PGCP sections 3.4 and 4.4.1).

    The boundary's mean, weighted by length on the surface, comes to 0. Where that leaves boundary vertices too close to
    be told apart, the disk is centred where they have most room instead, and what is still too close is spread out.
    Raises WeldFailedError where the boundary crosses itself, CrowdedError where parts are so long and thin that the
    circle has no room for them.
    """
    on_mesh = union.nodes < union.vertex_count
    inner = on_mesh.copy()
    inner[union.loop] = False
    inside = np.flatnonzero(inner)
    if len(union.corners) == _TRIANGLE and len(inside) == 0:
        return _around_triangle(union)
    plane = geodesic_map(union.z[union.loop], union.z[inside])
    if isinstance(plane, int):
        if not crosses_itself(union.z[union.loop]):
            raise CrowdedError(_TOO_LONG)
        raise WeldFailedError(f"the welded boundary of {len(union.loop)} points crosses itself near its point {plane}")
    lengths = union.lengths[loop_edges(union.edges, union.loop, len(union.nodes))]
    centre = balanced_centre(plane, 0.5 * (lengths + np.roll(lengths, 1)))
    if centre is None:
        raise CrowdedError(_TOO_LONG)
    corners = union.corners
    gaps = np.add.reduceat(plane.circle_gaps(centre), corners)
    if gaps.min() < _CROWDED:
        centre = roomiest_centre(plane, corners, centre)
        gaps = np.add.reduceat(plane.circle_gaps(centre), corners)
    smallest = float(gaps.min())
    if smallest < _LOST:
        raise CrowdedError(_TOO_LONG)
    tight = gaps < _FLOOR
    gaps = np.where(tight, _FLOOR, gaps)
    angles = 2.0 * np.pi * np.concatenate([[0.0], np.cumsum(gaps[:-1])]) / gaps.sum()
    turn = np.conj(plane.circle(centre)[corners[0]])
    z = np.concatenate([np.exp(1j * angles), turn * plane.disk(centre)])
    if not np.isfinite(z).all():
        raise WeldFailedError("the map of the welded union to the disk is not finite")
    ids = np.concatenate([union.nodes[union.loop[corners]], union.nodes[inside]])
    return SeamPositions(ids, z, smallest, int(tight.sum()))


def _around_triangle(union: Component) -> SeamPositions:
    """Three boundary points as they are, on the circle through them: any three points of the circle go to any others."""
    ids = union.loop[union.corners]
    a, b, c = union.z[ids]
    angles = np.angle(np.array([(b - a) / (c - a), (c - b) / (a - b), (a - c) / (b - c)]).conj())
    gaps = 2.0 * np.abs(angles[[2, 0, 1]])
    z = np.exp(2j * np.pi * np.concatenate([[0.0], np.cumsum(gaps[:-1])]) / gaps.sum())
    if not np.isfinite(z).all() or not gaps.min() > _FLOOR:
        raise CrowdedError(_TOO_LONG)
    return SeamPositions(union.nodes[ids], z, float(gaps.min()))


def constrain_to_sphere(union: Component) -> SeamPositions:
    """Map a closed union to the unit sphere, the mean of its points, weighted by seam length, at 0 (PGCP section 4.4.2)."""
    if np.isnan(union.z).any() or len(np.unique(union.z)) < 3:
        raise WeldFailedError("the welded union is so crowded that it cannot be brought to the sphere")
    weights = np.bincount(union.edges.reshape(-1), np.repeat(union.lengths, 2), len(union.nodes)).astype(np.float64)
    points, _ = balance_sphere(union.z, weights)
    if not np.isfinite(points).all():
        raise WeldFailedError("the map of the welded union to the sphere is not finite")
    on_mesh = union.nodes < union.vertex_count
    ends = points[union.edges]
    smallest = float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).min())
    return SeamPositions(union.nodes[on_mesh], points[on_mesh], smallest)
