"""Put the maps of all patches together into one, at the surface's scale."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial

import numba
import numpy as np

from pgcp.beltrami import signed_area
from pgcp.errors import InputError
from pgcp.mobius import are_apart, rotation_to_north, shift_disk
from pgcp.operators import face_areas
from pgcp.parallel import at_once, in_slices
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray, Mesh, PatchMap, Positions

_INSIDE = 1e-14


@numba.njit(cache=True, nogil=True)
def _scatter(ids: IntArray, values: FloatArray, out: FloatArray) -> None:
    """Rows (n, k) of values to rows ids (n,) of out."""
    for i in range(ids.shape[0]):
        for d in range(values.shape[1]):
            out[ids[i], d] = values[i, d]


def _rows(values: Positions) -> FloatArray:
    """The same numbers (n, k), real and imaginary parts apart."""
    return values.view(np.float64).reshape(len(values), -1)


def collect(
    mesh: Mesh, shares: Sequence[Iterable[tuple[IntArray, IntArray, PatchMap]]], target: str
) -> tuple[Positions, ComplexArray]:
    """One array of positions, complex (V,) or unit vectors (V, 3), and one of Beltrami coefficients mu (F,).

    shares: in each, for some patches, vertex_ids and face_ids in the mesh, and its map; they are taken at the same time.
    Vertices on seams have the same position in every patch that holds them. Vertices used by no face are at 0, on the sphere
    at the north pole.
    """
    points: Positions = np.zeros(len(mesh.vertices), np.complex128)
    if target == "sphere":
        points = np.tile([0.0, 0.0, 1.0], (len(mesh.vertices), 1))
    mu = np.zeros(len(mesh.faces), np.complex128)

    def put(share: Iterable[tuple[IntArray, IntArray, PatchMap]]) -> None:
        """Take the maps of one share."""
        for vertex_ids, face_ids, solved in share:
            _scatter(vertex_ids, _rows(solved.points), _rows(points))
            _scatter(face_ids, _rows(solved.mu), _rows(mu))

    at_once(*(partial(put, share) for share in shares))
    return points, mu


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
def _mark(faces: IntArray, used: BoolArray, begin: int, end: int) -> None:
    for f in range(begin, end):
        for i in range(3):
            used[faces[f, i]] = True


def used_vertices(mesh: Mesh) -> BoolArray:
    """Which vertices (V,) some face uses."""
    used = np.zeros(len(mesh.vertices), bool)
    in_slices(partial(_mark, mesh.faces, used), len(mesh.faces))
    return used


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


def turn_to_surface(mesh: Mesh, points: FloatArray) -> FloatArray:
    """Rotate a map to the sphere (V, 3) so that it faces the way the surface does.

    The rotation that brings the points closest to the directions of the surface's faces from its centre, weighted by area.
    """
    parts = in_slices(lambda begin, end: _moments(mesh.vertices, points, mesh.faces[begin:end]), len(mesh.faces))
    total = np.sum(parts, axis=0)
    u, _, v = np.linalg.svd(total[1:, 1:] - np.outer(total[1:, 0], total[0, 1:]) / total[0, 0])
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v
    turned: FloatArray = points @ turn
    turned /= np.sqrt(np.einsum("ij,ij->i", turned, turned))[:, None]
    return turned


def place_free(mesh: Mesh, z: ComplexArray, boundary: IntArray, used: BoolArray) -> FloatArray:
    """Coordinates (V, 2): total area as on the surface, boundary centred at the origin, its long axis horizontal."""
    centre = z[boundary].mean()
    axis = np.exp(-0.5j * np.angle(np.sum((z[boundary] - centre) ** 2)))
    image = abs(signed_area(mesh.faces, z))
    surface = sum(in_slices(lambda begin, end: face_areas(mesh.vertices, mesh.faces[begin:end]).sum(), len(mesh.faces)))
    placed = z - centre
    placed *= axis * (np.sqrt(surface / image) if image > 0 else 1.0)
    return as_coordinates(placed, used)


def centre_on(positions: Positions, vertex: int, boundary: IntArray) -> Positions:
    """Bring a vertex to the centre of the disk, or to the north pole of the sphere.

    Raises InputError where the vertex is on the boundary, or so close to it that boundary vertices would coincide.
    """
    if positions.ndim == 2:
        return positions @ rotation_to_north(positions[vertex]).T
    if abs(positions[vertex]) >= 1.0 - _INSIDE or vertex in boundary:
        raise InputError(f"vertex {vertex} is on the boundary: it cannot be the centre of the disk")
    moved = shift_disk(positions, complex(positions[vertex]))
    moved[boundary] /= np.abs(moved[boundary])
    if not are_apart(moved, boundary):
        raise InputError(f"with vertex {vertex} at the centre of the disk, boundary vertices could not be told apart")
    return moved


def placed(mesh: Mesh, points: Positions, target: str, boundary: IntArray, centre: int | None) -> FloatArray:
    """Coordinates (V, 2) or (V, 3) of a finished map in its target's customary position.

    Raises InputError where the centre asked for cannot be one.
    """
    used = used_vertices(mesh)
    if target == "free":
        return place_free(mesh, points, boundary, used)
    if target == "sphere":
        coordinates = turn_to_surface(mesh, points)
        if centre is not None:
            coordinates = centre_on(coordinates, centre, boundary)
        coordinates[~used] = [0.0, 0.0, 1.0]
        return coordinates
    if centre is not None:
        points = centre_on(points, centre, boundary)
    points = points * np.conj(points[boundary[0]])
    points[boundary] /= np.abs(points[boundary])
    points[boundary[0]] = 1.0
    return as_coordinates(points, used)
