"""BFF: boundary first flattening (Sawhney, Crane 2018).

The boundary is found first, from scale factors or turning angles and the Dirichlet-to-Neumann operator; the inside is harmonic.
A closed surface is opened at the faces around one vertex, flattened to the disk and closed on the sphere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pgcp.errors import InputError
from pgcp.interface.factor import InterfaceFactor
from pgcp.interface.puncture import puncture_face, straightened
from pgcp.interface.whole_mesh import eliminated
from pgcp.methods.base import Method, OwnOption, whole
from pgcp.methods.common.boundary_first import BoundaryFlattening, integrated_curvature
from pgcp.methods.common.disk import BoundaryFactor, boundary_factor
from pgcp.methods.common.harmonic import mapped_whole
from pgcp.methods.common.prescribed import ANGLES, LENGTHS, of_boundary, read_lengths, read_turning
from pgcp.options import AUTO, Options
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts
from pgcp.plane.mobius import balance_sphere, sphere_points
from pgcp.surface.operators import cotangent_laplacian, face_areas
from pgcp.surface.topology import loops_of, used_vertices
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray, Mesh

_ISOMETRIC, _DISK = "isometric", "disk"
_READ = {ANGLES: read_turning, LENGTHS: read_lengths}


def _boundary(value: str) -> tuple[str, IntArray | FloatArray]:
    """The word of the option, and what its file holds; raises InputError where it is none, or the file's form is wrong."""
    word, path = of_boundary(value, (AUTO, _ISOMETRIC, _DISK), tuple(_READ))
    return word, np.empty(0) if path is None else _READ[word](path)


def _meant(options: Options) -> Options:
    """The target that a boundary is one for; raises InputError where another is asked for."""
    word = str(options.own["boundary"]).partition(":")[0]
    if word == AUTO:
        return options
    target = "disk" if word == _DISK else "free"
    if options.target not in (AUTO, target):
        raise InputError(f"the boundary {word} is one for the target {target}, not {options.target}")
    if word in _READ and options.fix:
        raise InputError(
            f"{options.own['boundary']}: the file names vertices that --fix may renumber; map the mesh that it writes"
        )
    return replace(options, target=target)


def _edge_lengths(mesh: Mesh, loop: IntArray) -> FloatArray:
    return np.asarray(np.linalg.norm(mesh.vertices[np.roll(loop, -1)] - mesh.vertices[loop], axis=1), np.float64)


def _map(run: Run, parts: Parts) -> Mapped:
    return _map_closed(run, parts) if run.is_closed else _map_open(run, parts)


def _map_open(run: Run, parts: Parts) -> Mapped:
    mesh, loop = run.mesh, run.boundary
    word, path = of_boundary(run.options.own["boundary"], (AUTO, _ISOMETRIC, _DISK), tuple(_READ))
    prescribed = np.empty(0) if path is None else _READ[word](path, loop)
    factor = boundary_factor(run, parts)
    with run.clock.stage("map"):
        curvature = integrated_curvature(mesh.vertices, mesh.faces, loop, used_vertices(mesh), run.mollification)
        kappa = factor.reduce(curvature.astype(np.complex128)).real
        flat = BoundaryFlattening(factor.schur, kappa, _edge_lengths(mesh, loop))
        if run.target.name == _DISK:
            z = flat.on_circle()
        elif word == ANGLES:
            z = flat.with_turning(prescribed)
        elif word == LENGTHS:
            z = flat.with_lengths(prescribed)
        else:
            z = flat.isometric()
        z = factor.extend(z)
    return _finished(run, parts, factor, loop, z)


def _finished(run: Run, parts: Parts, factor: BoundaryFactor, kept: IntArray, points: ComplexArray | FloatArray) -> Mapped:
    record = factor.record()
    factor.release()
    return mapped_whole(run, parts, points, kept, {"interface": record})


@dataclass(frozen=True, slots=True, eq=False)
class Star:
    """The faces around a vertex: pole, and the ring (n,) around it, along the orientation of the rest; which faces (F,)."""

    pole: int
    ring: IntArray
    faces: BoolArray

    @property
    def kept(self) -> IntArray:
        """The ring, and last the pole."""
        return np.append(self.ring, self.pole)


def star_of(faces: IntArray, pole: int) -> Star:
    """The faces around a vertex of a closed surface, faces (F, 3)."""
    around = (faces == pole).any(axis=1)
    turned = faces[around]
    place = np.argmax(turned == pole, axis=1)
    rows = np.arange(len(turned))
    after, before = turned[rows, (place + 1) % 3], turned[rows, (place + 2) % 3]
    return Star(pole, loops_of(before.astype(np.int64), after.astype(np.int64))[0], around)


def _opened(run: Run, factor: InterfaceFactor, star: Star) -> BoundaryFlattening:
    """The surface without its star, on the ring: the closed surface's operator and load, less what the star adds."""
    mesh, ring = run.mesh, star.ring
    rest, count = mesh.faces[~star.faces], len(ring)
    used = used_vertices(mesh)
    used[star.pole] = False
    curvature = integrated_curvature(mesh.vertices, rest, ring, used, run.mollification)
    kappa = factor.reduce(curvature.astype(np.complex128)).real[:count]
    own = cotangent_laplacian(mesh.vertices, mesh.faces[star.faces], run.mollification)[ring][:, ring].toarray()
    return BoundaryFlattening(factor.schur[:count, :count] - own, kappa, _edge_lengths(mesh, ring))


def _map_closed(run: Run, parts: Parts) -> Mapped:
    mesh = run.mesh
    star = star_of(mesh.faces, int(mesh.faces[puncture_face(mesh)][0]))
    factor = eliminated(run, parts, star.kept)
    with run.clock.stage("map"):
        on_ring = _opened(run, factor, star).on_circle()
        z = factor.extend(np.append(on_ring, 0.0))
    with run.clock.stage("close"):
        beyond = used_vertices(mesh)
        beyond[star.kept] = False
        points = _on_sphere(mesh, straightened(mesh, z, beyond), star.pole)
    return _finished(run, parts, factor, star.kept, points)


def _on_sphere(mesh: Mesh, z: ComplexArray, pole: int) -> FloatArray:
    """Unit vectors (V, 3) of positions z (V,) in the disk, the pole at infinity, so that the surface's area is balanced."""
    areas = np.repeat(face_areas(mesh.vertices, mesh.faces), 3)
    weights = np.bincount(mesh.faces.reshape(-1), areas, len(mesh.vertices)).astype(np.float64)
    used = used_vertices(mesh)
    used[pole] = False
    points = np.tile([0.0, 0.0, 1.0], (len(mesh.vertices), 1))
    points[used], matrix = balance_sphere(z[used], weights[used])
    points[pole] = sphere_points(matrix[:1, 0], matrix[1:, 0])[0]
    return points


METHOD = Method(
    name="bff",
    targets=("free", "disk", "sphere"),
    summary="boundary first: scale factors or turning angles prescribed on the boundary, the inside harmonic",
    guarantees="the same map for any cuts; lengths of a free boundary kept as near as it closes; no folds promised",
    reference="Sawhney, Crane 2018 (BFF)",
    mapper=whole(_map),
    options=_meant,
    own=(
        OwnOption(
            "boundary",
            "isometric (keeps lengths), disk, angles:FILE (a vertex and the degrees it turns by a line) or lengths:FILE (two "
            "vertices and a length); auto: by the target",
            AUTO,
            metavar="WHICH",
            check=_boundary,
        ),
    ),
)
