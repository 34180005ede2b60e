"""Repair of folds: every tier where it is the one that is needed, and what is said where it is switched off."""

from __future__ import annotations

import re

import numpy as np
import pytest
from meshes import grid, icosphere, similarity_error, spheroid

import pgcp
from pgcp.errors import FoldError, SolveFailedError, WeldFailedError
from pgcp.folds.embed import drawn_back, embed_disk, embed_sphere
from pgcp.folds.regions import _deformed, regions_around
from pgcp.folds.repair import Surroundings, repair_folds
from pgcp.folds.untangle import _better_place
from pgcp.interface import whole_mesh
from pgcp.methods import pgcp as welds
from pgcp.options import REPAIRS
from pgcp.patches import stored
from pgcp.plane.space import PLANE, SPHERE
from pgcp.retry import course
from pgcp.surface.beltrami import folded_faces, folded_faces_on_sphere
from pgcp.surface.topology import examine, rings_around
from pgcp.targets.registry import TARGETS
from pgcp.types import Mesh

NONE = np.empty(0, np.int64)


def surroundings(mesh, target="free"):
    loops = examine(mesh.faces, len(mesh.vertices)).loops
    kind = TARGETS.get(target)
    return Surroundings(mesh, kind.space, loops[0] if loops else NONE, 0.0, kind.has_free_boundary)


def find_folds(faces, positions):
    return (folded_faces_on_sphere if positions.ndim == 2 else folded_faces)(faces, positions)


def folded_map(seed=0, count=3):
    mesh = grid(16, jitter=0.3)
    z = mesh.vertices[:, 0] + 1j * mesh.vertices[:, 1]
    inner = np.flatnonzero((np.abs(z.real - 0.5) < 0.4) & (np.abs(z.imag - 0.5) < 0.4))
    chosen = np.random.default_rng(seed).choice(inner, count, replace=False)
    bad = z.copy()
    bad[chosen] += 0.09 * np.exp(1j * np.arange(count))
    return mesh, z, bad


@pytest.mark.parametrize("method", ["relax", "average", "untangle"])
@pytest.mark.parametrize("seed", range(3))
def test_local_folds_are_repaired_and_the_rest_keeps(seed, method):
    mesh, _, bad = folded_map(seed)
    before = find_folds(mesh.faces, bad)
    assert len(before) > 0
    done = repair_folds(surroundings(mesh), bad, (method,))
    assert done.folds == len(find_folds(mesh.faces, done.points)) == 0
    changed = np.flatnonzero(done.points != bad)
    assert {record.method for record in done.records} == {method}
    assert (done.records[0].folds_before, done.records[-1].folds_after) == (len(before), 0)
    assert 0 < done.records[-1].moved_vertices <= len(changed) < 200
    assert np.array_equal(done.touched, np.flatnonzero(np.isin(mesh.faces, changed).any(axis=1)))


@pytest.mark.parametrize("methods", [REPAIRS, ()])
def test_a_good_map_is_not_touched(methods):
    mesh, z, _ = folded_map()
    done = repair_folds(surroundings(mesh), z, methods)
    assert done.points is z
    assert len(done.touched) == len(done.records) == done.folds == 0


def test_the_boundary_stays_but_for_single_moves_in_a_free_map():
    mesh = grid(8)
    z = mesh.vertices @ [1, 1j, 0]
    boundary = surroundings(mesh).boundary
    z[boundary[3]] += 0.2j
    assert len(find_folds(mesh.faces, z)) > 0
    for target, methods in (("disk", REPAIRS), ("free", ("relax", "compose", "average"))):
        done = repair_folds(surroundings(mesh, target), z, methods)
        assert np.array_equal(done.points[boundary], z[boundary])
    assert repair_folds(surroundings(mesh), z, REPAIRS[:3]).folds > 0
    done = repair_folds(surroundings(mesh), z, REPAIRS)
    assert (done.folds, done.records[-1].method) == (0, "untangle")
    assert done.points[boundary[3]] != z[boundary[3]]


