"""Moebius corrections only help: what they may cost, how far they go, and what their records say."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import cap, grid, icosphere

from pgcp.finish import correct as module
from pgcp.finish.correct import Correction, Setting, correct
from pgcp.plane.mobius import boost, in_ball, shift_disk
from pgcp.surface.distortion import mean_distortion
from pgcp.targets.registry import TARGETS
from pgcp.types import Mesh


def setting(mesh, positions, target, boundary=()):
    """A correction's setting with all vertices in use."""
    chosen = TARGETS.get(target)
    everything = np.arange(len(mesh.vertices))
    return Setting(mesh, chosen.space, positions, chosen.family(positions), np.array(boundary, int), everything)


def two_squares(noise, scale):
    """A coarse square mapped as it is but for noise, and a small fine one beside it that is smaller than on the surface.

    A Moebius map that enlarges the fine square bends the coarse one, whose large faces have straight edges.
    """
    coarse, fine = grid(4), grid(16)
    one = (coarse.vertices[:, 0] - 0.5) + 1j * (coarse.vertices[:, 1] - 0.5)
    two = 0.8 + 0.15 * ((fine.vertices[:, 0] - 0.5) + 1j * (fine.vertices[:, 1] - 0.5))
    surface = np.concatenate([one, scale * two])
    rng = np.random.default_rng(0)
    one = one + noise * (rng.normal(size=len(one)) + 1j * rng.normal(size=len(one)))
    faces = np.vstack([coarse.faces, len(one) + fine.faces])
    return Mesh(np.column_stack([surface.real, surface.imag, 0 * surface.real]), faces), np.concatenate([one, two])


def test_areas_are_not_evened_out_at_the_cost_of_angles(monkeypatch):
    """The mean angle error may rise by 1 %, whatever is gained in area."""
    mesh, z = two_squares(0.05, 2.0)
    here = setting(mesh, z, "free")
    with monkeypatch.context() as patch:
        patch.setattr(module, "_ANGLE_LIMIT", np.inf)
        _, free = correct(here, "area")
    assert free.log_area_after < 0.1 * free.log_area_before
    assert free.angle_mean_after_deg > 1.3 * free.angle_mean_before_deg
    same, kept = correct(here, "area")
    assert kept.angle_mean_after_deg <= 1.01 * kept.angle_mean_before_deg
    assert (kept.share, kept.parameter) == (0.0, (0.0, 0.0))
    assert np.array_equal(same, z)


def test_part_of_the_way_is_gone_where_the_whole_costs_too_much():
    mesh, z = two_squares(0.15, 1.2)
    here = setting(mesh, z, "free")
    moved, record = correct(here, "area")
    assert 0.0 < record.share < 1.0
    assert record.angle_mean_before_deg < record.angle_mean_after_deg <= 1.01 * record.angle_mean_before_deg
    assert record.log_area_after < record.log_area_before
    assert (record.log_area_after, record.angle_mean_after_deg) == here.distortion(moved)


def test_the_record_says_by_which_map_the_positions_moved():
    mesh, exact = cap(12)
    exact = exact / np.abs(exact).max()
    flat = Mesh(np.column_stack([exact.real, exact.imag, 0 * exact.real]), mesh.faces)
    boundary = np.arange(len(exact) - 72, len(exact))
    z = shift_disk(exact, 0.3 - 0.5j)
    for method in ("area", "angle"):
        moved, record = correct(setting(flat, z, "disk", boundary), method)
        assert moved == pytest.approx(shift_disk(z, complex(*record.parameter)), abs=1e-12)
        assert np.abs(np.abs(moved[boundary]) - 1).max() < 1e-15
        assert record.parameter == pytest.approx((-0.3, 0.5), abs=0.02)
        before, after = (mean_distortion(flat, np.column_stack([p.real, p.imag, 0 * p.real])) for p in (z, moved))
        assert (record.log_area_before, record.angle_mean_before_deg) == pytest.approx(before)
        assert (record.log_area_after, record.angle_mean_after_deg) == pytest.approx(after)


