"""The unit sphere, for closed surfaces of genus 0."""

from __future__ import annotations

from pgcp.finish.families import Boosts
from pgcp.finish.place import place_sphere, turn_by_axes
from pgcp.interface.whole_mesh import map_closed_exactly
from pgcp.patches.constrain import constrain_to_sphere
from pgcp.plane.space import SPHERE
from pgcp.targets.base import Target
from pgcp.types import Positions


def _boosts(_positions: Positions) -> Boosts:
    return Boosts()


TARGET = Target(
    name="sphere",
    summary="the unit sphere; for closed surfaces of genus 0",
    space=SPHERE,
    constrain=constrain_to_sphere,
    solve_exactly=map_closed_exactly,
    family=_boosts,
    place=place_sphere,
    place_exactly=turn_by_axes,
    rank=0,
    has_centre=True,
)
