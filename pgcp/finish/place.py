"""Where the finished map lies in the target: size, centre, orientation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import permutations, product

import numba
import numpy as np

from pgcp.errors import InputError
from pgcp.parallel import in_slices
from pgcp.plane.mobius import are_apart, rotation_to_north, shift_disk
from pgcp.surface.beltrami import signed_area
from pgcp.surface.operators import face_areas
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray, Mesh, Positions

_INSIDE = 1e-14
_TINY_EDGE = 1e-7
_CROWDED = 1e-6  # smallest edge to the largest distance: from there on ten digits are not kept


@numba.njit(cache=True, nogil=True)
def _coordinates(z: ComplexArray, used: BoolArray, out: FloatArray, begin: int, end: int) -> None:
    for v in range(begin, end):
        out[v, 0], out[v, 1] = (z[v].real, z[v].imag) if used[v] else (0.0, 0.0)


def as_coordinates(z: ComplexArray, used: BoolArray) -> FloatArray:
    """Coordinates (V, 2) of z (V,); vertices used by no face at the origin."""
    out = np.empty((len(z), 2))
    in_slices(partial(_coordinates, z, used, out), len(z))
    return out


@numba.njit(cache=True, nogil=True)
def _moments(vertices: FloatArray, points: FloatArray, faces: IntArray) -> FloatArray:
    """Sums over faces of area times (1, centre in the image)^T (1, centre on the surface), (4, 4)."""
    total, surface, image = np.zeros((4, 4)), np.ones(4), np.ones(4)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        for d in range(3):
            surface[d + 1] = (vertices[a, d] + vertices[b, d] + vertices[c, d]) / 3.0
            image[d + 1] = (points[a, d] + points[b, d] + points[c, d]) / 3.0
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        area = 0.5 * np.sqrt(nx * nx + ny * ny + nz * nz)
        for i in range(4):
            for j in range(4):
                total[i, j] += area * image[i] * surface[j]
    return total


def _towards_surface(mesh: Mesh, points: FloatArray) -> FloatArray:
    """The matrix M (3, 3) for which a rotation R that brings points @ R closest to the surface makes trace(R^T M) largest.

    The surface's faces are seen from its centre and weighted by area.
    """
    parts = in_slices(lambda begin, end: _moments(mesh.vertices, points, mesh.faces[begin:end]), len(mesh.faces))
    total = np.sum(parts, axis=0)
    out: FloatArray = total[1:, 1:] - np.outer(total[1:, 0], total[0, 1:]) / total[0, 0]
    return out


def turn_to_surface(mesh: Mesh, points: FloatArray) -> FloatArray:
    """Rotate a map to the sphere (V, 3) so that it faces the way the surface does.

    The rotation that brings the points closest to the directions of the surface's faces from its centre, weighted by area.
    """
    u, _, v = np.linalg.svd(_towards_surface(mesh, points))
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v
    turned: FloatArray = points @ turn
    turned /= np.sqrt(np.einsum("ij,ij->i", turned, turned))[:, None]
    return turned


@dataclass(frozen=True, slots=True, eq=False)
class Unplaced:
    """A finished map before it is placed: mesh, positions (V,), the outer boundary (B,), which vertices (V,) some face uses."""

    mesh: Mesh
    positions: Positions
    boundary: IntArray
    used: BoolArray


@numba.njit(cache=True, nogil=True)
def _smallest_edge(faces: IntArray, z: ComplexArray) -> tuple[float, int]:
    """Length of the shortest of the faces' first edges, along x or y, whichever is longer, and where it begins."""
    best, least = 0, np.inf
    for f in range(faces.shape[0]):
        edge = z[faces[f, 1]] - z[faces[f, 0]]
        length = max(abs(edge.real), abs(edge.imag))
        if length < least:
            best, least = faces[f, 0], length
    return least, best


def place_free(done: Unplaced, centre: int | None = None) -> FloatArray:
    """Coordinates (V, 2): total area as on the surface, boundary centred at the origin, its long axis horizontal.

    Where some part is so small that its coordinates would lose digits there, the smallest one is at the origin instead. There
    is no ``centre`` to bring a vertex to.
    """
    del centre
    mesh, z, boundary = done.mesh, done.positions, done.boundary
    middle = z[boundary].mean()
    size, tip = min(in_slices(lambda begin, end: _smallest_edge(mesh.faces[begin:end], z), len(mesh.faces)))
    origin = z[tip] if size < _CROWDED * np.abs(z[boundary] - middle).max() else middle
    axis = np.exp(-0.5j * np.angle(np.sum((z[boundary] - middle) ** 2)))
    image = abs(signed_area(mesh.faces, z))
    surface = sum(in_slices(lambda begin, end: face_areas(mesh.vertices, mesh.faces[begin:end]).sum(), len(mesh.faces)))
    placed = z - origin
    placed *= axis * (np.sqrt(surface / image) if image > 0 else 1.0)
    return as_coordinates(placed, done.used)


