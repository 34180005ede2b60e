"""Random shapes, mapped to any target by any method: right and without folds, or refused in one sentence.

``PGCP_RUNS`` says how many runs there are, 40 unless it does; run N is the same each time: ``scripts/matrix.py --only N``.
"""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

import numpy as np
import pytest
from judge import boundary_of, covered, faults_of, flipped_in_plane, flipped_on_sphere, mean_error
from meshes import cap, grid, icosphere
from runs import OUTCOMES, case_of
from shapes import KINDS
from surfaces import is_disk_or_sphere

RUNS = int(os.environ.get("PGCP_RUNS", "40"))
SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "matrix.py"
_spec = importlib.util.spec_from_file_location("matrix", SCRIPT)
matrix = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(matrix)


@pytest.mark.slow
@pytest.mark.timeout(3600 + 30 * RUNS)
def test_random_shapes_are_mapped_or_refused():
    rows = list(matrix.done_by(range(RUNS), 1))
    print(f"\n{matrix.table(rows)}")
    assert [row for row in rows if row["outcome"] == matrix.FAULT] == []


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("faces", [1, 7, 300])
def test_shapes_are_disks_or_spheres(kind, faces):
    for seed in range(5):
        shape = KINDS[kind](np.random.default_rng(seed), faces)
        assert is_disk_or_sphere(shape.faces) == ("sphere" if shape.closed else "disk")
        assert np.isfinite(shape.vertices).all()
        assert len(np.unique(shape.faces)) == len(shape.vertices)
        if shape.image is not None:
            flipped = flipped_on_sphere if shape.closed else flipped_in_plane
            assert flipped(shape.image, shape.faces) == 0


def test_a_run_is_known_by_its_number():
    one, two, other = case_of(12), case_of(12), case_of(13)
    assert one.told() == two.told() != other.told()
    assert np.array_equal(one.shape.vertices, two.shape.vertices)
    assert set(OUTCOMES) == set(matrix.COLUMNS)


def test_folds_are_seen():
    mesh = grid(6)
    plane = mesh.vertices[:, :2].copy()
    everything = np.arange(len(plane))
    assert faults_of(plane, mesh.faces, "free", everything) == []
    assert faults_of(plane * 1e-170, mesh.faces, "free", everything) == []  # products of such numbers are 0 in doubles
    plane[10] = plane[17]
    assert faults_of(plane, mesh.faces, "free", everything)[0].endswith("folds")
    assert flipped_in_plane(plane[:, ::-1], mesh.faces) > 60
    near = np.array([[0.0, 0.0], [1.0, 1.0], [0.5, np.nextafter(0.5, 1)]])  # a sliver whose area is lost in doubles
    assert flipped_in_plane(near, np.array([[0, 1, 2]])) == 0
    assert flipped_in_plane(near, np.array([[0, 2, 1]])) == 1


def test_folds_on_the_sphere_are_seen():
    ball = icosphere(2)
    everything = np.arange(len(ball.vertices))
    assert faults_of(ball.vertices, ball.faces, "sphere", everything) == []
    assert flipped_on_sphere(ball.vertices, ball.faces[:, ::-1]) == len(ball.faces)
    assert covered(ball.vertices, ball.faces) == pytest.approx(1)
    assert faults_of(1.001 * ball.vertices, ball.faces, "sphere", everything) == ["off the sphere by 1e-03"]
    points = ball.vertices.copy()
    points[5] = points[100]
    assert faults_of(points, ball.faces, "sphere", everything)[0].endswith("folds")


def test_what_leaves_the_disk_is_seen():
    mesh, z = cap(4)
    z = z / np.abs(z).max()
    disk, everything = np.column_stack([z.real, z.imag]), np.arange(len(z))
    loop = boundary_of(mesh.faces)
    disk[loop] /= np.linalg.norm(disk[loop], axis=1)[:, None]
    assert faults_of(disk, mesh.faces, "disk", everything) == []
    assert "off the circle" in faults_of(1.001 * disk, mesh.faces, "disk", everything)[0]
    disk[loop[3]] *= 0.99
    assert "off the circle" in faults_of(disk, mesh.faces, "disk", everything)[0]
    assert mean_error(mesh.vertices, mesh.faces, mesh.vertices) < 1e-12
    assert mean_error(mesh.vertices, mesh.faces, np.column_stack([z.real, z.imag])) == pytest.approx(2.18, abs=0.01)
