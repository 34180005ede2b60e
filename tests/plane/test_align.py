"""Maps of one sphere or disk brought into line: every piece against what is known exactly."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pgcp.plane import align
from pgcp.plane.harmonics import power_by_degree, projected, rotation_correlations, sphere_grid
from pgcp.plane.mobius import boost, boost_matrix

RNG = np.random.default_rng(0)
POINTS = RNG.normal(size=(60, 3))
POINTS /= np.linalg.norm(POINTS, axis=1)[:, None]
TURN = Rotation.from_euler("xyz", [0.4, 2.1, -1.3])
BOOST = np.array([0.2, -0.5, 0.3])
ROUND = align.rotation_as_moebius(TURN.as_matrix()) @ boost_matrix(BOOST)
DISK = np.sqrt(RNG.uniform(size=60)) * np.exp(2j * np.pi * RNG.uniform(size=60))
DISK[:15] /= np.abs(DISK[:15])
FLAT = align.turn_of_disk(2.0) @ align.shift_of_disk(-0.5 + 0.3j)
_CENTRES = POINTS[:6]


def bumps(points):
    """A smooth function on the sphere without symmetry."""
    return np.exp(2.0 * (points @ _CENTRES.T)) @ [1.0, -0.7, 0.4, 0.9, -0.3, 0.5]


def test_matrices_act_as_rotations_and_boosts():
    assert np.allclose(align.moved_on_sphere(ROUND, POINTS), TURN.apply(boost(POINTS, BOOST)), atol=1e-14)
    poles = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    assert np.allclose(align.moved_on_sphere(ROUND, poles), TURN.apply(boost(poles, BOOST)), atol=1e-14)
    assert np.allclose(align.moved_on_sphere(align.undone(ROUND), align.moved_on_sphere(ROUND, POINTS)), POINTS, atol=1e-14)


def test_scales_are_those_of_small_steps():
    across = np.cross(POINTS, [1.0, 2.0, 3.0])
    near = POINTS + 1e-6 * across / np.linalg.norm(across, axis=1)[:, None]
    near /= np.linalg.norm(near, axis=1)[:, None]
    stretch = np.linalg.norm(align.moved_on_sphere(ROUND, near) - align.moved_on_sphere(ROUND, POINTS), axis=1)
    step = np.linalg.norm(near - POINTS, axis=1)
    assert np.allclose(np.log(stretch / step), align.log_scale_on_sphere(ROUND, POINTS), atol=1e-5)
    z = 0.9 * DISK
    moved = align.moved_in_plane(FLAT, z + 1e-7) - align.moved_in_plane(FLAT, z)
    assert np.allclose(np.log(np.abs(moved) / 1e-7), align.log_scale_in_plane(FLAT, z), atol=1e-5)


def test_centred_means_are_zero_wherever_the_points_were():
    weights = RNG.uniform(0.1, 1.0, 60)
    moved = align.moved_on_sphere(ROUND, POINTS)
    for points in (POINTS, moved):
        there = align.moved_on_sphere(align.centring_of_sphere(points, weights), points)
        assert np.abs(weights @ there).max() < 1e-10
    images = []
    for z in (DISK, align.moved_in_plane(align.shift_of_disk(0.9 - 0.3j), DISK)):
        there = align.moved_in_plane(align.centring_of_disk(z, weights), z)
        assert abs(weights @ there) < 1e-10
        images.append(np.abs(there))
    assert np.allclose(*images, atol=1e-9)  # there is one centre


def test_harmonics_have_the_energy_of_the_function_and_turn_with_it():
    degree = 16
    grid, weights = sphere_grid(degree)
    one = projected(degree, grid, weights * bumps(grid))
    fine, fine_weights = sphere_grid(40)
    assert fine_weights.sum() == pytest.approx(4.0 * np.pi)
    integral = fine_weights @ bumps(fine) ** 2
    assert one @ one == pytest.approx(integral, rel=1e-9)
    angles, tilts, _ = rotation_correlations(one, one)
    last, tilt, first = 5, 4, 29
    turn = Rotation.from_euler("ZYZ", [angles[last], tilts[tilt], angles[first]])
    other = projected(degree, grid, weights * bumps(turn.inv().apply(grid)))
    scores = rotation_correlations(one, other)[2]
    assert np.unravel_index(scores.argmax(), scores.shape) == (tilt, last, first)
    assert scores.max() == pytest.approx(integral, rel=1e-9)


def test_a_turn_of_the_sphere_is_found_among_all():
    grid, weights = sphere_grid(12)
    one, other = (projected(12, grid, weights * values) for values in (bumps(grid), bumps(TURN.inv().apply(grid))))
    starts = align.turns_of_sphere(one, other, 4)
    found, error = align.finer_turn_of_sphere(
        starts[0], POINTS, bumps(POINTS), np.ones(60), lambda points: bumps(TURN.inv().apply(points))
    )
    assert np.allclose(found, TURN.as_matrix(), atol=1e-6)
    assert error < 1e-10


def test_a_measure_is_turned_as_its_points_are():
    weights = RNG.uniform(0.1, 1.0, 60)
    one, other = (projected(10, points, weights) for points in (POINTS, TURN.apply(POINTS)))
    assert np.allclose(power_by_degree(one[:, None]), power_by_degree(other[:, None]))
    assert one[0] == pytest.approx(weights.sum() * np.sqrt(0.25 / np.pi))
    best = align.turns_of_sphere(one, other, 1)[0]
    assert Rotation.from_matrix(best @ TURN.as_matrix().T).magnitude() < 2.0 * np.pi / 22


def test_a_turn_of_the_disk_is_found():
    def field(z):
        return np.exp(2.0 * z.real) + z.imag**3

    rings = align.disk_rings(np.array([0.3, 0.6, 0.9]), 90)
    starts = align.turns_of_disk(field(rings), field(rings * np.exp(-2.2j)), 3)
    assert abs(starts[0] - 2.2) < 0.05
    found, error = align.finer_turn_of_disk(starts[0], DISK, field(DISK), np.ones(60), lambda z: field(z * np.exp(-2.2j)))
    assert found == pytest.approx(2.2, abs=1e-6)
    assert error < 1e-10


def test_landmarks_give_the_map_that_made_them():
    there = align.moved_on_sphere(ROUND, POINTS)
    for count in (3, 60):
        found = align.landmarks_on_sphere(POINTS[:count], there[:count], False)
        assert np.allclose(align.moved_on_sphere(found, POINTS), there, atol=1e-8)
    found = align.landmarks_on_sphere(POINTS[:2], TURN.apply(POINTS[:2]), True)
    assert np.allclose(align.moved_on_sphere(found, POINTS), TURN.apply(POINTS), atol=1e-8)
    flat = align.moved_in_plane(FLAT, DISK)
    for count in (2, 60):
        found = align.landmarks_in_disk(DISK[20 : 20 + count], flat[20 : 20 + count], False)
        assert np.allclose(align.moved_in_plane(found, DISK), flat, atol=1e-7)
    found = align.landmarks_in_disk(DISK[:1], 1j * DISK[:1], True)
    assert np.allclose(align.moved_in_plane(found, DISK), 1j * DISK)


def test_a_rigid_motion_is_found_and_mirrors_are_none():
    weights = RNG.uniform(0.1, 1.0, 60)
    rotation, shift = align.rigid_motion(POINTS, TURN.apply(POINTS) + np.array([1.0, 2.0, 3.0]), weights)
    assert np.allclose(rotation, TURN.as_matrix())
    assert np.allclose(shift, [1, 2, 3])
    rotation, _ = align.rigid_motion(POINTS, POINTS * [-1, 1, 1], weights)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