def centred_in_disk(z: ComplexArray, vertex: int, boundary: IntArray) -> ComplexArray:
    """Bring a vertex to the centre of the disk.

    Raises InputError where the vertex is on the boundary, or so close to it that boundary vertices would coincide.
    """
    if abs(z[vertex]) >= 1.0 - _INSIDE or vertex in boundary:
        raise InputError(f"vertex {vertex} is on the boundary: it cannot be the centre of the disk")
    moved = shift_disk(z, complex(z[vertex]))
    moved[boundary] /= np.abs(moved[boundary])
    if not are_apart(moved, boundary):
        raise InputError(f"with vertex {vertex} at the centre of the disk, boundary vertices could not be told apart")
    return moved


def place_disk(done: Unplaced, centre: int | None = None) -> FloatArray:
    """Coordinates (V, 2) in the unit disk, the first boundary vertex at (1, 0), and a vertex at the centre if asked for.

    Raises InputError where the centre cannot be one.
    """
    boundary = done.boundary
    z = done.positions if centre is None else centred_in_disk(done.positions, centre, boundary)
    z = z * np.conj(z[boundary[0]])
    z[boundary] /= np.abs(z[boundary])
    z[boundary[0]] = 1.0
    return as_coordinates(z, done.used)


@numba.njit(cache=True, nogil=True)
def _crowds_at_an_axis(faces: IntArray, points: FloatArray) -> bool:
    """Whether the image (V, 3) has an edge at the end of an axis that is so short that its ends have few digits elsewhere."""
    for f in range(faces.shape[0]):
        a, b = faces[f, 0], faces[f, 1]
        square = 0.0
        for d in range(3):
            square += (points[b, d] - points[a, d]) ** 2
        if square < _TINY_EDGE**2 and np.abs(points[a]).max() > 1.0 - _TINY_EDGE:
            return True
    return False


def place_sphere(done: Unplaced, centre: int | None = None) -> FloatArray:
    """Unit vectors (V, 3) that face the way the surface does, or with a vertex at the north pole.

    Where parts are crowded at an end of an axis the map is turned by axes only (see ``turn_by_axes``).
    """
    if centre is None and _crowds_at_an_axis(done.mesh.faces, done.positions):
        return turn_by_axes(done)
    coordinates = turn_to_surface(done.mesh, done.positions)
    if centre is not None:
        coordinates = coordinates @ rotation_to_north(coordinates[centre]).T
    coordinates[~done.used] = [0.0, 0.0, 1.0]
    return coordinates


def turn_by_axes(done: Unplaced) -> FloatArray:
    """Unit vectors (V, 3), turned by that of the 24 rotations that exchange axes which faces the surface best.

    Nothing is rounded, so what is crowded at an axis point stays as it is.
    """
    matrix = _towards_surface(done.mesh, done.positions)
    turns = [np.diag(signs)[:, order] for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)]
    turn = max((t for t in turns if np.linalg.det(t) > 0.0), key=lambda t: float((t * matrix).sum()))
    columns = np.argmax(np.abs(turn), axis=0)
    coordinates: FloatArray = done.positions[:, columns] * turn[columns, range(3)]
    coordinates[~done.used] = [0.0, 0.0, 1.0]
    return coordinates


def as_they_are(done: Unplaced) -> FloatArray:
    """Coordinates (V, 2) where the map has them."""
    return as_coordinates(done.positions, done.used)


def scale_only(done: Unplaced) -> FloatArray:
    """Coordinates (V, 2), scaled by a power of two so that their area is that of the surface to a factor of four."""
    mesh = done.mesh
    image = abs(signed_area(mesh.faces, done.positions))
    surface = sum(in_slices(lambda begin, end: face_areas(mesh.vertices, mesh.faces[begin:end]).sum(), len(mesh.faces)))
    exponent = int(np.round(0.5 * np.log2(surface / image))) if image > 0 else 0
    return as_coordinates(done.positions * complex(2.0**exponent), done.used)
