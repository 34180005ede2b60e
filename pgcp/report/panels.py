"""Sheets of panels, each a picture or a chart under a caption, and animations.

Lengths are in pixels of a canvas that is made smaller by half in the end.
"""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from pgcp.report.chart import BLUE, INK, RED, Axis, Chart, Scale, centred, colour_bar, linear_axis, log_axis
from pgcp.report.raster import PIXELS
from pgcp.types import FloatArray

BAR = 100  # of a bar of colours with its labels
SMALLER = PIXELS - BAR  # a picture above such a bar
WIDTH, HEIGHT = PIXELS + 100, PIXELS + 68  # of a panel with its caption
_TOP, _CAPTION, _TITLE = 48, 18, 76
ROOM = 40, 52, WIDTH - 40, HEIGHT - 20  # of a chart
COLOURS = (BLUE, RED, "#2f8f4e", "#8a5aa8")
_CAPTIONED, _LARGER = 40, 28


def panel(caption: str, picture: Image.Image | None = None, scale: Scale | None = None, pixels: int = PIXELS) -> Image.Image:
    """A panel for a picture of so many pixels, or for one of ``BAR`` fewer above a bar of colours."""
    out = Image.new("RGB", (WIDTH - PIXELS + pixels, HEIGHT - PIXELS + pixels), "white")
    centred(ImageDraw.Draw(out), (out.width / 2, _CAPTION), caption, _LARGER, out.width - 40)
    if picture is not None:
        out.paste(picture, ((out.width - picture.width) // 2, _TOP))
    if scale is not None:
        colour_bar(out, (out.width // 6, out.height - BAR + 10, out.width * 5 // 6, out.height - 10), scale)
    return out


def curves(
    caption: str, below: str, x: Sequence[float] | FloatArray, lines: Sequence[FloatArray], *, log: bool = False, dots: int = 0
) -> Image.Image:
    """A panel with lines (T,) over x (T,), each in a colour of ``COLOURS``; ``log``: on a logarithmic axis, positive values."""
    out = panel(caption)
    low, high = (min(float(line.min()) for line in lines), max(float(line.max()) for line in lines))
    left: Axis = log_axis(max(low, 1e-300), max(high, 1e-299)) if log else linear_axis(low, high)
    chart = Chart(out, ROOM, linear_axis(float(min(x)), float(max(x)), (0.0, 0.0)), left)
    chart.write(below)
    for line, colour in zip(lines, COLOURS, strict=False):
        values = np.maximum(line, 1e-300) if log else line
        chart.line(list(zip(map(float, x), map(float, values), strict=True)), colour, dots=dots)
    chart.frame()
    return out


def in_rows(panels: Sequence[Image.Image], across: int, top: int = 0) -> Image.Image:
    """Panels of one size in rows, below so many empty pixels."""
    across, (width, height) = min(across, len(panels)), panels[0].size
    out = Image.new("RGB", (width * across, top + height * -(-len(panels) // across)), "white")
    for k, one in enumerate(panels):
        out.paste(one, (width * (k % across), top + height * (k // across)))
    return out


def sheet(title: str, panels: Sequence[Image.Image], across: int = 3, colour: str = INK) -> Image.Image:
    """Panels of one size in rows under a title, made smaller by half."""
    out = in_rows(panels, across, _TITLE)
    centred(ImageDraw.Draw(out), (out.width / 2, _TITLE / 2), title, 36, out.width - 80, colour)
    return out.reduce(2)


def as_png(image: Image.Image) -> bytes:
    """The bytes of a PNG."""
    out = io.BytesIO()
    image.save(out, "png", compress_level=6)
    return out.getvalue()


def captioned(pictures: Sequence[Image.Image], caption: str) -> Image.Image:
    """Pictures beside each other under a caption."""
    row = in_rows(pictures, len(pictures), _CAPTIONED)
    centred(ImageDraw.Draw(row), (row.width / 2, _CAPTIONED / 2), caption, 22, row.width - 20)
    return row


def animation(frames: Sequence[Image.Image], times: Sequence[int], colours: int = 128) -> bytes:
    """GIF bytes of frames that stand for so many milliseconds each, over and over, all in the same colours."""
    some = [frames[k].reduce(2) for k in sorted({0, len(frames) // 2, len(frames) - 1})]
    palette = in_rows(some, 1).quantize(colours, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    first, *others = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    out = io.BytesIO()
    first.save(out, "gif", save_all=True, append_images=others, duration=list(times), loop=0, optimize=False)
    return out.getvalue()
