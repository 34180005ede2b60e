"""pgcp harmonics: surfaces made of harmonics come out as they were made."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from meshes import grid, icosphere, lifted, spheroid

import pgcp
from pgcp.apps.harmonics import expand
from pgcp.cli.apps import main
from pgcp.plane.harmonics import real_harmonics
from pgcp.result import Result


def on_sphere(mesh, image):
    """A result whose map is known."""
    made = pgcp.compute(mesh)
    values = {name: getattr(made, name) for name in ("patch", "mu", "quality", "target")}
    return Result(mesh=mesh, coordinates=image, coordinates_name="sphere", **values)


def test_a_sphere_is_exact_at_degree_1():
    expansion = expand(pgcp.compute(icosphere(3), pgcp.Options(moebius="area")), degree=3)
    assert expansion.sizes[0] == pytest.approx(1.0, rel=1e-9)
    assert expansion.errors[0, 0] == pytest.approx(1.0, rel=1e-9)
    assert expansion.errors[1, 0] < 1e-3  # the map's own error on a mesh of 642 vertices
    assert expansion.power[1, 0] == pytest.approx(3 * 4 * np.pi / 3, rel=1e-3)


def test_an_ellipsoid_by_its_linear_map_is_exact_at_degree_1_and_by_its_conformal_map_it_is_not():
    mesh, conformal = spheroid(3, 1.5)
    mesh = pgcp.Mesh(mesh.vertices + np.array([3.0, -2.0, 1.0]), mesh.faces)
    linear = expand(on_sphere(mesh, icosphere(3).vertices), degree=2)
    assert linear.errors[1, 0] < 1e-12
    assert linear.coefficients[0] * np.sqrt(0.25 / np.pi) == pytest.approx([3.0, -2.0, 1.0])
    assert np.diag(linear.coefficients[[3, 1, 2]]) * np.sqrt(0.75 / np.pi) == pytest.approx([1.0, 1.0, 1.5])
    errors = expand(on_sphere(mesh, conformal), degree=9).errors[:, 0]
    assert errors[1] > 0.05
    assert errors[9] < 0.02 * errors[1]


def test_a_surface_of_harmonics_up_to_degree_4_is_recovered():
    sphere, random = icosphere(3), np.random.default_rng(5)
    made = 0.03 * random.standard_normal((25, 3))
    made[[3, 1, 2], [0, 1, 2]] += np.sqrt(4 * np.pi / 3)
    values = random.standard_normal((25, 1))
    mesh = pgcp.Mesh(real_harmonics(4, sphere.vertices) @ made, sphere.faces)
    result = on_sphere(mesh, sphere.vertices)
    expansion = expand(result, degree=6, values=real_harmonics(4, sphere.vertices) @ values)
    assert expansion.coefficients[:25] == pytest.approx(np.hstack([made, values]), abs=1e-11)
    assert np.abs(expansion.coefficients[25:]).max() < 1e-11
    assert expansion.errors[4].max() < 1e-11 < 1e-3 < expansion.errors[3].min()
    assert expansion.reconstructed(4)[:, :3] == pytest.approx(mesh.vertices, abs=1e-11)


def test_the_error_falls_with_the_degree_and_is_that_of_the_reconstruction():
    sphere = icosphere(3)
    bumps = 1.0 + 0.2 * np.sin(5 * sphere.vertices[:, :1]) * sphere.vertices[:, 1:2]
    mesh = pgcp.Mesh(sphere.vertices * bumps, sphere.faces)
    result = pgcp.compute(mesh, pgcp.Options(moebius="area"))
    expansion = expand(result, values=result.log_scale)
    errors = expansion.errors[:, 0]
    assert expansion.degree == 11
    assert (np.diff(errors) < 0).all()
    assert errors[-1] < 0.05 * errors[1]
    areas = np.zeros(len(mesh.vertices))
    corners = mesh.vertices[mesh.faces]
    size = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 6
    np.add.at(areas, mesh.faces, size[:, None])
    for degree in (1, 5, 11):
        away = ((expansion.reconstructed(degree)[:, :3] - mesh.vertices) ** 2).sum(axis=1)
        assert np.sqrt(areas @ away / areas.sum()) == pytest.approx(errors[degree], rel=1e-9)
    assert expansion.errors[-1, 1] < 0.1 * expansion.sizes[1]


def test_a_map_that_is_not_corrected_for_area_needs_higher_degrees():
    result = pgcp.compute(spheroid(3, 1.4)[0], pgcp.Options(moebius="area"))
    shift = np.array([0.0, 0.6, 0.0])
    moved = result.coordinates + shift
    moved = (1 - shift @ shift) * moved / (moved**2).sum(axis=1)[:, None] + shift
    assert np.linalg.norm(moved, axis=1) == pytest.approx(1.0)
    corrected, other = (expand(on_sphere(result.mesh, points), 8).errors[8, 0] for points in (result.coordinates, moved))
    assert other > 5.0 * corrected


def test_power_does_not_change_where_the_surface_is_turned():
    mesh, _ = spheroid(3, 1.4)
    mesh.vertices[:, 0] *= 1.0 + 0.2 * mesh.vertices[:, 2]
    turn = np.linalg.qr(np.random.default_rng(6).standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    options = pgcp.Options(moebius="area", patches=2)
    one = expand(pgcp.compute(mesh, options), degree=6).power[1:, 0]
    other = expand(pgcp.compute(pgcp.Mesh(mesh.vertices @ turn + 1.0, mesh.faces), options), degree=6).power[1:, 0]
    assert other == pytest.approx(one, rel=1e-3, abs=1e-3 * one[0])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pgcp.write_mesh("ball.ply", spheroid(2, 1.5)[0])
    pgcp.write_mesh("bust.ply", lifted(grid(8)))
    return tmp_path


def names(path):
    return sorted(str(file.relative_to(path)) for file in path.rglob("*") if file.is_file())


def test_the_command_writes_coefficients_the_surface_and_a_picture(folder, capsys):
    np.savetxt("heights.txt", pgcp.read_mesh("ball.ply").vertices[:, 2])
    assert main(["harmonics", "ball.ply", "--degree", "5", "--values", "heights.txt"]) == 0
    assert "36 harmonics up to degree 5" in capsys.readouterr().out
    written = ["harmonics.json", "ball.npz", "ball.ply", "ball.png", "ball_coefficients.json"]
    assert names(folder / "ball_harmonics") == sorted(written)
    said = json.loads(Path("ball_harmonics/harmonics.json").read_text())
    table = json.loads(Path("ball_harmonics/ball_coefficients.json").read_text())
    with np.load("ball_harmonics/ball.npz") as data:
        assert np.array(table["coefficients"])[:, 2:] == pytest.approx(data["coefficients"])
        assert data["coefficients"][:, 2] == pytest.approx(data["coefficients"][:, 3], abs=1e-10)
        assert said["errors"] == pytest.approx(data["errors"][:, 0])
        places = data["reconstructed"][:, :3]
    assert table["columns"] == ["l", "m", "x", "y", "z", "value_1"]
    assert np.array_equal(pgcp.read_mesh("ball_harmonics/ball.ply").vertices, places)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["bust.ply"], "bust.ply is an open surface (a disk)"),
        (["ball.ply", "--degree", "-1"], "--degree is -1; it must be from 0 to 80"),
        (["ball.ply", "--degree", "13"], "degree 13 has 196 harmonics, more than the surface has vertices, 162"),
        (["ball.ply", "--values", "lost.txt"], "lost.txt: the values cannot be read: No such file or directory"),
        (["ball.ply", "--values", "short.txt"], "short.txt: it holds values of 2 vertices, and the mesh has 162"),
        (["ball.ply", "--values", "ball.ply"], "ball.ply: byte "),
        (["ball.ply", "--target", "disk"], "this needs a map to the target sphere, and --target disk asks for another"),
    ],
)
def test_what_cannot_be_expanded_is_refused_in_one_sentence(folder, capsys, words, message):
    Path("short.txt").write_text("1\n2\n")
    before = names(folder)
    assert main(["harmonics", *words]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1].startswith(f"pgcp harmonics: {message}")
    assert names(folder) == before


def test_values_and_degrees_that_make_no_sense_are_refused():
    result = pgcp.compute(icosphere(1))
    for keywords in ({"degree": 99}, {"values": np.zeros(3)}, {"values": np.full(42, np.nan)}):
        with pytest.raises(pgcp.InputError):
            expand(result, **keywords)
    with pytest.raises(pgcp.InputError, match="goes to the plane"):
        expand(pgcp.compute(lifted(grid(6))))
    with pytest.raises(pgcp.InputError, match="goes from 0 to 2"):
        expand(result, degree=2).reconstructed(3)
