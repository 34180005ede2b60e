"""One run: what is mapped, where to and on what."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from pgcp.options import Options
from pgcp.patches.types import Component, SeamPositions
from pgcp.plane.space import Space
from pgcp.runtime.clock import Clock
from pgcp.runtime.executors import Executor
from pgcp.runtime.job import Job
from pgcp.surface.intrinsic import Intrinsic
from pgcp.surface.topology import Topology
from pgcp.types import IntArray, Mesh


class Goal(Protocol):
    """What the maps of patches need to know of a target."""

    @property
    def name(self) -> str:
        """Name of the target."""
        ...

    @property
    def space(self) -> Space:
        """The plane or the sphere."""
        ...

    @property
    def constrain(self) -> Callable[[Component], SeamPositions]:
        """Where the points of a welded union lie in the target."""
        ...

    @property
    def solve_exactly(self) -> Callable[..., Any]:
        """Of a run and its parts, the map of the undivided mesh by its interface operator (Mapped)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One mesh to be mapped, and all that is known of it.

    intrinsic: a triangulation whose Laplacian takes the place of the mesh's where seams are solved exactly, in one piece.
    """

    mesh: Mesh
    topology: Topology
    target: Goal
    mollification: float
    options: Options
    cuts: IntArray | None
    patch_count: int
    job: Job
    executor: Executor
    clock: Clock
    intrinsic: Intrinsic | None = None

    @property
    def boundary(self) -> IntArray:
        """The outer boundary, none where the surface is closed."""
        return self.topology.loops[0] if self.topology.loops else np.empty(0, np.int64)

    @property
    def is_closed(self) -> bool:
        """Whether the surface has no boundary."""
        return not self.topology.loops

    @property
    def fewest_patches(self) -> int:
        """The least number of patches there can be."""
        return 2 if self.is_closed else 1
