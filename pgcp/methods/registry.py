"""All methods by name: each is a file of this room that holds a ``METHOD``, or was registered."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pgcp.errors import InputError
from pgcp.options import AUTO, Options
from pgcp.registry import Registry

if TYPE_CHECKING:
    from pgcp.methods.base import Method

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
    return method, method.options(options)
