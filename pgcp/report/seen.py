"""A surface as it is seen: from one side, in the light, in colours of values, of a map's checkerboard, or of any function."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image

from pgcp.finish.unit_square import standing
from pgcp.report.chart import Scale
from pgcp.report.raster import PIXELS, Paint, Shown, View, shown, view
from pgcp.report.shade import checkered, in_colours, lit, vertex_shapes
from pgcp.targets.registry import TARGETS
from pgcp.types import BoolArray, FloatArray, IntArray, Parameterization

DARK, LIGHT = (np.array(colour, np.float32) for colour in ((0.20, 0.38, 0.62), (0.98, 0.94, 0.84)))
HEAT = ((0.93, 0.93, 0.91), (0.98, 0.82, 0.45), (0.90, 0.42, 0.16), (0.60, 0.08, 0.12), (0.25, 0.02, 0.10))
COLD_WARM = ((0.13, 0.25, 0.55), (0.45, 0.66, 0.85), (0.94, 0.94, 0.92), (0.93, 0.60, 0.42), (0.62, 0.10, 0.14))
FIELD = ((0.18, 0.20, 0.47), (0.16, 0.47, 0.60), (0.36, 0.71, 0.52), (0.86, 0.81, 0.36), (0.99, 0.94, 0.72))
_PLAIN = np.array((0.72, 0.78, 0.86), np.float32)
_LIGHTS = np.array([[0.35, 0.55, 0.76], [0.0, 0.0, 1.0]])  # unit vectors to the light and to the eye
_EDGE = 0.28  # brightness of edges
_CHECKS = 48  # squares across
_VIEW_SAMPLE = 50_000
_TINY = 1e-300


def sample_of(faces: IntArray, most: int) -> tuple[IntArray, int]:
    """An even sample of at most so many faces, and the step from one to the next: odd, as faces often come in pairs."""
    step = -(-len(faces) // most) | 1
    return faces[::step], step


def unit_corners(points: FloatArray, faces: IntArray) -> FloatArray:
    """The corners of faces, one after another (3 F, 2 or 3), in units of their extent."""
    corners = points[faces.reshape(-1)]
    corners /= max(*(float(np.ptp(column)) for column in corners.T), _TINY)
    return corners


def view_rotation(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Rotation (3, 3) to the flattest view, from the side most faces look to, y or z upright, whichever the surface stands on.

    Rows: to the right, up, towards the eye. Where as many look either way, as on closed surfaces, from the positive side.
    """
    sample, _ = sample_of(faces, _VIEW_SAMPLE)
    corners = unit_corners(vertices, sample)
    a, b, c = corners.reshape(-1, 3, 3).swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    spread = corners - corners.mean(axis=0)
    _, axes = np.linalg.eigh(spread.T @ spread)
    towards = axes[:, 0] * np.sign(axes[np.abs(axes[:, 0]).argmax(), 0])
    facing = normals @ towards
    if facing.sum() < -0.03 * np.abs(facing).sum():
        towards = -towards
    stands = standing(corners, np.arange(len(corners)).reshape(-1, 3))
    stands[0] = -1.0
    stands[2] *= 1.05  # z, if both do alike
    axis = int(np.argmax(np.where(np.abs(towards) < 0.7, stands, -2.0)))
    up = np.eye(3)[axis]
    up = up - towards * (towards @ up)
    up = up / np.linalg.norm(up)
    return np.array([np.cross(up, towards), up, towards])


