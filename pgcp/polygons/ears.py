"""Ears clipped from many polygons of one size at once (Meisters 1975; ElGindy, Everett, Toussaint 1993)."""

from __future__ import annotations

import numpy as np

from pgcp.types import BoolArray, FloatArray, IntArray

_LEAST = 1e-13  # twice the area of a triangle that has any, where polygons have about unit size


def clip_ears(points: FloatArray) -> tuple[IntArray, BoolArray]:
    """Triangles (K, n - 2, 3) of counter-clockwise polygons (K, n, 2), by numbers of their corners.

    The ear with the shortest diagonal goes first. An ear is a convex corner whose triangle holds no corner that is not convex,
    at any other place than its own three. Where there is none, a corner without area goes. The second value (K,) is
    false where there was neither: the polygon crosses itself.
    """
    state = _Polygons(points)
    count, size = points.shape[:2]
    out = np.empty((count, size - 2, 3), np.int64)
    good = np.ones(count, bool)
    for step in range(size - 3):
        out[:, step], fits = state.clip()
        good &= fits
    out[:, -1] = np.nonzero(state.is_left)[1].reshape(count, 3)
    a, b, c = (points[np.arange(count), out[:, -1, i]] for i in range(3))
    good &= _areas(a, b, c) > -_LEAST
    return np.take_along_axis(out, (out.argmin(axis=2)[:, :, None] + np.arange(3)) % 3, 2), good


def _areas(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Twice the signed areas of triangles."""
    u, v = b - a, c - a
    return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])


class _Polygons:
    """Polygons (K, n, 2) on their way to triangles: who is next to whom, and which corners are ears."""

    def __init__(self, points: FloatArray) -> None:
        count, size = points.shape[:2]
        self._points, self._rows = points, np.arange(count)
        self._before = np.tile(np.roll(np.arange(size), 1), (count, 1))
        self._after = np.tile(np.roll(np.arange(size), -1), (count, 1))
        self.is_left: BoolArray = np.ones((count, size), bool)
        self._area: FloatArray = np.empty((count, size))
        self._is_ear: BoolArray = np.zeros((count, size), bool)
        self._diagonal = np.empty((count, size))
        self._look_at_all()

    def clip(self) -> tuple[IntArray, BoolArray]:
        """Cut one corner off every polygon; returns the triangles (K, 3), and where there was a corner that could go."""
        rows = self._rows
        if not self._is_ear.any(axis=1).all():
            self._look_at_all()
        has_ear = self._is_ear.any(axis=1)
        flat: BoolArray = np.where(self.is_left, np.abs(self._area), np.inf) <= _LEAST
        cost = np.where(self._is_ear, self._diagonal, np.inf)
        spare = np.where(flat, -self._diagonal, np.where(self.is_left, 1e9 - self._area, np.inf))
        best = np.where(np.expand_dims(has_ear, 1), cost, spare).argmin(axis=1)
        a, b = self._before[rows, best], self._after[rows, best]
        self.is_left[rows, best] = self._is_ear[rows, best] = False
        self._after[rows, a], self._before[rows, b] = b, a
        for i in (a, b):
            self._area[rows, i] = self._corner_areas(i)
        for i in (a, b):
            self._look(i)
        return np.stack([a, best, b], axis=1), np.logical_or(has_ear, flat.any(axis=1))

    def _corner_areas(self, i: IntArray) -> FloatArray:
        rows, points = self._rows, self._points
        return _areas(points[rows, self._before[rows, i]], points[rows, i], points[rows, self._after[rows, i]])

    def _look_at_all(self) -> None:
        for i in range(self._points.shape[1]):
            self._area[:, i] = self._corner_areas(np.full(len(self._rows), i))
        for i in range(self._points.shape[1]):
            self._look(np.full(len(self._rows), i))

    def _look(self, i: IntArray) -> None:
        """See whether a corner (K,) of each polygon is an ear."""
        rows, points = self._rows, self._points
        a, b, c = (points[rows, j][:, None] for j in (self._before[rows, i], i, self._after[rows, i]))
        own = (points == a).all(axis=2) | (points == b).all(axis=2) | (points == c).all(axis=2)
        inside = self.is_left & ~own & (self._area <= _LEAST)
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= _areas(p, q, points) >= -_LEAST
        self._is_ear[rows, i] = self.is_left[rows, i] & (self._area[rows, i] > _LEAST) & ~inside.any(axis=1)
        self._diagonal[rows, i] = ((c - a) ** 2).sum(axis=2)[:, 0]
