"""The unit disk: the boundary goes to the circle, and the map is unique up to the disk's Moebius maps."""

from __future__ import annotations

from functools import partial

from pgcp.finish.families import Shifts
from pgcp.finish.place import as_they_are, place_disk
from pgcp.interface.whole_mesh import map_open_exactly, whole_boundary
from pgcp.patches.constrain import constrain_to_disk
from pgcp.patches.run import Run
from pgcp.patches.types import SeamPositions
from pgcp.plane.space import PLANE
from pgcp.surface.distortion import conformal_energy
from pgcp.targets.base import Target
from pgcp.types import ComplexArray, FloatArray, Mesh, Positions


def _to_the_circle(run: Run, z: ComplexArray) -> SeamPositions:
    return constrain_to_disk(whole_boundary(run, z))


def _shifts(_positions: Positions) -> Shifts:
    return Shifts()


def _energy(mesh: Mesh, coordinates: FloatArray) -> float:
    return conformal_energy(mesh, PLANE.positions(coordinates))


TARGET = Target(
    name="disk",
    summary="the unit disk: a standard domain, comparable between surfaces; for open surfaces",
    space=PLANE,
    constrain=constrain_to_disk,
    solve_exactly=partial(map_open_exactly, place=_to_the_circle),
    family=_shifts,
    place=place_disk,
    place_exactly=as_they_are,
    rank=1,
    has_centre=True,
    centre_is_all=True,
    energy=_energy,
)
