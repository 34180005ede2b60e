"""Cuts: what they open, what they cost, where they show, and what they lead to."""

from __future__ import annotations

import numpy as np
import pytest

from pgcp.surface.cutting import EdgeGraph, open_surface, spread_vertices, with_tips
from pgcp.surface.hidden import edge_costs, visibility
from pgcp.surface.squeeze import Foretold, curvature, scale_ratio, scale_ratio_of, tips_of
from pgcp.surface.topology import examine
from pgcp.types import Mesh
from tests.meshes import cap, double_torus, grid, holed, icosphere, limbed, torus


def graph_of(mesh):
    topology = examine(mesh.faces, len(mesh.vertices))
    return EdgeGraph.of(mesh.faces, topology.twins, len(mesh.vertices)), topology


def lengths(mesh, graph):
    return np.linalg.norm(mesh.vertices[graph.ends[:, 0]] - mesh.vertices[graph.ends[:, 1]], axis=1)


def faces_joined(graph, cut):
    """Components of faces across edges that are not cut, and how many loops their crossings close."""
    import networkx as nx

    inner = ~cut & ~graph.is_boundary
    faces = nx.MultiGraph((graph.halves[inner] // 3).tolist())
    return nx.number_connected_components(faces), faces.number_of_edges() - faces.number_of_nodes() + 1


def test_edges_are_numbered_once_and_found_by_their_ends():
    mesh = grid(5)
    graph, topology = graph_of(mesh)
    assert len(graph.ends) == topology.edge_count
    assert graph.is_boundary.sum() == len(topology.loops[0])
    assert np.array_equal(graph.numbers(graph.ends[::-1, ::-1]), np.arange(len(graph.ends))[::-1])
    assert np.array_equal(graph.numbers(np.array([[0, 35], [0, 0], [-1, 3], [3, 99]])), [-1] * 4)
    assert graph.characteristic == 1


@pytest.mark.parametrize(("mesh", "loops"), [(torus(), 2), (double_torus(), 4), (holed(), 2)])
def test_a_cut_through_handles_and_boundaries_leaves_one_sheet_in_which_every_loop_goes_round_a_vertex(mesh, loops):
    graph, topology = graph_of(mesh)
    ends = np.array([loop[0] for loop in topology.loops], np.int64)
    cut = open_surface(graph, lengths(mesh, graph), np.array([0, 5]), ends)
    sheets, around = faces_joined(graph, cut)
    on_cut = graph.degrees(cut) > 0
    assert sheets == 1
    used = np.isin(np.arange(len(on_cut)), mesh.faces)
    assert around == (used & ~on_cut).sum()  # one loop round each vertex off the cut: no other
    inner = cut & ~graph.is_boundary
    degree = graph.degrees(cut)
    assert (degree[graph.ends[inner]] >= 2).all()  # no branch ends in the middle
    assert cut.sum() - on_cut.sum() + 1 == loops  # two for each handle, and each boundary


def test_handles_are_cut_where_it_is_cheapest():
    mesh = torus(24)
    graph, _ = graph_of(mesh)
    cut = open_surface(graph, lengths(mesh, graph), np.array([0, 100, 300]), np.empty(0, np.int64))
    length = lengths(mesh, graph)[cut].sum()
    assert length == pytest.approx(2 * np.pi * (1.0 + 1.0), rel=0.01)  # the inner circle and one round the tube


def test_tips_are_joined_by_shortest_paths():
    mesh = grid(10)
    graph, _ = graph_of(mesh)
    middle = int(np.argmin(np.abs(mesh.vertices[:, :2] - 0.5).sum(axis=1)))
    cut = with_tips(graph, lengths(mesh, graph), graph.is_boundary.copy(), np.array([middle, middle + 1]))
    assert lengths(mesh, graph)[cut & ~graph.is_boundary].sum() == pytest.approx(0.5)
    assert (graph.degrees(cut)[[middle, middle + 1]] > 0).all()


def test_vertices_far_apart_are_found():
    mesh = limbed(3)
    graph, topology = graph_of(mesh)
    far = spread_vertices(graph, lengths(mesh, graph), np.ones(topology.vertex_count, bool), 2)
    assert np.argmax(mesh.vertices[:, 2]) in far


def test_the_inside_of_a_bowl_is_seen_less_and_sharp_edges_are_cheap():
    ball = icosphere(4)
    assert visibility(ball.vertices, ball.faces).min() > 0.95
    inside_out = visibility(ball.vertices, ball.faces[:, ::-1])
    assert inside_out.min() > 0.95
    # a ball pressed in deeply from above
    height = ball.vertices[:, 2]
    radial = np.hypot(*ball.vertices[:, :2].T)
    points = ball.vertices.copy()
    points[:, 2] = np.where(height > 0.0, -0.85 * np.sqrt(np.maximum(1.0 - (radial / 1.02) ** 2, 0.0)), height)
    seen = visibility(points, ball.faces)
    assert seen[height > 0.9].mean() < 0.8 * seen[height < -0.9].mean()
    cube = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    faces = np.array(
        [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4),
         (1, 5, 7), (1, 7, 3)]
    )  # fmt: skip
    graph, _ = graph_of(Mesh(cube, faces))
    diagonal = lengths(Mesh(cube, faces), graph) > 1.1
    for kind in range(3):
        costs = edge_costs(cube, faces, graph.ends, graph.halves, np.ones(8), kind) / lengths(Mesh(cube, faces), graph)
        assert costs[~diagonal].max() < 0.5 * costs[diagonal].min()
    half_seen = edge_costs(cube, faces, graph.ends, graph.halves, np.full(8, 0.5), 1) / lengths(Mesh(cube, faces), graph)
    assert np.allclose(half_seen[diagonal], 0.35)


def test_scales_of_a_cap_are_foretold():
    mesh, _ = cap(24, 0.8)
    foretold = Foretold(mesh.vertices, mesh.faces)
    rim = np.zeros(len(mesh.vertices), bool)
    rim[examine(mesh.faces, len(mesh.vertices)).loops[0]] = True
    # stereographic projection scales by (1 + tan(theta / 2)^2) / 2, up to a factor
    theta = np.arccos(np.clip(mesh.vertices[:, 2], -1.0, 1.0))
    exact = np.log((1.0 + np.tan(theta / 2) ** 2) / (1.0 + np.tan(0.4) ** 2))
    assert np.abs(foretold.log_scale(rim) - exact).max() < 0.01
    assert curvature(mesh.vertices, mesh.faces)[~rim].sum() == pytest.approx(2 * np.pi * (1 - np.cos(0.8)), rel=0.05)


def test_the_scale_ratio_leaves_a_hundredth_out_at_either_end_and_squares_lengths():
    values = np.log(np.concatenate([[1e-9], np.ones(499), np.full(499, 3.0), [1e9]]))
    assert scale_ratio(values, np.ones(1000)) == pytest.approx(9.0)
    mesh = grid(6)
    bent = np.where(mesh.vertices[:, :1] > 0.5, mesh.vertices[:, :2] * 2.0, mesh.vertices[:, :2])
    assert scale_ratio_of(mesh, mesh.vertices[:, :2] * 7.0) == pytest.approx(1.0)
    assert scale_ratio_of(mesh, bent) > 3.9


def test_tips_are_those_of_the_regions_that_are_squeezed_too_much():
    mesh = grid(20)
    graph, _ = graph_of(mesh)
    x, y = mesh.vertices[:, :2].T
    pits = [np.exp(-60.0 * ((x - a) ** 2 + (y - 0.5) ** 2)) for a in (0.25, 0.75)]
    areas, nowhere = np.ones(len(x)), np.zeros(len(x), bool)
    tips = tips_of(graph.ends, -4.0 * (pits[0] + pits[1]), areas, nowhere, 4.0)
    assert sorted(np.round(mesh.vertices[tips, 0], 2).tolist()) == [0.25, 0.75]
    assert np.allclose(mesh.vertices[tips, 1], 0.5)
    assert len(tips_of(graph.ends, 0.1 * pits[0], areas, nowhere, 4.0)) == 0
    swollen = tips_of(graph.ends, 4.0 * pits[0], areas, nowhere | (pits[0] < 0.05), 4.0)
    assert np.allclose(mesh.vertices[swollen], [[0.25, 0.5, 0.0]])
