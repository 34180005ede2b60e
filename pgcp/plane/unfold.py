"""Developable surfaces unfolded: laid out in the plane face by face, where every face keeps its size and shape."""

from __future__ import annotations

import numba
import numpy as np

from pgcp.types import ComplexArray, FloatArray, IntArray

_CLOSE, _NEARLY_CLOSE = 1e-9, 1e-6
_LOOKED_AT, _MOST_AROUND, _BENT = 200, 40, 1e-6  # half-edges, faces around a vertex, radians


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _flat(vertices: FloatArray, face: IntArray, out: ComplexArray) -> None:
    """Corners (3,) of one face in the plane, the first at 0, the second on the real axis, the third to the left."""
    a, b, c = face[0], face[1], face[2]
    ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
    vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = np.sqrt(ux * ux + uy * uy + uz * uz)
    out[0], out[1], out[2] = 0.0, length, 0.0
    if not length > 0.0:
        return
    out[2] = complex(ux * vx + uy * vy + uz * vz, np.sqrt(nx * nx + ny * ny + nz * nz)) / length


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _laid_out(vertices: FloatArray, faces: IntArray, twins: IntArray, start: int, close: float) -> tuple[ComplexArray, bool]:
    """Positions (V,), the first corner of the face ``start`` at 0, and whether all faces fit.

    Faces are turned one against the other: lengths are always those on the surface, so errors add and do not multiply.
    """
    out = np.zeros(vertices.shape[0], np.complex128)
    placed = np.zeros(vertices.shape[0], np.bool_)
    turn = np.zeros(faces.shape[0], np.complex128)  # 0 for faces that are not laid out
    queue = np.empty(faces.shape[0], np.int64)
    here, there = np.empty(3, np.complex128), np.empty(3, np.complex128)
    _flat(vertices, faces[start], here)
    for i in range(3):
        out[faces[start, i]] = here[i]
        placed[faces[start, i]] = True
    turn[start] = 1.0
    queue[0] = start
    head, size = 0, 1
    while head < size:
        f = queue[head]
        head += 1
        _flat(vertices, faces[f], here)
        for i in range(3):
            twin = twins[3 * f + i]
            if twin < 0 or turn[twin // 3] != 0.0:
                continue
            g, j = twin // 3, twin % 3
            queue[size] = g
            size += 1
            _flat(vertices, faces[g], there)
            k = (j + 2) % 3
            along = there[(j + 1) % 3] - there[j]
            turned = turn[f] * (here[i] - here[(i + 1) % 3]) * np.conj(along)
            if not abs(turned) > 0.0:  # a face without extent
                return out, False
            turn[g] = turned / abs(turned)
            a, c = faces[g, j], faces[g, k]
            at = out[a] + turn[g] * (there[k] - there[j])
            if not placed[c]:
                out[c] = at
                placed[c] = True
            elif not abs(at - out[c]) <= close * min(abs(there[k] - there[j]), abs(there[k] - there[(j + 1) % 3])):
                return out, False
    return out, size == faces.shape[0]


def _is_bent(vertices: FloatArray, faces: IntArray, twins: IntArray) -> bool:
    """Whether the angles around one of a few inner vertices clearly do not sum to 2 pi: a surface that is not developable."""
    edge = np.arange(0, twins.size, max(1, twins.size // _LOOKED_AT))
    start, here = edge.copy(), np.ones(len(edge), bool)
    total = np.zeros(len(edge))
    for _ in range(_MOST_AROUND):
        face, corner = edge // 3, edge % 3
        a, b, c = (vertices[faces[face, (corner + k) % 3]] for k in range(3))
        u, v = b - a, c - a
        total += here * np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), (u * v).sum(axis=1))
        following = twins[3 * face + (corner + 2) % 3]
        closed = here & (following == start)
        if (np.abs(total[closed] - 2.0 * np.pi) > _BENT).any():
            return True
        here &= (following >= 0) & ~closed
        edge = np.where(here, following, edge)
    return False


def unfolded(vertices: FloatArray, faces: IntArray, twins: IntArray) -> ComplexArray | None:
    """Positions (V,) of a connected developable surface in the plane, every face as it is; None for any other surface.

    vertices (V, 3); faces (F, 3); twins (3F,) the half-edge beside each, from corner i to the next, -1 on the boundary. Faces
    are laid out ring by ring about the smallest one, whose first corner comes to 0: what is small keeps its digits. A surface
    that is not developable is left at the first vertex at which faces do not close to a billionth of their size.
    """
    if _is_bent(vertices, faces, twins):
        return None
    edges = vertices[faces] - vertices[np.roll(faces, -1, axis=1)]
    squares = np.einsum("fij,fij->fi", edges, edges)
    if not squares.all():  # an edge of no length has no direction to turn a face to
        return None
    if not _laid_out(vertices, faces, twins, 0, _NEARLY_CLOSE)[1]:  # from there sizes may grow less well
        return None
    start = int(np.argmin(squares.sum(axis=1)))
    z, fits = _laid_out(vertices, faces, twins, start, _CLOSE)
    return z if fits and np.isfinite(z).all() else None
