"""What a method is: how it maps a mesh that is split into patches, and what is said of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from math import isfinite
from typing import Any

from pgcp.errors import CrowdedError, InputError, NumericalError, SolveFailedError, WeldFailedError
from pgcp.options import Options, Running
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


_NAMED = {int: "a whole number", float: "a number", bool: "yes or no", str: "text"}
_TRUTHS = {"yes": True, "true": True, "no": False, "false": False}
_TAKEN = {field.name for kind in (Options, Running) for field in fields(kind)} | {"source", "progress"}


@dataclass(frozen=True, slots=True)
class OwnOption:
    """An option that only some methods have: ``--a-name`` on the command line, ``a_name`` in Python and in the report.

    help: a line for the command line; default: which says of what type it is, one of int, float, bool and str;
    choices: what text it may be, none where that is free; metavar: what stands for its value in the help;
    check: of a value of that type; raises InputError where it means nothing.
    Raises ValueError where the name is that of another option.
    """

    name: str
    help: str
    default: Any
    choices: tuple[str, ...] = ()
    metavar: str | None = None
    check: Callable[[Any], object] | None = None

    def __post_init__(self) -> None:
        if not self.name.isidentifier() or self.name in _TAKEN:
            raise ValueError(f"{self.name!r} cannot be the name of an option that a method has of its own")
        if type(self.default) not in _NAMED:
            raise ValueError(f"the default of {self.name} is {self.default!r}, it must be one of {', '.join(_NAMED.values())}")

    def made(self, given: Any) -> Any:
        """The value that is given, or written as text; raises InputError where it is of another type, or no choice."""
        kind = type(self.default)
        try:
            value = _from_text(kind, given) if isinstance(given, str) else given
            value = float(value) if kind is float and type(value) is int else value
            if type(value) is not kind or (kind is float and not isfinite(value)):
                raise TypeError
        except (KeyError, TypeError, ValueError):
            raise InputError(f"{self.name} is {given!r}, it must be {_NAMED[kind]}") from None
        if self.choices and value not in self.choices:
            raise InputError(f"unknown {self.name} {value!r}; choose from {', '.join(self.choices)}")
        if self.check is not None:
            self.check(value)
        return value


def _from_text(kind: type, text: str) -> Any:
    return _TRUTHS[text] if kind is bool else kind(text)


@dataclass(frozen=True, slots=True, eq=False)
class Method:
    """A way to map a mesh.

    name; targets, by name, None for all that there are; summary, guarantees, reference: a line each for the documentation;
    mapper: for one split of the mesh, a function from a route to a map; attempts: which attempts may be made, in order;
    options: the user's options with what the method means by them; moebius: the correction that ``auto`` means, None for the
    target's own; chooses_seams: whether ``seams`` is a choice;
    is_polished: whether a polish is what ``auto`` means, where it is quick;
    to_target: the map to the run's target from a map to another, by the same welds; where there is none, no other map takes
    the place of one that fails or folds;
    own: options that the method has and others have not; ``run.options.own`` holds a value of each, by name.
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
    own: tuple[OwnOption, ...] = ()
