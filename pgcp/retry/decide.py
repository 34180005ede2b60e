"""Which attempt comes next, as a pure function of what was tried."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from pgcp.methods.base import EXACT, Attempt

_FOLDED_MAPS = 2


@dataclass(frozen=True, slots=True)
class Tried:
    """One attempt that did not serve.

    label: the route as the report names it; folds: how many are left in its map, None where there is none;
    stage: what failed then, split, flatten, weld or exact, or plan where there is no such weld plan; crowded: whether it failed
    because the target has no room for the surface in double precision; blurred: whether points came too close to be told apart
    while patches were welded.
    """

    attempt: Attempt
    label: float | str
    reason: str
    folds: int | None = None
    stage: str = ""
    crowded: bool = False
    blurred: bool = False

    def record(self) -> dict[str, Any]:
        """What the report says of it."""
        where = {"patches": self.attempt.patches, "seed": self.attempt.seed, "route": self.label}
        return {**where, "folds": self.folds, "reason": self.reason}


def next_attempt(order: Iterable[Attempt], history: Sequence[Tried]) -> Attempt | None:
    """The first attempt of an order that may lead to a map without folds after all that was tried; None where none may.

    Two folded maps with the same number of patches are enough: a third weld of as many patches does not do better. Exact seams
    are tried once, since the map does not depend on the split. Where the disk has no room for the surface, no other weld of the
    same split finds room, and if there is no map yet, neither do fewer patches. Where all welds of a split are
    blurred and exact seams fail as well, no other split is tried.
    """
    for attempt in order:
        if _is_hopeless(attempt, history):
            return None
        if not _is_pointless(attempt, history):
            return attempt
    return None


def _is_hopeless(attempt: Attempt, history: Sequence[Tried]) -> bool:
    """Whether fewer patches than were tried last, or other ones, would meet the same lack of room."""
    failed = [tried for tried in history if tried.stage != "plan"]
    if not failed or any(tried.folds is not None for tried in failed):
        return False
    welds = [tried for tried in failed if tried.attempt.route != EXACT]
    is_another = (attempt.patches, attempt.seed) != (failed[-1].attempt.patches, failed[-1].attempt.seed)
    if is_another and 0 < len(welds) < len(failed) and all(tried.blurred for tried in welds):
        return True
    return attempt.patches < history[-1].attempt.patches and failed[-1].crowded


def _is_pointless(attempt: Attempt, history: Sequence[Tried]) -> bool:
    """Whether an attempt was made, or would end as another did."""
    same_split = [t for t in history if (t.attempt.patches, t.attempt.seed) == (attempt.patches, attempt.seed)]
    if any(t.attempt == attempt or t.stage == "split" for t in same_split):
        return True
    if attempt.route == EXACT:
        return any(t.attempt.route == EXACT for t in history)
    if sum(t.attempt.patches == attempt.patches and t.folds is not None for t in history) >= _FOLDED_MAPS:
        return True
    return any(t.stage in ("flatten", "plan") or (t.crowded and t.stage == "weld") for t in same_split)
