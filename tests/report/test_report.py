from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from meshes import cap, grid, lifted, spheroid
from PIL import Image

import pgcp
from pgcp.report.chart import _legible, linear_axis, log_axis, plain
from pgcp.report.picture import draw
from pgcp.report.raster import _places, _visible, rasterise, view
from pgcp.report.seen import sample_of, view_rotation
from pgcp.report.shade import _darkness, _mercator, in_colours, lit, vertex_shapes


def picture_of(result):
    return np.asarray(Image.open(io.BytesIO(draw(result))).convert("RGB")) / 255.0


def test_every_pixel_of_a_square_shows_the_face_it_lies_in():
    mesh = grid(5)
    screen = mesh.vertices * [90, 90, 1] + [5, 5, 0]
    seen = _visible(screen, mesh.faces, 100)
    inside = seen[6:94, 6:94]
    assert (inside >= 0).all()
    assert (seen[:4] == -1).all()
    rows, columns = np.nonzero(seen >= 0)
    face_ids, weights = _places(screen, mesh.faces, seen)
    assert np.array_equal(face_ids, seen[rows, columns])
    place = np.einsum("mk,mkd->md", weights, screen[mesh.faces[face_ids]])
    assert np.abs(place[:, 0] - columns).max() < 1e-9
    assert np.abs(place[:, 1] - rows).max() < 1e-9


def test_the_nearer_face_hides_the_farther_one():
    screen = np.array([[0.0, 0, 0], [40, 0, 0], [0, 40, 0], [0, 0, 5], [40, 0, 5], [0, 40, 5]])
    for order in ([[0, 1, 2], [3, 4, 5]], [[3, 4, 5], [0, 1, 2]]):
        seen = _visible(screen, np.array(order), 41)
        assert set(np.unique(seen)) == {-1, order.index([3, 4, 5])}


def test_every_pixel_shows_the_highest_of_many_faces():
    rng = np.random.default_rng(5)
    screen = (rng.uniform(10, 49, (300, 1, 3)) + rng.uniform(-10, 10, (300, 3, 3))).reshape(-1, 3)
    faces = rng.permutation(np.arange(900).reshape(-1, 3)).astype(np.int32)
    seen = _visible(screen, faces, 60)
    rows, columns = np.indices((60, 60))
    highest = np.full((60, 60), -np.inf)
    wanted = np.full((60, 60), -1)
    for f, (a, b, c) in enumerate(screen[faces]):
        # weights from the 3 x 3 system (x, y, 1) = sum of weights times corners
        system = np.array([[a[0], b[0], c[0]], [a[1], b[1], c[1]], [1, 1, 1]])
        weights = np.einsum("ij,jrc->irc", np.linalg.inv(system), np.array([columns, rows, np.ones((60, 60))]))
        z = np.einsum("i,irc->rc", [a[2], b[2], c[2]], weights)
        nearer = (weights.min(axis=0) >= 0) & (z > highest)
        wanted[nearer], highest[nearer] = f, z[nearer]
    assert (wanted >= 0).mean() > 0.6
    assert (seen == wanted)[wanted >= 0].mean() > 0.999


def test_faces_between_pixels_show_where_they_are():
    screen = np.array([[4.1, 4.1, 0], [4.3, 4.1, 0], [4.1, 4.3, 0], [7.6, 2.6, 0], [7.8, 2.6, 0], [7.6, 2.8, 0]])
    seen = _visible(screen, np.array([[0, 1, 2], [3, 4, 5]]), 10)
    assert [tuple(place) for place in np.argwhere(seen >= 0)] == [(3, 8), (4, 4)]
    assert np.allclose(_places(screen, np.array([[0, 1, 2], [3, 4, 5]]), seen)[1], 1 / 3)


def test_a_surface_of_tiny_faces_has_no_holes():
    mesh, _ = cap(400)
    image = rasterise(view(mesh.vertices, mesh.faces), lambda ids, _: np.zeros((len(ids), 3)))
    dark = image.sum(axis=2) == 0
    radius = np.hypot(*(np.indices(dark.shape) - (len(dark) - 1) / 2))
    assert dark[radius < 0.48 * len(dark)].all()


