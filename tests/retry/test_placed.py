"""Maps in their place: no fold in the coordinates that are given out, nor in the files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from meshes import grid, icosphere

import pgcp
from pgcp.finish.place import Unplaced, as_they_are, scale_only, turn_by_axes
from pgcp.finish.quality import single_precision_folds
from pgcp.finish.unit_square import in_unit_square
from pgcp.io.write import write_outputs
from pgcp.plane.space import PLANE, SPHERE, find_folds
from pgcp.surface.topology import examine
from pgcp.types import Mesh


def helicoid(n: int = 300, m: int = 8) -> Mesh:
    """Four turns of a helicoid, n by m cells."""
    flat = grid(n, m)
    u, w = flat.vertices[:, 0], flat.vertices[:, 1] / flat.vertices[:, 1].max()
    r = 0.2 + 0.8 * w
    return Mesh(np.column_stack([np.cos(25 * u) * r, np.sin(25 * u) * r, 3 * u]), flat.faces, "helicoid")


def test_folds_that_placing_brings_are_taken_away():
    mesh = helicoid()
    result = pgcp.parameterize(mesh, target="disk")
    assert result.quality.folds == 0
    assert len(find_folds(PLANE, mesh.faces, PLANE.positions(result.coordinates))) == 0


def test_a_sphere_is_turned_by_axes_without_rounding():
    mesh = icosphere(2)
    points = mesh.vertices[:, [1, 2, 0]] * [-1.0, 1.0, -1.0]
    points[0] = [1e-70, -3e-80, 1.0]
    placed = turn_by_axes(Unplaced(mesh, points, np.empty(0, int), np.ones(len(points), bool)))
    assert np.array_equal(placed[1:], mesh.vertices[1:])
    assert placed[0].tolist() == [-1.0, -1e-70, -3e-80]


def test_the_plane_is_placed_without_rounding():
    mesh = grid(6)
    z = (mesh.vertices[:, 0] + 1j * mesh.vertices[:, 1]) / 11.0
    boundary = examine(mesh.faces, len(mesh.vertices)).loops[0]
    done = Unplaced(mesh, z, boundary, np.ones(len(z), bool))
    assert np.array_equal(as_they_are(done) @ [1, 1j], z)
    assert np.array_equal(scale_only(done) @ [1, 1j], 8.0 * z)


@pytest.mark.parametrize("small", [False, True])
def test_coordinates_that_32_bits_would_fold_are_written_as_doubles(tmp_path, small):
    mesh = grid(4)
    points = mesh.vertices.copy()
    if small:
        points[points[:, 0] == 0.5, 0] = 0.25 + 1e-9  # one such place can lie at the origin, but not both
        points[points[:, 0] == 0.75, 0] = 1.0 - 1e-9
    result = pgcp.parameterize(Mesh(points, mesh.faces, "sheet"), target="free")
    assert result.quality.folds == 0
    assert (result.report["single_precision_folds"] > 0) == small
    write_outputs(tmp_path, "m", result, {}, kinds=["ply"])
    header = (tmp_path / "m.ply").read_bytes().split(b"end_header")[0]
    assert (b"property double s" if small else b"property float s") in header


def test_texture_coordinates_say_what_rounding_folds(tmp_path):
    mesh = grid(2)
    near = mesh.vertices[:, :2].copy()
    near[near == 0.5] = 1e-40  # doubles have room for it at 0, but not in the middle of the unit square
    near[near == 0.0] = -1e-40
    near[near == 1.0] = 2.0
    assert len(find_folds(PLANE, mesh.faces, PLANE.positions(near))) == 0
    record = in_unit_square(mesh, near).record
    assert record["folds"] > 0
    assert record["single_precision_folds"] >= record["folds"]
    far = in_unit_square(mesh, 1e-12 * mesh.vertices[:, :2]).record  # it is as large as any in the unit square
    assert far["folds"] == far["single_precision_folds"] == 0


@pytest.mark.parametrize("uv", ["unit", "surface"])
def test_files_hold_all_digits_where_those_written_need_them(tmp_path, uv):
    mesh = grid(4)
    result = pgcp.parameterize(mesh, target="free")
    small = replace(result, coordinates=1e-12 * result.coordinates, report={**result.report, "single_precision_folds": 9})
    write_outputs(tmp_path, "m", small, {}, kinds=["ply", "obj"], layout=small.layout(uv))
    header = (tmp_path / "m.ply").read_bytes().split(b"end_header")[0]
    assert (b"property double s" if uv == "surface" else b"property float s") in header
    texts = [line.split()[1] for line in (tmp_path / "m.obj").read_text().splitlines() if line.startswith("vt")]
    assert (max(map(len, texts)) > 12) == (uv == "surface")


def test_folds_in_32_bits_are_counted_in_any_space():
    mesh = icosphere(2)
    assert single_precision_folds(SPHERE, mesh.faces, mesh.vertices) == 0
    plane = grid(3)
    assert single_precision_folds(PLANE, plane.faces, plane.vertices[:, :2] * 1e-3 + 1e6) == len(plane.faces)
    assert single_precision_folds(PLANE, plane.faces, plane.vertices[:, :2] * 1e300) == len(plane.faces)
    # as (u, 1 - v) what is small disappears beside 1
    assert single_precision_folds(PLANE, plane.faces, plane.vertices[:, :2] * 1e-12) > 0
