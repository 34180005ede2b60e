"""Put the maps of all patches together into one, at the surface's scale."""

from __future__ import annotations

from collections.abc import Iterable

import numba
import numpy as np

from pgcp.beltrami import signed_area
from pgcp.errors import InputError
from pgcp.mobius import are_apart, rotation_to_north, shift_disk
from pgcp.operators import face_areas
from pgcp.parallel import in_slices
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray, Mesh, PatchMap, Positions

_INSIDE = 1e-14


def collect(mesh: Mesh, parts: Iterable[tuple[IntArray, IntArray, PatchMap]], target: str) -> tuple[Positions, ComplexArray]:
    """One array of positions, complex (V,) or unit vectors (V, 3), and one of Beltrami coefficients mu (F,).

    parts: for each patch its vertex_ids and face_ids in the mesh, and its map. Vertices on seams have the same position in
    every patch that holds them. Vertices used by no face are at 0, on the sphere at the north pole.
    """
    points: Positions = np.zeros(len(mesh.vertices), np.complex128)
    if target == "sphere":
        points = np.tile([0.0, 0.0, 1.0], (len(mesh.vertices), 1))
    mu = np.zeros(len(mesh.faces), np.complex128)
    for vertex_ids, face_ids, solved in parts:
        points[vertex_ids] = solved.points
        mu[face_ids] = solved.mu
    return points, mu


def as_coordinates(z: ComplexArray, used: BoolArray) -> FloatArray:
    """Coordinates (V, 2) of z (V,); vertices used by no face at the origin."""
    return np.column_stack([np.where(used, z.real, 0.0), np.where(used, z.imag, 0.0)])


def used_vertices(mesh: Mesh) -> BoolArray:
    """Which vertices (V,) some face uses."""
    used = np.zeros(len(mesh.vertices), bool)
    used[mesh.faces.reshape(-1)] = True
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


def place_free(mesh: Mesh, z: ComplexArray, boundary: IntArray) -> FloatArray:
    """Coordinates (V, 2): total area as on the surface, boundary centred at the origin, its long axis horizontal."""
    centred = z - z[boundary].mean()
    axis = np.exp(-0.5j * np.angle(np.sum(centred[boundary] ** 2)))
    area = abs(signed_area(mesh.faces, z))
    scale = np.sqrt(face_areas(mesh.vertices, mesh.faces).sum() / area) if area > 0 else 1.0
    return as_coordinates(centred * axis * scale, used_vertices(mesh))


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
        return place_free(mesh, points, boundary)
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
