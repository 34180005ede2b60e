"""Maps that cannot fold: convex embeddings with positive weights, of a disk into the disk and of a sphere onto the sphere.

With positive weights every inner vertex of the harmonic map is a mean of its neighbours, and where the boundary is convex
no face is folded (Tutte 1963, Floater 2003). On the sphere one face is taken out and its corners held: the weights then
are a stress in equilibrium, which lifts the plane drawing to a convex polyhedron (Maxwell, Cremona), and central
projection from inside a convex polyhedron folds nothing. With cotangent weights and a conformal map the lift is the
paraboloid over the stereographic projection, so a projective map takes it close to the sphere the drawing came from.
"""

from __future__ import annotations

import numba
import numpy as np
from scipy.sparse import csr_array

from pgcp.elimination.dirichlet import extend_once
from pgcp.plane.mobius import rotation_to_north, to_plane
from pgcp.plane.space import Space
from pgcp.surface.beltrami import folded_faces_on_sphere
from pgcp.surface.operators import positive_laplacian, uniform_laplacian
from pgcp.surface.topology import pair_half_edges
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray, Mesh, Positions

_LEAST_WEIGHT = 0.1
_KEPT = 0.05
_SWEEPS = 500
_LEAST_SHARE = 1e-6
_ROUNDING = 8.0 * np.finfo(np.float64).eps


def _positive(mesh: Mesh, used: IntArray, faces: IntArray, mollification: float, uniform: bool) -> csr_array:
    """Laplacian with weights that are all 1, or cotangents raised to 0.1 where they are less."""
    if uniform:
        return uniform_laplacian(faces, len(used))
    everywhere = np.ones(len(faces), bool)
    return positive_laplacian(mesh.vertices[used], faces, everywhere, _LEAST_WEIGHT, mollification)[0]


def embed_disk(mesh: Mesh, z: ComplexArray, boundary: IntArray, mollification: float, uniform: bool = False) -> ComplexArray:
    """Map an open disk into the polygon of its boundary's positions z[boundary], which must be convex, without folds.

    With ``uniform`` weights parts that are long and thin shrink less. Vertices used by no face keep their positions.
    """
    used, local = np.unique(mesh.faces, return_inverse=True)
    laplacian = _positive(mesh, used, local.reshape(-1, 3), mollification, uniform)
    rim = np.searchsorted(used, boundary)
    out = z.copy()
    out[used] = extend_once(laplacian, rim, z[boundary])
    out[boundary] = z[boundary]
    return out


@numba.njit(cache=True)
def _lift(faces: IntArray, twins: IntArray, z: ComplexArray, stress: FloatArray, lid: int, start: int) -> FloatArray:
    """Heights (V,) of the convex surface over the drawing whose creases have the given stress, 0 on the face ``start``.

    stress (3F,): that of the half-edge from corner i to the next of each face. The height over face f is the linear
    function <q_f, z> + d_f. Across an edge from p to r, to the face on its right, q changes by -i stress (r - p), and d so
    that both functions agree on the edge. The lid, whose edges carry other stresses, is not entered.
    """
    count = faces.shape[0]
    q = np.zeros(count, np.complex128)
    d = np.zeros(count)
    seen = np.zeros(count, np.bool_)
    queue = np.empty(count, np.int64)
    out = np.zeros(z.shape[0])
    queue[0] = start
    seen[start] = seen[lid] = True
    head, size = 0, 1
    while head < size:
        f = queue[head]
        head += 1
        for i in range(3):
            v = faces[f, i]
            p, r = z[v], z[faces[f, (i + 1) % 3]]
            out[v] = q[f].real * p.real + q[f].imag * p.imag + d[f]
            g = twins[3 * f + i] // 3
            if seen[g]:
                continue
            step = -1j * stress[3 * f + i] * (r - p)
            q[g] = q[f] + step
            d[g] = d[f] - (step.real * p.real + step.imag * p.imag)
            seen[g] = True
            queue[size] = g
            size += 1
    return out


def embed_sphere(mesh: Mesh, points: FloatArray, mollification: float, uniform: bool = False) -> FloatArray:
    """Map a closed surface of genus 0 onto the unit sphere without folds, near the map ``points`` (V, 3) where that is good.

    The face with the largest image is the lid. Weights as in ``embed_disk``; vertices used by no face keep their positions.
    """
    used, local = np.unique(mesh.faces, return_inverse=True)
    faces = local.reshape(-1, 3)
    corners = points[mesh.faces]
    volumes = np.linalg.det(corners)
    lid = int(np.argmax(volumes))
    middle = corners[lid].sum(axis=0)
    rotation = rotation_to_north(-middle / np.linalg.norm(middle))
    laplacian = _positive(mesh, used, faces, mollification, uniform)
    rim = faces[lid]
    before = to_plane(points[used] @ rotation.T)
    z = extend_once(laplacian, rim, before[rim])
    z[rim] = before[rim]
    # what is held is next to infinity: where the rest comes to lie is better told by the rest
    weight = 1.0 / (1.0 + np.abs(before) ** 2)
    scale, shift = np.linalg.lstsq(np.column_stack([z, np.ones(len(z))]) * weight[:, None], before * weight, rcond=None)[0]
    z = scale * z + shift
    stress = -laplacian[faces.reshape(-1), faces[:, [1, 2, 0]].reshape(-1)]
    twins = pair_half_edges(faces, len(used))
    start = int(np.argmin(np.where(np.arange(len(faces)) == lid, np.inf, np.abs(z[faces].mean(axis=1)))))
    height = _lift(faces, twins, z, np.asarray(stress, np.float64), lid, start)
    # the paraboloid |z|^2 is the sphere, seen in perspective: fit the lift to it, each vertex as it counts on the sphere
    square = np.abs(z) ** 2
    columns = np.column_stack([height, np.ones(len(z)), z.real, z.imag])
    fitted = columns @ np.linalg.lstsq(columns / (1.0 + square)[:, None], square / (1.0 + square), rcond=None)[0]
    out = points.copy()
    out[used] = _from_inside(faces, z, fitted) @ rotation
    return out


