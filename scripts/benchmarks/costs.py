"""Seconds of small parts of the computation, by themselves: what grows fastest is too small to see in a measured run."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from pgcp.parallel import limited_to
from pgcp.plane.natural import natural_boundary
from pgcp.plane.zipper import close_arcs, open_arc


def seconds_of(function: Callable[..., Any], *arguments: Any) -> float:
    """Seconds of a call on one BLAS thread, the lesser of two after one that may compile."""
    taken = []
    with threadpool_limits(1), limited_to(1):
        for _ in range(3):
            start = time.perf_counter()
            function(*arguments)
            taken.append(time.perf_counter() - start)
    return min(taken[1:])


def zipper_seconds(seam: int = 400, others: int = 50_000) -> float:
    """Seconds for opening and closing an arc, by its points and by the other points that move along."""
    arc = np.exp(1j * np.pi * np.arange(seam + 1) / seam)
    rest = np.exp(1j * np.pi * (1 + (0.5 + np.arange(others)) / others))
    gaps, moved, _ = open_arc(arc, rest, 1.0)
    both = seconds_of(open_arc, arc, rest, 1.0) + seconds_of(close_arcs, gaps, gaps, moved)
    alone = seconds_of(open_arc, arc, rest[:1], 1.0) + seconds_of(close_arcs, gaps, gaps, moved[:1])
    return max(both - alone, 0.0) / (seam * others)


def cycle_seconds(side: int = 24, steps: int = 16) -> float:
    """Seconds of the natural boundary by the square of the cycles and the nodes: of a square of side x side cells.

    The walls between its cells are cut into ``steps``; what its boundary costs is small beside them.
    """
    many = side * steps
    x, y = np.meshgrid(np.arange(many + 1), np.arange(many + 1), indexing="ij")
    on_wall = (x % steps == 0) | (y % steps == 0)
    number = np.where(on_wall, np.cumsum(on_wall).reshape(x.shape) - 1, -1)
    ends = (number[:-1, ::steps], number[1:, ::steps]), (number[::steps, :-1], number[::steps, 1:])
    edges = np.concatenate([np.column_stack([one.ravel(), other.ravel()]) for one, other in ends])
    loop = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    z = (x + 1j * y)[on_wall] / many
    arguments = z, edges, np.ones(len(edges)), loop, np.arange(0, len(loop), steps)
    return seconds_of(natural_boundary, *arguments) / (side**4 * len(z))
