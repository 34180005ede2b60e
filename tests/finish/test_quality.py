from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from meshes import cap, grid, lifted, spheroid

import pgcp
from pgcp.finish.quality import measure_quality
from pgcp.plane.space import PLANE, SPHERE
from pgcp.surface.beltrami import beltrami_coefficients, folded_faces
from pgcp.surface.distortion import angle_errors, corner_angles, log_area_ratios, mean_distortion
from pgcp.surface.operators import face_areas
from pgcp.types import Mesh


@settings(max_examples=40, deadline=None)
@given(st.floats(0, 0.95), st.floats(0, 6.28), st.floats(0.1, 50))
def test_the_beltrami_coefficient_of_z_plus_k_conj_z_is_k(size, turn, scale):
    mesh = grid(4, jitter=0.4)
    k = size * np.exp(1j * turn)
    w = mesh.vertices[:, 0] + 1j * mesh.vertices[:, 1]
    mu = beltrami_coefficients(mesh.vertices, mesh.faces, scale * (w + k * np.conj(w)))
    # each face's chart has its first edge along the real axis
    edge = w[mesh.faces[:, 1]] - w[mesh.faces[:, 0]]
    expected = k * np.conj(edge) / edge
    assert np.abs(mu - expected).max() < 1e-12


def test_a_conformal_image_has_small_mu_and_a_mirrored_one_more_than_one():
    mesh, exact = cap(20)
    assert np.abs(beltrami_coefficients(mesh.vertices, mesh.faces, exact)).max() < 0.05
    mirrored = beltrami_coefficients(mesh.vertices, mesh.faces, exact.conj())
    assert np.isfinite(mirrored).all()
    assert (np.abs(mirrored) > 1).all()
    assert len(folded_faces(mesh.faces, exact)) == 0
    assert len(folded_faces(mesh.faces, exact.conj())) == len(mesh.faces)


def test_folds_are_decided_exactly():
    """Three collinear points whose rounded area may have either sign."""
    faces = np.array([[0, 1, 2]])
    for t in range(1, 60):
        x, y = 0.1 * t, 0.3 * t
        z = np.array([0.1 + 0.3j, complex(0.1 + x, 0.3 + y), complex(0.1 + 2 * x, 0.3 + 2 * y)])
        from fractions import Fraction as Q

        a, b, c = ((Q(w.real), Q(w.imag)) for w in z.tolist())
        exact = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        assert (len(folded_faces(faces, z)) == 0) == (exact > 0)


def test_angles_of_a_known_triangle():
    points = np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0]])
    assert np.degrees(corner_angles(points, np.array([[0, 1, 2]])))[0] == pytest.approx([90, 53.13010235, 36.86989765])


def test_quality_of_an_exact_map_and_of_a_stretched_one():
    mesh = grid(6, jitter=0.3)
    exact = measure_quality(mesh, PLANE, 3 * mesh.vertices[:, :2], np.zeros(len(mesh.faces), complex))
    assert exact.angle_max_deg < 1e-9
    assert exact.log_area_mean < 1e-12
    assert exact.folds == 0
    square = grid(6)
    stretched = square.vertices[:, :2] * [np.sqrt(3), 1.0]
    errors = angle_errors(square, stretched)
    # right isosceles triangles: 45 degrees become 30 or 60, 90 stays
    assert np.allclose(np.sort(errors, axis=1), [0, 15, 15], atol=1e-9)
    areas = [face_areas(p, square.faces) for p in (square.vertices, np.column_stack([stretched, 0 * stretched[:, 0]]))]
    assert np.abs(log_area_ratios(*areas, (1.0, np.sqrt(3)))).max() < 1e-12
    assert mean_distortion(square, np.pad(stretched, ((0, 0), (0, 1)))) == pytest.approx((0.0, 10.0), abs=1e-9)


def test_area_ratios_follow_the_definition():
    mesh = grid(1)
    flat = np.array([[0.0, 0], [1, 0], [0, 1], [3, 3]])
    order = mesh.faces
    area = lambda p, f: 0.5 * abs(np.cross(p[f[1]] - p[f[0]], p[f[2]] - p[f[0]]))  # noqa: E731
    with np.errstate(all="ignore"):
        import warnings

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            image = np.array([area(flat, f) for f in order])
    expected = np.log(image / image.sum()) - np.log(0.5)
    assert log_area_ratios(np.array([0.5, 0.5]), image, (1.0, image.sum())) == pytest.approx(expected)
    flat = np.pad(flat, ((0, 0), (0, 1)))
    assert mean_distortion(mesh, flat)[0] == pytest.approx(np.abs(expected).mean())
    flat[0] = flat[2]  # the second face without area: it counts as the first
    assert mean_distortion(mesh, flat)[0] == pytest.approx(abs(np.log(2.0)))


