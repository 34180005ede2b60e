"""The natural boundary against maps that are known; far panels of its Cauchy integrals are summed in groups, to rounding."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import similarity_error

from pgcp.plane.natural import _angle_rows, _cauchy, _integrate, natural_boundary


def boundary(nodes, panels, seed=0):
    rng = np.random.default_rng(seed)
    turn = np.sort(rng.random(nodes)) * 2.0 * np.pi
    z = np.exp(1j * turn) * (1.0 + 0.4 * np.cos(3.0 * turn))
    starts = np.append(np.sort(rng.choice(np.arange(1, nodes), panels - 1, replace=False)), nodes)
    starts = np.concatenate([[0], starts])
    return z, starts, rng.standard_normal(panels)


def exact(points, z, starts, density):
    """Phi by the log ratio of every single edge, which winds nowhere."""
    closed = np.append(z, z[0])
    edges = np.log((closed[1:, None] - points) / (closed[:-1, None] - points))
    return (np.repeat(density, np.diff(starts))[:, None] * edges).sum(axis=0) / (2j * np.pi)


@pytest.mark.parametrize(("nodes", "panels"), [(40, 5), (600, 200), (3000, 1200)])
def test_groups_of_panels_are_summed_to_rounding(nodes, panels):
    z, starts, density = boundary(nodes, panels)
    points = np.concatenate([0.9 * z[::3], 0.5 * z[::5], 0.05 * z[::7]])
    x, y = np.append(z.real, z.real[0]), np.append(z.imag, z.imag[0])
    steps = np.abs(np.roll(z, -1) - z)
    reach = 1.5 * np.add.reduceat(steps, starts[:-1])
    found = _cauchy(points, np.full(len(points), -1), x, y, starts, reach, density)
    expected = exact(points, z, starts, density)
    assert np.abs(found - expected).max() < 1e-12 * np.abs(density).sum()


def test_a_constant_density_gives_a_constant():
    z, starts, _ = boundary(500, 150)
    x, y = np.append(z.real, z.real[0]), np.append(z.imag, z.imag[0])
    reach = 1.5 * np.add.reduceat(np.abs(np.roll(z, -1) - z), starts[:-1])
    found = _cauchy(0.7 * z, np.full(500, -1), x, y, starts, reach, np.full(150, 2.5))
    assert np.abs(found - 2.5).max() < 1e-12


def test_panels_far_and_near_are_seen_under_the_angles_of_their_edges():
    z, starts, _ = boundary(1500, 500)
    x, y = np.append(z.real, z.real[0]), np.append(z.imag, z.imag[0])
    reach = 1.5 * np.add.reduceat(np.abs(np.roll(z, -1) - z), starts[:-1])
    found = _angle_rows(x, y, starts, reach, 100, 140)
    closed = np.append(z, z[0])
    for row in range(40):
        own = np.arange(starts[100 + row], starts[101 + row])
        middle = 0.5 * (closed[own] + closed[own + 1])
        angles = np.angle((closed[1:, None] - middle) / (closed[:-1, None] - middle))
        angles[own, np.arange(len(own))] = np.pi
        expected = np.add.reduceat(angles, starts[:-1], axis=0).mean(axis=1) / (2.0 * np.pi)
        assert np.abs(found[row] - expected).max() < 1e-14


def sampled_disk(nodes, crowded=0.0):
    """Points of the unit circle, closer together on one side, and others inside it; edges of the loop and of a tree."""
    t = 2.0 * np.pi * np.arange(nodes) / nodes
    z = np.exp(1j * (t + crowded * np.sin(t)))
    points = np.concatenate([z, 0.8 * z, 0.3 * z[::4]])
    loop = np.arange(nodes)
    spokes = np.column_stack([loop, nodes + loop])
    inner = np.column_stack([nodes + loop[::4], 2 * nodes + np.arange(len(loop[::4]))])
    return points, np.vstack([np.column_stack([loop, np.roll(loop, -1)]), spokes, inner]), loop


def image_lengths(function, points, edges):
    return np.abs(function(points[edges[:, 0]]) - function(points[edges[:, 1]]))


@pytest.mark.parametrize("strength", [1.0, 0.5, 0.25])
@pytest.mark.parametrize("crowded", [0.0, 0.7])
def test_part_of_the_way_is_a_power_of_the_derivative(strength, crowded):
    """The whole way from the disk to exp(2 z) has the derivative 2 exp(2 z): a part s of it leads to exp(2 s z)."""
    points, edges, loop = sampled_disk(240, crowded)
    lengths = image_lengths(lambda z: np.exp(2.0 * z), points, edges)
    found = natural_boundary(points, edges, lengths, loop, loop, strength)
    assert similarity_error(found, np.exp(2.0 * strength * points)) < 0.03


def test_the_natural_boundary_converges_with_unevenly_sampled_curves():
    errors = []
    for nodes in (60, 120, 240):
        points, edges, loop = sampled_disk(nodes, 0.6)
        lengths = image_lengths(lambda z: (z + 2.0) ** 3, points, edges)
        found = natural_boundary(points, edges, lengths, loop, loop)
        errors.append(similarity_error(found, (points + 2.0) ** 3))
    assert np.log2(np.array(errors[:-1]) / errors[1:]).min() > 0.9


def test_lengths_as_in_the_plane_change_nothing():
    points, edges, loop = sampled_disk(100, 0.5)
    lengths = 3.0 * np.abs(points[edges[:, 0]] - points[edges[:, 1]])
    assert similarity_error(natural_boundary(points, edges, lengths, loop, loop), points) < 1e-12


def test_panels_that_hold_several_edges_take_their_mean():
    """Panels of one edge and of eight give the same map, to within what the nodes resolve."""
    points, edges, loop = sampled_disk(480)
    lengths = image_lengths(np.exp, points, edges)
    uneven = np.concatenate([[0, 1, 2, 3], np.arange(8, 480, 8)])
    for corners in (loop, loop[::8], uneven):
        found = natural_boundary(points, edges, lengths, loop, corners)
        assert similarity_error(found, np.exp(points)) < 0.0065


def test_no_more_panels_than_can_be_solved_for(monkeypatch):
    points, edges, loop = sampled_disk(480)
    lengths = image_lengths(np.exp, points, edges)
    expected = natural_boundary(points, edges, lengths, loop, loop[::4])
    monkeypatch.setattr("pgcp.plane.natural._MAX_PANELS", 120)
    assert np.array_equal(natural_boundary(points, edges, lengths, loop, loop), expected)


def test_cycles_that_do_not_close_share_out_what_is_missing_by_their_steps():
    """Steps round a square of which one is too long: least squares relative to the steps, and every cycle closed."""
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [3, 4]])
    steps = np.array([3.0, 1j, -3.0, -1.04j, 1e-9 + 0j])
    found = _integrate(5, edges, steps)
    moved = found[edges[:, 1]] - found[edges[:, 0]]
    # min sum |d|^2 / |step|^2 with sum d = 0.04j: shares in proportion to the squares of the steps
    shares = np.abs(steps[:4]) ** 2
    assert moved[:4] == pytest.approx(steps[:4] + 0.04j * shares / shares.sum(), rel=1e-12)
    assert moved[4] == pytest.approx(1e-9, rel=1e-6)
    assert np.isnan(_integrate(2, np.array([[0, 1]]), np.array([0j]))).all()
