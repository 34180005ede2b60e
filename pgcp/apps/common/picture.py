"""Pictures of surfaces with values or colours at their vertices, in the light, several beside each other."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from pgcp.report.chart import Scale, centred, colour_bar, linear_axis
from pgcp.report.picture import DARK, LIGHT
from pgcp.report.raster import Paint, View, rasterise, view
from pgcp.report.shade import checkered, in_colours, lit, vertex_shapes
from pgcp.result import Result
from pgcp.targets.registry import TARGETS
from pgcp.types import FloatArray, IntArray

FIELD = ((0.18, 0.20, 0.47), (0.16, 0.47, 0.60), (0.36, 0.71, 0.52), (0.86, 0.81, 0.36), (0.99, 0.94, 0.72))
_LIGHTS = np.array([[0.35, 0.55, 0.76], [0.0, 0.0, 1.0]])
_CAPTION, _BAR, _GAP = 60, 96, 40  # pixels of a canvas that is made smaller by half
_TINY = 1e-300
_CHECKS = 32  # squares across


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """A surface to be drawn: points (V, 3), faces (F, 3), and how it is turned, rows to the right, up and towards the eye.

    values: colours (V, 3) from 0 to 1, or numbers (V,) that are shown by colours between ``limits``, or what gives colours
    (m, 3) of places on faces, face_ids (m,) and weights (m, 3).
    box (2, 3): what is in sight of the turned points, all of them where it is None.
    """

    points: FloatArray
    faces: IntArray
    rotation: FloatArray
    values: FloatArray | Paint
    caption: str = ""
    limits: tuple[float, float] | None = None
    box: FloatArray | None = None


def limits_of(values: FloatArray) -> tuple[float, float]:
    """From where to where 98 % of values (V,) lie."""
    low, high = (float(each) for each in np.quantile(values, [0.01, 0.99]))
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def turned_box(points: Sequence[FloatArray], rotation: FloatArray) -> FloatArray:
    """What is in sight (2, 3) of all of several sets of points (V, 3), turned."""
    ends = [[turn.min(axis=0), turn.max(axis=0)] for turn in (each @ rotation.T for each in points)]
    return np.array([np.min([low for low, _ in ends], axis=0), np.max([high for _, high in ends], axis=0)])


def pixels_of(panel: Panel, size: int) -> np.ndarray:
    """The drawn surface (size, size, 3), bytes on white, without its caption."""
    points = np.ascontiguousarray(panel.points, np.float64)
    seen = view(points, panel.faces, np.ascontiguousarray(panel.rotation))
    if panel.box is not None:
        seen = View(seen.points, seen.faces, seen.rotation, panel.box)
    unit = max(float(np.ptp(points, axis=0).max()), _TINY)
    shapes = vertex_shapes(points, panel.faces, points, (unit, unit))
    lights = np.ascontiguousarray(_LIGHTS @ seen.rotation)

    def paint(face_ids: IntArray, weights: FloatArray) -> np.ndarray:
        """Colours in the light."""
        values = panel.values
        if callable(values):
            shown = values(face_ids, weights)
        else:
            shown = np.einsum("mk,mk...->m...", weights, values[panel.faces[face_ids]])
        if panel.limits is not None:
            shown = in_colours((shown - panel.limits[0]) / (panel.limits[1] - panel.limits[0]), FIELD)
        light = lit(face_ids, weights, panel.faces, shapes, lights)
        return np.asarray(shown * light[:, :1] + light[:, 1:], np.float64)

    return rasterise(seen, paint, size)


def checkers_of(result: Result, rotation: FloatArray) -> Paint:
    """Colours of places on faces: a checkerboard of a map, upright on the sphere as the surface is that is turned so."""
    mesh, closed = result.mesh, TARGETS.get(result.target).space.closed
    unit = 1.0 if closed else max(float(np.ptp(result.coordinates, axis=0).max()), _TINY)
    size = max(float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))), _TINY)
    shapes = vertex_shapes(mesh.vertices, mesh.faces, result.coordinates, (size, unit))
    image = np.ascontiguousarray(result.coordinates @ rotation[[2, 0, 1]].T) if closed else result.coordinates

    def paint(face_ids: IntArray, weights: FloatArray) -> np.ndarray:
        """Light and dark squares, which double where the map's scale does."""
        dark = checkered(face_ids, weights, mesh.faces, image, shapes, float(np.log2(unit / _CHECKS)), closed)
        return LIGHT + dark[:, None] * (DARK - LIGHT)

    return paint


def side_by_side(panels: Sequence[Panel], size: int = 900) -> Image.Image:
    """Panels in a row under their captions, each a square of half so many pixels; a bar of colours below if they share one."""
    limits = panels[0].limits
    width = len(panels) * size + (len(panels) - 1) * _GAP
    sheet = Image.new("RGB", (width, _CAPTION + size + (0 if limits is None else _BAR)), "white")
    draw = ImageDraw.Draw(sheet)
    for k, panel in enumerate(panels):
        left = k * (size + _GAP)
        centred(draw, (left + size / 2, _CAPTION / 2), panel.caption, 30, size - 20)
        sheet.paste(Image.fromarray(pixels_of(panel, size)), (left, _CAPTION))
    if limits is not None:
        room = (width // 4, sheet.height - _BAR + 12, width * 3 // 4, sheet.height - 10)
        colour_bar(sheet, room, Scale(linear_axis(*limits, (0.0, 0.0), 7), FIELD))
    return sheet.reduce(2)


def as_png(image: Image.Image, colours: int = 0) -> bytes:
    """The bytes of a PNG, with so few colours where they are not 0."""
    out = io.BytesIO()
    (image.quantize(colours, dither=Image.Dither.NONE) if colours else image).save(out, "png", optimize=True)
    return out.getvalue()
