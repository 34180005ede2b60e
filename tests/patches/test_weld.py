from __future__ import annotations

from dataclasses import replace

import networkx
import numpy as np
import pytest
from meshes import grid, lifted, similarity_error
from pieces import polygon_component

from pgcp.errors import WeldFailedError
from pgcp.patches import plan as plan_module
from pgcp.patches import weld
from pgcp.patches.plan import plan_welds, weld_tree
from pgcp.patches.split import split_mesh
from pgcp.patches.types import BoundaryCurve, EdgeTable
from pgcp.patches.weld import Component, normalise, relax_boundary, shared_arc, start_component, subdivide, weld_pair
from pgcp.plane.curves import crosses_itself
from pgcp.plane.natural import natural_boundary
from pgcp.plane.zipper import close_arcs, open_arc
from pgcp.surface.topology import examine


def half_squares(n: int, bend_left, bend_right, refinement: int = 1):
    """Two halves of the square [-1, 1]^2 cut along x = 0, n edges a unit, each bent by a conformal map."""
    t = np.linspace(0, 1, n, endpoint=False)
    seam = -1j + 2j * np.arange(2 * n + 1) / (2 * n)
    top_left, west, bottom_left = 1j - t, -1 + 1j - 2j * np.linspace(0, 1, 2 * n, endpoint=False), -1 - 1j + t
    left = np.concatenate([seam[:-1], top_left, west, bottom_left])
    right_bottom, east, right_top = -1j + t, 1 - 1j + 2j * np.linspace(0, 1, 2 * n, endpoint=False), 1 + 1j - t
    right = np.concatenate([right_bottom, east, right_top, seam[:0:-1]])
    points = np.unique(np.round(np.concatenate([left, right]), 12))
    ids = {complex(p): i for i, p in enumerate(points)}
    number = lambda loop: np.array([ids[complex(p)] for p in np.round(loop, 12)])  # noqa: E731
    vertices = np.column_stack([points.real, points.imag, np.zeros(len(points))])
    left_ids, right_ids = number(left), number(right)
    pairs = [np.sort(np.column_stack([i, np.roll(i, -1)]), axis=1) for i in (left_ids, right_ids)]
    keys = np.unique(np.concatenate([p[:, 0] * len(points) + p[:, 1] for p in pairs]))
    table = EdgeTable(keys, np.full(len(keys), refinement), len(points))
    parts = []
    for index, (loop, loop_ids, bend) in enumerate(((left, left_ids, bend_left), (right, right_ids, bend_right))):
        fine = bend(subdivide(loop, np.full(len(loop), refinement)))
        parts.append(start_component(BoundaryCurve(index, loop_ids, fine), vertices, table))
    return parts[0], parts[1], points


def square_error(union: Component, points) -> float:
    known = union.nodes < len(points)
    return similarity_error(union.z[known], points[union.nodes[known]])


BENDS = [
    (lambda z: (z + 3) ** 2, lambda z: np.exp(0.7 * z)),
    (lambda z: 1 / (z + 2.5 - 0.4j), lambda z: z + 0.12 * z**2),
    (lambda z: np.exp((0.5 + 0.3j) * z), lambda z: 1j * (z - 4) ** 2),
]


@pytest.mark.parametrize("bends", BENDS)
def test_bent_halves_weld_back_to_the_square_at_first_order(bends):
    errors = [square_error(weld_pair(*half_squares(n, *bends)[:2]), half_squares(n, *bends)[2]) for n in (10, 20, 40, 80)]
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] < 4e-3
    assert np.mean(rates) > 0.9


def test_subdivided_edges_make_a_weld_more_accurate():
    errors = []
    for refinement in (1, 4):
        left, right, points = half_squares(12, *BENDS[0], refinement=refinement)
        errors.append(square_error(weld_pair(left, right), points))
    assert errors[1] < 0.5 * errors[0]