@pytest.mark.parametrize("method", ["relax", "average", "untangle", "embed"])
def test_folds_on_the_sphere_are_repaired(method):
    mesh = icosphere(4)
    bad = mesh.vertices.copy()
    rng = np.random.default_rng(1)
    chosen = rng.choice(len(bad), 3, replace=False)
    bad[chosen] += rng.normal(size=(3, 3)) * 0.15
    bad[chosen] /= np.linalg.norm(bad[chosen], axis=1)[:, None]
    assert len(find_folds(mesh.faces, bad)) > 0
    done = repair_folds(surroundings(mesh, "sphere"), bad, (method,))
    assert len(find_folds(mesh.faces, done.points)) == done.folds == 0
    assert np.allclose(np.linalg.norm(done.points, axis=1), 1.0, atol=1e-15)
    assert np.abs(done.points - mesh.vertices).max() < 0.2


def test_what_cannot_be_repaired_is_said():
    mesh = grid(8)
    z = (mesh.vertices[:, 0] + 1j * mesh.vertices[:, 1]).conj()
    done = repair_folds(surroundings(mesh), z, REPAIRS)
    assert done.folds == len(mesh.faces)
    local = list(REPAIRS[:3])
    assert [(r.method, r.rings) for r in done.records] == [
        *((m, rings) for rings in (3, 12, 48) for m in local), ("untangle", 8), *((m, -1) for m in local)
    ]  # fmt: skip
    assert {r.folds_after for r in done.records} == {len(mesh.faces)}
    assert np.array_equal(done.points, z)


@pytest.mark.parametrize("method", REPAIRS[:-1])
def test_a_repair_never_leaves_more_folds_than_it_found(method):
    rng = np.random.default_rng(5)
    for _ in range(4):
        mesh = grid(5, jitter=0.4)
        z = mesh.vertices @ [1, 1j, 0]
        z[rng.choice(len(z), 9, replace=False)] += 0.4 * rng.normal(size=9)
        before = len(find_folds(mesh.faces, z))
        done = repair_folds(surroundings(mesh), z, (method,))
        assert len(find_folds(mesh.faces, done.points)) == done.folds <= before
        changed = np.flatnonzero(done.points != z)
        assert np.array_equal(np.flatnonzero(np.isin(mesh.faces, changed).any(axis=1)), done.touched)


# embedding


def test_any_positions_of_a_disk_in_a_circle_lead_to_a_map_without_folds():
    mesh = grid(20, jitter=0.45)
    boundary = surroundings(mesh).boundary
    rng = np.random.default_rng(3)
    z = rng.normal(size=len(mesh.vertices)) + 1j * rng.normal(size=len(mesh.vertices))
    z[boundary] = np.exp(2j * np.pi * np.arange(len(boundary)) / len(boundary))
    assert len(find_folds(mesh.faces, embed_disk(mesh, z, boundary, 0.0))) == 0


@pytest.mark.parametrize("length", [1.0, 3.0])
def test_any_positions_on_the_sphere_lead_to_a_map_without_folds(length):
    mesh, _ = spheroid(4, length)
    rng = np.random.default_rng(3)
    points = rng.normal(size=mesh.vertices.shape)
    points /= np.linalg.norm(points, axis=1)[:, None]
    safe = embed_sphere(mesh, points, 0.0)
    assert len(find_folds(mesh.faces, points)) > 1000
    assert len(find_folds(mesh.faces, safe)) == 0


def test_the_embedding_of_a_conformal_map_is_near_it():
    mesh = icosphere(4)
    safe = embed_sphere(mesh, mesh.vertices, 0.0)
    assert np.abs(safe - mesh.vertices).max() < 0.03
    disk, _ = folded_map()[:2]
    z = disk.vertices @ [1, 1j, 0]
    flat = embed_disk(Mesh(disk.vertices, disk.faces), z, surroundings(disk).boundary, 0.0)
    assert similarity_error(flat, z) < 0.05


