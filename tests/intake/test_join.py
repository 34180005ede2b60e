"""Split vertices are joined where that is right, and the map is given back on the vertices of the input."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from meshes import cap, grid

import pgcp
from pgcp.intake.given import take
from pgcp.intake.join import joined_vertices
from pgcp.surface.topology import examine
from pgcp.targets.fitting import Asked
from pgcp.types import Mesh

BALL = trimesh.creation.icosphere(2)


def soup(mesh, name="soup"):
    """Every face with vertices of its own, as flat shading leaves it."""
    return Mesh(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(mesh.faces.size).reshape(-1, 3), name)


def globe(n=8, m=16):
    """A sphere with a seam from pole to pole and a vertex for every face at a pole, as modellers write it."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, n + 1), 2 * np.pi * (np.arange(m + 1) % m) / m, indexing="ij")
    across = np.sin(theta)
    across[[0, -1]] = 0.0
    points = np.stack([across * np.cos(phi), across * np.sin(phi), np.cos(theta)], -1).reshape(-1, 3)
    i, j = (index.ravel() for index in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    a = i * (m + 1) + j
    lower, upper = np.column_stack([a, a + m + 1, a + m + 2])[i < n - 1], np.column_stack([a, a + m + 2, a + 1])[i > 0]
    return Mesh(points, np.vstack([lower, upper]), "globe")


def cut_open(n=12, m=6, turns=1.0):
    """A cylinder, or a part of one, cut along a line: its first and its last column of vertices are at one place."""
    flat = grid(n, m)
    angle = turns * 2 * np.pi * np.round(flat.vertices[:, 0] * n) / n
    points = np.column_stack([np.cos(angle), np.sin(angle), flat.vertices[:, 1] * n])
    last = np.isclose(flat.vertices[:, 0], 1.0)
    points[last] = points[np.isclose(flat.vertices[:, 0], 0.0)] if turns == 1.0 else points[last]
    return Mesh(points, flat.faces, "cylinder")


def taken(mesh, target="auto", **options):
    return take(mesh, examine(mesh.faces, len(mesh.vertices)), Asked(target), **options)


@pytest.mark.parametrize(
    "mesh", [soup(BALL), globe(), soup(trimesh.creation.box())], ids=["flat shaded", "seam", "24 vertices"]
)
def test_a_split_sphere_is_mapped_as_the_sphere(mesh):
    result = pgcp.parameterize(mesh, patches=2)
    assert result.target == "sphere"
    assert result.mesh.vertices.tobytes() == mesh.vertices.tobytes()
    assert np.array_equal(result.mesh.faces, mesh.faces)
    assert result.vertex_of is None
    (note,) = result.report["input"]
    places = len(np.unique(mesh.vertices[np.unique(mesh.faces)] + 0.0, axis=0))
    assert (note["step"], note["count"]) == ("join", len(np.unique(mesh.faces)) - places)
    whole, where = np.unique(mesh.vertices + 0.0, axis=0, return_inverse=True)
    spread = [np.ptp(result.coordinates[where.ravel() == k], axis=0).max() for k in range(len(whole))]
    used = np.isin(np.arange(len(mesh.vertices)), mesh.faces)
    assert max(s for s, k in zip(spread, range(len(whole)), strict=True) if used[where.ravel() == k].all()) == 0.0


def test_joined_vertices_are_mapped_as_if_they_had_never_been_split():
    """Faces and vertices in the same order as those of the whole ball: the same map."""
    whole = pgcp.parameterize(Mesh(BALL.vertices, BALL.faces), patches=1, seams="exact")
    split = pgcp.parameterize(soup(BALL), patches=1, seams="exact")
    apart = np.abs(np.linalg.norm(np.diff(whole.coordinates[BALL.faces], axis=1), axis=2) - np.linalg.norm(
        np.diff(split.coordinates[split.faces], axis=1), axis=2))  # fmt: skip
    assert apart.max() < 0.02


def test_a_surface_cut_open_on_purpose_stays_open():
    mesh = cut_open()
    result = pgcp.parameterize(mesh, patches=2)
    (note,) = result.report["input"]
    assert note["step"] == "apart"
    assert "2 boundary loops" in note["message"]
    assert result.target == "free"
    plain = pgcp.parameterize(mesh, patches=2, weld_distance=None)
    assert plain.report["input"] == []
    assert plain.coordinates.tobytes() == result.coordinates.tobytes()


def test_a_target_that_needs_an_open_surface_leaves_a_seam_open():
    mesh = globe()
    assert taken(mesh).topology.is_sphere
    assert taken(mesh, "disk").mesh is mesh
    assert taken(mesh, "disk").notes[0]["step"] == "apart"
    assert taken(mesh, distance=None).notes == ()


def test_a_seam_in_a_disk_is_closed():
    whole, _ = cap(6)
    mesh = soup(whole)
    given = taken(mesh)
    assert given.topology.is_disk
    assert given.topology.euler_characteristic == examine(whole.faces, len(whole.vertices)).euler_characteristic


def test_vertices_that_touch_only_in_a_point_stay_apart():
    one, two = grid(3), grid(3)
    points = np.vstack([one.vertices, two.vertices + one.vertices.max(axis=0)])
    faces = np.vstack([one.faces, two.faces + len(one.vertices)])
    topology = examine(faces, len(points))
    assert joined_vertices(points, faces, topology.twins) is None


def test_three_sheets_at_one_edge_are_not_joined():
    """A fin on an edge between two faces that are split: which two belong together is not to be guessed."""
    points = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 1]], float)
    mesh = soup(Mesh(points, np.array([[0, 2, 1], [1, 3, 0], [0, 1, 4]])))
    assert joined_vertices(mesh.vertices, mesh.faces, examine(mesh.faces, 9).twins) is None


