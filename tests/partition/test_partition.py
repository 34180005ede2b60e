from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from meshes import cap, grid, lifted, tetrahedron
from pgcp.partition.dual_graph import dual_graph, edge_lengths, vertex_starts
from pgcp.partition.kway import bisection_labels, has_metis, metis_labels
from pgcp.partition.smooth import shorten_seams

from pgcp.partition import PartitionError, check_partition, cut_labels, make_disks, partition_faces, seam_table
from pgcp.surface.topology import pair_half_edges


def twins_of(mesh):
    return pair_half_edges(mesh.faces, len(mesh.vertices))


def seam_length(mesh, twins, labels):
    lengths = edge_lengths(mesh.vertices, mesh.faces)
    inner = np.flatnonzero(twins >= 0)
    return lengths[inner[labels[inner // 3] != labels[twins[inner] // 3]]].sum() / 2


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8, 13, 24, 40, 64])
def test_parts_are_disks_and_as_many_as_asked(count, hills):
    twins = twins_of(hills)
    labels = partition_faces(hills.vertices, hills.faces, twins, count, seed=3)
    report = check_partition(hills.faces, twins, labels, count)
    assert report.problems() == []
    assert len(np.unique(labels)) == count
    assert report.face_count.max() <= 2.0 * len(hills.faces) / count


def test_the_same_seed_gives_the_same_labels(hills):
    twins = twins_of(hills)
    one, two = (partition_faces(hills.vertices, hills.faces, twins, 7, seed=5) for _ in range(2))
    assert np.array_equal(one, two)


def long_tube(length=60, around=16):
    """A tube closed at one end: k-way parts are rings."""
    mesh, _ = cap(around // 4, 1.5)
    points = [mesh.vertices * [1, 1, -1]]
    faces = [mesh.faces[:, ::-1]]
    rim = 6 * (around // 4)
    base = len(mesh.vertices) - rim
    phi = 2 * np.pi * np.arange(rim) / rim
    radius, low = np.sin(1.5), -np.cos(1.5)
    start = base
    for k in range(1, length + 1):
        points.append(np.column_stack([radius * np.cos(phi), radius * np.sin(phi), np.full(rim, low + 0.25 * k)]))
        a = start + np.arange(rim)
        b = start + (np.arange(rim) + 1) % rim
        start += rim
        c, d = start + np.arange(rim), start + (np.arange(rim) + 1) % rim
        faces.append(np.concatenate([np.column_stack([a, d, b]), np.column_stack([a, c, d])])[:, ::-1])
    from pgcp.types import Mesh

    return Mesh(np.vstack(points), np.concatenate(faces), "tube")


@pytest.mark.parametrize("count", [2, 5, 9])
def test_rings_are_cut_into_disks(count):
    mesh = long_tube()
    twins = twins_of(mesh)
    rings = np.minimum((mesh.vertices[mesh.faces].mean(axis=1)[:, 2] / 15.0 * count).astype(int), count - 1)
    rings = np.maximum(rings, 0)
    before = check_partition(mesh.faces, twins, rings, count)
    assert any("hole" in problem for problem in before.problems())
    labels = make_disks(mesh.vertices, mesh.faces, twins, rings, count)
    assert check_partition(mesh.faces, twins, labels, count).problems() == []
    assert len(np.unique(labels)) == count


def test_pieces_pinches_and_empty_parts_are_found_and_mended():
    mesh = grid(8)
    twins = twins_of(mesh)
    centre = mesh.vertices[mesh.faces].mean(axis=1)
    labels = np.zeros(len(mesh.faces), int)
    labels[(centre[:, 0] < 0.25) & (centre[:, 1] < 0.25)] = 1
    labels[(centre[:, 0] > 0.75) & (centre[:, 1] > 0.75)] = 1
    assert any("2 pieces" in p for p in check_partition(mesh.faces, twins, labels, 2).problems())
    checker = ((centre[:, 0] > 0.5) ^ (centre[:, 1] > 0.5)).astype(int)
    pinched = check_partition(mesh.faces, twins, checker, 2)
    assert len(pinched.pinched_vertices) == 2
    assert any("no faces" in p for p in check_partition(mesh.faces, twins, labels, 3).problems())
    for bad in (labels, checker):
        mended = make_disks(mesh.vertices, mesh.faces, twins, bad, 2)
        assert check_partition(mesh.faces, twins, mended, 2).problems() == []


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 12), st.booleans())
def test_random_labels_are_repaired(seed, count, noisy):
    mesh = lifted(grid(9, 7, jitter=0.3, seed=seed % 97))
    twins = twins_of(mesh)
    rng = np.random.default_rng(seed)
    centre = mesh.vertices[mesh.faces].mean(axis=1)
    seeds = rng.random((count, 3))
    labels = np.argmin(((centre[:, None] - seeds) ** 2).sum(axis=2), axis=1)
    if noisy:
        flips = rng.random(len(labels)) < 0.2
        labels[flips] = rng.integers(0, count, flips.sum())
    mended = make_disks(mesh.vertices, mesh.faces, twins, labels, count)
    assert check_partition(mesh.faces, twins, mended, count).problems() == []


def test_shortening_seams_shortens_them_and_keeps_disks(hills):
    twins = twins_of(hills)
    lengths = edge_lengths(hills.vertices, hills.faces)
    centre = hills.vertices[hills.faces].mean(axis=1)
    ragged = (centre[:, 0] + 0.06 * np.sin(60 * centre[:, 1]) > 0.5).astype(np.int64)
    labels = make_disks(hills.vertices, hills.faces, twins, ragged, 2)
    before = seam_length(hills, twins, labels)
    starts = vertex_starts(hills.faces, twins, len(hills.vertices))
    moves = shorten_seams(hills.faces, twins, lengths, starts, labels, 2, len(labels), 100)
    assert moves > 0
    assert seam_length(hills, twins, labels) < 0.9 * before
    assert check_partition(hills.faces, twins, labels, 2).problems() == []


def test_bisection_without_metis_is_balanced_and_repairable(hills):
    twins = twins_of(hills)
    labels = bisection_labels(dual_graph(twins, edge_lengths(hills.vertices, hills.faces)), 6)
    assert np.bincount(labels).max() - np.bincount(labels).min() <= 6
    mended = make_disks(hills.vertices, hills.faces, twins, labels, 6)
    assert check_partition(hills.faces, twins, mended, 6).problems() == []


def test_everything_works_without_pymetis(hills, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "pymetis", None)
    import pgcp

    result = pgcp.parameterize(hills, patches=5, backend="superlu")
    assert result.quality.folds == 0
    assert len(result.report["patches"]) == 5
    twins = twins_of(hills)
    assert check_partition(hills.faces, twins, result.patch, 5).problems() == []


def test_cuts_give_the_parts_between_them():
    mesh = grid(8)
    twins = twins_of(mesh)
    column = np.arange(9) + 9 * 4
    labels = cut_labels(mesh.faces, twins, np.column_stack([column[:-1], column[1:]]))
    assert len(np.unique(labels)) == 2
    left = mesh.vertices[mesh.faces].mean(axis=1)[:, 0] < 0.5
    assert np.array_equal(labels == labels[left][0], left)


def test_a_cut_that_is_no_edge_is_refused_by_its_number():
    mesh = grid(8)
    with pytest.raises(PartitionError, match=r"cut 2 \(0 80\) is not an edge"):
        cut_labels(mesh.faces, twins_of(mesh), np.array([[0, 1], [0, 80]]))


def test_contacts_tell_arcs_from_other_meetings():
    mesh = grid(6)
    twins = twins_of(mesh)
    centre = mesh.vertices[mesh.faces].mean(axis=1)
    labels = (centre[:, 0] * 2).astype(int) * 2 + (centre[:, 1] * 2).astype(int)
    contacts = seam_table(mesh.vertices, mesh.faces, twins, labels).contacts(np.arange(4))
    counts = np.column_stack([contacts.edge_count, contacts.vertex_count])
    meets = dict(zip(map(tuple, contacts.pairs.tolist()), map(tuple, counts.tolist()), strict=True))
    assert meets[(0, 1)] == (3, 4)
    assert meets[(0, 3)] == (0, 1)
    assert dict(zip(map(tuple, contacts.pairs.tolist()), contacts.is_arc.tolist(), strict=True))[(0, 3)] is False


def test_impossible_counts_are_refused():
    mesh = tetrahedron()
    twins = twins_of(mesh)
    with pytest.raises(PartitionError, match="only 4 faces"):
        partition_faces(mesh.vertices, mesh.faces, twins, 5)
    with pytest.raises(PartitionError, match="at least 1"):
        partition_faces(mesh.vertices, mesh.faces, twins, 0)
    labels = partition_faces(mesh.vertices, mesh.faces, twins, 2)
    assert check_partition(mesh.faces, twins, labels, 2).is_valid


@pytest.mark.skipif(not has_metis(), reason="pymetis is not installed")
def test_edges_without_length_can_be_cut():
    """Where most edges have none, as on a surface of voxels, their median is no measure."""
    mesh = grid(6)
    dual = dual_graph(pair_half_edges(mesh.faces, len(mesh.vertices)), edge_lengths(mesh.vertices, mesh.faces)).tocsr()
    dual.data[::2] = dual.data[1::4] = 0.0
    assert np.median(dual.data) == 0
    labels = metis_labels(dual, np.ones(len(mesh.faces), np.int64), 4, 0)
    assert np.bincount(labels).min() > 0
