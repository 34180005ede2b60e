"""One picture of a finished map: the surface with a checkerboard, the map, where angles and areas err, and a histogram.

Panels are drawn in two threads at a time, twice as large as they will be, and put three in a row.
"""

from __future__ import annotations

import colorsys
import io
import math
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any

import networkx
import numpy as np
from PIL import Image

from pgcp.finish.unit_square import upright_angle
from pgcp.report.chart import BLUE, INK, RED, Axis, Chart, Scale, linear_axis, log_axis
from pgcp.report.panels import ROOM, SMALLER, in_rows, panel, sheet
from pgcp.report.raster import PIXELS, Paint, view
from pgcp.report.seen import COLD_WARM, HEAT, Seen, checkers, map_shapes, sample_of, unit_corners, view_rotation
from pgcp.report.shade import in_colours
from pgcp.surface.distortion import angle_errors
from pgcp.surface.operators import face_areas
from pgcp.targets.registry import TARGETS
from pgcp.types import FloatArray, IntArray, Mesh, Parameterization

_BINS = 80
_SAMPLE = 250_000
_TINY = 1e-300
_WHERE_ANGLES = "where angles err: |angle error| (degrees)"


def _drawn(caption: str, look: Seen, paint: Paint, scale: Callable[[], Scale] | None = None) -> Image.Image:
    """A panel with a picture, above a bar of colours if there is one, which is asked for once it is painted."""
    picture = look.drawn(paint, PIXELS if scale is None else SMALLER)
    return panel(caption, picture, None if scale is None else scale())


def _angles(result: Parameterization, look: Seen, limit: float = 0.0, caption: str = _WHERE_ANGLES) -> Image.Image:
    """The surface, every face in the colour of its mean angle error, up to a limit in degrees: that of 99 % if it is 0."""
    limit = limit or max(result.quality.angle_p99_deg, 1e-9)

    def paint(face_ids: IntArray, weights: FloatArray) -> np.ndarray:
        """Colour of the angle error."""
        shown, place = np.unique(face_ids, return_inverse=True)
        errors = _errors(result, result.mesh.faces[shown]).mean(axis=1)
        return in_colours(errors / limit, HEAT)[place.reshape(-1)]

    return _drawn(caption, look, paint, lambda: Scale.between(0.0, limit, HEAT))


