"""The shape of one surface turned into that of another: both ends are those surfaces, and what is between lies between."""

from __future__ import annotations

import json

import numpy as np
import pytest
from meshes import even_sphere, grid, hilly_disk, icosphere, lifted, lumpy, spheroid
from PIL import Image
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import pgcp
from pgcp.apps.morph import morph
from pgcp.cli.apps import main

TURN = Rotation.from_euler("xyz", [2.0, -0.7, 1.1])
SHIFT = np.array([1.0, 2.0, 3.0])


def surfaces(kind):
    """Two surfaces of unlike shape and mesh, the second turned and moved."""
    if kind == "closed":
        one, two = spheroid(3, 1.5)[0], even_sphere(700)
        return one, pgcp.Mesh(TURN.apply(lumpy(two.vertices)) + SHIFT, two.faces, "lumps")
    one, two = hilly_disk(700), hilly_disk(600, 0.4)
    return one, pgcp.Mesh(TURN.apply(two.vertices * [1.0, 1.2, 2.0]) + SHIFT, two.faces, "steep")


@pytest.fixture(scope="module", params=["closed", "open"])
def done(request):
    target = {"closed": "sphere", "open": "disk"}[request.param]
    a, b = (pgcp.parameterize(mesh, target=target, patches=2) for mesh in surfaces(request.param))
    return morph(a, b, steps=4)


