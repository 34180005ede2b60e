"""Plain data that passes between stages. Nothing here computes; arrays are checked once, at the border."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from pgcp.errors import DegenerateError, InputError

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
IntArray = npt.NDArray[np.integer[Any]]
BoolArray = npt.NDArray[np.bool_]
Columns = Mapping[str, np.ndarray[Any, Any]]
Positions = npt.NDArray[Any]  # complex (n,) in the plane, or unit vectors (n, 3) on the sphere


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A triangle mesh: vertices (V, 3) float64, faces (F, 3) integers, kept as int32, counter-clockwise from outside.

    The last ``filler`` faces close holes: they are mapped with the others, but neither measured nor given out.
    Raises InputError where shapes, indices or coordinates are not those of a mesh.
    """

    vertices: FloatArray
    faces: IntArray
    name: str = "mesh"
    filler: int = 0

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, np.float64)
        faces = np.ascontiguousarray(self.faces)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise InputError(f"{self.name}: vertices have shape {vertices.shape}, expected (V, 3)")
        if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
            raise InputError(f"{self.name}: faces have shape {faces.shape} and type {faces.dtype}, expected (F, 3) integers")
        if len(faces) == 0:
            raise InputError(f"{self.name}: the mesh has no faces")
        low, high = int(faces.min()), int(faces.max())
        if low < 0 or high >= len(vertices):
            bad = int(np.flatnonzero((faces < 0).any(1) | (faces >= len(vertices)).any(1))[0])
            raise InputError(
                f"{self.name}: face {bad} uses vertex {high if high >= len(vertices) else low}, "
                f"but the mesh has vertices 0 to {len(vertices) - 1}"
            )
        # a sum is finite only where all terms are, but may overflow
        with np.errstate(over="ignore", invalid="ignore"):
            finite = np.isfinite(vertices.sum())
        if not finite and not np.isfinite(vertices).all():
            bad = int(np.flatnonzero(~np.isfinite(vertices).all(axis=1))[0])
            raise DegenerateError(f"{self.name}: vertex {bad} has a coordinate that is not a finite number")
        if not 0 <= self.filler < len(faces):
            raise InputError(f"{self.name}: {self.filler} of {len(faces)} faces cannot be filler")
        small = len(vertices) < 2**31
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces.astype(np.int32 if small else np.int64, copy=False))

    @property
    def bare(self) -> Mesh:
        """The mesh without its filler."""
        return Mesh(self.vertices, self.faces[: len(self.faces) - self.filler], self.name) if self.filler else self


@dataclass(frozen=True, slots=True, eq=False)
class Quality:
    """How good a map is, over all 3F corners and F faces.

    Angles in degrees of |angle in the map - angle on the surface| (PGCP eq. 5.1); ``log_area_mean`` is the mean
    of |d_area| (PGCP eq. 6.1); folds counts faces whose signed area in the map is not positive, on the sphere seen from
    outside. degree: how often a sphere is covered, None in the plane. conformal_energy: of a disk map, E_C = 1/2 f* L f less
    the area of the image, with the surface's cotangent Laplacian L (CCEM eq. 2.4), None elsewhere.
    """

    angle_mean_deg: float
    angle_sd_deg: float
    angle_median_deg: float
    angle_p99_deg: float
    angle_max_deg: float
    mu_mean: float
    mu_max: float
    folds: int
    log_area_mean: float
    degree: float | None = None
    conformal_energy: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A surface of polygons, with what a file says of it beside places and corners.

    vertices (V, 3) float64; corners (C,) vertices of all polygons, one polygon after the other; offsets (P + 1,): where each
    begins, None where all have three corners. part_of (P, L): which of the ``parts``, the names of objects, groups or nodes,
    each polygon belongs to on each of some levels, -1 for none.
    of_vertices, of_polygons: further values (V, ...) and (P, ...) by name, in the types the file has them in; of a PLY file
    under the names of its properties. marks: statements of an OBJ file that stand before a polygon, as numbers of polygons and
    lines without their ends (``o``, ``g``, ``s``, ``usemtl``, ``mtllib``); libraries: contents of its material files, by name.
    normals (N, 3), normal_of (C,): normals by corner, -1 for none. materials: glTF materials as the file has them; material_of
    (P,): which of these, -1 for none.
    """

    vertices: FloatArray
    corners: IntArray
    offsets: IntArray | None = None
    parts: tuple[str, ...] = ()
    part_of: IntArray | None = None
    of_vertices: Columns = field(default_factory=dict)
    of_polygons: Columns = field(default_factory=dict)
    marks: tuple[tuple[int, bytes], ...] = ()
    libraries: Mapping[str, bytes] = field(default_factory=dict)
    normals: FloatArray | None = None
    normal_of: IntArray | None = None
    materials: tuple[dict[str, Any], ...] = ()
    material_of: IntArray | None = None
    name: str = "mesh"

    @property
    def polygon_count(self) -> int:
        """How many polygons there are."""
        return len(self.corners) // 3 if self.offsets is None else len(self.offsets) - 1

    @property
    def is_plain(self) -> bool:
        """Whether there is nothing but vertices and triangles."""
        others = (self.part_of, self.normals, self.material_of)
        said = self.of_vertices, self.of_polygons, self.marks
        return self.offsets is None and all(other is None for other in others) and not any(map(len, said))

    @property
    def sizes(self) -> IntArray:
        """Numbers of corners (P,)."""
        return np.full(self.polygon_count, 3) if self.offsets is None else np.diff(self.offsets)


@dataclass(frozen=True, slots=True, eq=False)
class Origin:
    """Where a finished map's vertices and faces come from.

    point_of (V,): vertices of the same number are one point of the surface, split in the input; vertex_of (V,): the input's
    vertex; corner_of (F, 3): the corner of the source that each corner of a face is, None where faces are the source's
    triangles and all of them are there, in order. source: None where the file held nothing but vertices and triangles.
    component_of (F,): of which component each face is, where several were mapped.
    """

    point_of: IntArray
    vertex_of: IntArray
    corner_of: IntArray | None = None
    source: Source | None = None
    component_of: IntArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Parameterization:
    """The finished map: coordinates, patch (F,), mu (F,), quality, and the report as plain data.

    coordinates (V, 2) in the plane (targets free and disk) or unit vectors (V, 3) (target sphere). Where the mesh was to be
    fixed, ``mesh`` is the fixed one, and vertex_of (V,) and face_of (F,) say which vertex and face of the input each of its
    own is; else they are None. coordinates_name: what coordinates are called in files, uv or sphere. origin: the way back to
    what the input was, where it was more than vertices and triangles, or vertices were joined; None elsewhere.
    """

    mesh: Mesh
    coordinates: FloatArray
    patch: IntArray
    mu: ComplexArray
    quality: Quality
    target: str
    report: dict[str, Any] = field(repr=False, default_factory=dict)
    vertex_of: IntArray | None = None
    face_of: IntArray | None = None
    coordinates_name: str = "uv"
    origin: Origin | None = field(repr=False, default=None)


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Where a map lies on a texture: points (T, 2), and which of them the corners of faces (F, 3) have.

    The first V points are those of the vertices; further ones are the other sides of cuts, at the vertices ``copies`` (T - V,).
    record: what report.json says of it.
    """

    points: FloatArray
    faces: IntArray
    copies: IntArray
    record: dict[str, Any]
