"""Laplace's equation of a patch: the chart it is solved in, digits where it is squeezed, what is kept of a second try."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from meshes import grid, lifted

from pgcp.elimination.dirichlet import eliminate_interior
from pgcp.patches.solve import _DIRECTIONS, _even_directions, _outside, _solved, solve_patch
from pgcp.plane.mobius import rotation_to_north, to_plane, to_sphere
from pgcp.surface.operators import cotangent_laplacian
from pgcp.surface.topology import examine


def boundary_of(seed):
    """A random boundary: of a flat patch (n, 3), and where it goes on the sphere (n, 3)."""
    random = np.random.default_rng(seed)
    n = int(random.integers(8, 40))
    t = np.sort(random.uniform(0, 2 * np.pi, n))
    z = np.exp(1j * t) * (1 + random.uniform(0, 0.6) * np.cos(2 * t + random.uniform(0, 6))) + 0.1 * np.exp(2j * t)
    flat = np.column_stack([np.cos(t), np.sin(t), 0 * t]) * random.uniform(0.5, 1.5, (n, 1))
    return flat, to_sphere(z * np.exp(random.normal()) + random.normal() + 1j * random.normal())


def pole_of(flat, boundary):
    return _outside(SimpleNamespace(vertices=flat, boundary=np.arange(len(flat)), mollification=0.0, index=0), boundary)


@pytest.mark.parametrize("seed", range(20))
def test_next_to_nothing_of_the_boundary_counts_for_next_to_nothing(seed):
    """Sixty vertices within a thousandth of the patch, whatever their scale, choose no other chart."""
    flat, boundary = boundary_of(seed)
    before = pole_of(flat, boundary)
    random = np.random.default_rng(seed)
    more = np.cumsum(random.uniform(1e-6, 1e-5, 60))
    along, image = flat[1] - flat[0], boundary[1] - boundary[0]
    tiny_flat = flat[0] + more[:, None] * along
    tiny_image = boundary[0] + (more * 50)[:, None] * image
    tiny_image /= np.linalg.norm(tiny_image, axis=1, keepdims=True)
    after = pole_of(np.insert(flat, 1, tiny_flat, axis=0), np.insert(boundary, 1, tiny_image, axis=0))
    assert np.abs(after - before).max() < 1e-12


def widest(pole, boundary):
    """The longest a boundary edge is seen from a pole: its chord over the nearer end's distance."""
    chord = np.linalg.norm(np.roll(boundary, -1, axis=0) - boundary, axis=1)
    away = np.linalg.norm(boundary - pole, axis=1)
    return float((chord / np.minimum(away, np.roll(away, -1))).max())


def encloses(pole, boundary):
    z = to_plane(boundary @ rotation_to_north(-pole).T)
    return np.imag(np.conj(z) * np.roll(z, -1)).sum() > 0


def test_no_edge_is_seen_wide_from_the_pole_where_that_can_be():
    near = 0
    for seed in range(60):
        flat, boundary = boundary_of(seed)
        others = [c for c in _even_directions(_DIRECTIONS) if encloses(c, boundary)]
        if any(widest(c, boundary) <= 0.5 for c in others):
            near += any(widest(c, boundary) > 0.5 for c in others)
            assert widest(pole_of(flat, boundary), boundary) <= 0.5 + 1e-12, seed
    assert near > 10


def half_annulus(levels, arcs):
    """Half an annulus whose rings halve in size, around 0: places (n,), faces, the loop counter-clockwise."""
    angle = np.pi * np.arange(arcs + 1) / arcs
    w = np.multiply.outer(0.5 ** np.arange(levels + 1), np.exp(1j * angle)).reshape(-1)
    k, j = (x.reshape(-1) for x in np.meshgrid(np.arange(levels), np.arange(arcs), indexing="ij"))
    a = k * (arcs + 1) + j
    b, c, d = a + 1, a + arcs + 1, a + arcs + 2
    faces = np.concatenate([np.column_stack([a, b, d]), np.column_stack([a, d, c])])
    return w, faces, examine(faces, len(w)).loops[0]


def test_where_a_patch_is_crowded_it_keeps_its_last_digits():
    """Rings down to a few hundred units in the last place: harmonic values are right to a few of these units."""
    w, faces, loop = half_annulus(43, 8)
    flat = np.column_stack([w.real, w.imag, 0 * w.real])
    patch = SimpleNamespace(vertices=flat, faces=faces, boundary=loop, mollification=0.0, index=0)
    factor = eliminate_interior(cotangent_laplacian(flat, faces), loop, "superlu")
    z = 1.0 + w
    chart = SimpleNamespace(boundary=z[loop], points=lambda points: points)
    found = _solved(patch, chart, factor, z[loop])
    small = np.abs(w) < 1e-10
    assert small.sum() > 50
    assert np.abs(found - z)[small].max() <= 4 * np.finfo(float).eps


class Scripted:
    """A plane in which faces are folded as a script says, whatever the positions."""

    closed = False

    def __init__(self, counts):
        self._counts = iter(counts)
        self.asked = []

    def folded(self, _faces, points):
        self.asked.append(points.copy())
        return np.arange(next(self._counts))

    def coefficients(self, _vertices, faces, _points):
        return np.zeros(len(faces), complex)


@pytest.fixture
def bent():
    """A patch with obtuse angles, whose weights can be raised."""
    mesh = lifted(grid(14, jitter=0.45), 2.0)
    loop = examine(mesh.faces, len(mesh.vertices)).loops[0]
    patch = SimpleNamespace(vertices=mesh.vertices, faces=mesh.faces, boundary=loop, mollification=0.0, index=0)
    return patch, eliminate_interior(cotangent_laplacian(mesh.vertices, mesh.faces), loop, "superlu")


@pytest.mark.parametrize("counts", [(60, 60, 70, 90, 60), (60, 61, 60, 60, 60)])
def test_weights_are_raised_for_fewer_folds_only(counts, bent):
    patch, factor = bent
    space = Scripted([*counts, *[99] * 20])
    boundary = patch.vertices[patch.boundary] @ [1, 1j, 0]
    found = solve_patch(space, patch, boundary, factor, "superlu")
    assert len(space.asked) > 1  # others were tried
    assert any(np.abs(other - space.asked[0]).max() > 1e-9 for other in space.asked[1:])
    assert np.array_equal(found.points, space.asked[0])
    assert (found.fold_count, found.raised_weights) == (60, 0)


def test_weights_are_raised_where_that_takes_folds_away(bent):
    patch, factor = bent
    space = Scripted([60, 50, 0])
    found = solve_patch(space, patch, patch.vertices[patch.boundary] @ [1, 1j, 0], factor, "superlu")
    assert np.array_equal(found.points, space.asked[2])
    assert found.fold_count == 0
    assert found.raised_weights > 0
