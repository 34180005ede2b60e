"""What a target is: where a map goes, and what is done for it on the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pgcp.finish.families import Family
from pgcp.finish.place import Unplaced
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts
from pgcp.patches.types import Component, SeamPositions
from pgcp.plane.space import Space
from pgcp.types import FloatArray, Mesh, Positions


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """A target of maps.

    name; summary: a line for the documentation; space: the plane or the sphere;
    constrain: where the points of a welded union lie; solve_exactly: the map of the undivided mesh; family: of the positions of
    the vertices in use, the Moebius maps that a correction chooses from; place: coordinates of a finished map in the target's
    customary position; place_exactly: near there by operations that round nothing, where rounding would fold faces;
    moebius: the correction that ``auto`` means; rank: the least one that fits a surface is what ``auto`` chooses;
    has_centre: whether a vertex can be brought to its centre; centre_is_all: whether that leaves no Moebius map to choose;
    has_free_boundary: whether the boundary goes where the map takes it, so that the map may overlap itself;
    keeps_scale: whether coordinates are in the surface's unit of length;
    gives_way_to: the target whose map takes the place of one that stays folded, by name;
    energy: of coordinates, the conformal energy, where the target has a boundary of fixed area.
    """

    name: str
    summary: str
    space: Space
    constrain: Callable[[Component], SeamPositions]
    solve_exactly: Callable[[Run, Parts], Mapped]
    family: Callable[[Positions], Family]
    place: Callable[[Unplaced, int | None], FloatArray]
    place_exactly: Callable[[Unplaced], FloatArray] | None = None
    moebius: str = "auto"
    rank: int = 9
    has_centre: bool = False
    centre_is_all: bool = False
    has_free_boundary: bool = False
    keeps_scale: bool = False
    gives_way_to: str | None = None
    energy: Callable[[Mesh, FloatArray], float] | None = None
