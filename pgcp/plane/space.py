"""The two spaces that maps go to, the plane and the sphere: how positions are held there, and what is asked of them."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from pgcp.parallel import in_slices
from pgcp.plane.mobius import rotation_to_north, to_plane, to_sphere
from pgcp.surface.beltrami import (
    beltrami_coefficients,
    beltrami_coefficients_on_sphere,
    covering_degree,
    folded_faces,
    folded_faces_on_sphere,
)
from pgcp.types import ComplexArray, FloatArray, IntArray, Mesh, Positions

_LOWEST = -0.9
_NORTH = np.array([0.0, 0.0, 1.0])


class Chart(Protocol):
    """Some positions as complex numbers, and the way back."""

    z: ComplexArray
    usable: bool

    def points(self, z: ComplexArray) -> Positions:
        """Positions (n,) of chart positions z (n,)."""
        ...


class Space(Protocol):
    """The plane or the sphere.

    ``positions`` are what the mathematics computes with, ``coordinates`` (n, dimension) what is given out.
    """

    @property
    def coordinates_name(self) -> str:
        """What coordinates are called in files."""
        ...

    @property
    def dimension(self) -> int:
        """Number of coordinates of a point."""
        ...

    @property
    def closed(self) -> bool:
        """Whether closed surfaces are mapped to it."""
        ...

    def origin(self, count: int) -> Positions:
        """So many positions, all at the origin or the north pole."""
        ...

    def positions(self, coordinates: FloatArray) -> Positions:
        """Positions (n,) of coordinates (n, dimension)."""
        ...

    def coordinates(self, positions: Positions) -> FloatArray:
        """Coordinates (n, dimension) of positions (n,)."""
        ...

    def in_space(self, positions: Positions) -> FloatArray:
        """Points (n, 3) of positions (n,)."""
        ...

    def folded(self, faces: IntArray, positions: Positions) -> IntArray:
        """Indices of faces whose image has no positive area, decided exactly, in this thread."""
        ...

    def coefficients(self, vertices: FloatArray, faces: IntArray, positions: Positions) -> ComplexArray:
        """Beltrami coefficient (F,) of every face of the map vertices (V, 3) -> positions (V,), in this thread."""
        ...

    def chart(self, positions: Positions) -> Chart:
        """A chart about the middle of some positions."""
        ...

    def degree(self, faces: IntArray, positions: Positions) -> float | None:
        """How often a closed space is covered, None for the plane."""
        ...


def find_folds(space: Space, faces: IntArray, positions: Positions) -> IntArray:
    """Indices of folded faces of a map, as ``Space.folded``, on all processors."""
    parts = in_slices(lambda begin, end: begin + space.folded(faces[begin:end], positions), len(faces))
    return np.concatenate(parts) if parts else np.empty(0, np.int64)


def map_coefficients(space: Space, mesh: Mesh, faces: IntArray, positions: Positions) -> ComplexArray:
    """Beltrami coefficients of some faces of a map, as ``Space.coefficients``, on all processors."""
    parts = in_slices(lambda begin, end: space.coefficients(mesh.vertices, faces[begin:end], positions), len(faces))
    return np.concatenate(parts) if parts else np.empty(0, np.complex128)


class PlanarChart:
    """Positions in the plane as they are."""

    usable = True

    def __init__(self, z: ComplexArray) -> None:
        self.z = z

    def points(self, z: ComplexArray) -> ComplexArray:
        """Positions of chart positions."""
        return z


class StereographicChart:
    """Positions on the sphere by the stereographic projection about their middle; not usable where they reach around it."""

    def __init__(self, points: FloatArray) -> None:
        middle = points.mean(axis=0)
        size = float(np.linalg.norm(middle))
        self._rotation = rotation_to_north(middle / size) if size > 0 else np.eye(3)
        turned = points @ self._rotation.T
        self.usable = bool(turned[:, 2].min() > _LOWEST)
        self.z = to_plane(turned) if self.usable else np.zeros(len(points), np.complex128)

    def points(self, z: ComplexArray) -> FloatArray:
        """Positions on the sphere of chart positions."""
        return to_sphere(z) @ self._rotation


class Plane:
    """The plane: positions are complex (n,), coordinates (n, 2)."""

    coordinates_name, dimension, closed = "uv", 2, False

    def origin(self, count: int) -> ComplexArray:
        """See Space."""
        return np.zeros(count, np.complex128)

    def positions(self, coordinates: FloatArray) -> ComplexArray:
        """See Space."""
        pairs: ComplexArray = np.array(coordinates, np.float64, order="C").view(np.complex128)
        return pairs[:, 0]

    def coordinates(self, positions: ComplexArray) -> FloatArray:
        """See Space."""
        return np.column_stack([positions.real, positions.imag])

    def in_space(self, positions: ComplexArray) -> FloatArray:
        """See Space."""
        return np.column_stack([positions.real, positions.imag, np.zeros(len(positions))])

    def folded(self, faces: IntArray, positions: ComplexArray) -> IntArray:
        """See Space."""
        return folded_faces(faces, positions)

    def coefficients(self, vertices: FloatArray, faces: IntArray, positions: ComplexArray) -> ComplexArray:
        """See Space."""
        mu: ComplexArray = beltrami_coefficients(vertices, faces, positions)
        return mu

    def chart(self, positions: ComplexArray) -> PlanarChart:
        """See Space."""
        return PlanarChart(positions)

    def degree(self, faces: IntArray, positions: ComplexArray) -> None:
        """See Space."""


class Sphere:
    """The unit sphere: positions and coordinates are unit vectors (n, 3)."""

    coordinates_name, dimension, closed = "sphere", 3, True

    def origin(self, count: int) -> FloatArray:
        """See Space."""
        return np.tile(_NORTH, (count, 1))

    def positions(self, coordinates: FloatArray) -> FloatArray:
        """See Space."""
        return coordinates

    def coordinates(self, positions: FloatArray) -> FloatArray:
        """See Space."""
        return positions

    def in_space(self, positions: FloatArray) -> FloatArray:
        """See Space."""
        return np.asarray(positions, np.float64)

    def folded(self, faces: IntArray, positions: FloatArray) -> IntArray:
        """See Space."""
        return folded_faces_on_sphere(faces, positions)

    def coefficients(self, vertices: FloatArray, faces: IntArray, positions: FloatArray) -> ComplexArray:
        """See Space."""
        mu: ComplexArray = beltrami_coefficients_on_sphere(vertices, faces, positions)
        return mu

    def chart(self, positions: FloatArray) -> StereographicChart:
        """See Space."""
        return StereographicChart(positions)

    def degree(self, faces: IntArray, positions: FloatArray) -> float:
        """See Space."""
        return float(covering_degree(faces, positions))


PLANE, SPHERE = Plane(), Sphere()
