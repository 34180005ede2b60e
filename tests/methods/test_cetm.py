"""CETM: a flat surface is its own solution, the metric found is flat, cuts do not matter, and a failure says why."""

from __future__ import annotations

import json

import numpy as np
import pytest
from meshes import grid, lifted, similarity_error

import pgcp
from pgcp.cli.main import main
from pgcp.methods.common.conjugate_gradients import conjugate_gradients
from pgcp.methods.common.edge_metric import (
    angle_sums,
    conformal_equivalence_energy,
    edge_lengths,
    lobachevsky,
    scaled_lengths,
    shapes_of,
)
from pgcp.surface.distortion import angle_errors, corner_angles
from pgcp.surface.operators import cotangents, weighted_laplacian
from pgcp.surface.topology import examine
from pgcp.types import Mesh


def flat(result):
    return result.coordinates @ [1, 1j]


def mapped(mesh, **named):
    return pgcp.parameterize(mesh, method="cetm", **named)


def rim(mesh):
    return examine(mesh.faces, len(mesh.vertices)).loops[0]


def rolled(mesh, radius):
    x, y = mesh.vertices[:, 0], mesh.vertices[:, 1]
    return Mesh(np.column_stack([radius * np.sin(x / radius), y, radius * np.cos(x / radius)]), mesh.faces, "rolled")


def spike():
    """Five faces around a vertex whose angles there are together 20 degrees, and a flat collar of needles."""
    angles = 2 * np.pi * np.arange(5) / 5
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(5)])
    vertices = np.vstack([[0.0, 0.0, 40.0], 0.02 * ring, ring])
    i, j = np.arange(5), (np.arange(5) + 1) % 5
    faces = [
        np.column_stack([0 * i, 1 + i, 1 + j]),
        np.column_stack([1 + i, 6 + i, 6 + j]),
        np.column_stack([1 + i, 6 + j, 1 + j]),
    ]
    return Mesh(vertices, np.vstack(faces), "spike")


# The energy -------------------------------------------------------------------------------------------------------------------


def test_lobachevsky_has_the_slope_and_the_symmetries_that_it_should():
    x = np.linspace(0.01, np.pi - 0.01, 400)
    slope = (lobachevsky(x + 1e-6) - lobachevsky(x - 1e-6)) / 2e-6
    assert np.abs(slope + np.log(2 * np.sin(x))).max() < 1e-7
    assert np.abs(lobachevsky(x) + lobachevsky(np.pi - x)).max() < 1e-15
    assert lobachevsky(np.array([0.0, np.pi])).tolist() == [0.0, 0.0]
    catalan = 0.9159655941772190
    assert lobachevsky(np.array([np.pi / 4])) == pytest.approx(catalan / 2, abs=1e-15)


def test_the_gradient_of_the_energy_is_the_defect_and_its_hessian_the_laplacian():
    mesh = lifted(grid(4, jitter=0.2), 0.6)
    count, random = len(mesh.vertices), np.random.default_rng(1)
    lengths, targets = edge_lengths(mesh.vertices, mesh.faces), random.uniform(1, 6, count)
    u, d = random.uniform(-0.05, 0.05, (2, count))

    def at(factors):
        scaled = scaled_lengths(lengths, mesh.faces, factors)
        shapes = shapes_of(scaled)
        energy = conformal_equivalence_energy(scaled, shapes, mesh.faces, factors, targets)
        return energy, 0.5 * (targets - angle_sums(shapes.angles, mesh.faces, count)), shapes

    (ahead, slope_ahead, _), (behind, slope_behind, _) = at(u + 1e-5 * d), at(u - 1e-5 * d)
    _, slope, shapes = at(u)
    assert not shapes.broken.any()
    assert (ahead - behind) / 2e-5 == pytest.approx(slope @ d, rel=1e-6)
    hessian = 0.5 * weighted_laplacian(mesh.faces, 0.5 * shapes.cotangents, count)
    assert np.abs((slope_ahead - slope_behind) / 2e-5 - hessian @ d).max() < 1e-7


def test_shapes_are_those_of_the_faces_and_a_broken_one_is_flat():
    mesh = lifted(grid(4, jitter=0.2))
    shapes = shapes_of(edge_lengths(mesh.vertices, mesh.faces))
    assert np.abs(shapes.angles - corner_angles(mesh.vertices, mesh.faces)).max() < 1e-12
    assert np.abs(shapes.cotangents - cotangents(mesh.vertices, mesh.faces)).max() < 1e-12
    broken = shapes_of(np.array([[1.0, 1.0, 3.0], [1.0, 1.0, 1.0]]))
    assert broken.broken.tolist() == [True, False]
    assert broken.angles[0].tolist() == [0.0, 0.0, np.pi]
    assert broken.cotangents[0].tolist() == [0.0, 0.0, 0.0]


