from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import numpy as np
from matplotlib.image import imread
from meshes import cap, grid, spheroid

import pgcp
from pgcp.report import draw
from pgcp.report.picture import _checker, _mercator
from pgcp.report.raster import _visible, rasterise

ROOT = Path(__file__).resolve().parents[1]


def test_every_pixel_of_a_square_shows_the_face_it_lies_in():
    mesh = grid(5)
    screen = mesh.vertices * [90, 90, 1] + [5, 5, 0]
    seen, weights = _visible(screen, mesh.faces, 100)
    inside = seen[6:94, 6:94]
    assert (inside >= 0).all()
    assert (seen[:4] == -1).all()
    rows, columns = np.nonzero(seen >= 0)
    corners = screen[mesh.faces[seen[rows, columns]]]
    place = np.einsum("mk,mkd->md", weights[rows, columns], corners)
    assert np.abs(place[:, 0] - columns).max() < 1e-9
    assert np.abs(place[:, 1] - rows).max() < 1e-9


def test_the_nearer_face_hides_the_farther_one():
    screen = np.array([[0.0, 0, 0], [40, 0, 0], [0, 40, 0], [0, 0, 5], [40, 0, 5], [0, 40, 5]])
    for order in ([[0, 1, 2], [3, 4, 5]], [[3, 4, 5], [0, 1, 2]]):
        seen, _ = _visible(screen, np.array(order), 41)
        assert set(np.unique(seen)) == {-1, order.index([3, 4, 5])}


def test_a_surface_of_tiny_faces_has_no_holes():
    mesh, _ = cap(400)
    image = rasterise(mesh.vertices, mesh.faces, lambda ids, _: np.zeros((len(ids), 3)))
    dark = image.sum(axis=2) == 0
    radius = np.hypot(*(np.indices(dark.shape) - (len(dark) - 1) / 2))
    assert dark[radius < 0.48 * len(dark)].all()


def test_the_picture_shows_all_patches_and_is_the_same_every_time():
    result = pgcp.parameterize(grid(12), patches=4)
    one = draw(result)
    assert one == draw(result)
    picture = imread(io.BytesIO(one))
    middle = picture[:, picture.shape[1] // 3 : 2 * picture.shape[1] // 3, :3].reshape(-1, 3)
    colours, counts = np.unique(np.round(middle, 2), axis=0, return_counts=True)
    assert (counts[colours.max(axis=1) - colours.min(axis=1) > 0.1] > 0.02 * len(middle)).sum() == 4


def test_the_accuracy_table(tmp_path):
    pgcp.write_mesh(tmp_path / "cap.ply", cap(16)[0])
    command = [sys.executable, ROOT / "scripts" / "accuracy.py", tmp_path / "cap.ply", "--patches", "2,3", "--seeds", "0,1"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    rows = [line.split("\t") for line in done.stdout.splitlines()]
    assert [row[2:4] for row in rows[1:]] == [["1", "-"], ["2", "0"], ["2", "1"], ["3", "0"], ["3", "1"]]
    assert all(0.8 < float(row[5]) < 1.2 and row[6] == "0" for row in rows[1:])


def test_the_picture_of_a_sphere_shows_both_sides():
    mesh, _ = spheroid(4, 2.0)
    image = imread(io.BytesIO(draw(pgcp.parameterize(mesh, patches=3))))
    flat = imread(io.BytesIO(draw(pgcp.parameterize(grid(8), patches=2))))
    assert image.shape[1] > 1.2 * flat.shape[1]
    quarter = image.shape[1] // 4
    for panel in (1, 2):
        colours = image[:, panel * quarter : (panel + 1) * quarter, :3]
        seen = colours[np.ptp(colours, axis=2) > 0.2]
        assert len(seen) > 0.2 * colours.shape[0] * colours.shape[1]


def test_the_checkerboard_of_a_sphere_has_even_squares_of_one_size():
    """On the round sphere near the equator: equal shares of dark and light, and no break where the turn closes."""
    angle = np.linspace(-np.pi, np.pi, 4001)[:-1]
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.full(4000, 0.1), np.ones(4000), np.full(4000, np.log2(0.2))])
    dark = _checker(_mercator(ring))[:, 0] < 0.5
    runs = np.flatnonzero(dark != np.roll(dark, 1))
    assert len(runs) in (32, 64)
    assert np.ptp(np.diff(runs)) <= 2
    assert (runs[0] + 4000 - runs[-1]) - np.diff(runs)[0] <= 2


def script(name, *words):
    return subprocess.run([sys.executable, ROOT / "scripts" / name, *words], capture_output=True, text=True, check=True)


def test_the_matrix_counts_runs_and_resumes(tmp_path):
    mesh, _ = cap(6)
    pgcp.write_mesh(tmp_path / "cap.ply", mesh)
    words = (tmp_path / "cap.ply", "--patches", "1,300", "--seeds", "0,1", "--output", tmp_path / "out.tsv")
    done = script("matrix.py", *words)
    rows = [line.split("\t") for line in done.stdout.splitlines()]
    assert [row[1:4] for row in rows] == [[t, k, s] for t in ("free", "disk") for k in ("1", "300") for s in ("0", "1")]
    assert [row[6] for row in rows] == ["weld", "weld", "failed", "failed"] * 2
    assert all(row[5] == "0" for row in rows if row[6] != "failed")
    assert "300 patches were asked for" in rows[2][9]
    assert "8 runs:" in done.stderr
    assert "failed 4" in done.stderr
    again = script("matrix.py", *words)
    assert again.stdout == ""
    assert again.stderr == done.stderr


def test_seams_are_compared(tmp_path):
    mesh, _ = cap(6)
    pgcp.write_mesh(tmp_path / "cap.ply", mesh)
    words = (tmp_path / "cap.ply", "--targets", "free", "--patches", "3", "--plot", tmp_path / "plot.png")
    header, *rows = (line.split("\t") for line in script("seams.py", *words).stdout.splitlines())
    assert header[3:7] == ["seams", "mean_deg", "near_deg", "elsewhere_deg"]
    assert [row[3] for row in rows] == ["weld", "relax", "exact"]
    for row in rows:
        mean, near, elsewhere = (float(x) for x in row[4:7])
        assert min(near, elsewhere) <= mean <= max(near, elsewhere)
    assert (tmp_path / "plot.png").read_bytes()[:4] == b"\x89PNG"
