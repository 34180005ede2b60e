"""One picture of a finished map: the surface with a checkerboard, the map, where angles and areas err, and a histogram.

Panels are drawn in two threads at a time, twice as large as they will be, and put three in a row.
"""

from __future__ import annotations

import colorsys
import io
import math
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import networkx
import numpy as np
from PIL import Image, ImageDraw

from pgcp.finish.unit_square import standing, upright_angle
from pgcp.report.chart import BLUE, INK, RED, Axis, Chart, Scale, centred, colour_bar, linear_axis, log_axis
from pgcp.report.raster import PIXELS, Paint, View, rasterise, view
from pgcp.report.shade import checkered, in_colours, lit, vertex_shapes
from pgcp.surface.distortion import angle_errors
from pgcp.surface.operators import face_areas
from pgcp.targets.registry import TARGETS
from pgcp.types import FloatArray, IntArray, Mesh, Parameterization

_CHECKS = 48
_ACROSS, _BAR = 3, 100  # panels in a row; pixels of a bar of colours with its labels
DARK, LIGHT = (np.array(colour, np.float32) for colour in ((0.20, 0.38, 0.62), (0.98, 0.94, 0.84)))
HEAT = ((0.93, 0.93, 0.91), (0.98, 0.82, 0.45), (0.90, 0.42, 0.16), (0.60, 0.08, 0.12), (0.25, 0.02, 0.10))
COLD_WARM = ((0.13, 0.25, 0.55), (0.45, 0.66, 0.85), (0.94, 0.94, 0.92), (0.93, 0.60, 0.42), (0.62, 0.10, 0.14))
_BINS = 80
_SAMPLE, _VIEW_SAMPLE = 250_000, 50_000
_WIDTH, _HEIGHT, _TITLE = 1100, 1068, 76  # of a panel with its caption, and of the title above
_CAPTION, _TOP = 18, 1068 - PIXELS - 20
_ROOM = 40, 52, _WIDTH - 40, _HEIGHT - 20
_TINY = 1e-300
_WHERE_ANGLES = "where angles err: |angle error| (degrees)"