def test_the_two_sides_meet_point_by_point_and_nothing_is_lost():
    left, right, points = half_squares(12, *BENDS[1])
    union = weld_pair(left, right)
    assert sorted(union.nodes.tolist()) == list(range(len(points)))
    assert not crosses_itself(union.z[union.loop])
    loop = union.z[union.loop]
    assert np.imag(np.vdot(loop, np.roll(loop, -1))) > 0
    assert len(union.loop) == len(left.loop) + len(right.loop) - 2 * 24
    pairs = np.sort(union.nodes[union.edges], axis=1)
    assert len(np.unique(pairs, axis=0)) == len(pairs)


def test_pieces_of_a_plane_are_moved_rigidly():
    left, right, points = half_squares(9, lambda z: 2 * z + 1, lambda z: (0.3 - 0.9j) * z)
    assert square_error(weld_pair(left, right), points) < 1e-11


def test_the_union_does_not_depend_on_how_the_sides_lie():
    left, right, _ = half_squares(16, *BENDS[0])
    moved = replace(right, z=(0.2 + 3j) * right.z - 7)
    one, two = weld_pair(left, right), weld_pair(left, moved)
    assert similarity_error(one.z, two.z) < 1e-9


# hazards of the zipper, one by one


def test_opening_brings_the_arc_to_one_half_axis_in_order():
    """Hazard: points beyond a pole pass to the other half-axis until the last Moebius map."""
    left, _, _ = half_squares(20, lambda z: np.exp(1.2j * z), lambda z: z)
    k = 40
    for branch in (1.0, -1.0):
        gaps, others, stuck = open_arc(left.z[: k + 1], left.z[k + 1 :], branch)
        assert stuck == -1
        assert len(gaps) == k - 1
        assert (gaps > 0).all()
        assert (others.real > 0).all()


def test_collinear_arcs_open_without_dividing_by_zero():
    arc = np.linspace(0, 1, 9).astype(complex)
    gaps, others, stuck = open_arc(arc, np.array([0.5 + 0.5j, -1 + 1j]), 1.0)
    assert stuck == -1
    assert np.isfinite(others).all()
    # the exact map is sqrt((z - 1) / z): the point x has the inverse height sqrt(x / (1 - x)), up to one scale
    p = np.concatenate([[0.0], np.cumsum(gaps)])
    exact = np.sqrt(arc[:-1].real / (1 - arc[:-1].real))
    assert np.allclose(p / p[4], exact / exact[4], rtol=1e-12)


def cross_ratio(z):
    return (z[0] - z[2]) * (z[1] - z[3]) / ((z[0] - z[3]) * (z[1] - z[2]))


def wavy_arc():
    return np.cumsum(np.concatenate([[0], 1 + 0.3j * np.random.default_rng(2).normal(size=12)]))


def hairpin_arc(width: float):
    """Out along the real axis, a turn by nearly 180 degrees, and back beside itself."""
    out = np.linspace(0, 6, 13)
    back = np.linspace(5.75, 3.0, 12)
    away = 3.0 + 1j * np.linspace(0.25, 3, 12)
    return np.concatenate([out, back + 1j * width * (6 - back), away])


@pytest.mark.parametrize("arc", [wavy_arc(), hairpin_arc(0.05), hairpin_arc(0.02)], ids=["wavy", "hairpin", "tight hairpin"])
def test_opening_then_closing_onto_its_mirror_image_is_a_moebius_map(arc):
    """Hazard: neighbours agree in all their digits where a curve turns back on itself."""
    others = np.array([3 - 4j, 7 + 5j, -1 - 9j, 10 + 2j])
    up, a, stuck_up = open_arc(arc, others, 1.0)
    down, b, stuck_down = open_arc(arc, others, -1.0)
    assert stuck_up == stuck_down == -1
    assert (up > 0).all()
    assert (down > 0).all()
    assert np.allclose(a, b)
    welded, moved, stuck = close_arcs(up, down, a)
    assert stuck == -1
    assert cross_ratio(moved) == pytest.approx(cross_ratio(others), rel=1e-6)
    for j in (1, 5, len(arc) - 3):
        seen = cross_ratio(np.append(welded[j - 1 : j + 2], moved[0]))
        assert seen == pytest.approx(cross_ratio(np.append(arc[j : j + 3], others[0])), rel=1e-5)


