"""Fixing a mesh on request: each step where it is the one that is needed, and what comes out lines up with what went in."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from meshes import grid, icosphere, lifted, lines_up, spheroid
from said import without_progress

import pgcp
from pgcp.errors import InputError
from pgcp.finish.quality import measure_quality
from pgcp.intake.holes import fill_loops, triangulate_loop
from pgcp.intake.manifold import cut_edges
from pgcp.intake.mend import mend
from pgcp.plane.space import PLANE
from pgcp.surface.beltrami import folded_faces
from pgcp.surface.operators import face_areas
from pgcp.surface.topology import NON_MANIFOLD, examine, pair_half_edges
from pgcp.targets.fitting import Asked
from pgcp.types import Mesh

HILLS = lifted(grid(12, jitter=0.2))


def without(mesh, centres):
    """The mesh without all faces around some vertices."""
    return Mesh(mesh.vertices, mesh.faces[~np.isin(mesh.faces, centres).any(axis=1)], mesh.name)


def vertex_at(mesh, x, y):
    return int(np.argmin(np.hypot(mesh.vertices[:, 0] - x, mesh.vertices[:, 1] - y)))


def pinched():
    """Hills, two distant vertices of whose boundary are one: a loop that meets itself."""
    a, b = vertex_at(HILLS, 0.5, 0), vertex_at(HILLS, 0.5, 1)
    faces = np.where(HILLS.faces == b, a, HILLS.faces)
    return Mesh(HILLS.vertices, faces)


def unwelded(cut=0.45):
    """Hills in two halves that share no vertex: those of the right are listed again."""
    right = HILLS.vertices[HILLS.faces].mean(axis=1)[:, 0] > cut
    faces = HILLS.faces + np.where(right, len(HILLS.vertices), 0)[:, None]
    return Mesh(np.vstack([HILLS.vertices, HILLS.vertices]), faces)


def fin():
    a, b, _ = HILLS.faces[140]
    tip = HILLS.vertices[[a, b]].mean(axis=0) + np.array([0, 0, 0.3])
    return Mesh(np.vstack([HILLS.vertices, tip]), np.vstack([HILLS.faces[:200], [[a, b, 169]], HILLS.faces[200:]]))


def some_turned():
    faces = HILLS.faces.copy()
    faces[::5] = faces[::5, ::-1]
    return Mesh(HILLS.vertices, faces)


def with_island():
    island = grid(3)
    vertices = np.vstack([island.vertices + 5.0, HILLS.vertices])
    return Mesh(vertices, np.vstack([island.faces, HILLS.faces + len(island.vertices)]))


def repeated():
    a, b, c = HILLS.faces[100]
    return Mesh(HILLS.vertices, np.vstack([[[a, b, a]], HILLS.faces, [[c, c, c], [b, c, a], [b, a, c]]]))


# the mesh, the words it is refused with, the steps taken, faces that are left
CASES = {
    "drop": (repeated(), "2 faces use a vertex twice.*; --fix would drop 4 faces", ["drop"], 288),
    "weld": (unwelded(), "", ["weld"], 288),
    "cut": (fin(), "more than two faces.*; --fix would cut 1 edge", ["cut", "keep"], 288),
    "split": (pinched(), "non-manifold.*; --fix would split 1 vertex", ["split"], 288),
    "keep": (with_island(), "", ["keep"], 288),
    "turn": (some_turned(), "disagree in orientation.*; --fix would turn 58 faces to agree", ["turn"], 288),
    "fill": (without(HILLS, [84]), "2 boundary loops.*; --fix would fill 1 hole", ["fill"], None),
}


@pytest.mark.parametrize("name", CASES)
def test_each_step_is_named_where_it_is_needed_and_mends_the_mesh(name):
    mesh, words, steps, left = CASES[name]
    if words:
        with pytest.raises(InputError, match=words):
            pgcp.parameterize(mesh, patches=3, weld_distance=None)
    result = pgcp.parameterize(mesh, patches=3, fix=True, weld_distance=None)
    assert [fix["step"] for fix in result.report["fixes"]] == steps
    assert all(fix["count"] > 0 and fix["message"] for fix in result.report["fixes"])
    assert len(result.mesh.faces) == (left or len(mesh.faces))
    assert result.quality.folds == 0
    lines_up(mesh, result)
    assert np.isfinite(result.coordinates).all()


@pytest.mark.parametrize("name", [n for n in CASES if n not in ("fill", "split")])
def test_what_is_mended_is_mapped_as_the_sound_mesh_is(name):
    result = pgcp.parameterize(CASES[name][0], patches=1, fix=True)
    sound = pgcp.parameterize(HILLS, patches=1)
    sides = []
    for r in (result, sound):
        a, b, c = (r.coordinates[r.mesh.faces[:, i]] for i in range(3))
        lengths = np.sort([np.linalg.norm(p - q, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
        sides.append(lengths[:, np.lexsort(lengths)])
    assert np.abs(sides[0] - sides[1]).max() < 1e-8


def test_a_mesh_that_fits_is_left_alone(hills):
    plain = pgcp.parameterize(hills, patches=4)
    fixed = pgcp.parameterize(hills, patches=4, fix=True)
    assert plain.coordinates.tobytes() == fixed.coordinates.tobytes()
    assert (plain.report["fixes"], fixed.report["fixes"]) == ([], [])
    assert plain.vertex_of is None
    assert plain.face_of is None
    assert np.array_equal(fixed.vertex_of, np.arange(len(hills.vertices)))
    assert np.array_equal(fixed.face_of, np.arange(len(hills.faces)))


def messy():
    """All at once: halves that share no vertex, a fin, doubled and degenerate faces, turned faces, holes, an island."""
    mesh = unwelded()
    faces = without(mesh, [30, len(HILLS.vertices) + 120]).faces
    a, b, c = faces[60]
    tip, far = len(mesh.vertices), grid(2)
    vertices = np.vstack([mesh.vertices, mesh.vertices[a] + [0, 0, 0.2], far.vertices - 3.0, [[np.pi, 0, 0]]])
    extra = [[a, b, tip], [c, b, a], [a, a, b]]
    faces = np.vstack([faces, extra, far.faces + tip + 1])
    faces[::7] = faces[::7, ::-1]
    return Mesh(vertices, np.random.default_rng(0).permutation(faces), "messy")


def test_everything_at_once():
    mesh = messy()
    result = pgcp.parameterize(mesh, patches=3, fix=True, weld_distance=None)
    assert [fix["step"] for fix in result.report["fixes"]] == ["drop", "weld", "cut", "keep", "turn", "fill"]
    assert result.quality.folds == 0
    lines_up(mesh, result)
    sound = without(HILLS, [30, 120])
    assert len(result.mesh.faces) == len(sound.faces)
    topology = examine(result.mesh.faces, len(result.mesh.vertices))
    assert (topology.component_count, topology.genus, len(topology.loops)) == (1, 0, 3)
    assert topology.unreferenced_count == examine(mesh.faces, len(mesh.vertices)).unreferenced_count


@pytest.mark.parametrize("name", [*CASES, "messy"])
def test_fixing_what_is_fixed_does_nothing(name):
    once = mend(messy() if name == "messy" else CASES[name][0])
    again = mend(once.mesh)
    assert again.fixes == ()
    assert len(again.face_of) == len(once.face_of)
    assert again.mesh is once.mesh
    bare = mend(once.mesh.bare)
    assert {fix.step for fix in bare.fixes} <= {"fill"}
    assert np.array_equal(bare.mesh.faces, once.mesh.faces)
    assert np.array_equal(bare.vertex_of, np.arange(len(once.mesh.vertices)))
    assert np.array_equal(bare.face_of, np.arange(len(once.face_of)))


soups = st.integers(4, 9).flatmap(
    lambda n: st.tuples(
        st.lists(st.tuples(*[st.integers(0, n - 1)] * 3), min_size=1, max_size=24),
        st.lists(st.tuples(*[st.integers(0, 2)] * 3), min_size=n, max_size=n),
    )
)


def helps(mended, closed):
    """Whether what was mended can be mapped: the right surface, half of its faces with an area, no pillow."""
    bare = mended.mesh.bare
    solid = (face_areas(bare.vertices, bare.faces) > 0).sum() * 2 >= len(bare.faces)
    pillow = mended.topology.is_sphere and len(mended.mesh.faces) == 2
    return bool(mended.topology.fits(closed) and mended.fixes and solid and not pillow)


@given(soups, st.sampled_from(["auto", "free", "disk", "sphere"]), st.booleans())
@settings(max_examples=400, deadline=None)
def test_any_soup_becomes_a_manifold_or_is_refused(soup, target, collapses):
    faces, places = soup
    mesh = Mesh(np.array(places, float), np.array(faces))
    before = mesh.faces.copy()
    closed = Asked(target).closed
    try:
        mended = mend(mesh, closed, collapses=collapses)
    except InputError as problem:
        assert "all faces use a vertex twice" in str(problem)
        assert collapses or all(len(set(face)) < 3 for face in faces)
        return
    bare = mended.mesh.bare
    topology = examine(bare.faces, len(bare.vertices))
    assert {defect.kind for defect in topology.defects} <= {"not-orientable"}
    assert topology.component_count == 1
    assert mended.topology.fits(closed) or mended.obstacle or mended.topology.is_sphere or mended.topology.is_disk
    assert np.array_equal(bare.vertices, mesh.vertices[mended.vertex_of])
    given_ids = mended.stands_for[mesh.faces[mended.face_of]]
    assert np.array_equal(np.sort(given_ids, axis=1), np.sort(mended.vertex_of[bare.faces], axis=1))
    assert np.array_equal(mesh.faces, before)
    try:
        pgcp.check_mesh(mesh, target)
    except InputError as problem:
        named = "--fix would" in str(problem)
        assert named or not helps(mended, closed) or collapses
        if named:
            assert helps(mended, closed) or helps(mend(mesh, closed, collapses=not collapses), closed)


# edges of more than two faces


def pages(*angles):
    """Square pages that share one side as their spine, page k raised by its angle, a function of the place on the spine."""
    page = grid(8)
    x, y, _ = page.vertices.T
    spine = np.flatnonzero(x == 0)
    vertices = np.vstack([np.column_stack([x * np.cos(angle(y)), y, x * np.sin(angle(y))]) for angle in angles])
    name = np.arange(len(vertices))
    for k in range(1, len(angles)):
        name[81 * k + spine] = spine
    return vertices, [name[page.faces + 81 * k] for k in range(len(angles))]


def test_sheets_along_a_spine_come_apart_in_one_way_all_along_it():
    """Three pages: the two that continue each other best on the whole stay joined, also where the third is flatter."""
    vertices, (one, two, three) = pages(lambda y: 0 * y, lambda y: 2.8 + 0 * y, lambda y: np.where(y < 0.3, 3.1, 1.3))
    mended = mend(Mesh(vertices, np.vstack([one, two[:, ::-1], three[:, ::-1]])))
    assert [fix.step for fix in mended.fixes] == ["cut", "keep"]
    assert mended.fixes[0].count == 8
    assert mended.topology.is_disk
    assert np.array_equal(mended.face_of, np.arange(256))


def test_sheets_that_agree_in_orientation_stay_joined_rather_than_flatter_ones():
    """Four pages, the flattest pairs of which face opposite ways: no face is turned."""
    vertices, parts = pages(*(lambda y, a=a: a + 0 * y for a in np.radians([0, 100, 180, 280])))
    mended = mend(Mesh(vertices, np.vstack([part[:, :: 1 - 2 * (k % 2)] for k, part in enumerate(parts)])))
    assert [fix.step for fix in mended.fixes] == ["cut", "keep"]
    assert set((mended.face_of // 128).tolist()) in ({0, 1}, {2, 3})


def test_a_cut_makes_no_one_sided_surface():
    """A Moebius band across one edge of which another sheet passes: it is opened there, though its ends continue each other."""
    n = 24
    t = np.pi * np.arange(n) / n
    across = np.column_stack([np.cos(2 * t) * np.cos(t), np.sin(2 * t) * np.cos(t), np.sin(t)])
    ring = np.column_stack([np.cos(2 * t), np.sin(2 * t), 0 * t])
    vertices = np.vstack([ring - 0.2 * across, ring + 0.2 * across])
    i = np.arange(n)
    last = i == n - 1
    left, right = np.where(last, n, i + 1), np.where(last, 0, i + 1 + n)
    band = np.concatenate([np.column_stack([i, left, i + n]), np.column_stack([i + n, left, right])])
    assert "not orientable" in examine(band, 2 * n).defects[0].message
    edge, out = [0, n], np.array([[1.0, 0, 2.0], [1.0, 0, -2.0]])
    cross = [[*edge, 2 * n], [*edge[::-1], 2 * n + 1]]
    mended = mend(Mesh(np.vstack([vertices, out]), np.vstack([band, cross])))
    assert mended.fixes[0].step == "cut"
    assert mended.topology.is_disk
    assert len(mended.face_of) >= len(band)


def test_a_cut_whose_sides_stay_joined_another_way_frees_a_face():
    points = [[0.2, 1.0, 1.5], [-0.7, 0.8, -1.5], [0.6, -1.5, 1.1], [-0.2, -0.1, -1.0], [1.6, 0.2, -1.9], [-1.7, -1.4, 0.1]]
    vertices = np.array(points)
    faces = np.array([[0, 3, 5], [2, 0, 3], [1, 0, 5], [3, 2, 1], [5, 4, 3], [5, 2, 4], [5, 3, 1], [1, 2, 5]])
    cut, vertex_of, _ = cut_edges(vertices, faces, np.arange(6))
    assert np.array_equal(vertex_of[cut], faces)
    assert (pair_half_edges(cut, len(vertex_of)) != NON_MANIFOLD).all()
    assert mend(Mesh(vertices, faces)).topology.component_count == 1


def test_solids_that_share_an_edge_come_apart_whole():
    """Two cubes that touch in an edge: neither is joined to the other, though faces of both continue each other."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    cube = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    vertices = np.vstack([corners, corners - [1, 1, 0]])
    faces = np.vstack([cube, cube + 8])
    faces = np.where(faces == 14, 0, np.where(faces == 15, 1, faces))
    mended = mend(Mesh(vertices, faces))
    assert [fix.step for fix in mended.fixes] == ["cut", "keep"]
    assert mended.topology.is_sphere
    assert len(mended.face_of) == 12
    assert len(np.unique(mended.face_of // 12)) == 1


@pytest.mark.parametrize("faces", [3, 40])
def test_many_faces_on_one_edge(faces):
    angle = 2 * np.pi * np.arange(faces) / faces
    tips = np.column_stack([np.cos(angle), np.sin(angle), np.full(faces, 0.5)])
    mesh = Mesh(np.vstack([[[0, 0, 0], [0, 0, 1]], tips]), np.array([[0, 1, 2 + i] for i in range(faces)]))
    mended = mend(mesh)
    assert mended.fixes[0].what == "1 edge of more than two faces"
    assert mended.topology.is_disk


# welding


def test_vertices_that_coincide_stay_apart_where_nothing_is_lost_by_it():
    """A slit along the middle, open at one end, of a surface whose only defect is a fin."""
    middle = [vertex_at(HILLS, x / 12, 0.5) for x in range(5)]
    faces = HILLS.faces.copy()
    upper = HILLS.vertices[faces].mean(axis=1)[:, 1] > 0.5
    for k, vertex in enumerate(middle[:-1]):
        moved = (faces == vertex) & upper[:, None]
        faces[moved] = len(HILLS.vertices) + k
    vertices = np.vstack([HILLS.vertices, HILLS.vertices[middle[:-1]]])
    slit = Mesh(vertices, faces)
    assert examine(slit.faces, len(vertices)).is_disk
    a, b, _ = HILLS.faces[5]
    fin_too = Mesh(np.vstack([vertices, [0, 0, 9.0]]), np.vstack([faces, [a, b, len(vertices)]]))
    mended = mend(fin_too)
    assert "weld" not in [fix.step for fix in mended.fixes]
    assert np.array_equal(mended.mesh.faces, faces)


def test_soup_is_welded_and_zeros_of_either_sign_are_one():
    soup = HILLS.vertices[HILLS.faces].reshape(-1, 3).copy()
    soup[::2][soup[::2] == 0] = -0.0
    mesh = Mesh(soup, np.arange(len(soup)).reshape(-1, 3))
    mended = mend(mesh)
    assert [fix.step for fix in mended.fixes] == ["weld"]
    assert mended.topology.is_disk
    assert len(mended.mesh.vertices) == len(HILLS.vertices)


def test_a_surface_listed_twice_is_kept_once():
    """With vertices of its own, and turned over or not."""
    for again in (HILLS.faces, HILLS.faces[:, ::-1]):
        mesh = Mesh(np.vstack([HILLS.vertices] * 2), np.vstack([HILLS.faces, again + len(HILLS.vertices)]))
        mended = mend(mesh)
        assert np.array_equal(mended.mesh.faces, HILLS.faces)
        assert mended.topology.is_disk


# holes


def polygon(n, depth=0.0):
    angle = 2 * np.pi * np.arange(n) / n
    return np.column_stack([np.cos(angle), np.sin(angle), depth * np.cos(3 * angle)])


@pytest.mark.parametrize("n", [3, 4, 5, 12, 60, *(pytest.param(n, marks=pytest.mark.slow) for n in (301, 420))])
def test_a_loop_is_filled_with_as_many_triangles_as_it_takes(n):
    points = polygon(n)
    triangles = triangulate_loop(points, np.zeros((n, n), bool))
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    unique, counts = np.unique(edges, axis=0, return_counts=True)
    ring = np.sort(np.column_stack([np.arange(n), np.roll(np.arange(n), -1)]), axis=1)
    assert len(triangles) == n - 2
    assert np.array_equal(unique[counts == 1], np.unique(ring, axis=0))
    area = 0.5 * n * np.sin(2 * np.pi / n)
    assert face_areas(points, triangles).sum() == pytest.approx(area, rel=1e-9)
    assert len(folded_faces(triangles, points @ [1, 1j, 0])) == 0


def test_the_area_of_a_filling_is_the_least():
    """Against all triangulations of a bent octagon."""
    points = polygon(8, 0.6)

    def triangulations(i, j):
        """All of the corners i to j."""
        if j - i < 2:
            return [[]]
        return [[(i, m, j), *a, *b] for m in range(i + 1, j) for a in triangulations(i, m) for b in triangulations(m, j)]

    def cost(triangles):
        """As the filling weighs it, lengths in units of the loop's."""
        p = points / np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1).sum()
        edges = sum(((p[triangles[:, i]] - p[triangles[:, i - 1]]) ** 2).sum() for i in range(3))
        return face_areas(p, triangles).sum() + 0.01 * edges

    every = [cost(np.array(t)) for t in triangulations(0, 7)]
    assert len(every) == 132
    assert cost(triangulate_loop(points, np.zeros((8, 8), bool))) == pytest.approx(min(every), rel=1e-12)


def test_points_in_line_do_not_become_a_face_without_area():
    side = np.linspace(0, 1, 6)[:-1]
    zero = np.zeros(5)
    square = np.vstack([np.column_stack(c) for c in ((side, zero), (zero + 1, side), (1 - side, zero + 1), (zero, 1 - side))])
    points = np.column_stack([square, np.zeros(20)])
    triangles = triangulate_loop(points, np.zeros((20, 20), bool))
    assert face_areas(points, triangles).min() > 1e-3


def test_no_edge_is_used_that_the_mesh_has():
    """A quadrilateral hole, one diagonal of which is an edge elsewhere; with both there is no way."""
    sphere = icosphere(2)
    loop_of = examine(without(sphere, [50]).faces, len(sphere.vertices)).loops[0]
    taken = np.zeros((len(loop_of),) * 2, bool)
    free = triangulate_loop(sphere.vertices[loop_of], taken)
    chords = np.sort(free[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    chords = chords[((chords[:, 1] - chords[:, 0]) % (len(loop_of) - 1)) > 1]
    for i, j in chords:
        taken[i, j] = taken[j, i] = True
        other = triangulate_loop(sphere.vertices[loop_of], taken)
        if other is None:
            break
        edges = np.sort(other[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        assert not taken[edges[:, 0], edges[:, 1]].any()
    square = polygon(4)
    both = np.zeros((4, 4), bool)
    both[0, 2] = both[2, 0] = True
    assert sorted(map(sorted, triangulate_loop(square, both).tolist())) == [[0, 1, 3], [1, 2, 3]]
    both[1, 3] = both[3, 1] = True
    assert triangulate_loop(square, both) is None


def test_a_hole_is_closed_with_the_surface_orientation():
    sphere = icosphere(3)
    open_ = without(sphere, [40, 41, 200])
    loops = list(examine(open_.faces, len(sphere.vertices)).loops)
    filled = fill_loops(sphere.vertices, open_.faces, loops)
    closed = examine(np.vstack([open_.faces, *filled]), len(sphere.vertices))
    assert len(loops) == 3
    assert closed.is_sphere
    assert [len(f) for f in filled] == [len(loop) - 2 for loop in loops]


@pytest.mark.parametrize("target", ["auto", "sphere"])
def test_small_holes_of_a_ball_are_filled_and_it_becomes_a_sphere(target):
    mesh = without(spheroid(3, 1.5)[0], [40, 200, 333])
    result = pgcp.parameterize(mesh, patches=3, target=target, fix=True)
    assert result.target == "sphere"
    assert result.quality.degree == pytest.approx(1.0)
    assert result.quality.folds == 0
    assert np.array_equal(result.mesh.faces, mesh.faces)
    whole = pgcp.parameterize(spheroid(3, 1.5)[0], patches=3)
    assert result.quality.angle_mean_deg < 1.1 * whole.quality.angle_mean_deg
    lines_up(mesh, result)


@pytest.mark.parametrize("target", ["free", "disk"])
def test_the_longest_loop_stays_open_for_the_plane(target):
    mesh = without(spheroid(3, 1.5)[0], [40, 200, 333, 7, *np.unique(spheroid(3, 1.5)[0].faces[:3])])
    loops = examine(mesh.faces, len(mesh.vertices)).loops
    lengths = [np.linalg.norm(mesh.vertices[loop] - mesh.vertices[np.roll(loop, 1)], axis=1).sum() for loop in loops]
    result = pgcp.parameterize(mesh, patches=2, target=target, fix=True)
    assert result.report["fixes"][0]["count"] == len(loops) - 1
    (outer,) = mend(mesh, False).topology.loops
    assert set(outer.tolist()) == set(loops[int(np.argmax(lengths))].tolist())


def test_a_large_hole_is_not_filled():
    ring = without(lifted(grid(20)), [vertex_at(grid(20), x, y) for x in (0.4, 0.5, 0.6) for y in (0.4, 0.5, 0.6)])
    shares = "a flat disk of its length would have"
    with pytest.raises(InputError, match=f"--fix does not fill the hole of 24 edges at vertex 154: {shares} 1. % of"):
        pgcp.parameterize(without(ring, np.flatnonzero(np.abs(ring.vertices[:, :2] - 0.5).max(axis=1) < 0.13)), fix=True)


def test_what_fills_holes_is_in_no_figure_and_no_result():
    mesh = without(HILLS, [84, 40])
    result = pgcp.parameterize(mesh, patches=3, fix=True)
    mended = mend(mesh)
    assert mended.mesh.filler > 0
    assert np.array_equal(result.mesh.faces, mesh.faces)
    assert len(result.mu) == len(result.patch) == len(mesh.faces)
    own = measure_quality(mesh, PLANE, result.coordinates, result.mu)
    for name in ("angle_mean_deg", "angle_sd_deg", "angle_max_deg", "mu_mean", "mu_max", "folds", "log_area_mean"):
        assert getattr(result.quality, name) == pytest.approx(getattr(own, name), rel=1e-9)
    areas = [face_areas(points, mesh.faces).sum() for points in (mesh.vertices, np.pad(result.coordinates, ((0, 0), (0, 1))))]
    assert areas[0] == pytest.approx(areas[1], rel=1e-12)


def test_filler_is_some_of_the_faces():
    for count in (-1, len(HILLS.faces)):
        with pytest.raises(InputError, match=f"{count} of 288 faces cannot be filler"):
            Mesh(HILLS.vertices, HILLS.faces, "hills", count)


def test_a_fold_of_filler_alone_is_no_fold(monkeypatch):
    from pgcp.patches import stored

    mesh = without(HILLS, [84])
    ring = examine(mesh.faces, len(mesh.vertices)).loops[1]
    filler = mend(mesh).mesh.faces[len(mesh.faces) :]
    tip = int(np.flatnonzero([(filler == vertex).sum() == 1 for vertex in ring])[0])
    before, ear, after = (int(ring[(tip + k) % len(ring)]) for k in (-1, 0, 1))
    original = stored.collect

    def bent(whole, parts, target):
        """A vertex of the hole is pulled in across the filler's edge beside it."""
        points, mu = original(whole, parts, target)
        middle = 0.5 * (points[before] + points[after])
        points[ear] = middle + 0.1 * (middle - points[ear])
        assert len(folded_faces(whole.faces, points)) > len(folded_faces(whole.bare.faces, points)) == 0
        return points, mu

    monkeypatch.setattr(stored, "collect", bent)
    result = pgcp.parameterize(mesh, patches=1, fix=True)
    assert result.quality.folds == 0
    assert result.report["repairs"] == []


# real files

MENDED = {
    "cow_nonmanifold_real.off": None,
    "camel_unwelded_bowtie_real.obj": None,
    "unwelded.stl": None,
    "bowtie_two_triangles.ply": "--fix would split 1 vertex",
    "inconsistent_orientation.ply": "--fix would turn 5573 faces",
    "duplicate_faces.ply": "--fix would drop 3 faces",
    "annulus_pinhole.ply": "--fix would fill 1 hole",
    "nonmanifold_edge_fin.ply": "--fix would cut 1 edge",
}
HOPELESS = {
    "far_from_origin.ply": "faces have zero area",
    "moebius.ply": "not orientable",
    "torus_genus1.ply": "genus 1",
    "rocker_arm_genus1_real.ply": "genus 1",
    "collinear.ply": "zero area",
}


@pytest.mark.parametrize("name", MENDED)
def test_defective_files_are_mapped_with_fix(name, mesh_folder):
    path = mesh_folder / "bad" / name
    if MENDED[name] is not None:
        with pytest.raises(InputError, match=MENDED[name]):
            pgcp.parameterize(path)
    result = pgcp.parameterize(path, fix=True)
    assert result.quality.folds == 0
    assert np.isfinite(result.coordinates).all()
    assert (result.report["fixes"] == []) == (MENDED[name] is None)
    lines_up(pgcp.read_mesh(path), result)


@pytest.mark.parametrize("name", HOPELESS)
@pytest.mark.parametrize("fix", [False, True])
def test_files_that_nothing_mends_are_refused_and_no_hope_is_raised(name, fix, mesh_folder):
    with pytest.raises(InputError, match=HOPELESS[name]) as caught:
        pgcp.parameterize(mesh_folder / "bad" / name, fix=fix)
    assert "--fix would" not in str(caught.value)


# the command; its own largest size at the end, which that of the process it is forked from does not count for
WATCHED = """
import sys
from pathlib import Path
from pgcp.cli.main import main
status = main(sys.argv[1:])
print(next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM")))
sys.exit(status)
"""
QUICK = ("annulus_pinhole.ply", "nonmanifold_edge_fin.ply", "moebius.ply")
OTHERS = [pytest.param(name, marks=pytest.mark.slow) for name in (*MENDED, *HOPELESS) if name not in QUICK]


@pytest.mark.parametrize("name", [*QUICK, *OTHERS])
def test_the_command_fixes_files_quickly(name, mesh_folder, tmp_path):
    command = [sys.executable, "-c", WATCHED, mesh_folder / "bad" / name, "--fix", "--output-dir", tmp_path / "out"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stderr is not None
    assert process.stdout is not None
    said = without_progress(process.stderr.read())
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    most = int(process.stdout.read().split()[-2])
    process.stderr.close()
    process.stdout.close()
    assert process.returncode == (0 if name in MENDED else 2), said
    assert said.count("\n") == (0 if name in MENDED else 1)
    assert (tmp_path / "out").exists() == (name in MENDED)
    assert most < 500 * 1024
    assert usage.ru_utime + usage.ru_stime < 8  # seconds of processor time, however busy the machine
