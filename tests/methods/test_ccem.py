"""CEM and CCEM: the energy and its derivatives, descents that descend, maps that are known, the paper's own figures."""

from __future__ import annotations

import json

import numpy as np
import pytest
from descents import curvature, descend_by_gradient, descend_by_quasi_newton, heat, heat_matrix
from meshes import cap, grid, lifted
from oracles import moebius_distance

import pgcp
from pgcp.elimination.dirichlet import choose_backend, eliminate_interior
from pgcp.errors import SolveFailedError
from pgcp.methods.ccem import ccem_map, descend_in_order
from pgcp.methods.cem import cem_boundary, cem_map
from pgcp.methods.common.boundary_energy import (
    energy_and_gradient,
    goes_round_once,
    increasing_angles,
    on_circle,
    plain_steps,
)
from pgcp.methods.common.descent import FLAT, SUFFICIENT, QuasiNewton, wolfe_step
from pgcp.methods.common.double_cover import central_face, harmonic_boundary, late_heat, start_angles
from pgcp.plane.space import PLANE
from pgcp.surface.beltrami import folded_faces
from pgcp.surface.distortion import angle_errors, conformal_energy
from pgcp.surface.operators import cotangent_laplacian
from pgcp.surface.topology import examine
from pgcp.types import Mesh

DESCENTS = [descend_by_gradient, descend_by_quasi_newton, descend_in_order]
ROUGH = lifted(grid(20, jitter=0.45), 0.5)
BENT = lifted(grid(24), 1.0)
LONG = grid(4, 40)


class Problem:
    """What the descents need of a mesh."""

    def __init__(self, mesh, backend="superlu"):
        self.mesh = mesh
        self.laplacian = cotangent_laplacian(mesh.vertices, mesh.faces)
        self.loop = examine(mesh.faces, len(mesh.vertices)).loops[0]
        self.factor = eliminate_interior(self.laplacian, self.loop, backend)
        self.schur = self.factor.schur
        self.block = self.laplacian[self.loop][:, self.loop]

    def start(self, warmth=None):
        warmth = late_heat(self.loop, np.ones(len(self.mesh.vertices), bool), self.factor) if warmth is None else warmth
        face = self.mesh.faces[central_face(self.mesh.vertices, self.mesh.faces, warmth)]
        return start_angles(harmonic_boundary(self.mesh.vertices, face, self.factor))


def random_angles(n, seed=0):
    gaps = np.random.default_rng(seed).uniform(0.2, 1.8, n)
    return np.cumsum(gaps) * 2 * np.pi / gaps.sum()


def energies(steps, method="ccem"):
    return np.array([step.energy for step in steps if step.method == method])


def test_the_energy_is_dirichlet_less_area(hills):
    """CCEM eq. 3.4, 3.5, 3.17, and the sum of squares over the faces."""
    p = Problem(hills)
    angles = random_angles(len(p.loop))
    u = p.factor.extend(on_circle(angles))
    area = 0.5 * np.sin(np.diff(np.append(angles, angles[0] + 2 * np.pi))).sum()
    expected = 0.5 * np.vdot(u, p.laplacian @ u).real - area
    assert energy_and_gradient(p.schur, angles)[0] == pytest.approx(expected, rel=1e-12)
    assert conformal_energy(hills, u) == pytest.approx(expected, rel=1e-12)
    z = np.random.default_rng(0).normal(size=(len(u), 2)) @ [1, 1j]
    polygon = 0.5 * np.imag(np.vdot(z[p.loop], np.roll(z[p.loop], -1)))
    assert conformal_energy(hills, z) == pytest.approx(0.5 * np.vdot(z, p.laplacian @ z).real - polygon, rel=1e-12)


def test_the_energy_is_zero_for_conformal_maps_and_twice_the_area_for_mirror_images():
    mesh = grid(9, jitter=0.4)
    z = mesh.vertices @ [1, 1j, 0]
    assert conformal_energy(mesh, (2 - 3j) * z + 5) < 1e-28
    assert conformal_energy(mesh, z.conj()) == pytest.approx(2.0, rel=1e-12)
    flat = Mesh(np.vstack([mesh.vertices, [[2.0, 0, 0]]]), np.vstack([mesh.faces, [[0, 0, len(z)]]]))
    assert conformal_energy(flat, np.append(z.conj(), 9j)) == pytest.approx(2.0, rel=1e-12)


def test_gradient_and_curvature_are_those_of_finite_differences(hills):
    """CCEM eq. 4.1 and 4.5."""
    schur = Problem(hills).schur
    angles, step = random_angles(len(schur)), 1e-5
    _, gradient = energy_and_gradient(schur, angles)
    for k in range(0, len(schur), 7):
        ahead, behind = (energy_and_gradient(schur, angles + s * step * np.eye(len(schur))[k])[0] for s in (1, -1))
        assert (ahead - behind) / (2 * step) == pytest.approx(gradient[k], abs=1e-8)
    direction = np.random.default_rng(1).normal(size=len(schur))
    ahead, behind = (energy_and_gradient(schur, angles + s * step * direction)[1] @ direction for s in (1, -1))
    assert (ahead - behind) / (4 * step) == pytest.approx(curvature(schur, angles, direction), rel=1e-7)
    assert np.abs(energy_and_gradient(schur, angles)[1].sum()) < 1e-9 * np.abs(gradient).max()


