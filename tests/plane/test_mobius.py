"""Moebius maps: projection, boosts, barycentres, and corrections that undo a known map."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import cap, grid, icosphere
from oracles import moebius_distance

from pgcp.errors import InputError
from pgcp.finish.correct import Setting, correct
from pgcp.finish.least_area import AreaSample, least_area_bend, least_area_boost, least_area_shift
from pgcp.finish.place import Unplaced, centred_in_disk, place_sphere
from pgcp.plane.mobius import (
    balance_sphere,
    bend_plane,
    boost,
    boost_matrix,
    rotation_to_north,
    shift_disk,
    to_plane,
    to_sphere,
)
from pgcp.surface.beltrami import beltrami_coefficients_on_sphere, covering_degree, folded_faces_on_sphere
from pgcp.surface.operators import face_areas
from pgcp.targets.registry import TARGETS
from pgcp.types import Mesh

RNG = np.random.default_rng(3)


def unit(n):
    x = RNG.normal(size=(n, 3))
    return x / np.linalg.norm(x, axis=1)[:, None]


def test_projection_and_back():
    points = unit(500)
    assert np.allclose(to_sphere(to_plane(points)), points, atol=1e-14)
    z = np.concatenate([10.0 ** RNG.uniform(-12, 12, 200) * np.exp(2j * np.pi * RNG.random(200)), [0.0]])
    assert np.allclose(to_plane(to_sphere(z))[np.abs(z) < 1e6], z[np.abs(z) < 1e6], rtol=1e-9)
    assert np.array_equal(to_sphere(np.array([np.inf + 0j, 0.0])), [[0, 0, -1], [0, 0, 1]])


def test_the_projection_keeps_orientation_seen_from_outside():
    z = np.array([0.1, 0.2 + 0.1j, 0.1 + 0.2j]) * np.exp(0.3j)
    assert len(folded_faces_on_sphere(np.array([[0, 1, 2]]), to_sphere(z))) == 0
    assert len(folded_faces_on_sphere(np.array([[0, 2, 1]]), to_sphere(z))) == 1


def test_rotation_takes_its_direction_north():
    for direction in [*unit(20), np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0])]:
        rotation = rotation_to_north(direction)
        assert np.allclose(rotation @ direction, [0, 0, 1], atol=1e-15)
        assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(rotation) > 0


@pytest.mark.parametrize("b", [(0.3, -0.2, 0.4), (0.0, 0.0, -0.9), (0.5, 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_boost_and_its_matrix_are_one_map(b):
    points, b = unit(200), np.array(b)
    (p, q), (r, s) = boost_matrix(b)
    z = to_plane(points)
    assert np.allclose(to_sphere((p * z + q) / (r * z + s)), boost(points, b), atol=1e-12)
    assert np.allclose(boost(boost(points, b), -b), points, atol=1e-13)


def test_the_balance_has_its_mean_at_the_centre_and_finds_a_boosted_balance_again():
    points = icosphere(3).vertices
    even = boost(points, np.array([0.2, 0.6, -0.7]))
    moved, _ = balance_sphere(to_plane(even), np.ones(len(points)))
    assert np.linalg.norm(moved.mean(axis=0)) < 1e-11
    assert np.allclose(moved @ moved.T, points @ points.T, atol=1e-9)  # the same up to a rotation


def test_crowded_points_keep_their_digits_when_balanced():
    ring = 1e-20 * np.exp(2j * np.pi * np.arange(6) / 6)
    z = np.concatenate([ring, 1.0 / ring[:5], [np.inf + 0j]])
    points, _ = balance_sphere(z, np.ones(12))
    assert np.linalg.norm(points.mean(axis=0)) < 1e-11
    crowd = to_plane(points[:6] if points[0, 2] > 0 else -points[:6])
    angles = np.sort(np.angle(crowd / crowd[0]))
    assert np.allclose(np.diff(angles), np.pi / 3, atol=1e-6)


def distorted(kind):
    """A flat or round map with areas as on its surface, and the same bent by a known Moebius map."""
    if kind == "sphere":
        good = icosphere(4)
        return good, good.vertices, boost(good.vertices, np.array([0.3, -0.1, 0.2]))
    if kind == "disk":
        mesh, z = cap(20)
        z = z / np.abs(z).max()
        return Mesh(np.column_stack([z.real, z.imag, 0 * z.real]), mesh.faces), z, shift_disk(z, 0.4 - 0.3j)
    mesh = grid(40)
    z = (mesh.vertices[:, 0] - 0.5) + 1j * (mesh.vertices[:, 1] - 0.5)
    return mesh, z, bend_plane(z, 0.5 + 0.4j)


def setting(mesh, positions, kind, boundary=()):
    """A correction's setting with all vertices in use."""
    target = TARGETS.get(kind)
    everything = np.arange(len(mesh.vertices))
    return Setting(mesh, target.space, positions, target.family(positions), np.array(boundary, int), everything)


@pytest.mark.parametrize("kind", ["sphere", "disk", "free"])
def test_the_area_correction_undoes_a_known_map(kind):
    mesh, good, bad = distorted(kind)
    boundary = np.arange(len(good) - 120, len(good)) if kind == "disk" else np.empty(0, int)
    here = setting(mesh, bad, kind, boundary)
    before = here.distortion(bad)[0]
    mended, record = correct(here, "area")
    assert record.share > 0
    assert record.log_area_before == pytest.approx(before)
    assert record.log_area_after == pytest.approx(here.distortion(mended)[0])
    assert record.log_area_after < 0.1 * before
    assert moebius_distance(mended, good) < 1e-9


