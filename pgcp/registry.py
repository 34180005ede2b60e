"""One place for each kind of thing that can be added: a method, a target.

A thing is one file of its room, and is found by the file's name: it is imported when it is asked for, not before.
"""

from __future__ import annotations

import importlib
import pkgutil
from typing import Generic, Protocol, TypeVar, cast

from pgcp.errors import InputError


class Named(Protocol):
    """Has a name."""

    @property
    def name(self) -> str:
        """What it is called on the command line and in reports."""
        ...


Thing = TypeVar("Thing", bound=Named)


class Registry(Generic[Thing]):
    """Things of one kind by name: those of the files of a room, and those that were registered while the program runs.

    kind: what one is called in messages; room: the package; attribute: what a file of the room calls its thing; others: files
    of the room that hold none.
    """

    def __init__(self, kind: str, room: str, attribute: str, others: tuple[str, ...] = ()) -> None:
        self.kind = kind
        self._room, self._attribute, self._others = room, attribute, others
        self._added: dict[str, Thing] = {}

    def names(self) -> tuple[str, ...]:
        """All names, those of the room's files in alphabetical order first. Imports none of them."""
        path = importlib.import_module(self._room).__path__
        files = sorted(file.name for file in pkgutil.iter_modules(path) if not file.ispkg)
        found = [name for name in files if name not in self._others and name not in self._added]
        return (*found, *self._added)

    def get(self, name: str) -> Thing:
        """The thing of a name; raises InputError where there is none."""
        if name in self._added:
            return self._added[name]
        if name not in self.names():
            raise InputError(f"unknown {self.kind} {name!r}; choose from {', '.join(self.names())}")
        return cast(Thing, getattr(importlib.import_module(f"{self._room}.{name}"), self._attribute))

    def all(self) -> list[Thing]:
        """All things, in the order of their names."""
        return [self.get(name) for name in self.names()]

    def register(self, thing: Thing) -> Thing:
        """Add a thing, or put it in the place of one of the same name; returns it."""
        self._added[thing.name] = thing
        return thing

    def remove(self, name: str) -> None:
        """Take away a thing that was registered."""
        self._added.pop(name, None)
