"""One picture of a finished map: the surface with a checkerboard, the map by patch, the histogram of angle errors."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from pgcp.operators import face_areas
from pgcp.distortion import angle_errors
from pgcp.types import FloatArray, IntArray, Parameterization

_PIXELS = 800
_CHECKS = 48
Paint = Callable[[IntArray, FloatArray], FloatArray]


def _view(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Rotate to the flattest view, from the side most faces look to, z (or y) upright; x right, y up, z to the eye."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a).sum(axis=0)
    centred = vertices - vertices[faces.reshape(-1)].mean(axis=0)
    sample = centred[faces[:: max(1, len(faces) // 50_000), 0]]
    _, axes = np.linalg.eigh(sample.T @ sample)
    towards = axes[:, 0] if normal @ axes[:, 0] >= 0 else -axes[:, 0]
    up = np.array([0.0, 0.0, 1.0]) if abs(towards[2]) < 0.7 else np.array([0.0, 1.0, 0.0])
    up = up - towards * (towards @ up)
    up = up / np.linalg.norm(up)
    return centred @ np.array([np.cross(up, towards), up, towards]).T


@numba.njit(cache=True)
def _visible(screen: FloatArray, faces: IntArray, size: int) -> tuple[IntArray, FloatArray]:
    """Face seen in each pixel (size, size), -1 for none, and its barycentric weights there (size, size, 3).

    screen (V, 3): pixel column, pixel row upwards, height towards the eye. Faces smaller than a pixel show at their centre.
    """
    seen = np.full((size, size), -1, np.int64)
    weights = np.zeros((size, size, 3))
    height = np.full((size, size), -np.inf)
    for f in range(faces.shape[0]):
        a, b, c = screen[faces[f, 0]], screen[faces[f, 1]], screen[faces[f, 2]]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        x0, x1 = int(np.ceil(min(a[0], b[0], c[0]))), int(np.floor(max(a[0], b[0], c[0])))
        y0, y1 = int(np.ceil(min(a[1], b[1], c[1]))), int(np.floor(max(a[1], b[1], c[1])))
        if x1 - x0 <= 1 and y1 - y0 <= 1:
            x, y = int(np.rint((a[0] + b[0] + c[0]) / 3.0)), int(np.rint((a[1] + b[1] + c[1]) / 3.0))
            z = (a[2] + b[2] + c[2]) / 3.0
            if z > height[y, x]:
                seen[y, x], height[y, x] = f, z
                weights[y, x, :] = 1.0 / 3.0
        if area == 0.0:
            continue
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                u = ((b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)) / area
                v = ((c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)) / area
                w = 1.0 - u - v
                if min(u, v, w) < -1e-9:
                    continue
                z = u * a[2] + v * b[2] + w * c[2]
                if z > height[y, x]:
                    seen[y, x], height[y, x] = f, z
                    weights[y, x, 0], weights[y, x, 1], weights[y, x, 2] = u, v, w
    return seen, weights


def _rasterise(points: FloatArray, faces: IntArray, paint: Paint) -> FloatArray:
    """Image (n, n, 3) of faces seen along -z; paint(face_ids (m,), weights (m, 3)) gives the colours (m, 3) of pixels."""
    mark = np.zeros(len(points), bool)
    mark[faces.reshape(-1)] = True
    used = points[mark, :2]
    low, high = used.min(axis=0), used.max(axis=0)
    scale = (_PIXELS - 20) / (high - low).max()
    screen = points.copy()
    screen[:, :2] = (points[:, :2] - low) * scale + 0.5 * (_PIXELS - (high - low) * scale)
    seen, weights = _visible(screen, np.asarray(faces, np.int64), _PIXELS)
    image = np.ones((_PIXELS, _PIXELS, 3))
    shown = seen >= 0
    image[shown] = paint(seen[shown], weights[shown])
    return image[::-1]


def _checker(values: FloatArray) -> FloatArray:
    """Colours (n, 3) from u, v, brightness and log2 of the local scale (n, 4); squares double where the scale does."""
    size = np.exp2(np.floor(values[:, 3]))
    dark = (np.floor(values[:, 0] / size) + np.floor(values[:, 1] / size)) % 2 == 0
    base = np.where(dark[:, None], np.array([0.16, 0.32, 0.55]), np.array([0.98, 0.93, 0.82]))
    return np.clip(base * values[:, 2:3], 0.0, 1.0)


def _brightness(points: FloatArray, faces: IntArray) -> FloatArray:
    a, b, c = (points[faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    smooth = np.column_stack([np.bincount(faces.reshape(-1), np.repeat(normals[:, k], 3), len(points)) for k in range(3)])
    length = np.linalg.norm(smooth, axis=1)
    length[length == 0] = 1.0
    light = np.array([0.3, 0.4, 0.87])
    return 0.45 + 0.6 * np.abs(smooth @ light / length)


def _vertex_scale(result: Parameterization) -> FloatArray:
    """Length scale of the map at every vertex (V,), from the areas of the faces around it."""
    mesh = result.mesh
    flat = np.column_stack([result.coordinates, np.zeros(len(result.coordinates))])
    ids = mesh.faces.reshape(-1)
    surface, image = (
        np.bincount(ids, np.repeat(face_areas(points, mesh.faces), 3), len(mesh.vertices)) for points in (mesh.vertices, flat)
    )
    return np.sqrt(np.maximum(image, 1e-300) / np.maximum(surface, 1e-300))


def _draw_surface(axes: Any, result: Parameterization) -> None:
    mesh = result.mesh
    points = _view(mesh.vertices, mesh.faces)
    extent = np.linalg.norm(np.ptp(points, axis=0)[:2])
    log_scale = np.log2(_vertex_scale(result) * extent / _CHECKS)
    values = np.column_stack([result.coordinates, _brightness(points, mesh.faces), log_scale])

    def paint(face_ids: IntArray, weights: FloatArray) -> FloatArray:
        """Checkerboard of the map."""
        return _checker(np.einsum("mk,mkd->md", weights, values[mesh.faces[face_ids]]))

    axes.imshow(_rasterise(points, mesh.faces, paint), interpolation="antialiased")
    axes.set_axis_off()
    axes.set_title("the surface, with a checkerboard of the map (squares double with the scale)", fontsize=8)


def _draw_map(axes: Any, result: Parameterization) -> None:
    from matplotlib.colors import hsv_to_rgb

    mesh, uv = result.mesh, result.coordinates
    count = int(result.patch.max()) + 1
    rng = np.random.default_rng(1)
    hues = np.column_stack([rng.permutation(count) / count, np.full(count, 0.45), 0.75 + 0.25 * rng.random(count)])
    palette = hsv_to_rgb(hues)
    flat = np.column_stack([uv, np.zeros(len(uv))])

    def paint(face_ids: IntArray, _weights: FloatArray) -> FloatArray:
        """Colour of the patch."""
        return palette[result.patch[face_ids]]

    axes.imshow(_rasterise(flat, mesh.faces, paint), interpolation="antialiased")
    axes.set_axis_off()
    width, height = np.ptp(uv, axis=0)
    axes.set_title(f"the map, {count} patch{'es' if count > 1 else ''}, {width:.4g} x {height:.4g}", fontsize=9)


def _draw_histogram(axes: Any, result: Parameterization) -> None:
    errors = angle_errors(result.mesh, result.coordinates).reshape(-1)
    quality = result.quality
    limit = max(float(np.quantile(errors, 0.995)), 1e-12)
    axes.hist(errors, bins=80, range=(0.0, limit), color="#29528c")
    axes.axvline(quality.angle_mean_deg, color="#b5442c", linewidth=1)
    axes.set_xlabel("|angle error| (degrees)", fontsize=8)
    axes.set_ylabel("corners", fontsize=8)
    axes.tick_params(labelsize=7)
    text = f"mean {quality.angle_mean_deg:.3f}, sd {quality.angle_sd_deg:.3f}, 99 % {quality.angle_p99_deg:.2f}"
    axes.set_title(f"{text}; folds {quality.folds}", fontsize=9)


def draw(result: Parameterization) -> bytes:
    """PNG bytes of the picture."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 5.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    left, middle, right = figure.subplots(1, 3)
    _draw_surface(left, result)
    _draw_map(middle, result)
    _draw_histogram(right, result)
    mark = "" if result.quality.folds == 0 else f"  -  FOLDED: {result.quality.folds} faces"
    figure.suptitle(f"{result.mesh.name}{mark}", fontsize=11, color="black" if not mark else "#b5442c")
    out = io.BytesIO()
    figure.savefig(out, format="png", metadata={"Software": None})
    return out.getvalue()