def test_two_boxes_that_touch_along_an_edge_stay_two_boxes():
    """Four open edges are at one place; two of each box."""
    box = trimesh.creation.box()
    one = soup(box)
    points = np.vstack([one.vertices, one.vertices + np.array([1, 1, 0])])
    given = taken(Mesh(points, np.vstack([one.faces, one.faces + len(one.vertices)])))
    assert given.topology.is_sphere
    assert given.topology.face_count == 12
    assert [note["step"] for note in given.notes] == ["join", "component"]


def test_a_sheet_with_a_back_stays_two_sheets():
    front = grid(4)
    points = np.vstack([front.vertices, front.vertices])
    faces = np.vstack([front.faces, front.faces[:, ::-1] + len(front.vertices)])
    given = taken(Mesh(points, faces))
    assert given.topology.is_disk
    assert [note["step"] for note in given.notes] == ["component"]


@pytest.mark.parametrize(("distance", "sphere"), [(0.0, False), (1e-6, False), (1e-4, True)])
def test_places_may_be_apart_by_a_share_of_the_diagonal(distance, sphere):
    mesh = globe()
    noise = np.random.default_rng(3).uniform(-1e-5, 1e-5, mesh.vertices.shape)
    assert taken(Mesh(mesh.vertices + noise, mesh.faces), distance=distance).topology.is_sphere == sphere


def test_a_centre_and_cuts_are_given_in_the_input_s_numbers(tmp_path):
    mesh = soup(BALL)
    twin = int(np.flatnonzero((mesh.vertices == mesh.vertices[100]).all(axis=1))[-1])
    result = pgcp.parameterize(mesh, centre=twin, patches=2)
    assert np.allclose(result.coordinates[[100, twin]], [0, 0, 1], atol=1e-9)


def test_what_is_fixed_is_given_back_split():
    faces = soup(BALL).faces.copy()
    faces[7] = faces[7][[0, 2, 1]]
    turned = Mesh(soup(BALL).vertices, faces)
    result = pgcp.parameterize(turned, fix=True, patches=2)
    assert result.target == "sphere"
    assert np.array_equal(np.sort(result.mesh.faces, axis=1), np.sort(faces[result.face_of], axis=1)) or (
        np.array_equal(result.mesh.vertices, turned.vertices[result.vertex_of])
    )
    assert np.isfinite(result.coordinates).all()


def test_distances_that_are_none_are_refused():
    with pytest.raises(pgcp.InputError, match=r"weld_distance is 0\.5, it must be from 0 to 0\.01"):
        pgcp.parameterize(globe(), weld_distance=0.5)
