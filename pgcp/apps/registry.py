"""All applications by name: each is a file of this room that holds an ``APP``, or was registered."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pgcp.registry import Registry

if TYPE_CHECKING:
    from pgcp.apps.base import App

APPS: Registry[App] = Registry("command", "pgcp.apps", "APP", ("base", "registry"))
