"""CDCP: the paper's theorem, maps that are known, and the paper's own figures."""

from __future__ import annotations

import numpy as np
import pytest
from descents import heat, heat_matrix
from meshes import cap, grid, lifted
from oracles import moebius_distance
from scipy.sparse.linalg import spsolve
from test_real import DISK

import pgcp
from pgcp.elimination.dirichlet import available_backends, choose_backend, eliminate_interior
from pgcp.errors import CrowdedError, SolveFailedError
from pgcp.methods import cdcp
from pgcp.methods.ccem import ccem_map
from pgcp.methods.cdcp import cdcp_map, least_angle_shift
from pgcp.methods.cem import cem_map
from pgcp.methods.common.boundary_energy import goes_round_once
from pgcp.methods.common.double_cover import (
    central_face,
    circle_boundary,
    dipole,
    harmonic_boundary,
    late_heat,
    start_angles,
)
from pgcp.plane.mobius import are_apart, shift_disk
from pgcp.plane.space import PLANE
from pgcp.surface.beltrami import folded_faces
from pgcp.surface.distortion import angle_errors, conformal_energy
from pgcp.surface.operators import cotangent_laplacian
from pgcp.surface.topology import examine
from pgcp.types import Mesh


def problem(mesh, backend="superlu", first=0):
    """The loop, from its point ``first`` on, and the Laplacian's factor."""
    loop = np.roll(examine(mesh.faces, len(mesh.vertices)).loops[0], -first)
    return loop, eliminate_interior(cotangent_laplacian(mesh.vertices, mesh.faces), loop, backend)


def centre_of(mesh, loop, factor):
    return central_face(mesh.vertices, mesh.faces, late_heat(loop, np.ones(len(mesh.vertices), bool), factor))


def doubled(mesh, loop):
    """The double cover: the mesh and a copy of it with the other orientation, their boundaries identified."""
    n = len(mesh.vertices)
    inner = np.setdiff1d(np.arange(n), loop)
    copy = np.arange(n)
    copy[inner] = n + np.arange(len(inner))
    return Mesh(np.vstack([mesh.vertices, mesh.vertices[inner]]), np.vstack([mesh.faces, copy[mesh.faces[:, ::-1]]]))


def rough(mesh):
    """Vertices moved at random, some edges no longer Delaunay."""
    return Mesh(mesh.vertices + 0.05 * np.random.default_rng(0).normal(size=mesh.vertices.shape), mesh.faces)


@pytest.mark.parametrize("backend", available_backends())
@pytest.mark.parametrize("mesh", [rough(cap(7)[0]), cap(8, 2.6)[0]], ids=["rough", "cap"])
def test_half_of_the_double_cover_is_enough(mesh, backend):
    """CDCP Theorem 1, Corollary 1: h_B = 2 h~_B + c."""
    loop, factor = problem(mesh, backend)
    double = doubled(mesh, loop)
    assert examine(double.faces, len(double.vertices)).is_sphere
    face = mesh.faces[centre_of(mesh, loop, factor)]
    load = np.zeros(len(double.vertices), complex)
    load[face] = dipole(mesh.vertices[face])
    laplacian = cotangent_laplacian(double.vertices, double.faces).tocsc()
    whole = np.zeros(len(load), complex)
    whole[1:] = spsolve(laplacian[1:, 1:], load[1:])
    assert np.abs(laplacian @ whole - load).max() < 1e-9 * np.abs(load).max()
    twice = 2.0 * whole[loop]
    twice -= twice.mean()
    assert np.abs(harmonic_boundary(mesh.vertices, face, factor) - twice).max() < 1e-10 * np.abs(twice).max()


def test_the_dipole_takes_the_derivative_across_its_face():
    """<r, u> = du/dx - i du/dy for a linear u in the face's own chart."""
    corners = np.random.default_rng(3).normal(size=(3, 3))
    one = corners[1] - corners[0]
    one /= np.linalg.norm(one)
    two = corners[2] - corners[0]
    two -= (two @ one) * one
    two /= np.linalg.norm(two)
    u = (corners - corners[0]) @ (0.7 * one - 1.3 * two)
    assert dipole(corners) @ u == pytest.approx(0.7 + 1.3j, abs=1e-12)


