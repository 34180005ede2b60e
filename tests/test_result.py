"""What a finished map says of itself, and gives to others."""

from __future__ import annotations

import io
import json
from time import perf_counter

import numpy as np
import pytest
from meshes import grid, lifted, spheroid
from PIL import Image

import pgcp
from pgcp.errors import BadFileError, InputError
from pgcp.plane.locate import Locator


@pytest.fixture(scope="module")
def plane():
    return pgcp.parameterize(lifted(grid(14, 10)), patches=2)


@pytest.fixture(scope="module")
def ball():
    return pgcp.parameterize(spheroid(3, 1.5)[0], patches=2)


def test_a_result_is_a_parameterization_with_its_coordinates_by_name(plane, ball):
    assert isinstance(plane, pgcp.Result)
    assert isinstance(plane, pgcp.Parameterization)
    assert plane.uv is plane.coordinates
    assert plane.sphere is None
    assert ball.sphere is ball.coordinates
    assert ball.uv is None
    assert plane.faces is plane.mesh.faces
    assert isinstance(pgcp.compute(grid(3)), pgcp.Result)


def test_measures_by_face_agree_with_the_quality(plane, ball):
    for result in (plane, ball):
        assert result.angle_error.mean() == pytest.approx(result.quality.angle_mean_deg, rel=1e-12)
        assert np.abs(np.log(result.area_ratio)).mean() == pytest.approx(result.quality.log_area_mean, rel=1e-12)


def test_measures_of_a_scaled_plane_are_exact():
    mesh = grid(4)
    result = pgcp.Result.of(pgcp.compute(mesh, pgcp.Options(patches=1)))
    scaled = pgcp.Result(mesh, mesh.vertices[:, :2] * 8, result.patch, result.mu, result.quality, "free")
    assert np.allclose(scaled.log_scale, np.log(8))
    assert np.allclose(scaled.area_ratio, 1)
    assert scaled.angle_error.max() < 1e-10


def test_faces_without_area_have_measures_all_the_same():
    mesh = grid(2)
    flat = pgcp.Mesh(np.vstack([mesh.vertices, mesh.vertices[:1]]), np.vstack([mesh.faces, [0, 0, 9]]))
    patch, mu = np.zeros(9, int), np.zeros(9, complex)
    quality = pgcp.Quality(*[0.0] * 7, 0, 0.0)
    for image in (flat.vertices[:, :2], 0 * flat.vertices[:, :2]):
        result = pgcp.Result(flat, image, patch, mu, quality, "free")
        for values in (result.angle_error, result.area_ratio, result.log_scale):
            assert np.isfinite(values).all()


def places_on(result, count, seed=0):
    """Random places on faces: faces, weights, points of the map and of the surface."""
    rng = np.random.default_rng(seed)
    faces, weights = rng.integers(0, len(result.faces), count), rng.dirichlet([1, 1, 1], count)
    return (
        faces,
        weights,
        *(
            np.einsum("nk,nkd->nd", weights, points[result.faces[faces]])
            for points in (result.coordinates, result.mesh.vertices)
        ),
    )


def test_the_inverse_finds_faces_and_places(plane, ball):
    for result in (plane, ball):
        faces, weights, image, surface = places_on(result, 3000)
        found = result.inverse(image)
        assert found.inside.all()
        assert np.array_equal(found.faces, faces)
        assert np.abs(found.weights - weights).max() < 1e-9
        assert np.abs(found.points - surface).max() < 1e-9


def test_vertices_and_middles_of_edges_are_inside(plane, ball):
    for result in (plane, ball):
        middles = 0.5 * (result.coordinates[result.faces[:, 0]] + result.coordinates[result.faces[:, 1]])
        for image in (result.coordinates, middles):
            found = result.inverse(image)
            back = np.einsum("nk,nkd->nd", found.weights, result.coordinates[result.faces[found.faces]])
            assert np.abs(back - image).max() < 1e-9
            assert found.weights.min() >= 0
    assert np.abs(plane.inverse(plane.uv).points - plane.mesh.vertices).max() < 1e-9


def test_points_outside_go_to_the_nearest_place_on_an_edge():
    mesh = grid(5)
    locator = Locator(mesh.vertices[:, :2], mesh.faces, False)
    points = np.array([[1.5, 0.3], [-2.0, -3.0], [0.35, 7.0], [0.5, 0.5]])
    found = locator.find(points, mesh.vertices)
    assert found.inside.tolist() == [False, False, False, True]
    assert np.allclose(found.points[:, :2], np.clip(points, 0, 1), atol=1e-12)