def test_faces_whose_image_has_no_area_count_as_the_most_distorted():
    """Their logarithm is infinite: the mean over the others alone would be better the more faces collapse."""
    mesh = lifted(grid(6, jitter=0.2))
    image = mesh.vertices[:, :2].copy()
    means = []
    for lost in ([], [8], [8, 24, 40]):
        for vertex in lost:
            image[vertex] = image[vertex + 1]
        areas = [face_areas(points, mesh.faces) for points in (mesh.vertices, np.pad(image, ((0, 0), (0, 1))))]
        logs = np.abs(log_area_ratios(*areas, (areas[0].sum(), areas[1].sum())))
        assert np.isinf(logs).sum() == 2 * len(lost)
        logs = np.where(np.isinf(logs), logs[np.isfinite(logs)].max(), logs)
        mu = np.zeros(len(mesh.faces), complex)
        means.append(measure_quality(mesh, PLANE, image, mu).log_area_mean)
        assert means[-1] == pytest.approx(logs.mean(), rel=1e-12)
    assert means[0] < means[1] < means[2]


def test_types_refuse_what_is_no_mesh():
    from pgcp.errors import DegenerateError, InputError

    good = grid(2)
    with pytest.raises(InputError, match="face 0 uses vertex 99"):
        Mesh(good.vertices, np.array([[0, 1, 99]]))
    with pytest.raises(InputError, match="no faces"):
        Mesh(good.vertices, np.empty((0, 3), int))
    with pytest.raises(InputError, match="expected \\(F, 3\\) integers"):
        Mesh(good.vertices, good.faces.astype(float))
    with pytest.raises(InputError, match="expected \\(V, 3\\)"):
        Mesh(good.vertices[:, :2], good.faces)
    broken = good.vertices.copy()
    broken[4, 1] = np.nan
    with pytest.raises(DegenerateError, match="vertex 4"):
        Mesh(broken, good.faces)


@pytest.mark.parametrize(("sample", "sure"), [(1 << 16, 6.0), (100, 6.0), (3, 0.0)])  # by the last, quantiles are missed
@pytest.mark.parametrize("kind", ["plane", "sphere"])
def test_slices_measure_what_the_whole_would(kind, sample, sure, monkeypatch):
    monkeypatch.setattr("pgcp.finish.quality._SAMPLE", sample)
    monkeypatch.setattr("pgcp.finish.quality._SURE", sure)
    mesh = lifted(grid(31, 23, jitter=0.3)) if kind == "plane" else spheroid(3, 2.0)[0]
    result = pgcp.parameterize(mesh, patches=2)
    space = PLANE if kind == "plane" else SPHERE
    errors = angle_errors(mesh, result.coordinates)
    areas = [face_areas(points, mesh.faces) for points in (mesh.vertices, space.in_space(space.positions(result.coordinates)))]
    logs, mu = np.abs(log_area_ratios(*areas, (areas[0].sum(), areas[1].sum()))), np.abs(result.mu)
    for size in (1 << 18, 97, 1):
        monkeypatch.setattr("pgcp.parallel._SLICE", size)
        quality = measure_quality(mesh, space, result.coordinates, result.mu)
        assert quality.angle_mean_deg == pytest.approx(errors.mean(), rel=1e-12)
        assert quality.angle_sd_deg == pytest.approx(errors.std(), rel=1e-12)
        assert quality.angle_median_deg == np.median(errors)
        assert quality.angle_p99_deg == pytest.approx(np.quantile(errors, 0.99), rel=1e-14)
        assert quality.angle_max_deg == errors.max()
        assert (quality.mu_max, quality.folds) == (mu.max(), 0)
        assert quality.mu_mean == pytest.approx(mu.mean(), rel=1e-12)
        assert quality.log_area_mean == pytest.approx(logs.mean(), rel=1e-12)


def test_angle_errors_are_differences_of_angles_however_small_the_image():
    mesh = lifted(grid(9, jitter=0.3))
    image = pgcp.parameterize(mesh, patches=1).coordinates * [1.0, 0.8]
    for scale in (1.0, 1e-60, 1e-100):
        expected = np.degrees(
            np.abs(corner_angles(np.pad(image, ((0, 0), (0, 1))), mesh.faces) - corner_angles(mesh.vertices, mesh.faces))
        )
        assert np.abs(angle_errors(mesh, image * scale) - expected).max() < 1e-9
