"""Random disks and spheres, stretched and renumbered, in random patches: never a fold, a NaN or an exception."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, note, settings
from hypothesis import strategies as st
from meshes import icosphere
from scipy.spatial import ConvexHull, Delaunay

import pgcp
from pgcp.surface.topology import examine
from pgcp.types import Mesh

SEEDS = st.integers(0, 2**32 - 1)
STRETCH = st.floats(0, 3).map(lambda power: 10.0**power)


def often(count):
    return settings(
        max_examples=count,
        derandomize=True,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
        phases=[Phase.explicit, Phase.generate],  # a mesh made smaller is another mesh, and every attempt takes seconds
    )


def renumbered(points, faces, random):
    """The same surface with its vertices and faces in random order."""
    order = random.permutation(len(points))
    faces = np.argsort(order)[faces]
    turn = random.integers(0, 3, len(faces))[:, None]
    faces = faces[np.arange(len(faces))[:, None], (turn + np.arange(3)) % 3]
    return Mesh(points[order], random.permutation(faces), "random")


def slivers(points, faces, count, random):
    """Split faces by a vertex next to the middle of an edge."""
    for k in random.choice(len(faces), count, replace=False):
        a, b, c = faces[k]
        new = len(points)
        middle = 0.5 * (points[a] + points[b])
        points = np.vstack([points, middle + 10.0 ** random.uniform(-6, -1) * (points[c] - middle)])
        faces[k] = a, b, new
        faces = np.vstack([faces, [[b, c, new], [c, a, new]]])
    return points, faces


@st.composite
def disks(draw):
    """Delaunay triangulations of random points, lifted to a noisy height field and stretched along one axis."""
    random = np.random.default_rng(draw(SEEDS))
    count = draw(st.integers(4, 400))
    plane = random.random((count, 2)) if draw(st.booleans()) else random.normal(size=(count, 2))
    faces = Delaunay(plane).simplices.astype(np.int64)
    a, b, c = plane[faces.T[0]], plane[faces.T[1]], plane[faces.T[2]]
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    faces[area < 0] = faces[area < 0][:, ::-1]
    height = draw(st.sampled_from([0.0, 0.05, 0.3, 1.0])) * random.normal(size=count) * count**-0.5
    height += 0.5 * np.sin(3 * plane[:, 0]) * np.cos(2 * plane[:, 1])
    points = np.column_stack([plane, height])
    points, faces = slivers(points, faces, draw(st.integers(0, min(5, len(faces)))), random)
    points[:, draw(st.integers(0, 2))] *= draw(STRETCH)
    return renumbered(points, faces, random)


@st.composite
def spheres(draw):
    """Convex hulls and icospheres, with noise and with needles, stretched along one axis."""
    random = np.random.default_rng(draw(SEEDS))
    if draw(st.booleans()):
        directions = random.normal(size=(draw(st.integers(6, 300)), 3))
        points = directions / np.linalg.norm(directions, axis=1)[:, None]
        faces = ConvexHull(points).simplices.astype(np.int64)
        a, b, c = points[faces.T[0]], points[faces.T[1]], points[faces.T[2]]
        inward = np.einsum("fd,fd->f", np.cross(b - a, c - a), a + b + c - 3 * points.mean(axis=0)) < 0
        faces[inward] = faces[inward][:, ::-1]
    else:
        mesh = icosphere(draw(st.integers(1, 3)))
        points, faces = mesh.vertices.copy(), mesh.faces.copy()
    points = points * (1 + draw(st.sampled_from([0.0, 0.02, 0.1])) * random.normal(size=(len(points), 1)))
    points, faces = slivers(points, faces, draw(st.integers(0, 3)), random)
    points[:, draw(st.integers(0, 2))] *= draw(STRETCH)
    return renumbered(points, faces, random)


def check(mesh, target, patches, seed):
    """Map a mesh as asked, and see that the map is one."""
    patches = min(patches, len(mesh.faces))
    sizes = np.ptp(mesh.vertices, axis=0)
    note(f"{len(mesh.vertices)} vertices, {len(mesh.faces)} faces, sizes {sizes}, target {target}, {patches} patches")
    result = pgcp.compute(mesh, pgcp.Options(patches=patches, target=target, seed=seed))
    assert np.isfinite(result.coordinates).all()
    assert np.isfinite(result.mu).all()
    assert result.quality.folds == 0
    points = result.coordinates
    if target == "sphere":
        a, b, c = points[mesh.faces.T[0]], points[mesh.faces.T[1]], points[mesh.faces.T[2]]
        assert (np.einsum("fd,fd->f", np.cross(a, b), c) > 0).all()
        assert np.abs(np.linalg.norm(points, axis=1) - 1).max() < 1e-12
        return
    a, b, c = points[mesh.faces.T[0]], points[mesh.faces.T[1]], points[mesh.faces.T[2]]
    u, v = b - a, c - a
    assert (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] > 0).all()
    if target == "disk":
        assert np.abs(np.linalg.norm(points[examine(mesh.faces, len(points)).loops[0]], axis=1) - 1).max() < 1e-12


@pytest.mark.parametrize("target", ["free", "disk"])
def test_random_disks_have_maps_without_folds(target):
    @often(8)
    @given(disks(), st.integers(1, 12), st.integers(0, 5))
    def run(mesh, patches, seed):
        check(mesh, target, patches, seed)

    run()


def test_random_spheres_have_maps_without_folds():
    @often(8)
    @given(spheres(), st.integers(2, 12), st.integers(0, 5))
    def run(mesh, patches, seed):
        check(mesh, "sphere", patches, seed)

    run()
