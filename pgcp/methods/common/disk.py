"""The frame of disk methods that work on the boundary of the undivided mesh."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from pgcp.elimination.sparse_boundary import Make, SparseFactor, sparse_solver, stays_sparse
from pgcp.interface.factor import InterfaceFactor
from pgcp.interface.whole_mesh import eliminated
from pgcp.methods.common.boundary_energy import EnergyMap, angles_by_length, plain_steps
from pgcp.methods.common.double_cover import central_face, harmonic_boundary, late_heat, start_angles
from pgcp.methods.common.kept import as_mapped
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts
from pgcp.surface.operators import cotangent_laplacian
from pgcp.surface.topology import used_vertices
from pgcp.types import ComplexArray, FloatArray, IntArray

BoundaryFactor = InterfaceFactor | SparseFactor


@dataclass(frozen=True, slots=True, eq=False)
class Disk:
    """A surface to be mapped to the disk: its run, boundary loop (n_B,), the Laplacian's factor on it, and the central face."""

    run: Run
    loop: IntArray
    factor: BoundaryFactor
    centre: int

    def starts(self) -> tuple[FloatArray, ...]:
        """The starts (n_B,) of CEM: that of the double cover, and the boundary by its length; one alone where it is exact."""
        mesh = self.run.mesh
        first = self.start_angles()
        return (first,) if len(mesh.faces) == 1 else (first, angles_by_length(mesh.vertices[self.loop]))

    def start_angles(self) -> FloatArray:
        """Boundary angles (n_B,) of the harmonic map of the double cover, increasing through one turn; exact for one face."""
        mesh = self.run.mesh
        if len(mesh.faces) == 1:
            return inscribed(mesh.vertices[self.loop])
        return start_angles(harmonic_boundary(mesh.vertices, mesh.faces[self.centre], self.factor))

    def boundary_block(self) -> csr_array:
        """The rows and columns of the Laplacian (n_B, n_B) at boundary vertices."""
        mesh = self.run.mesh
        near = np.zeros(len(mesh.vertices), bool)
        near[self.loop] = True
        faces = mesh.faces[near[mesh.faces].any(axis=1)]
        return csr_array(cotangent_laplacian(mesh.vertices, faces, self.run.mollification)[self.loop][:, self.loop])


def inscribed(corners: FloatArray) -> FloatArray:
    """Angles (3,), the first 0, of a triangle (3, 3) inscribed in the unit circle: each arc is twice the angle that sees it."""
    one, other = np.roll(corners, -1, axis=0) - corners, np.roll(corners, 1, axis=0) - corners
    seen = np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), (one * other).sum(axis=1))
    return np.array([0.0, 2.0 * seen[2], 2.0 * (seen[2] + seen[0])])


@dataclass(frozen=True, slots=True, eq=False)
class DiskMap:
    """Positions z (V,) in the closed unit disk, and what the report says of how they were found."""

    z: ComplexArray
    details: dict[str, Any]


def of_energy(found: EnergyMap) -> DiskMap:
    """The map of a descent on the conformal energy, with its iterations."""
    return DiskMap(found.z, {"iterations": plain_steps(found.steps), "converged": found.converged})


def boundary_factor(run: Run, parts: Parts, make: Make | None = None) -> BoundaryFactor:
    """The Laplacian, boundary last; sparse where the boundary is not small beside the interior, or a solver is given."""
    mesh, loop = run.mesh, run.boundary
    if make is None and not stays_sparse(len(loop), len(mesh.vertices)):
        return eliminated(run, parts, loop)
    with run.clock.stage("eliminate"):
        laplacian = cotangent_laplacian(mesh.vertices, mesh.faces, run.mollification)
        return SparseFactor(laplacian, loop, used_vertices(mesh), make or sparse_solver)


def map_disk(run: Run, parts: Parts, find: Callable[[Disk], DiskMap], make: Make | None = None) -> Mapped:
    """Eliminate the mesh up to its boundary, have ``find`` map it, and see what became of the patches.

    make: what makes solvers of the undivided mesh's sparse systems, where these are to take the place of the elimination.
    """
    mesh, loop = run.mesh, run.boundary
    factor = boundary_factor(run, parts, make)
    with run.clock.stage("centre"):
        centre = central_face(mesh.vertices, mesh.faces, late_heat(loop, used_vertices(mesh), factor))
    with run.clock.stage("map"):
        found = find(Disk(run, loop, factor, centre))
    record = factor.record()
    factor.release()
    return as_mapped(run, parts, found.z, loop, record, **found.details)
