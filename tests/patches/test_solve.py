"""The second pass of one patch: its chart, its precision, and its answer to folds."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import grid, lifted
from pieces import patch_of

from pgcp.elimination.dirichlet import available_backends, eliminate_interior
from pgcp.errors import SolveFailedError
from pgcp.patches.solve import _even_directions, _outside, extend_patch, solve_patch
from pgcp.plane.mobius import rotation_to_north, to_plane, to_sphere
from pgcp.plane.space import PLANE, SPHERE
from pgcp.surface.beltrami import folded_faces
from pgcp.surface.operators import cotangent_laplacian
from pgcp.types import Mesh


def factor_of(patch, backend="superlu"):
    return eliminate_interior(cotangent_laplacian(patch.vertices, patch.faces), patch.boundary, backend)


def stretched_patch(seed, most=6):
    """A flat patch of a few unequal cells."""
    rng = np.random.default_rng(seed)
    mesh = grid(int(rng.integers(2, most + 1)))
    points = mesh.vertices ** [rng.uniform(1, 4), rng.uniform(1, 3), 1]
    return rng, patch_of(Mesh(points, mesh.faces))


def seen_from_everywhere(patch, boundary):
    """What each pole of 500 and the one opposite makes of a boundary (n, 3), by its chart's positions themselves.

    Candidates (501, 3), variances of the scale by length and by count, whether an edge is longer than half the distance from
    the pole, and whether the boundary goes round counter-clockwise.
    """
    surface = patch.vertices[patch.boundary]
    lengths = np.linalg.norm(np.roll(surface, -1, axis=0) - surface, axis=1)
    middle = boundary.mean(axis=0)
    poles = np.vstack([-middle / np.linalg.norm(middle), _even_directions(500)])
    chords = np.linalg.norm(np.roll(boundary, -1, axis=0) - boundary, axis=1)
    rows = []
    for pole in poles:
        z = to_plane(boundary @ rotation_to_north(-pole).T)
        scale = np.log(np.abs(np.roll(z, -1) - z) / lengths)
        by_length = np.average((scale - np.average(scale, weights=lengths)) ** 2, weights=lengths)
        away = np.linalg.norm(boundary - pole, axis=1)
        is_near = (chords / np.minimum(away, np.roll(away, -1))).max() > 0.5
        rows.append((by_length, scale.var(), is_near, np.imag(np.conj(z) * np.roll(z, -1)).sum() > 0))
    return poles, *(np.array(column) for column in zip(*rows, strict=True))


def least_of(values, allowed):
    return int(np.argmin(np.where(allowed, values, np.inf)))


def chosen_of(poles, pole):
    return int(np.argmin(np.linalg.norm(poles - pole, axis=1)))


def test_the_chart_is_the_one_in_which_the_boundarys_scale_varies_least_by_length():
    differ = 0
    for seed in range(12):
        rng, patch = stretched_patch(seed, 12)
        w = patch.vertices[patch.boundary] @ [1, 1j, 0] - 0.5 - 0.5j
        w = w * rng.uniform(0.3, 1) + 0.2 * w**2
        boundary = to_sphere(w / (1 - w * rng.uniform(0, 0.6) * np.exp(2j * np.pi * rng.uniform())))
        poles, by_length, by_count, is_near, is_outside = seen_from_everywhere(patch, boundary)
        allowed = is_outside & ~is_near
        if not allowed.any():
            continue
        expected = least_of(by_length, allowed)
        assert chosen_of(poles, _outside(patch, boundary)) == expected
        differ += least_of(by_count, allowed) != expected
    assert differ > 3


def test_no_edge_is_seen_wide_from_the_pole_while_there_is_another():
    """From close by, the long edge of a coarse boundary could make up for any variation of the others."""
    differ = 0
    for seed in range(40):
        rng, patch = stretched_patch(seed)
        w = 0.6 * (patch.vertices[patch.boundary] @ [1, 1j, 0] - 0.5 - 0.5j)
        w = w / (1 - w * rng.uniform(0.7, 1.6) * np.exp(2j * np.pi * rng.uniform()))
        boundary = to_sphere(w)
        poles, by_length, _, is_near, is_outside = seen_from_everywhere(patch, boundary)
        if not (is_outside & ~is_near).any():
            continue
        chosen = chosen_of(poles, _outside(patch, boundary))
        assert not is_near[chosen]
        assert is_outside[chosen]
        assert chosen == least_of(by_length, is_outside & ~is_near)
        differ += chosen != least_of(by_length, is_outside)
    assert differ > 5


def graded_patch(levels):
    """The unit square in cells whose sides are halved towards 0."""
    mesh = grid(levels)
    sides = np.concatenate([[0.0], 2.0 ** -np.arange(levels - 1, -1, -1)])
    points = mesh.vertices.copy()
    points[:, :2] = sides[np.rint(levels * points[:, :2]).astype(int)]
    return patch_of(Mesh(points, mesh.faces))


@pytest.mark.parametrize("backend", available_backends())
def test_positions_are_as_precise_as_numbers_are_where_the_boundary_is_most_crowded(backend):
    """Cells of 2^-40 around 10,000 come out right to the last bit: a linear map is harmonic, and all positions are numbers."""
    for far, levels in ((1.0, 40), (100.0, 40), (1e4, 38)):
        patch = graded_patch(levels)
        exact = far + patch.vertices @ [1, 1j, 0]
        factor = factor_of(patch, backend)
        near = np.abs(exact - far) < 2.0**-30
        for found in (
            solve_patch(PLANE, patch, exact[patch.boundary], factor, backend),
            extend_patch(patch, patch.boundary, exact[patch.boundary], factor),
        ):
            assert found.fold_count == 0
            assert np.abs(found.points - exact).max() < 1e-14 * far
            if found.first_fold_count == 0 and far > 1.0:
                assert np.abs(found.points - exact)[near].max() <= np.spacing(far)


def rough_patch(seed, rough):
    """A rough patch, to be mapped into a flower: harmonic maps into it fold."""
    rng = np.random.default_rng(seed)
    mesh = grid(8, jitter=0.3, seed=seed)
    patch = patch_of(Mesh(mesh.vertices + [0, 0, rough] * rng.normal(size=mesh.vertices.shape), mesh.faces))
    t = 2 * np.pi * np.arange(len(patch.boundary)) / len(patch.boundary)
    return patch, np.exp(1j * t) * (1 + 0.6 * np.cos(rng.integers(2, 6) * t + rng.uniform(0, 6)))


def test_clamped_weights_are_kept_only_where_they_leave_fewer_folds():
    helped = useless = 0
    for seed in range(16):
        for rough in (0.1, 0.3):
            patch, boundary = rough_patch(seed, rough)
            found = solve_patch(PLANE, patch, boundary, factor_of(patch), "superlu")
            assert np.array_equal(found.points[patch.boundary], boundary)
            assert found.fold_count == len(folded_faces(patch.faces, found.points))
            assert found.mu_max == np.abs(found.mu).max()
            assert found.fold_count <= found.first_fold_count
            assert (found.raised_weights > 0) == (found.fold_count < found.first_fold_count)
            helped += found.raised_weights > 0
            useless += found.raised_weights == 0 and found.fold_count > 2
    assert helped > 5
    assert useless > 5


def test_clamped_weights_fold_nothing_in_a_convex_boundary():
    """Tutte, Floater: positive weights fold nothing. In the chart z itself, the circle is convex."""
    first = 0
    for seed in range(8):
        patch, boundary = rough_patch(seed, 0.5)
        boundary = np.exp(2j * np.pi * np.arange(len(boundary)) / len(boundary))
        found = solve_patch(PLANE, patch, boundary, factor_of(patch), "superlu")
        first += found.first_fold_count
        assert found.fold_count <= 2
    assert first > 20


def test_a_patch_on_the_sphere_is_solved_where_infinity_is_outside():
    patch = patch_of(lifted(grid(12), 0.1))
    w = 3.0 * (patch.vertices @ [1, 1j, 0] - 0.5 - 0.5j)
    boundary = to_sphere(w[patch.boundary])
    found = solve_patch(SPHERE, patch, boundary, factor_of(patch), "superlu")
    assert found.fold_count == 0
    assert np.abs(np.linalg.norm(found.points, axis=1) - 1).max() < 1e-14
    # all around the south pole, which is infinity in the usual chart
    turned = solve_patch(SPHERE, patch, -boundary * [1, -1, 1], factor_of(patch), "superlu")
    assert turned.fold_count == 0
    assert np.abs(turned.points + found.points * [1, -1, 1]).max() < 0.02


def test_positions_that_are_no_numbers_are_refused():
    patch = patch_of(grid(4))
    boundary = (patch.vertices @ [1, 1j, 0])[patch.boundary]
    boundary[2] = np.nan
    with pytest.raises(SolveFailedError, match="patch 0"):
        extend_patch(patch, patch.boundary, boundary, factor_of(patch))