@pytest.mark.parametrize("backend", available_backends())
def test_the_harmonic_boundary_does_not_depend_on_where_the_loop_begins(backend):
    """A face a million times smaller than the disk: what its dipole leaves over in rounding does not go out at one vertex."""
    flat, _ = cap(20)
    ring = np.rint(20 * np.arccos(np.clip(flat.vertices[:, 2], -1, 1)) / 1.2)
    radius = np.where(ring > 0, 1e-6 ** (1 - (ring - 1) / 19), 0.0)
    across = flat.vertices[:, :2] / np.maximum(np.linalg.norm(flat.vertices[:, :2], axis=1), 1e-300)[:, None]
    mesh = Mesh(np.pad(radius[:, None] * across, ((0, 0), (0, 1))), flat.faces)
    found = []
    for first in (0, 17, 50):
        _, factor = problem(mesh, backend, first)
        found.append(np.roll(harmonic_boundary(mesh.vertices, mesh.faces[0], factor), first))
    for other in found[1:]:
        assert np.abs(other - found[0]).max() < 2e-11 * np.abs(found[0]).max()


class Within:
    """A factor of a mesh whose first vertices no face uses: it does not read what is said of them, and they stay at 0."""

    def __init__(self, factor, unused):
        self._factor, self._unused, self.schur = factor, unused, factor.schur

    def reduce(self, load):
        return self._factor.reduce(load[self._unused :])

    def solve(self, load, values):
        return np.pad(self._factor.solve(load[self._unused :], values), (self._unused, 0))


def test_vertices_that_no_face_uses_take_no_heat():
    mesh = lifted(grid(6, 20), 0.5)
    loop, factor = problem(mesh)
    plain = late_heat(loop, np.ones(len(mesh.vertices), bool), factor)
    used = np.arange(2000 + len(plain)) >= 2000
    found = late_heat(loop + 2000, used, Within(factor, 2000))
    assert np.abs(found[2000:] - plain).max() < 1e-12 * np.abs(plain).max()
    more = Mesh(np.vstack([np.random.default_rng(0).normal(size=(2000, 3)), mesh.vertices]), mesh.faces + 2000)
    one, other = (pgcp.parameterize(m, method="cdcp", patches=3) for m in (mesh, more))
    assert np.abs(other.coordinates[2000:] - one.coordinates).max() < 1e-9


def test_heat_is_one_implicit_step():
    mesh = lifted(grid(11, jitter=0.3))
    loop, _ = problem(mesh)
    matrix = heat_matrix(cotangent_laplacian(mesh.vertices, mesh.faces))
    start = np.zeros(len(mesh.vertices))
    start[loop] = 1.0
    expected = np.linalg.solve(matrix.toarray(), start)
    assert np.abs(heat(eliminate_interior(matrix, loop)) - expected).max() < 1e-12


@pytest.mark.parametrize("backend", available_backends())
def test_late_heat_is_the_limit_of_long_times(hills, backend):
    loop, factor = problem(hills, backend)
    late = late_heat(loop, np.ones(len(hills.vertices), bool), factor)
    late -= late.mean()
    for time in (1e5, 1e7):
        now = time * heat(eliminate_interior(heat_matrix(cotangent_laplacian(hills.vertices, hills.faces), time), loop))
        assert np.abs(now - now.mean() - late).max() < 2e3 / time * np.abs(late).max()
        assert central_face(hills.vertices, hills.faces, now) == central_face(hills.vertices, hills.faces, late)


def test_the_centre_of_a_cap_is_its_pole():
    mesh, _ = cap(10)
    loop, factor = problem(mesh)
    assert 0 in mesh.faces[centre_of(mesh, loop, factor)]


def test_a_needle_is_no_centre_while_there_are_other_faces():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0.01, 0], [0.5, 0.8, 0], [2, 0.5, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 3], [1, 4, 3]])
    warmth = np.array([0.1, 0.1, 0.1, 0.5, 2.0])
    assert int(np.argmin(warmth[faces].sum(axis=1))) == 0
    assert central_face(points, faces, warmth) in (1, 2)
    assert central_face(points, faces[:1], warmth) == 0


def test_a_spherical_cap_comes_out_at_second_order():
    errors = []
    for n in (6, 12, 24, 48):
        mesh, exact = cap(n)
        loop, factor = problem(mesh)
        z = cdcp_map(mesh, loop, factor, centre_of(mesh, loop, factor), corrected=False).z
        assert np.abs(np.abs(z[loop]) - 1).max() < 1e-12
        assert z[loop[0]] == pytest.approx(1.0, abs=1e-14)
        errors.append(moebius_distance(z, exact / np.abs(exact).max()))
    assert np.log2(np.array(errors[:-1]) / errors[1:]).min() > 1.9
    assert errors[-1] < 1e-4