def test_two_sides_that_would_overlap_are_kept_apart():
    """Hazard: nothing in Algorithm 2 keeps the two intermediate forms disjoint."""
    a = np.array([0.05 + 1.2j, 0.9 + 0.1j, 0.7 - 0.6j, 0.4 - 1.0j])  # from the positive half-axis across the middle
    gaps = np.array([0.5, 0.5, 1.0])
    z_a, gaps_a, z_b, _, wide_a, wide_b = weld._separate(a, gaps, a.conj(), gaps)
    assert weld._sector(a, 1.0) + weld._sector(a.conj(), -1.0) > np.pi
    assert wide_a + wide_b <= weld.SECTOR_LIMIT + 1e-12
    reach_a = np.arctan2(z_a.real, z_a.imag).max()
    reach_b = np.arctan2(z_b.real, -z_b.imag).max()
    assert reach_a + reach_b < np.pi
    assert reach_a == pytest.approx(wide_a)
    # the half-axis goes through the same power map
    power = wide_a / weld._sector(a, 1.0)
    heights = np.cumsum(gaps) ** power
    assert np.cumsum(gaps_a) / np.cumsum(gaps_a)[-1] == pytest.approx(heights / heights[-1], rel=1e-12)


def wedges(angle, n=12):
    """Two flat sectors of the unit disk with a radius in common, one on either side of it."""
    m = int(angle * n)
    ray = np.arange(n + 1) / n
    left = np.concatenate([ray, np.exp(1j * angle * np.arange(1, m + 1) / m), np.exp(1j * angle) * ray[-2:0:-1]])
    ids = np.arange(len(left))
    right_ids = np.where(ids <= n, ids, len(left) + ids)[::-1]
    count = 2 * len(left)
    return polygon_component(left, vertex_count=count), polygon_component(
        left.conj()[::-1], nodes=right_ids, vertex_count=count
    )


def log_scale(union):
    """log(|edge in the plane| / |edge on the surface|) of all edges (M,)."""
    return np.log(np.abs(union.z[union.edges[:, 0]] - union.z[union.edges[:, 1]]) / union.lengths)


@pytest.mark.parametrize("angle", [0.9 * np.pi, 1.2 * np.pi, 1.5 * np.pi])
def test_flat_pieces_stay_flat_only_where_they_do_not_overlap(angle):
    """Two sectors of more than a half-turn each have no room side by side: their union is bent, but simple."""
    union = weld_pair(*wedges(angle))
    assert not crosses_itself(union.z[union.loop])
    if angle < np.pi:
        assert np.ptp(log_scale(union)) < 1e-12
    else:
        assert np.ptp(log_scale(union)) > 0.1


def test_a_gap_of_a_quarter_is_left_between_sides_that_would_overlap():
    """The two forms fill less than three quarters of the half-plane.

    Sides that nearly touch make a slit where the seam ends, from which the natural boundary cannot get away: the scale of
    two sectors of three right angles each then varies by half as much again.
    """
    assert log_scale(weld_pair(*wedges(1.5 * np.pi))).std() < 0.55
    a = np.exp(1j * np.linspace(-1.5, 1.5, 9)) * 0.8
    gaps = np.full(4, 0.3)
    *_, wide_a, wide_b = weld._separate(a, gaps, a.conj(), gaps)
    assert wide_a + wide_b < 0.75 * np.pi


