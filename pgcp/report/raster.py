"""Draw triangles into an image: which face each pixel shows, and colours by a function of face and place on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np

from pgcp.types import FloatArray, IntArray

PIXELS = 1000  # twice those of the picture, in which four become one
_RIM = 1  # of a texture: pixels are not drawn well before the first
_MARGIN = 12.0 / (PIXELS - 1)  # of an image, at each side
Paint = Callable[[IntArray, FloatArray], np.ndarray]


@numba.njit(cache=True, nogil=True)
def _box(points: FloatArray, faces: IntArray, rotation: FloatArray) -> FloatArray:
    """Least and greatest coordinates (2, 3) of the turned points that faces use."""
    used = np.zeros(points.shape[0], np.bool_)
    for f in range(faces.shape[0]):
        used[faces[f, 0]] = used[faces[f, 1]] = used[faces[f, 2]] = True
    box = np.empty((2, 3))
    box[0], box[1] = np.inf, -np.inf
    for v in range(points.shape[0]):
        if not used[v]:
            continue
        for row in range(3):
            x = 0.0
            for d in range(points.shape[1]):
                x += rotation[row, d] * points[v, d]
            box[0, row], box[1, row] = min(box[0, row], x), max(box[1, row], x)
    return box


@numba.njit(cache=True, nogil=True)
def _on_screen(points: FloatArray, rotation: FloatArray, low: FloatArray, scale: float, shift: FloatArray) -> np.ndarray:
    """Turned points in pixels (V, 3), less ``low``, times ``scale``, plus ``shift``: single precision is plenty."""
    out = np.empty((points.shape[0], 3), np.float32)
    for v in range(points.shape[0]):
        for row in range(3):
            x = -low[row]
            for d in range(points.shape[1]):
                x += rotation[row, d] * points[v, d]
            out[v, row] = x * scale + shift[row]
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _visible(screen: np.ndarray, faces: IntArray, size: int) -> IntArray:
    """Face seen in each pixel (size, size), -1 for none.

    screen (V, 3): pixel column, pixel row upwards, height towards the eye. Faces that fall between pixels show at their centre.
    """
    seen, height = np.full((size, size), -1, np.int32), np.full((size, size), np.float32(-np.inf))
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, az = np.float64(screen[a, 0]), np.float64(screen[a, 1]), np.float64(screen[a, 2])
        bx, by, bz = np.float64(screen[b, 0]), np.float64(screen[b, 1]), np.float64(screen[b, 2])
        cx, cy, cz = np.float64(screen[c, 0]), np.float64(screen[c, 1]), np.float64(screen[c, 2])
        # a pixel just at the lesser edge is that of the face before
        x0, x1 = max(int(min(ax, bx, cx)) + 1, 0), min(int(max(ax, bx, cx)), size - 1)
        y0, y1 = max(int(min(ay, by, cy)) + 1, 0), min(int(max(ay, by, cy)), size - 1)
        shown = x1 - x0 > 1 or y1 - y0 > 1
        if x0 <= x1 and y0 <= y1:
            per_area = 1.0 / ((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))
            for y in range(y0, y1 + 1):
                for x in range(x0, x1 + 1):
                    u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) * per_area
                    v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) * per_area
                    w = 1.0 - u - v
                    if u >= -1e-9 and v >= -1e-9 and w >= -1e-9:
                        shown = True
                        z = np.float32(u * az + v * bz + w * cz)
                        if z > height[y, x]:
                            seen[y, x], height[y, x] = f, z
        if not shown:
            x = min(max(int((ax + bx + cx) / 3.0 + 0.5), 0), size - 1)
            y = min(max(int((ay + by + cy) / 3.0 + 0.5), 0), size - 1)
            z = np.float32((az + bz + cz) / 3.0)
            if z > height[y, x]:
                seen[y, x], height[y, x] = f, z
    return seen


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _places(screen: np.ndarray, faces: IntArray, seen: IntArray) -> tuple[IntArray, FloatArray]:
    """Faces (m,) of all pixels that show one, row by row, and barycentric weights (m, 3) there: equal ones outside the face."""
    count = np.count_nonzero(seen >= 0)
    face_ids, weights = np.empty(count, np.int64), np.empty((count, 3))
    k = 0
    for y in range(seen.shape[0]):
        for x in range(seen.shape[1]):
            f = seen[y, x]
            if f < 0:
                continue
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            ax, ay = np.float64(screen[a, 0]), np.float64(screen[a, 1])
            bx, by = np.float64(screen[b, 0]), np.float64(screen[b, 1])
            cx, cy = np.float64(screen[c, 0]), np.float64(screen[c, 1])
            area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
            u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
            v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
            w = 1.0 - u - v
            face_ids[k] = f
            if u >= -1e-9 and v >= -1e-9 and w >= -1e-9:
                weights[k, 0], weights[k, 1], weights[k, 2] = u, v, w
            else:
                weights[k, :] = 1.0 / 3.0
            k += 1
    return face_ids, weights


@numba.njit(cache=True, nogil=True)
def _coloured(seen: IntArray, colours: np.ndarray) -> np.ndarray:
    """Bytes (size, size, 3), first row on top: colours (m, 3) from 0 to 1 of the pixels that show a face, white elsewhere."""
    size = seen.shape[0]
    image = np.full((size, size, 3), 255, np.uint8)
    k = 0
    for y in range(size):
        for x in range(size):
            if seen[y, x] >= 0:
                for d in range(3):
                    image[size - 1 - y, x, d] = np.uint8(255.0 * min(max(colours[k, d], 0.0), 1.0) + 0.5)
                k += 1
    return image


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Points (V, 2) or (V, 3) and faces as they are looked at, along -z once turned by ``rotation`` (3, 2) or (3, 3).

    box (2, 3): the least and greatest turned coordinates.
    """

    points: FloatArray
    faces: IntArray
    rotation: FloatArray
    box: FloatArray

    @property
    def extent(self) -> FloatArray:
        """Width and height (2,)."""
        return self.box[1, :2] - self.box[0, :2]