def _sample(faces: IntArray, most: int) -> tuple[IntArray, int]:
    """An even sample of at most so many faces, and the step from one to the next: odd, as faces often come in pairs."""
    step = -(-len(faces) // most) | 1
    return faces[::step], step


def _corners(points: FloatArray, faces: IntArray) -> FloatArray:
    """The corners of faces, one after another (3 F, 2 or 3), in units of their extent."""
    corners = points[faces.reshape(-1)]
    corners /= max(*(float(np.ptp(column)) for column in corners.T), _TINY)
    return corners


def view_rotation(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Rotation (3, 3) to the flattest view, from the side most faces look to, y or z upright, whichever the surface stands on.

    Rows: to the right, up, towards the eye. Where as many look either way, as on closed surfaces, from the positive side.
    """
    sample, _ = _sample(faces, _VIEW_SAMPLE)
    corners = _corners(vertices, sample)
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


def _panel(caption: str) -> Image.Image:
    panel = Image.new("RGB", (_WIDTH, _HEIGHT), "white")
    centred(ImageDraw.Draw(panel), (_WIDTH / 2, _CAPTION), caption, 28, _WIDTH - 40)
    return panel


def _drawn(caption: str, seen_from: View, paint: Paint, scale: Callable[[], Scale] | None = None) -> Image.Image:
    """A panel with a picture, above a bar of colours if there is one."""
    panel = _panel(caption)
    pixels = PIXELS if scale is None else PIXELS - _BAR
    panel.paste(Image.fromarray(rasterise(seen_from, paint, pixels)), ((_WIDTH - pixels) // 2, _TOP))
    if scale is not None:
        colour_bar(panel, (_WIDTH // 6, _HEIGHT - _BAR + 10, _WIDTH * 5 // 6, _HEIGHT - 10), scale())
    return panel


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """A surface as it is seen: the view, normals and scale of its vertices, and where light and eye are."""

    seen_from: View
    shapes: np.ndarray
    lights: FloatArray

    def lit(self, face_ids: IntArray, weights: FloatArray, colours: np.ndarray) -> np.ndarray:
        """Colours (m, 3) of places in the light."""
        light = lit(face_ids, weights, self.seen_from.faces, self.shapes, self.lights)
        return np.asarray(colours * light[:, :1] + light[:, 1:])


def _look(seen_from: View, shapes: np.ndarray) -> _Look:
    lights = np.array([[0.35, 0.55, 0.76], [0.0, 0.0, 1.0]])
    return _Look(seen_from, shapes, np.ascontiguousarray(lights @ seen_from.rotation))


def _checkers(result: Parameterization, look: _Look, upright: FloatArray, log_size: float, caption: str) -> Image.Image:
    """A surface, or the sphere, with a checkerboard of the map, ``upright``: coordinates of the plane, or turned ones."""
    on_sphere = TARGETS.get(result.target).space.closed

    def paint(face_ids: IntArray, weights: FloatArray) -> np.ndarray:
        """Checkerboard of the map."""
        dark = checkered(face_ids, weights, result.mesh.faces, upright, look.shapes, log_size, on_sphere)
        return look.lit(face_ids, weights, LIGHT + dark[:, None] * (DARK - LIGHT))

    return _drawn(caption, look.seen_from, paint)


def _angles(result: Parameterization, look: _Look, limit: float = 0.0, caption: str = _WHERE_ANGLES) -> Image.Image:
    """The surface, every face in the colour of its mean angle error, up to a limit in degrees: that of 99 % if it is 0."""
    limit = limit or max(result.quality.angle_p99_deg, 1e-9)

    def paint(face_ids: IntArray, weights: FloatArray) -> np.ndarray:
        """Colour of the angle error."""
        shown, place = np.unique(face_ids, return_inverse=True)
        errors = _errors(result, result.mesh.faces[shown]).mean(axis=1)
        return look.lit(face_ids, weights, in_colours(errors / limit, HEAT)[place.reshape(-1)])

    axis = linear_axis(0.0, limit, (0.0, 0.0), 6)
    return _drawn(caption, look.seen_from, paint, lambda: Scale(axis, HEAT))


def _areas(result: Parameterization, look: _Look) -> Image.Image:
    """The surface, in colours of how large its parts are in the map; they span nineteen twentieths of what is seen."""
    faces, _ = _sample(result.mesh.faces, _SAMPLE)
    middle = float(np.median(look.shapes[faces, 3].mean(axis=1)))
    limits = [1]

    def paint(face_ids: IntArray, weights: FloatArray) -> np.ndarray:
        """Colour of the area ratio."""
        corners = result.mesh.faces[face_ids]
        ratios = 2.0 * (np.einsum("mk,mk->m", weights, look.shapes[corners, 3]) - middle)
        reach = float(np.quantile(np.abs(ratios), 0.95)) if len(ratios) else 0.0
        limits.append(1 if reach <= 1.0 else 2 * math.ceil(0.5 * min(reach, 1000.0)))
        return look.lit(face_ids, weights, in_colours(0.5 + 0.5 * ratios / limits[-1], COLD_WARM))

    def scale() -> Scale:
        """Powers of two, even on either side of 1."""
        limit = limits[-1]
        powers = [-1, 0, 1] if limit == 1 else [-limit, -limit // 2, 0, limit // 2, limit]
        labels = [f"{2**k}" if 0 <= k <= 10 else f"1/{2**-k}" if -10 <= k < 0 else f"2^{k}" for k in powers]
        return Scale(Axis(-limit, limit, [float(k) for k in powers], labels, []), COLD_WARM)

    return _drawn("area in the map over area on the surface (1: the median)", look.seen_from, paint, scale)


def patch_colours(rows: list[dict[str, Any]], count: int) -> np.ndarray:
    """Colours (count, 3) of patches: neighbours have different hues, of the same hue each is lighter or darker than others."""
    graph: networkx.Graph = networkx.empty_graph(count)
    graph.add_edges_from((row["index"], other) for row in rows for other in row["neighbours"])
    number = networkx.greedy_color(graph, "DSATUR")
    alike = [[k for k in range(count) if number[k] == hue] for hue in range(max(number.values()) + 1)]
    colours = np.empty((count, 3), np.float32)
    for hue, patches in enumerate(alike):
        for place, patch in enumerate(patches):
            colours[patch] = colorsys.hsv_to_rgb(0.58 + hue / len(alike), 0.45, 1.0 - 0.3 * place / len(patches))
    return colours


def _map(result: Parameterization, plane: View) -> Image.Image:
    """The map, every patch with its colour."""
    count = int(result.patch.max()) + 1
    palette = patch_colours(result.report.get("patches", []), count)

    def paint(face_ids: IntArray, _weights: FloatArray) -> np.ndarray:
        """Colour of the patch."""
        return palette[result.patch[face_ids]]

    width, height = plane.extent
    return _drawn(f"the map, {count} patch{'es' if count > 1 else ''}, {width:.4g} x {height:.4g}", plane, paint)


def _soup(faces: IntArray) -> IntArray:
    """As many faces, each with corners of its own."""
    return np.arange(faces.size, dtype=np.int32).reshape(-1, 3)


def _errors(result: Parameterization, faces: IntArray) -> FloatArray:
    """Angle errors (n, 3) of faces, in degrees; 0 where a face has no area on the surface."""
    surface, image = (_corners(points, faces) for points in (result.mesh.vertices, result.coordinates))
    mesh = Mesh(surface, _soup(faces))
    return np.where((face_areas(surface, mesh.faces) > 0.0)[:, None], angle_errors(mesh, image), 0.0)


def angle_histogram(result: Parameterization) -> tuple[IntArray, float, int]:
    """How many corners have an angle error in each of the bins from 0 to a limit, in degrees, that 99.5 % keep.

    Of an even sample of the faces, of those that have an area. Returns counts (bins,), the limit, and the step of the sample.
    """
    faces, step = _sample(result.mesh.faces, _SAMPLE)
    errors = _errors(result, faces)[face_areas(_corners(result.mesh.vertices, faces), _soup(faces)) > 0.0].reshape(-1)
    limit = max(float(np.quantile(errors, 0.995)), 1e-12) if len(errors) else 1.0
    bins = (errors[errors <= limit] * (_BINS / limit)).astype(np.int32)
    return np.bincount(np.minimum(bins, _BINS - 1), minlength=_BINS), limit, step


def _histogram(result: Parameterization) -> Image.Image:
    """Angle errors of an even sample of the faces."""
    quality, (counts, limit, step) = result.quality, angle_histogram(result)
    mean = quality.angle_mean_deg
    text = f"mean {mean:.3f}, sd {quality.angle_sd_deg:.3f}, 99 % {quality.angle_p99_deg:.2f}"
    panel = _panel(f"{text}; folds {quality.folds}")
    below, left = linear_axis(0.0, limit), linear_axis(0.0, float(counts.max()), (0.0, 0.05))
    chart = Chart(panel, _ROOM, below, left)
    chart.write("|angle error| (degrees)", "corners" if step == 1 else f"corners, of one face in {step}")
    for k in np.flatnonzero(counts).tolist():
        chart.bar(k * limit / _BINS, (k + 1) * limit / _BINS, float(counts[k]), BLUE)
    if mean < below.high:
        chart.line([(mean, left.low), (mean, left.high)], RED)
    chart.frame()
    return panel


def _descent(iterations: list[dict[str, Any]]) -> Image.Image:
    """Conformal energy or else mean |mu| by iteration, and the norm of the energy's gradient where that is known."""
    key, name = ("energy", "conformal energy") if "energy" in iterations[0] else ("mean_mu", "mean |mu|")
    values = [float(step[key]) for step in iterations]
    norms = [float(step["gradient_norm"]) for step in iterations if "gradient_norm" in step]
    panel = _panel(f"{name} (blue) {values[-1]:.6g}" + (", gradient's norm (red)" if norms else ""))
    below, left = linear_axis(0.0, max(len(values) - 1.0, 1.0)), linear_axis(min(values), max(values))
    least = min((norm for norm in norms if norm > _TINY), default=1.0)
    norms = [max(norm, least) for norm in norms]
    right = log_axis(least, max(norms)) if norms else None
    chart = Chart(panel, _ROOM, below, left, right)
    chart.write("iteration")
    if right is not None:
        chart.line(list(enumerate(norms)), RED, right)
    chart.line(list(enumerate(values)), BLUE, dots=6)
    chart.frame()
    return panel


def _panels(result: Parameterization, pool: ThreadPoolExecutor) -> list[Future[Image.Image]]:
    """All panels, row by row. What waits for something is queued after it."""
    mesh, image = result.mesh, result.coordinates
    iterations = result.report.get("iterations", [])
    surface = view(mesh.vertices, mesh.faces, view_rotation(mesh.vertices, mesh.faces))
    closed = TARGETS.get(result.target).space.closed
    plane = None if closed else view(image, mesh.faces, _upright(mesh, image))
    unit = max(float(np.ptp(image, axis=0).max()), _TINY) if plane else 1.0
    # longitudes run around the axis that is up in the picture
    upright = image if plane else np.ascontiguousarray(image @ surface.rotation[[2, 0, 1]].T)
    units, size = (max(float(np.hypot(*surface.extent)), _TINY), unit), math.log2(unit / _CHECKS)
    shapes = pool.submit(vertex_shapes, mesh.vertices, mesh.faces, image, units)

    def shaded(panel: Callable[[_Look], Image.Image]) -> Future[Image.Image]:
        """A panel of the surface, which needs the shapes."""
        return pool.submit(lambda: panel(_look(surface, shapes.result())))

    def on_sphere(side: str) -> Image.Image:
        """The sphere from the side the surface is shown from, or from behind."""
        turn = np.diag([1.0, 1.0, 1.0] if side == "front" else [-1.0, 1.0, -1.0])
        round_ones = shapes.result().copy()
        round_ones[:, :3] = image
        look = _look(view(image, mesh.faces, turn @ surface.rotation), round_ones)
        return _checkers(result, look, upright, size, f"the same checkerboard on the sphere, {side}")

    caption = "the surface, with a checkerboard of the map (squares double with the scale)"
    flat = [pool.submit(_map, result, plane)] if plane else []
    curves = [pool.submit(_descent, iterations)] if iterations else []
    last = pool.submit(_histogram, result)
    first = shaded(lambda look: _checkers(result, look, upright, size, caption))
    sides = [] if plane else [pool.submit(on_sphere, side) for side in ("front", "back")]
    maps = [shaded(partial(_angles, result)), shaded(partial(_areas, result))]
    return [first, *flat, *sides, *maps, last, *curves]


def drawn_beside(columns: Sequence[tuple[str, Parameterization | None, str]], limit: float) -> Image.Image:
    """Maps of one surface beside each other: a checkerboard of each, and below where its angles err, in the same colours.

    columns: a caption, the map, and why there is none; limit: the error in degrees that the last colour stands for.
    """
    sheet = Image.new("RGB", (_WIDTH * len(columns), 2 * _HEIGHT), "white")
    for k, (caption, result, problem) in enumerate(columns):
        panels = _without_map(caption, problem) if result is None else _two_panels(caption, result, limit)
        for row, panel in enumerate(panels):
            sheet.paste(panel, (_WIDTH * k, _HEIGHT * row))
    return sheet.reduce(3)


def _two_panels(caption: str, result: Parameterization, limit: float) -> tuple[Image.Image, Image.Image]:
    mesh, image = result.mesh, result.coordinates
    surface = view(mesh.vertices, mesh.faces, view_rotation(mesh.vertices, mesh.faces))
    closed = TARGETS.get(result.target).space.closed
    unit = 1.0 if closed else max(float(np.ptp(image, axis=0).max()), _TINY)
    units = max(float(np.hypot(*surface.extent)), _TINY), unit
    look = _look(surface, vertex_shapes(mesh.vertices, mesh.faces, image, units))
    upright = np.ascontiguousarray(image @ surface.rotation[[2, 0, 1]].T) if closed else image
    return (
        _checkers(result, look, upright, math.log2(unit / _CHECKS), caption),
        _angles(result, look, limit, f"mean |angle error| {result.quality.angle_mean_deg:.4f} degrees"),
    )


def _without_map(caption: str, problem: str) -> tuple[Image.Image, Image.Image]:
    return _panel(caption), _panel(f"no map: {problem}")


def _upright(mesh: Mesh, image: FloatArray) -> FloatArray:
    """Rotation (3, 2) of a map to the plane, so that the surface's up is up."""
    angle, _ = upright_angle(mesh, image)
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)], [0.0, 0.0]])


def draw(result: Parameterization) -> bytes:
    """PNG bytes of the picture."""
    out = io.BytesIO()
    drawn_sheet(result).save(out, "png", compress_level=4)
    return out.getvalue()


def drawn_sheet(result: Parameterization) -> Image.Image:
    """The picture: all panels side by side under the mesh's name."""
    with ThreadPoolExecutor(2) as pool:
        panels = [panel.result() for panel in _panels(result, pool)]
    across = min(_ACROSS, len(panels))
    sheet = Image.new("RGB", (_WIDTH * across, _TITLE + _HEIGHT * -(-len(panels) // across)), "white")
    mark = "" if result.quality.folds == 0 else f"  -  FOLDED: {result.quality.folds} faces"
    place, room = (sheet.width / 2, _TITLE / 2), sheet.width - 80
    centred(ImageDraw.Draw(sheet), place, f"{result.mesh.name}{mark}", 36, room, RED if mark else INK)
    for k, panel in enumerate(panels):
        sheet.paste(panel, (_WIDTH * (k % across), _TITLE + _HEIGHT * (k // across)))
    return sheet.reduce(2)
