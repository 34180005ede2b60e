"""Discrete operators of a triangle mesh: cotangents, cotangent Laplacian, areas, angles."""

from __future__ import annotations

import numba
import numpy as np
from scipy.sparse import csr_array

from pgcp.parallel import in_slices
from pgcp.surface import plain
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray

_SPARE = 1e-5
_ENOUGH_SPARE = 1e-10


@numba.njit(cache=True, nogil=True)
def _edge_lengths(vertices: FloatArray, face: IntArray, length: FloatArray) -> None:
    """Write the lengths of a face's edges, edge i opposite corner i."""
    for i in range(3):
        p, q = face[(i + 1) % 3], face[(i + 2) % 3]
        square = 0.0
        for d in range(3):
            square += (vertices[q, d] - vertices[p, d]) ** 2
        length[i] = np.sqrt(square)


@numba.njit(cache=True, nogil=True)
def _needed(length: FloatArray, shortest: float) -> float:
    """How much longer a face's edges are to be taken, 0 where its triangle inequality holds with 1e-10 of it to spare."""
    longest = max(length.max(), shortest)
    spare = length.sum() - 2.0 * length.max()
    return 0.0 if spare >= _ENOUGH_SPARE * longest else _SPARE * longest - spare


@numba.njit(cache=True, nogil=True)
def _mollified_cotangents(vertices: FloatArray, faces: IntArray, mollification: float) -> FloatArray:
    """Cotangents (F, 3), those of faces without area from edges taken longer: of each face by no more than it needs."""
    out = cotangents(vertices, faces)
    length = np.empty(3)
    for f in range(faces.shape[0]):
        _edge_lengths(vertices, faces[f], length)
        needed = _needed(length, mollification)
        if needed == 0.0:
            continue
        for i in range(3):
            length[i] += needed
        c, b, a = np.sort(length)
        # Heron's formula as Kahan orders it
        product = (a + (b + c)) * (c - (a - b)) * (c + (a - b)) * (a + (b - c))
        four_areas = np.sqrt(max(product, 0.0))
        for i in range(3):
            j, k = length[(i + 1) % 3], length[(i + 2) % 3]
            out[f, i] = (j * j + (k - length[i]) * (k + length[i])) / four_areas
    return out


@numba.njit(cache=True, nogil=True)
def _edge_length(vertices: FloatArray, p: int, q: int) -> float:
    x, y, z = vertices[q, 0] - vertices[p, 0], vertices[q, 1] - vertices[p, 1], vertices[q, 2] - vertices[p, 2]
    return float(np.sqrt(x * x + y * y + z * z))


@numba.njit(cache=True, nogil=True)
def _most_needed(vertices: FloatArray, faces: IntArray) -> tuple[float, float]:
    """Most that any face needs, as a part of its longest edge, and the sum of all edge lengths."""
    most, total = 0.0, 0.0
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        one, two, three = _edge_length(vertices, b, c), _edge_length(vertices, c, a), _edge_length(vertices, a, b)
        longest, perimeter = max(one, two, three), one + two + three
        spare = perimeter - 2.0 * longest
        if longest == 0.0:
            most = 1.0
        elif spare < _ENOUGH_SPARE * longest:
            most = max(most, _SPARE - spare / longest)
        total += perimeter
    return most, total


def needed_mollification(vertices: FloatArray, faces: IntArray) -> float:
    """The length that edges of faces without area are taken longer by, at the most (Sharp, Crane 2020).

    0 where each face's triangle inequality holds with 1e-10 of its longest edge to spare. Where that of a face does not, its
    own edges are taken longer, as much as it takes to have 1e-5 of the longest to spare; other faces keep their shape. A face
    that is a point counts as one of the size returned, which is 1e-5 of the mean edge length.
    """
    if plain.is_few(faces, _most_needed):
        parts = [plain.most_needed(vertices, faces, _ENOUGH_SPARE, _SPARE)]
    else:
        parts = in_slices(lambda begin, end: _most_needed(vertices, faces[begin:end]), len(faces))
    most, mean = max(part[0] for part in parts), sum(part[1] for part in parts) / (3.0 * len(faces))
    return 0.0 if most == 0.0 else float(_SPARE * mean)


