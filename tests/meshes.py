"""Analytic meshes: surfaces whose conformal maps are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pgcp.types import Mesh

SHARED = Path(__file__).resolve().parents[2] / "shared" / "meshes"


def grid(n: int, m: int | None = None, jitter: float = 0.0, seed: int = 0) -> Mesh:
    """The unit square (or n x m cells) in the plane z = 0, alternating diagonals, inner vertices jittered."""
    m = n if m is None else m
    x, y = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, m / n, m + 1), indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    inner = ((x > 0) & (x < 1) & (y > 0) & (y < m / n)).ravel()
    noise = np.random.default_rng(seed).uniform(-1, 1, (x.size, 2)) * jitter / n
    points[inner, :2] += noise[inner]
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    a = (i * (m + 1) + j).ravel()
    b, c, d = a + m + 1, a + m + 2, a + 1
    even = ((i + j) % 2 == 0).ravel()[:, None, None]
    one = np.stack([np.column_stack([a, b, c]), np.column_stack([a, c, d])], axis=1)
    two = np.stack([np.column_stack([a, b, d]), np.column_stack([b, c, d])], axis=1)
    return Mesh(points, np.where(even, one, two).reshape(-1, 3), f"grid {n}x{m}")


def lifted(mesh: Mesh, height: float = 0.3) -> Mesh:
    """A planar mesh bent into a surface with hills."""
    points = mesh.vertices.copy()
    points[:, 2] = height * np.sin(3.0 * points[:, 0]) * np.cos(4.0 * points[:, 1])
    return Mesh(points, mesh.faces, "hills")


def cap(n: int, angle: float = 1.2) -> tuple[Mesh, np.ndarray]:
    """A spherical cap of opening ``angle`` (radians), and its stereographic projection z (V,), which is conformal."""
    counts = np.array([1] + [6 * k for k in range(1, n + 1)])
    first = np.concatenate([[0], np.cumsum(counts)])
    ring = np.repeat(np.arange(n + 1), counts)
    t = (np.arange(first[-1]) - first[ring]) / counts[ring]
    theta, phi = angle * ring / n, 2 * np.pi * t
    points = np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    faces = []
    for k in range(n):
        for s in range(6):
            for j in range(k + 1):
                inner = first[k] + (s * k + j) % max(1, counts[k])
                outer = first[k + 1] + s * (k + 1) + j
                after = first[k + 1] + (s * (k + 1) + j + 1) % counts[k + 1]
                faces.append((inner, outer, after))
                if j < k:
                    faces.append((inner, after, first[k] + (s * k + j + 1) % counts[k]))
    return Mesh(points, np.array(faces), "cap"), np.tan(theta / 2) * np.exp(1j * phi)


def torus(n: int = 12) -> Mesh:
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    u, v = 2 * np.pi * i.ravel() / n, 2 * np.pi * j.ravel() / n
    points = np.column_stack([(2 + np.cos(v)) * np.cos(u), (2 + np.cos(v)) * np.sin(u), np.sin(v)])
    a, b = i * n + j, (i + 1) % n * n + j
    c, d = (i + 1) % n * n + (j + 1) % n, i * n + (j + 1) % n
    a, b, c, d = (k.ravel() for k in (a, b, c, d))
    return Mesh(points, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]), "torus")


def tetrahedron() -> Mesh:
    points = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], float)
    return Mesh(points, np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]), "tetrahedron")


def similarity_error(z: np.ndarray, target: np.ndarray) -> float:
    """Largest distance after the best similarity, relative to the target's extent."""
    u, v = z - z.mean(), target - target.mean()
    a = np.vdot(u, v) / np.vdot(u, u)
    return float(np.abs(v - a * u).max() / np.abs(v).max())
