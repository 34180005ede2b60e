"""FDCP: the fast disk conformal map of Choi and Lui (2015), in two steps, from one end of the disk and from the other.

North-pole step: the disk goes to the half-plane with a boundary edge of little distortion at infinity; the fifth of the
vertices nearest to it is held, all else is harmonic, its boundary sliding along the real line. South-pole steps, up to five:
the mirror image at 1 / conj(z) of what lies nearest the centre is held, all else of the double cover is harmonic, and the
boundary goes radially to the circle. The iterate of least mean |mu| is kept; on rough surfaces later ones wander about it, and
the authors' code ends with the last. The paper composes with quasi-conformal maps whose coefficients are those of the
inverse; their generalized Laplacian is the cotangent Laplacian of the surface itself. For the mirror image the authors' code
takes a mean of coefficients; the double cover's own Laplacian needs none.
"""

from __future__ import annotations

import numpy as np

from pgcp.errors import SolveFailedError
from pgcp.methods.base import Method, whole
from pgcp.methods.common.boundary_energy import angles_by_length, on_circle
from pgcp.methods.common.kept import KeptDisk, as_mapped, first_of, harmonic, rim_of
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts
from pgcp.plane.space import PLANE, map_coefficients
from pgcp.surface.topology import used_vertices
from pgcp.types import ComplexArray, IntArray, Mesh

NORTH, SOUTH, FEWEST = 5, 100, 100
TOLERANCE = 1e-5
ITERATIONS = 5


