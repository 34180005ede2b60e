"""The built-in demo surface: a bust made by formula, with head, nose, brow, ears, neck and shoulders."""

from __future__ import annotations

import numpy as np

from pgcp.types import FloatArray, Mesh


def _bump(x: FloatArray, centre: tuple[float, float, float], width: tuple[float, float, float]) -> FloatArray:
    return np.exp(-(((x - np.array(centre)) / np.array(width)) ** 2).sum(axis=1))


def demo_mesh(rings: int = 129) -> Mesh:
    """A bust-like open surface of about 3 rings^2 vertices (50,000 by default), open at the base.

    Rings of 6 n points around the crown make a triangulated disk, which is bent over the head and down to the shoulders
    and displaced by smooth features. Deterministic.
    """
    counts = np.array([1] + [6 * n for n in range(1, rings + 1)])
    first = np.concatenate([[0], np.cumsum(counts)])
    ring = np.repeat(np.arange(rings + 1), counts)
    t = (np.arange(first[-1]) - first[ring]) / counts[ring]
    s, angle = ring / rings, 2.0 * np.pi * t
    # profile of a bust: radius and height along s from the crown to the base
    knots = np.array([0.0, 0.12, 0.25, 0.38, 0.48, 0.56, 0.63, 0.70, 0.78, 0.88, 1.0])
    from scipy.interpolate import PchipInterpolator

    radius = PchipInterpolator(knots, [0.0, 0.52, 0.83, 0.92, 0.84, 0.62, 0.46, 0.50, 0.95, 1.45, 1.60])(s)
    height = PchipInterpolator(knots, [2.60, 2.48, 2.12, 1.66, 1.25, 0.98, 0.75, 0.45, 0.22, 0.0, -0.55])(s)
    body = np.clip((s - 0.66) / 0.2, 0.0, 1.0)
    x = radius * np.cos(angle) * (1.0 + 0.35 * body)
    y = radius * np.sin(angle) * (1.12 - 0.42 * body)
    points = np.column_stack([x, y, height])
    out = points / np.linalg.norm(points, axis=1, keepdims=True)
    front = np.array([0.0, -1.0, 0.0])
    side = np.array([1.0, 0.0, 0.0])
    push = np.zeros_like(points)
    push += 0.34 * _bump(points, (0.0, -1.0, 1.55), (0.16, 0.35, 0.24))[:, None] * front  # nose
    push += 0.12 * _bump(points, (0.0, -1.0, 1.95), (0.55, 0.40, 0.10))[:, None] * front  # brow
    push -= 0.16 * _bump(points, (0.34, -0.95, 1.75), (0.17, 0.40, 0.12))[:, None] * front  # eyes
    push -= 0.16 * _bump(points, (-0.34, -0.95, 1.75), (0.17, 0.40, 0.12))[:, None] * front
    push += 0.13 * _bump(points, (0.0, -0.9, 1.22), (0.22, 0.40, 0.06))[:, None] * front  # lips
    push += 0.15 * _bump(points, (0.0, -0.8, 1.02), (0.24, 0.35, 0.11))[:, None] * front  # chin
    push += 0.38 * _bump(points, (0.92, 0.05, 1.62), (0.22, 0.13, 0.24))[:, None] * side  # ears
    push -= 0.38 * _bump(points, (-0.92, 0.05, 1.62), (0.22, 0.13, 0.24))[:, None] * side
    hair = np.clip((points[:, 2] - 1.9) / 0.4, 0.0, 1.0) + np.clip((points[:, 1] - 0.1) / 0.4, 0.0, 1.0) * (points[:, 2] > 1.0)
    curls = 0.018 * np.sin(14.0 * points[:, 0]) * np.sin(14.0 * points[:, 1]) * np.sin(11.0 * points[:, 2])
    points = points + push + (np.minimum(hair, 1.0) * curls)[:, None] * out
    faces = []
    for n in range(rings):
        inner, outer = first[n], first[n + 1]
        n_in, n_out = max(1, counts[n]), counts[n + 1]
        for sector in range(6):
            for j in range(n + 1):
                o0, o1 = outer + sector * (n + 1) + j, outer + (sector * (n + 1) + j + 1) % n_out
                i0 = inner + (sector * n + j) % n_in
                faces.append((i0, o0, o1))
                if j < n:
                    faces.append((i0, o1, inner + (sector * n + j + 1) % n_in))
    return Mesh(points, np.array(faces, np.int64), "demo")