def test_conjugate_gradients_solve_with_a_near_operator_in_a_few_steps():
    random = np.random.default_rng(0)
    near = np.diag(random.uniform(1, 1e4, 50))
    matrix = near + np.diag(np.full(49, 0.3), 1) + np.diag(np.full(49, 0.3), -1)
    x = random.normal(size=(50, 2)) @ [1, 1j]
    found, steps = conjugate_gradients(lambda v: matrix @ v, lambda r: r / np.diag(near), matrix @ x, 1e-12, 50)
    assert np.abs(found - x).max() < 1e-9
    assert steps < 15


# The map ----------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("patches", [1, 4])
def test_a_flat_surface_comes_back(patches):
    mesh = grid(16, 10, jitter=0.3)
    assert similarity_error(flat(mapped(mesh, patches=patches)), mesh.vertices[:, :2] @ [1, 1j]) < 1e-9
    surface = rolled(grid(16, 10), 0.4)
    assert angle_errors(surface, mapped(surface, patches=patches).coordinates).max() < 1e-6


def test_lengths_in_the_map_are_scaled_by_factors_of_vertices_and_those_of_the_boundary_kept():
    mesh = lifted(grid(12))
    z = flat(mapped(mesh))
    corners = z[mesh.faces]
    there = np.abs(np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1))
    logs = np.log(there / edge_lengths(mesh.vertices, mesh.faces))  # edge i opposite corner i: (u_j + u_k) / 2
    at_corners = np.roll(logs, 1, axis=1) + np.roll(logs, -1, axis=1) - logs
    flattened = mesh.faces.reshape(-1)
    count = np.bincount(flattened)
    mean = np.bincount(flattened, at_corners.reshape(-1)) / count
    assert np.abs(at_corners.reshape(-1) - mean[flattened]).max() < 1e-9
    assert np.ptp(mean[rim(mesh)]) < 1e-9
    assert np.ptp(mean) > 0.1


def test_cuts_do_not_matter():
    mesh = lifted(grid(20))
    one, four = (mapped(mesh, patches=patches).coordinates for patches in (1, 4))
    assert np.abs(one - four).max() < 1e-9 * np.abs(one).max()


def test_four_right_angles_make_a_rectangle(tmp_path):
    mesh = lifted(grid(12))
    corners = [0, 12, 168, 156]
    (tmp_path / "angles.txt").write_text("\n".join(f"{corner} 90" for corner in corners))
    one, four = (mapped(mesh, boundary=f"angles:{tmp_path / 'angles.txt'}", patches=patches) for patches in (1, 4))
    assert np.abs(one.coordinates - four.coordinates).max() < 1e-9
    z = flat(one)[rim(mesh)]
    steps = np.roll(z, -1) - z
    turns = np.degrees(np.angle(steps / np.roll(steps, 1)))
    assert np.abs(turns - np.where(np.isin(rim(mesh), corners), 90, 0)).max() < 1e-6
    assert one.quality.folds == 0


def test_the_report_has_the_iterations(tmp_path):
    pgcp.write_mesh(tmp_path / "hills.ply", lifted(grid(12)))
    assert main([str(tmp_path / "hills.ply"), "--method", "cetm", "--quiet"]) == 0
    report = json.loads((tmp_path / "hills_pgcp" / "report.json").read_text())
    norms = [step["gradient_norm"] for step in report["iterations"]]
    assert norms[-1] < 1e-10 < 0.1 < norms[0]
    assert len(norms) < 10
    assert report["converged"] is True
    assert report["options"]["boundary"] == "isometric"


def test_a_surface_without_such_a_metric_ends_with_status_3_and_says_what_to_try(tmp_path, capsys):
    pgcp.write_mesh(tmp_path / "spike.ply", spike())
    assert main([str(tmp_path / "spike.ply"), "--method", "cetm", "--quiet", "--patches", "1"]) == 3
    said = capsys.readouterr().err
    assert "no flat metric was found in" in said
    assert "the largest angle defect left is" in said
    assert "break their triangle inequality; remesh the surface with better-shaped faces, or choose --method bff" in said
    assert not (tmp_path / "spike_pgcp").exists()


@pytest.mark.parametrize(
    ("named", "sentence"),
    [
        ({"boundary": "disk"}, "unknown boundary 'disk'; choose from isometric, angles:FILE"),
        ({"boundary": "angles:nowhere.txt"}, "nowhere.txt: No such file"),
        ({"target": "disk"}, "the method cetm is one for the target free, not disk"),
    ],
)
def test_what_it_cannot_do_is_refused(named, sentence):
    with pytest.raises(pgcp.InputError, match=sentence):
        mapped(grid(3), **named)


def test_angle_errors_of_a_real_mesh_are_no_larger_than_those_of_bff(mesh_folder):
    result = mapped(mesh_folder / "open" / "max_planck_disk.ply")
    assert result.quality.angle_mean_deg <= 1.411
    assert result.quality.folds == 0
