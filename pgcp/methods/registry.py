"""All methods by name: each is a file of this room that holds a ``METHOD``, or was registered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from pgcp.errors import InputError
from pgcp.options import AUTO, Options
from pgcp.registry import Registry

if TYPE_CHECKING:
    from pgcp.methods.base import Method, OwnOption

METHODS: Registry[Method] = Registry("method", "pgcp.methods", "METHOD", ("base", "registry"))


def method_of(options: Options) -> tuple[Method, Options]:
    """The method asked for, and the options with what it means by them; raises InputError where they do not go together."""
    method = METHODS.get(options.method)
    if method.targets is not None and options.target not in (AUTO, *method.targets):
        kind = "target" if len(method.targets) == 1 else "targets"
        able = ", ".join(method.targets)
        raise InputError(f"the method {method.name} is one for the {kind} {able}, not {options.target}")
    if options.seams != Options().seams and not method.chooses_seams:
        able = ", ".join(other.name for other in METHODS.all() if other.chooses_seams)
        raise InputError(f"the method {method.name} has no welds to choose seams for; seams goes with the method {able}")
    return method, method.options(_completed(method, options))


def _completed(method: Method, options: Options) -> Options:
    """The options with a value of each option that is the method's own; raises InputError where it has no such option."""
    check_own(options, [method])
    given = options.own
    return replace(options, own={own.name: own.made(given.get(own.name, own.default)) for own in method.own})


def check_own(options: Options, methods: Sequence[Method]) -> None:
    """Raise InputError for an option of some method's own that none of the methods has, with those that have it."""
    for name in options.own:
        if not any(name == own.name for method in methods for own in method.own):
            able = [other.name for other, _ in own_options().get(name, ())]
            names = ", ".join(method.name for method in methods)
            which = f"method {names} has" if len(methods) == 1 else f"methods {names} have"
            goes = f"it goes with the method {', '.join(able)}" if able else "no method has it"
            raise InputError(f"the {which} no option {name}; {goes}")


def only_own(options: Options, method: Method) -> Options:
    """The options without those that only other methods have."""
    names = {own.name for own in method.own}
    return replace(options, own={name: value for name, value in options.own.items() if name in names})


def own_options() -> dict[str, list[tuple[Method, OwnOption]]]:
    """Options that only some methods have, by name: each with the methods that have it. Imports all methods."""
    found: dict[str, list[tuple[Method, OwnOption]]] = {}
    for method in METHODS.all():
        for own in method.own:
            found.setdefault(own.name, []).append((method, own))
    return found
