from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from meshes import cap, grid, lifted
from scipy.sparse import csr_array

from pgcp.elimination.dirichlet import available_backends, choose_backend, eliminate_interior, extend_once
from pgcp.errors import InputError, SolveFailedError
from pgcp.surface.operators import cotangent_laplacian, cotangents, face_areas
from pgcp.surface.topology import examine
from pgcp.types import Mesh

MESHES = {"hills": lifted(grid(15, 11, jitter=0.3)), "cap": cap(9)[0], "one inner": grid(2), "no inner": grid(1)}


def loop_of(mesh: Mesh):
    return examine(mesh.faces, len(mesh.vertices)).loops[0]


@pytest.mark.parametrize("backend", available_backends())
@pytest.mark.parametrize(
    "mesh", [lifted(grid(15, 11, jitter=0.3)), cap(9)[0], grid(2), grid(1)], ids=["hills", "cap", "one inner", "no inner"]
)
def test_schur_and_extension_are_those_of_dense_algebra(backend, mesh):
    laplacian, boundary = cotangent_laplacian(mesh.vertices, mesh.faces), loop_of(mesh)
    full = laplacian.toarray()
    inner = np.setdiff1d(np.arange(len(full)), boundary)
    solved = (
        np.linalg.solve(full[np.ix_(inner, inner)], full[np.ix_(inner, boundary)])
        if len(inner)
        else np.zeros((0, len(boundary)))
    )
    schur = full[np.ix_(boundary, boundary)] - full[np.ix_(boundary, inner)] @ solved
    factor = eliminate_interior(laplacian, boundary, backend)
    scale = np.abs(schur).max()
    assert np.abs(factor.schur - schur).max() < 1e-12 * scale
    assert np.abs(factor.schur.sum(axis=0)).max() < 1e-12 * scale
    z = np.random.default_rng(0).normal(size=(len(boundary), 2)) @ [1, 1j]
    u = factor.extend(z)
    assert np.array_equal(u[boundary], z)
    assert np.abs(u[inner] + solved @ z).max(initial=0.0) < 1e-12 * np.abs(z).max()
    load = np.random.default_rng(1).normal(size=(len(full), 2)) @ [1, 1j]
    assert np.abs(factor.reduce(load) - (load[boundary] - solved.T @ load[inner])).max() < 1e-12 * np.abs(load).max()
    u = factor.solve(load, z)
    assert np.array_equal(u[boundary], z)
    assert np.abs((full @ u - load)[inner]).max(initial=0.0) < 1e-12 * np.abs(full).max() * np.abs(u).max()
    assert factor.nbytes > 0
    factor.release()


@pytest.mark.skipif(len(available_backends()) < 2, reason="only one sparse backend is installed")
def test_the_backends_agree(hills):
    laplacian, boundary = cotangent_laplacian(hills.vertices, hills.faces), loop_of(hills)
    one, two = (eliminate_interior(laplacian, boundary, name) for name in available_backends())
    assert np.abs(one.schur - two.schur).max() < 1e-10 * np.abs(two.schur).max()
    z = hills.vertices[boundary] @ [1, 1j, 0]
    assert np.abs(one.extend(z) - two.extend(z)).max() < 1e-10


@pytest.mark.parametrize("backend", available_backends())
def test_a_second_extension_is_not_disturbed_by_the_first(backend, hills):
    boundary = loop_of(hills)
    factor = eliminate_interior(cotangent_laplacian(hills.vertices, hills.faces), boundary, backend)
    z = hills.vertices[boundary] @ [1, 1j, 0]
    first = factor.extend(z)
    factor.extend(z**2)
    factor.solve(first**2, z)
    factor.reduce(first)
    assert np.array_equal(factor.extend(z), first)


def test_linear_functions_are_harmonic_in_the_plane():
    mesh = grid(12, jitter=0.4)
    residual = cotangent_laplacian(mesh.vertices, mesh.faces) @ mesh.vertices[:, :2]
    inner = np.setdiff1d(np.arange(len(mesh.vertices)), loop_of(mesh))
    assert np.abs(residual[inner]).max() < 1e-12


def test_the_laplacian_is_the_gradient_squared(hills):
    """u^T L u = sum over faces of area * |grad u|^2."""
    u = np.cos(3 * hills.vertices[:, 0]) + hills.vertices[:, 1] ** 2
    a, b, c = (hills.vertices[hills.faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    double = np.linalg.norm(normal, axis=1, keepdims=True)
    values = u[hills.faces]
    edges = (c - b, a - c, b - a)
    gradient = sum(values[:, [i]] * np.cross(normal / double, edges[i]) for i in range(3)) / double
    energy = (face_areas(hills.vertices, hills.faces) * (gradient**2).sum(axis=1)).sum()
    assert u @ (cotangent_laplacian(hills.vertices, hills.faces) @ u) == pytest.approx(energy, rel=1e-12)


@pytest.mark.parametrize("unit", [1e-20, 1.0, 1e18])
def test_cotangents_do_not_know_the_unit_of_length(unit):
    triangle = np.array([[0.0, 0, 0], [4, 0, 0], [0, 3, 0]]) * unit
    assert cotangents(triangle, np.array([[0, 1, 2]]))[0] == pytest.approx([0.0, 4 / 3, 3 / 4], abs=1e-12)


def test_a_needle_keeps_its_cotangents():
    h = 1e-9
    triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, h, 0]])
    assert cotangents(triangle, np.array([[0, 1, 2]]))[0, 0] == pytest.approx(0.5 / h, rel=1e-6)


