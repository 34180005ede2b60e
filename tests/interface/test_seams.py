"""Clusters of faces, and seams made straight."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import grid, icosphere, lifted
from pgcp.partition.clusters import cluster_graph, grow_clusters
from pgcp.partition.dual_graph import dual_graph, edge_lengths, label_components, vertex_starts
from pgcp.partition.straighten import straighten_seams

from pgcp.partition import check_partition, partition_faces, seam_half_edges
from pgcp.surface.topology import pair_half_edges


def parts_of(mesh):
    twins = pair_half_edges(mesh.faces, len(mesh.vertices))
    return twins, edge_lengths(mesh.vertices, mesh.faces), vertex_starts(mesh.faces, twins, len(mesh.vertices))


def seam_length(mesh, twins, lengths, labels):
    return lengths[seam_half_edges(twins, labels)].sum()


@pytest.mark.parametrize("size", [1, 7, 16])
def test_clusters_are_connected_and_their_graph_weighs_what_they_share(size):
    mesh = lifted(grid(20, 15, jitter=0.3))
    twins, lengths, _ = parts_of(mesh)
    clusters = grow_clusters(twins, size)
    cluster, sizes, graph = clusters[0], np.diff(clusters[2]), cluster_graph(twins, lengths, *clusters)
    assert (np.bincount(cluster) == sizes).all()
    assert sizes.min() >= 1
    assert sizes.max() == size
    assert label_components(twins, cluster)[0] == len(sizes)
    dual = dual_graph(twins, lengths).tocoo()
    apart = cluster[dual.row] != cluster[dual.col]
    expected = np.zeros(graph.shape)
    np.add.at(expected, (cluster[dual.row[apart]], cluster[dual.col[apart]]), dual.data[apart])
    assert np.abs(graph.toarray() - expected).max() < 1e-12


def test_a_crooked_seam_becomes_the_shortest_path_between_its_ends():
    mesh = grid(24)
    twins, lengths, starts = parts_of(mesh)
    centre = mesh.vertices[mesh.faces].mean(axis=1)
    labels = (centre[:, 0] > 0.5 + 0.12 * np.sin(12 * centre[:, 1]) * (centre[:, 1] * (1 - centre[:, 1]))).astype(np.int32)
    before = seam_length(mesh, twins, lengths, labels)
    assert straighten_seams(mesh.faces, twins, lengths, starts, labels, 2, 8) == 1
    assert seam_length(mesh, twins, lengths, labels) == pytest.approx(1.0)  # the square's height
    assert before > 1.05
    assert check_partition(mesh.faces, twins, labels, 2).is_valid


def test_a_closed_seam_is_shortened_in_two_halves():
    mesh = icosphere(4)
    twins, lengths, starts = parts_of(mesh)
    centre = mesh.vertices[mesh.faces].mean(axis=1)
    turn = np.arctan2(centre[:, 1], centre[:, 0])
    labels = (centre[:, 2] > 0.15 * np.sin(9 * turn)).astype(np.int32)
    before = seam_length(mesh, twins, lengths, labels)
    for _ in range(3):
        straighten_seams(mesh.faces, twins, lengths, starts, labels, 2, 10)
    assert seam_length(mesh, twins, lengths, labels) < 0.9 * before
    assert check_partition(mesh.faces, twins, labels, 2).is_valid


@pytest.mark.parametrize("count", [2, 3, 5, 8, 13, 30])
@pytest.mark.parametrize("kind", ["open", "closed"])
def test_straight_seams_leave_disks_and_are_no_longer(kind, count):
    mesh = lifted(grid(40, 30, jitter=0.35)) if kind == "open" else icosphere(4)
    twins, lengths, starts = parts_of(mesh)
    for seed in range(3):
        labels = partition_faces(mesh.vertices, mesh.faces, twins, count, seed)
        assert check_partition(mesh.faces, twins, labels, count).problems() == []
        again = labels.copy()
        straighten_seams(mesh.faces, twins, lengths, starts, again, count, 5)
        assert check_partition(mesh.faces, twins, again, count).problems() == []
        assert seam_length(mesh, twins, lengths, again) <= seam_length(mesh, twins, lengths, labels) * (1 + 1e-12)


def test_from_random_beginnings_disks_stay_disks():
    """Parts grown at random have ragged seams that touch and wind."""
    mesh = lifted(grid(18, 14, jitter=0.3))
    twins, lengths, starts = parts_of(mesh)
    from pgcp.partition import make_disks

    for seed in range(30):
        rng = np.random.default_rng(seed)
        labels = np.full(len(mesh.faces), -1, np.int32)
        count = int(rng.integers(2, 9))
        labels[rng.choice(len(labels), count, replace=False)] = np.arange(count)
        while (labels < 0).any():
            h = np.flatnonzero((twins >= 0) & (np.repeat(labels, 3) >= 0))
            h = h[labels[twins[h] // 3] < 0]
            h = rng.permutation(h)[: max(1, len(h) // 3)]
            labels[twins[h] // 3] = labels[h // 3]
        labels = make_disks(mesh.vertices, mesh.faces, twins, labels, count)
        before = seam_length(mesh, twins, lengths, labels)
        straighten_seams(mesh.faces, twins, lengths, starts, labels, count, 6)
        assert check_partition(mesh.faces, twins, labels, count).problems() == []
        assert seam_length(mesh, twins, lengths, labels) <= before * (1 + 1e-12)
