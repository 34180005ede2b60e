"""A free map whose boundary is brought nearer to the surface's own lengths, as far as it then does not overlap itself.

The boundary that keeps its lengths has the least range of scales (Springborn, Schroeder, Pinkall 2008, section 3), but may
cross itself. Between a simple boundary, the map's or a circle, and that one, turning angles are interpolated linearly and
lengths geometrically, as both are by boundary first flattening (Sawhney, Crane 2018) with scale factors t u, t from 0 to 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import islice

import numpy as np

from pgcp.errors import SolveFailedError
from pgcp.interface.whole_mesh import eliminated
from pgcp.methods.common.boundary_first import BoundaryFlattening, integrated_curvature
from pgcp.methods.common.harmonic import mapped_whole
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts
from pgcp.plane.curves import crosses_itself
from pgcp.surface.topology import used_vertices
from pgcp.types import ComplexArray, FloatArray

LONGEST = 6000  # boundary vertices: the operator is dense
_SHARES = (0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)

_HALVINGS = 5


def turning_angles(z: ComplexArray) -> FloatArray:
    """Turning angle (n,) at each vertex of a closed polygon z (n,), from -pi to pi."""
    step = np.roll(z, -1) - z
    return np.angle(step * np.conj(np.roll(step, 1)))


def boundaries_between(
    flat: BoundaryFlattening, ratio: FloatArray, turning: FloatArray
) -> Iterator[tuple[float, ComplexArray]]:
    """Simple boundaries (n,) from that which keeps its lengths to another, and the share t of the other in each.

    ratio (n,): logarithms of lengths of the other's edges over those on the surface; turning (n,): its turning angles.
    """
    ratio = ratio - np.average(ratio, weights=flat.lengths)
    crossed: float | None = None  # the share before, whose boundary crosses itself

    def simple(share: float) -> ComplexArray | None:
        """The boundary of a share, None where it crosses itself or does not close."""
        try:
            found = flat.polygon(flat.lengths * np.exp(share * ratio), (1.0 - share) * flat.kappa + share * turning)
        except SolveFailedError:
            return None
        return found if np.isfinite(found).all() and not crosses_itself(found) else None

    for share in _SHARES:
        found = simple(share)
        if found is None:
            crossed = share
            continue
        if crossed is not None:
            yield from _halved(simple, crossed, share)
        crossed = None
        yield share, found


def _halved(
    simple: Callable[[float], ComplexArray | None], nearer: float, share: float
) -> Iterator[tuple[float, ComplexArray]]:
    """The simple boundary of least share that halving finds between one that crosses itself and one that is simple."""
    best = None
    for _ in range(_HALVINGS):
        middle = 0.5 * (nearer + share)
        found = simple(middle)
        if found is None:
            nearer = middle
        else:
            share, best = middle, (middle, found)
    if best is not None:
        yield best


def _from_map(flat: BoundaryFlattening, z: ComplexArray) -> Iterator[tuple[float, ComplexArray]]:
    """Boundaries between that which keeps its lengths and z (n,)."""
    edges = np.abs(np.roll(z, -1) - z)
    if (edges > 0.0).all():
        yield from boundaries_between(flat, np.log(edges / flat.lengths), turning_angles(z))


def _from_circle(flat: BoundaryFlattening) -> Iterator[tuple[float, ComplexArray]]:
    """Boundaries between that which keeps its lengths and a circle."""
    with suppress(SolveFailedError):
        factors, turning = flat.round_turning()
        yield from boundaries_between(flat, np.log(flat.scaled(factors) / flat.lengths), turning)


def evened(run: Run, parts: Parts, z: ComplexArray, most: int = 3) -> Iterator[Mapped]:
    """Maps with less range of scales than the free map z (V,), none of which overlaps itself; the evenest first.

    most: how many at the most from the map's own boundary, and from a circle. None where the boundary is longer than 6000
    vertices.
    """
    mesh, loop = run.mesh, run.boundary
    if len(loop) > LONGEST:
        return
    factor = eliminated(run, parts, loop)
    try:
        with run.clock.stage("even"):
            curvature = integrated_curvature(mesh.vertices, mesh.faces, loop, used_vertices(mesh), run.mollification)
            kappa = factor.reduce(curvature.astype(np.complex128)).real
            lengths = np.linalg.norm(mesh.vertices[np.roll(loop, -1)] - mesh.vertices[loop], axis=1)
            if not (lengths > 0.0).all():
                return
            flat = BoundaryFlattening(factor.schur, kappa, np.asarray(lengths, np.float64))
        for start, found in (("map", _from_map(flat, z[loop])), ("circle", _from_circle(flat))):
            for share, boundary in islice(found, most):
                details = {"interface": factor.record(), "evened": {"from": start, "share": share}}
                yield mapped_whole(run, parts, factor.extend(boundary), loop, details)
    finally:
        factor.release()