def test_zero_area_and_unknown_backends_are_refused():
    flat = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    with pytest.raises(SolveFailedError, match="zero area"):
        eliminate_interior(cotangent_laplacian(flat.vertices, flat.faces), np.arange(4))
    with pytest.raises(InputError, match="unknown sparse backend 'magic'"):
        choose_backend("magic")


def test_a_backend_that_is_not_installed_is_refused(monkeypatch):
    monkeypatch.setattr("pgcp.elimination.pardiso.is_available", lambda: False)
    assert choose_backend("auto") == "nested"
    assert available_backends() == ("superlu",)
    with pytest.raises(InputError, match="not installed"):
        choose_backend("pardiso")


@pytest.mark.parametrize("backend", available_backends())
def test_a_vertex_without_faces_is_refused(backend):
    mesh = grid(3)
    lonely = np.concatenate([mesh.vertices, [[5.0, 5, 5]]])
    with pytest.raises(SolveFailedError):
        eliminate_interior(cotangent_laplacian(lonely, mesh.faces), loop_of(mesh), backend)


def test_what_stands_in_for_nested_is_the_same_with_mkl_and_without(hills):
    laplacian, boundary = cotangent_laplacian(hills.vertices, hills.faces), loop_of(hills)
    nested, superlu = (eliminate_interior(laplacian, boundary, name) for name in ("nested", "superlu"))
    assert type(nested) is type(superlu)
    assert np.array_equal(nested.schur, superlu.schur)


@pytest.mark.skipif("pardiso" not in available_backends(), reason="the package mkl is not installed")
def test_pardiso_in_several_threads_gives_what_it_gives_in_one():
    meshes = [lifted(grid(9 + k, 7, jitter=0.3)) for k in range(6)]

    def schur(mesh):
        return eliminate_interior(cotangent_laplacian(mesh.vertices, mesh.faces), loop_of(mesh), "pardiso").schur

    alone = [schur(mesh) for mesh in meshes]
    with ThreadPoolExecutor(6) as pool:
        for _ in range(5):
            for one, other in zip(alone, pool.map(schur, meshes), strict=True):
                assert np.array_equal(one, other)


@pytest.mark.skipif("pardiso" not in available_backends(), reason="the package mkl is not installed")
def test_few_inner_vertices_are_not_given_to_pardiso():
    """In Schur mode MKL 2026.2 crashes once in about two thousand times where there are two or three."""

    def kind(side):
        mesh = grid(side)
        return type(eliminate_interior(cotangent_laplacian(mesh.vertices, mesh.faces), loop_of(mesh), "pardiso")).__name__

    assert [kind(2), kind(4), kind(6)] == ["SuperLUFactor", "SuperLUFactor", "PardisoFactor"]


def test_an_extension_once_is_that_of_the_factor_and_makes_nothing_dense(hills):
    laplacian, boundary = cotangent_laplacian(hills.vertices, hills.faces), loop_of(hills)
    values = np.exp(1j * np.arange(len(boundary)))
    expected = eliminate_interior(laplacian, boundary).extend(values)
    assert extend_once(laplacian, boundary, values) == pytest.approx(expected, abs=1e-12)
    everything = np.arange(laplacian.shape[0])
    assert np.array_equal(extend_once(laplacian, everything, everything + 0j), everything)
    # a dense operator of these would need 80 GB
    n = 100_000
    spokes = np.arange(1, n + 1)
    wheel = csr_array(
        (
            np.r_[float(n), np.ones(n), -np.ones(2 * n)],
            (np.r_[0, spokes, 0 * spokes, spokes], np.r_[0, spokes, spokes, 0 * spokes]),
        )
    )
    assert extend_once(wheel, spokes, spokes + 0j)[0] == pytest.approx(spokes.mean())


def test_an_extension_that_cannot_be_is_said():
    with pytest.raises(SolveFailedError, match="not finite"):
        extend_once(csr_array(np.full((3, 3), np.nan)), np.array([0]), np.ones(1, complex))
    with pytest.raises(SolveFailedError, match="SuperLU could not factor"):
        extend_once(csr_array(np.diag([1.0, 0.0, 0.0])), np.array([0]), np.ones(1, complex))
