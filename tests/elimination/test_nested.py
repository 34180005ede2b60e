"""The nested elimination against a dense one, and the plan it follows."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from meshes import cap, grid, lifted, spheroid

from pgcp.elimination.dirichlet import eliminate_mesh, harmonic_solver
from pgcp.elimination.dissection import dissect
from pgcp.elimination.nested import NestedFactor, NestedSolver
from pgcp.elimination.superlu import SuperLUFactor
from pgcp.errors import SolveFailedError
from pgcp.surface.operators import cotangent_laplacian
from pgcp.surface.topology import examine


def surfaces():
    hills = lifted(grid(23, 17))
    yield hills, examine(hills.faces, len(hills.vertices)).loops[0]
    ball, _ = spheroid(3, 2.0)
    yield ball, np.array([5, 3, 400, 17])  # kept vertices need not be a boundary, nor in order
    round_, _ = cap(40)
    loop = examine(round_.faces, len(round_.vertices)).loops[0]
    yield round_, np.concatenate([loop, [0, 7, 100]])


@pytest.mark.parametrize("case", range(3))
@pytest.mark.parametrize("mollification", [0.0, 0.01])
def test_all_that_a_factor_gives_is_that_of_the_dense_matrix(case, mollification):
    mesh, kept = list(surfaces())[case]
    dense = cotangent_laplacian(mesh.vertices, mesh.faces, mollification).toarray()
    inner = np.setdiff1d(np.arange(len(mesh.vertices)), kept)
    reduced = np.linalg.solve(dense[np.ix_(inner, inner)], dense[np.ix_(inner, kept)])
    factor = NestedFactor(mesh.vertices, mesh.faces, kept, mollification)
    schur = dense[np.ix_(kept, kept)] - dense[np.ix_(kept, inner)] @ reduced
    assert np.abs(factor.schur - schur).max() < 1e-12 * np.abs(schur).max()
    rng = np.random.default_rng(case)
    values = rng.standard_normal(len(kept)) + 1j * rng.standard_normal(len(kept))
    load = rng.standard_normal(len(dense)) + 1j * rng.standard_normal(len(dense))
    extended = factor.extend(values)
    assert np.abs(extended[inner] + reduced @ values).max() < 1e-12
    assert (extended[kept] == values).all()
    solved = factor.solve(load, values)
    assert np.abs(dense[inner] @ solved - load[inner]).max() < 1e-10
    assert np.abs(factor.reduce(load) - (load[kept] - reduced.T @ load[inner])).max() < 1e-10


@pytest.mark.parametrize("faces_a_leaf", [1, 5, 24, 10**6])
def test_the_plan_eliminates_every_vertex_once_and_after_all_it_is_joined_to_below(faces_a_leaf):
    mesh, kept = next(surfaces())
    tree = dissect(mesh.vertices, mesh.faces, kept, faces_a_leaf)
    count = len(tree.children)
    assert sorted(tree.position.tolist()) == list(range(len(mesh.vertices)))
    assert tree.position[kept].tolist() == list(range(len(mesh.vertices) - len(kept), len(mesh.vertices)))
    assert sorted(tree.order.tolist()) == list(range(len(mesh.faces)))
    parent = np.full(count, -1)
    for k in range(count):
        if tree.leaf[k] < 0:
            assert (tree.children[k] < k).all()
            parent[tree.children[k]] = k
    owner = np.searchsorted(tree.first, np.arange(tree.first[-1]), side="right") - 1
    for k in range(count):
        others = tree.others[tree.starts[k] : tree.starts[k + 1]]
        assert (np.diff(others) > 0).all()
        above = set()
        up = parent[k]
        while up >= 0:
            above.add(up)
            up = parent[up]
        assert all(p >= tree.first[-1] or owner[p] in above for p in others.tolist())
    assert tree.starts[-1] - tree.starts[-2] == len(kept)  # the root leaves what is kept


def test_halves_are_even_and_lie_apart():
    mesh = grid(64, 16)
    tree = dissect(mesh.vertices, mesh.faces, np.arange(4), 512)
    assert tree.depth == 2
    centres = mesh.vertices[mesh.faces].mean(axis=1)[tree.order]
    quarters = np.array_split(centres[:, 0], 4)
    for one, other in combinations(quarters, 2):
        assert len(one) == len(other)
        assert min(one.max(), other.max()) <= max(one.min(), other.min()) + 1e-12


def test_a_cut_crosses_few_faces_rather_than_the_longest_axis():
    mesh = grid(20, 200)
    wide = mesh.vertices * [30.0, 1.0, 1.0]
    tree = dissect(wide, mesh.faces, np.arange(4), 4000)
    assert tree.depth == 1
    assert np.diff(tree.first)[-1] <= 23


def test_where_no_pivot_is_left_another_backend_takes_over(monkeypatch):
    mesh, kept = next(surfaces())
    good = eliminate_mesh(mesh.vertices, mesh.faces, kept)
    assert isinstance(good, NestedFactor)
    from pgcp.elimination import dirichlet
    from pgcp.elimination import nested as dirichlet_nested

    monkeypatch.setattr(dirichlet_nested, "_factor", lambda *_: False)
    with pytest.raises(SolveFailedError, match="pivot that is not positive"):
        NestedFactor(mesh.vertices, mesh.faces, kept)
    monkeypatch.setattr(dirichlet, "available_backends", lambda: ("superlu",))
    other = eliminate_mesh(mesh.vertices, mesh.faces, kept)
    assert isinstance(other, SuperLUFactor)
    assert np.abs(other.schur - good.schur).max() < 1e-12 * np.abs(good.schur).max()


def test_nothing_to_eliminate_and_nothing_to_keep():
    mesh = grid(1)
    factor = NestedFactor(mesh.vertices, mesh.faces, np.arange(4))
    assert np.abs(factor.schur - cotangent_laplacian(mesh.vertices, mesh.faces).toarray()).max() < 1e-15
    with pytest.raises(SolveFailedError, match="in no face"):
        NestedFactor(np.vstack([mesh.vertices, [5.0, 5.0, 5.0]]), mesh.faces, np.arange(4))


@pytest.mark.parametrize("case", range(3))
def test_the_solver_of_the_second_pass_extends_as_the_factor_does(case):
    mesh, kept = list(surfaces())[case]
    rng = np.random.default_rng(case)
    values = rng.standard_normal(len(kept)) + 1j * rng.standard_normal(len(kept))
    factor = NestedFactor(mesh.vertices, mesh.faces, kept, 0.01)
    solver = harmonic_solver(mesh.vertices, mesh.faces, kept, "nested", 0.01)
    assert isinstance(solver, NestedSolver)
    assert np.abs(solver.extend(values) - factor.extend(values)).max() < 1e-12
    assert (solver.extend(values)[kept] == values).all()
    again = harmonic_solver(mesh.vertices, mesh.faces, kept, "nested", 0.01, factor.order)
    assert again.extend(values).tobytes() == solver.extend(values).tobytes()
    bare = NestedFactor(mesh.vertices, mesh.faces, kept, 0.01, lambda nbytes: nbytes < 0)
    assert not bare.is_whole
    assert bare.schur.tobytes() == factor.schur.tobytes()
    assert bare.nbytes < factor.nbytes
    other = harmonic_solver(mesh.vertices, mesh.faces, kept, "superlu", 0.01)
    assert np.abs(other.extend(values) - factor.extend(values)).max() < 1e-10


@pytest.mark.parametrize("kept", [[0, 1, 4, 3], [0, 1, 1]])
def test_vertices_kept_twice_or_in_no_face_are_refused(kept):
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [5, 5, 5]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    with pytest.raises(SolveFailedError, match="in no face, or is to be kept twice"):
        NestedFactor(square[: 5 if 4 in kept else 4], faces, np.array(kept))