def coefficients_of_inverse(mesh: Mesh, z: ComplexArray) -> ComplexArray:
    """Beltrami coefficient (F,), in the plane's coordinate, of the map from z (V,) to each face; 0 where there is no area."""
    corners, image = mesh.vertices[mesh.faces], z[mesh.faces]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(one, axis=1)
    across = np.linalg.norm(np.cross(one, other), axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        third = ((one * other).sum(axis=1) + 1j * across) / length
        e, g = image[:, 1] - image[:, 0], image[:, 2] - image[:, 0]
        mu: ComplexArray = (e * third - g * length) / (length * g.conj() - third * e.conj())
    return np.where(np.isfinite(mu), mu, 0.0)


def least_bent_edge(mesh: Mesh, loop: IntArray, z: ComplexArray) -> int:
    """Place in the loop (n_B,) of the tail of the boundary edge with least |mu|, of mean coefficients at its two ends."""
    mu = np.repeat(coefficients_of_inverse(mesh, z), 3)
    flat, n = mesh.faces.reshape(-1), len(z)
    faces_at = np.maximum(np.bincount(flat, minlength=n), 1)
    mean = np.hypot(np.bincount(flat, mu.real, n), np.bincount(flat, mu.imag, n))[loop] / faces_at[loop]
    return int(first_of(mean + np.roll(mean, -1), 1)[0])


def _north(run: Run, parts: Parts, z: ComplexArray) -> ComplexArray:
    """The north-pole step on a disk map z (V,): positions (V,) in the disk again."""
    mesh, loop = run.mesh, run.boundary
    edge = least_bent_edge(mesh, loop, z)
    ends = loop[[edge, (edge + 1) % len(loop)]]
    middle = z[ends].sum()
    z = z * (middle.conjugate() / abs(middle))
    used = used_vertices(mesh)
    near = first_of(np.where(used, -z.real, np.inf), _share(int(used.sum()), NORTH))
    held = np.zeros(len(z), bool)
    held[near] = True
    held[loop] = False
    half = _to_half_plane(z)
    disk = KeptDisk(run, parts, rim_of(held, mesh.faces))
    along_line = np.isin(disk.kept, loop)
    still, there = held[disk.kept], half[disk.kept]
    x = harmonic(disk.schur, still | np.isin(disk.kept, ends), there.real.astype(np.complex128)).real
    y = harmonic(disk.schur, still | along_line, np.where(along_line, 0.0, there.imag).astype(np.complex128)).real
    moved = disk.extend(x + 1j * y)
    moved[held] = half[held]
    disk.release()
    return (moved - 1j) / (moved + 1j)


def _share(count: int, part: int) -> int:
    """How many of so many vertices are held: one in ``part``, 100 at least where there are as many."""
    return max(count // part, min(FEWEST, count))


def _to_half_plane(z: ComplexArray) -> ComplexArray:
    """The Cayley map of the disk (V,) to the upper half-plane, 1 to infinity."""
    away = 1.0 - z
    smallest = np.finfo(float).tiny ** 0.5
    return 1j * (1.0 + z) / np.where(np.abs(away) > smallest, away, smallest)


def _south(run: Run, parts: Parts, z: ComplexArray) -> tuple[ComplexArray, dict[str, object] | None]:
    """One south-pole step on a disk map z (V,), and what the report says of its elimination."""
    mesh, loop = run.mesh, run.boundary
    used = used_vertices(mesh)
    size = np.where(used, np.abs(z), np.inf)
    count = _share(2 * int(used.sum()) - len(loop), SOUTH)
    held = np.zeros((2, len(z)), bool)
    # farthest out in the double are the mirror images of what is nearest to the centre; those on the circle come last
    size[loop] = np.maximum(size[loop], 1.0)
    held[1, first_of(size, min(count, int(used.sum())))] = True
    disk = KeptDisk(run, parts, rim_of(held[1], mesh.faces))
    tiny = np.finfo(float).tiny ** 0.5
    values = np.stack([z, z / np.maximum(np.abs(z), tiny) ** 2])
    # a boundary vertex is one of both copies
    held[0, loop] = held[1, loop]
    moved = disk.extend(disk.doubled(held, values)[0])
    moved = moved - moved[used].mean()
    size_on_loop = np.abs(moved[loop])
    if not (np.isfinite(moved).all() and (size_on_loop > 0.0).all()):
        raise SolveFailedError("FDCP led to a boundary that is not around the centre of the disk")
    out = disk.within(moved[loop] / size_on_loop)
    return out, disk.release()


def _map(run: Run, parts: Parts) -> Mapped:
    mesh, loop = run.mesh, run.boundary
    plain = KeptDisk(run, parts, np.empty(0, np.int64))
    with run.clock.stage("map"):
        z = plain.within(on_circle(angles_by_length(mesh.vertices[loop])))
    record = plain.release()
    z = best = _checked(_north(run, parts, z))
    bent = [_bent(run, z)]
    change = np.inf
    while change > TOLERANCE and len(bent) <= ITERATIONS:
        z, record = _south(run, parts, z)
        bent.append(_bent(run, _checked(z)))
        change = abs(bent[-1] - bent[-2])
        if bent[-1] == min(bent):
            best = z
    best[loop] /= np.abs(best[loop])
    iterations = [{"method": "fdcp", "iteration": k, "mean_mu": value} for k, value in enumerate(bent)]
    return as_mapped(run, parts, best, loop, record, iterations=iterations, converged=bool(change <= TOLERANCE))


def _checked(z: ComplexArray) -> ComplexArray:
    """Positions that are finite; raises SolveFailedError elsewhere."""
    if not np.isfinite(z).all():
        raise SolveFailedError("FDCP led to positions that are not finite")
    return z


def _bent(run: Run, z: ComplexArray) -> float:
    """Mean |mu| of a disk map."""
    return float(np.abs(map_coefficients(PLANE, run.mesh, run.mesh.faces, z)).mean())


METHOD = Method(
    name="fdcp",
    targets=("disk",),
    summary="fast disk conformal map: harmonic in the half-plane, then on the double cover, up to five times",
    guarantees="the same map for any cuts; no folds promised",
    reference="Choi, Lui 2015 (FDCP)",
    mapper=whole(_map),
    moebius="none",
)
