"""A map as notebooks show it: the report page in a frame of its own, which turns, zooms and needs no network."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

from pgcp.errors import InputError
from pgcp.report.page import page
from pgcp.report.scene import MOST_FACES
from pgcp.types import Parameterization

LIGHT_FACES = 20_000  # that a result shows by itself, as whatever stands last in a cell stays in the notebook's file
HEIGHT = 640
_LEAST, _MOST = 200, 4000  # pixels of a frame


def framed(result: Parameterization, most: int = LIGHT_FACES, height: int = HEIGHT) -> str:
    """HTML of a frame with the report page, ``height`` pixels high, in which at most so many faces are drawn.

    The page is in the text itself. It cannot reach what is around it: its scripts run in a sandbox.
    """
    text = page(result, most=most, is_framed=True).decode()
    source = text.replace("&", "&amp;").replace('"', "&quot;")
    style = f"width: 100%; height: {height}px; border: 0"
    title = f"map of {escape(result.mesh.name)}"
    return f'<iframe title="{title}" style="{style}" sandbox="allow-scripts" loading="lazy" srcdoc="{source}"></iframe>'


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Plot:
    """A map to look at: a notebook shows its report page, a terminal a line; nothing is opened.

    faces: how many are drawn at most; height: of the frame, in pixels. Raises InputError where they are out of bounds.
    """

    result: Parameterization
    faces: int = MOST_FACES
    height: int = HEIGHT

    def __post_init__(self) -> None:
        if self.faces < 1:
            raise InputError(f"faces is {self.faces}, it must be 1 or more")
        if not _LEAST <= self.height <= _MOST:
            raise InputError(f"height is {self.height}, it must be from {_LEAST} to {_MOST} pixels")

    def _repr_html_(self) -> str:
        """The report page in a frame, for notebooks."""
        return framed(self.result, self.faces, self.height)

    def __repr__(self) -> str:
        """What a terminal shows."""
        return f"plot of {self.result.mesh.name} for a notebook; the result's page() and picture() are for files"
