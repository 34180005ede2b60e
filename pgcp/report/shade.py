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
def _square(u: float, v: float, size: float) -> float:
    """1 in the dark squares of a checkerboard, 0 in the others."""
    half = 0.5 * (np.floor(u / size) + np.floor(v / size))
    return 1.0 if half == np.floor(half) else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _darkness(u: float, v: float, log_scale: float) -> float:
    """How dark a place on the map is, 0 to 1, on a checkerboard whose squares double where the map's scale (log2) does.

    Squares fade into those of twice their size over half of the way, so that no line is seen where they double.
    """
    level = np.floor(log_scale)
    share = min(max(2.0 * (log_scale - level) - 0.5, 0.0), 1.0)
    share *= share * (3.0 - 2.0 * share)
    size = math.ldexp(1.0, int(level))
    return (1.0 - share) * _square(u, v, size) + share * _square(u, v, 2.0 * size)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _mercator(x: float, y: float, z: float, log_scale: float) -> tuple[float, float, float]:
    """A place on the sphere and log2 of the scale there to u, v and log2 of the scale, by the conformal Mercator map.

    Longitude and log of the stereographic radius, in turns, so that squares of 1/2, 1/4, ... of a turn fit around.
    """
    across = max(np.hypot(x, y), 1e-300)
    turn = 2.0 * np.pi
    return np.arctan2(y, x) / turn, np.arcsinh(z / across) / turn, min(log_scale - np.log2(across * turn), -2.0)


@numba.njit(cache=True, nogil=True)
def lit(face_ids: IntArray, weights: FloatArray, faces: IntArray, shapes: np.ndarray, lights: FloatArray) -> np.ndarray:
    """Brightness and gloss (m, 2) at places on faces, from normals that change evenly over them; either side is lit alike.

    shapes (V, 5) of the vertices; lights (2, 3): unit vectors to the light and to the eye.
    """
    out = np.empty((len(face_ids), 2), np.float32)
    for k in range(len(face_ids)):
        f = face_ids[k]
        x = y = z = 0.0
        for i in range(3):
            v, weight = faces[f, i], weights[k, i]
            x += weight * shapes[v, 0]
            y += weight * shapes[v, 1]
            z += weight * shapes[v, 2]
        length = max(np.sqrt(x * x + y * y + z * z), 1e-30)
        towards = (x * lights[1, 0] + y * lights[1, 1] + z * lights[1, 2]) / length
        facing = (x * lights[0, 0] + y * lights[0, 1] + z * lights[0, 2]) / length
        if towards < 0.0:
            towards, facing = -towards, -facing
        middle = lights[0, 0] * lights[1, 0] + lights[0, 1] * lights[1, 1] + lights[0, 2] * lights[1, 2]
        half = max(facing + towards, 0.0) / np.sqrt(2.0 + 2.0 * middle)
        out[k, 0] = 0.42 + 0.48 * max(facing, 0.0) + 0.14 * towards
        out[k, 1] = 0.10 * half**24
    return out


@numba.njit(cache=True, nogil=True)
def checkered(
    face_ids: IntArray,
    weights: FloatArray,
    faces: IntArray,
    image: FloatArray,
    shapes: np.ndarray,
    log_size: float,
    on_sphere: bool,
) -> np.ndarray:
    """Darkness (m,), 0 to 1, of a checkerboard of the map at places on faces.

    image (V, 2), or (V, 3) ``on_sphere``, shapes (V, 5) of the vertices; squares are 2^log_size of the surface's units.
    """
    out = np.empty(len(face_ids), np.float32)
    for k in range(len(face_ids)):
        f = face_ids[k]
        x = y = z = 0.0
        log_scale = log_size
        for i in range(3):
            v, weight = faces[f, i], weights[k, i]
            x += weight * image[v, 0]
            y += weight * image[v, 1]
            if on_sphere:
                z += weight * image[v, 2]
            log_scale += weight * shapes[v, 3]
        if on_sphere:
            x, y, log_scale = _mercator(x, y, z, log_scale)
        out[k] = _darkness(x, y, log_scale)
    return out


def in_colours(values: np.ndarray, stops: tuple[tuple[float, float, float], ...]) -> np.ndarray:
    """Colours (m, 3) of values (m,) from 0 to 1, in between evenly spaced colours."""
    places, table = np.linspace(0.0, 1.0, len(stops)), np.array(stops)
    inside = np.clip(values, 0.0, 1.0)
    return np.stack([np.interp(inside, places, table[:, d]) for d in range(3)], axis=-1).astype(np.float32)
