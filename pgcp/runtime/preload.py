"""Imported first by the process that local workers are forked from."""

from __future__ import annotations

from pgcp.runtime.forks import collect_seldom

collect_seldom()