def test_a_correction_that_cannot_help_leaves_the_map_alone():
    mesh = icosphere(3)
    same, record = correct(setting(mesh, mesh.vertices, "sphere"), "angle")
    assert record.angle_mean_after_deg <= record.angle_mean_before_deg
    same, record = correct(setting(mesh, mesh.vertices, "sphere"), "area")
    assert record.log_area_after <= record.log_area_before
    assert np.allclose(same, mesh.vertices, atol=1e-4)


@pytest.mark.parametrize("size", [100, 100_000])
def test_gradient_of_the_area_distortion(size):
    mesh = icosphere(3)
    image = boost(mesh.vertices, np.array([0.5, 0.1, 0.0]))
    sample = AreaSample(face_areas(mesh.vertices, mesh.faces), face_areas(image, mesh.faces), size)
    slope = RNG.normal(size=(len(sample.chosen), 2))
    start = RNG.normal(size=len(sample.chosen))
    value, gradient = sample.distortion(start, slope)
    for k in range(2):
        up, down = (sample.distortion(start + t * slope[:, k], slope)[0] for t in (1e-6, -1e-6))
        assert gradient[k] == pytest.approx((up - down) / 2e-6, rel=1e-5, abs=1e-8)
    assert value > 0


def test_a_sample_finds_what_all_faces_find():
    mesh = icosphere(5)
    image = boost(mesh.vertices, np.array([0.5, 0.1, 0.0]))
    surface, areas = face_areas(mesh.vertices, mesh.faces), face_areas(image, mesh.faces)
    for size in (2000, 100_000):
        sample = AreaSample(surface, areas, size)
        centres = image[mesh.faces[sample.chosen]].mean(axis=1)
        b = least_area_boost(centres / np.linalg.norm(centres, axis=1)[:, None], sample)
        assert np.allclose(b, [-0.5, -0.1, 0.0], atol=0.02)


def test_the_planar_searches_share_their_conventions():
    mesh, _, bad = distorted("disk")
    sample = AreaSample(face_areas(mesh.vertices, mesh.faces), np.ones(len(mesh.faces)))
    z = bad[mesh.faces[sample.chosen]].mean(axis=1)
    assert least_area_bend(z, sample) == np.conj(least_area_shift(z, sample))


def test_centres():
    mesh = icosphere(2)
    whole = Unplaced(mesh, mesh.vertices, np.empty(0, int), np.ones(len(mesh.vertices), bool))
    assert np.allclose(place_sphere(whole, 7)[7], [0, 0, 1])
    z = np.append(np.exp(2j * np.pi * np.arange(5) / 5), 0.3 + 0.2j)
    moved = centred_in_disk(z, 5, np.arange(5))
    assert abs(moved[5]) < 1e-15
    assert np.allclose(np.abs(moved[:5]), 1.0, atol=1e-15)
    with pytest.raises(InputError, match="vertex 2 is on the boundary"):
        centred_in_disk(z, 2, np.arange(5))
    z = np.append(np.exp(1j * np.array([0.0, 1e-9, 2.0, 4.0])), -0.99999)
    with pytest.raises(InputError, match="could not be told apart"):
        centred_in_disk(z, 4, np.arange(4))


def test_folds_degree_and_coefficients_on_the_sphere():
    mesh = icosphere(2)
    assert len(folded_faces_on_sphere(mesh.faces, mesh.vertices)) == 0
    assert covering_degree(mesh.faces, mesh.vertices) == pytest.approx(1.0, abs=1e-12)
    assert np.abs(beltrami_coefficients_on_sphere(mesh.vertices, mesh.faces, mesh.vertices)).max() < 1e-15
    inside_out = mesh.vertices * [-1, 1, 1]
    assert len(folded_faces_on_sphere(mesh.faces, inside_out)) == len(mesh.faces)
    assert covering_degree(mesh.faces, inside_out) == pytest.approx(-1.0, abs=1e-12)
    mu = beltrami_coefficients_on_sphere(mesh.vertices, mesh.faces, inside_out)
    assert np.abs(mu).min() > 1.0
    flipped = mesh.vertices.copy()
    flipped[0] = -flipped[0] + 0.1 * flipped[1]
    flipped[0] /= np.linalg.norm(flipped[0])
    folded = folded_faces_on_sphere(mesh.faces, flipped)
    assert len(folded) > 0
    mu = beltrami_coefficients_on_sphere(mesh.vertices, mesh.faces, flipped)
    assert np.array_equal(np.flatnonzero(np.abs(mu) >= 1.0), folded)


def test_a_fold_on_the_sphere_is_decided_exactly():
    a = np.array([1.0, 0.0, 0.0])
    for tiny in (2.0**-52, -(2.0**-52)):
        points = np.array([a, [1.0, 2.0**-40, 0.0], [1.0, 2.0**-41, tiny]])
        assert len(folded_faces_on_sphere(np.array([[0, 1, 2]]), points)) == (tiny < 0)
    points = np.array([a, [1.0, 2.0**-40, 0.0], [1.0, 2.0**-41, 0.0]])
    assert len(folded_faces_on_sphere(np.array([[0, 1, 2]]), points)) == 1


def test_the_angle_correction_lowers_the_angle_error():
    mesh, good, bad = distorted("disk")
    boundary = np.arange(len(good) - 120, len(good))
    mended, record = correct(setting(mesh, bad, "disk", boundary), "angle")
    assert record.angle_mean_after_deg < 0.01 * record.angle_mean_before_deg
    assert moebius_distance(mended, good) < 1e-9
    _, auto = correct(setting(mesh, bad, "disk", boundary), "auto")
    assert auto == record
    _, unused = correct(setting(mesh, good, "disk", boundary), "auto")
    assert unused.method == "area"
