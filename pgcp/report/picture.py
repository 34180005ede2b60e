"""One picture of a finished map: the surface with a checkerboard, the map, the histogram of angle errors."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from pgcp.distortion import angle_errors, as_points
from pgcp.operators import face_areas
from pgcp.report.raster import rasterise
from pgcp.types import FloatArray, IntArray, Parameterization

_CHECKS = 48


def _view_rotation(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Rotation (3, 3) to the flattest view, from the side most faces look to, z (or y) upright.

    Rows: to the right, up, towards the eye.
    """
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a).sum(axis=0)
    sample = vertices[faces[:: max(1, len(faces) // 50_000), 0]]
    sample = sample - sample.mean(axis=0)
    _, axes = np.linalg.eigh(sample.T @ sample)
    towards = axes[:, 0] if normal @ axes[:, 0] >= 0 else -axes[:, 0]
    up = np.array([0.0, 0.0, 1.0]) if abs(towards[2]) < 0.7 else np.array([0.0, 1.0, 0.0])
    up = up - towards * (towards @ up)
    up = up / np.linalg.norm(up)
    return np.array([np.cross(up, towards), up, towards])


def _checker(values: FloatArray) -> FloatArray:
    """Colours (n, 3) from u, v, brightness and log2 of the local scale (n, 4); squares double where the scale does."""
    size = np.exp2(np.floor(values[:, 3]))
    dark = (np.floor(values[:, 0] / size) + np.floor(values[:, 1] / size)) % 2 == 0
    base = np.where(dark[:, None], np.array([0.16, 0.32, 0.55]), np.array([0.98, 0.93, 0.82]))
    return np.clip(base * values[:, 2:3], 0.0, 1.0)


def _normals(points: FloatArray, faces: IntArray) -> FloatArray:
    """Unit normals (V, 3) of the vertices; 0 where there is none."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    smooth = np.column_stack([np.bincount(faces.reshape(-1), np.repeat(normals[:, k], 3), len(points)) for k in range(3)])
    length = np.linalg.norm(smooth, axis=1)
    length[length == 0] = 1.0
    return smooth / length[:, None]


def _vertex_scale(result: Parameterization) -> FloatArray:
    """Length scale of the map at every vertex (V,), from the areas of the faces around it."""
    mesh = result.mesh
    ids = mesh.faces.reshape(-1)
    surface, image = (
        np.bincount(ids, np.repeat(face_areas(points, mesh.faces), 3), len(mesh.vertices))
        for points in (mesh.vertices, as_points(result.coordinates))
    )
    return np.sqrt(np.maximum(image, 1e-300) / np.maximum(surface, 1e-300))


def _mercator(values: FloatArray) -> FloatArray:
    """Columns x, y, z, brightness, log2 scale (n, 5) to those of ``_checker``, by the conformal Mercator map.

    Longitude and log of the stereographic radius, in turns, so that squares of 1/2, 1/4, ... of a turn fit around.
    """
    x, y, z = values[:, 0], values[:, 1], values[:, 2]
    across = np.maximum(np.hypot(x, y), 1e-300)
    turns = np.arctan2(y, x) / (2.0 * np.pi)
    height = np.arcsinh(z / across) / (2.0 * np.pi)
    log_scale = values[:, 4] - np.log2(across * 2.0 * np.pi)
    return np.column_stack([turns, height, values[:, 3], np.minimum(log_scale, -1.0)])


def _draw_surface(axes: Any, result: Parameterization) -> None:
    mesh = result.mesh
    rotation = _view_rotation(mesh.vertices, mesh.faces)
    points = mesh.vertices @ rotation.T
    extent = np.linalg.norm(np.ptp(points[mesh.faces.reshape(-1)], axis=0)[:2])
    log_scale = np.log2(_vertex_scale(result) * extent / _CHECKS)
    brightness = 0.45 + 0.6 * np.abs(_normals(points, mesh.faces) @ [0.3, 0.4, 0.87])
    values = np.column_stack([result.coordinates, brightness, log_scale])
    to_checks = _mercator if result.target == "sphere" else np.asarray

    def paint(face_ids: IntArray, weights: FloatArray) -> FloatArray:
        """Checkerboard of the map."""
        return _checker(to_checks(np.einsum("mk,mkd->md", weights, values[mesh.faces[face_ids]])))

    axes.imshow(rasterise(points, mesh.faces, paint), interpolation="antialiased")
    axes.set_axis_off()
    axes.set_title("the surface, with a checkerboard of the map (squares double with the scale)", fontsize=8)


def _draw_map(axes: Any, result: Parameterization) -> None:
    from matplotlib.colors import hsv_to_rgb

    mesh, uv = result.mesh, result.coordinates
    count = int(result.patch.max()) + 1
    rng = np.random.default_rng(1)
    hues = np.column_stack([rng.permutation(count) / count, np.full(count, 0.45), 0.75 + 0.25 * rng.random(count)])
    palette = hsv_to_rgb(hues)

    def paint(face_ids: IntArray, _weights: FloatArray) -> FloatArray:
        """Colour of the patch."""
        return palette[result.patch[face_ids]]

    axes.imshow(rasterise(as_points(uv), mesh.faces, paint), interpolation="antialiased")
    axes.set_axis_off()
    width, height = np.ptp(uv, axis=0)
    axes.set_title(f"the map, {count} patch{'es' if count > 1 else ''}, {width:.4g} x {height:.4g}", fontsize=9)


def _draw_sphere(front: Any, back: Any, result: Parameterization) -> None:
    """The sphere from the side the surface is shown from, and from behind, the surface's normals as colours."""
    mesh = result.mesh
    rotation = _view_rotation(mesh.vertices, mesh.faces)
    colours = np.clip(0.5 + 0.5 * _normals(mesh.vertices @ rotation.T, mesh.faces), 0.0, 1.0)

    def paint(face_ids: IntArray, weights: FloatArray) -> FloatArray:
        """Normal of the surface."""
        return np.einsum("mk,mkd->md", weights, colours[mesh.faces[face_ids]])

    for axes, sides, title in ((front, [1, 1, 1], "front"), (back, [-1, 1, -1], "back")):
        axes.imshow(rasterise(result.coordinates @ rotation.T * sides, mesh.faces, paint), interpolation="antialiased")
        axes.set_axis_off()
        axes.set_title(f"the sphere, {title}: colours are the surface's normals", fontsize=8)


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


def _draw_descent(axes: Any, iterations: list[dict[str, Any]]) -> None:
    """Conformal energy, and the norm of its gradient, by iteration."""
    energies = [step["energy"] for step in iterations]
    axes.plot(energies, color="#29528c", marker=".", label="conformal energy")
    axes.set_xlabel("iteration", fontsize=8)
    axes.tick_params(labelsize=7)
    other = axes.twinx()
    other.semilogy([max(step["gradient_norm"], 1e-300) for step in iterations], color="#b5442c", linewidth=1)
    other.tick_params(labelsize=7)
    axes.set_title(f"conformal energy (blue) {energies[-1]:.6g}, gradient's norm (red)", fontsize=9)


def draw(result: Parameterization) -> bytes:
    """PNG bytes of the picture."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    on_sphere = result.target == "sphere"
    iterations = result.report.get("iterations", [])
    count = 4 if on_sphere or iterations else 3
    figure = Figure(figsize=(5 * count, 5.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    first, *maps, last = figure.subplots(1, count)
    _draw_surface(first, result)
    if on_sphere:
        _draw_sphere(maps[0], maps[1], result)
    else:
        _draw_map(maps[0], result)
    if iterations:
        _draw_descent(maps[1], iterations)
    _draw_histogram(last, result)
    mark = "" if result.quality.folds == 0 else f"  -  FOLDED: {result.quality.folds} faces"
    figure.suptitle(f"{result.mesh.name}{mark}", fontsize=11, color="black" if not mark else "#b5442c")
    out = io.BytesIO()
    figure.savefig(out, format="png", metadata={"Software": None})
    return out.getvalue()