def test_the_picture_shows_all_patches_and_is_the_same_every_time():
    result = pgcp.parameterize(grid(12), patches=4)
    one = draw(result)
    assert one == draw(result)
    picture = picture_of(result)
    third = picture.shape[1] // 3
    middle = picture[: picture.shape[0] // 2, third : 2 * third, :3].reshape(-1, 3)
    colours, counts = np.unique(np.round(middle, 2), axis=0, return_counts=True)
    assert (counts[colours.max(axis=1) - colours.min(axis=1) > 0.1] > 0.02 * len(middle)).sum() == 4


def panel(picture, row, column):
    """One of the six panels, without its caption."""
    height, width = (picture.shape[0] - 38) // 2, picture.shape[1] // 3
    return picture[38 + row * height + 30 : 38 + (row + 1) * height, column * width : (column + 1) * width]


def test_the_picture_of_a_sphere_shows_both_sides_with_the_checkerboard():
    mesh, _ = spheroid(4, 2.0)
    image = picture_of(pgcp.parameterize(mesh, patches=3))
    for column in (1, 2):
        seen = panel(image, 0, column)
        blue, light = seen[..., 2] - seen[..., 0] > 0.2, seen[..., 0] - seen[..., 2] > 0.03
        round_share = np.pi / 4 * 500**2 / blue.size
        assert 0.3 < blue.mean() / round_share < 0.6
        assert 0.3 < light.mean() / round_share < 0.6


def test_colours_say_where_angles_err():
    """A map that is sheared in one half only is coloured there and pale in the other."""
    mesh = grid(24)
    image = mesh.vertices[:, :2].copy()
    image[:, 1] += 0.5 * np.maximum(image[:, 0] - 0.5, 0)
    errors = pgcp.surface.distortion.angle_errors(mesh, image)
    quality = pgcp.Quality(*[float(errors.max())] * 7, 0, 0.0)
    result = pgcp.Parameterization(mesh, image, np.zeros(len(mesh.faces), int), np.zeros(len(mesh.faces)), quality, "free")
    seen = panel(picture_of(result), 0, 2)[:430]
    colour = seen[..., 0] - seen[..., 2] > 0.2
    columns = np.flatnonzero((seen < 0.99).any(axis=(0, 2)))
    middle = (columns[0] + columns[-1]) // 2
    assert colour[:, middle + 5 : columns[-1] - 5].mean() > 0.7
    assert colour[:, columns[0] + 5 : middle - 5].mean() < 0.01


def test_colours_say_where_areas_grow():
    mesh = grid(24)
    image = mesh.vertices[:, :2] * 3.0
    image[:, 0] = np.where(image[:, 0] > 1.5, 1.5 + 4 * (image[:, 0] - 1.5), image[:, 0])
    quality = pgcp.Quality(*[1.0] * 7, 0, 0.0)
    result = pgcp.Parameterization(mesh, image, np.zeros(len(mesh.faces), int), np.zeros(len(mesh.faces)), quality, "free")
    seen = panel(picture_of(result), 1, 0)[:430]
    columns = np.flatnonzero((seen < 0.99).any(axis=(0, 2)))
    middle = (columns[0] + columns[-1]) // 2
    left, right = seen[200, (columns[0] + middle) // 2], seen[200, (columns[-1] + middle) // 2]
    assert (left[2] - left[0]) - (right[2] - right[0]) > 0.2


def test_squares_fade_into_those_of_twice_their_size():
    """No step of the scale changes the checkerboard abruptly, and at whole steps its squares are plain."""
    scales = np.linspace(-4, 0, 4001)
    for u, v in np.random.default_rng(0).uniform(-5, 5, (50, 2)):
        darkness = np.array([_darkness(u, v, scale) for scale in scales])
        assert np.abs(np.diff(darkness)).max() < 0.01
        assert set(darkness[::1000]) <= {0.0, 1.0}


def test_brightness_does_not_depend_on_the_side_and_is_even_over_faces():
    mesh = grid(2)
    shapes = vertex_shapes(mesh.vertices, mesh.faces, mesh.vertices[:, :2], (1.0, 1.0))
    lights = np.array([[0.0, 0.6, 0.8], [0.0, 0.0, 1.0]])
    ids, weights = np.arange(len(mesh.faces)), np.full((len(mesh.faces), 3), 1 / 3)
    one = lit(ids, weights, mesh.faces, shapes, lights)
    shapes[:, :3] *= -1
    assert np.allclose(one, lit(ids, weights, mesh.faces, shapes, lights))
    assert np.ptp(one, axis=0).max() < 1e-6
    assert one[0, 0] == pytest.approx(0.42 + 0.48 * 0.8 + 0.14)


def test_colours_lie_between_their_stops():
    stops = ((0.0, 0.0, 0.0), (1.0, 0.5, 0.0))
    assert np.allclose(in_colours(np.array([-1, 0, 0.5, 1, 2]), stops), [[0, 0, 0]] * 2 + [[0.5, 0.25, 0]] + [[1, 0.5, 0]] * 2)


def test_the_checkerboard_of_a_sphere_has_even_squares_of_one_size():
    """On the round sphere near the equator: equal shares of dark and light, and no break where the turn closes."""
    angle = np.linspace(-np.pi, np.pi, 4001)[:-1]
    size = np.log2(2 * np.pi / 32)
    dark = np.array([_darkness(*_mercator(np.cos(turn), np.sin(turn), 0.1, size)) for turn in angle]) > 0.5
    runs = np.flatnonzero(dark != np.roll(dark, 1))
    assert len(runs) == 32
    assert np.ptp(np.diff(runs)) <= 2
    assert (runs[0] + 4000 - runs[-1]) - np.diff(runs)[0] <= 2


def test_vertices_know_their_normal_and_the_scale_of_the_map():
    mesh = grid(5)
    image = mesh.vertices[:, :2] * 8.0
    for factor in (1.0, 2.0**-600, 2.0**600):
        shapes = vertex_shapes(mesh.vertices * factor, mesh.faces, image * factor, (factor, factor))
        assert np.allclose(shapes[:, :4], [0.0, 0.0, 1.0, 3.0], atol=1e-6)


def test_the_view_does_not_depend_on_unit_or_place_and_shows_the_outside():
    mesh = lifted(grid(12, 9))
    rotation = view_rotation(mesh.vertices, mesh.faces)
    assert np.allclose(rotation @ rotation.T, np.eye(3))
    assert rotation[2, 2] > 0.7
    assert np.allclose(view_rotation(2.0**400 * (mesh.vertices + 5.0), mesh.faces), rotation, atol=1e-9)
    assert view_rotation(mesh.vertices, mesh.faces[:, ::-1])[2, 2] < -0.7
    ball, _ = spheroid(4, 0.5)
    order = np.random.default_rng(2).permutation(len(ball.faces))
    assert np.allclose(view_rotation(ball.vertices, ball.faces[order]), view_rotation(ball.vertices, ball.faces), atol=1e-9)


@pytest.mark.parametrize("normal", np.eye(3))
def test_one_face_is_looked_at_from_its_flat_side(normal):
    along = np.roll(np.eye(3), int(np.argmax(normal)) + 1, axis=0)
    corners = np.array([[0, 0], [1, 0], [0.3, 0.8]]) @ along[:2] + normal
    towards = view_rotation(corners, np.array([[0, 1, 2]]))[2]
    assert abs(towards @ np.cross(*along[:2])) > 0.999


def test_a_flat_surface_from_its_side_shows_nothing():
    seen = view(np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 1]]), np.array([[0, 1, 2]]), np.eye(3))
    painted = rasterise(seen, lambda faces, weights: [weights.max()], 20)
    assert (painted == 255).all()


