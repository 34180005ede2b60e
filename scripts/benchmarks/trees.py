"""The tree of welds of a flat square in any number of patches."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import pgcp
from pgcp.patches.plan import plan_welds
from pgcp.patches.split import cut_patches, split_mesh
from pgcp.surface.topology import examine

PLANNED = 256  # parts of the tree that the package plans
_PART_VERTICES = 150

Step = tuple[int, int, int, float]  # left, right, result, length of the seam


@dataclass(frozen=True, slots=True)
class Tree:
    """Welds in an order in which they can be done. Lengths are in mean perimeters of a patch."""

    perimeters: tuple[float, ...]
    steps: tuple[Step, ...]


def square(side: int) -> pgcp.Mesh:
    """A flat square of side x side cells, its vertices moved about so that no two lengths are the same."""
    x, y = np.meshgrid(np.arange(side + 1.0), np.arange(side + 1.0), indexing="ij")
    shift = np.random.default_rng(0).uniform(-0.2, 0.2, (2, x.size))
    points = np.column_stack([x.ravel() + shift[0], y.ravel() + shift[1], np.zeros(x.size)])
    a = np.add.outer(np.arange(side) * (side + 1), np.arange(side)).ravel()
    b, c, d = a + side + 1, a + side + 2, a + 1
    return pgcp.Mesh(points, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]))


@functools.cache
def planned(count: int) -> Tree:
    """The tree that the package plans in so many parts."""
    if count == 1:
        return Tree((1.0,), ())
    mesh = square(int(np.sqrt(_PART_VERTICES * count)))
    topology = examine(mesh.faces, len(mesh.vertices))
    split = split_mesh(mesh, topology, count)
    lengths = np.array([len(patch.boundary) for patch in cut_patches(mesh, topology, split)], float)
    steps = sorted(plan_welds(split.table, count).steps, key=lambda step: step.level)
    seams = [(step.left, step.right, step.result, step.seam_edge_count / lengths.mean()) for step in steps]
    return Tree(tuple(lengths / lengths.mean()), tuple(seams))


def weld_tree(count: int) -> Tree:
    """The tree for any number of patches: beyond what is planned every part is halved until there are enough."""
    top = planned(min(count, PLANNED))
    parts = len(top.perimeters)
    sizes = [count // parts + (k < count % parts) for k in range(parts)]
    names, steps, perimeters = iter(range(count, 2 * count)), list[Step](), list[float]()
    now = {}  # part or union of the planned tree -> its number here
    for k, size in enumerate(sizes):
        first = len(perimeters)
        perimeters += size * [top.perimeters[k]]
        now[k] = _halved(first, size, names, steps)
    for left, right, result, seam in top.steps:
        now[result] = next(names)
        steps.append((now[left], now[right], now[result], seam * np.sqrt(count / parts)))
    return Tree(tuple(perimeters), tuple(steps))


def _halved(first: int, size: int, names: Iterator[int], steps: list[Step]) -> int:
    """Add the welds of patches first, first + 1, ... by halves, round unions; returns the union's number."""
    if size == 1:
        return first
    low = size // 2
    left, right = _halved(first, low, names, steps), _halved(first + low, size - low, names, steps)
    result = next(names)
    steps.append((left, right, result, 0.5 * (np.sqrt(low) + np.sqrt(size - low) - np.sqrt(size))))
    return result
