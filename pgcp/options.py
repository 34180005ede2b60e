"""What a run computes, and where it runs: each checked once. Names of methods and targets are checked by their registries."""

from __future__ import annotations

import inspect
import operator
import os
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from functools import cache, wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, get_args, get_origin, get_type_hints

from pgcp.errors import InputError

Given = ParamSpec("Given")
Made = TypeVar("Made")
Kind = TypeVar("Kind", bound=type)

AUTO, NONE = "auto", "none"
METHOD = "pgcp"
MOEBIUS = (AUTO, NONE, "area", "angle")
UVS, UPS = ("unit", "surface"), ("auto", "x", "y", "z")  # texture coordinates, and what is up on the texture
POLISHES = (AUTO, "none", "angles")
REPAIRS = ("relax", "compose", "average", "untangle", "embed")
FLATTENERS = ("dncp", "scp")
BACKENDS = ("nested", "pardiso", "superlu")
SEAMS = ("weld", "relax", "exact")
_LEAST_MEMORY = 10**9
_MOST_WELDED = 0.01
SCALE_RATIO = 20.0  # of areas, that a cut that is found is to keep below


def names_checked(function: Callable[Given, Made]) -> Callable[Given, Made]:
    """The same function, which raises InputError for a keyword that it has not, with the nearest that it has."""
    known = [name for name in inspect.signature(function).parameters if name != "self"]

    @wraps(function)
    def checked(*values: Given.args, **named: Given.kwargs) -> Made:
        """See the function."""
        check_names(named, known)
        return function(*values, **named)

    return checked


def check_names(names: Iterable[str], known: Sequence[str]) -> None:
    """Raise InputError for a name of an option that is not known, with the nearest that is."""
    for name in names:
        if name not in known:
            near = get_close_matches(name, known, 1, 0.6)
            raise InputError(f"unknown option {name!r}{f'; did you mean {near[0]}?' if near else ''}")


def _options(kind: Kind) -> Kind:
    """A class of options whose unknown keywords are InputErrors."""
    kind.__init__ = names_checked(kind.__init__)  # type: ignore[misc]
    return kind


def _whole(value: Any) -> int:
    if isinstance(value, bool):
        raise TypeError
    return int(value) if isinstance(value, float) and value.is_integer() else operator.index(value)


def _real(value: Any) -> float:
    if isinstance(value, (bool, str)):
        raise TypeError
    return float(value)


def _truth(value: Any) -> bool:
    if type(value).__name__ not in ("bool", "bool_"):  # the latter is NumPy's
        raise TypeError
    return bool(value)


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


def _path(value: Any) -> Path:
    return Path(os.fspath(value))


def _texts(value: Any) -> tuple[str, ...]:
    if isinstance(value, str) or not isinstance(value, Sequence | set | frozenset):
        raise TypeError
    return tuple(_text(one) for one in value)


def _by_name(value: Any) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise TypeError
    return {_text(name): given for name, given in value.items()}


# type of an option: what makes one of what was given, and what it is called
_TYPES: dict[Any, tuple[Callable[[Any], Any], str]] = {
    int: (_whole, "a whole number"),
    float: (_real, "a number"),
    bool: (_truth, "True or False"),
    str: (_text, "text"),
    Path: (_path, "a path"),
    tuple: (_texts, "several names"),
    Mapping: (_by_name, "values by name"),
}


@cache
def _types_of(kind: Any) -> dict[str, tuple[Any, bool]]:
    """The type of each option of a class, and whether it may be None."""
    out = {}
    for name, hint in get_type_hints(kind).items():
        choices = get_args(hint) if get_origin(hint) is types.UnionType else (hint,)
        out[name] = next(get_origin(c) or c for c in choices if c is not type(None)), type(None) in choices
    return out


