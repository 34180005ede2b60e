"""Which target fits a surface, and which options a target has a use for."""

from __future__ import annotations

from dataclasses import dataclass

from pgcp.errors import InputError
from pgcp.options import AUTO, Options
from pgcp.surface.topology import Topology
from pgcp.targets.base import Target
from pgcp.targets.registry import TARGETS
from pgcp.types import Mesh

_NO_BOUNDARY_TO_HOLD = (
    "seams cannot be relaxed on a sphere: a closed surface has no boundary to hold, and harmonic maps of all of it collapse; "
    "choose --seams weld or --seams exact"
)


@dataclass(frozen=True, slots=True)
class Asked:
    """The target asked for by name, or ``auto``: the one of least rank, of those ``among`` which the method has, that fits.

    opens: whether the surface is cut open before it is mapped, so that any connected oriented surface does.
    Raises InputError where there is no such target, or none for open surfaces though it is cut open.
    """

    name: str = AUTO
    among: tuple[str, ...] | None = None
    opens: bool = False

    def __post_init__(self) -> None:
        if self.name != AUTO:
            TARGETS.get(self.name)
        if self.opens and not self._able():
            name = self.name if self.name != AUTO else " and ".join(self.among or ())
            raise InputError(
                f"--cut opens the surface, and {name} takes closed ones; --cut goes with {' and '.join(_names(False))}"
            )

    def _able(self) -> list[Target]:
        """Targets that may be meant, those of least rank first."""
        named = TARGETS.all() if self.among is None else [TARGETS.get(name) for name in self.among]
        meant = (t for t in named if self.name in (AUTO, t.name) and not (self.opens and t.space.closed))
        return sorted(meant, key=lambda target: target.rank)

    def takes(self, topology: Topology) -> bool:
        """Whether a surface can be mapped."""
        return topology.genus is not None if self.opens else topology.fits(self.closed)

    @property
    def closed(self) -> bool | None:
        """Whether closed surfaces are asked for, or open ones, or (None) either."""
        kinds = {None} if self.opens else {target.space.closed for target in self._able()}
        return kinds.pop() if len(kinds) == 1 else None

    def chosen(self, topology: Topology) -> Target:
        """The target for a surface that fits."""
        return next(target for target in self._able() if topology.fits(target.space.closed))

    def refusal(self, topology: Topology) -> str:
        """Why a surface does not fit, and what would, as the end of a sentence."""
        flat, round_ones = (_names(closed) for closed in (False, True))
        if topology.is_disk or topology.is_sphere:
            use = " or ".join(round_ones if topology.is_sphere else flat)
            if self.name == AUTO and self.among is not None:
                return f", and the method maps to the {' and the '.join(self.among)} only; use a method with the target {use}"
            return f", which the target {self.name} does not fit; use target {use}"
        need = "need" if len(flat) > 1 else "needs"
        opens = "" if topology.genus is None else " (--cut auto opens it to a disk)"
        return (
            f"; no target fits it: {_listed(flat)} {need} one open disk with one boundary loop, "
            f"{_listed(round_ones)} one closed surface of genus 0{opens}"
        )


def _names(closed: bool) -> list[str]:
    fitting = sorted(TARGETS.all(), key=lambda target: target.rank)
    return [target.name for target in fitting if target.space.closed == closed]


def _listed(names: list[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0]


def fitting_names(topology: Topology, opens: bool = False) -> list[str]:
    """Names of the targets that fit a surface, or that fit it once it is cut open."""
    if opens:
        return _names(False) if topology.genus is not None else []
    return [name for closed in (False, True) if topology.fits(closed) for name in _names(closed)]


def check_options(options: Options, mesh: Mesh, target: Target) -> None:
    """Raise InputError for options that the target, or the mesh on its way there, has no use for."""
    if options.seams == "relax" and target.space.closed:
        raise InputError(_NO_BOUNDARY_TO_HOLD)
    if options.no_overlap and options.target != AUTO and not target.has_free_boundary:
        free = ", ".join(other.name for other in TARGETS.all() if other.has_free_boundary)
        raise InputError(f"a map to the {target.name} does not overlap itself; no_overlap goes with the target {free}")
    if options.centre is not None:
        _check_centre(options.centre, options.moebius, mesh, target)


def check_centre_is_inside(centre: int | None, topology: Topology, target: Target) -> None:
    """Raise InputError where the centre, in the numbers of the mesh of this topology, is on the boundary."""
    if centre is not None and any((loop == centre).any() for loop in topology.loops):
        raise InputError(f"vertex {centre} is on the boundary: it cannot be the centre of the {target.name}")


def _check_centre(centre: int, moebius: str, mesh: Mesh, target: Target) -> None:
    if not target.has_centre:
        able = " and ".join(other.name for other in TARGETS.all() if other.has_centre)
        raise InputError(f"the target {target.name} has no centre; --centre goes with the targets {able}")
    if target.centre_is_all and moebius not in (AUTO, "none"):
        raise InputError(f"a vertex at the centre leaves no Moebius correction of the {target.name} to choose")
    if centre >= len(mesh.vertices):
        raise InputError(f"{mesh.name}: the centre is vertex {centre}, but the mesh has {len(mesh.vertices)} vertices")
    if not (mesh.faces == centre).any():
        raise InputError(f"{mesh.name}: the centre is vertex {centre}, which no face uses")
