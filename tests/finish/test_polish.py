"""The polish lowers angle errors, folds nothing, keeps boundaries where they belong; its elimination solves its equations."""

from __future__ import annotations

import json

import numpy as np
import pytest
from meshes import cap, grid, icosphere

import pgcp
from pgcp.cli.main import main
from pgcp.elimination.elements import SquaresSolver
from pgcp.errors import SolveFailedError
from pgcp.finish.polish import BALANCED, LEAST_MEAN, is_quick, polish
from pgcp.plane.space import find_folds
from pgcp.targets.registry import TARGETS
from pgcp.types import Mesh


def case(target, noise=0.02):
    """A noisy surface and a map of it."""
    rng = np.random.default_rng(5)
    if target == "sphere":
        ball = icosphere(3)
        return Mesh(ball.vertices + noise * rng.normal(size=ball.vertices.shape), ball.faces), ball.vertices, np.empty(0, int)
    mesh, z = cap(10) if target == "disk" else (grid(16), None)
    z = mesh.vertices @ [1, 1j, 0] if z is None else z / np.abs(z).max()
    surface = Mesh(np.column_stack([z.real, z.imag, 0 * z.real]) + noise * rng.normal(size=(len(z), 3)), mesh.faces)
    boundary = np.arange(len(z) - 60, len(z)) if target == "disk" else np.empty(0, int)
    return surface, z, boundary


@pytest.mark.parametrize("aim", [BALANCED, LEAST_MEAN])
@pytest.mark.parametrize("target", ["free", "disk", "sphere"])
def test_a_polish_lowers_the_errors_and_folds_nothing(target, aim):
    mesh, start, boundary = case(target)
    chosen = TARGETS.get(target)
    moved, record = polish(mesh, chosen.space, start, boundary, chosen.has_free_boundary, aim)
    assert record.steps > 0
    assert record.angle_mean_after_deg < 0.9 * record.angle_mean_before_deg
    assert len(find_folds(chosen.space, mesh.faces, moved)) == 0
    if target == "disk":
        assert np.abs(np.abs(moved[boundary]) - 1.0).max() < 1e-15
        turns = np.angle(np.roll(moved[boundary], -1) / moved[boundary])
        assert (turns > 0).all()
        assert np.abs(np.angle(moved[boundary] / start[boundary])).max() > 1e-4
    if target == "sphere":
        assert np.abs(np.linalg.norm(moved, axis=1) - 1.0).max() < 1e-15


def test_a_lower_power_lowers_the_mean_more_and_the_deviation_less():
    mesh, start, boundary = case("free", 0.004)
    one, two = (polish(mesh, TARGETS.get("free").space, start, boundary, True, aim)[1] for aim in (LEAST_MEAN, BALANCED))
    assert one.angle_mean_after_deg < two.angle_mean_after_deg
    assert two.angle_sd_after_deg < one.angle_sd_after_deg


def test_a_map_without_errors_is_left_as_it_is():
    mesh = grid(6)
    z = mesh.vertices @ [1, 1j, 0]
    same, record = polish(mesh, TARGETS.get("free").space, z, np.empty(0, int), True, BALANCED)
    assert record.steps == 0
    assert same is z


def test_needles_do_not_turn_and_unused_vertices_stay():
    """Vertices nearly on opposite edges; and one that no face uses."""
    rng = np.random.default_rng(2)
    square = grid(12)
    z = square.vertices @ [1, 1j, 0]
    image = z.copy()
    image[40:60] += 0.014 * (rng.normal(size=20) + 1j * rng.normal(size=20))
    space = TARGETS.get("free").space
    assert len(find_folds(space, square.faces, image)) == 0
    vertices = np.vstack([square.vertices, [[9.0, 9.0, 9.0]]])
    mesh, image = Mesh(vertices, square.faces), np.append(image, 5.0 + 5.0j)
    moved, record = polish(mesh, space, image, np.empty(0, int), True, LEAST_MEAN)
    assert len(find_folds(space, mesh.faces, moved)) == 0
    assert record.angle_mean_after_deg < 0.2 * record.angle_mean_before_deg
    assert moved[-1] == image[-1]


def test_the_elimination_solves_the_normal_equations():
    mesh, rng = grid(20), np.random.default_rng(1)
    rows = rng.normal(size=(len(mesh.faces), 3, 6))
    n, damping = len(mesh.vertices), 0.1
    columns = (2 * mesh.faces[:, :, None] + [0, 1]).reshape(-1, 6)
    matrix = damping * np.eye(2 * n)
    for face, own in zip(columns, rows, strict=True):
        matrix[np.ix_(face, face)] += own.T @ own
    right = rng.normal(size=(n, 2))
    solver = SquaresSolver(mesh.vertices, mesh.faces)
    solver.factor(rows, damping)
    assert solver.solve(right).reshape(-1) == pytest.approx(np.linalg.solve(matrix, right.reshape(-1)), rel=1e-9, abs=1e-10)
    with pytest.raises(SolveFailedError, match="not positive"):
        solver.factor(np.zeros_like(rows), 0.0)


@pytest.mark.parametrize("target", ["free", "disk"])
def test_auto_polishes_welded_maps_only(target):
    hills = grid(14, jitter=0.3)
    x, y = hills.vertices[:, 0], hills.vertices[:, 1]
    mesh = Mesh(np.column_stack([x, y, 0.4 * np.sin(5 * x) * np.cos(4 * y)]), hills.faces)
    assert is_quick(mesh)
    plain = pgcp.parameterize(mesh, patches=2, target=target, polish="none")
    auto = pgcp.parameterize(mesh, patches=2, target=target, polish="auto")
    angles = pgcp.parameterize(mesh, patches=2, target=target, polish="angles")
    assert plain.report["polish"] is None
    assert "polish" not in [stage["name"] for stage in plain.report["stages"]]
    assert "polish" in [stage["name"] for stage in auto.report["stages"]]
    assert angles.quality.angle_mean_deg < auto.quality.angle_mean_deg < plain.quality.angle_mean_deg
    record = angles.report["polish"]
    assert record["angle_mean_before_deg"] == pytest.approx(plain.quality.angle_mean_deg, rel=1e-6)
    assert record["angle_mean_after_deg"] == pytest.approx(angles.quality.angle_mean_deg, rel=1e-6)
    assert np.abs(angles.mu - plain.mu).max() > 1e-6
    assert pgcp.parameterize(mesh, patches=2, target=target, seams="exact", polish="auto").report["polish"] is None
    other = pgcp.parameterize(mesh, method="dncp", target="free", polish="angles")
    assert other.report["polish"]["steps"] > 0
    assert pgcp.parameterize(mesh, method="dncp", target="free", polish="auto").report["polish"] is None


def test_the_command_polishes_where_it_is_asked_to(tmp_path):
    surface, _, _ = case("free")
    pgcp.write_mesh(tmp_path / "m.ply", surface)
    means = {}
    for wanted in ("none", "angles", "auto"):
        out = tmp_path / wanted
        assert main([str(tmp_path / "m.ply"), "--polish", wanted, "--quiet", "--no-png", "--output-dir", str(out)]) == 0
        report = json.loads((out / "report.json").read_text())
        means[wanted] = report["quality"]["angle_mean_deg"]
        assert (report["polish"] is None) == (wanted == "none")
    assert max(means["angles"], means["auto"]) < means["none"]
