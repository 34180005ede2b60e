"""All targets by name: each is a file of this room that holds a ``TARGET``, or was registered."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pgcp.registry import Registry

if TYPE_CHECKING:
    from pgcp.targets.base import Target

TARGETS: Registry[Target] = Registry("target", "pgcp.targets", "TARGET", ("base", "fitting", "registry"))