@pytest.mark.parametrize("corrected", [False, True])
def test_the_map_is_a_disk_map_in_order_without_folds(hills, corrected):
    loop, factor = problem(hills)
    z = cdcp_map(hills, loop, factor, centre_of(hills, loop, factor), corrected).z
    assert goes_round_once(z[loop])
    assert np.abs(np.abs(z[loop]) - 1).max() < 1e-14
    assert z[loop[0]] == pytest.approx(1.0, abs=1e-14)
    assert np.abs(z).max() < 1 + 1e-14
    assert len(folded_faces(hills.faces, z)) == 0


def test_the_correction_finds_back_a_map_that_was_moved():
    mesh, exact = cap(10, 0.05)
    exact = exact / np.abs(exact).max()
    moved = shift_disk(exact, 0.5 - 0.3j)
    omega = least_angle_shift(mesh.vertices, mesh.faces, moved)
    # vertices move, not the points between them, so a coarse map comes back to within its own error
    assert abs(omega - (-0.5 + 0.3j)) < 1e-2
    before, after = (angle_errors(mesh, PLANE.coordinates(z)).mean() for z in (moved, shift_disk(moved, omega)))
    assert after < 0.02 * before


def test_the_correction_never_makes_angles_worse():
    gains = []
    for mesh in (lifted(grid(12), 0.5), lifted(grid(20, 8, jitter=0.3)), cap(9, 2.5)[0]):
        loop, factor = problem(mesh)
        centre = centre_of(mesh, loop, factor)
        plain, best = (cdcp_map(mesh, loop, factor, centre, corrected) for corrected in (False, True))
        assert plain.omega == 0
        gains.append(
            angle_errors(mesh, PLANE.coordinates(plain.z)).mean() - angle_errors(mesh, PLANE.coordinates(best.z)).mean()
        )
        assert (gains[-1] > 0) == (best.omega != 0)
    assert min(gains) >= 0 < max(gains)


def test_a_correction_that_only_helps_its_sample_is_not_made(monkeypatch):
    """One that folds nothing and leaves all boundary points apart: only its angles speak against it."""
    mesh, _ = cap(9, 2.5)
    loop, factor = problem(mesh)
    centre = centre_of(mesh, loop, factor)
    plain = cdcp_map(mesh, loop, factor, centre, corrected=False).z
    for sample in (5, 8):
        monkeypatch.setattr("pgcp.methods.cdcp._SAMPLE", sample)
        omega = least_angle_shift(mesh.vertices, mesh.faces, plain)
        moved = shift_disk(plain, omega)
        assert abs(omega) > 0.1
        assert are_apart(moved, loop)
        assert len(folded_faces(mesh.faces, moved)) == 0
        assert angle_errors(mesh, PLANE.coordinates(moved)).mean() > angle_errors(mesh, PLANE.coordinates(plain)).mean() + 0.5
        kept = cdcp_map(mesh, loop, factor, centre)
        assert kept.omega == 0
        assert np.array_equal(kept.z, plain)


@pytest.mark.parametrize(("seed", "n"), [(11, 2), (17, 4), (22, 2)])
def test_a_correction_that_folds_is_not_made(seed, n):
    """On few large faces a Moebius map of their vertices may fold one and still keep angles better on the whole."""
    rng, mesh = np.random.default_rng(seed), grid(n, jitter=0.4, seed=seed)
    mesh = Mesh(mesh.vertices + 0.3 / n * rng.normal(size=mesh.vertices.shape) * [0.5, 0.5, 2], mesh.faces)
    loop, factor = problem(mesh)
    centre = centre_of(mesh, loop, factor)
    plain = cdcp_map(mesh, loop, factor, centre, corrected=False).z
    moved = shift_disk(plain, least_angle_shift(mesh.vertices, mesh.faces, plain))
    assert angle_errors(mesh, PLANE.coordinates(moved)).mean() < angle_errors(mesh, PLANE.coordinates(plain)).mean()
    assert len(folded_faces(mesh.faces, moved)) > len(folded_faces(mesh.faces, plain)) == 0
    kept = cdcp_map(mesh, loop, factor, centre)
    assert kept.omega == 0
    assert np.array_equal(kept.z, plain)


