"""Texture coordinates: upright, within the square, never mirrored, and cut once around the sphere."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import cap, grid, icosphere, lifted

from pgcp import Mesh
from pgcp.errors import InputError
from pgcp.finish.unit_square import MARGIN, in_unit_square, on_the_globe


def turned(points, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return points @ np.array([[c, s], [-s, c]])


def areas(points, faces):
    a, b, c = points[faces].swapaxes(0, 1)
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("degrees", [0, 37, 90, 179, -120])
def test_a_plane_stands_upright_whichever_way_it_was_mapped(axis, degrees):
    flat = grid(6, 4).vertices[:, :2] * [3, 1]
    vertices = np.zeros((len(flat), 3))
    vertices[:, {"x": 2, "y": 0, "z": 0}[axis]], vertices[:, "xyz".index(axis)] = flat.T
    mesh = Mesh(vertices, grid(6, 4).faces)
    layout = in_unit_square(mesh, turned(flat, degrees) * 7 + [100, -3], axis)
    wanted = flat * (1 - 2 * MARGIN) / np.ptp(flat, axis=0).max()
    assert np.allclose(layout.points - layout.points[0], wanted - wanted[0], atol=1e-12)
    assert np.allclose(layout.points.min(axis=0) + layout.points.max(axis=0), 1)
    assert layout.record["up"] == axis
    assert layout.faces is mesh.faces
    if axis != "x":
        assert in_unit_square(mesh, flat).record["up"] == axis


def test_a_layout_keeps_angles_and_sides():
    mesh = lifted(grid(8))
    uv = mesh.vertices[:, :2] * 3 + 5
    layout = in_unit_square(mesh, uv)
    ratio = areas(layout.points, mesh.faces) / areas(uv, mesh.faces)
    assert np.allclose(ratio, layout.record["scale"] ** 2)
    assert layout.points.min() >= MARGIN - 1e-12
    assert layout.points.max() <= 1 - MARGIN + 1e-12


def test_a_disk_fills_the_square_and_one_from_above_is_not_turned():
    mesh, z = cap(12)
    uv = np.column_stack([z.real, z.imag]) / np.abs(z).max()
    layout = in_unit_square(mesh, uv, "z")
    assert np.allclose(layout.points, 0.5 + 0.48 * uv, atol=0.03)
    assert layout.record["up"] is None
    assert layout.record["angle_deg"] == 0


def test_vertices_that_no_face_uses_stay_in_the_square():
    mesh = Mesh(np.vstack([grid(3).vertices, [[9, 9, 9]]]), grid(3).faces)
    points = in_unit_square(mesh, mesh.vertices[:, :2]).points
    assert ((points >= 0) & (points <= 1)).all()
    assert points[:-1].max() == pytest.approx(1 - MARGIN)


@pytest.mark.parametrize("up", ["y", "z", "x"])
def test_longitude_and_latitude_lie_the_right_way_round(up):
    mesh = icosphere(4)
    tilt = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    points = mesh.vertices @ (tilt * np.linalg.det(tilt)).T
    points /= np.linalg.norm(points, axis=1)[:, None]
    mesh = Mesh(points, mesh.faces)
    layout = on_the_globe(mesh, points, up)
    assert layout.record["up"] == up
    corners = layout.points[layout.faces]
    assert (areas(layout.points, layout.faces) <= 0).sum() <= 2  # a face with a pole inside has all longitudes
    assert layout.points[: len(points)].min() >= 0
    assert layout.points[: len(points)].max() <= 1
    assert corners[..., 0].min(axis=1).max() <= 1
    latitude = np.pi * (layout.points[: len(points), 1] - 0.5)
    assert np.allclose(np.sin(latitude), points[:, "xyz".index(up)])
    turns = corners[..., 0] - layout.points[mesh.faces, 0]
    assert np.abs(turns - np.rint(turns)).max() < 1e-9
    copied = layout.faces >= len(points)
    assert copied.any()
    assert np.array_equal(layout.copies[layout.faces[copied] - len(points)], mesh.faces[copied])
    assert np.array_equal(layout.faces[~copied], mesh.faces[~copied])


def test_poles_at_vertices_have_a_longitude_in_each_face():
    """An octahedron: both poles are vertices of four faces."""
    points = np.array([[0, 0, 1], [0, -1, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, -1]], float)
    faces = np.array([[0, a, a % 4 + 1] for a in (1, 2, 3, 4)] + [[5, a % 4 + 1, a] for a in (1, 2, 3, 4)])
    layout = on_the_globe(Mesh(points, faces), points, "z")
    corners = layout.points[layout.faces]
    assert np.allclose(np.sort(corners[:4, 0, 0] % 1), [0.125, 0.375, 0.625, 0.875])
    assert np.allclose(corners[:4, 0, 0], corners[:4, 1:, 0].mean(axis=1))
    assert np.allclose(np.ptp(corners[..., 0], axis=1), 0.25)
    assert (areas(layout.points, layout.faces) > 0).all()


def test_the_front_of_a_globe_is_in_the_middle():
    mesh = icosphere(3)
    for up, front in (("z", [0, -1, 0]), ("y", [0, 0, 1])):
        layout = on_the_globe(mesh, mesh.vertices, up)
        nearest = np.argmax(mesh.vertices @ front)
        assert np.abs(layout.points[nearest] - 0.5).max() < 0.05


def test_an_axis_that_is_none_is_refused():
    for lay, points in ((in_unit_square, grid(2).vertices[:, :2]), (on_the_globe, grid(2).vertices)):
        with pytest.raises(InputError, match="unknown axis 'w'; choose from auto, x, y, z"):
            lay(grid(2), points, "w")


def test_faces_that_lie_at_the_pole_with_all_their_corners_have_finite_coordinates():
    ball = icosphere(2)
    points = ball.vertices.copy()
    top = int(np.argmax(points[:, 2]))
    around = np.unique(ball.faces[(ball.faces == top).any(axis=1)])
    points[around] = np.array([0.0, 0.0, 1.0]) + 1e-12 * (points[around] - points[top])
    layout = on_the_globe(ball, points / np.linalg.norm(points, axis=1, keepdims=True), "z")
    assert np.isfinite(layout.points).all()
