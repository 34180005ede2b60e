"""The sparse boundary operator against the dense one, and when it is taken."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import grid, lifted, similarity_error

import pgcp
from pgcp.elimination.dirichlet import eliminate_interior
from pgcp.elimination.nested import NestedFactor
from pgcp.elimination.sparse_boundary import (
    SparseFactor,
    applied,
    either_factor,
    pinned_solver,
    sparse_solver,
    stays_sparse,
)
from pgcp.elimination.superlu import SuperLUFactor
from pgcp.errors import SolveFailedError
from pgcp.interface.factor import InterfaceFactor
from pgcp.methods.common.double_cover import solve_pinned
from pgcp.patches.flatten import flatten_boundary
from pgcp.surface.operators import cotangent_laplacian
from pgcp.surface.topology import examine
from pgcp.types import Mesh


def _fan(n, height=0.5):
    angles = 2 * np.pi * np.arange(n) / n
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n)])
    ring = np.arange(1, n + 1)
    return Mesh(np.vstack([[0, 0, height], rim]), np.column_stack([np.zeros(n, int), ring, np.roll(ring, -1)]))


@pytest.mark.parametrize("mesh", [lifted(grid(7)), _fan(12), grid(1), grid(1, 5)], ids=["hills", "fan", "square", "strip"])
def test_it_does_what_the_dense_one_does(mesh):
    n, rng = len(mesh.vertices), np.random.default_rng(0)
    laplacian, loop = cotangent_laplacian(mesh.vertices, mesh.faces), examine(mesh.faces, n).loops[0]
    dense, sparse = eliminate_interior(laplacian, loop), SparseFactor(laplacian, loop, np.ones(n, bool))
    columns, load = rng.normal(size=(len(loop), 2)), rng.normal(size=(n, 2)) @ [1, 1j]
    assert len(sparse.schur) == len(loop)
    assert np.abs(sparse.schur @ columns - dense.schur @ columns).max() < 1e-12
    for pin in (solve_pinned, lambda schur, load: pinned_solver(schur)(load)):
        pinned = [pin(factor.schur, columns[1:]) for factor in (dense, sparse)]
        assert np.abs(pinned[0] - pinned[1]).max() < 1e-11
    values = columns @ [1, 1j]
    assert np.abs(applied(sparse.schur, values) - dense.schur @ values).max() < 1e-12
    assert np.abs(sparse.extend(values) - dense.extend(values)).max() < 1e-12
    assert np.abs(sparse.solve(load, values) - dense.solve(load, values)).max() < 1e-12
    assert np.abs(sparse.reduce(load) - dense.reduce(load)).max() < 1e-12
    assert np.array_equal(sparse.extend(np.full(len(loop), 0.1 + 0.2j)), np.full(n, 0.1 + 0.2j))


def test_vertices_of_no_face_get_nothing():
    mesh = lifted(grid(4))
    more = Mesh(np.vstack([mesh.vertices, [[9, 9, 9]]]), mesh.faces)
    laplacian, loop = cotangent_laplacian(more.vertices, more.faces), examine(mesh.faces, len(mesh.vertices)).loops[0]
    out = SparseFactor(laplacian, loop, np.arange(26) < 25).extend(np.ones(len(loop), np.complex128))
    assert np.array_equal(out, np.arange(26) < 25)


def test_a_singular_system_is_refused():
    laplacian = cotangent_laplacian(grid(2).vertices, grid(2).faces)
    with pytest.raises(SolveFailedError, match="singular"):
        sparse_solver(laplacian * 0)


def test_it_is_taken_where_nearly_all_vertices_lie_on_the_boundary():
    assert stays_sparse(10000, 10001)
    assert not stays_sparse(1000, 1001)
    assert not stays_sparse(4000, 1_000_000)


@pytest.mark.parametrize("method", ["cdcp", "cem", "ccem"])
def test_a_fan_is_mapped_in_little_time_and_memory(method):
    mesh = _fan(4000)
    result = pgcp.parameterize(mesh, method=method, target="disk", patches=2)
    assert result.quality.folds == 0
    assert result.quality.angle_mean_deg < 0.05
    assert result.report["interface"] is None
    assert sum(stage["seconds"] for stage in result.report["stages"]) < 10


@pytest.mark.parametrize("method", ["cem", "ccem"])
def test_an_even_fan_is_mapped_as_well_as_can_be(method):
    """The rim by its length is the exact map; the start of the double cover, whose pole lies at the rim, is far from it."""
    mesh = _fan(60)
    energy = pgcp.parameterize(mesh, method=method, target="disk", patches=1).quality.conformal_energy
    flat = Mesh(mesh.vertices * [1, 1, 0], mesh.faces)
    exact = pgcp.parameterize(mesh, method="fdcp", target="disk", patches=1).quality.conformal_energy
    assert energy <= exact + 1e-9
    assert pgcp.parameterize(flat, method=method, target="disk", patches=1).quality.conformal_energy < 1e-9


@pytest.mark.parametrize("flattener", ["dncp", "scp"])
@pytest.mark.parametrize("mesh", [lifted(grid(7)), _fan(12), grid(1, 50)], ids=["hills", "fan", "strip"])
def test_the_free_boundary_is_that_of_the_dense_operator(mesh, flattener):
    n = len(mesh.vertices)
    laplacian, loop = cotangent_laplacian(mesh.vertices, mesh.faces), examine(mesh.faces, n).loops[0]
    dense, sparse = eliminate_interior(laplacian, loop), SparseFactor(laplacian, loop, np.ones(n, bool))
    z, wanted = (flatten_boundary(factor.schur, mesh.vertices[loop], flattener) for factor in (sparse, dense))
    assert similarity_error(z, wanted) < 1e-8


def test_either_factor_is_sparse_where_nearly_all_is_kept():
    mesh = _fan(1600)
    laplacian = cotangent_laplacian(mesh.vertices, mesh.faces)
    assert isinstance(either_factor(laplacian, np.arange(1, 1601)), SparseFactor)
    assert not isinstance(either_factor(laplacian, np.arange(1, 100)), SparseFactor)
    laplacian.data[0] = np.nan
    with pytest.raises(SolveFailedError, match="not finite"):
        either_factor(laplacian, np.arange(1, 1601))


@pytest.fixture
def nothing_dense(monkeypatch):
    """Whatever would make an operator of more than 1000 vertices fails."""

    def refused(make, kept_at):
        def tried(*arguments, **named):
            assert len(arguments[kept_at]) <= 1000
            make(*arguments, **named)

        return tried

    for factor, kept_at in ((NestedFactor, 3), (SuperLUFactor, 3), (InterfaceFactor, 5)):
        monkeypatch.setattr(factor, "__init__", refused(factor.__init__, kept_at))


@pytest.mark.parametrize(
    "asked",
    [
        {"target": "disk", "method": "bff"},
        {"target": "free", "method": "bff"},
        {"target": "free", "method": "cetm"},
        {"target": "free", "method": "dncp"},
        {"target": "free", "method": "scp"},
        {"target": "disk"},
        {"target": "disk", "flatten": "scp"},
        {"target": "disk", "seams": "exact"},
        {"target": "free", "seams": "relax"},
    ],
    ids=lambda asked: " ".join(asked.values()),
)
def test_nothing_dense_is_made_of_a_long_boundary(asked, nothing_dense):
    result = pgcp.parameterize(_fan(2400), patches=2, polish="none", **asked)
    assert result.quality.folds == 0
    assert result.report["fallback"] is None
    # two pins, both on the rim, bend the map a little: so they do where the operator is dense
    assert result.quality.angle_mean_deg < (0.35 if asked.get("method") == "dncp" else 0.02)
