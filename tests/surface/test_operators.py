"""Cotangents and Laplacians, against exact arithmetic where shapes are extreme."""

from __future__ import annotations

from decimal import Decimal, localcontext
from fractions import Fraction
from itertools import permutations

import numpy as np
import pytest
from meshes import grid, lifted

from pgcp.surface.operators import (
    cotangent_laplacian,
    cotangents,
    face_areas,
    needed_mollification,
    positive_laplacian,
    uniform_laplacian,
)
from pgcp.types import Mesh


def exact_cotangents(points):
    """Cotangents (3,) of the corners (3, 3) of a triangle, in rational numbers up to one square root."""
    corners = [[Fraction(x) for x in row] for row in points.tolist()]
    away = lambda p, q: [y - x for x, y in zip(p, q, strict=True)]  # noqa: E731
    u, v = away(corners[0], corners[1]), away(corners[0], corners[2])
    square = sum((u[i] * v[(i + 1) % 3] - u[(i + 1) % 3] * v[i]) ** 2 for i in range(3))
    with localcontext() as context:
        context.prec = 80
        area = (Decimal(square.numerator) / Decimal(square.denominator)).sqrt()
        out = []
        for i in range(3):
            one, two = away(corners[i], corners[(i + 1) % 3]), away(corners[i], corners[(i + 2) % 3])
            dot = sum(a * b for a, b in zip(one, two, strict=True))
            out.append(float(Decimal(dot.numerator) / Decimal(dot.denominator) / area))
        return np.array(out)


@pytest.mark.parametrize("width", [1e-3, 1e-6, 1e-9, 1e-12])
def test_cotangents_of_a_needle_are_precise_whichever_edge_is_short(width):
    """The area of two long edges that are almost parallel would be lost to rounding, that of a short and a long one is not."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        tip, end = np.zeros(3), rng.uniform(0.5, 1.0, 3)
        points = np.array([tip, end, end + width * rng.uniform(0.5, 1.0, 3) * [1, -1, 1]])
        for order in permutations(range(3)):
            found = cotangents(points[list(order)], np.array([[0, 1, 2]]))[0]
            expected = exact_cotangents(points[list(order)])
            assert np.abs(found - expected).max() < 1e-14 * np.abs(expected).max()


def test_a_face_without_area_has_infinite_cotangents():
    points = np.array([[0.0, 0, 0], [1, 1, 1], [2, 2, 2]])
    assert np.isinf(cotangents(points, np.array([[0, 1, 2]]))).all()


def test_the_laplacian_gives_the_dirichlet_energy_of_linear_functions():
    """u^T L u is the area times |grad u|^2 in a flat mesh, and constants are in the kernel."""
    mesh = grid(7, jitter=0.4)
    laplacian = cotangent_laplacian(mesh.vertices, mesh.faces)
    u = mesh.vertices @ [3.0, -4.0, 0.0]
    assert u @ laplacian @ u == pytest.approx(25.0 * face_areas(mesh.vertices, mesh.faces).sum(), rel=1e-12)
    assert np.abs(laplacian @ np.ones(len(u))).max() < 1e-12
    assert abs(laplacian - laplacian.T).max() == 0


def weights_of(laplacian):
    """Weight of every edge of a Laplacian, by its ends."""
    table = -laplacian.toarray()
    return {(i, j): table[i, j] for i, j in np.argwhere(np.triu(table, 1)).tolist()}


def test_only_weights_below_the_least_around_chosen_faces_are_clamped():
    mesh = lifted(grid(8, jitter=0.45, seed=3), 0.6)
    chosen = np.zeros(len(mesh.faces), bool)
    chosen[::3] = True
    before = weights_of(cotangent_laplacian(mesh.vertices, mesh.faces))
    clamped, count = positive_laplacian(mesh.vertices, mesh.faces, chosen, 0.3)
    after = weights_of(clamped)
    near = {tuple(sorted(e)) for face in mesh.faces[chosen].tolist() for e in zip(face, face[1:] + face[:1], strict=True)}
    expected = {e: max(w, 0.3) if e in near else w for e, w in before.items()}
    assert after.keys() == expected.keys()
    assert max(abs(after[e] - expected[e]) for e in after) < 1e-12
    assert count == sum(before[e] < 0.3 for e in near) > 10
    assert np.abs(clamped @ np.ones(len(mesh.vertices))).max() < 1e-12


def test_every_edge_of_the_uniform_laplacian_weighs_one():
    mesh = grid(5)
    laplacian = uniform_laplacian(mesh.faces, len(mesh.vertices))
    assert set(weights_of(laplacian).values()) == {1.0}
    assert np.abs(laplacian @ np.ones(len(mesh.vertices))).max() == 0


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_edges_are_lengthened_only_where_a_face_has_no_area_and_in_proportion(unit):
    mesh = grid(5)
    assert needed_mollification(unit * mesh.vertices, mesh.faces) == 0.0
    flat = Mesh(np.vstack([mesh.vertices, 0.5 * (mesh.vertices[0] + mesh.vertices[1])]), np.vstack([mesh.faces, [0, 1, 36]]))
    needed = needed_mollification(unit * flat.vertices, flat.faces)
    lengths = np.linalg.norm(flat.vertices[flat.faces] - flat.vertices[np.roll(flat.faces, 1, axis=1)], axis=2)
    assert needed == pytest.approx(1e-5 * unit * lengths.mean(), rel=1e-6)
    assert np.isfinite(cotangent_laplacian(unit * flat.vertices, flat.faces, needed).data).all()
