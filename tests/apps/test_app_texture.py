"""Textures: as many texels as are asked for, baked colours that are those of the vertices, files that others open."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh
from meshes import grid, lifted, spheroid
from PIL import Image

import pgcp
from pgcp.apps.texture import baked, baked_error, colours_of, size_for, textured
from pgcp.cli.apps import main
from pgcp.finish.texels import at_places, texel_density
from pgcp.report.raster import texels
from pgcp.types import Layout, Source

HILLS, BALL = lifted(grid(20, jitter=0.2)), spheroid(3, 1.6)[0]


def colours(points):
    """Smooth bytes (V, 3)."""
    return np.rint(127.5 + 127.5 * np.sin(5.0 * points + [0.0, 1.0, 2.0])).astype(np.uint8)


def painted(mesh):
    rows = dict(zip(("red", "green", "blue"), colours(mesh.vertices).T, strict=True))
    return Source(mesh.vertices, mesh.faces.reshape(-1), of_vertices=rows, name=mesh.name)


@pytest.fixture(scope="module")
def maps():
    found = {target: pgcp.parameterize(painted(HILLS), target=target, patches=2) for target in ("free", "disk")}
    return {**found, "sphere": pgcp.parameterize(painted(BALL), patches=2)}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, mesh in (("hills", HILLS), ("ball", BALL)):
        rgba = np.column_stack([colours(mesh.vertices), np.full(len(mesh.vertices), 255, np.uint8)])
        trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=rgba, process=False).export(f"{name}.ply")
    pgcp.write_mesh("plain.ply", HILLS)
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (40, 60, 3), np.uint8)).save("stones.png")
    (tmp_path / "words.png").write_text("no picture")
    return tmp_path


def names(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def test_the_density_of_a_square_that_is_stretched_on_its_texture():
    """The unit square on 0.8 x 0.4 of a texture of 100 x 50 texels: 80 texels per unit one way, 20 the other."""
    mesh = grid(3)
    layout = Layout(0.1 + mesh.vertices[:, :2] * [0.8, 0.4], mesh.faces, np.empty(0, np.int64), {})
    density = texel_density(mesh, layout, 100, 50)
    assert density.most == pytest.approx(80.0)
    assert density.least == pytest.approx(20.0)
    record = density.record()
    assert record["texels_per_unit_median"] == pytest.approx(40.0)
    assert record["texel_ratio_worst"] == pytest.approx(4.0)
    assert record["stretch_worst"] == pytest.approx(2.0)
    assert record["stretch_mean"] == pytest.approx(np.sqrt(0.5 * (0.25 + 4.0)))


@pytest.mark.parametrize("target", ["free", "disk", "sphere"])
@pytest.mark.parametrize("share", [0.5, 0.9, 1.0])
def test_the_size_is_the_least_that_gives_the_density(maps, target, share):
    result, asked = maps[target], 300.0
    width, height = size_for(result, asked, share)
    assert (width % 4, height) == (0, width // 2 if target == "sphere" else width)
    density = texel_density(result.mesh, result.layout(), width, height)
    met = density.areas[density.mean >= asked * (1.0 - 1e-12)].sum() / density.areas.sum()
    assert met >= share - 1e-9
    smaller = texel_density(result.mesh, result.layout(), width - 4, height * (1.0 - 4.0 / width))
    assert smaller.areas[smaller.mean >= asked].sum() / smaller.areas.sum() < share


def test_squares_of_the_checkerboard_have_the_size_that_is_asked_for(maps):
    """On a map that keeps lengths, steps of a colour along the texture are as far apart as on the surface."""
    flat = pgcp.parameterize(grid(10), patches=2)
    made = textured(flat, square=0.25, size=(512, 512))
    dark = made.image.astype(int).sum(axis=2) < 400
    row = dark[300]
    steps = np.diff(np.flatnonzero(row[1:] != row[:-1]))
    assert steps.mean() / made.density.met_by(0.5) == pytest.approx(0.25, rel=0.01)
    assert textured(maps["sphere"]).image.shape == (512, 1024, 3)


def test_texels_are_those_whose_middles_lie_in_faces():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    place, face, weights = texels(points, np.array([[0, 1, 2], [1, 3, 2]], np.int32), 8, 4)
    assert np.array_equal(np.sort(place), np.arange(32))
    rows, columns = place // 8, place % 8
    middles = np.column_stack([(columns + 0.5) / 8, 1.0 - (rows + 0.5) / 4])
    corners = points[np.array([[0, 1, 2], [1, 3, 2]])[face]]
    assert np.einsum("mk,mkd->md", weights, corners) == pytest.approx(middles, abs=1e-6)


@pytest.mark.parametrize("target", ["free", "disk", "sphere"])
def test_baked_colours_are_those_of_the_vertices(maps, target):
    """Within 6 of 255 wherever faces are two texels high; colours of neighbours differ by up to 100."""
    result = maps[target]
    made = baked(result)
    wanted = colours_of(result)
    assert 255.0 * wanted == pytest.approx(colours(result.mesh.vertices))
    apart = baked_error(made, wanted)
    assert apart["share_with_room"] > 0.7
    assert apart["largest_with_room"] <= 6.0
    assert apart["mean"] < 2.0
    middles = made.layout.points[made.layout.faces].mean(axis=1)
    shown = at_places(made.image, middles)
    assert np.median(np.abs(shown - 255.0 * wanted[result.faces].mean(axis=1))) < 1.5


def test_nothing_but_colours_of_the_surface_is_on_the_texture(maps):
    """Red bytes at every vertex: the texture is red beyond the boundary and around the date line, too."""
    for result in maps.values():
        red = np.tile([1.0, 0.0, 0.0], (len(result.mesh.vertices), 1))
        assert set(map(tuple, baked(result, (64, 64), red).image.reshape(-1, 3).tolist())) == {(255, 0, 0)}


@pytest.mark.parametrize("name", ["hills", "ball"])
def test_files_of_a_baked_scan_are_opened_by_others(folder, name, capsys):
    """The colours that trimesh finds for the corners of the textured mesh are those of the scan's vertices."""
    assert main(["texture", f"{name}.ply", "--bake", "--patches", "2"]) == 0
    assert "baked colours at vertices: off by" in capsys.readouterr().out
    here = folder / f"{name}_texture"
    files = [f"{name}.glb", f"{name}.mtl", f"{name}.obj", f"{name}_density.png", f"{name}_texture.png", "texture.json"]
    assert sorted(path.name for path in here.iterdir()) == sorted(files)
    record = json.loads((here / "texture.json").read_text())
    assert record["baked_error_of_255"]["largest_with_room"] <= 6.0
    mesh = HILLS if name == "hills" else BALL
    picture = Image.open(here / f"{name}_texture.png")
    assert picture.size == (record["width"], record["height"])
    for ending in ("glb", "obj"):
        loaded = trimesh.load(here / f"{name}.{ending}", force="mesh", process=False)
        assert loaded.visual.kind == "texture"
        material = loaded.visual.material
        image = material.baseColorTexture if ending == "glb" else material.image
        assert np.array_equal(np.asarray(image.convert("RGB")), np.asarray(picture))
        corners = colours(loaded.vertices[loaded.faces].reshape(-1, 3))
        shown = at_places(np.asarray(picture).astype(float), loaded.visual.uv[loaded.faces].reshape(-1, 2))
        assert np.quantile(np.abs(shown - corners).max(axis=1), 0.9) < 4.5
        assert len(loaded.faces) == len(mesh.faces)
        assert loaded.bounds == pytest.approx(np.array([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)]), abs=1e-6)
    with np.errstate(all="ignore"):
        assert all(len(line.split()) == 4 for line in (here / f"{name}.obj").read_text().splitlines() if line.startswith("v "))


