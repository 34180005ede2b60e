"""The Cauchy integrals of the natural boundary: panels far away are summed in groups, to rounding."""

from __future__ import annotations

import numpy as np
import pytest

from pgcp.natural import _angle_rows, _cauchy


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
