from __future__ import annotations

import numpy as np
import pytest
from meshes import cap, grid, tetrahedron, torus

from pgcp.api import check_mesh
from pgcp.errors import NotManifoldError, NotSimplyConnectedError
from pgcp.surface.topology import examine, pair_half_edges
from pgcp.types import Mesh


def look(mesh: Mesh):
    return examine(mesh.faces, len(mesh.vertices))


def test_a_grid_is_a_disk_and_its_loop_runs_counter_clockwise():
    mesh = grid(7, 5)
    topology = look(mesh)
    assert topology.is_disk
    assert not topology.is_sphere
    assert topology.genus == 0
    (loop,) = topology.loops
    assert len(loop) == 24
    z = mesh.vertices[loop, 0] + 1j * mesh.vertices[loop, 1]
    assert np.imag(np.vdot(z, np.roll(z, -1))) / 2 == pytest.approx(5 / 7)


def test_closed_surfaces():
    assert look(tetrahedron()).is_sphere
    ring = look(torus())
    assert (ring.genus, ring.euler_characteristic, ring.loops) == (1, 0, ())
    assert "genus 1" in ring.describe()


def test_twins_are_mutual_and_run_opposite():
    mesh, _ = cap(5)
    twins = pair_half_edges(mesh.faces, len(mesh.vertices))
    inner = np.flatnonzero(twins >= 0)
    assert np.array_equal(twins[twins[inner]], inner)
    flat = mesh.faces.reshape(-1)
    nxt = np.arange(len(flat)) - np.arange(len(flat)) % 3 + (np.arange(len(flat)) % 3 + 1) % 3
    assert np.array_equal(flat[inner], flat[nxt[twins[inner]]])


def damaged(kind: str) -> Mesh:
    mesh = grid(6)
    faces, vertices = mesh.faces.copy(), mesh.vertices
    if kind == "non-manifold-edge":
        vertices = np.vstack([vertices, [0.5, 0.5, 1.0]])
        faces = np.vstack([faces, [faces[20][0], faces[20][1], len(vertices) - 1]])
    elif kind == "duplicate-face":
        faces = np.vstack([faces, faces[30]])
    elif kind == "repeated-index-face":
        faces[5, 1] = faces[5, 0]
    elif kind == "inconsistent-orientation":
        faces[::3] = faces[::3, ::-1]
    elif kind == "non-manifold-vertex":
        vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], float)
        faces = np.array([[0, 1, 2], [0, 3, 4]])
    elif kind == "not-orientable":
        faces = np.array([[i, (i + 1) % 5, (i + 2) % 5] for i in range(5)])
        vertices = np.column_stack([np.cos(np.arange(5)), np.sin(np.arange(5)), np.arange(5) % 2]).astype(float)
    return Mesh(vertices, faces)


@pytest.mark.parametrize(
    "kind",
    [
        "non-manifold-edge",
        "duplicate-face",
        "repeated-index-face",
        "inconsistent-orientation",
        "non-manifold-vertex",
        "not-orientable",
    ],
)
def test_every_defect_is_named_with_offenders_and_refused(kind):
    mesh = damaged(kind)
    topology = look(mesh)
    found = {defect.kind: defect for defect in topology.defects}
    assert kind in found
    assert found[kind].count >= 1
    assert found[kind].first
    assert not topology.is_disk
    with pytest.raises(NotManifoldError):
        check_mesh(mesh)


def test_the_crowded_edge_is_the_one_named():
    mesh = damaged("non-manifold-edge")
    (defect,) = look(mesh).defects
    assert set(defect.first[0]) == set(mesh.faces[-1][:2].tolist())


@pytest.mark.parametrize(
    ("mesh", "words"),
    [
        (torus(), "genus 1, closed"),
        (tetrahedron(), "closed surface of genus 0"),
        (Mesh(grid(6).vertices, np.delete(grid(6).faces, [30], axis=0)), "2 boundary loops"),
        (Mesh(np.vstack([grid(3).vertices] * 2), np.vstack([grid(3).faces, grid(3).faces + 16])), "2 separate components"),
    ],
)
def test_what_is_no_disk_is_refused_by_its_name(mesh, words):
    with pytest.raises(NotSimplyConnectedError, match=words):
        check_mesh(mesh, "disk")


def test_what_fits_a_target_is_taken():
    assert check_mesh(grid(3)).is_disk
    assert check_mesh(grid(3), "disk").is_disk
    assert check_mesh(tetrahedron()).is_sphere
    assert check_mesh(tetrahedron(), "sphere").is_sphere
    with pytest.raises(NotSimplyConnectedError, match="use target free or disk"):
        check_mesh(grid(3), "sphere")


def test_unreferenced_vertices_are_counted_and_harmless():
    mesh = grid(4)
    topology = examine(mesh.faces, len(mesh.vertices) + 3)
    assert topology.unreferenced_count == 3
    assert topology.is_disk
