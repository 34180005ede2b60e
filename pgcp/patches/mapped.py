"""What a method returns: one map of all patches."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pgcp.patches.run import Goal
from pgcp.patches.stored import Parts
from pgcp.patches.types import Component, SeamPositions, SolveReport, WeldPlan
from pgcp.types import ComplexArray, Positions


@dataclass(frozen=True, slots=True, eq=False)
class Weld:
    """How patches were welded: the plan, its seam-length penalty (crowding), the union, and a note on each weld."""

    plan: WeldPlan
    crowding: float
    union: Component
    pieces: list[int]
    notes: tuple[dict[str, int], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Mapped:
    """One pass through all patches: positions (V,), and mu (F,) of the patches as they were solved.

    solved: what was seen of each patch, none where no patch was solved by itself; seams: where seam vertices lie;
    weld: how patches were welded, None where they were not; details: what the report says of the method's own steps,
    such as ``interface`` (seams solved exactly), ``iterations`` and ``converged``.
    """

    parts: Parts
    target: Goal
    points: Positions
    mu: ComplexArray
    seams: SeamPositions
    solved: list[SolveReport]
    weld: Weld | None = None
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def route(self) -> float | str:
        """The route to it as the report names it: the weld plan's seam-length penalty, or exact."""
        return "exact" if self.weld is None else self.weld.crowding

    @property
    def seams_by(self) -> str | None:
        """How seams were treated: weld, relax or exact; None where there are none."""
        exact = self.details.get("interface") is not None
        if self.weld is None:
            return "exact" if exact else None
        return "relax" if exact else "weld"