def test_a_picture_goes_onto_single_files_in_the_size_that_is_asked_for(folder, capsys):
    words = ["texture", "hills.ply", "stones.png", "-o", "new.glb", "-o", "new_texture.png", "--json"]
    assert main([*words, "--size", "128"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["width"], said["height"], said["results"]) == (128, 128, ["new.glb", "new_texture.png"])
    assert Image.open("new_texture.png").size == (128, 128)
    assert main(words) == 0
    assert np.array_equal(np.asarray(Image.open("new_texture.png")), np.asarray(Image.open("stones.png")))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["hills.ply", "words.png"], "words.png: it is no picture that can be read"),
        (["hills.ply", "lost.png"], "lost.png: the picture cannot be read: No such file"),
        (["hills.ply", "--size", "8"], "--size is 8; from 16 to 16384 texels are made"),
        (["hills.ply", "--size", "99999"], "--size is 99999; from 16 to 16384 texels are made"),
        (["hills.ply", "--size", "many"], "argument --size: 'many' is no whole number"),
        (["hills.ply", "--texels-per-unit", "0"], "--texels-per-unit is 0.0; it must be a number above 0"),
        (["hills.ply", "--texels-per-unit", "1e9"], "1e+09 texels per unit on 50 % of the surface need a texture of"),
        (["hills.ply", "--texels-per-unit", "9", "--share", "2"], "--share is 2.0; it must be above 0 and at most 1"),
        (["hills.ply", "--size", "99", "--texels-per-unit", "9"], "--size and --texels-per-unit both say how large"),
        (["hills.ply", "--square", "-1"], "--square is -1.0; it must be a number above 0"),
        (["hills.ply", "stones.png", "--square", "1"], "--square is for the checkerboard, which is not asked for"),
        (["hills.ply", "stones.png", "--bake"], "--bake makes the texture from the mesh's colours"),
        (["plain.ply", "--bake"], "plain.ply has no colours at its vertices that could be baked"),
        (["hills.ply", "-o", "hills.stl"], "hills.stl: texture writes no such file"),
        (["hills.ply", "stones.png", "-o", "stones.png"], "stones.png: this would take the place of what was given"),
    ],
)
def test_mistakes_are_said_in_one_sentence_and_nothing_is_written(folder, capsys, words, message):
    before = names(folder)
    assert main(["texture", *words]) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith(f"pgcp texture: {message}")
    assert names(folder) == before