def _from_inside(faces: IntArray, z: ComplexArray, fitted: FloatArray) -> FloatArray:
    """Unit vectors (n, 3): a convex polyhedron over z, near the paraboloid |z|^2, seen from a point inside it.

    Where it is near the paraboloid, the projective map that takes that to the unit sphere takes 0 inside. Otherwise the mean of
    its corners is inside for certain, of the projective image if that is finite, or else of the polyhedron itself.
    """
    box = np.column_stack([z.real, z.imag, fitted])
    box = (box - box.mean(axis=0)) / box.std(axis=0) * [1.0, 1.0, -1.0]
    tries = [box]
    if (1.0 + fitted > 0.0).all():
        round_one = np.column_stack([2.0 * z.real, 2.0 * z.imag, 1.0 - fitted]) / (1.0 + fitted)[:, None]
        tries = [round_one, round_one - round_one.mean(axis=0), box]
    seen = [corners / np.linalg.norm(corners, axis=1)[:, None] for corners in tries]
    return min(seen, key=lambda points: len(folded_faces_on_sphere(faces, points)))


@numba.njit(cache=True)
def _sure_volume(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    """det(a, b, c) less what rounding may have added: twice the signed area where all third coordinates are 1."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    volume = a[0] * (uy * vz - uz * vy) + a[1] * (uz * vx - ux * vz) + a[2] * (ux * vy - uy * vx)
    return volume - _ROUNDING * (abs(ux) + abs(uy) + abs(uz)) * (abs(vx) + abs(vy) + abs(vz))


@numba.njit(cache=True)
def _draw_back(
    faces: IntArray, starts: IntArray, around: IntArray, points: FloatArray, goal: FloatArray, free: BoolArray, on_sphere: bool
) -> None:
    """Move vertices of ``points`` towards ``goal`` in place, each as far as every face around it keeps its least size."""
    least = np.empty(faces.shape[0])
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        now, then = _sure_volume(points[a], points[b], points[c]), _sure_volume(goal[a], goal[b], goal[c])
        least[f] = _KEPT * (min(now, then) if then > 0.0 else now)
    tried = np.empty(3)
    before = np.empty(3)
    waiting = free.copy()
    for _ in range(_SWEEPS):
        moved = 0
        for v in range(points.shape[0]):
            if not waiting[v]:
                continue
            before[:] = points[v]
            share = 1.0
            while share > _LEAST_SHARE:
                size = 0.0
                for i in range(3):
                    tried[i] = goal[v, i] if share == 1.0 else before[i] + share * (goal[v, i] - before[i])
                    size += tried[i] * tried[i]
                if on_sphere and share < 1.0:
                    for i in range(3):
                        tried[i] /= np.sqrt(size)
                points[v] = tried
                good = True
                for k in range(starts[v], starts[v + 1]):
                    f = around[k]
                    if not _sure_volume(points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]) > least[f]:
                        good = False
                        break
                if good:
                    break
                points[v] = before
                share *= 0.5
            if share == 1.0:
                waiting[v] = False
            if share > _LEAST_SHARE:
                moved += 1
        if moved == 0:
            break


def drawn_back(space: Space, faces: IntArray, points: Positions, goal: Positions, held: BoolArray) -> Positions:
    """Move a map without folds back towards another one, wherever that folds nothing.

    points, goal: complex (V,) or unit vectors (V, 3); held (V,) vertices stay. A face keeps at least a twentieth of the
    smaller of its two sizes, or of its first one where it is folded in ``goal``.
    """
    now, then = (
        space.in_space(w) if space.closed else np.column_stack([w.real, w.imag, np.ones(len(w))]) for w in (points, goal)
    )
    now = np.array(now, np.float64)
    flat = faces.reshape(-1)
    around = np.argsort(flat, kind="stable") // 3
    starts = np.concatenate([[0], np.cumsum(np.bincount(flat, minlength=len(points)))])
    _draw_back(faces, starts, around, now, np.asarray(then, np.float64), ~held, space.closed)
    return now if space.closed else now[:, 0] + 1j * now[:, 1]
