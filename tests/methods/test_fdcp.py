"""FDCP: its parts, a cap that is mapped as it should be, the same for any cuts, and the authors' own figures."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import cap, grid, lifted
from oracles import moebius_distance

import pgcp
from pgcp.methods.common.boundary_energy import angles_by_length
from pgcp.methods.fdcp import coefficients_of_inverse, least_bent_edge
from pgcp.surface.beltrami import folded_faces
from pgcp.types import Mesh

PEERS = {"chinese_lion_head": (1.419, 2.04), "human_face": (1.210, 1.83)}


def _plane(result):
    return result.coordinates @ [1, 1j]


def test_boundary_goes_by_its_lengths():
    square = np.array([(0, 0, 0), (2, 0, 0), (2, 1, 0), (0, 1, 0)], float)
    assert angles_by_length(square) == pytest.approx(np.pi * np.array([0, 2, 3, 5]) / 3)


def test_the_coefficient_of_the_inverse_is_that_of_the_affine_map_back():
    mesh = grid(5, jitter=0.4)
    w = mesh.vertices @ [1, 1j, 0]
    k = 0.3 - 0.4j
    back = (w - k * w.conj()) / (1 - abs(k) ** 2)  # z with z + k conj(z) = w
    turned = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]])
    for vertices in (mesh.vertices, mesh.vertices @ turned):
        assert np.abs(coefficients_of_inverse(Mesh(vertices, mesh.faces), back) - k).max() < 1e-13
    flat = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    assert coefficients_of_inverse(flat, w[:3]).tolist() == [0]


def test_the_edge_of_least_distortion_is_where_the_map_was_left_alone():
    mesh = grid(6)
    z = mesh.vertices @ [1, 1j, 0]
    loop = np.concatenate([np.arange(0, 42, 7), np.arange(42, 48), np.arange(48, 6, -7), np.arange(6, 0, -1)])
    z = z + 0.2 * np.maximum(np.abs(z - 0.6) - 0.25, 0) * z.conj()
    edge = least_bent_edge(mesh, loop, z)
    assert np.abs(z[loop[[edge, (edge + 1) % len(loop)]]] - 0.6).max() < 0.25


@pytest.mark.parametrize("name", ["fdcp", "ldm"])
def test_a_cap_is_mapped_conformally_whatever_the_cuts(name):
    mesh, exact = cap(16)
    one, other = (pgcp.parameterize(mesh, method=name, target="disk", patches=p) for p in (1, 4))
    assert moebius_distance(_plane(one), exact / np.abs(exact).max()) < 2e-3
    assert np.abs(_plane(one) - _plane(other)).max() < 1e-9
    assert one.quality.folds == 0
    assert np.abs(np.abs(_plane(one)[-96:]) - 1).max() < 1e-15


@pytest.mark.parametrize("name", ["fdcp", "ldm"])
def test_cuts_do_not_matter_on_a_surface_with_hills_either(name):
    mesh = lifted(grid(20), 0.5)
    one, other = (_plane(pgcp.parameterize(mesh, method=name, target="disk", patches=p)) for p in (1, 5))
    assert np.abs(one - other).max() < 1e-9


def test_the_best_iterate_is_kept():
    result = pgcp.parameterize(lifted(grid(12, jitter=0.4), 0.8), method="fdcp", target="disk", patches=1)
    values = [step["mean_mu"] for step in result.report["iterations"]]
    assert len(values) >= 2
    assert result.quality.mu_mean == pytest.approx(min(values), rel=1e-9)


@pytest.mark.parametrize("name", ["fdcp", "ldm"])
@pytest.mark.parametrize("mesh", [grid(1), grid(2), grid(5)], ids=["1", "2", "5"])
def test_small_squares_are_mapped_without_folds(mesh, name):
    result = pgcp.parameterize(mesh, method=name, target="disk", patches=1)
    assert len(folded_faces(mesh.faces, _plane(result))) == 0


@pytest.mark.parametrize("name", ["fdcp", "ldm"])
def test_other_targets_are_refused(name):
    with pytest.raises(pgcp.InputError, match=f"the method {name} is one for the target disk, not free"):
        pgcp.parameterize(grid(3), method=name, target="free")


@pytest.mark.parametrize("name", PEERS)
def test_the_figures_of_the_authors_program(name, mesh_folder):
    """shared/meshes/PEERS.md, to 1 %."""
    mesh = pgcp.read_mesh(mesh_folder / "open" / f"{name}.ply")
    quality = pgcp.parameterize(mesh, method="fdcp", patches=2).quality
    assert quality.folds == 0
    assert (quality.angle_mean_deg, quality.angle_sd_deg) == pytest.approx(PEERS[name], rel=0.01)