def needles(mesh, z, at):
    """Two faces of hardly any height on a chord, one on either side of it: a circle's arc for the chord folds one of them."""
    a, b = at
    middle, across = 0.5 * (a + b), 1e-6j * (b - a)
    count = len(z)
    z = np.concatenate([z, [a, b, middle + across, b, a, middle - across]])
    faces = np.vstack([mesh.faces, [[count, count + 1, count + 2], [count + 3, count + 4, count + 5]]])
    surface = np.concatenate([mesh.vertices, np.column_stack([z[count:].real, z[count:].imag, np.zeros(6)])])
    return Mesh(surface, faces), z


@pytest.mark.parametrize("method", ["area", "angle"])
def test_a_correction_that_folds_faces_is_not_made(method, monkeypatch):
    """Also where no face of the sample folds."""
    monkeypatch.setattr(module, "_ANGLE_SAMPLE", 300)
    square = grid(40)
    good = (square.vertices[:, 0] - 0.5) + 1j * (square.vertices[:, 1] - 0.5)
    flat, z = square, good / (1 - (0.5 + 0.4j) * good)
    plain, record = correct(setting(flat, z, "free"), method)
    assert record.share == 1.0
    mesh, bent = needles(flat, z, (z[100], z[1500]))
    assert not np.isin([len(mesh.faces) - 1, len(mesh.faces) - 2], module._sampled(len(mesh.faces))).any()
    here = setting(mesh, bent, "free")
    assert here.folds(bent) == 0
    monkeypatch.setattr(module, "_FOLD_FRACTION", 0.0)
    same, kept = correct(here, method)
    assert here.folds(same) == 0
    assert kept.share == 0.0
    monkeypatch.setattr(module, "_FOLD_FRACTION", 0.0005)  # of 3202 faces one, which is left to repair
    moved, allowed = correct(here, method)
    assert here.folds(moved) == 1
    assert allowed.share == 1.0
    assert len(plain) < len(moved)


def test_a_correction_never_raises_what_it_is_to_lower():
    rng = np.random.default_rng(1)
    for target, mesh in (("sphere", icosphere(2)), ("free", grid(6, jitter=0.3)), ("disk", cap(4)[0])):
        for _ in range(3):
            surface = Mesh(mesh.vertices + 0.1 * rng.normal(size=mesh.vertices.shape), mesh.faces)
            if target == "sphere":
                positions, boundary = boost(mesh.vertices, rng.uniform(-0.3, 0.3, 3)), ()
            elif target == "free":
                positions, boundary = mesh.vertices @ [1, 1j, 0], ()
            else:
                positions, boundary = cap(4)[1] / np.abs(cap(4)[1]).max(), np.arange(37, 61)
            here = setting(surface, positions, target, boundary)
            before = here.distortion(positions)
            moved, area = correct(here, "area")
            assert here.distortion(moved)[0] <= before[0]
            assert here.distortion(moved)[1] <= 1.01 * before[1]
            assert (area.share > 0) == (here.distortion(moved)[0] < before[0])
            moved, angle = correct(here, "angle")
            assert here.distortion(moved)[1] <= before[1]
            assert (angle.share > 0) == (here.distortion(moved)[1] < before[1])


def test_boundary_vertices_stay_apart():
    """A shift that brings all but one of the disk's boundary vertices together is not one of its maps."""
    family = TARGETS.get("disk").family(np.zeros(1, complex))
    z = np.exp(2j * np.pi * np.arange(12) / 12)
    near, far = (family.moved(z, np.array([size, 0.0])) for size in (1.0, 18.0))
    assert family.keeps(near, np.arange(12))
    assert np.abs(np.abs(near) - 1).max() < 1e-15
    assert not family.keeps(far, np.arange(12))


def test_a_vector_is_half_a_hyperbolic_distance():
    for size in (0.1, 1.0, 3.0):
        b = in_ball(np.array([0.0, size, 0.0]))
        assert np.log((1 + b[1]) / (1 - b[1])) == pytest.approx(2 * size)
    assert in_ball(np.zeros(2)).tolist() == [0.0, 0.0]


def test_a_correction_taken_back_says_that_nothing_changed():
    record = Correction("area", (0.1, -0.2, 0.3), 0.7, 1.5, 0.9, 2.0, 2.01)
    assert record.undone() == Correction("area", (0.0, 0.0, 0.0), 0.0, 1.5, 1.5, 2.0, 2.0)