def test_crowded_maps_are_searched_as_well():
    """Faces of a map whose scale spans fifteen powers of ten are found."""
    rings = np.exp(-np.arange(60) * 0.6)
    angle = np.arange(24) * (np.pi / 12)
    z = np.append((rings[:, None] * np.exp(1j * angle)).ravel(), 0)
    inner = np.arange(24)
    faces = [[59 * 24 + a, 59 * 24 + (a + 1) % 24, 60 * 24] for a in range(24)]
    for r in range(59):
        a, b = r * 24 + inner, r * 24 + (inner + 1) % 24
        faces += [*np.column_stack([a, b, b + 24]).tolist(), *np.column_stack([a, b + 24, a + 24]).tolist()]
    faces = np.array(faces)
    image = np.column_stack([z.real, z.imag])
    middles = image[faces].mean(axis=1)
    found = Locator(image, faces, False).find(middles, np.pad(image, ((0, 0), (0, 1))))
    assert found.inside.all()
    assert np.array_equal(found.faces, np.arange(len(faces)))


def test_a_million_points_are_found_at_once():
    mesh = grid(200)
    locator = Locator(mesh.vertices[:, :2], mesh.faces, False)
    points = np.random.default_rng(1).uniform(0, 1, (1_000_000, 2))
    locator.find(points[:1], mesh.vertices)
    begun = perf_counter()
    found = locator.find(points, mesh.vertices)
    assert perf_counter() - begun < 10  # 1.0 measured
    assert found.inside.all()
    assert np.abs(found.points[:, :2] - points).max() < 1e-12


def test_points_that_cannot_be_in_the_map_are_refused(plane, ball):
    for result, points, words in (
        (plane, np.zeros((3, 3)), r"shape \(3, 3\), expected \(N, 2\)"),
        (ball, np.zeros((3, 2)), r"shape \(3, 2\), expected \(N, 3\)"),
        (plane, [[0, 0], [0, np.nan]], "point 1 is no finite number"),
        (ball, [[1, 0, 0], [0, 0, 0]], "point 1 is the centre of the sphere"),
    ):
        with pytest.raises(InputError, match=words):
            result.inverse(points)
    assert len(plane.inverse(np.empty((0, 2))).faces) == 0


def test_a_result_is_saved_and_loaded_as_it_is(plane, ball, tmp_path):
    fixed = pgcp.compute(pgcp.Mesh(grid(6).vertices, np.delete(grid(6).faces, [30, 31], axis=0)), pgcp.Options(fix=True))
    for result in (plane, ball, fixed):
        result.save(tmp_path / "one.result")
        again = pgcp.Result.load(tmp_path / "one.result")
        for name in ("coordinates", "patch", "mu", "faces", "vertex_of", "face_of"):
            one, other = getattr(result, name), getattr(again, name)
            assert (one is None and other is None) or (np.array_equal(one, other) and one.dtype == other.dtype)
        assert np.array_equal(again.mesh.vertices, result.mesh.vertices)
        assert repr(again) == repr(result)
        assert again.report == json.loads(json.dumps(result.report))
        assert again.quality.angle_p99_deg == result.quality.angle_p99_deg
    assert [path.name for path in tmp_path.iterdir()] == ["one.result"]


def test_what_is_no_saved_result_is_refused(plane, tmp_path):
    path = tmp_path / "x.npz"
    with pytest.raises(BadFileError, match="cannot be read"):
        pgcp.Result.load(path)
    path.write_bytes(b"something else")
    with pytest.raises(BadFileError, match="no saved result"):
        pgcp.Result.load(path)
    np.savez(path, uv=plane.uv)
    with pytest.raises(BadFileError, match="no saved result"):
        pgcp.Result.load(path)
    with pytest.raises(BadFileError, match="cannot be written"):
        plane.save(tmp_path / "nowhere" / "x")


def test_a_result_describes_itself_in_three_lines_and_a_picture(plane, ball):
    for result in (plane, ball):
        lines = repr(result).splitlines()
        assert len(lines) == 3
        assert str(len(result.faces)) in lines[0]
        assert result.target in lines[1]
    assert isinstance(plane.picture(), Image.Image)
    out = io.BytesIO()
    plane.picture().save(out, "png")


def test_a_result_as_polydata(plane, ball):
    pytest.importorskip("pyvista")
    for result in (plane, ball):
        surface = result.to_pyvista()
        assert np.array_equal(surface.points, result.mesh.vertices)
        assert np.array_equal(surface.regular_faces, result.faces)
        assert np.array_equal(surface.point_data[result.coordinates_name], result.coordinates)
        assert np.array_equal(surface.point_data["log_scale"], result.log_scale)
        assert np.array_equal(surface.cell_data["patch"], result.patch)
        assert np.array_equal(surface.cell_data["angle_error"], result.angle_error)
    assert np.array_equal(plane.to_pyvista().active_texture_coordinates, plane.uv)