@numba.njit(cache=True, nogil=True)
def cotangents(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Cotangent of every corner (F, 3): dot product of its two edges over twice the face's area.

    The area is that of the two shorter edges, which loses least in a needle. Where a face has zero area the cotangents
    are infinite; callers check for it.
    """
    out = np.empty((faces.shape[0], 3))
    edge = np.empty((3, 3))  # edge i is opposite corner i
    length = np.empty(3)
    for f in range(faces.shape[0]):
        for i in range(3):
            p, q = faces[f, (i + 1) % 3], faces[f, (i + 2) % 3]
            for d in range(3):
                edge[i, d] = vertices[q, d] - vertices[p, d]
            length[i] = edge[i, 0] ** 2 + edge[i, 1] ** 2 + edge[i, 2] ** 2
        longest = 0
        for i in range(1, 3):
            if length[i] > length[longest]:
                longest = i
        u, v = edge[(longest + 1) % 3], edge[(longest + 2) % 3]
        x, y, z = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
        double_area = np.sqrt(x * x + y * y + z * z)
        for i in range(3):
            a, b = edge[(i + 1) % 3], edge[(i + 2) % 3]
            dot = -(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
            out[f, i] = dot / double_area if double_area > 0 else np.inf
    return out


@numba.njit(cache=True, nogil=True)
def face_areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Area of every face (F,), in squared units of the vertices."""
    out = np.empty(faces.shape[0])
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        out[f] = 0.5 * np.sqrt(nx * nx + ny * ny + nz * nz)
    return out


def looked_at_areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Area of every face (F,) of a mesh that may be refused: the same, without compiled code where faces are few."""
    return plain.face_areas(vertices, faces) if plain.is_few(faces, face_areas) else face_areas(vertices, faces)


def corner_weights(vertices: FloatArray, faces: IntArray, mollification: float = 0.0) -> FloatArray:
    """Half the cotangent of every corner (F, 3): what it adds to the weight of the edge opposite."""
    if mollification > 0.0:
        return 0.5 * _mollified_cotangents(vertices, faces, mollification)
    return 0.5 * cotangents(vertices, faces)


def _weights(vertices: FloatArray, faces: IntArray, mollification: float) -> FloatArray:
    return corner_weights(vertices, faces, mollification).reshape(-1)


def cotangent_laplacian(vertices: FloatArray, faces: IntArray, mollification: float = 0.0) -> csr_array:
    """Cotangent Laplacian L (n, n), symmetric positive semi-definite, off-diagonal -(cot a + cot b)/2 (PGCP eq. 4.6).

    The sign is that of the Dirichlet energy: E_D(u) = 1/2 u^T L u. With ``mollification`` faces of no area count as thin ones.
    """
    tails, heads = faces[:, [1, 2, 0]].reshape(-1), faces[:, [2, 0, 1]].reshape(-1)
    return edge_laplacian(tails, heads, _weights(vertices, faces, mollification), len(vertices))


def weighted_laplacian(faces: IntArray, weights: FloatArray, vertex_count: int) -> csr_array:
    """Laplacian (n, n) of faces (F, 3) whose corners add weights (F, 3) of their own to the edges opposite."""
    tails, heads = faces[:, [1, 2, 0]].reshape(-1), faces[:, [2, 0, 1]].reshape(-1)
    return edge_laplacian(tails, heads, weights.reshape(-1), vertex_count)


def triangle_laplacian(corners: ComplexArray, faces: IntArray, vertex_count: int) -> csr_array:
    """Cotangent Laplacian (n, n) of faces (F, 3) that each have the shape of a planar triangle of their own, corners (F, 3)."""
    flat = corners.reshape(-1)
    shapes = np.column_stack([flat.real, flat.imag, np.zeros(len(flat))])
    tails, heads = faces[:, [1, 2, 0]].reshape(-1), faces[:, [2, 0, 1]].reshape(-1)
    return edge_laplacian(tails, heads, _weights(shapes, np.arange(len(flat)).reshape(-1, 3), 0.0), vertex_count)


def positive_laplacian(
    vertices: FloatArray, faces: IntArray, chosen: BoolArray, least: float, mollification: float = 0.0
) -> tuple[csr_array, int]:
    """Cotangent Laplacian with the weights of the chosen faces' (F,) edges raised to ``least``, and how many were raised.

    With positive weights every inner vertex is a mean of its neighbours, which folds nothing inside a convex boundary
    (Tutte 1963, Floater 2003).
    """
    n = len(vertices)
    tails, heads = faces[:, [1, 2, 0]].reshape(-1).astype(np.int64), faces[:, [2, 0, 1]].reshape(-1).astype(np.int64)
    keys, edge = np.unique(np.minimum(tails, heads) * n + np.maximum(tails, heads), return_inverse=True)
    weights = np.bincount(edge, _weights(vertices, faces, mollification))
    raised = (np.bincount(edge, np.repeat(chosen, 3)) > 0) & (weights < least)
    return edge_laplacian(keys // n, keys % n, np.where(raised, least, weights), n), int(raised.sum())


def uniform_laplacian(faces: IntArray, vertex_count: int) -> csr_array:
    """Laplacian (n, n) in which every edge weighs 1 (Tutte 1963)."""
    tails, heads = faces[:, [1, 2, 0]].reshape(-1).astype(np.int64), faces[:, [2, 0, 1]].reshape(-1).astype(np.int64)
    keys = np.unique(np.minimum(tails, heads) * vertex_count + np.maximum(tails, heads))
    return edge_laplacian(keys // vertex_count, keys % vertex_count, np.ones(len(keys)), vertex_count)


def edge_laplacian(tails: IntArray, heads: IntArray, values: FloatArray, n: int) -> csr_array:
    """Laplacian (n, n) of edges from tails (E,) to heads (E,) with these weights (E,); edges may be given in parts."""
    rows = np.concatenate([tails, heads, tails, heads])
    columns = np.concatenate([heads, tails, tails, heads])
    data = np.concatenate([-values, -values, values, values])
    return csr_array((data, (rows, columns)), shape=(n, n))


def around_vertices(values: FloatArray, faces: IntArray, count: int) -> FloatArray:
    """Sums (V,) of values (F,) over the faces around each of ``count`` vertices."""
    return np.asarray(sum(np.bincount(corner, values, count) for corner in faces.T), np.float64)
