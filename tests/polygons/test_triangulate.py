"""Polygons are cut into triangles that fill them, and put together again as they were."""

from __future__ import annotations

import numpy as np
import pytest

from pgcp.errors import BadFileError
from pgcp.polygons.together import polygons_of
from pgcp.polygons.triangulate import triangulated
from pgcp.types import Source


def source(points, *polygons):
    return Source(np.array(points, float), np.concatenate(polygons), np.append(0, np.cumsum([len(p) for p in polygons])))


def star(n, seed=0):
    """A polygon that is seen whole from the middle, in some plane of space."""
    rng = np.random.default_rng(seed)
    angle, radius = np.sort(rng.uniform(0, 2 * np.pi, n)), rng.uniform(0.3, 1.0, n)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(n)]) @ turn + 5.0


def areas(points, faces, normal):
    a, b, c = (points[faces[:, i]] for i in range(3))
    return 0.5 * np.cross(b - a, c - a) @ normal


def newell(points):
    around = points - points.mean(axis=0)
    return np.cross(around, np.roll(around, -1, axis=0)).sum(axis=0)


@pytest.mark.parametrize("n", [4, 5, 7, 12, 40, 200])
def test_ears_fill_a_concave_polygon(n):
    points = star(n, n)
    cut = triangulated(source(points, np.arange(n)))
    total = newell(points)
    size = np.linalg.norm(total)
    each = areas(points, cut.mesh.faces, total / size)
    assert len(each) == n - 2
    assert each.min() > 0.0
    assert each.sum() == pytest.approx(0.5 * size, rel=1e-12)


def test_many_polygons_of_a_size_are_cut_at_once():
    points = np.vstack([star(9, seed) for seed in range(50)])
    cut = triangulated(source(points, *(np.arange(9) + 9 * k for k in range(50))))
    for k in range(50):
        mine = cut.mesh.faces[7 * k : 7 * k + 7]
        assert (mine // 9 == k).all()
        total = newell(points[9 * k : 9 * k + 9])
        assert areas(points, mine, total).min() > 0.0


SQUARE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
QUADS = {
    "square": (SQUARE, {0, 2}, []),
    "the shorter diagonal": ([[0, 0, 0], [1, 0, 0], [3, 2, 0], [0, 1, 0]], {1, 3}, []),
    "concave": ([[0, 0, 0], [2, 0, 0], [0.5, 0.5, 0], [0, 2, 0]], {0, 2}, []),
    "a corner on a side": ([[0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 0]], {1, 3}, []),
    "warped": ([[0, 0, 0], [1, 0, 1], [1, 1, 0], [0, 1, 1]], {0, 2}, ["warped"]),
    "without area": ([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], None, ["degenerate"]),
}


@pytest.mark.parametrize("name", QUADS)
def test_quads(name):
    points, diagonal, said = QUADS[name]
    cut = triangulated(source(points, np.arange(4)))
    one, two = (set(face) for face in cut.mesh.faces.tolist())
    assert diagonal is None or one & two == diagonal
    assert [note["step"] for note in cut.notes] == ["triangulate", *said]


def test_two_quads_with_three_vertices_in_common_get_no_edge_twice():
    """Both would be cut along the shorter diagonal, which is one edge: it would have four faces."""
    points = [[0, 0, 0], [1, 0, 0], [0.5, 0.5, 0.1], [0.5, 2, 0.5], [0.5, 2, -0.5]]
    cut = triangulated(source(points, [0, 2, 1, 3], [0, 4, 1, 2]))
    ends = np.sort(np.stack([cut.mesh.faces, np.roll(cut.mesh.faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    assert np.unique(ends, axis=0, return_counts=True)[1].max() <= 2


BAD = {
    "two corners": ([[0, 1]], "face 1 has 2 corners"),
    "a vertex twice": ([[0, 1, 2, 1]], "face 1 has vertex 1 at two of its corners"),
    "a vertex that is not there": ([[0, 1, 2, 9]], "face 1 uses vertex 9, but the mesh has vertices 0 to 3"),
    "crossed": ([[0, 2, 1, 3]], "face 1 crosses itself"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_polygon_is_refused_with_its_number(name):
    polygons, words = BAD[name]
    points = [*SQUARE[:3], [0, 2, 0]]
    with pytest.raises(BadFileError, match=words):
        triangulated(source(points, [0, 1, 2, 3], *polygons))


def mixed():
    points = np.vstack([star(5), star(4, 1), star(3, 2), star(8, 3)])
    return source(points, np.arange(5), 5 + np.arange(4), 9 + np.arange(3), 12 + np.arange(8))


@pytest.mark.parametrize("turned", [False, True])
def test_polygons_come_back_as_they_were(turned):
    given = mixed()
    cut = triangulated(given)
    order = [0, 2, 1] if turned else [0, 1, 2]
    back = polygons_of(cut.mesh.faces[:, order], cut.corner_of[:, order], given.offsets)
    corners = cut.mesh.faces[:, order].reshape(-1)[back.corner_at]
    assert np.array_equal(back.offsets, given.offsets)
    assert np.array_equal(back.polygon_of, np.arange(4))
    for begin, end in zip(given.offsets[:-1], given.offsets[1:], strict=True):
        mine = given.corners[begin:end]
        assert corners[begin:end].tolist() == (np.roll(mine[::-1], 1) if turned else mine).tolist()


def test_a_polygon_that_is_no_longer_whole_comes_back_as_triangles():
    given = mixed()
    cut = triangulated(given)
    kept = np.delete(np.arange(len(cut.mesh.faces)), [1])  # of the first polygon
    back = polygons_of(cut.mesh.faces[kept], cut.corner_of[kept], given.offsets)
    assert np.diff(back.offsets).tolist() == [3, 3, 4, 3, 8]
    assert back.polygon_of.tolist() == [0, 0, 1, 2, 3]
    faces = cut.mesh.faces[kept].copy()
    faces[2, 1] = 0  # split off a triangle of the second polygon
    assert 4 not in np.diff(polygons_of(faces, cut.corner_of[kept], given.offsets).offsets)
