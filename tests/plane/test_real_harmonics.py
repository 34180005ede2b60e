"""Real spherical harmonics, fits by them, and their transforms on a grid."""

from __future__ import annotations

import numpy as np
import pytest

from pgcp.plane.harmonics import degree_and_order, fitted, power_by_degree, real_harmonics


def directions(count, seed=0):
    points = np.random.default_rng(seed).standard_normal((count, 3))
    return points / np.linalg.norm(points, axis=1)[:, None]


def test_harmonics_of_low_degree_are_the_polynomials_that_they_are():
    points = directions(50)
    x, y, z = points.T
    found = real_harmonics(2, points)
    half = np.sqrt(3 / (4 * np.pi))
    assert found[:, 0] == pytest.approx(np.sqrt(1 / (4 * np.pi)))
    assert found[:, 1:4] == pytest.approx(half * np.column_stack([y, z, x]))
    assert found[:, 4] == pytest.approx(np.sqrt(15 / (4 * np.pi)) * x * y)
    assert found[:, 6] == pytest.approx(np.sqrt(5 / (16 * np.pi)) * (3 * z**2 - 1))


def test_harmonics_add_up_to_the_same_at_every_point():
    points = np.vstack([directions(20), [[0, 0, 1], [0, 0, -1], [1, 0, 0]]])
    degrees, orders = degree_and_order(40)
    assert np.abs(orders).max() == 40
    squares = np.stack([np.bincount(degrees, row) for row in real_harmonics(40, points) ** 2])
    assert squares == pytest.approx(np.broadcast_to((2 * np.arange(41) + 1) / (4 * np.pi), squares.shape))


def test_one_factorization_gives_the_fits_of_all_degrees():
    points, random = directions(400), np.random.default_rng(1)
    areas, values = random.uniform(0.5, 2.0, 400), random.standard_normal((400, 2))
    fit = fitted(6, points, areas, values)
    for degree in (0, 3, 6):
        basis, root = real_harmonics(degree, points), np.sqrt(areas / areas.sum())[:, None]
        wanted = np.linalg.lstsq(root * basis, root * values, rcond=None)[0]
        assert fit.coefficients(degree) == pytest.approx(wanted)
        rest = (areas / areas.sum()) @ (values - basis @ wanted) ** 2
        assert fit.rest[degree] == pytest.approx(rest)


def test_power_stays_when_the_sphere_is_turned():
    turn = np.linalg.qr(np.random.default_rng(2).standard_normal((3, 3)))[0]
    points, areas = directions(600), np.ones(600)
    values = real_harmonics(5, points) @ np.random.default_rng(3).standard_normal((36, 1))
    one, other = (fitted(5, places, areas, values).coefficients(5) for places in (points, points @ turn))
    assert np.abs(one - other).max() > 0.1
    assert power_by_degree(other) == pytest.approx(power_by_degree(one))


def test_a_grid_gives_coefficients_back_and_integrates_cubes():
    pytest.importorskip("ducc0")
    from pgcp.plane.sphere_grid import SphereGrid

    grid = SphereGrid(12)
    vector = np.random.default_rng(4).standard_normal(169)
    values = grid.synthesis(vector)
    assert grid.weights.sum() == pytest.approx(4 * np.pi)
    assert grid.analysis(values) == pytest.approx(vector)
    assert grid.weights @ values**2 == pytest.approx(vector @ vector)
    assert grid.at(vector, grid.points) == pytest.approx(values)
    assert real_harmonics(12, grid.points) @ vector == pytest.approx(values)
    complex_ones = vector * (1 - 2j)
    assert grid.analysis(grid.synthesis(complex_ones)) == pytest.approx(complex_ones)
    assert sorted(set(grid.degrees)) == list(range(13))


def test_without_its_package_the_grid_says_what_to_install(monkeypatch):
    import sys

    from pgcp.errors import InputError
    from pgcp.plane.sphere_grid import SphereGrid

    monkeypatch.setitem(sys.modules, "ducc0", None)
    with pytest.raises(InputError, match=r"pip install 'pgcp\[harmonics\]'"):
        SphereGrid(3)
