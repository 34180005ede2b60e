"""The picture of a finished map."""

from __future__ import annotations

from pgcp.report.picture import draw

__all__ = ["draw"]
