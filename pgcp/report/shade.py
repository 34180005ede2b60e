"""Colours of a surface: a checkerboard of its map, and its normals."""

from __future__ import annotations

import math

import numba
import numpy as np

from pgcp.types import FloatArray, IntArray


@numba.njit(cache=True, nogil=True)
def _cross(points: FloatArray, a: int, b: int, c: int, per_unit: float) -> tuple[float, float, float]:
    """Normal of a face, as long as twice its area, once points are multiplied by ``per_unit``."""
    ux, uy = (points[b, 0] - points[a, 0]) * per_unit, (points[b, 1] - points[a, 1]) * per_unit
    vx, vy = (points[c, 0] - points[a, 0]) * per_unit, (points[c, 1] - points[a, 1]) * per_unit
    if points.shape[1] < 3:
        return 0.0, 0.0, ux * vy - uy * vx
    uz, vz = (points[b, 2] - points[a, 2]) * per_unit, (points[c, 2] - points[a, 2]) * per_unit
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@numba.njit(cache=True, nogil=True, error_model="numpy")
def vertex_shapes(vertices: FloatArray, faces: IntArray, image: FloatArray, units: tuple[float, float]) -> np.ndarray:
    """Unit normal of the surface, 0 where there is none, and log2 of the map's length scale, at every vertex (V, 5), single.

    From the faces around it. vertices (V, 3) and image (V, 2) or (V, 3), each in a unit of its own. The last column is spare.
    """
    shapes, tiny = np.zeros((vertices.shape[0], 5), np.float32), np.float32(1e-37)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        x, y, z = _cross(vertices, a, b, c, 1.0 / units[0])
        p, q, r = _cross(image, a, b, c, 1.0 / units[1])
        surface, mapped = np.sqrt(x * x + y * y + z * z), np.sqrt(p * p + q * q + r * r)
        for v in (a, b, c):
            shapes[v, 0] += np.float32(x)
            shapes[v, 1] += np.float32(y)
            shapes[v, 2] += np.float32(z)
            shapes[v, 3] += np.float32(surface)
            shapes[v, 4] += np.float32(mapped)
    for v in range(vertices.shape[0]):
        x, y, z = np.float64(shapes[v, 0]), np.float64(shapes[v, 1]), np.float64(shapes[v, 2])
        length = max(np.sqrt(x * x + y * y + z * z), np.float64(tiny))
        shapes[v, 0], shapes[v, 1], shapes[v, 2] = x / length, y / length, z / length
        shapes[v, 3] = np.float32(0.5) * np.log2(max(shapes[v, 4], tiny) / max(shapes[v, 3], tiny))
    return shapes


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _is_dark(u: float, v: float, log_scale: float) -> bool:
    """Whether a place on the map lies in a dark square; squares double where the map's scale (log2) does."""
    size = math.ldexp(1.0, int(np.floor(log_scale)))
    half = 0.5 * (np.floor(u / size) + np.floor(v / size))
    return half == np.floor(half)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _mercator(x: float, y: float, z: float, log_scale: float) -> tuple[float, float, float]:
    """A place on the sphere and log2 of the scale there to u, v and log2 of the scale, by the conformal Mercator map.

    Longitude and log of the stereographic radius, in turns, so that squares of 1/2, 1/4, ... of a turn fit around.
    """
    across = max(np.hypot(x, y), 1e-300)
    turn = 2.0 * np.pi
    return np.arctan2(y, x) / turn, np.arcsinh(z / across) / turn, min(log_scale - np.log2(across * turn), -1.0)


@numba.njit(cache=True, nogil=True)
def checkered(
    face_ids: IntArray,
    weights: FloatArray,
    faces: IntArray,
    image: FloatArray,
    shapes: np.ndarray,
    light: FloatArray,
    log_size: float,
    on_sphere: bool,
) -> np.ndarray:
    """Colours (m, 3) of a checkerboard of the map at places on faces, lit from ``light`` (3,).

    image (V, 2), or (V, 3) ``on_sphere``, shapes (V, 5) of the vertices; squares are 2^log_size of the surface's units.
    """
    dark, bright = (0.16, 0.32, 0.55), (0.98, 0.93, 0.82)
    colours = np.empty((len(face_ids), 3), np.float32)
    for k in range(len(face_ids)):
        f = face_ids[k]
        x = y = z = facing = 0.0
        log_scale = log_size
        for i in range(3):
            v, weight = faces[f, i], weights[k, i]
            x += weight * image[v, 0]
            y += weight * image[v, 1]
            if on_sphere:
                z += weight * image[v, 2]
            facing += weight * abs(light[0] * shapes[v, 0] + light[1] * shapes[v, 1] + light[2] * shapes[v, 2])
            log_scale += weight * shapes[v, 3]
        if on_sphere:
            x, y, log_scale = _mercator(x, y, z, log_scale)
        colour = dark if _is_dark(x, y, log_scale) else bright
        for d in range(3):
            colours[k, d] = colour[d] * (0.45 + 0.6 * facing)
    return colours


@numba.njit(cache=True, nogil=True)
def by_normals(
    face_ids: IntArray, weights: FloatArray, faces: IntArray, shapes: np.ndarray, rotation: FloatArray
) -> np.ndarray:
    """The surface's normals, turned, as colours (m, 3) at places on faces."""
    colours = np.empty((len(face_ids), 3), np.float32)
    for k in range(len(face_ids)):
        f = face_ids[k]
        x = y = z = 0.0
        for i in range(3):
            v, weight = faces[f, i], weights[k, i]
            x += weight * shapes[v, 0]
            y += weight * shapes[v, 1]
            z += weight * shapes[v, 2]
        for d in range(3):
            colours[k, d] = 0.5 + 0.5 * (rotation[d, 0] * x + rotation[d, 1] * y + rotation[d, 2] * z)
    return colours