@dataclass(frozen=True, slots=True, eq=False)
class Still:
    """What one image of a surface shows: painted in any colours without looking again. light (m, 2): brightness and gloss."""

    shown: Shown
    light: np.ndarray | None

    def painted(self, paint: Paint) -> Image.Image:
        """The picture."""
        if not len(self.shown.face_ids):  # a flat surface seen from its side
            return Image.fromarray(self.shown.painted(np.empty((0, 3))))
        colours = paint(self.shown.face_ids, self.shown.weights)
        if self.light is not None:
            colours = np.asarray(colours * self.light[:, :1] + self.light[:, 1:])
        return Image.fromarray(self.shown.painted(colours))


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A surface or a map from one side.

    shapes (V, 5): normals of its vertices, as ``vertex_shapes`` has them; None of what has no light on it.
    """

    view: View
    shapes: np.ndarray | None = None

    @classmethod
    def of(cls, points: FloatArray, faces: IntArray, rotation: FloatArray | None, box: FloatArray | None = None) -> Seen:
        """Points (V, 2) as they lie, or (V, 3) turned by ``rotation``, rows to the right, up, towards the eye.

        box (2, 3): what is in sight of the turned points, all of them where it is None.
        """
        points = np.ascontiguousarray(points, np.float64)
        flat = points.shape[-1] < 3
        whole = view(points, faces, None if flat or rotation is None else np.ascontiguousarray(rotation))
        size = max(float(np.hypot(*whole.extent)), _TINY)
        shapes = None if flat else vertex_shapes(points, faces, points, (size, size))
        return cls(whole if box is None else replace(whole, box=box), shapes)

    def window(self, centre: FloatArray, width: float) -> Seen:
        """The same with a square of this width around a point (3,) of the surface."""
        middle = self.view.rotation @ centre
        half = np.array([0.5 * width, 0.5 * width, 0.0])
        return replace(self, view=replace(self.view, box=np.array([middle - half, middle + half])))

    def still(self, pixels: int = PIXELS) -> Still:
        """What is seen in so many pixels across."""
        found, light = shown(self.view, pixels), None
        if self.shapes is not None:
            lights = np.ascontiguousarray(_LIGHTS @ self.view.rotation)
            light = lit(found.face_ids, found.weights, self.view.faces, self.shapes, lights)
        return Still(found, light)

    def drawn(self, paint: Paint, pixels: int = PIXELS) -> Image.Image:
        """The picture in colours of places on faces."""
        return self.still(pixels).painted(paint)

    def with_edges(self, paint: Paint, drawn: BoolArray | None = None, pixels: float = 2.0) -> Paint:
        """Colours of places, darker along edges; drawn (F, 3): which edges, opposite to each corner, if not all."""
        points, faces = self.view.points, self.view.faces
        thick = pixels * float(self.view.extent.max()) / PIXELS

        def painted(face_ids: IntArray, weights: FloatArray) -> np.ndarray:
            """Colours (m, 3)."""
            corners = points[faces[face_ids]]
            sides = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)  # opposite to each corner
            double = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
            heights = double[:, None] / np.maximum(np.linalg.norm(sides, axis=2), _TINY)
            close = weights * heights < 0.5 * thick
            near = (close if drawn is None else close & drawn[face_ids]).any(axis=1)
            return np.where(near[:, None], _EDGE, 1.0) * paint(face_ids, weights)

        return painted


def turned_box(points: Sequence[FloatArray], rotation: FloatArray) -> FloatArray:
    """What is in sight (2, 3) of all of several sets of points (V, 3), turned."""
    ends = [[turn.min(axis=0), turn.max(axis=0)] for turn in (each @ rotation.T for each in points)]
    return np.array([np.min([low for low, _ in ends], axis=0), np.max([high for _, high in ends], axis=0)])


# Colours of places on faces ---------------------------------------------------------------------------------------------------


def plain(face_ids: IntArray, _weights: FloatArray) -> np.ndarray:
    """One colour."""
    return np.broadcast_to(_PLAIN, (len(face_ids), 3))


def in_scale(values: np.ndarray, scale: Scale) -> np.ndarray:
    """Colours (m, 3) of values (m,)."""
    return in_colours((values - scale.axis.low) / (scale.axis.high - scale.axis.low), scale.stops)


def at_vertices(faces: IntArray, values: FloatArray, scale: Scale | None = None) -> Paint:
    """Colours of values (V,) at vertices, interpolated; without a scale, they are colours (V, 3), which are."""

    def paint(face_ids: IntArray, weights: FloatArray) -> np.ndarray:
        """Colours (m, 3)."""
        here = np.einsum("mk,mk...->m...", weights, values[faces[face_ids]])
        return here if scale is None else in_scale(here, scale)

    return paint


def on_faces(values: FloatArray, scale: Scale) -> Paint:
    """Colours of values (F,) of whole faces."""
    return lambda face_ids, _weights: in_scale(values[face_ids], scale)


def map_shapes(result: Parameterization, surface: View) -> np.ndarray:
    """Normals of the surface and log2 of the map's scale (V, 5), as ``vertex_shapes`` has them, in units of the view."""
    mesh, size = result.mesh, max(float(np.hypot(*surface.extent)), _TINY)
    return vertex_shapes(mesh.vertices, mesh.faces, result.coordinates, (size, _map_unit(result)))


def _map_unit(result: Parameterization) -> float:
    closed = TARGETS.get(result.target).space.closed
    return 1.0 if closed else max(float(np.ptp(result.coordinates, axis=0).max()), _TINY)


def checkers(result: Parameterization, rotation: FloatArray, shapes: np.ndarray, squares: int = _CHECKS) -> Paint:
    """A checkerboard of a map, about so many squares across, which double where the map's scale does.

    On the sphere it is upright as the surface is that is turned by ``rotation``. shapes: those of ``map_shapes``.
    """
    faces, closed, image = result.mesh.faces, TARGETS.get(result.target).space.closed, result.coordinates
    log_size = math.log2(_map_unit(result) / squares)
    if closed:  # longitudes run around the axis that is up in the picture
        image = np.ascontiguousarray(image @ rotation[[2, 0, 1]].T)

    def paint(face_ids: IntArray, weights: FloatArray) -> np.ndarray:
        """Light and dark squares."""
        dark = checkered(face_ids, weights, faces, image, shapes, log_size, closed)
        return LIGHT + dark[:, None] * (DARK - LIGHT)

    return paint