@pytest.mark.parametrize("on_sphere", [False, True])
def test_a_safe_map_goes_back_all_the_way_to_a_map_without_folds(on_sphere):
    mesh = icosphere(3) if on_sphere else grid(12, jitter=0.3)
    goal = mesh.vertices if on_sphere else mesh.vertices @ [1, 1j, 0]
    held = np.zeros(len(goal), bool)
    if on_sphere:
        moved = goal + np.array([0.3, 0.1, 0.2])
        safe = moved / np.linalg.norm(moved, axis=1)[:, None]
    else:
        safe = goal + 0.1 * goal**2
    assert len(find_folds(mesh.faces, safe)) == 0
    space = SPHERE if on_sphere else PLANE
    assert np.array_equal(drawn_back(space, mesh.faces, safe, goal, held), goal)
    held[:20] = True
    part = drawn_back(space, mesh.faces, safe, goal, held)
    assert np.array_equal(part[:20], safe[:20])
    assert len(find_folds(mesh.faces, part)) == 0


# regions


def test_regions_are_connected_and_know_their_rims():
    mesh = grid(12)
    fixed = np.zeros(len(mesh.vertices), bool)
    fixed[surroundings(mesh).boundary] = True
    two = np.array([0, len(mesh.faces) - 1])
    for rings, count in ((2, 2), (40, 1)):
        regions = regions_around(mesh.faces, two, rings, fixed)
        assert len(regions) == count
        chosen = rings_around(mesh.faces, two, rings, len(mesh.vertices))
        assert np.array_equal(np.sort(np.concatenate([r.face_ids for r in regions])), np.flatnonzero(chosen))
        for region in regions:
            assert np.array_equal(region.vertex_ids[region.faces], mesh.faces[region.face_ids])
            outside = np.setdiff1d(np.arange(len(mesh.faces)), region.face_ids)
            rim = np.isin(region.vertex_ids, mesh.faces[outside]) | fixed[region.vertex_ids]
            assert np.array_equal(region.held, rim)


# the whole run


def stretched(seed, jitter, stretch, noise):
    flat = grid(14, jitter=jitter, seed=seed)
    vertices = flat.vertices * [stretch, 1, 1]
    vertices[:, 2] = np.random.default_rng(seed).normal(size=len(vertices)) * noise
    return Mesh(vertices, flat.faces)


