"""Maps of long thin surfaces, whose images shrink to less than 1e-60."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import cap, icosphere, similarity_error
from scipy.spatial.transform import Rotation

import pgcp
from pgcp.errors import SolveFailedError
from pgcp.folds.polar import disk_of, polar_map, sphere_of
from pgcp.plane.space import PLANE, SPHERE, find_folds
from pgcp.surface.distortion import angle_errors
from pgcp.surface.topology import examine
from pgcp.types import Mesh


def ellipsoid(level: int, length: float) -> tuple[Mesh, np.ndarray]:
    """A surface of revolution with half axes 1, 1 and length, and its conformal map to the sphere at its vertices.

    At latitude t (the parameter) the radius is cos t and the arc has the length sqrt(sin^2 t + length^2 cos^2 t) dt, so that
    the isometric latitude is the integral of sqrt(tan^2 t + length^2).
    """
    ball = icosphere(level)
    t = np.linspace(0.0, 0.5 * np.pi, 200_001)
    speed = np.sqrt(np.tan(t[:-1]) ** 2 + length**2)
    u = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * t[1])])
    latitude = np.arcsin(np.clip(ball.vertices[:, 2], -1.0, 1.0))
    isometric = np.sign(latitude) * np.interp(np.abs(latitude), t[:-1], u)
    around = np.arctan2(ball.vertices[:, 1], ball.vertices[:, 0])
    r = 1.0 / np.cosh(isometric)
    exact = np.column_stack([r * np.cos(around), r * np.sin(around), np.tanh(isometric)])
    return Mesh(ball.vertices * [1.0, 1.0, length], ball.faces, "ellipsoid"), exact


def tube(steps: int, around: int, ends: int) -> Mesh:
    """A tube along a helix, nearly square cells, closed at so many ends by a fan."""
    t = np.linspace(0.0, 1.0, steps)
    size = 0.4 / around * 16
    turns = steps * 2 * np.pi * 0.1 / around / 1.2
    middle = np.column_stack([np.cos(turns * t), np.sin(turns * t), 0.3 * turns * t])
    along = np.gradient(middle, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    side = np.cross(along, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=1)[:, None]
    other = np.cross(along, side)
    a = 2 * np.pi * np.arange(around) / around
    ring = np.cos(a)[None, :, None] * side[:, None] + np.sin(a)[None, :, None] * other[:, None]
    points = (middle[:, None] + 0.1 * min(size, 1.0) * ring).reshape(-1, 3)
    k, after = np.arange(around), (np.arange(around) + 1) % around
    faces = []
    for i in range(steps - 1):
        p, q = i * around + k, i * around + after
        faces += [np.column_stack([p, q, q + around]), np.column_stack([p, q + around, p + around])]
    last = (steps - 1) * around
    for one, two, tip in [(last + k, last + after, middle[-1]), (after, k, middle[0])][:ends]:
        faces.append(np.column_stack([np.full(around, len(points)), one, two]))
        points = np.vstack([points, tip])
    return Mesh(points, np.concatenate(faces), "tube")


def boundary_of(mesh: Mesh) -> np.ndarray:
    loops = examine(mesh.faces, len(mesh.vertices)).loops
    return loops[0] if loops else np.empty(0, np.int64)


@pytest.mark.parametrize("turn", [None, (1, 2, 3), (-2, 0.3, 1)])
def test_a_long_ellipsoid_is_mapped_as_well_as_by_formula(turn):
    mesh, exact = ellipsoid(4, 20.0)
    best = angle_errors(mesh, exact).mean()
    if turn is not None:
        mesh = Mesh(mesh.vertices @ Rotation.from_rotvec(turn).as_matrix().T, mesh.faces, "turned")
    result = pgcp.parameterize(mesh)
    assert result.quality.folds == 0
    assert len(find_folds(SPHERE, mesh.faces, result.coordinates)) == 0
    assert angle_errors(mesh, result.coordinates).mean() <= 1.2 * best
    assert result.report["fallback"] is None


@pytest.mark.parametrize(("ends", "target"), [(2, "sphere"), (1, "disk"), (1, "free")])
def test_a_tube_is_mapped_as_well_as_angles_can_be(ends, target):
    mesh = tube(300, 12, ends)
    result = pgcp.parameterize(mesh, target=target)
    assert (result.target, result.quality.folds) == (target, 0)
    # loops of 12 edges around it turn by 360 degrees in the image and not on the surface: 120 / 12 at each corner
    assert result.quality.angle_mean_deg < 1.1 * 120 / 12
    size = np.linalg.norm(result.coordinates[mesh.faces[:, 0]] - result.coordinates[mesh.faces[:, 1]], axis=1)
    assert 0 < size.min() < (1e-30 if ends == 2 else 1e-60)


def test_a_disk_map_in_logarithms_is_that_of_the_surface():
    mesh, z = cap(24)
    polar = polar_map(mesh, boundary_of(mesh), 0.0, "superlu")
    found = disk_of(polar)
    assert abs(found[polar.tip]) == 0
    assert similarity_error(found, z) < 0.01
    assert len(find_folds(PLANE, mesh.faces, found)) == 0


def test_a_sphere_map_in_logarithms_is_that_of_the_surface():
    mesh, exact = ellipsoid(4, 3.0)
    found = sphere_of(polar_map(mesh, boundary_of(mesh), 0.0, "superlu"), mesh)
    assert len(find_folds(SPHERE, mesh.faces, found)) == 0
    assert angle_errors(mesh, found).mean() < 1.05 * angle_errors(mesh, exact).mean()
    assert np.linalg.norm(found, axis=1) == pytest.approx(1.0)


def test_a_surface_without_inner_vertices_has_no_tip():
    mesh = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    with pytest.raises(SolveFailedError):
        polar_map(mesh, boundary_of(mesh), 0.0, "superlu")
