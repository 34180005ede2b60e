"""FFGCM: the Gauss map, the curves it descends along, spheres and spheroids that are known, and figures."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import cap, icosphere, spheroid
from oracles import moebius_distance

import pgcp
from pgcp.methods import ffgcm
from pgcp.methods.common.sphere_descent import centred, descend_on_sphere, moved_along, state_of
from pgcp.methods.ffgcm import gauss_map, vertex_weights
from pgcp.plane.mobius import boost
from pgcp.surface.operators import cotangent_laplacian
from pgcp.types import Mesh


def _unit(seed, n=30):
    x = np.random.default_rng(seed).normal(size=(n, 3))
    return x / np.linalg.norm(x, axis=1)[:, None]


def test_normals_of_a_sphere_are_its_points():
    mesh = icosphere(3)
    assert np.abs(gauss_map(mesh) - mesh.vertices).max() < 0.01
    flat = Mesh(np.zeros((4, 3)), np.array([[0, 1, 2]]))
    assert np.array_equal(gauss_map(flat), np.tile([0, 0, 1.0], (4, 1)))


def test_weights_are_shares_of_the_area():
    mesh = spheroid(2, 2.0)[0]
    weights = vertex_weights(mesh)
    assert weights.sum() == pytest.approx(1)
    assert np.abs(weights @ mesh.vertices).max() < 1e-12
    doubled = Mesh(mesh.vertices * 2, mesh.faces)
    assert np.abs(vertex_weights(doubled) - weights).max() < 1e-16


def test_the_curve_stays_on_the_sphere_and_leaves_against_the_gradient_along_it():
    points, gradient = _unit(0), np.random.default_rng(1).normal(size=(30, 3))
    for step in (1e-3, 0.5, 40.0):
        assert np.abs(np.linalg.norm(moved_along(points, gradient, step), axis=1) - 1).max() < 1e-14
    along = gradient - (points * gradient).sum(axis=1)[:, None] * points
    ahead, behind = moved_along(points, gradient, 1e-5), moved_along(points, gradient, -1e-5)
    assert np.abs((ahead - behind) / 2e-5 + along).max() < 1e-8


def test_energy_and_gradient_are_those_of_finite_differences():
    mesh = icosphere(1)
    laplacian = cotangent_laplacian(mesh.vertices * [1, 2, 1], mesh.faces)
    points, rng = _unit(3, len(mesh.vertices)), np.random.default_rng(4)
    now, move = state_of(laplacian, points), rng.normal(size=points.shape)
    move -= (move * points).sum(axis=1)[:, None] * points
    ahead, behind = (state_of(laplacian, points + t * move).energy for t in (1e-5, -1e-5))
    assert (ahead - behind) / 2e-5 == pytest.approx((now.along * move).sum(), rel=1e-7)
    assert now.size == pytest.approx(np.linalg.norm(now.along))


def test_points_are_centred_by_a_moebius_map():
    mesh = icosphere(3)
    weights = vertex_weights(mesh)
    away = boost(mesh.vertices, np.array([0.5, 0.2, -0.4]))
    back = centred(away, weights)
    assert np.linalg.norm(weights @ away) > 0.5
    assert np.linalg.norm(weights @ back) < 1e-3
    assert moebius_distance(back, mesh.vertices) < 1e-6


def test_the_descent_ends_at_the_harmonic_map():
    mesh, exact = spheroid(2, 1.4)
    laplacian = cotangent_laplacian(mesh.vertices, mesh.faces)
    found = descend_on_sphere(laplacian, gauss_map(mesh), vertex_weights(mesh))
    energies = np.array(found.steps)[:, 0]
    assert energies[-1] == pytest.approx(energies.min(), rel=1e-6)
    assert energies[-1] < state_of(laplacian, exact).energy
    assert found.steps[-1][1] < 0.02 * found.steps[0][1]
    assert found.converged
    assert len(descend_on_sphere(laplacian, gauss_map(mesh), vertex_weights(mesh), 5).steps) == 6


@pytest.mark.parametrize("length", [1.0, 1.5, 0.6])
def test_spheroids_are_mapped_conformally_whatever_the_cuts(length):
    mesh, exact = spheroid(3, length)
    one, other = (pgcp.parameterize(mesh, method="ffgcm", patches=p) for p in (2, 5))
    assert moebius_distance(one.coordinates, exact) < 0.02
    assert one.quality.folds == 0
    assert np.abs(one.coordinates - other.coordinates).max() < 1e-9


def test_where_normals_lead_to_folds_the_descent_starts_from_a_harmonic_map(monkeypatch):
    mesh, exact = spheroid(3, 1.5)
    monkeypatch.setattr(ffgcm, "gauss_map", lambda mesh: -gauss_map(mesh))
    one, other = (pgcp.parameterize(mesh, method="ffgcm", patches=p) for p in (2, 5))
    assert {step["method"] for step in one.report["iterations"]} == {"ffgcm, harmonic"}
    assert moebius_distance(one.coordinates, exact) < 0.02
    assert one.quality.folds == 0
    assert np.abs(one.coordinates - other.coordinates).max() < 1e-9


def test_open_surfaces_are_not_for_it():
    with pytest.raises(pgcp.InputError, match="sphere"):
        pgcp.parameterize(cap(3)[0], method="ffgcm", target="sphere")


def test_without_a_target_the_refusal_says_what_the_method_maps_to():
    with pytest.raises(pgcp.InputError, match="the method maps to the sphere only; use a method with the target free or disk"):
        pgcp.parameterize(cap(3)[0], method="ffgcm")


def test_the_report_has_the_conformal_energy():
    result = pgcp.parameterize(spheroid(2, 1.2)[0], method="ffgcm", patches=2)
    assert abs(result.report["iterations"][-1]["energy"]) < 0.5


def test_a_real_mesh_has_smaller_errors_than_by_flash(mesh_folder):
    """shared/meshes/PEERS.md."""
    quality = pgcp.parameterize(pgcp.read_mesh(mesh_folder / "closed" / "spot.ply"), method="ffgcm").quality
    assert quality.folds == 0
    assert quality.angle_mean_deg < 0.9 * 3.306
