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


def icosphere(levels: int) -> Mesh:
    """The unit sphere: an icosahedron whose faces are split in four ``levels`` times."""
    g = 0.5 * (1 + np.sqrt(5))
    points = np.array(
        [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g), (0, -1, -g), (0, 1, -g),
         (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    )  # fmt: skip
    faces = np.array(
        [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6), (7, 1, 8),
         (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]
    )  # fmt: skip
    for _ in range(levels):
        half = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        edges, index = np.unique(half, axis=0, return_inverse=True)
        middle = len(points) + index.reshape(-1, 3)
        points = np.vstack([points, points[edges].mean(axis=1)])
        a, b, c = faces.T
        ab, bc, ca = middle.T
        faces = np.vstack([np.column_stack(t) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
    return Mesh(points / np.linalg.norm(points, axis=1)[:, None], faces, "icosphere")


def spheroid(levels: int, length: float) -> tuple[Mesh, np.ndarray]:
    """An ellipsoid of revolution with half-axes 1, 1, ``length``, and its conformal map to the unit sphere (V, 3).

    A point at (sin t, 0, length cos t) goes to the colatitude T with log tan(T/2) = int_{pi/2}^t |p'| / sin, by quadrature.
    """
    sphere = icosphere(levels)
    x, y, z = sphere.vertices.T
    across = np.hypot(x, y)
    nodes, weights = np.polynomial.legendre.leggauss(60)
    # from the equator to the point, in u = z: dt = -du / across; the excess over the sphere's own 1 / sin t is smooth
    u = 0.5 * z[:, None] * (1 + nodes)
    excess = (np.sqrt(u**2 + length**2 * (1 - u**2)) - 1) / (1 - u**2)
    log_tan = -np.arctanh(np.clip(z, -1 + 1e-16, 1 - 1e-16)) - 0.5 * z * (excess @ weights)
    sine, cosine = 1 / np.cosh(log_tan), -np.tanh(log_tan)
    turn = np.column_stack([x, y]) / np.where(across > 0, across, 1)[:, None]
    image = np.column_stack([turn * sine[:, None], cosine])
    return Mesh(sphere.vertices * [1, 1, length], sphere.faces, "spheroid"), image


def lines_up(mesh, result):
    """Vertices and faces of the result are those of the mesh that vertex_of and face_of name."""
    out = result.mesh
    assert np.array_equal(out.vertices, mesh.vertices[result.vertex_of])
    assert len(result.coordinates) == len(out.vertices)
    assert len(result.patch) == len(result.mu) == len(out.faces) == len(result.face_of)
    assert len(np.unique(result.face_of)) == len(result.face_of)

    def corners(points):
        """Positions of each face's corners, in an order of their own."""
        return np.sort(points.view([("x", float), ("y", float), ("z", float)])[..., 0], axis=1)

    assert np.array_equal(corners(out.vertices[out.faces]), corners(mesh.vertices[mesh.faces[result.face_of]]))


def double_torus(n: int = 12) -> Mesh:
    """Two tori beside each other, joined by a tube between a triangle of each: genus 2."""
    one = torus(n)
    first = one.faces[1:]
    second = first[:, ::-1] + len(one.vertices)
    here, there = one.faces[0], one.faces[0] + len(one.vertices)
    tube = [row for k in range(3) for row in ((here[k], here[k - 2], there[k]), (here[k - 2], there[k - 2], there[k]))]
    points = np.concatenate([one.vertices, one.vertices * [-1.0, 1.0, 1.0] + [6.5, 0.0, 0.0]])
    return Mesh(points, np.concatenate([first, second, tube]), "double torus")


def holed(n: int = 12) -> Mesh:
    """The unit square with a hole in its middle: an annulus."""
    square = grid(n)
    middles = square.vertices[square.faces].mean(axis=1)
    kept = (np.abs(middles[:, :2] - 0.5) > 0.17).any(axis=1)
    return Mesh(square.vertices, square.faces[kept], "annulus")


def limbed(levels: int = 4) -> Mesh:
    """A sphere with a limb, up, and a short one, to the right."""
    ball = icosphere(levels)
    radius = 1.0 + 2.5 * np.exp(20.0 * (ball.vertices[:, 2] - 1.0)) + 1.0 * np.exp(20.0 * (ball.vertices[:, 0] - 1.0))
    return Mesh(ball.vertices * radius[:, None], ball.faces, "limbs")


_LUMPS = np.array([[0.9, 0.2, 0.3], [-0.3, 0.8, 0.5], [-0.5, -0.7, 0.5], [0.2, -0.3, -0.93]])


def lumpy(points: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 3) to points of one closed surface without symmetry: an ellipsoid with three lumps and a dent."""
    aims = _LUMPS / np.linalg.norm(_LUMPS, axis=1)[:, None]
    bumps = np.exp((points @ aims.T - 1.0) * [6, 8, 5, 10])
    return points * (1.0 + bumps @ [0.5, 0.35, -0.25, 0.7])[:, None] * [1.0, 1.2, 0.8]


def even_sphere(count: int) -> Mesh:
    """The unit sphere with so many vertices along a spiral, the convex hull of them."""
    k = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    points = np.column_stack([np.sqrt(1.0 - z * z) * np.cos(turn), np.sqrt(1.0 - z * z) * np.sin(turn), z])
    from scipy.spatial import ConvexHull

    faces = ConvexHull(points).simplices.copy()
    a, b, c = points[faces].swapaxes(0, 1)
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return Mesh(points, faces, "even sphere")


def hilly_disk(count: int, first: float = 0.0) -> Mesh:
    """One open surface without symmetry, with about so many vertices: hills on a round plate; first: angle of its boundary."""
    from scipy.spatial import Delaunay

    rim = first + 2 * np.pi * np.arange(int(3.9 * np.sqrt(count))) / int(3.9 * np.sqrt(count))
    k = np.arange(count) + 0.5
    z = np.sqrt(k / count) * (1.0 - 1.2 / np.sqrt(count)) * np.exp(1j * np.pi * (1.0 + np.sqrt(5.0)) * k)
    z = np.concatenate([z, np.exp(1j * rim)])
    faces = Delaunay(np.column_stack([z.real, z.imag])).simplices
    a, b, c = z[faces].T
    areas = ((b - a).conj() * (c - a)).imag
    faces = np.where((areas < 0)[:, None], faces[:, ::-1], faces)[np.abs(areas) > 1e-12]
    z *= 1.0 + 0.2 * np.cos(2 * np.angle(z) - 0.4) + 0.1 * np.cos(3 * np.angle(z)) * np.abs(z)
    places = np.array([0.3 + 0.2j, -0.4 + 0.3j, -0.1 - 0.45j])
    height = np.exp(-(np.abs(z[:, None] - places) ** 2) * [12, 9, 10]) @ [0.5, 0.35, -0.25]
    return Mesh(np.column_stack([1.1 * z.real, z.imag, height]), faces, "hilly disk")
