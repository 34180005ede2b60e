"""Points along the boundary curve of a surface, evenly by length, with its corners kept: on the surface and in the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgcp.types import FloatArray, IntArray

CORNER_DEG = 50.0  # a boundary that turns by more is at a corner


@dataclass(frozen=True, slots=True, eq=False)
class Rim:
    """A closed boundary curve: its vertices on the surface (B, 3) and in the map (B, 2), counter-clockwise there."""

    points: FloatArray
    image: FloatArray

    @property
    def ends(self) -> FloatArray:
        """Length along the curve (B + 1,) up to each vertex, and all of it."""
        steps = np.linalg.norm(np.roll(self.points, -1, axis=0) - self.points, axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])

    def at(self, lengths: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places at lengths (n,) along the curve: on the surface (n, 3) and in the map (n, 2)."""
        ends = self.ends
        closed = [np.vstack([values, values[:1]]) for values in (self.points, self.image)]
        around = np.mod(lengths, ends[-1])
        surface, image = (np.column_stack([np.interp(around, ends, column) for column in values.T]) for values in closed)
        return surface, image

    def corners(self, spacing: float, least_deg: float = CORNER_DEG) -> IntArray:
        """Vertices at which the curve turns by more than ``least_deg``, looked at on a length of ``spacing`` to either side.

        What is finer than that is no corner. Of several within ``spacing`` the sharpest is one.
        """
        ends, total = self.ends, float(self.ends[-1])
        reach = min(spacing, total / 8.0)
        before, after = (self.at(ends[:-1] + side * reach)[0] for side in (-1.0, 1.0))
        one, two = self.points - before, after - self.points
        sizes = np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1)
        turn = np.degrees(np.arccos(np.clip(np.einsum("nk,nk->n", one, two) / np.maximum(sizes, 1e-300), -1.0, 1.0)))
        taken: list[int] = []
        for vertex in np.argsort(-turn, kind="stable").tolist():
            if turn[vertex] <= least_deg:
                break
            apart = np.abs(ends[taken] - ends[vertex])
            if not (np.minimum(apart, total - apart) < reach).any():
                taken.append(vertex)
        return np.sort(np.array(taken, np.int64))

    def spaced(self, spacing: float) -> FloatArray:
        """Lengths (n,) along the curve of its corners and of points between them, about ``spacing`` apart; three at least."""
        ends, total = self.ends, float(self.ends[-1])
        starts = ends[self.corners(spacing)]
        return _between(starts if len(starts) else np.zeros(1), total, spacing)


def _between(starts: FloatArray, total: float, spacing: float) -> FloatArray:
    """Numbers (n,) from each start to the next, evenly and about ``spacing`` apart, around a circle of length ``total``."""
    stops = np.append(starts[1:], starts[0] + total)
    counts = np.maximum(np.rint((stops - starts) / spacing).astype(int), 1 if len(starts) >= 3 else 4 - len(starts))
    parts = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(starts, stops, counts.tolist(), strict=True)]
    return np.concatenate(parts)
