"""Loops on several processors: what they give does not depend on how many there are."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from meshes import cap, icosphere
from pgcp.partition.straighten import _rounds

from pgcp import parallel
from pgcp.parallel import at_once, beside, in_parts, in_slices, limited_to, processor_count
from pgcp.partition import partition_faces
from pgcp.patches import weld
from pgcp.plane import natural, zipper
from pgcp.surface.topology import examine


@pytest.fixture(autouse=True)
def _three_processors(monkeypatch):
    monkeypatch.setattr(parallel.os, "sched_getaffinity", lambda _: {0, 1, 2}, raising=False)


def test_a_limit_holds_inside_and_in_the_threads_started_there():
    assert processor_count() == 3
    with limited_to(2):
        assert at_once(processor_count, processor_count) == [2, 2]
        with limited_to(1):
            assert processor_count() == 1
        assert processor_count() == 2
    with limited_to(9):
        assert processor_count() == 3
    assert processor_count() == 3


def test_as_many_threads_as_processors():
    barrier = threading.Barrier(3)
    assert len(set(at_once(*3 * [lambda: (barrier.wait(10), threading.get_ident())[1]]))) == 3
    with limited_to(1):
        assert at_once(*3 * [threading.get_ident]) == 3 * [threading.get_ident()]


def test_beside_needs_a_processor():
    with beside(threading.get_ident) as result:
        assert result() != threading.get_ident()
    with limited_to(1), beside(threading.get_ident) as result:
        assert result() == threading.get_ident()
    called = []
    with limited_to(1), beside(lambda: called.append(1)):
        pass
    assert not called  # nobody asked


def test_parts_make_up_the_whole():
    assert in_parts(lambda *ends: ends, 1000, 100) == [(0, 320), (320, 640), (640, 1000)]
    assert in_parts(lambda *ends: ends, 1000, 400) == [(0, 448), (448, 1000)]
    assert in_parts(lambda *ends: ends, 0, 100) == [(0, 0)]
    with limited_to(1):
        assert in_parts(lambda *ends: ends, 1000, 100) == [(0, 1000)]
    slices = in_slices(lambda *ends: ends, 600_000)
    with limited_to(1):
        assert in_slices(lambda *ends: ends, 600_000) == slices


@pytest.mark.parametrize("mesh", [cap(60)[0], icosphere(5)], ids=["open", "closed"])
def test_a_partition_does_not_depend_on_the_order_of_what_is_done_at_once(mesh):
    topology = examine(mesh.faces, len(mesh.vertices))
    moved = []

    def backwards(*functions):
        out = [function() for function in functions[::-1]][::-1]
        moved.append(sum(type(one) is bool and one for one in out))
        return out

    def labels(at_once):
        return partition_faces(mesh.vertices, mesh.faces, topology.twins, 16, at_once=at_once)

    assert np.array_equal(labels(backwards), labels(at_once))
    assert max(moved) > 1  # seams that are moved at the same time


def test_seams_that_are_moved_at_the_same_time_have_nothing_in_common():
    taken = [({0, 1}, {5, 6}), ({2, 3}, {7, 8}), ({1, 2}, {9, 10}), ({4, 5}, {6, 11}), ({6, 7}, {12, 13})]
    assert _rounds(taken) == [[0, 1, 4], [2, 3]]


def test_a_weld_has_the_same_bits_on_any_number_of_processors(monkeypatch):
    for module, name in ((natural, "_LEAST_ROWS"), (natural, "_LEAST_POINTS"), (zipper, "_LEAST_POINTS")):
        monkeypatch.setattr(module, name, 64)
    monkeypatch.setattr(zipper, "_LEAST_VALUES", 64)
    split = []

    def noted(function, length, least):
        parts = in_parts(function, length, least)
        split.append(len(parts))
        return parts

    monkeypatch.setattr(natural, "in_parts", noted)
    monkeypatch.setattr(zipper, "in_parts", noted)
    unions = [_union()]
    assert max(split) == 3
    for count in (2, 1):
        split.clear()
        with limited_to(count):
            unions.append(_union())
        assert max(split) == count
    assert all(union.z.tobytes() == unions[0].z.tobytes() for union in unions)


def _union():
    """Two wavy half-disks, welded."""
    t = np.linspace(0.0, np.pi, 400)
    diameter = np.linspace(-1.0, 1.0, 300)[1:-1]
    sides = []
    for sign in (1, -1):
        arc = np.exp(1j * sign * t) * (1.0 + 0.1 * np.sin(5 * t))
        middle = diameter + 0.1j * sign * np.sin(3 * diameter)
        ids = np.concatenate([[0], 1000 * (2 + sign) + np.arange(398), [1], 10_000 + np.arange(298)])
        z = np.concatenate([arc, middle])
        if sign < 0:
            ids, z = ids[::-1], z[::-1]
        n = len(z)
        edges = np.column_stack([np.arange(n), np.roll(np.arange(n), -1)])
        sides.append(weld.Component(ids, z, np.arange(n), edges, np.full(n, 0.01), 10**6))
    return weld.weld_pair(*sides)