@pytest.mark.parametrize("descend", DESCENTS)
@pytest.mark.parametrize("mesh", [ROUGH, BENT, LONG], ids=["rough", "bent", "long"])
def test_the_energy_falls_in_every_iteration(descend, mesh):
    p = Problem(mesh)
    for start in (p.start(), random_angles(len(p.loop))):
        found = descend(p.schur, start, 60)
        values = energies(found.steps)
        assert (np.diff(values) < 0).all()
        assert values[0] == pytest.approx(energy_and_gradient(p.schur, start)[0], rel=1e-13)
        assert values[-1] == pytest.approx(energy_and_gradient(p.schur, found.angles)[0], rel=1e-13)
        assert found.steps[-1].gradient_norm == pytest.approx(np.linalg.norm(energy_and_gradient(p.schur, found.angles)[1]))
        assert found.converged == (len(values) < 61) or values[-2] - values[-1] < 1e-7


def test_steps_satisfy_the_wolfe_conditions():
    """CCEM eq. 4.7 and 4.9, from first steps far too short and far too long."""
    p = Problem(ROUGH)
    x = p.start()

    def objective(angles):
        return energy_and_gradient(p.schur, angles)

    value, gradient = objective(x)
    slope = -gradient @ gradient
    for first in (1e-9, 1.0, 1e6):
        length, reached, new_gradient = wolfe_step(objective, x, -gradient, value, gradient, first)
        assert reached == objective(x - length * gradient)[0]
        assert reached <= value + SUFFICIENT * length * slope
        assert new_gradient @ -gradient >= FLAT * slope
    assert wolfe_step(objective, x, gradient, value, gradient, 1.0) is None


@pytest.mark.parametrize("descend", [descend_by_gradient, descend_by_quasi_newton])
def test_the_first_step_goes_to_the_least_point_of_the_quadratic(descend, hills):
    """CCEM eq. 4.6: -c_1 / (2 c_2)."""
    p = Problem(hills)
    _, gradient = energy_and_gradient(p.schur, p.start())
    expected = (gradient @ gradient) / (2 * curvature(p.schur, p.start(), -gradient))
    assert expected != pytest.approx(1.0, rel=0.1)
    found = descend(p.schur, p.start(), 1)
    assert found.steps[1].step == pytest.approx(expected, rel=1e-9)


def test_quasi_newton_directions_are_those_of_the_printed_recursion():
    """CCEM Algorithm 4.2 with H as a matrix."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(8, 8))
    hessian = root @ root.T + np.eye(8)
    rule = QuasiNewton()
    x = rng.normal(size=8)
    inverse = np.eye(8)
    before = None
    for k in range(6):
        gradient = hessian @ x
        direction = rule(x, gradient)
        if before is not None:
            s, y = x - before[0], gradient - before[1]
            if k == 1:
                inverse = np.eye(8) * (s @ s) / (y @ s)
            rho = 1 / (y @ s)
            left = np.eye(8) - rho * np.outer(s, y)
            inverse = left @ inverse @ left.T + rho * np.outer(s, s)
        assert np.abs(direction + inverse @ gradient).max() < 1e-10 * np.abs(direction).max()
        before = x, gradient
        x = x + 0.1 * direction


def test_a_pair_without_curvature_is_left_out():
    rule = QuasiNewton()
    rule(np.zeros(2), np.array([1.0, 0.0]))
    assert np.array_equal(rule(np.array([1.0, 0.0]), np.array([0.5, 2.0])), [-0.5, -2.0])


def test_all_descents_end_at_one_minimum():
    p = Problem(lifted(grid(10), 0.2))
    found = [descend(p.schur, p.start(), 5000, 1e-14) for descend in DESCENTS]
    values = np.array([energies(f.steps)[-1] for f in found])
    assert np.ptp(values) < 1e-9
    assert max(f.steps[-1].gradient_norm for f in found) < 1e-5
    assert len(found[1].steps) < len(found[0].steps) / 4
    assert len(found[2].steps) < len(found[0].steps) / 4


def test_a_spherical_cap_is_mapped_conformally():
    """The energy falls with the square of the edge length, to that of the exact map's linear interpolant."""
    values, errors = [], []
    for n in (6, 12, 24):
        mesh, exact = cap(n)
        p = Problem(mesh)
        exact /= np.abs(exact).max()
        found = ccem_map(p.factor, p.block, p.start())
        errors.append(moebius_distance(found.z, exact))
        values.append(conformal_energy(mesh, found.z))
        assert found.converged
        assert values[-1] == pytest.approx(found.steps[-1].energy, abs=1e-11)
        assert values[-1] <= conformal_energy(mesh, exact) + 1e-7
    assert np.log2(np.array(values[:-1]) / values[1:]).min() > 1.9
    assert max(errors) < 2e-3
    assert errors[2] < errors[0] / 4


