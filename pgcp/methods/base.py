"""What a method is: how it maps a mesh that is split into patches, and what is said of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from pgcp.errors import CrowdedError, NumericalError, SolveFailedError, WeldFailedError
from pgcp.options import Options
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts

Route = int | str  # a weld plan by its number, or the name of a way without welds
EXACT, WHOLE = "exact", "whole"
FAILURES = (WeldFailedError, SolveFailedError, CrowdedError)


@dataclass(frozen=True, slots=True)
class Attempt:
    """One try at a map: the number of patches, the partition's seed, and the route to the map."""

    patches: int
    seed: int
    route: Route = WHOLE


@dataclass(frozen=True, slots=True)
class Choice:
    """What attempts may be made of: patches and seed asked for, the fewest patches, and what must not be varied.

    varies: whether other seeds and fewer patches may be tried; exact_first: seams solved exactly before any weld.
    """

    patches: int
    seed: int = 0
    fewest: int = 1
    varies: bool = True
    exact_first: bool = False


@dataclass(frozen=True, slots=True)
class Failure:
    """A route that led to no map: the stage that failed, flatten or weld, and why; or there is no such route (plan)."""

    stage: str
    problem: NumericalError | None = None
    label: float | str = ""


Mapper = Callable[[Route], Mapped | Failure]


def once(choice: Choice) -> Iterator[Attempt]:
    """One attempt, with the patches and the seed asked for."""
    yield Attempt(choice.patches, choice.seed)


def unchanged(options: Options) -> Options:
    """The options as they are."""
    return options


def whole(map_mesh: Callable[[Run, Parts], Mapped]) -> Callable[[Run, Parts], Mapper]:
    """The mapper of a method with one route; its errors are the user's."""
    return lambda run, parts: lambda route: map_mesh(run, parts)


@dataclass(frozen=True, slots=True, eq=False)
class Method:
    """A way to map a mesh.

    name; targets, by name, None for all that there are; summary, guarantees, reference: a line each for the documentation;
    mapper: for one split of the mesh, a function from a route to a map; attempts: which attempts may be made, in order;
    options: the user's options with what the method means by them; moebius: the correction that ``auto`` means, None for the
    target's own; chooses_seams: whether ``seams`` is a choice;
    is_polished: whether a polish is what ``auto`` means, where it is quick;
    to_target: the map to the run's target from a map to another, by the same welds; where there is none, no other map takes
    the place of one that fails or folds.
    """

    name: str
    targets: tuple[str, ...] | None
    summary: str
    guarantees: str
    reference: str
    mapper: Callable[[Run, Parts], Mapper]
    attempts: Callable[[Choice], Iterator[Attempt]] = once
    options: Callable[[Options], Options] = unchanged
    moebius: str | None = None
    chooses_seams: bool = False
    is_polished: bool = False
    to_target: Callable[[Run, Mapped], Mapped] | None = None
