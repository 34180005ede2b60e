"""Comparison of maps that agree up to a Moebius map."""

from __future__ import annotations

import numpy as np

from pgcp.plane.mobius import sphere_points


def homogeneous(points):
    """Pairs p, q with stereographic projection p / q, for unit vectors (n, 3) or complex z (n,)."""
    if points.ndim == 1:
        return points, np.ones_like(points)
    p, q = points[:, 0] + 1j * points[:, 1], 1 + points[:, 2].astype(complex)
    south = points[:, 2] < 0
    p[south], q[south] = 1 - points[south, 2], points[south, 0] - 1j * points[south, 1]
    size = np.hypot(np.abs(p), np.abs(q))
    return p / size, q / size


def moebius_distance(moving, fixed):
    """Largest chordal distance on the sphere between fixed and the Moebius image of moving that fits it best."""
    p, q = homogeneous(moving)
    r, s = homogeneous(fixed)
    size = np.hypot(np.abs(r), np.abs(s))
    rows = np.column_stack([s * p, s * q, -r * p, -r * q]) / (size * np.hypot(np.abs(p), np.abs(q)))[:, None]
    a, b, c, d = np.linalg.svd(rows)[2][-1].conj() if len(rows) < 2000 else np.linalg.eigh(rows.conj().T @ rows)[1][:, 0]
    image = sphere_points(a * p + b * q, c * p + d * q)
    return float(np.linalg.norm(image - sphere_points(r, s), axis=1).max())