def texels(points: FloatArray, faces: IntArray, width: int, height: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Which texels of a texture faces cover: their rows, from the top, times ``width`` plus columns (m,), face (m,), weights.

    points (T, 2): texture coordinates, v upwards; weights (m, 3): barycentric, of the texel's middle. A face that falls between
    the middles of texels has the one nearest to its own, with equal weights.
    """
    screen = np.zeros((len(points), 3), np.float32)
    screen[:, :2] = points * np.array([width, height]) + (_RIM - 0.5)
    seen = _visible(screen, faces, max(width, height) + 2 * _RIM)
    for beyond in (np.s_[:_RIM], np.s_[_RIM + height :], np.s_[:, :_RIM], np.s_[:, _RIM + width :]):
        seen[beyond] = -1
    row, column = np.nonzero(seen >= 0)
    return ((_RIM + height - 1 - row) * width + column - _RIM, *_places(screen, faces, seen))


def view(points: FloatArray, faces: IntArray, rotation: FloatArray | None = None) -> View:
    """A view of faces, unturned if nothing else is said."""
    if rotation is None:
        rotation = np.eye(3)[:, : points.shape[1]]
    return View(points, faces, np.ascontiguousarray(rotation), _box(points, faces, rotation))


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """What an image shows: face seen (pixels, pixels), -1 for none; face_ids (m,), weights (m, 3) of pixels that show one."""

    seen: IntArray
    face_ids: IntArray
    weights: FloatArray

    def painted(self, colours: np.ndarray) -> np.ndarray:
        """Image (pixels, pixels, 3) of bytes, with colours (m, 3), 0 to 1, of those pixels, white elsewhere."""
        return _coloured(self.seen, colours)


def shown(seen_from: View, pixels: int = PIXELS) -> Shown:
    """What is seen in so many pixels across."""
    low, extent, faces = seen_from.box[0], seen_from.extent, seen_from.faces
    scale = (pixels - 1) * (1 - 2 * _MARGIN) / max(float(extent.max()), 1e-300)
    shift = np.append(0.5 * (pixels - 1 - extent * scale), 0.0)
    screen = _on_screen(seen_from.points, seen_from.rotation, low, scale, shift)
    seen = _visible(screen, faces, pixels)
    return Shown(seen, *_places(screen, faces, seen))


def rasterise(seen_from: View, paint: Paint, pixels: int = PIXELS) -> np.ndarray:
    """Image (pixels, pixels, 3) of bytes; paint(face_ids (m,), weights (m, 3)) gives the colours (m, 3), 0 to 1, of pixels."""
    found = shown(seen_from, pixels)
    # a flat surface seen from its side shows nothing
    return found.painted(paint(found.face_ids, found.weights) if len(found.face_ids) else np.empty((0, 3)))