def test_a_curve_that_is_not_simple_is_refused():
    t = 2 * np.pi * np.arange(40) / 40
    eight = (np.cos(t) + 1j * np.sin(2 * t)) + 3.0
    with pytest.raises(SolveFailedError, match="crosses itself"):
        circle_boundary(eight)


def test_points_that_cannot_be_told_apart_are_refused():
    mesh = grid(3, 60)
    loop, factor = problem(mesh)
    with pytest.raises(CrowdedError, match="long and thin"):
        cdcp_map(mesh, loop, factor, centre_of(mesh, loop, factor))


def test_the_start_of_cem_is_in_order_even_where_the_curve_turns_back():
    t = 2 * np.pi * np.arange(80) / 80
    round_curve = np.exp(-1j * t) * (1 + 0.2 * np.cos(3 * t))
    assert np.abs(start_angles(round_curve) - t).max() < 1e-14
    swirl = np.exp(-1j * (t + 0.3 * np.sin(4 * t))) * (1 + 0.3 * np.cos(4 * t))
    assert not goes_round_once(np.conj(swirl))
    angles = start_angles(swirl)
    assert (np.diff(angles) > 0).all()
    assert angles[-1] < 2 * np.pi


@pytest.mark.parametrize(("name", "mean", "sd"), [("chinese_lion_head", 1.42, 2.05), ("human_brain", 1.46, 1.59)])
@pytest.mark.parametrize("corrected", [False, True])
@pytest.mark.parametrize("late", [False, True])
def test_the_printed_figures(name, mean, sd, corrected, late, mesh_folder):
    """CDCP Table 1, to the printed digits, with and without the Moebius correction, heat at time 1e4 or late."""
    mesh = pgcp.read_mesh(mesh_folder / "open" / f"{name}.ply")
    backend = choose_backend()
    loop, factor = problem(mesh, backend)
    laplacian = cotangent_laplacian(mesh.vertices, mesh.faces)
    warmth = (
        late_heat(loop, np.ones(len(mesh.vertices), bool), factor)
        if late
        else heat(eliminate_interior(heat_matrix(laplacian), loop, backend))
    )
    centre = central_face(mesh.vertices, mesh.faces, warmth)
    z = cdcp_map(mesh, loop, factor, centre, corrected).z
    errors = angle_errors(mesh, PLANE.coordinates(z))
    assert (round(float(errors.mean()), 2), round(float(errors.std()), 2)) == (mean, sd)
    assert len(folded_faces(mesh.faces, z)) == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(DISK) - {"alligator"}))
def test_real_meshes_are_mapped_as_well_as_by_any(name, mesh_folder):
    """CDCP against the least angle errors of other tools, CCEM against the energy of CEM. No folds in any."""
    mesh = pgcp.read_mesh(mesh_folder / "open" / f"{name}.ply")
    loop, factor = problem(mesh, choose_backend())
    centre = centre_of(mesh, loop, factor)
    constructive = cdcp_map(mesh, loop, factor, centre).z
    assert angle_errors(mesh, PLANE.coordinates(constructive)).mean() <= 1.02 * DISK[name]
    block = cotangent_laplacian(mesh.vertices, mesh.faces)[loop][:, loop]
    start = start_angles(harmonic_boundary(mesh.vertices, mesh.faces[centre], factor))
    first, least = cem_map(factor, block, start), ccem_map(factor, block, start)
    assert least.converged
    assert conformal_energy(mesh, least.z) < conformal_energy(mesh, first.z)
    for z in (constructive, first.z, least.z):
        assert goes_round_once(z[loop])
        assert len(folded_faces(mesh.faces, z)) == 0


@pytest.fixture
def mapped_hills():
    mesh = lifted(grid(12, jitter=0.3))
    loop, factor = problem(mesh)
    centre = centre_of(mesh, loop, factor)
    return mesh, loop, factor, centre, cdcp_map(mesh, loop, factor, centre, False)


def test_a_correction_that_raises_the_angle_error_is_not_kept(mapped_hills, monkeypatch):
    mesh, loop, factor, centre, plain = mapped_hills
    monkeypatch.setattr(cdcp, "least_angle_shift", lambda *_: 0.9 + 0j)
    found = cdcp_map(mesh, loop, factor, centre)
    worse = angle_errors(mesh, PLANE.coordinates(shift_disk(plain.z, 0.9))).mean()
    assert worse > angle_errors(mesh, PLANE.coordinates(plain.z)).mean()
    assert np.array_equal(found.z, plain.z)
    assert found.omega == 0
