"""Surfaces meshed anew through their maps."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from meshes import grid, lifted, spheroid
from PIL import Image

import pgcp
from pgcp.apps.remesh import remesh
from pgcp.cli.apps import main
from pgcp.finish.lattice import quadtree
from pgcp.finish.shape import hausdorff_distance, shape_record
from pgcp.surface.topology import examine
from pgcp.types import Source

HILLS, BALL = lifted(grid(24, jitter=0.3)), spheroid(3, 1.8)[0]


@pytest.fixture(scope="module")
def maps():
    found = {target: pgcp.parameterize(HILLS, target=target, patches=2) for target in ("free", "disk")}
    return {**found, "sphere": pgcp.parameterize(BALL, patches=2)}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pgcp.write_mesh("hills.ply", HILLS)
    pgcp.write_mesh("ball.ply", BALL)
    return tmp_path


def names(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def volume_or_area(mesh):
    """What tells the orientation: the volume of a ball, the area of hills seen from above."""
    a, b, c = mesh.vertices[mesh.faces].swapaxes(0, 1)
    if examine(mesh.faces, len(mesh.vertices)).is_sphere:
        return float(np.einsum("fk,fk->", a, np.cross(b, c)) / 6.0)
    return float(0.5 * np.cross(b - a, c - a)[:, 2].sum())


def on_surface(points, mesh):
    return np.abs(trimesh.proximity.closest_point_naive(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False), points)[1])


@pytest.mark.parametrize("target", ["free", "disk", "sphere"])
def test_triangles_are_even_on_the_surface_and_stay_on_it(maps, target):
    result = maps[target]
    made = remesh(result)
    before, after = shape_record(result.mesh), shape_record(made.mesh)
    topology = examine(made.mesh.faces, len(made.mesh.vertices))
    assert topology.is_sphere if target == "sphere" else topology.is_disk
    assert abs(after["vertices"] - before["vertices"]) <= 3
    assert after["min_angle_median_deg"] > max(49.0, before["min_angle_median_deg"])
    assert after["min_angle_least_deg"] > 18.0
    assert after["edge_variation"] < 0.14 < before["edge_variation"]
    assert after["edge_mean"] == pytest.approx(made.spacing, rel=0.04)
    assert on_surface(made.mesh.vertices[:200], result.mesh).max() < 1e-12
    assert volume_or_area(made.mesh) == pytest.approx(volume_or_area(result.mesh), rel=0.02)


def test_sizes_on_the_surface_do_not_depend_on_how_the_map_stretches(maps):
    """The disk of a square shrinks its corners; the triangles there are as large as in the middle."""
    made = remesh(maps["disk"], vertices=900)
    areas = trimesh.Trimesh(made.mesh.vertices, made.mesh.faces, process=False).area_faces
    middles = made.mesh.vertices[made.mesh.faces].mean(axis=1)
    at_corners = (np.abs(middles[:, :2] - 0.5) > 0.38).all(axis=1)
    assert np.median(areas[at_corners]) == pytest.approx(np.median(areas[~at_corners]), rel=0.15)
    flat = made.image[made.mesh.faces]
    u, v = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    mapped = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    assert mapped.min() > 0.0
    assert np.median(mapped[at_corners]) < 0.5 * np.median(mapped[~at_corners])


@pytest.mark.parametrize("target", ["free", "disk"])
def test_the_boundary_stays_and_keeps_its_corners(maps, target):
    made = remesh(maps[target], edge=0.06)
    loop = examine(made.mesh.faces, len(made.mesh.vertices)).loops[0]
    rim = made.mesh.vertices[loop]
    assert on_surface(rim, HILLS).max() < 1e-12
    sides = np.minimum(np.abs(rim[:, :2]), np.abs(rim[:, :2] - 1.0)).min(axis=1)
    assert sides.max() < 1e-12
    for corner in ((0, 0), (0, 1), (1, 0), (1, 1)):
        assert np.linalg.norm(rim[:, :2] - corner, axis=1).min() < 1e-12
    steps = np.linalg.norm(np.roll(rim, -1, axis=0) - rim, axis=1)
    assert 0.04 < steps.min() <= steps.max() < 0.08


@pytest.mark.parametrize("target", ["free", "sphere"])
def test_quads_lie_in_the_lattice_and_close_up_with_triangles(maps, target):
    made = remesh(maps[target], quads=True)
    sizes = np.diff(made.source.offsets)
    assert (sizes == 4).sum() > 0.5 * len(sizes)
    assert set(sizes.tolist()) <= {3, 4}
    topology = examine(made.mesh.faces, len(made.mesh.vertices))
    assert topology.is_sphere if target == "sphere" else topology.is_disk
    quads = made.source.corners[made.source.offsets[:-1][sizes == 4][:, None] + np.arange(4)]
    corners = made.mesh.vertices[quads]
    before, after = np.roll(corners, 1, axis=1) - corners, np.roll(corners, -1, axis=1) - corners
    cosines = np.einsum("qkd,qkd->qk", before, after) / np.linalg.norm(before, axis=2) / np.linalg.norm(after, axis=2)
    assert np.median(np.abs(np.degrees(np.arccos(cosines)) - 90.0)) < 4.0
    assert abs(len(made.mesh.vertices) - len(maps[target].mesh.vertices)) < 0.15 * len(maps[target].mesh.vertices)
    sides = np.linalg.norm(after, axis=2) / made.spacing
    assert np.quantile(sides, [0.1, 0.9]) == pytest.approx([0.85, 1.2], abs=0.35)
    assert volume_or_area(made.mesh) == pytest.approx(volume_or_area(maps[target].mesh), rel=0.03)


def test_a_quadtree_is_halved_where_short_sides_are_wanted_and_balanced():
    places = np.array([[0.02, 0.02], [0.9, 0.9]])
    tree = quadtree(np.zeros(2), 1.0, places, np.array([1.0 / 32, 0.5]))
    corners = tree.nodes[tree.squares]
    sides = corners[:, 1, 0] - corners[:, 0, 0]
    assert (corners[:, 2, 1] - corners[:, 1, 1]) == pytest.approx(sides)
    assert (sides**2).sum() == pytest.approx(1.0)
    low = corners[:, 0] - np.column_stack([1e-3 * corners[:, 0, 1], np.zeros(len(corners))])
    for place, side in zip(places, (1.0 / 32, 0.5), strict=True):
        assert sides[((low <= place) & (place < low + sides[:, None])).all(axis=1)] == pytest.approx(side)
    for one, size in zip(low, sides, strict=True):
        touches = ((low <= one + size + 1e-9) & (one <= low + sides[:, None] + 1e-9)).all(axis=1)
        assert sides[touches].max() <= 2.0 * size + 1e-12


def test_a_quadtree_is_finest_at_the_place_that_wants_it():
    place = np.array([[0.3, 0.98]])
    tree = quadtree(np.zeros(2), 1.0, place, np.array([2.0**-14]))
    assert np.linalg.norm(tree.nodes - place, axis=1).min() < 2.0**-14


def test_the_hausdorff_distance_of_parallel_squares_and_of_a_bump():
    flat = grid(10)
    lifted_up = pgcp.Mesh(flat.vertices + np.array([0.0, 0.0, 0.25]), flat.faces)
    assert hausdorff_distance(flat, lifted_up, 2000) == pytest.approx((0.25, 0.25), abs=1e-12)
    bump = flat.vertices.copy()
    bump[60, 2] = 0.3
    there, back = hausdorff_distance(pgcp.Mesh(bump, flat.faces), flat, 2000)
    assert there == pytest.approx(0.3, abs=1e-12)
    assert back < 0.15


def test_colours_and_split_vertices_of_the_input_go_through(maps):
    """A seam of the file that splits vertices is joined; colours are those of the places on the surface."""
    red = np.rint(255 * HILLS.vertices[:, 0]).astype(np.uint8)
    seam = np.flatnonzero(np.abs(HILLS.vertices[:, 0] - 0.5) < 0.05)
    faces = HILLS.faces.astype(np.int64)
    right = HILLS.vertices[faces].mean(axis=1)[:, 0] > 0.5
    number = np.arange(len(HILLS.vertices))
    number[seam] = len(HILLS.vertices) + np.arange(len(seam))
    faces[right] = number[faces[right]]
    of = np.concatenate([np.arange(len(HILLS.vertices)), seam])
    colours = {"red": red[of], "green": np.zeros_like(red)[of], "blue": np.full_like(red, 9)[of]}
    result = pgcp.parameterize(Source(HILLS.vertices[of], faces.reshape(-1), of_vertices=colours), patches=2)
    made = remesh(result, vertices=300)
    assert len(made.mesh.vertices) == pytest.approx(300, abs=3)
    assert np.abs(made.source.of_vertices["red"] - 255.0 * made.mesh.vertices[:, 0]).max() <= 1.5
    assert set(made.source.of_vertices["blue"].tolist()) == {9}


def test_the_command_writes_meshes_a_picture_and_figures(folder, capsys):
    assert main(["remesh", "ball.ply", "--vertices", "400", "--patches", "2"]) == 0
    said = capsys.readouterr().out
    assert "400 vertices, 796 triangles, before 642 and 1,280" in said
    assert names(folder)[1:] == ["ball_remesh/ball.obj", "ball_remesh/ball.ply", "ball_remesh/ball_remesh.png",
                                 "ball_remesh/remesh.json", "hills.ply"]  # fmt: skip
    record = json.loads((folder / "ball_remesh" / "remesh.json").read_text())
    assert record["after"]["faces"] == 796
    assert record["hausdorff"] == max(record["from_before"], record["from_after"]) < 0.05
    Image.open(folder / "ball_remesh" / "ball_remesh.png").verify()
    for ending in ("ply", "obj"):
        assert len(pgcp.read_mesh(f"ball_remesh/ball.{ending}").faces) == 796


def test_single_files_of_other_formats(folder):
    files = ["new.stl", "new.glb", "new.off", "new.vtp"]
    words = [word for name in files for word in ("-o", name)]
    assert main(["remesh", "hills.ply", "--edge", "0.1", "--quiet", *words]) == 0
    for name in files:
        mesh = pgcp.read_mesh(name)
        assert examine(mesh.faces, len(mesh.vertices)).is_disk


def test_quads_are_written_as_quads(folder):
    assert main(["remesh", "hills.ply", "--edge", "0.1", "--quads", "-o", "new.obj", "--quiet"]) == 0
    corners = [len(line.split()) - 1 for line in (folder / "new.obj").read_text().splitlines() if line.startswith("f ")]
    assert corners.count(4) > 30


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--edge", "2"], "the edge length 2 is longer than hills.ply, whose diagonal is 1.5"),
        (["--edge", "0"], "--edge is 0.0; it must be a number above 0"),
        (["--edge", "nan"], "--edge is nan; it must be a number above 0"),
        (["--edge", "1e-9"], "edges of length 1e-09 make"),
        (["--edge", "x"], "argument --edge: 'x' is no number"),
        (["--vertices", "3"], "--vertices is 3; from 12 to 2,000,000 are made"),
        (["--vertices", "1.5"], "argument --vertices: '1.5' is no whole number"),
        (["--edge", "0.1", "--vertices", "90"], "--edge and --vertices both say how fine the mesh is to be"),
        (["-o", "new.xyz"], "new.xyz: remesh writes no such file"),
    ],
)
def test_mistakes_are_said_in_one_sentence_and_nothing_is_written(folder, capsys, words, message):
    assert main(["remesh", "hills.ply", *words]) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith(f"pgcp remesh: {message}")
    assert names(folder) == ["ball.ply", "hills.ply"]


def test_maps_that_fold_or_overlap_and_surfaces_with_holes_are_refused(maps):
    free = maps["free"]
    folded = replace(free, quality=replace(free.quality, folds=2))
    with pytest.raises(pgcp.FoldError):
        remesh(folded)
    with pytest.raises(pgcp.InputError, match="one surface without holes"):
        remesh(replace(free, mesh=pgcp.Mesh(HILLS.vertices, np.delete(HILLS.faces, 600, axis=0))))
    turned = free.coordinates - free.coordinates.mean(axis=0)
    z = turned[:, 0] + 1j * turned[:, 1]
    around = np.exp(z * 7.0 / np.ptp(z.imag))
    overlapping = replace(free, coordinates=np.column_stack([around.real, around.imag]))
    with pytest.raises(pgcp.NumericalError, match="overlaps itself"):
        remesh(overlapping)


def test_a_map_with_folds_ends_with_status_3(folder, capsys, monkeypatch):
    folded = pgcp.parameterize(HILLS, patches=2)
    folded = replace(folded, quality=replace(folded.quality, folds=2))
    monkeypatch.setattr("pgcp.api.compute", lambda *_: folded)
    assert main(["remesh", "hills.ply"]) == 3
    assert names(folder) == ["ball.ply", "hills.ply"]
    assert "fold" in capsys.readouterr().err