def test_sides_that_leave_room_are_not_bent():
    """The halves of a smooth curve open to quadrants: what joins without a corner needs no power map."""
    a = np.array([0.4 + 1.0j, 0.9 + 0.3j])  # within 72 degrees of the half-axis, the others within 45
    b = np.array([0.5 - 1.1j, 0.1 - 0.1j])
    gaps = np.array([0.5, 1.0])
    z_a, gaps_a, z_b, gaps_b, wide_a, wide_b = weld._separate(a, gaps, b, gaps)
    assert wide_a + wide_b == pytest.approx(weld._sector(a, 1.0) + weld._sector(b, -1.0))
    assert wide_a + wide_b > 0.6 * np.pi
    assert np.ptp(np.angle(z_a / a)) < 1e-15
    assert np.ptp(np.angle(z_b / b)) < 1e-15
    assert gaps_a == pytest.approx(gaps_b, rel=1e-15)


def test_the_gap_holds_only_points_outside_both_sides():
    fan = weld._gap_fan(np.array([1 + 2j, 0.3 + 1j]), np.array([1 - 2j]), 0.9, 0.7)
    angle = np.angle(fan)
    assert angle.max() < np.pi / 2 - 0.9
    assert angle.min() > -np.pi / 2 + 0.7


def test_infinity_goes_where_the_scale_varies_least():
    """A polygon seen through 1 / (z - c): of many poles the one that undoes it is found, and inside ones never helped."""
    n = 80
    z = np.exp(2j * np.pi * np.arange(n) / n)
    edges = np.column_stack([np.arange(n), np.roll(np.arange(n), -1)])
    lengths = np.abs(z - np.roll(z, -1))
    pole = 1.3 + 0.4j
    seen = 1 / (z - pole)
    there = 1 / (np.array([np.inf]) - pole)  # where infinity went: 0
    back = normalise(seen, edges, lengths, np.array([0.5 - 2j, 0.0, 1 + 1j, there[0].real]))
    assert similarity_error(back, z) < 1e-12


def test_a_point_at_infinity_is_brought_back():
    z = np.array([np.inf, 0, 1, 1 + 1j, 2j])
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [4, 0]])
    out = normalise(z, edges, np.ones(5), np.array([-3 - 3j]))
    assert np.isfinite(out).all()


# the natural boundary


def polygon(n: int):
    t = np.arange(n) / n
    corners = np.array([0, 2, 2 + 1j, 1 + 1j, 1 + 2j, 2j])
    side = np.minimum((t * 6).astype(int), 5)
    return corners[side] + (t * 6 - side) * (np.roll(corners, -1) - corners)[side]


@pytest.mark.parametrize("bend", [lambda z: np.exp(0.6 * z), lambda z: (z + 2) ** 2, lambda z: 1 / (z + 1 + 1j)])
def test_a_bent_polygon_gets_its_own_lengths_back_at_first_order(bend):
    errors = []
    for n in (60, 120, 240):
        z = polygon(n)
        edges = np.column_stack([np.arange(n), np.roll(np.arange(n), -1)])
        back = natural_boundary(bend(z), edges, np.abs(np.roll(z, -1) - z), np.arange(n), np.arange(n))
        errors.append(similarity_error(back, z))
    assert errors[-1] < 0.02
    assert np.log2(np.array(errors[:-1]) / errors[1:]).mean() > 0.9


def test_inner_points_follow_and_small_parts_keep_their_precision():
    """A seam that runs into a region a million times smaller comes out with its steps' relative precision."""
    n = 120
    loop = np.exp(2j * np.pi * np.arange(n) / n)
    inner = 0.5 * 10.0 ** -np.linspace(0, 6, 40)
    z = np.concatenate([loop, inner])
    edges = np.vstack(
        [
            np.column_stack([np.arange(n), np.roll(np.arange(n), -1)]),
            np.column_stack([np.r_[0, np.arange(n, n + 39)], np.arange(n, n + 40)]),
        ]
    )
    lengths = np.abs(z[edges[:, 0]] - z[edges[:, 1]])
    out = natural_boundary(z, edges, lengths, np.arange(n), np.arange(n))
    steps = (out[edges[:, 1]] - out[edges[:, 0]]) / (z[edges[:, 1]] - z[edges[:, 0]])
    assert np.abs(steps / steps[0] - 1).max() < 1e-9


