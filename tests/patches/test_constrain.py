"""Where welded points go: balances by length, and room for points that crowd."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from meshes import similarity_error
from pieces import cyclic_edges, polygon_component

from pgcp.errors import CrowdedError, WeldFailedError
from pgcp.patches.constrain import constrain_to_disk, constrain_to_sphere, keep_free
from pgcp.patches.types import Component
from pgcp.plane.geodesic import balanced_centre, geodesic_map
from pgcp.plane.mobius import boost, to_plane, to_sphere


def uneven_circle(nodes=240, crowded=0.8):
    """Points of the unit circle, nine times as close together at -1 as at 1."""
    t = 2.0 * np.pi * np.arange(nodes) / nodes
    return np.exp(1j * (t + crowded * np.sin(t)))


def share_of(lengths):
    """Weight of each point: half of the edges on either side."""
    return 0.5 * (lengths + np.roll(lengths, 1)) / lengths.sum()


def lollipop(arm, width=0.2, step=0.1):
    """A disk with an arm of so many times its width, counter-clockwise from the end of the arm on."""
    turn = np.arcsin(width / 2)
    out = np.arange(arm * width, 0, -step * width) if arm else np.empty(0)
    side = np.cos(turn) + out
    across = 1j * width * (np.arange(-4, 5) / 10)
    bow = np.exp(1j * np.linspace(turn, 2 * np.pi - turn, 80))
    return np.concatenate([np.cos(turn) + arm * width + across, side + 0.5j * width, bow, side[::-1] - 0.5j * width])


def test_the_middle_of_the_disk_is_its_boundarys_mean_by_length_not_by_points():
    z = uneven_circle()
    assert abs(z.mean()) > 0.3
    found = constrain_to_disk(polygon_component(z, inside=[0.0, 0.4 + 0.2j]))
    assert abs(found.points[-2]) < 0.01
    assert abs(found.points[-1]) == pytest.approx(abs(0.4 + 0.2j), abs=0.01)
    assert similarity_error(found.points[:-2], z) < 0.01


@pytest.mark.parametrize("seed", range(3))
def test_the_boundarys_mean_by_length_on_the_surface_is_at_0(seed):
    rng = np.random.default_rng(seed)
    z = uneven_circle(60) * (1 + 0.3 * np.cos(3 * np.arange(60) * np.pi / 30)) + 2
    lengths = 10.0 ** rng.uniform(-2, 0, 60)
    found = constrain_to_disk(polygon_component(z, lengths))
    assert np.abs(np.abs(found.points) - 1).max() < 1e-14
    assert abs(share_of(lengths) @ found.points) < 1e-11
    assert abs(found.points.mean()) > 0.01
    assert found.points[0] == pytest.approx(1.0, abs=1e-14)
    assert (np.diff(np.unwrap(np.angle(found.points))) > 0).all()
    assert found.spread_count == 0
    assert found.smallest_gap == pytest.approx(np.diff(np.append(np.unwrap(np.angle(found.points)), 2 * np.pi)).min())


def test_only_vertices_of_the_mesh_come_out():
    """Every other point of the loop subdivides an edge, and the loop starts with one of them."""
    z = np.roll(uneven_circle(), 1)
    nodes = np.where(np.arange(240) % 2 == 1, np.arange(240), 1000 + np.arange(240))
    union = polygon_component(z, nodes=nodes, vertex_count=1000)
    found = constrain_to_disk(union)
    assert found.vertex_ids.tolist() == list(range(1, 240, 2))
    assert similarity_error(found.points, z[1::2]) < 0.02
    assert found.points[0] == pytest.approx(1.0, abs=1e-14)
    assert keep_free(union).vertex_ids.tolist() == list(range(1, 240, 2))
    assert np.array_equal(keep_free(union).points, z[1::2])


def test_the_disk_is_centred_where_points_have_room_if_the_mean_leaves_none():
    """An arm nine times as long as wide: from the middle of the disk its end spans too little."""
    z = lollipop(9)
    union = polygon_component(z)
    plane = geodesic_map(z, np.empty(0, complex))
    from_the_mean = plane.circle_gaps(balanced_centre(plane, share_of(union.lengths))).min()
    assert 1e-18 < from_the_mean < 1e-12
    found = constrain_to_disk(union)
    assert found.smallest_gap > 1e3 * from_the_mean
    assert found.smallest_gap > 1e-12
    assert found.spread_count == 0
    assert np.abs(np.roll(found.points, -1) - found.points).min() == pytest.approx(found.smallest_gap, rel=1e-3)


def test_the_disk_stays_centred_at_the_mean_while_there_is_room():
    union = polygon_component(lollipop(5))
    found = constrain_to_disk(union)
    assert found.smallest_gap < 1e-8
    assert abs(share_of(union.lengths) @ found.points) < 1e-6  # from where there is most room it is 0.5


def rectangle(length, step=0.1):
    """A rectangle of height 1: seen from its middle, points at either end are exp(-pi length / 2) apart."""
    x, y = np.arange(0, length, step), np.arange(0, 1, step)
    return np.concatenate([x, length + 1j * y, length - x + 1j, 1j - 1j * y])


def test_points_closer_than_numbers_are_spread_out_and_counted():
    z = rectangle(20)
    found = constrain_to_disk(polygon_component(z))
    assert 1e-15 < found.smallest_gap < 2e-14
    assert found.spread_count > 0
    assert len(np.unique(found.points)) == len(z)
    # 2e-14 apart, but for half a spacing in the sum of all gaps up to a point, two roundings when sums are scaled to one turn,
    # for either point, and one of each coordinate: together less than four spacings of 2 pi
    apart = np.abs(np.roll(found.points, -1) - found.points)
    assert apart.min() > 2e-14 - 4 * np.spacing(2 * np.pi)
    wide = constrain_to_disk(polygon_component(rectangle(18)))
    assert wide.smallest_gap > 2e-14
    assert wide.spread_count == 0


def test_parts_that_the_circle_has_no_room_for_are_refused():
    with pytest.raises(CrowdedError, match="long and thin"):
        constrain_to_disk(polygon_component(rectangle(40)))


def test_a_boundary_that_crosses_itself_is_no_crowding():
    t = 2 * np.pi * np.arange(40) / 40
    with pytest.raises(WeldFailedError, match="crosses itself near its point"):
        constrain_to_disk(polygon_component(np.cos(t) + 1j * np.sin(2 * t)))


def closed_union(z, lengths, inserted=0):
    """A closed component: z in a cycle, the last ``inserted`` points no vertices of the mesh."""
    nodes = np.arange(len(z))
    return Component(nodes, z, nodes[:0], cyclic_edges(len(z)), lengths, len(z) - inserted)


def even_points(count=40):
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)
    radius = np.sqrt(1.0 - height**2)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])


def test_the_mean_of_the_sphere_is_by_seam_length():
    lengths = 10.0 ** np.random.default_rng(0).uniform(-1, 1, 40)
    z = to_plane(boost(even_points(), np.array([0.3, 0.5, -0.2])))
    found = constrain_to_sphere(closed_union(z, lengths))
    assert np.abs(np.linalg.norm(found.points, axis=1) - 1).max() < 1e-14
    assert np.linalg.norm(share_of(lengths) @ found.points) < 1e-11
    assert np.linalg.norm(found.points.mean(axis=0)) > 0.01
    ends = found.points - np.roll(found.points, -1, axis=0)
    assert found.smallest_gap == pytest.approx(np.linalg.norm(ends, axis=1).min())


def test_a_point_at_infinity_is_one_of_the_sphere():
    points = np.vstack([[0.0, 0.0, -1.0], even_points(12)])
    z = np.concatenate([[np.inf], to_plane(points[1:])])
    lengths = np.ones(13)
    found = constrain_to_sphere(closed_union(z, lengths, inserted=3))
    assert found.vertex_ids.tolist() == list(range(10))
    again = constrain_to_sphere(closed_union(to_plane(boost(to_sphere(z), np.array([0.1, 0.4, 0.0]))), lengths, inserted=3))
    assert found.points @ found.points.T == pytest.approx(again.points @ again.points.T, abs=1e-9)  # but for a rotation


def test_a_closed_union_of_two_places_is_refused():
    union = closed_union(np.array([0.0, 1.0, 0.0, 1.0], complex), np.ones(4))
    for z in (union.z, np.array([0.0, 1.0, np.nan, 2.0], complex)):
        with pytest.raises(WeldFailedError, match="cannot be brought to the sphere"):
            constrain_to_sphere(replace(union, z=z))
