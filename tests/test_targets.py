"""Maps to the disk and to the sphere: exact maps, invariance, orientation, the same bits everywhere."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np
import pytest
from meshes import cap, grid, icosphere, lifted, spheroid, tetrahedron
from oracles import moebius_distance

import pgcp
from pgcp.elimination.dirichlet import choose_backend, eliminate_interior
from pgcp.errors import CrowdedError, SolveFailedError, WeldFailedError
from pgcp.patches.constrain import constrain_to_disk, constrain_to_sphere
from pgcp.patches.flatten import factor_patch, flatten_simply
from pgcp.patches.plan import plan_welds
from pgcp.patches.solve import solve_patch
from pgcp.patches.split import cut_patch, split_mesh
from pgcp.patches.types import Component, Patch
from pgcp.patches.weld import run_welds, start_component, weld_closed
from pgcp.plane.mobius import boost
from pgcp.plane.space import PLANE, SPHERE
from pgcp.retry import course
from pgcp.surface.beltrami import folded_faces_on_sphere
from pgcp.surface.operators import cotangent_laplacian, cotangents, needed_mollification, positive_laplacian
from pgcp.surface.topology import examine
from pgcp.types import Mesh


def rays(n, which):
    """Cut edges of ``cap(n)`` along some of its six rays from the centre."""
    counts = np.array([1] + [6 * k for k in range(1, n + 1)])
    first = np.concatenate([[0], np.cumsum(counts)])
    return np.array([(first[k] + s * k, first[k + 1] + s * (k + 1)) for s in which for k in range(n)])


def components(mesh, patches, seed=0):
    topology = examine(mesh.faces, len(mesh.vertices))
    split = split_mesh(mesh, topology, patches, seed)
    out = {}
    for index in range(split.patch_count):
        patch = cut_patch(mesh, topology, split, index)
        factor = factor_patch(patch, choose_backend("auto"))
        out[index] = start_component(flatten_simply(patch, factor, "dncp", choose_backend("auto")), mesh.vertices, split.edges)
        factor.release()
    return split, out


@pytest.mark.parametrize("which", [(0, 3), (0, 2, 4)])
def test_a_cap_goes_to_the_disk_by_its_exact_map_to_first_order(which, tmp_path):
    errors = []
    for n in (8, 16, 32):
        mesh, exact = cap(n)
        np.savetxt(tmp_path / "cuts.txt", rays(n, which), fmt="%d")
        result = pgcp.parameterize(mesh, cuts=tmp_path / "cuts.txt", target="disk", moebius="none", polish="none")
        assert len(result.report["patches"]) == len(which)
        errors.append(moebius_distance(result.coordinates @ [1, 1j], exact / np.abs(exact).max()))
    assert errors[-1] < 1e-3
    assert np.log2(np.array(errors[:-1]) / errors[1:]).min() > 0.9


@pytest.mark.parametrize("patches", [1, 5])
def test_a_cap_in_other_patches(patches):
    mesh, exact = cap(32)
    result = pgcp.parameterize(mesh, patches=patches, target="disk", polish="none")
    assert moebius_distance(result.coordinates @ [1, 1j], exact / np.abs(exact).max()) < 1.5e-3


@pytest.mark.parametrize("length", [0.5, 2.0, 4.0])
def test_a_spheroid_goes_to_the_sphere_by_its_exact_map(length):
    errors = []
    for levels in (2, 3, 4, 5):
        mesh, exact = spheroid(levels, length)
        result = pgcp.parameterize(mesh, patches=6, polish="none")
        assert result.target == "sphere"
        assert result.quality.degree == pytest.approx(1.0, abs=1e-9)
        errors.append(moebius_distance(result.coordinates, exact))
    assert errors[-1] < 2e-2
    assert np.log2(errors[0] / errors[-1]) / 3 > 1.0


@pytest.mark.parametrize("patches", [2, 6])
def test_a_moebius_image_of_the_sphere_has_the_same_map_up_to_an_automorphism(patches, monkeypatch):
    monkeypatch.setattr(course, "may_be_solved_in_logarithms", lambda *_: False)  # both by welds, or they are not comparable
    errors = []
    for levels in (2, 4):
        mesh = icosphere(levels)
        moved = Mesh(boost(mesh.vertices, np.array([0.3, -0.2, 0.4])), mesh.faces)
        errors.append(moebius_distance(pgcp.parameterize(moved, patches=patches, polish="none").coordinates, mesh.vertices))
    assert errors[1] < 0.01
    assert errors[1] < errors[0] / 4


def test_a_moebius_image_of_a_square_has_the_same_disk_up_to_an_automorphism():
    distances = []
    for n in (8, 32):
        mesh = grid(n)
        w = 1 / (mesh.vertices @ [1, 1j, 0] + 0.5 + 0.7j)
        bent = Mesh(np.column_stack([w.real, w.imag, 0 * w.real]), mesh.faces)
        one, two = (pgcp.parameterize(m, patches=4, target="disk", polish="none").coordinates @ [1, 1j] for m in (mesh, bent))
        distances.append(moebius_distance(one, two))
    assert distances[1] < 2.5e-3
    assert distances[1] < distances[0] / 4


@pytest.mark.parametrize("target", ["disk", "sphere"])
def test_serial_and_workers_agree_to_the_bit(target):
    mesh = lifted(grid(24)) if target == "disk" else spheroid(3, 2.0)[0]
    serial = pgcp.parameterize(mesh, patches=5, target=target)
    workers = pgcp.parameterize(mesh, patches=5, target=target, workers=2)
    assert serial.coordinates.tobytes() == workers.coordinates.tobytes()
    assert serial.mu.tobytes() == workers.mu.tobytes()
    assert {task["worker"] for task in serial.report["timeline"]} == {0}
    tasks = workers.report["timeline"]
    assert {task["worker"] for task in tasks} <= {1, 2}
    for worker in (1, 2):  # each does one after the other
        own = sorted((task["begin"], task["begin"] + task["seconds"]) for task in tasks if task["worker"] == worker)
        assert all(end <= begin + 1e-3 for (_, end), (begin, _) in pairwise(own))


@pytest.mark.parametrize("patches", [2, 3, 7])
@pytest.mark.parametrize("mesh", [icosphere(3), spheroid(3, 6.0)[0], spheroid(3, 0.2)[0]], ids=["round", "long", "flat"])
def test_every_closed_surface_covers_the_sphere_once(mesh, patches):
    result = pgcp.parameterize(mesh, patches=patches)
    assert np.abs(np.linalg.norm(result.coordinates, axis=1) - 1).max() < 1e-14
    assert len(folded_faces_on_sphere(mesh.faces, result.coordinates)) == 0
    assert result.quality.degree == pytest.approx(1.0, abs=1e-9)
    assert result.quality.mu_max < 1


def test_the_smallest_closed_surfaces():
    for mesh in (tetrahedron(), icosphere(0), icosphere(1)):
        result = pgcp.parameterize(mesh)
        assert result.quality.folds == 0
        assert result.quality.degree == pytest.approx(1.0)


def test_the_sphere_faces_the_way_the_surface_does():
    mesh = spheroid(3, 1.7)[0]
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    points = pgcp.parameterize(Mesh(mesh.vertices @ turn.T, mesh.faces), patches=4).coordinates
    outward = mesh.vertices @ turn.T
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    assert (points * outward).sum(axis=1).mean() > 0.95


def test_the_correction_lowers_the_area_distortion_and_keeps_the_angles():
    for mesh in (lifted(grid(24)), spheroid(3, 3.0)[0]):
        target = "disk" if len(mesh.faces) == 1152 else "sphere"
        plain = pgcp.parameterize(mesh, patches=4, target=target, moebius="none", polish="none")
        better = pgcp.parameterize(mesh, patches=4, target=target, moebius="area", polish="none")
        record = better.report["correction"]
        assert plain.report["correction"] is None
        assert record["log_area_before"] == pytest.approx(plain.quality.log_area_mean)
        assert better.quality.log_area_mean <= plain.quality.log_area_mean
        assert better.quality.angle_mean_deg <= 1.01 * plain.quality.angle_mean_deg
        angle = pgcp.parameterize(mesh, patches=4, target=target, moebius="angle", polish="none")
        assert angle.quality.angle_mean_deg <= plain.quality.angle_mean_deg


def test_a_vertex_at_the_centre():
    mesh = lifted(grid(16))
    middle = int(np.argmin(np.linalg.norm(mesh.vertices[:, :2] - [0.3, 0.6], axis=1)))
    result = pgcp.parameterize(mesh, patches=3, target="disk", centre=middle)
    assert np.abs(result.coordinates[middle]).max() < 1e-15
    assert result.quality.folds == 0
    ball = pgcp.parameterize(icosphere(3), centre=77)
    assert np.allclose(ball.coordinates[77], [0, 0, 1], atol=1e-14)
    assert np.abs(np.linalg.norm(ball.coordinates, axis=1) - 1).max() < 1e-14


def test_unused_vertices_have_a_place_on_the_sphere():
    mesh = icosphere(2)
    more = Mesh(np.vstack([mesh.vertices, [[7.0, 7, 7]]]), mesh.faces)
    result = pgcp.parameterize(more, patches=2)
    assert np.array_equal(result.coordinates[-1], [0, 0, 1])
    with pytest.raises(pgcp.InputError, match="which no face uses"):
        pgcp.parameterize(more, patches=2, centre=len(mesh.vertices))


def test_a_long_strip_keeps_its_boundary_in_order_on_the_circle():
    """The ends of a 1 x 18 strip span 1e-11 of the circle: boundary vertices must stay apart and nothing may fold."""
    mesh = grid(6, 108, jitter=0.2)
    result = pgcp.parameterize(mesh, patches=4, target="disk")
    boundary = pgcp.check_mesh(mesh).loops[0]
    z = result.coordinates @ [1, 1j]
    angles = np.angle(z[boundary]) % (2 * np.pi)
    assert (np.diff(angles) > 0).all()
    assert np.abs(np.abs(z[boundary]) - 1).max() < 1e-12
    assert result.report["smallest_gap"] < 1e-9


def test_a_strip_with_ends_at_the_limit_is_spread_out():
    mesh = grid(4, 84)
    result = pgcp.compute(mesh, pgcp.Options(patches=4, target="disk"))
    z = result.coordinates @ [1, 1j]
    boundary = pgcp.check_mesh(mesh).loops[0]
    assert result.report["spread_points"] > 0
    assert (np.diff(np.angle(z[boundary]) % (2 * np.pi)) > 0).all()
    assert np.isfinite(result.coordinates).all()


@pytest.mark.parametrize("length", [200, 2000])
def test_a_strip_longer_than_numbers_can_tell_is_embedded_and_the_reason_said(length):
    result = pgcp.compute(grid(4, length), pgcp.Options(patches=4, target="disk"))
    assert (result.target, result.quality.folds) == ("disk", 0)
    fallback = result.report["fallback"]
    assert (fallback["from"], fallback["to"]) == ("disk", "disk (embedding)")
    assert re.search(r"so long and thin .* target free can map it", fallback["reason"])
    with pytest.raises(CrowdedError, match=r"so long and thin .* target free can map it"):
        pgcp.compute(grid(4, length), pgcp.Options(patches=4, target="disk", repairs=()))


def test_the_last_weld_of_a_closed_surface_joins_whole_boundaries():
    mesh = icosphere(3)
    split, parts = components(mesh, 5)
    steps = plan_welds(split.table, 5, closed=True).steps
    assert [s.closed for s in steps] == [False] * 3 + [True]
    union = run_welds(parts, steps)
    assert len(union.loop) == 0
    assert len(np.unique(union.nodes)) == len(union.nodes)
    assert np.isfinite(union.z).sum() == len(union.z) - 1
    seams = constrain_to_sphere(union)
    assert np.abs(np.linalg.norm(seams.points, axis=1) - 1).max() < 1e-14
    assert moebius_distance(seams.points, mesh.vertices[seams.vertex_ids]) < 0.03
    with pytest.raises(WeldFailedError, match="do not share their whole boundaries"):
        _, other = components(mesh, 4, seed=3)
        weld_closed(other[0], other[1])


def test_a_union_that_crosses_itself_is_refused_by_the_disk():
    t = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    eight = np.sin(t) + 0.5j * np.sin(2 * t)
    n = len(t)
    edges = np.column_stack([np.arange(n), np.roll(np.arange(n), -1)])
    union = Component(np.arange(n), eight, np.arange(n), edges, np.ones(n), n)
    with pytest.raises(WeldFailedError, match="crosses itself near its point"):
        constrain_to_disk(union)


def one_patch(mesh):
    return Patch(
        0, mesh.vertices, mesh.faces, np.arange(len(mesh.vertices)), np.arange(len(mesh.faces)),
        examine(mesh.faces, len(mesh.vertices)).loops[0], np.ones(1, int),
    )  # fmt: skip


def test_the_chart_of_a_flat_patch_is_the_plane_itself():
    mesh = grid(9, jitter=0.3)
    patch = one_patch(mesh)
    z = mesh.vertices @ [1, 1j, 0]
    solved = solve_patch(PLANE, patch, z[patch.boundary], factor_patch(patch, "superlu"), "superlu")
    assert np.abs(solved.points - z).max() < 1e-13


def test_a_squeezed_patch_is_solved_in_a_chart_that_opens_it():
    mesh = grid(24)
    patch = one_patch(mesh)
    exact = 1 / (mesh.vertices @ [1, 1j, 0] + 0.1 + 0.1j)
    factor = factor_patch(patch, "superlu")
    solved = solve_patch(PLANE, patch, exact[patch.boundary], factor, "superlu")
    plain = factor.extend(exact[patch.boundary])
    assert solved.fold_count == 0
    assert np.abs(solved.points - exact).max() < 0.7 * np.abs(plain - exact).max()


def test_a_patch_that_covers_the_whole_sphere_has_no_chart():
    mesh = grid(2)
    patch = one_patch(mesh)
    with pytest.raises(SolveFailedError):
        solve_patch(SPHERE, patch, np.tile([0.0, 0.0, 1.0], (8, 1)), factor_patch(patch, "superlu"), "superlu")


def skewed(seed):
    """A patch whose flat triangles make many weights negative, and a convex boundary for it."""
    mesh = grid(14, jitter=0.45, seed=seed)
    rng = np.random.default_rng(seed)
    points = mesh.vertices * [1.0, 0.02, 1.0]
    points[:, 2] = 0.05 * rng.normal(size=len(points))
    return one_patch(Mesh(points, mesh.faces))


@pytest.mark.parametrize("seed", range(3))
def test_positive_weights_undo_folds_where_they_are_needed(seed):
    patch = skewed(seed)
    n = len(patch.boundary)
    circle = np.exp(2j * np.pi * np.arange(n) / n)
    laplacian, raised = positive_laplacian(patch.vertices, patch.faces, np.ones(len(patch.faces), bool), 1e-3)
    assert raised > 0
    off = laplacian - laplacian.multiply(np.eye(laplacian.shape[0]))
    assert off.max() <= 0
    without = eliminate_interior(cotangent_laplacian(patch.vertices, patch.faces), patch.boundary, "superlu")
    solved = solve_patch(PLANE, patch, circle, without, "superlu")
    assert solved.first_fold_count > 2  # the cotangent weights alone fold
    assert solved.raised_weights > 0
    assert solved.fold_count <= 2


def test_mollified_weights_are_finite_and_near_the_true_ones():
    mesh = grid(6, jitter=0.3)
    true, near = (cotangent_laplacian(mesh.vertices, mesh.faces, m).toarray() for m in (0.0, 1e-9))
    assert np.abs(near - true).max() < 1e-6
    points = mesh.vertices.copy()
    points[10] = points[11]
    needed = needed_mollification(points, mesh.faces)
    assert needed_mollification(mesh.vertices, mesh.faces) == 0
    assert 0 < needed < 1e-4
    assert np.isfinite(cotangent_laplacian(points, mesh.faces, needed).toarray()).all()


def test_no_weight_is_raised_without_need():
    mesh = grid(5, jitter=0.4)
    none = np.zeros(len(mesh.faces), bool)
    laplacian, raised = positive_laplacian(mesh.vertices, mesh.faces, none, 1e-3)
    assert raised == 0
    assert np.abs(laplacian - cotangent_laplacian(mesh.vertices, mesh.faces)).max() < 1e-12
    assert np.isfinite(cotangents(mesh.vertices, mesh.faces)).all()


def test_a_centre_on_the_boundary_is_refused_before_anything_is_mapped(monkeypatch):
    mesh = grid(4)
    monkeypatch.setattr("pgcp.pipeline.map_mesh", None)
    with pytest.raises(pgcp.InputError, match="vertex 0 is on the boundary: it cannot be the centre of the disk"):
        pgcp.parameterize(mesh, target="disk", centre=0)
