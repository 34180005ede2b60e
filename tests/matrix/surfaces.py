"""Pieces that random shapes are made of: rings of vertices sewn together, grids, limbs pulled out of faces, Moebius maps."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

Array = np.ndarray


@dataclass(frozen=True, slots=True)
class Shape:
    """A surface, and what is known of its conformal map.

    vertices (V, 3); faces (F, 3); closed; what: the numbers it was made from; is_flat: whether it unfolds into the plane;
    image: coordinates (V, 2) in the unit disk or (V, 3) on the unit sphere of the conformal map of the smooth surface that the
    vertices lie on, None where it is not known.
    """

    vertices: Array
    faces: Array
    closed: bool
    what: dict[str, Any] = field(default_factory=dict)
    is_flat: bool = False
    image: Array | None = None


def between(random: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform, rounded to three digits, so that it can be told."""
    return float(f"{np.exp(random.uniform(np.log(low), np.log(high))):.3g}")


def split_quads(corners: Array, random: np.random.Generator | None = None) -> Array:
    """Two triangles of every quad (Q, 4), along one diagonal or either."""
    a, b, c, d = corners.T
    one = np.stack([np.column_stack([a, b, c]), np.column_stack([a, c, d])], axis=1)
    two = np.stack([np.column_stack([a, b, d]), np.column_stack([b, c, d])], axis=1)
    first = np.ones(len(corners), bool) if random is None else random.random(len(corners)) < 0.5
    return np.where(first[:, None, None], one, two).reshape(-1, 3)


def grid_quads(rows: int, columns: int) -> Array:
    """Quads of a grid of (rows + 1) x (columns + 1) vertices."""
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    a = (i * (columns + 1) + j).ravel()
    return np.column_stack([a, a + columns + 1, a + columns + 2, a + 1])


def sheet(rows: int, columns: int, random: np.random.Generator | None = None) -> tuple[Array, Array, Array]:
    """Parameters u, v (V,) in [0, 1] of a grid, and its faces."""
    u, v = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    return u.ravel(), v.ravel(), split_quads(grid_quads(rows, columns), random)


def rings_sewn(rings: int, around: int, first_tip: bool, last_tip: bool, random: np.random.Generator | None = None) -> Array:
    """Faces of a tube of ``rings`` rings with ``around`` vertices each, ring by ring; then its tips, first and last.

    Seen from outside, vertices of a ring run counter-clockwise about the direction from the first ring to the last.
    """
    i, k = np.meshgrid(np.arange(rings - 1), np.arange(around), indexing="ij")
    a, b = (i * around + k).ravel(), (i * around + (k + 1) % around).ravel()
    faces = [split_quads(np.column_stack([a, b, b + around, a + around]), random)]
    here, after = np.arange(around), (np.arange(around) + 1) % around
    tip = rings * around
    if first_tip:
        faces.append(np.column_stack([np.full(around, tip), after, here]))
        tip += 1
    if last_tip:
        last = (rings - 1) * around
        faces.append(np.column_stack([np.full(around, tip), last + here, last + after]))
    return np.concatenate(faces)


