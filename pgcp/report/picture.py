"""One picture of a finished map: the surface with a checkerboard, the map, the histogram of angle errors.

Panels are drawn in two threads at a time, twice as large as they will be, and put side by side.
"""

from __future__ import annotations

import colorsys
import io
import math
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any

import networkx
import numpy as np
from PIL import Image, ImageDraw

from pgcp.report.chart import BLUE, INK, RED, Chart, centred, linear_axis, log_axis
from pgcp.report.raster import PIXELS, Paint, View, rasterise, view
from pgcp.report.shade import by_normals, checkered, vertex_shapes
from pgcp.surface.distortion import angle_errors
from pgcp.surface.operators import face_areas
from pgcp.targets.registry import TARGETS
from pgcp.types import FloatArray, IntArray, Mesh, Parameterization

_CHECKS = 48
_BINS = 80
_SAMPLE, _VIEW_SAMPLE = 250_000, 50_000
_WIDTH, _HEIGHT, _TITLE = 1100, 1068, 76  # of a panel with its caption, and of the title above
_CAPTION, _TOP = 18, 1068 - PIXELS - 20
_ROOM = 40, 52, _WIDTH - 40, _HEIGHT - 20
_TINY = 1e-300


def _sample(faces: IntArray, most: int) -> tuple[IntArray, int]:
    """An even sample of at most so many faces, and the step from one to the next: odd, as faces often come in pairs."""
    step = -(-len(faces) // most) | 1
    return faces[::step], step


def _corners(points: FloatArray, faces: IntArray) -> FloatArray:
    """The corners of faces, one after another (3 F, 2 or 3), in units of their extent."""
    corners = points[faces.reshape(-1)]
    corners /= max(float(np.ptp(corners, axis=0).max()), _TINY)
    return corners


def _view_rotation(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Rotation (3, 3) to the flattest view, from the side most faces look to, z (or y) upright.

    Rows: to the right, up, towards the eye. Where as many look either way, as on closed surfaces, from the positive side.
    """
    sample, _ = _sample(faces, _VIEW_SAMPLE)
    a, b, c = _corners(vertices, sample).reshape(-1, 3, 3).swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    spread = a - a.mean(axis=0)
    _, axes = np.linalg.eigh(spread.T @ spread)
    towards = axes[:, 0] * np.sign(axes[np.abs(axes[:, 0]).argmax(), 0])
    facing = normals @ towards
    if facing.sum() < -0.03 * np.abs(facing).sum():
        towards = -towards
    up = np.array([0.0, 0.0, 1.0]) if abs(towards[2]) < 0.7 else np.array([0.0, 1.0, 0.0])
    up = up - towards * (towards @ up)
    up = up / np.linalg.norm(up)
    return np.array([np.cross(up, towards), up, towards])


def _panel(caption: str) -> Image.Image:
    panel = Image.new("RGB", (_WIDTH, _HEIGHT), "white")
    centred(ImageDraw.Draw(panel), (_WIDTH / 2, _CAPTION), caption, 28, _WIDTH - 40)
    return panel


def _drawn(caption: str, seen_from: View, paint: Paint) -> Image.Image:
    panel = _panel(caption)
    panel.paste(Image.fromarray(rasterise(seen_from, paint)), ((_WIDTH - PIXELS) // 2, _TOP))
    return panel


def _surface(result: Parameterization, surface: View, log_size: float, shapes: np.ndarray) -> Image.Image:
    """The surface with a checkerboard of the map."""
    light = np.array([0.3, 0.4, 0.87]) @ surface.rotation
    on_sphere = TARGETS.get(result.target).space.closed

    def paint(face_ids: IntArray, weights: FloatArray) -> np.ndarray:
        """Checkerboard of the map."""
        return checkered(face_ids, weights, surface.faces, result.coordinates, shapes, light, log_size, on_sphere)

    return _drawn("the surface, with a checkerboard of the map (squares double with the scale)", surface, paint)


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


def _sphere(result: Parameterization, surface: View, side: str, shapes: np.ndarray) -> Image.Image:
    """The sphere from the side the surface is shown from, or from behind, the surface's normals as colours."""
    turn = np.diag([1.0, 1.0, 1.0] if side == "front" else [-1.0, 1.0, -1.0])
    seen_from = view(result.coordinates, surface.faces, turn @ surface.rotation)

    def paint(face_ids: IntArray, weights: FloatArray) -> np.ndarray:
        """Normal of the surface."""
        return by_normals(face_ids, weights, surface.faces, shapes, surface.rotation)

    return _drawn(f"the sphere, {side}: colours are the surface's normals", seen_from, paint)


def _histogram(result: Parameterization) -> Image.Image:
    """Angle errors of an even sample of the faces, of those that have an area."""
    quality, (faces, step) = result.quality, _sample(result.mesh.faces, _SAMPLE)
    surface, image = (_corners(points, faces) for points in (result.mesh.vertices, result.coordinates))
    mesh = Mesh(surface, np.arange(faces.size, dtype=np.int32).reshape(-1, 3))
    errors = angle_errors(mesh, image)[face_areas(surface, mesh.faces) > 0.0].reshape(-1)
    limit = max(float(np.quantile(errors, 0.995)), 1e-12) if len(errors) else 1.0
    bins = (errors[errors <= limit] * (_BINS / limit)).astype(np.int32)
    counts = np.bincount(np.minimum(bins, _BINS - 1), minlength=_BINS)
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
    """Conformal energy, and the norm of its gradient, by iteration."""
    energies = [float(step["energy"]) for step in iterations]
    norms = [float(step["gradient_norm"]) for step in iterations]
    least = min((norm for norm in norms if norm > _TINY), default=1.0)
    norms = [max(norm, least) for norm in norms]
    panel = _panel(f"conformal energy (blue) {energies[-1]:.6g}, gradient's norm (red)")
    below, left = linear_axis(0.0, max(len(energies) - 1.0, 1.0)), linear_axis(min(energies), max(energies))
    chart = Chart(panel, _ROOM, below, left, log_axis(least, max(norms)))
    chart.write("iteration")
    chart.line(list(enumerate(norms)), RED, chart.right)
    chart.line(list(enumerate(energies)), BLUE, dots=6)
    chart.frame()
    return panel


def _panels(result: Parameterization, pool: ThreadPoolExecutor) -> list[Future[Image.Image]]:
    """All panels from left to right. What waits for something is queued after it."""
    mesh, image = result.mesh, result.coordinates
    iterations = result.report.get("iterations", [])
    surface = view(mesh.vertices, mesh.faces, _view_rotation(mesh.vertices, mesh.faces))
    plane = None if TARGETS.get(result.target).space.closed else view(image, mesh.faces)
    unit = max(float(plane.extent.max()), _TINY) if plane else 1.0
    units = max(float(np.hypot(*surface.extent)), _TINY), unit
    shapes = pool.submit(vertex_shapes, mesh.vertices, mesh.faces, image, units)

    def shaded(panel: Callable[[np.ndarray], Image.Image]) -> Future[Image.Image]:
        """A panel that needs the shapes."""
        return pool.submit(lambda: panel(shapes.result()))

    flat = [pool.submit(_map, result, plane)] if plane else []
    flat += [pool.submit(_descent, iterations)] if iterations else []
    last = pool.submit(_histogram, result)
    first = shaded(partial(_surface, result, surface, math.log2(unit / _CHECKS)))
    sides = [] if plane else [shaded(partial(_sphere, result, surface, side)) for side in ("front", "back")]
    return [first, *sides, *flat, last]


def draw(result: Parameterization) -> bytes:
    """PNG bytes of the picture."""
    out = io.BytesIO()
    drawn_sheet(result).save(out, "png", compress_level=4)
    return out.getvalue()


def drawn_sheet(result: Parameterization) -> Image.Image:
    """The picture: all panels side by side under the mesh's name."""
    with ThreadPoolExecutor(2) as pool:
        panels = [panel.result() for panel in _panels(result, pool)]
    sheet = Image.new("RGB", (_WIDTH * len(panels), _TITLE + _HEIGHT), "white")
    mark = "" if result.quality.folds == 0 else f"  -  FOLDED: {result.quality.folds} faces"
    place, room = (sheet.width / 2, _TITLE / 2), sheet.width - 80
    centred(ImageDraw.Draw(sheet), place, f"{result.mesh.name}{mark}", 36, room, RED if mark else INK)
    for k, panel in enumerate(panels):
        sheet.paste(panel, (_WIDTH * k, _TITLE))
    return sheet.reduce(2)
