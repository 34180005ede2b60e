"""One picture of a finished map: the surface with a checkerboard, the map by patch, the histogram of angle errors."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from pgcp.operators import face_areas
from pgcp.quality import angle_errors
from pgcp.types import FloatArray, IntArray, Parameterization

_PIXELS = 800
_CHECKS = 48
_EDGE_FACES = 20_000


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


def _rasterise(points: FloatArray, faces: IntArray, values: FloatArray) -> FloatArray:
    """Image (n, n, 3) of faces with colours interpolated from corners: a depth-buffered point splat of subdivided faces."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    scale = (_PIXELS - 20) / (high - low).max()
    shift = 0.5 * (_PIXELS - (high - low) * scale)
    screen = (points[:, :2] - low) * scale + shift
    corners = screen[faces]
    extent = np.abs(corners - np.roll(corners, 1, axis=1)).max(axis=(1, 2))
    image = np.ones((_PIXELS, _PIXELS, 3))
    depth = np.full(_PIXELS * _PIXELS, -np.inf)
    flat = image.reshape(-1, 3)
    divisions = np.ceil(1.5 * extent).astype(int) + 1
    for n in np.unique(divisions):
        chosen = np.flatnonzero(divisions == n)
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        keep = i + j <= n
        weights = np.column_stack([i[keep], j[keep], n - i[keep] - j[keep]]) / n
        step = max(1, 2_000_000 // len(weights))
        for start in range(0, len(chosen), step):
            part = faces[chosen[start : start + step]]
            place = np.einsum("wk,fkd->fwd", weights, screen[part]).reshape(-1, 2)
            z = (points[part][:, :, 2] @ weights.T).reshape(-1)
            colour = np.einsum("wk,fkd->fwd", weights, values[part]).reshape(-1, values.shape[1])
            x, y = np.rint(place).astype(int).T
            pixel = np.clip(_PIXELS - 1 - y, 0, _PIXELS - 1) * _PIXELS + np.clip(x, 0, _PIXELS - 1)
            order = np.lexsort((z, pixel))
            last = order[np.flatnonzero(np.diff(pixel[order], append=-1))]
            front = last[z[last] > depth[pixel[last]]]
            depth[pixel[front]] = z[front]
            flat[pixel[front]] = _checker(colour[front])
    return image


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
    axes.imshow(_rasterise(points, mesh.faces, values), interpolation="antialiased")
    axes.set_axis_off()
    axes.set_title("the surface, with a checkerboard of the map (squares double with the scale)", fontsize=8)


def _draw_map(axes: Any, result: Parameterization) -> None:
    from matplotlib.colors import ListedColormap, hsv_to_rgb

    mesh, uv = result.mesh, result.coordinates
    count = int(result.patch.max()) + 1
    rng = np.random.default_rng(1)
    hues = np.column_stack([rng.permutation(count) / count, np.full(count, 0.45), 0.75 + 0.25 * rng.random(count)])
    step = max(1, len(mesh.faces) // 400_000)
    axes.tripcolor(
        uv[:, 0],
        uv[:, 1],
        mesh.faces[::step],
        facecolors=result.patch[::step].astype(float),
        cmap=ListedColormap(hsv_to_rgb(hues)),
        vmin=-0.5,
        vmax=count - 0.5,
        edgecolors="k" if len(mesh.faces) <= _EDGE_FACES else "none",
        linewidth=0.05,
        rasterized=True,
    )
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)
    axes.set_title(f"the map, {count} patch{'es' if count > 1 else ''}", fontsize=9)


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