def _areas(result: Parameterization, look: Seen) -> Image.Image:
    """The surface, in colours of how large its parts are in the map; they span nineteen twentieths of what is seen."""
    shapes = look.shapes
    assert shapes is not None
    faces, _ = sample_of(result.mesh.faces, _SAMPLE)
    middle = float(np.median(shapes[faces, 3].mean(axis=1)))
    limits = [1]

    def paint(face_ids: IntArray, weights: FloatArray) -> np.ndarray:
        """Colour of the area ratio."""
        corners = result.mesh.faces[face_ids]
        ratios = 2.0 * (np.einsum("mk,mk->m", weights, shapes[corners, 3]) - middle)
        reach = float(np.quantile(np.abs(ratios), 0.95)) if len(ratios) else 0.0
        limits.append(1 if reach <= 1.0 else 2 * math.ceil(0.5 * min(reach, 1000.0)))
        return in_colours(0.5 + 0.5 * ratios / limits[-1], COLD_WARM)

    def scale() -> Scale:
        """Powers of two, even on either side of 1."""
        limit = limits[-1]
        powers = [-1, 0, 1] if limit == 1 else [-limit, -limit // 2, 0, limit // 2, limit]
        labels = [f"{2**k}" if 0 <= k <= 10 else f"1/{2**-k}" if -10 <= k < 0 else f"2^{k}" for k in powers]
        return Scale(Axis(-limit, limit, [float(k) for k in powers], labels, []), COLD_WARM)

    return _drawn("area in the map over area on the surface (1: the median)", look, paint, scale)


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


def _map(result: Parameterization, plane: Seen) -> Image.Image:
    """The map, every patch with its colour."""
    count = int(result.patch.max()) + 1
    palette = patch_colours(result.report.get("patches", []), count)

    def paint(face_ids: IntArray, _weights: FloatArray) -> np.ndarray:
        """Colour of the patch."""
        return palette[result.patch[face_ids]]

    width, height = plane.view.extent
    return _drawn(f"the map, {count} patch{'es' if count > 1 else ''}, {width:.4g} x {height:.4g}", plane, paint)


def _soup(faces: IntArray) -> IntArray:
    """As many faces, each with corners of its own."""
    return np.arange(faces.size, dtype=np.int32).reshape(-1, 3)


def _errors(result: Parameterization, faces: IntArray) -> FloatArray:
    """Angle errors (n, 3) of faces, in degrees; 0 where a face has no area on the surface."""
    surface, image = (unit_corners(points, faces) for points in (result.mesh.vertices, result.coordinates))
    mesh = Mesh(surface, _soup(faces))
    return np.where((face_areas(surface, mesh.faces) > 0.0)[:, None], angle_errors(mesh, image), 0.0)


def angle_histogram(result: Parameterization) -> tuple[IntArray, float, int]:
    """How many corners have an angle error in each of the bins from 0 to a limit, in degrees, that 99.5 % keep.

    Of an even sample of the faces, of those that have an area. Returns counts (bins,), the limit, and the step of the sample.
    """
    faces, step = sample_of(result.mesh.faces, _SAMPLE)
    errors = _errors(result, faces)[face_areas(unit_corners(result.mesh.vertices, faces), _soup(faces)) > 0.0].reshape(-1)
    limit = max(float(np.quantile(errors, 0.995)), 1e-12) if len(errors) else 1.0
    bins = (errors[errors <= limit] * (_BINS / limit)).astype(np.int32)
    return np.bincount(np.minimum(bins, _BINS - 1), minlength=_BINS), limit, step


def _histogram(result: Parameterization) -> Image.Image:
    """Angle errors of an even sample of the faces."""
    quality, (counts, limit, step) = result.quality, angle_histogram(result)
    mean = quality.angle_mean_deg
    text = f"mean {mean:.3f}, sd {quality.angle_sd_deg:.3f}, 99 % {quality.angle_p99_deg:.2f}"
    out = panel(f"{text}; folds {quality.folds}")
    below, left = linear_axis(0.0, limit), linear_axis(0.0, float(counts.max()), (0.0, 0.05))
    chart = Chart(out, ROOM, below, left)
    chart.write("|angle error| (degrees)", "corners" if step == 1 else f"corners, of one face in {step}")
    for k in np.flatnonzero(counts).tolist():
        chart.bar(k * limit / _BINS, (k + 1) * limit / _BINS, float(counts[k]), BLUE)
    if mean < below.high:
        chart.line([(mean, left.low), (mean, left.high)], RED)
    chart.frame()
    return out


def _descent(iterations: list[dict[str, Any]]) -> Image.Image:
    """Conformal energy or else mean |mu| by iteration, and the norm of the energy's gradient where that is known."""
    key, name = ("energy", "conformal energy") if "energy" in iterations[0] else ("mean_mu", "mean |mu|")
    values = [float(step[key]) for step in iterations]
    norms = [float(step["gradient_norm"]) for step in iterations if "gradient_norm" in step]
    out = panel(f"{name} (blue) {values[-1]:.6g}" + (", gradient's norm (red)" if norms else ""))
    below, left = linear_axis(0.0, max(len(values) - 1.0, 1.0)), linear_axis(min(values), max(values))
    least = min((norm for norm in norms if norm > _TINY), default=1.0)
    norms = [max(norm, least) for norm in norms]
    right = log_axis(least, max(norms)) if norms else None
    chart = Chart(out, ROOM, below, left, right)
    chart.write("iteration")
    if right is not None:
        chart.line(list(enumerate(norms)), RED, right)
    chart.line(list(enumerate(values)), BLUE, dots=6)
    chart.frame()
    return out


def _panels(result: Parameterization, pool: ThreadPoolExecutor) -> list[Future[Image.Image]]:
    """All panels, row by row. What waits for something is queued after it."""
    mesh, image = result.mesh, result.coordinates
    iterations = result.report.get("iterations", [])
    surface = view(mesh.vertices, mesh.faces, view_rotation(mesh.vertices, mesh.faces))
    closed = TARGETS.get(result.target).space.closed
    shapes = pool.submit(map_shapes, result, surface)

    def shaded(draw_one: Callable[[Seen], Image.Image]) -> Future[Image.Image]:
        """A panel of the surface, which needs the shapes."""
        return pool.submit(lambda: draw_one(Seen(surface, shapes.result())))

    def board(caption: str, look: Seen) -> Image.Image:
        """A surface, or the sphere, with a checkerboard of the map."""
        return _drawn(caption, look, checkers(result, surface.rotation, shapes.result()))

    def on_sphere(side: str) -> Image.Image:
        """The sphere from the side the surface is shown from, or from behind."""
        turn = np.diag([1.0, 1.0, 1.0] if side == "front" else [-1.0, 1.0, -1.0])
        round_ones = shapes.result().copy()
        round_ones[:, :3] = image
        look = Seen(view(image, mesh.faces, turn @ surface.rotation), round_ones)
        return board(f"the same checkerboard on the sphere, {side}", look)

    caption = "the surface, with a checkerboard of the map (squares double with the scale)"
    flat = [] if closed else [pool.submit(_map, result, Seen(view(image, mesh.faces, _upright(mesh, image))))]
    curves = [pool.submit(_descent, iterations)] if iterations else []
    last = pool.submit(_histogram, result)
    first = shaded(partial(board, caption))
    sides = [pool.submit(on_sphere, side) for side in ("front", "back")] if closed else []
    maps = [shaded(partial(_angles, result)), shaded(partial(_areas, result))]
    return [first, *flat, *sides, *maps, last, *curves]


def drawn_beside(columns: Sequence[tuple[str, Parameterization | None, str]], limit: float) -> Image.Image:
    """Maps of one surface beside each other: a checkerboard of each, and below where its angles err, in the same colours.

    columns: a caption, the map, and why there is none; limit: the error in degrees that the last colour stands for.
    """
    pairs = [
        (panel(caption), panel(f"no map: {problem}")) if result is None else _two_panels(caption, result, limit)
        for caption, result, problem in columns
    ]
    return in_rows([pair[row] for row in range(2) for pair in pairs], len(pairs)).reduce(3)


def _two_panels(caption: str, result: Parameterization, limit: float) -> tuple[Image.Image, Image.Image]:
    mesh = result.mesh
    surface = view(mesh.vertices, mesh.faces, view_rotation(mesh.vertices, mesh.faces))
    look = Seen(surface, map_shapes(result, surface))
    return (
        _drawn(caption, look, checkers(result, surface.rotation, map_shapes(result, surface))),
        _angles(result, look, limit, f"mean |angle error| {result.quality.angle_mean_deg:.4f} degrees"),
    )


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
        panels = [one.result() for one in _panels(result, pool)]
    mark = "" if result.quality.folds == 0 else f"  -  FOLDED: {result.quality.folds} faces"
    return sheet(f"{result.mesh.name}{mark}", panels, colour=RED if mark else INK)
