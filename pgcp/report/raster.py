"""Draw triangles into an image: which face each pixel shows, and colours by a function of face and place on it."""

from __future__ import annotations

from collections.abc import Callable

import numba
import numpy as np

from pgcp.types import FloatArray, IntArray

_PIXELS = 800
Paint = Callable[[IntArray, FloatArray], FloatArray]


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


def rasterise(points: FloatArray, faces: IntArray, paint: Paint) -> FloatArray:
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
