"""Pictures of values at vertices: on surfaces and on maps, in panels beside charts, and as an animation."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from pgcp.report.chart import BLUE, INK, RED, Axis, Chart, Scale, centred, colour_bar, linear_axis, log_axis
from pgcp.report.picture import COLD_WARM, HEAT, view_rotation
from pgcp.report.raster import rasterise, view
from pgcp.report.shade import in_colours, lit, vertex_shapes
from pgcp.types import FloatArray, IntArray

_WIDTH, _HEIGHT, _TOP, _TITLE, _BAR = 1100, 1060, 56, 76, 90
_LIGHTS = np.array([[0.35, 0.55, 0.76], [0.0, 0.0, 1.0]])
COLOURS = (BLUE, RED, "#2f8f4e", "#8a5aa8")
Colours = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True, slots=True)
class Tint:
    """Colours of values: from low to high, evenly."""

    low: float
    high: float
    stops: Colours = COLD_WARM

    @classmethod
    def around_zero(cls, limit: float) -> Tint:
        """Blue below 0, red above, up to a limit."""
        limit = limit if limit > 0.0 else 1.0
        return cls(-limit, limit)

    @classmethod
    def up_to(cls, limit: float) -> Tint:
        """Grey at 0, dark at a limit."""
        return cls(0.0, limit if limit > 0.0 else 1.0, HEAT)

    @property
    def scale(self) -> Scale:
        """For a bar of colours."""
        return Scale(linear_axis(self.low, self.high, (0.0, 0.0), 5), self.stops)


class Painter:
    """Draws values on one surface or map, seen from one side: points (V, 3) or (V, 2), faces (F, 3).

    What is seen is found once. rotation (3, 3): rows to the right, up, towards the eye; that of the flattest view if not given.
    """

    def __init__(self, points: FloatArray, faces: IntArray, pixels: int, rotation: FloatArray | None = None) -> None:
        points = np.ascontiguousarray(points, np.float64)
        flat = points.shape[-1] < 3
        if rotation is None and not flat:
            rotation = view_rotation(points, faces)
        self.rotation, self._faces = rotation, faces
        seen_from = view(points, faces, None if flat else rotation)
        size = max(float(np.hypot(*seen_from.extent)), 1e-300)
        shapes = vertex_shapes(points, faces, points, (size, size))
        lights = np.ascontiguousarray(_LIGHTS @ seen_from.rotation)

        def paint(face_ids: IntArray, weights: FloatArray) -> np.ndarray:
            """Nothing but black, and what is seen is kept."""
            self._ids, self._weights = face_ids, weights
            light = np.array([[1.0, 0.0]], np.float32)
            self._light = light if flat else lit(face_ids, weights, faces, shapes, lights)
            return np.zeros((len(face_ids), 3), np.float32)

        self._mask = rasterise(seen_from, paint, pixels)[::-1, :, 0] == 0

    def draw(self, values: FloatArray, tint: Tint) -> Image.Image:
        """The picture of values (V,)."""
        here = np.einsum("mk,mk->m", values[self._faces[self._ids]], self._weights)
        colours = in_colours((here - tint.low) / (tint.high - tint.low), tint.stops)
        return self._shown(colours)

    def plain(self) -> Image.Image:
        """The picture of the surface alone."""
        return self._shown(np.full((len(self._ids), 3), (0.72, 0.78, 0.86), np.float32))

    def _shown(self, colours: np.ndarray) -> Image.Image:
        out = np.full((*self._mask.shape, 3), 255, np.uint8)
        shown = np.clip(colours * self._light[:, :1] + self._light[:, 1:], 0.0, 1.0)
        out[self._mask] = (255.0 * shown + 0.5).astype(np.uint8)
        return Image.fromarray(np.ascontiguousarray(out[::-1]))


PIXELS = _HEIGHT - _TOP - _BAR - 10


def panel(caption: str, picture: Image.Image, tint: Tint | None = None) -> Image.Image:
    """A panel with a caption, a picture and its bar of colours."""
    out = Image.new("RGB", (_WIDTH, _HEIGHT), "white")
    centred(ImageDraw.Draw(out), (_WIDTH / 2, _TOP / 2), caption, 28, _WIDTH - 40)
    out.paste(picture, ((_WIDTH - picture.width) // 2, _TOP))
    if tint is not None:
        colour_bar(out, (_WIDTH // 6, _HEIGHT - _BAR + 10, _WIDTH * 5 // 6, _HEIGHT - 10), tint.scale)
    return out


def curves(
    caption: str, below: str, x: Sequence[float] | FloatArray, lines: Sequence[FloatArray], *, log: bool = False, dots: int = 0
) -> Image.Image:
    """A panel with lines (T,) over x (T,), each in a colour of ``COLOURS``; ``log``: on a logarithmic axis, positive values."""
    out = Image.new("RGB", (_WIDTH, _HEIGHT), "white")
    centred(ImageDraw.Draw(out), (_WIDTH / 2, _TOP / 2), caption, 28, _WIDTH - 40)
    low, high = (min(float(line.min()) for line in lines), max(float(line.max()) for line in lines))
    left: Axis = log_axis(max(low, 1e-300), max(high, 1e-299)) if log else linear_axis(low, high)
    chart = Chart(out, (40, _TOP + 4, _WIDTH - 40, _HEIGHT - 20), linear_axis(float(min(x)), float(max(x)), (0.0, 0.0)), left)
    chart.write(below)
    for line, colour in zip(lines, COLOURS, strict=False):
        values = np.maximum(line, 1e-300) if log else line
        chart.line(list(zip(map(float, x), map(float, values), strict=True)), colour, dots=dots)
    chart.frame()
    return out


def sheet(title: str, panels: Sequence[Image.Image], across: int = 3) -> bytes:
    """PNG bytes of panels in rows under a title."""
    across = min(across, len(panels))
    out = Image.new("RGB", (_WIDTH * across, _TITLE + _HEIGHT * -(-len(panels) // across)), "white")
    centred(ImageDraw.Draw(out), (out.width / 2, _TITLE / 2), title, 36, out.width - 80, INK)
    for k, one in enumerate(panels):
        out.paste(one, (_WIDTH * (k % across), _TITLE + _HEIGHT * (k // across)))
    stream = io.BytesIO()
    out.reduce(2).save(stream, "png", compress_level=6)
    return stream.getvalue()


def animation(pictures: Sequence[Sequence[Image.Image]], captions: Sequence[str], seconds: float = 0.1) -> bytes:
    """GIF bytes of frames, each of some pictures beside each other under a caption; the last stands longer, then all again."""
    frames = []
    for row, caption in zip(pictures, captions, strict=True):
        width, height = sum(one.width for one in row), max(one.height for one in row)
        frame = Image.new("RGB", (width, height + 40), "white")
        centred(ImageDraw.Draw(frame), (width / 2, 20), caption, 22, width - 20)
        x = 0
        for one in row:
            frame.paste(one, (x, 40))
            x += one.width
        frames.append(frame)
    some = [frames[k].reduce(2) for k in sorted({0, len(frames) // 2, len(frames) - 1})]
    together = Image.new("RGB", (some[0].width, some[0].height * len(some)))
    for k, one in enumerate(some):
        together.paste(one, (0, k * one.height))
    palette = together.quantize(128, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    frames = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    stream = io.BytesIO()
    lasting = [round(1000 * seconds)] * (len(frames) - 1) + [1500]
    frames[0].save(stream, "gif", save_all=True, append_images=frames[1:], duration=lasting, loop=0, optimize=False)
    return stream.getvalue()
