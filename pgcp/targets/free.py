"""The plane, the boundary free: it keeps the surface's lengths as well as a conformal map can."""

from __future__ import annotations

from functools import partial

from pgcp.finish.families import Bends
from pgcp.finish.place import place_free, scale_only
from pgcp.interface.whole_mesh import as_it_is, map_open_exactly
from pgcp.patches.constrain import keep_free
from pgcp.plane.space import PLANE
from pgcp.targets.base import Target

TARGET = Target(
    name="free",
    summary="the plane, boundary free: least stretch; for open surfaces",
    space=PLANE,
    constrain=keep_free,
    solve_exactly=partial(map_open_exactly, place=as_it_is),
    family=Bends,
    place=place_free,
    place_exactly=scale_only,
    moebius="none",
    rank=0,
    has_free_boundary=True,
    keeps_scale=True,
    gives_way_to="disk",
)
