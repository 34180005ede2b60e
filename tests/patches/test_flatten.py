from __future__ import annotations

import numpy as np
import pytest
from meshes import cap, grid, similarity_error

from pgcp.elimination.dirichlet import eliminate_interior
from pgcp.patches.flatten import conformal_energy_matrix, flatten_boundary
from pgcp.plane.natural import natural_boundary
from pgcp.surface.distortion import angle_errors
from pgcp.surface.operators import cotangent_laplacian
from pgcp.surface.topology import examine


def boundary_problem(mesh):
    loop = examine(mesh.faces, len(mesh.vertices)).loops[0]
    factor = eliminate_interior(cotangent_laplacian(mesh.vertices, mesh.faces), loop)
    return loop, factor


def test_the_energy_is_dirichlet_less_area(hills):
    loop, factor = boundary_problem(hills)
    z = np.random.default_rng(1).normal(size=(len(loop), 2)) @ [1, 1j]
    u = factor.extend(z)
    laplacian = cotangent_laplacian(hills.vertices, hills.faces)
    dirichlet = 0.5 * np.real(np.vdot(u, laplacian @ u))
    area = 0.5 * np.imag(np.vdot(z, np.roll(z, -1)))
    energy = 0.5 * np.vdot(z, conformal_energy_matrix(factor.schur) @ z)
    assert energy.imag == pytest.approx(0.0, abs=1e-9)
    assert energy.real == pytest.approx(dirichlet - area, rel=1e-12)


def full_dncp(mesh, loop, pins, values):
    """PGCP eq. 4.10 as printed: the 2n x 2n system."""
    n = len(mesh.vertices)
    laplacian = cotangent_laplacian(mesh.vertices, mesh.faces).toarray()
    system = np.zeros((2 * n, 2 * n))
    system[:n, :n] = system[n:, n:] = laplacian
    for p, q in zip(loop, np.roll(loop, -1), strict=True):
        for row, column, sign in ((p, q + n, 1), (q + n, p, 1), (q, p + n, -1), (p + n, q, -1)):
            system[row, column] -= 0.5 * sign
    fixed = np.concatenate([pins, np.array(pins) + n])
    known = np.concatenate([np.real(values), np.imag(values)])
    free = np.setdiff1d(np.arange(2 * n), fixed)
    out = np.zeros(2 * n)
    out[fixed] = known
    out[free] = np.linalg.solve(system[np.ix_(free, free)], -system[np.ix_(free, fixed)] @ known)
    return out[:n] + 1j * out[n:]


def test_dncp_on_the_boundary_is_the_full_system_of_the_paper():
    mesh, _ = cap(6)
    loop, factor = boundary_problem(mesh)
    z = flatten_boundary(factor.schur, mesh.vertices[loop], "dncp")
    pins = [int(np.flatnonzero(z == 0)[0]), int(np.argmax(np.abs(z) * (z.imag == 0)))]
    full = full_dncp(mesh, loop, loop[pins], z[pins])
    assert np.abs(full - factor.extend(z)).max() < 1e-10 * np.abs(full).max()


@pytest.mark.parametrize("method", ["dncp", "scp"])
def test_a_planar_mesh_comes_back(method):
    mesh = grid(14, 9, jitter=0.4)
    loop, factor = boundary_problem(mesh)
    z = flatten_boundary(factor.schur, mesh.vertices[loop], method)
    assert similarity_error(z, mesh.vertices[loop] @ [1, 1j, 0]) < 1e-8


@pytest.mark.parametrize("method", ["dncp", "scp"])
def test_a_spherical_cap_is_flattened_conformally_and_its_natural_boundary_is_a_circle(method):
    """Angle errors fall at first order; the natural boundary meets the stereographic projection faster."""
    bends, errors = [], []
    for n in (6, 12, 24):
        mesh, exact = cap(n)
        loop, factor = boundary_problem(mesh)
        boundary = flatten_boundary(factor.schur, mesh.vertices[loop], method)
        z = factor.extend(boundary)
        bends.append(angle_errors(mesh, np.column_stack([z.real, z.imag])).mean())
        edges = np.column_stack([np.arange(len(loop)), np.roll(np.arange(len(loop)), -1)])
        lengths = np.linalg.norm(mesh.vertices[np.roll(loop, -1)] - mesh.vertices[loop], axis=1)
        natural = natural_boundary(boundary, edges, lengths, np.arange(len(loop)), np.arange(len(loop)))
        errors.append(similarity_error(factor.extend(natural), exact))
    assert np.log2(np.array(bends[:-1]) / bends[1:]).min() > 0.95
    assert np.log2(np.array(errors[:-1]) / errors[1:]).mean() > 1.2


def test_scp_is_the_smallest_mode(hills):
    loop, factor = boundary_problem(hills)
    z = flatten_boundary(factor.schur, hills.vertices[loop], "scp")
    step = np.linalg.norm(np.roll(hills.vertices[loop], -1, axis=0) - hills.vertices[loop], axis=1)
    mass = 0.5 * (step + np.roll(step, 1)) / step.sum()
    root = np.sqrt(mass)
    h = conformal_energy_matrix(factor.schur)
    values = np.linalg.eigvalsh(h / np.outer(root, root))
    centred = z - mass @ z
    quotient = np.real(np.vdot(centred, h @ centred)) / (mass @ np.abs(centred) ** 2)
    assert quotient == pytest.approx(values[1], rel=1e-6, abs=1e-10)
