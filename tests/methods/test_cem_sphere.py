"""CEM on the sphere: its energy, spheres and spheroids that are known, the same for any cuts, figures beside FLASH's."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import cap, icosphere, spheroid
from oracles import moebius_distance

import pgcp
from pgcp.methods.common.sphere_energy import SphereEnergy, seen_from_the_other_pole
from pgcp.plane.mobius import boost, to_sphere
from pgcp.surface.operators import corner_weights, cotangent_laplacian, face_areas
from pgcp.types import Mesh


def _bent_by_moebius(mesh):
    """A sphere whose vertices a Moebius map has moved."""
    return Mesh(boost(mesh.vertices, np.array([0.1, -0.2, 0.3])), mesh.faces)


def test_the_energy_is_dirichlet_less_area():
    mesh, image = spheroid(2, 1.7)
    energy = SphereEnergy(mesh.faces, corner_weights(mesh.vertices, mesh.faces))
    dirichlet = 0.5 * np.trace(image.T @ (cotangent_laplacian(mesh.vertices, mesh.faces) @ image))
    assert energy.of(image) == pytest.approx(dirichlet - face_areas(image, mesh.faces).sum(), abs=1e-11)
    assert abs(SphereEnergy(mesh.faces, corner_weights(image, mesh.faces)).of(image)) < 1e-12


def test_the_other_pole_shows_the_sphere_turned():
    z = np.array([0.5 + 1j, -2, 1e-3j, 0])
    w = seen_from_the_other_pole(z)
    assert np.abs(to_sphere(w) - to_sphere(z) * [1, -1, -1]).max() < 1e-14


@pytest.mark.parametrize("surface", [icosphere(3), _bent_by_moebius(icosphere(3)), spheroid(3, 1.5)[0]], ids=["0", "1", "2"])
def test_the_conformal_map_is_found_whatever_the_cuts(surface):
    exact = spheroid(3, 1.5)[1] if np.ptp(surface.vertices[:, 2]) > 2.5 else surface.vertices
    one, other = (pgcp.parameterize(surface, method="cem", patches=p) for p in (2, 5))
    assert one.target == "sphere"
    assert moebius_distance(one.coordinates, exact) < 0.01
    assert one.quality.folds == 0
    assert np.abs(one.coordinates - other.coordinates).max() < 1e-9


def test_energy_falls_and_the_least_is_kept():
    mesh = spheroid(3, 0.4)[0]
    result = pgcp.parameterize(mesh, method="cem", patches=2)
    values = np.array([step["energy"] for step in result.report["iterations"]])
    assert (np.diff(values)[:-1] < 0).all()
    assert values.min() < 0.05 * values[0]
    energy = SphereEnergy(mesh.faces, corner_weights(mesh.vertices, mesh.faces))
    assert energy.of(result.coordinates) == pytest.approx(values.min(), rel=1e-6)


def test_open_surfaces_are_not_for_the_sphere():
    with pytest.raises(pgcp.InputError, match="sphere"):
        pgcp.parameterize(cap(3)[0], method="cem", target="sphere")


@pytest.mark.parametrize(("name", "flash"), [("david_head", 0.912), ("max_planck", 0.945)])
def test_real_meshes_have_smaller_errors_than_by_flash(name, flash, mesh_folder):
    """shared/meshes/PEERS.md."""
    quality = pgcp.parameterize(pgcp.read_mesh(mesh_folder / "closed" / f"{name}.ply"), method="cem").quality
    assert quality.folds == 0
    assert quality.angle_mean_deg < 0.97 * flash
