"""Multigrid against a direct factor; without pyamg one sentence says what to install."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from meshes import grid, lifted

import pgcp
from pgcp.elimination import multigrid
from pgcp.elimination.multigrid import MultigridSolver
from pgcp.elimination.sparse_boundary import sparse_solver
from pgcp.errors import SolveFailedError
from pgcp.methods.base import Method, whole
from pgcp.methods.cem import cem_map
from pgcp.methods.common.disk import map_disk, of_energy
from pgcp.methods.registry import METHODS
from pgcp.surface.operators import cotangent_laplacian


def _system():
    mesh = lifted(grid(40))
    return cotangent_laplacian(mesh.vertices, mesh.faces)[1:][:, 1:]


def test_it_solves_as_a_direct_factor_does_and_leaves_the_generator_alone():
    pytest.importorskip("pyamg")
    matrix = _system()
    load = np.random.default_rng(0).normal(size=(matrix.shape[0], 2))
    before = np.random.get_state()[1].copy()
    one, other = MultigridSolver(matrix), MultigridSolver(matrix)
    assert np.array_equal(np.random.get_state()[1], before)
    solved = one.solve(load)
    exact = sparse_solver(matrix).solve(load)
    assert np.abs(solved - exact).max() < 1e-8 * np.abs(exact).max()
    assert np.array_equal(other.solve(load), solved)
    assert one.solve(load[:, 0]).shape == (len(load),)
    assert np.array_equal(one.solve(0 * load), 0 * load)


def test_what_does_not_converge_says_so(monkeypatch):
    pytest.importorskip("pyamg")
    monkeypatch.setattr(multigrid, "MOST_ITERATIONS", 1)
    matrix = _system()
    with pytest.raises(SolveFailedError, match=r"did not converge in 1 iterations on 1680 unknowns: residual .* direct solver"):
        MultigridSolver(matrix).solve(np.eye(len(matrix.toarray()), 1))


def test_without_pyamg_it_is_said_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyamg", None)
    with pytest.raises(pgcp.InputError, match=r"pip install pgcp\[multigrid\]"):
        MultigridSolver(_system())


def test_cem_comes_to_the_same_map_by_multigrid():
    pytest.importorskip("pyamg")

    def find(disk):
        return of_energy(cem_map(disk.factor, disk.boundary_block(), disk.start_angles()))

    maps = []
    for name, make in (("cem-direct", None), ("cem-multigrid", MultigridSolver)):
        mapper = whole(lambda run, parts, make=make: map_disk(run, parts, find, make))
        METHODS.register(Method(name, ("disk",), "a", "b", "c", mapper, moebius="none"))
        try:
            maps.append(pgcp.parameterize(lifted(grid(20), 0.5), method=name, target="disk", patches=2).coordinates)
        finally:
            METHODS.remove(name)
    assert np.abs(maps[0] - maps[1]).max() < 1e-7
