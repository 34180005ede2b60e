"""Where finished maps lie: size, centre and direction."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import cap, grid, icosphere, similarity_error
from scipy.spatial.transform import Rotation

from pgcp.finish.place import Unplaced, as_coordinates, place_disk, place_free, place_sphere, turn_to_surface
from pgcp.surface.operators import face_areas
from pgcp.surface.topology import examine
from pgcp.types import Mesh


def unplaced(mesh, positions):
    """A map of which all vertices are in use."""
    loops = examine(mesh.faces, len(mesh.vertices)).loops
    boundary = loops[0] if loops else np.empty(0, int)
    return Unplaced(mesh, positions, boundary, np.ones(len(positions), bool))


@pytest.mark.parametrize("turn", [0.0, 0.4, 1.5, 2.8, 4.0])
@pytest.mark.parametrize("shape", [(12, 3), (3, 12)])
def test_a_free_maps_long_axis_is_horizontal_its_area_the_surfaces(turn, shape):
    mesh = grid(*shape)
    z = 0.2 * np.exp(1j * turn) * (mesh.vertices @ [1, 1j, 0]) + 7 - 3j
    done = unplaced(mesh, z)
    placed = place_free(done)
    wide, high = np.ptp(placed, axis=0)
    sides = sorted(np.ptp(mesh.vertices[:, :2], axis=0))
    assert (wide, high) == pytest.approx((sides[1], sides[0]), rel=1e-9)
    assert placed[done.boundary].mean(axis=0) == pytest.approx([0, 0], abs=1e-12)
    assert similarity_error(placed @ [1, 1j], z) < 1e-12  # moved and turned, not mirrored


def test_area_is_the_surfaces_and_not_its_shadows():
    mesh = grid(9)
    tilted = Mesh(mesh.vertices @ np.array([[1.0, 0, 2.0], [0, 1, 0], [0, 0, 1]]), mesh.faces)
    placed = place_free(unplaced(tilted, mesh.vertices @ [1, 1j, 0]))
    solid = np.column_stack([placed, np.zeros(len(placed))])
    assert face_areas(solid, mesh.faces).sum() == pytest.approx(np.sqrt(5.0))


def test_a_map_that_faces_down_keeps_its_size():
    mesh = grid(8, 2)
    placed = place_free(unplaced(mesh, 3j * np.conj(mesh.vertices @ [1, 1j, 0])))
    assert np.ptp(placed, axis=0) == pytest.approx([1, 0.25])


def test_vertices_that_no_face_uses_are_at_the_origin():
    used = np.array([True, False, True])
    assert as_coordinates(np.array([1 + 2j, 5 + 5j, 3j]), used).tolist() == [[1, 2], [0, 0], [0, 3]]
    mesh = icosphere(1)
    points = np.vstack([mesh.vertices, [[0.6, 0.8, 0.0]]])
    more = Mesh(points, mesh.faces)
    placed = place_sphere(Unplaced(more, points, np.empty(0, int), np.arange(len(points)) < len(mesh.vertices)))
    assert placed[-1].tolist() == [0, 0, 1]
    assert placed[:-1] == pytest.approx(mesh.vertices)


def test_a_disk_has_its_first_boundary_vertex_at_one_and_a_vertex_at_its_centre():
    mesh, exact = cap(6)
    z = exact / np.abs(exact).max() * np.exp(0.7j)
    done = unplaced(mesh, z)
    plain = place_disk(done) @ [1, 1j]
    assert plain[done.boundary[0]] == 1.0
    assert np.abs(np.abs(plain[done.boundary]) - 1).max() < 1e-15
    assert plain == pytest.approx(z * np.conj(z[done.boundary[0]]), abs=1e-14)
    centred = place_disk(done, 10) @ [1, 1j]
    assert abs(centred[10]) < 1e-15
    assert centred[done.boundary[0]] == 1.0
    assert np.abs(np.abs(centred[done.boundary]) - 1).max() < 1e-15


@pytest.mark.parametrize("seed", range(3))
def test_a_sphere_is_turned_back_however_it_was_turned_and_wherever_the_surface_lies(seed):
    mesh = icosphere(2)
    turned = mesh.vertices @ Rotation.random(random_state=seed).as_matrix().T
    surface = Mesh(5.0 * mesh.vertices + [100.0, -20.0, 3.0], mesh.faces)
    assert turn_to_surface(surface, turned) == pytest.approx(mesh.vertices, abs=1e-9)
    placed = place_sphere(unplaced(surface, turned), 11)
    assert placed[11] == pytest.approx([0, 0, 1])
    assert placed @ placed.T == pytest.approx(turned @ turned.T, abs=1e-12)


def test_a_sphere_is_not_mirrored_even_where_that_would_bring_it_closer():
    mesh = icosphere(2)
    mirrored = mesh.vertices * [1, 1, -1]
    turned = turn_to_surface(mesh, mirrored)
    assert np.linalg.det(np.linalg.lstsq(mirrored, turned, rcond=None)[0]) == pytest.approx(1.0)


def test_the_turn_weighs_faces_by_their_area():
    """Half of a sphere is cut into sixteen times as many faces and turned differently: it counts for its area."""
    fine, coarse = icosphere(4), icosphere(2)
    top = fine.faces[fine.vertices[fine.faces].mean(axis=1)[:, 2] > 0.4]
    rest = coarse.faces[coarse.vertices[coarse.faces].mean(axis=1)[:, 2] < 0.4]
    surface = np.vstack([fine.vertices, coarse.vertices])
    faces = np.vstack([top, rest + len(fine.vertices)])
    away, other = Rotation.from_rotvec([0.2, 0.7, 0.1]), Rotation.from_rotvec([-0.6, 0.4, 0.9])
    image = np.vstack([away.apply(fine.vertices), other.apply(coarse.vertices)])
    mesh = Mesh(surface, faces)
    areas = face_areas(surface, faces)
    centres, places = (points[faces].mean(axis=1) for points in (surface, image))
    centres = centres - areas @ centres / areas.sum()
    exact = Rotation.align_vectors(centres, places, weights=areas)[0]
    assert turn_to_surface(mesh, image) == pytest.approx(exact.apply(image), abs=1e-9)
    unweighted = Rotation.align_vectors(centres, places)[0]
    assert (exact * unweighted.inv()).magnitude() > 0.1


def test_a_free_maps_boundary_not_all_its_vertices_has_its_mean_at_the_origin():
    """Vertices are crowded on one side, which must not draw the map there."""
    flat = grid(10)
    mesh = Mesh(flat.vertices ** [3, 1, 1], flat.faces)
    (boundary,) = examine(mesh.faces, len(mesh.vertices)).loops
    z = mesh.vertices @ [1, 1j, 0]
    placed = place_free(Unplaced(mesh, z, boundary, np.ones(len(z), bool)))
    assert np.abs(placed[boundary].mean(axis=0)).max() < 1e-12
    assert np.abs(placed.mean(axis=0)).max() > 0.01
