"""Panels of a sheet: surfaces in the light, painted by a function of places on faces, with a caption and a bar of colours.

Lengths are in pixels of a sheet that is made smaller by half in the end.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from PIL import Image, ImageDraw

from pgcp.report.chart import Scale, centred, colour_bar
from pgcp.report.raster import Paint, View, rasterise, view
from pgcp.report.shade import lit, vertex_shapes
from pgcp.types import BoolArray, FloatArray, IntArray, Mesh

PANEL = 1000
_CAPTION, _BAR, _GAP, _TITLE = 44, 100, 30, 76
_LIGHTS = np.array([[0.35, 0.55, 0.76], [0.0, 0.0, 1.0]])
_EDGE = 0.28  # brightness of edges


@dataclass(frozen=True, eq=False)
class Seen:
    """A mesh as it is seen: turned by ``rotation`` (3, 3); box (2, 3) of turned coordinates, all of it where there is none."""

    mesh: Mesh
    rotation: FloatArray
    box: FloatArray | None = None

    @cached_property
    def view(self) -> View:
        """The view."""
        whole = view(self.mesh.vertices, self.mesh.faces, self.rotation)
        return whole if self.box is None else View(whole.points, whole.faces, whole.rotation, self.box)

    @cached_property
    def _shapes(self) -> np.ndarray:
        size = max(float(np.ptp(self.mesh.vertices, axis=0).max()), 1e-300)
        return vertex_shapes(self.mesh.vertices, self.mesh.faces, self.mesh.vertices, (size, size))

    def window(self, centre: FloatArray, width: float) -> Seen:
        """The same with a square of this width around a point (3,) of the surface."""
        middle = self.rotation @ centre
        half = np.array([0.5 * width, 0.5 * width, 0.0])
        return Seen(self.mesh, self.rotation, np.array([middle - half, middle + half]))

    def lit(self, paint: Paint) -> Paint:
        """Colours of places in the light."""
        lights = np.ascontiguousarray(_LIGHTS @ self.rotation)

        def painted(face_ids: IntArray, weights: FloatArray) -> np.ndarray:
            """Colours (m, 3)."""
            light = lit(face_ids, weights, self.mesh.faces, self._shapes, lights)
            return np.asarray(paint(face_ids, weights) * light[:, :1] + light[:, 1:])

        return painted

    def with_edges(self, paint: Paint, drawn: BoolArray | None = None, pixels: float = 2.0) -> Paint:
        """Colours of places, darker along edges; drawn (F, 3): which edges, opposite to each corner, if not all."""
        box = self.view.box
        thick = pixels * float((box[1, :2] - box[0, :2]).max()) / PANEL

        def painted(face_ids: IntArray, weights: FloatArray) -> np.ndarray:
            """Colours (m, 3)."""
            corners = self.mesh.vertices[self.mesh.faces[face_ids]]
            sides = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)  # opposite to each corner
            double = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
            heights = double[:, None] / np.maximum(np.linalg.norm(sides, axis=2), 1e-300)
            close = weights * heights < 0.5 * thick
            near = (close if drawn is None else close & drawn[face_ids]).any(axis=1)
            return np.where(near[:, None], _EDGE, 1.0) * paint(face_ids, weights)

        return painted


def panel(caption: str, seen_from: View, paint: Paint, scale: Scale | None = None) -> Image.Image:
    """A panel of painted faces under its caption, above a bar of colours if there is a scale."""
    sheet = Image.new("RGB", (PANEL, _CAPTION + PANEL + (0 if scale is None else _BAR)), "white")
    centred(ImageDraw.Draw(sheet), (PANEL / 2, _CAPTION / 2), caption, 28, PANEL - 20)
    sheet.paste(Image.fromarray(rasterise(seen_from, paint, PANEL)), (0, _CAPTION))
    if scale is not None:
        colour_bar(sheet, (PANEL // 8, _CAPTION + PANEL + 10, PANEL * 7 // 8, _CAPTION + PANEL + _BAR - 10), scale)
    return sheet


def sheet_of(title: str, panels: Sequence[Image.Image], across: int) -> bytes:
    """PNG bytes of panels in rows under a title, half as large."""
    rows = [panels[k : k + across] for k in range(0, len(panels), across)]
    heights = [max(one.height for one in row) for row in rows]
    sheet = Image.new("RGB", (across * (PANEL + _GAP) + _GAP, _TITLE + sum(heights) + _GAP * len(rows)), "white")
    centred(ImageDraw.Draw(sheet), (sheet.width / 2, _TITLE / 2), title, 36, sheet.width - 80)
    top = _TITLE
    for row, height in zip(rows, heights, strict=True):
        for k, one in enumerate(row):
            sheet.paste(one, (_GAP + k * (PANEL + _GAP), top))
        top += height + _GAP
    out = io.BytesIO()
    sheet.reduce(2).save(out, "png", compress_level=6)
    return out.getvalue()