def distances(points, mesh, count=60_000):
    """Distances of points from a dense sample of a surface, and how far apart its points are, about."""
    rng = np.random.default_rng(0)
    corners = mesh.vertices[mesh.faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    faces = rng.choice(len(areas), count, p=areas / areas.sum())
    sample = np.einsum("nk,nkd->nd", rng.dirichlet([1, 1, 1], count), corners[faces])
    return cKDTree(sample).query(points)[0], np.sqrt(0.5 * areas.sum() / count)


def test_the_first_shape_is_the_first_surface_exactly(done):
    assert np.array_equal(done.shapes[0], done.match.a.mesh.vertices)


def test_the_last_shape_lies_on_the_second_surface(done):
    b, last = done.match.b.mesh, done.shapes[-1]
    away, gap = distances(last, b)
    assert away.max() < 5.0 * gap  # as near as the sample tells
    corners = b.vertices[b.faces[done.match.on_b.faces]]
    assert np.abs(np.einsum("nk,nkd->nd", done.match.on_b.weights, corners) - last).max() < 1e-12


def test_what_of_the_second_surface_is_lost_is_stated(done):
    a, b, lost = done.match.a.mesh, done.match.b.mesh, done.detail_lost()
    away, _ = distances(b.vertices, pgcp.Mesh(done.shapes[-1], a.faces))
    size = np.linalg.norm(np.ptp(b.vertices, axis=0))
    assert away.mean() / size < 1.2 * lost["mean"] + 0.002
    corners = done.shapes[-1][a.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
    assert 0.0 < lost["mean"] < lost["p95"] < lost["max"] < longest / size
    assert lost["mean"] < 0.005


def test_shapes_are_between_once_the_rigid_motion_is_undone(done):
    a, shares = done.match.a.mesh, done.shares
    here = done.shapes[-1] @ done.rotation
    for shape, share in zip(done.shapes, shares, strict=True):
        wanted = (1.0 - share) * a.vertices + share * here
        turned, _ = Rotation.align_vectors(wanted - wanted.mean(axis=0), shape - shape.mean(axis=0))
        assert np.allclose(turned.apply(shape - shape.mean(axis=0)), wanted - wanted.mean(axis=0), atol=1e-6)


def test_shapes_in_place_go_straight(done):
    a, b = done.match.a, done.match.b
    still = morph(a, b, steps=2, in_place=True).shapes
    assert np.array_equal(still[0], a.mesh.vertices)
    assert np.allclose(still[1], 0.5 * (still[0] + still[2]))
    sides = [np.linalg.norm(shape[a.faces[:, 0]] - shape[a.faces[:, 1]], axis=1) for shape in (still[2], done.shapes[-1])]
    assert np.allclose(*sides)
    assert np.linalg.norm(still[2] - still[0], axis=1).mean() < np.linalg.norm(done.shapes[-1] - still[0], axis=1).mean()


def test_a_turned_copy_keeps_its_shape_on_the_way():
    mesh = hilly_disk(300)
    turned = pgcp.Mesh(TURN.apply(mesh.vertices) + SHIFT, mesh.faces)
    a, b = (pgcp.parameterize(each, target="disk", patches=1) for each in (mesh, turned))
    middle = morph(a, b, steps=2).shapes[1]
    sides = [np.linalg.norm(points[mesh.faces[:, 0]] - points[mesh.faces[:, 1]], axis=1) for points in (mesh.vertices, middle)]
    assert np.abs(sides[1] / sides[0] - 1.0).max() < 0.02


def test_of_any_size_shapes_change_evenly_and_grow_by_factors():
    mesh = hilly_disk(300)
    larger = pgcp.Mesh(100.0 * TURN.apply(mesh.vertices * [1.0, 1.0, 2.0]) + SHIFT, mesh.faces)
    a, b = (pgcp.parameterize(each, target="disk", patches=1) for each in (mesh, larger))
    done = morph(a, b, steps=2, any_size=True)
    first, middle, last = done.shapes
    assert np.array_equal(first, mesh.vertices)
    assert np.array_equal(last, done.match.on_b.points)
    sizes = [
        np.linalg.norm(np.ptp(shape - shape.mean(axis=0), axis=0))
        for shape in morph(a, b, steps=2, in_place=True, any_size=True).shapes
    ]
    assert sizes[1] / sizes[0] == pytest.approx(sizes[2] / sizes[1], rel=0.05)
    assert 90 < sizes[2] / sizes[0] < 120
    assert (
        np.linalg.norm(morph(a, b, steps=2).shapes[1], axis=1).mean()
        > 4.0 * np.linalg.norm(middle - middle.mean(axis=0), axis=1).mean()
    )


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one, two = icosphere(2), even_sphere(200)
    pgcp.write_mesh("one.ply", pgcp.Mesh(one.vertices * [1.0, 1.3, 0.7], one.faces))
    pgcp.write_mesh("two.ply", pgcp.Mesh(lumpy(two.vertices), two.faces))
    pgcp.write_mesh("open.ply", lifted(grid(6)))
    return tmp_path


def test_the_command_writes_meshes_an_animation_and_a_picture(files, capsys, monkeypatch):
    monkeypatch.setattr("pgcp.apps.morph._PIXELS", 240)
    words = ["morph", "one.ply", "two.ply", "--steps", "3", "--patches", "1"]
    assert main([*words, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert sorted(path.name for path in (files / "one_morph").iterdir()) == [
        "morph.json", "one.gif", "one.png", "one_00.ply", "one_01.ply", "one_02.ply", "one_03.ply",
    ]  # fmt: skip
    first, shapes = pgcp.read_mesh("one.ply"), [pgcp.read_mesh(f"one_morph/one_0{k}.ply") for k in range(4)]
    assert np.array_equal(shapes[0].vertices, first.vertices)
    for shape in shapes:
        assert np.array_equal(shape.faces, first.faces)
    away, gap = distances(shapes[3].vertices, pgcp.read_mesh("two.ply"))
    assert away.max() < 5.0 * gap
    assert set(said["detail_lost"]) == {"mean", "p95", "max"}
    with Image.open("one_morph/one.gif") as film:
        assert film.n_frames == 48  # there and back
        first_frame = np.asarray(film.convert("L"), int)
        film.seek(24)
        assert np.abs(np.asarray(film.convert("L"), int) - first_frame).mean() > 2.0
    assert main([*words, "--quiet", "-o", "all.npz", "-o", "shape.obj"]) == 0
    with np.load("all.npz") as data:
        assert np.array_equal(data["vertices"][1], shapes[1].vertices)
        assert np.array_equal(data["shares"], [0, 1 / 3, 2 / 3, 1])
    assert np.allclose(pgcp.read_mesh("shape_02.obj").vertices, shapes[2].vertices, atol=1e-8)  # OBJ files have nine digits


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["open.ply"], "one.ply is closed and open.ply is open; only two closed surfaces, or two open ones, correspond"),
        (["two.ply", "--steps", "0"], "--steps is 0; it must be from 1 to 999"),
        (["two.ply", "--landmarks", "none.txt"], "none.txt: there is no such file of landmarks"),
        (["two.ply", "-o", "x.stl"], "x.stl: morph writes no such file"),
    ],
)
def test_mistakes_are_said_in_one_sentence_and_nothing_is_written(files, capsys, words, message):
    before = sorted(path.name for path in files.iterdir())
    assert main(["morph", "one.ply", *words]) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith(f"pgcp morph: {message}")
    assert sorted(path.name for path in files.iterdir()) == before


def test_a_shape_never_takes_the_place_of_a_mesh_that_was_given(files, capsys):
    (files / "shape_01.ply").write_bytes((files / "two.ply").read_bytes())
    before = (files / "shape_01.ply").read_bytes()
    assert main(["morph", "one.ply", "shape_01.ply", "--steps", "2", "--patches", "1", "-o", "shape.ply"]) == 2
    assert "shape_01.ply: this would take the place of what was given" in capsys.readouterr().err
    assert (files / "shape_01.ply").read_bytes() == before
    assert not (files / "shape_00.ply").exists()