def exponential_disk(power):
    """A circle with the lengths of its image under exp(power z), which overlaps itself from a power of pi on."""
    z = np.exp(2j * np.pi * np.arange(300) / 300)
    return polygon_component(z, np.abs(np.roll(np.exp(power * z), -1) - np.exp(power * z))), z


def test_a_natural_boundary_that_would_overlap_itself_is_gone_part_of_the_way():
    """exp(4 z) overlaps itself, exp(2 z) does not: half the way is gone, and no more."""
    union, z = exponential_disk(4.0)
    assert crosses_itself(np.exp(4.0 * z))
    relaxed = relax_boundary(union)
    assert not crosses_itself(relaxed.z[relaxed.loop])
    assert similarity_error(relaxed.z, np.exp(2.0 * z)) < 0.01


def test_less_than_half_the_way_is_tried_where_half_overlaps():
    """From exp(7 z / 4) half of what is left leads to exp(4.4 z), which overlaps itself again."""
    union, z = exponential_disk(7.0)
    relaxed = relax_boundary(union)
    assert not crosses_itself(relaxed.z[relaxed.loop])
    assert similarity_error(relaxed.z, np.exp(1.75 * z)) < 0.01


def test_a_natural_boundary_that_is_simple_is_gone_to_at_once():
    union, z = exponential_disk(2.5)
    assert similarity_error(relax_boundary(union).z, np.exp(2.5 * z)) < 0.01


def test_crossing_polygons_are_found():
    assert not crosses_itself(polygon(60))
    assert crosses_itself(np.array([0, 1 + 1j, 1, 1j]))
    spiral = np.exp(1j * np.linspace(0, 9, 90)) * np.linspace(1, 2, 90)
    assert crosses_itself(np.concatenate([spiral, [0.5]]))


# refusals


def test_loops_that_share_no_single_arc_are_refused():
    with pytest.raises(WeldFailedError, match="share 0 points"):
        shared_arc(np.arange(4), np.arange(10, 14))
    with pytest.raises(WeldFailedError, match="2 arcs"):
        shared_arc(np.array([0, 1, 2, 3, 4, 5]), np.array([1, 0, 9, 4, 3, 8]))
    order, other = shared_arc(np.array([5, 0, 1, 2, 7]), np.array([2, 1, 0, 9]))
    assert np.array([5, 0, 1, 2, 7])[order].tolist() == [0, 1, 2, 7, 5]
    assert np.array([2, 1, 0, 9])[other].tolist() == [0, 1, 2, 9]


def test_a_curve_whose_points_coincide_cannot_be_opened():
    left, right, _ = half_squares(8, lambda z: z, lambda z: np.exp(0.5 * z))
    z = left.z.copy()
    z[6] = z[5]
    with pytest.raises(WeldFailedError, match="near point 6 of its seam"):
        weld_pair(replace(left, z=z), right)


def test_an_open_surface_is_welded_in_few_levels(monkeypatch):
    mesh = lifted(grid(60, jitter=0.2))
    table = split_mesh(mesh, examine(mesh.faces, len(mesh.vertices)), 24).table

    def levels():
        plan = plan_welds(table, 24)
        tree = weld_tree(plan)
        assert networkx.is_arborescence(tree.reverse())  # every component goes into one union, the last one into none
        assert [part for part, inside in tree.in_degree() if inside == 0] == list(range(24))
        assert networkx.dag_longest_path_length(tree, weight=None) == len(plan.levels)
        return len(plan.levels)

    few = levels()
    monkeypatch.setattr(plan_module, "_DEPTH", {False: 0.0})
    assert few < levels()
    assert few <= 8
