"""The least mean angle error over Moebius maps: slopes against differences, the optimum against another optimiser's."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import cap, grid, icosphere
from scipy.optimize import minimize

from pgcp.finish.descent import descend
from pgcp.finish.least_angle import least_angle, sample_angles
from pgcp.finish.least_area import AreaSample
from pgcp.plane.mobius import bend_plane, boost, shift_disk
from pgcp.surface.operators import face_areas
from pgcp.targets.registry import TARGETS
from pgcp.types import Mesh


def case(target):
    """A noisy surface, its map moved away by a Moebius map."""
    rng = np.random.default_rng(3)
    if target == "sphere":
        round_one = icosphere(3)
        surface = Mesh(round_one.vertices + 0.01 * rng.normal(size=round_one.vertices.shape), round_one.faces)
        return surface, boost(round_one.vertices, np.array([0.5, -0.3, 0.2]))
    mesh, z = cap(10) if target == "disk" else (grid(14), None)
    z = (mesh.vertices[:, 0] - 0.5) + 1j * (mesh.vertices[:, 1] - 0.5) if z is None else z / np.abs(z).max()
    noise = 0.002 * rng.normal(size=(len(z), 3))
    surface = Mesh(np.column_stack([z.real, z.imag, 0 * z.real]) + noise, mesh.faces)
    return surface, shift_disk(z, 0.4 - 0.3j) if target == "disk" else bend_plane(z, 0.6 + 0.3j)


def sampled(target):
    """The case with a sample of all its faces."""
    mesh, positions = case(target)
    chosen, ids = TARGETS.get(target), np.arange(len(mesh.faces))
    return mesh, positions, chosen, sample_angles(mesh, chosen.space, chosen.family(positions), positions, ids)


@pytest.mark.parametrize("target", ["free", "disk", "sphere"])
def test_the_slope_is_that_of_the_error(target):
    _, _, _, sample = sampled(target)
    k = sample.family.parameters
    for v in (np.zeros(k), 0.4 * np.ones(k), np.linspace(-0.9, 0.2, k)):
        value, slope = sample.with_slope(v)
        differences = [(sample.error(v + 1e-6 * e) - sample.error(v - 1e-6 * e)) / 2e-6 for e in np.eye(k)]
        assert value == pytest.approx(sample.error(v), rel=1e-12)
        assert slope == pytest.approx(differences, abs=1e-3 * np.abs(differences).max())


@pytest.mark.parametrize("target", ["free", "disk", "sphere"])
def test_the_least_error_is_the_optimum(target):
    """To a millionth of what Nelder and Mead's simplex finds with tight bounds from the same place, and from the known one."""
    mesh, positions, chosen, sample = sampled(target)
    v = least_angle(mesh, chosen.space, positions, np.arange(len(mesh.faces)), sample)
    k, least = len(v), np.inf
    for start in (v, np.zeros(k)):
        here = start
        for size in (0.3, 0.03, 0.003):
            simplex = np.vstack([here, here + size * np.eye(k)])
            options = {"initial_simplex": simplex, "xatol": 1e-9, "fatol": 1e-13, "maxiter": 400}
            found = minimize(sample.error, here, method="Nelder-Mead", options=options)
            here, least = found.x, min(least, found.fun)
    assert sample.error(v) < 0.9 * sample.error(np.zeros(k))
    assert sample.error(v) <= least * (1 + 1e-6)


@pytest.mark.parametrize("target", ["free", "disk", "sphere"])
def test_the_least_area_distortion_is_the_optimum(target):
    mesh, positions = case(target)
    chosen = TARGETS.get(target)
    space, family = chosen.space, chosen.family(positions)
    sample = AreaSample(face_areas(mesh.vertices, mesh.faces), face_areas(space.in_space(positions), mesh.faces))
    found = family.least_area(positions[mesh.faces].mean(axis=1), sample)
    assert 0.1 < np.linalg.norm(found) < 1.0
    centres = positions[mesh.faces].mean(axis=1)
    if target == "sphere":
        centres = centres / np.linalg.norm(centres, axis=1)[:, None]

        def value(b):
            """Smoothed mean |d_area|."""
            growth = -2.0 * np.log(1.0 + 2.0 * centres @ b + b @ b)
            return sample.distortion(growth, np.zeros((len(growth), 3)))[0]
    else:
        where = (centres - family._middle) / family._radius if target == "free" else centres

        def value(b):
            """Smoothed mean |d_area|."""
            alpha = complex(b[0], -b[1]) if target == "disk" else complex(*b)
            growth = -4.0 * np.log(np.abs(1.0 - alpha * where))
            return sample.distortion(growth, np.zeros((len(growth), 2)))[0]

    options = {"xatol": 1e-10, "fatol": 1e-14, "maxiter": 2000}
    least = minimize(value, 0.9 * found, method="Nelder-Mead", options=options).fun
    assert value(found) <= least * (1 + 1e-6)


def test_a_descent_ends_in_a_curved_valley():
    def valley(x):
        """Rosenbrock's function, and its gradient."""
        a, b = x
        return (1 - a) ** 2 + 100 * (b - a * a) ** 2, np.array([-2 * (1 - a) - 400 * a * (b - a * a), 200 * (b - a * a)])

    value, x = descend(valley, np.array([-1.2, 1.0]), 0.5, 300, 1e-12)
    assert x == pytest.approx([1.0, 1.0], abs=1e-5)
    assert value < 1e-10


def test_a_descent_stays_where_nothing_is_gained():
    start = np.array([0.2, 0.3])
    value, x = descend(lambda x: (1.0, np.zeros(2)), start, 0.5, 10, 1e-9)
    assert value == 1.0
    assert np.array_equal(x, start)