def test_samples_are_even_and_take_faces_of_a_pair_alike():
    faces = np.arange(3000).reshape(-1, 3)
    assert sample_of(faces, 1000)[1] == 1
    sample, step = sample_of(faces, 100)
    assert len(sample) <= 100
    assert step == 11
    assert abs((sample[:, 0] // 3 % 2).mean() - 0.5) < 0.01


@pytest.mark.parametrize("ends", [(0.0, 8.3), (0.00403, 0.00641), (-3e-20, 4e-20), (1.0, 1.0), (0.0, 0.0), (5e6, 7.1e8)])
def test_ticks_are_round_and_within(ends):
    axis = linear_axis(*ends)
    assert 3 <= len(axis.ticks) <= 9
    assert axis.low <= min(axis.ticks) < max(axis.ticks) <= axis.high
    assert 0.0 < axis.share(ends[0]) <= axis.share(ends[1]) < 1.0
    assert len(set(axis.labels)) == len(axis.labels)
    assert np.allclose([float(label) for label in axis.labels], axis.ticks, rtol=1e-5, atol=1e-9 * abs(axis.high))


@pytest.mark.parametrize("ends", [(1e-9, 0.02), (6e-4, 2e-2), (1.1e-3, 1.2e-3), (2.0, 2.0), (1e-300, 1.0)])
def test_logarithmic_ticks(ends):
    axis = log_axis(*ends)
    assert 2 <= len(axis.ticks) <= 9
    assert 0.0 < axis.share(ends[0]) <= axis.share(ends[1]) < 1.0
    for tick, label in zip(axis.ticks, axis.labels, strict=True):
        factor, _, power = label.partition("10^")
        value = float(f"{factor.rstrip('·') or 1}e{power}") if power else float(label)
        assert value == pytest.approx(tick, rel=2e-3)


def test_names_are_written_out_where_no_typeface_has_their_letters(monkeypatch):
    assert plain("Büste_é.ply") == "Buste_e.ply"
    assert plain("Голова щит 1") == "Golova shchit 1"
    assert plain("κεφαλη") == "kefali"
    assert plain("頭.ply") == "[982D].ply"
    assert _legible("bust.ply") == ("bust.ply", "")
    monkeypatch.setattr("pgcp.report.chart._OTHERS", ("no such typeface.ttf",))
    _legible.cache_clear()
    assert _legible("голова\n1") == ("golova 1", "")
    _legible.cache_clear()


def test_names_are_drawn_by_a_typeface_of_the_system_that_has_them(monkeypatch):
    words, name = _legible("голова")
    if name:
        assert words == "голова"
    result = pgcp.parameterize(grid(4), patches=1)
    for title in ("голова.ply", "頭.ply", "رأس.ply", "\u202e\ud800x"):
        mesh = pgcp.Mesh(result.mesh.vertices, result.mesh.faces, title)
        assert (picture_of(replace(result, mesh=mesh))[8:30, 300:1300] < 0.5).any()


def test_folded_maps_are_marked_in_red_and_descents_plotted():
    result = pgcp.parameterize(grid(8), patches=2)
    red = lambda image: (image[:40, :, 0] - image[:40, :, 2] > 0.3).sum()  # noqa: E731
    assert red(picture_of(result)) == 0
    folded = replace(result, quality=replace(result.quality, folds=3))
    assert red(picture_of(folded)) > 100
    steps = [{"energy": 2.0**-k, "gradient_norm": 10.0**-k if k < 5 else 0.0} for k in range(6)]
    plotted = picture_of(replace(result, report={"iterations": steps}))
    plot = panel(plotted, 1, 2)
    assert (plot[..., 0] - plot[..., 2] > 0.3).sum() > 200
    assert (plot[..., 2] - plot[..., 0] > 0.3).sum() > 200
    draw(replace(result, report={"iterations": steps[:1]}))


def test_a_picture_does_not_depend_on_the_unit():
    result = pgcp.parameterize(lifted(grid(8)), patches=2)
    small = replace(
        result,
        mesh=pgcp.Mesh(result.mesh.vertices * 2.0**-500, result.mesh.faces, result.mesh.name),
        coordinates=result.coordinates * 2.0**-500,
    )
    one, other = picture_of(result)[60:], picture_of(small)[60:]
    assert (np.abs(one - other).max(axis=2) > 0.1).mean() < 1e-4
