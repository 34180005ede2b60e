"""The free map of a surface that was cut open: how even its scales are, and a more even map where they are not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgcp.errors import NumericalError
from pgcp.methods.base import Method
from pgcp.methods.common.evened import evened
from pgcp.patches.run import Run
from pgcp.plane.curves import crossings
from pgcp.retry.finished import Finished, finish, repaired_at_last
from pgcp.surface.squeeze import scale_ratio_of
from pgcp.types import FloatArray, IntArray, Mesh


@dataclass(frozen=True, slots=True, order=True)
class Evenness:
    """What makes a map of a cut surface good, what weighs most first: no folds, no overlap, scale ratio below its bound."""

    folds: int
    crossings: int
    excess: float
    ratio: float

    @property
    def is_good(self) -> bool:
        """Whether nothing is left to be wished for."""
        return self.folds == 0 and self.crossings == 0 and self.excess <= 1.0


def evenness(mesh: Mesh, image: FloatArray, boundary: IntArray, folds: int, bound: float) -> Evenness:
    """How good a map to points (V, 2) of the plane is, with its boundary (n_B,), its folds and the bound of its scale ratio."""
    ratio = scale_ratio_of(mesh, image)
    crossed = len(crossings(image[boundary] @ np.array([1.0, 1.0j])))
    return Evenness(folds, crossed, max(ratio / bound, 1.0), ratio)


def evenest(run: Run, method: Method, done: Finished) -> Finished:
    """The free map, or of a cut surface whose map is not good a more even one, where that is better.

    A method that gives no way to other maps returns its own.
    """
    options = run.options
    if not options.opens or method.to_target is None:
        return done
    best = _of(run, done)
    if best.is_good:
        return done
    try:
        for mapped in evened(run, done.mapped.parts, done.points):
            found = repaired_at_last(run, finish(run, method, mapped))
            other = _of(run, found)
            if other < best:
                best, done = other, found
            if other.is_good:
                break
    except NumericalError:
        pass
    return done


def _of(run: Run, done: Finished) -> Evenness:
    image = np.column_stack([done.points.real, done.points.imag])
    return evenness(run.mesh, image, run.boundary, done.folds, run.options.scale_bound)
