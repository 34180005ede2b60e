"""Harmonic maps of a surface with some vertices kept, and of its double cover, against one sparse solve."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import grid, lifted

import pgcp
from pgcp.elimination.dirichlet import eliminate_interior
from pgcp.errors import SolveFailedError
from pgcp.methods.common import kept
from pgcp.methods.common.kept import KeptDisk, first_of, harmonic, rim_of
from pgcp.surface.operators import cotangent_laplacian
from pgcp.surface.topology import examine


def test_equal_values_go_by_their_place_whatever_rounding():
    values = np.array([3.0, 1.0, 2.0, 1.0, np.inf, 2.0])
    for seed in range(5):
        noise = 1 + 1e-14 * np.random.default_rng(seed).uniform(-1, 1, 6)
        assert first_of(values * noise, 4).tolist() == [1, 3, 2, 5]
    assert first_of(np.zeros(3), 2).tolist() == [0, 1]
    assert first_of(np.array([np.inf, 1.0]), 1).tolist() == [1]


def test_rim_separates_held_from_free():
    faces = np.array([[0, 1, 2], [1, 3, 2], [2, 3, 4]])
    assert rim_of(np.array([True, True, True, False, False]), faces).tolist() == [1, 2]


def test_what_is_not_held_carries_no_load():
    mesh = lifted(grid(4))
    matrix = cotangent_laplacian(mesh.vertices, mesh.faces).toarray()
    rng = np.random.default_rng(0)
    held, values = rng.uniform(size=25) < 0.3, rng.normal(size=(25, 2)) @ [1, 1j]
    out = harmonic(matrix, held, values)
    assert np.array_equal(out[held], values[held])
    assert np.abs((matrix @ out)[~held]).max() < 1e-12
    with pytest.raises(SolveFailedError, match="not positive definite"):
        harmonic(-matrix, held, values)


class _Whole(KeptDisk):
    """A mesh's operator by one elimination, without patches."""

    def __init__(self, mesh, inner):
        self.loop = examine(mesh.faces, len(mesh.vertices)).loops[0]
        self.inner, self.kept = inner, np.concatenate([self.loop, inner])
        self.factor = eliminate_interior(cotangent_laplacian(mesh.vertices, mesh.faces), self.kept)
        self.schur = self.factor.schur


def test_the_double_cover_is_that_of_two_copies_glued_along_the_boundary():
    mesh = lifted(grid(8))
    n, laplacian = len(mesh.vertices), cotangent_laplacian(mesh.vertices, mesh.faces).toarray()
    disk = _Whole(mesh, np.array([30, 31, 40, 50]))
    held, values = np.zeros((2, n), bool), np.random.default_rng(1).normal(size=(2, n, 2)) @ [1, 1j]
    held[0, [30, 31, disk.loop[5]]] = held[1, [40, 50]] = True
    one, other = (disk.extend(copy) for copy in disk.doubled(held, values))
    assert np.array_equal(one[disk.loop], other[disk.loop])
    assert np.array_equal(one[[30, 31]], values[0, [30, 31]])
    assert np.array_equal(other[[40, 50]], values[1, [40, 50]])
    load = np.stack([laplacian @ one, laplacian @ other])
    load[:, disk.loop] = load[:, disk.loop].sum(axis=0)
    assert np.abs(load[~held]).max() > 1e-3  # the boundary vertex that is held, in its second copy
    held[1, disk.loop[5]] = True
    assert np.abs(load[~held]).max() < 1e-11


def test_inner_vertices_that_are_kept_change_no_disk_map():
    mesh = lifted(grid(8))
    disk, plain = _Whole(mesh, np.array([30, 31, 40])), _Whole(mesh, np.empty(0, int))
    circle = np.exp(2j * np.pi * np.arange(len(disk.loop)) / len(disk.loop))
    assert np.abs(disk.within(circle) - plain.within(circle)).max() < 1e-13


@pytest.mark.parametrize("method", ["fdcp", "ldm"])
def test_a_sparse_operator_leads_to_the_same_map(method, monkeypatch):
    mesh, maps = lifted(grid(12), 0.5), []
    for sparse in (False, True):
        monkeypatch.setattr(kept, "stays_sparse", lambda boundary, vertices, sparse=sparse: sparse)
        result = pgcp.parameterize(mesh, method=method, target="disk", patches=2)
        assert (result.report["interface"] is None) == sparse
        maps.append(result.coordinates)
    assert np.abs(maps[0] - maps[1]).max() < 1e-9