@pytest.mark.parametrize(
    ("mesh", "target", "method"),
    [
        (stretched(9, 0.45, 5, 0.02), "disk", "relax"),
        (stretched(0, 0.45, 1, 0.06), "free", "compose"),
        (stretched(6, 0.3, 1, 0.06), "disk", "average"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_each_tier_is_needed_somewhere_and_its_absence_is_reported(mesh, target, method):
    tiers = REPAIRS[: REPAIRS.index(method) + 1]
    result = pgcp.parameterize(mesh, patches=1, target=target, repairs=tiers, seams="exact")
    last = result.report["repairs"][-1]
    assert (last["method"], last["folds_after"]) == (method, 0)
    assert result.quality.folds == 0
    with pytest.raises(FoldError, match=r"folded faces of (392|364|384): face") as caught:
        pgcp.parameterize(mesh, patches=1, target=target, repairs=tiers[:-1], seams="exact")
    report = caught.value.result.report
    assert {r["method"] for r in report["repairs"]} == set(tiers[:-1])
    assert report["status"] == "folded"
    assert ("repairs tried: none" in str(caught.value)) == (not tiers[:-1])


def scrambled(_mesh, _parts, space):
    if space is not SPHERE:
        raise SolveFailedError("made to fail")
    points = np.random.default_rng(0).normal(size=(len(_mesh.vertices), 3))
    return points / np.linalg.norm(points, axis=1)[:, None], np.zeros(len(_mesh.faces), complex)


def test_the_last_tier_takes_away_what_no_other_does(monkeypatch):
    monkeypatch.setattr(stored, "collect", scrambled)
    monkeypatch.setattr(course, "may_be_solved_in_logarithms", lambda *_: False)
    mesh = icosphere(3)
    result = pgcp.parameterize(mesh, patches=3)
    assert result.quality.folds == 0
    assert result.quality.degree == pytest.approx(1.0)
    assert result.report["fallback"]["to"] == "sphere (embedding)"
    assert [r["route"] for r in result.report["retries"]] == [0.0, 1.0, "exact", 0.0]
    with pytest.raises(FoldError, match=r"untangle \(to \d+\) of \d+$"):
        pgcp.parameterize(mesh, patches=3, repairs=REPAIRS[:-1])


def test_a_free_map_that_stays_folded_gives_way_to_the_disk(monkeypatch):
    def mirrored(run, *rest):
        points, mu = stored.gathered(run, *rest)
        return (points.conj() if run.target.name == "free" else points), mu

    for module in (welds, whole_mesh):
        monkeypatch.setattr(module, "gathered", mirrored)
    monkeypatch.setattr(course, "may_be_solved_in_logarithms", lambda *_: False)
    result = pgcp.parameterize(stretched(0, 0.2, 1, 0.02), patches=2, target="free")
    assert (result.target, result.quality.folds) == ("disk", 0)
    assert re.fullmatch(r"38\d folds are left", result.report["fallback"]["reason"])


def test_a_needle_is_mapped_or_embedded_in_logarithms_and_not_without_the_last_repair():
    mesh, _ = spheroid(3, 300.0)
    result = pgcp.parameterize(mesh, patches=4)
    assert (result.target, result.quality.folds) == ("sphere", 0)
    assert result.quality.degree == pytest.approx(1.0)
    assert result.report["fallback"] is None or result.report["fallback"]["to"] == "sphere (embedding)"
    assert result.report["logarithms"]["range"] > 1.0
    assert np.abs(result.mu).max() < 1.0 + 1e-12
    with pytest.raises((WeldFailedError, FoldError)):
        pgcp.parameterize(mesh, patches=4, repairs=REPAIRS[:-1])


def test_an_open_surface_whose_welds_all_fail_is_embedded_in_the_disk(monkeypatch):
    def fail(*_):
        raise WeldFailedError("made to fail")

    monkeypatch.setattr(welds, "weld", fail)
    monkeypatch.setattr(whole_mesh, "eliminated", fail)
    monkeypatch.setattr(course, "may_be_solved_in_logarithms", lambda *_: False)
    mesh = stretched(0, 0.3, 2, 0.05)
    for target in ("free", "disk"):
        result = pgcp.parameterize(mesh, patches=3, target=target)
        assert (result.target, result.quality.folds) == ("disk", 0)
        assert result.report["fallback"] == {"from": target, "to": "disk (embedding)", "reason": "made to fail"}
        assert len(result.report["patches"]) == 1


@pytest.mark.parametrize("size", [1.0, 1e-120, 1e-160, 1e-250])
def test_stars_of_any_size_are_untangled(size):
    """In long thin parts areas are less than the least number that doubles hold."""
    ring = np.exp(2j * np.pi * np.arange(5) / 5) * size
    place = _better_place(complex(1.2 * size), ring, np.roll(ring, -1), np.ones(5))
    assert place is not None
    assert abs(place) < 0.9 * size


def test_untangling_ends_after_so_many_moves(monkeypatch):
    """Around a vertex of thousands of faces each move is dear."""
    mesh, _, z = folded_map(count=1)
    here, calls = surroundings(mesh), []
    monkeypatch.setattr("pgcp.folds.untangle._MOST_ROWS", 3 * 420)
    monkeypatch.setattr("pgcp.folds.untangle._move_in_plane", lambda *_: calls.append(1))
    repair_folds(here, z, ("untangle",))
    assert len(calls) == 3


def test_a_face_that_is_a_point_has_some_shape():
    corners = _deformed(np.zeros((3, 3)), np.array([[0, 1, 2]]), np.array([0.3 + 0.1j]))
    assert np.isfinite(corners).all()
    assert np.imag(np.conj(corners[0, 1] - corners[0, 0]) * (corners[0, 2] - corners[0, 0])) > 0