def test_where_the_fixed_point_iteration_stalls_the_descent_goes_on():
    """On a bent square CEM is still falling when its iterations end; on strips it rises, or loses the boundary's order."""
    for mesh, last, rises in ((BENT, 20, False), (grid(10, 20), 20, True), (LONG, 1, True)):
        p = Problem(mesh)
        first = cem_map(p.factor, p.block, p.start())
        found = ccem_map(p.factor, p.block, p.start())
        assert not first.converged
        assert first.steps[-1].iteration == last
        values = energies(first.steps, "cem")
        assert (values[-1] > values.min()) == rises
        assert energies(found.steps)[0] == pytest.approx(values.min(), rel=1e-12)
        assert found.converged
        assert energies(found.steps)[-1] < 0.85 * values.min()
        assert conformal_energy(mesh, found.z) == pytest.approx(energies(found.steps)[-1], rel=1e-9)
        assert len(folded_faces(mesh.faces, found.z)) == 0


def test_cem_keeps_symmetry_and_ends_where_nothing_moves():
    mesh, exact = cap(2)
    p = Problem(mesh)
    start = increasing_angles(exact[p.loop])
    for iterations in (1, 5):
        found = cem_boundary(p.schur, p.block, start, iterations)
        z = on_circle(found.angles)
        assert np.abs(np.roll(z, -2) * z.conj() - np.exp(1j * np.pi / 3)).max() < 1e-13
    assert found.converged
    assert len(found.steps) == 2


def test_order_is_kept_where_the_angles_alone_would_lose_it():
    p = Problem(LONG)
    start = cem_boundary(p.schur, p.block, p.start()).angles
    lost = descend_by_quasi_newton(p.schur, start)
    assert not goes_round_once(on_circle(lost.angles))
    assert len(folded_faces(LONG.faces, p.factor.extend(on_circle(lost.angles)))) > 0
    kept = descend_in_order(p.schur, start)
    assert goes_round_once(on_circle(kept.angles))
    assert len(folded_faces(LONG.faces, p.factor.extend(on_circle(kept.angles)))) == 0


def test_a_boundary_that_shrinks_to_a_point_is_refused():
    """CCEM Lemma 5.1: the point has no energy; a start at random on a strip falls into it, a start close to it stays."""
    p = Problem(LONG)
    fallen = descend_in_order(p.schur, random_angles(len(p.loop)))
    assert energies(fallen.steps)[-1] < 1e-9
    with pytest.raises(SolveFailedError, match="shrank to one side"):
        ccem_map(p.factor, p.block, fallen.angles)


@pytest.mark.parametrize("descend", DESCENTS)
def test_the_map_is_a_disk_map_in_order(descend, hills):
    p = Problem(hills)
    z = ccem_map(p.factor, p.block, p.start(), descend).z
    assert goes_round_once(z[p.loop])
    assert z[p.loop[0]] == 1.0
    assert np.abs(np.abs(z[p.loop]) - 1).max() < 1e-15
    assert len(folded_faces(hills.faces, z)) == 0


def test_the_record_is_plain_data(hills):
    p = Problem(hills)
    found = ccem_map(p.factor, p.block, p.start(), iterations=3)
    rows = json.loads(json.dumps(plain_steps(found.steps)))
    assert [row["method"] for row in rows[-4:]] == ["ccem"] * 4
    assert [row["iteration"] for row in rows[-4:]] == [0, 1, 2, 3]
    assert rows[0]["method"] == "cem"
    assert set(rows[0]) == {"method", "iteration", "energy", "gradient_norm", "step"}
    assert [row["energy"] for row in rows] == [step.energy for step in found.steps]
    assert not found.converged


@pytest.mark.parametrize(("name", "printed"), [("chinese_lion_head", 0.0139), ("human_brain", 0.0209)])
def test_the_printed_energies(name, printed, mesh_folder):
    """CCEM Table 1: CEM to 20 iterations or 1e-6, Algorithm 4.1 to 20 iterations or 1e-7; unit circle, polygon's area."""
    mesh = pgcp.read_mesh(mesh_folder / "open" / f"{name}.ply")
    p = Problem(mesh, choose_backend())
    start = p.start(heat(eliminate_interior(heat_matrix(p.laplacian), p.loop, choose_backend())))
    found = ccem_map(p.factor, p.block, start, descend_by_gradient, iterations=20)
    assert round(conformal_energy(mesh, found.z), 4) == printed
    assert len(folded_faces(mesh.faces, found.z)) == 0
    best = ccem_map(p.factor, p.block, start)
    assert best.converged
    assert conformal_energy(mesh, best.z) <= conformal_energy(mesh, found.z)
    assert angle_errors(mesh, PLANE.coordinates(best.z)).mean() < 1.01 * angle_errors(mesh, PLANE.coordinates(found.z)).mean()
