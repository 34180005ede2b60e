"""LDM: the linear disk map of Choi and Lui (2018), a spherical map of the double cover of which one half is kept.

North-pole step: the most regular face is held on a similar triangle, and all else of the double cover is harmonic in the
plane. South-pole step: seen from the other pole, the 50 vertices nearest to it are held, and all else is harmonic once more;
the paper corrects by a quasi-conformal map there, whose generalized Laplacian is the double cover's own. A Moebius map and a
stereographic projection bring the boundary close to a circle; it is put on it, and one Laplace solve fills the inside.
"""

from __future__ import annotations

import numpy as np

from pgcp.errors import SolveFailedError
from pgcp.methods.base import Method, whole
from pgcp.methods.common.boundary_energy import goes_round_once
from pgcp.methods.common.kept import KeptDisk, as_mapped, first_of, most_regular_face
from pgcp.methods.flash import balanced, similar_triangle
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts
from pgcp.plane.mobius import to_sphere
from pgcp.surface.topology import used_vertices
from pgcp.types import BoolArray, ComplexArray

HELD, MORE, MOST_TRIALS = 50, 5, 4


def from_north(run: Run, parts: Parts, pole: int) -> ComplexArray:
    """The north-pole step: positions (2, V) of both copies in the plane, the face ``pole`` of the first around infinity."""
    mesh, loop = run.mesh, run.boundary
    face, used = mesh.faces[pole], used_vertices(mesh)
    held, values = np.zeros((2, len(mesh.vertices)), bool), np.zeros((2, len(mesh.vertices)), np.complex128)
    held[0, face], values[0, face] = True, similar_triangle(mesh.vertices[face])
    disk = KeptDisk(run, parts, face)
    z = np.stack([disk.extend(copy) for copy in disk.doubled(held, values)])
    disk.release()
    inner = used.copy()
    inner[loop] = False
    z = z - np.concatenate([z[0, used], z[1, inner]]).mean()
    both = np.concatenate([mesh.faces, mesh.faces + len(mesh.vertices)])
    return balanced(z.reshape(-1), both, pole).reshape(2, -1)


def held_in_the_south(run: Run, z: ComplexArray, count: int) -> BoolArray:
    """Which vertices (2, V) of the double cover are held in the south-pole step: so many, those with the least |z|."""
    distance = np.where(used_vertices(run.mesh), np.abs(z), np.inf)
    distance[1, run.boundary] = np.inf
    held = np.zeros(z.size, bool)
    held[first_of(distance.reshape(-1), count)] = True
    return held.reshape(2, -1) & np.isfinite(distance)


def on_the_circle(w: ComplexArray) -> ComplexArray:
    """Points (n_B,) of the unit circle for a boundary w (n_B,), counter-clockwise around its inside, close to some circle.

    Three of its points on the sphere, the first, the farthest from that, and one between them, go by a Moebius map to a planar
    triangle congruent to theirs. The boundary is lifted to the sphere, its mean height taken off, projected to the plane, and
    seen from the middle of its extent. Where the order is lost so, as with few points, but is kept from the centre of the
    circle through the three, it is seen from there. Raises SolveFailedError where the boundary does not lie around the centre.
    """
    points = to_sphere(w)
    n = len(w)
    far = int(first_of(-np.linalg.norm(points - points[0], axis=1), 1)[0])
    between = far // 2 if far > 1 else (far + n) // 2
    three = np.array([0, far, between])
    width = float(np.linalg.norm(points[far] - points[0]))
    if not width > 0.0:
        raise SolveFailedError("LDM led to a boundary in one point")
    wanted = width * (similar_triangle(points[three]) - 0.5)
    # similar_triangle goes round anticlockwise; the boundary does, from the first by the one between to the farthest
    wanted = wanted.conj() if between < far else wanted
    z = _levelled(_moebius(w, w[three], wanted))
    middle = 0.5 * complex(z.real.min() + z.real.max(), z.imag.min() + z.imag.max())
    if not goes_round_once(z - middle) and goes_round_once(z - _circumcentre(z[three])):
        middle = _circumcentre(z[three])
    size = np.abs(z - middle)
    if not (np.isfinite(size).all() and (size > 0.0).all()):
        raise SolveFailedError("LDM led to a boundary that is not around the centre of the disk")
    return (z - middle) / size


def _moebius(w: ComplexArray, given: ComplexArray, wanted: ComplexArray) -> ComplexArray:
    """The Moebius image of w (n,) that takes three given points to wanted ones."""
    (a, b, c), (p, q, r) = given, wanted
    above, below = (w - a) * (b - c), (w - c) * (b - a)
    ratio = (q - r) / (q - p)
    out: ComplexArray = (p * ratio * below - r * above) / (ratio * below - above)
    return out


def _levelled(q: ComplexArray) -> ComplexArray:
    """A boundary q (n_B,) on the sphere, moved along the axis to the mean height 0, and back in the plane."""
    square = np.abs(q) ** 2
    height = (square - 1.0) / (square + 1.0)
    z: ComplexArray = 2.0 * q / (1.0 + square) / (1.0 - (height - height.mean()))
    return z


def _circumcentre(three: ComplexArray) -> complex:
    """Centre of the circle through three points."""
    one, other = three[1] - three[0], three[2] - three[0]
    across = one.conjugate() * other - one * other.conjugate()
    return complex(three[0] + one * other * (one - other).conjugate() / across) if across != 0.0 else complex(three.mean())


def _map(run: Run, parts: Parts) -> Mapped:
    mesh = run.mesh
    z = from_north(run, parts, most_regular_face(mesh))
    w = z / np.maximum(np.abs(z), np.finfo(float).tiny ** 0.5) ** 2
    count = HELD
    for trial in range(MOST_TRIALS):
        held = held_in_the_south(run, z, count)
        disk = KeptDisk(run, parts, np.flatnonzero(held.any(axis=0)))
        try:
            on_loop = disk.doubled(held, w)[0][: len(disk.loop)]
        except SolveFailedError:
            disk.release()
            if trial == MOST_TRIALS - 1:
                raise
            count *= MORE
            continue
        break
    out = disk.within(on_the_circle(on_loop))
    record = disk.release()
    if not np.isfinite(out).all():
        raise SolveFailedError("LDM led to positions that are not finite")
    out[run.boundary] /= np.abs(out[run.boundary])
    return as_mapped(run, parts, out, run.boundary, record, pinned=int(held.sum()))


METHOD = Method(
    name="ldm",
    targets=("disk",),
    summary="linear disk map: the double cover harmonic on the sphere from both poles, one half of it to the disk",
    guarantees="the same map for any cuts; no folds promised",
    reference="Choi, Lui 2018 (LDM)",
    mapper=whole(_map),
    moebius="none",
)