def frames(curve: Array) -> tuple[Array, Array]:
    """Two unit vectors (n, 3) across a curve (n, 3) that turn about it as little as can be."""
    along = np.gradient(curve, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    side = np.empty_like(along)
    first = np.cross(along[0], np.eye(3)[np.abs(along[0]).argmin()])
    side[0] = first / np.linalg.norm(first)
    for n in range(1, len(curve)):
        moved = side[n - 1] - (side[n - 1] @ along[n]) * along[n]
        side[n] = moved / np.linalg.norm(moved)
    return side, np.cross(along, side)


def tube(curve: Array, radii: Array, around: int) -> Array:
    """Vertices (n * around, 3) of rings about a curve (n, 3)."""
    side, other = frames(curve)
    turn = 2 * np.pi * np.arange(around) / around
    across = np.cos(turn)[None, :, None] * side[:, None] + np.sin(turn)[None, :, None] * other[:, None]
    return (curve[:, None] + radii[:, None, None] * across).reshape(-1, 3)


def revolved(radii: Array, heights: Array, around: int) -> tuple[Array, Array]:
    """Vertices (V, 3) of rings about the z axis, and the logarithm (n,) of their distance from the centre of the plane map.

    Between rings the surface is a cone, on which log |w| is the integral of ds / r: exact for the smooth surface.
    """
    turn = 2 * np.pi * np.arange(around) / around
    points = np.stack([np.outer(radii, np.cos(turn)), np.outer(radii, np.sin(turn))], axis=-1)
    vertices = np.concatenate([points, np.repeat(heights, around).reshape(len(radii), around, 1)], axis=-1).reshape(-1, 3)
    steps, ratio = np.hypot(np.diff(radii), np.diff(heights)), radii[1:] / radii[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        per_step = np.where(np.abs(ratio - 1) < 1e-9, 1 / radii[:-1], np.log(ratio) / np.diff(radii))
    return vertices, np.concatenate([[0.0], np.cumsum(steps * per_step)])


def on_sphere(w: Array) -> Array:
    """Points (n, 3) of the sphere whose stereographic projection from the south pole is w; infinity goes to (0, 0, -1)."""
    far = ~np.isfinite(w)
    w = np.where(far, 0, w)
    size = np.abs(w) ** 2
    points = np.column_stack([2 * w.real, 2 * w.imag, 1 - size]) / (1 + size)[:, None]
    points[far] = 0, 0, -1
    return points


def boosted(points: Array, towards: Array) -> Array:
    """Points (n, 3) of the sphere after the Moebius map that moves its centre to a point inside it."""
    size = towards @ towards
    inner = points @ towards
    return ((1 - size) * points + 2 * (1 + inner)[:, None] * towards) / (1 + size + 2 * inner)[:, None]


def pulled(
    vertices: Array, faces: Array, random: np.random.Generator, steps: int, length: float, thin: float
) -> tuple[Array, Array]:
    """Limbs pulled out of faces: each step puts a prism onto a face, often onto the last one made, so that trees of tubes grow.

    length: of a step, and thin: by which the new face is smaller, both about 1 and in terms of the face's own size.
    """
    points, triangles = list(vertices), [tuple(face) for face in faces.tolist()]
    last = int(random.integers(len(triangles)))
    for _ in range(steps):
        if random.random() < 0.08:
            last = int(random.integers(len(triangles)))
        corners = triangles[last]
        base = np.array([points[v] for v in corners])
        normal = np.cross(base[1] - base[0], base[2] - base[0])
        size = float(np.sqrt(np.linalg.norm(normal)))
        if size < 1e-6:
            last = int(random.integers(len(triangles)))
            continue
        direction = normal / size**2 + 0.25 * random.normal(size=3)
        middle = base.mean(axis=0)
        a, n = corners, len(points)
        points.extend(middle + thin * (base - middle) + length * size * direction)
        b = n, n + 1, n + 2
        for i, j in ((0, 1), (1, 2), (2, 0)):
            triangles += [(a[i], a[j], b[j]), (a[i], b[j], b[i])]
        triangles[last] = b
    return np.array(points), np.array(triangles)


def slivers(points: Array, faces: Array, count: int, random: np.random.Generator) -> tuple[Array, Array]:
    """Faces split by a vertex next to the middle of an edge."""
    faces = faces.copy()
    for k in random.choice(len(faces), min(count, len(faces)), replace=False):
        a, b, c = faces[k]
        new = len(points)
        middle = 0.5 * (points[a] + points[b])
        points = np.vstack([points, middle + 10.0 ** random.uniform(-6, -1) * (points[c] - middle)])
        faces[k] = a, b, new
        faces = np.vstack([faces, [[b, c, new], [c, a, new]]])
    return points, faces


def without_unused(points: Array, faces: Array) -> tuple[Array, Array]:
    """Vertices in use, and the faces in their numbers."""
    used, index = np.unique(faces, return_inverse=True)
    return points[used], index.reshape(-1, 3)


def is_disk_or_sphere(faces: Array) -> str:
    """What faces make up: "disk", "sphere", or "" for anything else, not manifold, not connected or not oriented."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    count = int(faces.max()) + 1
    keys = edges[:, 0] * count + edges[:, 1]
    if len(np.unique(keys)) < len(keys):
        return ""
    open_edges = edges[~np.isin(keys, edges[:, 1] * count + edges[:, 0])]
    graph = coo_array((np.ones(len(edges)), edges.T), (count, count))
    used = len(np.unique(faces))
    if used != count or connected_components(graph, directed=False)[0] != 1 or not _has_simple_stars(edges, faces, count):
        return ""
    euler = count - len(np.unique(np.sort(edges, axis=1), axis=0)) + len(faces)
    if len(open_edges) == 0:
        return "sphere" if euler == 2 else ""
    rim, index = np.unique(open_edges, return_inverse=True)
    index = index.reshape(-1, 2)
    loops = connected_components(coo_array((np.ones(len(index)), index.T), (len(rim), len(rim))), directed=False)[0]
    return "disk" if euler == 1 and loops == 1 and len(rim) == len(open_edges) else ""


def _has_simple_stars(edges: Array, faces: Array, count: int) -> bool:
    """Whether the faces around every vertex hang together: corners joined across edges are as many groups as vertices."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(faces)
    corner_from = np.concatenate([np.arange(n), n + np.arange(n), 2 * n + np.arange(n)])
    corner_to = np.concatenate([n + np.arange(n), 2 * n + np.arange(n), np.arange(n)])
    keys, back = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    order = np.argsort(keys)
    place = np.minimum(np.searchsorted(keys[order], back), len(keys) - 1)
    twin = np.where(keys[order][place] == back, order[place], -1)
    has = np.flatnonzero(twin >= 0)
    # half-edge h runs a -> b; its twin b -> a: corner of a here and there, corner of b here and there
    rows = np.concatenate([corner_from[has], corner_to[has]])
    columns = np.concatenate([corner_to[twin[has]], corner_from[twin[has]]])
    graph = coo_array((np.ones(len(rows)), (rows, columns)), (3 * n, 3 * n))
    return connected_components(graph, directed=False)[0] == count