def _check_types(options: Any) -> None:
    """Make every option of the type that it has; raises InputError where what was given is something else."""
    class_: Any = type(options)
    for name, (kind, may_be_none) in _types_of(class_).items():
        value = getattr(options, name)
        if (value is None and may_be_none) or kind not in _TYPES:
            continue
        make, called = _TYPES[kind]
        try:
            made = make(value)
        except TypeError:
            raise InputError(f"{name} is {value!r}, it must be {called}{' or None' if may_be_none else ''}") from None
        object.__setattr__(options, name, made)


@_options
@dataclass(frozen=True, slots=True)
class Options:
    """What is computed; the result depends on nothing else but the mesh, the number of workers at most through ``patches``.

    patches: how many, None for what ``runtime.sizing`` chooses by vertices, workers and memory;
    target: name of a target, or auto for the first that fits the surface; centre: vertex that goes to
    the centre of the disk or the north pole of the sphere; moebius: correction of the finished map, none, least area
    distortion, least angle error, or auto for what serves the target;
    cuts: a file of cut edges; repair_cuts: mend parts that are no disks; method: name of a method; flatten: how patches are
    flattened; seams: weld, relax (welded boundary held, seams solved) or exact (no weld); backend: auto, nested,
    pardiso or superlu; seed: of the partition; repairs: which tiers may take folds away; no_overlap: where a free map overlaps
    itself, map to the disk instead; fix: repair the topology of a mesh that the target does not fit;
    polish: none, angles, or auto for where it is quick and the map is not asked for as it is;
    weld_distance: how far apart vertices may be that are split by attributes only and are joined for the map, as a share of
    the diagonal of all, None to join none; cut: none, auto to open a surface to a disk by a cut, or the path of a file of edges
    to cut along; max_area_distortion: the scale ratio below which a cut that is found is to bring the map, None for 20;
    component: which of several is mapped: the largest, a name, a number, or all.
    own: options that only the method has, by name.
    """

    patches: int | None = None
    target: str = AUTO
    centre: int | None = None
    moebius: str = AUTO
    cuts: Path | None = None
    repair_cuts: bool = False
    method: str = METHOD
    flatten: str = "dncp"
    seams: str = "weld"
    backend: str = AUTO
    seed: int = 0
    repairs: tuple[str, ...] = REPAIRS
    no_overlap: bool = False
    fix: bool = False
    polish: str = "none"
    weld_distance: float | None = 0.0
    component: str = "largest"
    cut: str = NONE
    max_area_distortion: float | None = None
    own: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        if isinstance(self.cut, os.PathLike):
            object.__setattr__(self, "cut", os.fspath(self.cut))
        _check_types(self)
        self._check_cut()
        _least("patches", self.patches, 1)
        _least("seed", self.seed, 0)
        if self.centre is not None and self.centre < 0:
            raise InputError(f"centre is vertex {self.centre}, it must be 0 or more")
        if self.weld_distance is not None and not 0.0 <= self.weld_distance <= _MOST_WELDED:
            raise InputError(f"weld_distance is {self.weld_distance}, it must be from 0 to {_MOST_WELDED} of the diagonal")
        _one_of("Moebius correction", self.moebius, MOEBIUS)
        _one_of("polish", self.polish, POLISHES)
        _one_of("flattening", self.flatten, FLATTENERS)
        _one_of("treatment of seams", self.seams, SEAMS)
        for name in self.repairs:
            _one_of("repair", name, REPAIRS)

    def _check_cut(self) -> None:
        """Raise InputError where what is asked of a cut means nothing."""
        if not self.cut:
            raise InputError("cut is empty, it must be auto, none or a path")
        if self.max_area_distortion is not None and not 1.0 < self.max_area_distortion < float("inf"):
            raise InputError(f"max_area_distortion is {self.max_area_distortion}, it must be a number above 1")
        if self.max_area_distortion is not None and self.cut != AUTO:
            raise InputError("max_area_distortion bounds what a cut that is found leads to; it goes with cut auto")
        if self.opens and self.cuts is not None:
            raise InputError(
                f"cut opens the surface, and cuts ({self.cuts}) names the seams between patches by vertices, which the cut "
                "splits; give one of the two"
            )

    @property
    def opens(self) -> bool:
        """Whether the surface is cut open before it is mapped."""
        return self.cut != NONE

    @property
    def scale_bound(self) -> float:
        """The scale ratio that a map of a cut surface is to have at most; infinite where none is asked for."""
        if self.cut != AUTO:
            return float("inf")
        return SCALE_RATIO if self.max_area_distortion is None else self.max_area_distortion


@_options
@dataclass(frozen=True, slots=True)
class Running:
    """Where and how a run runs: the bits of its results do not depend on it.

    workers: 0 for threads of this process, else processes on this machine, which is then the number of processors in use;
    scheduler, scheduler_file or client: a running dask cluster, by its scheduler's address, the file that describes it, or a
    live dask.distributed.Client, which stays open; executor: name of what runs the tasks, or auto for the first that has
    workers if workers are asked for; store: directory shared with the workers; factor_cache_bytes: what factors one process may
    keep between the passes, None for 1.5 GB or what the memory limit leaves; memory_limit_bytes: of all processes together;
    resume: take up what an earlier run of the same mesh and options has finished, and keep what this one has when it is
    interrupted; tls_ca, tls_cert, tls_key: PEM files for a scheduler with TLS.
    """

    workers: int = 0
    scheduler: str | None = None
    scheduler_file: Path | None = None
    executor: str = AUTO
    store: Path | None = None
    factor_cache_bytes: int | None = None
    memory_limit_bytes: int | None = None
    resume: bool = False
    tls_ca: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None
    client: Any = None

    def __post_init__(self) -> None:
        _check_types(self)
        if self.workers < 0:
            raise InputError(f"workers is {self.workers}, it must be 0 (none) or more")
        if sum(given is not None for given in (self.scheduler, self.scheduler_file, self.client)) > 1:
            raise InputError("give one of a scheduler address, a scheduler file and a client")
        given = [path is not None for path in (self.tls_ca, self.tls_cert, self.tls_key)]
        if any(given) and not all(given):
            raise InputError("TLS needs all three of tls_ca, tls_cert and tls_key")
        if any(given) and self.client is not None:
            raise InputError("a client has its own TLS files; leave tls_ca, tls_cert and tls_key out")
        if any(given) and not self.is_elsewhere:
            raise InputError("TLS goes with a running scheduler: workers on this machine listen to this machine only")
        if self.memory_limit_bytes is not None and self.memory_limit_bytes < _LEAST_MEMORY:
            raise InputError(f"the memory limit is {self.memory_limit_bytes} bytes, it must be at least {_LEAST_MEMORY}")
        _least("factor_cache_bytes", self.factor_cache_bytes, 0)

    @property
    def is_elsewhere(self) -> bool:
        """Whether a running scheduler is used."""
        return self.scheduler is not None or self.scheduler_file is not None or self.client is not None

    @property
    def starts_workers(self) -> bool:
        """Whether the run has worker processes of its own."""
        return self.workers > 0 and not self.is_elsewhere

    @property
    def tls_files(self) -> tuple[Path, Path, Path] | None:
        """Authority, certificate and key where the scheduler is reached by TLS."""
        if self.tls_ca is None or self.tls_cert is None or self.tls_key is None:
            return None
        return self.tls_ca, self.tls_cert, self.tls_key


def _least(name: str, value: int | None, least: int) -> None:
    if value is not None and value < least:
        raise InputError(f"{name} is {value}, it must be {f'at least {least}' if least else '0 or more'}")


def _one_of(what: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise InputError(f"unknown {what} {value!r}; choose from {', '.join(known)}")


def plain_options(options: Options | Running) -> dict[str, Any]:
    """Options as plain data, paths and clients as text, those of a method's own among the others."""
    values = {f.name: getattr(options, f.name) for f in fields(options) if f.name != "own"}
    values |= options.own if isinstance(options, Options) else {}
    return {name: v if v is None or isinstance(v, (bool, int, float, str, tuple)) else str(v) for name, v in values.items()}
