"""What looks at a mesh without compiled code gives what the compiled code gives, to the last bit; refusals compile nothing."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from meshes import grid, icosphere, lifted, torus

import pgcp
from pgcp.intake.check import _extent
from pgcp.intake.holes import _optimal, _plain_optimal
from pgcp.intake.manifold import _fans
from pgcp.surface import plain
from pgcp.surface.operators import _ENOUGH_SPARE, _SPARE, _most_needed, face_areas
from pgcp.surface.topology import _component_count, _fan_starts, _pair, _split_fans
from pgcp.types import Mesh

MESHES = {"hills": lifted(grid(30, jitter=0.3)), "ball": icosphere(3), "torus": torus(), "page": grid(1)}


def same_topology(faces, vertex_count):
    """Twins, counts, fans, both ways."""
    twins, wanted = (np.full(3 * len(faces), -1, np.int32) for _ in range(2))
    count, crowded, turned = plain.pair(faces, twins)
    edge_count, *odd = _pair(faces, wanted, 0, vertex_count)
    assert np.array_equal(twins, wanted)
    assert count == edge_count
    for found, one in zip((crowded, turned), odd, strict=True):
        assert np.array_equal(np.sort(found), np.sort(one))
    assert plain.component_count(twins) == _component_count(twins)
    assert np.array_equal(plain.fans(faces, twins), _fans(faces, twins))
    if not (len(crowded) or len(turned)):
        split = _split_fans(twins, *_fan_starts(faces, twins, vertex_count), 0, vertex_count)
        assert np.array_equal(plain.vertices_of_fans(faces, twins), split)


soups = st.integers(4, 9).flatmap(
    lambda n: st.lists(st.permutations(range(n)).map(lambda p: tuple(p[:3])), min_size=1, max_size=24)
)


@given(soups)
@settings(max_examples=300, deadline=None)
def test_any_soup_has_one_topology(faces):
    same_topology(np.array(faces, np.int32), 9)


@pytest.mark.parametrize("name", MESHES)
def test_meshes_have_one_topology_and_geometry(name):
    mesh = MESHES[name]
    same_topology(mesh.faces, len(mesh.vertices))
    for points in (mesh.vertices, mesh.vertices * np.pi - 1e3, np.round(mesh.vertices * 5)):
        assert plain.face_areas(points, mesh.faces).tobytes() == face_areas(points, mesh.faces).tobytes()
        assert plain.most_needed(points, mesh.faces, _ENOUGH_SPARE, _SPARE) == _most_needed(points, mesh.faces)
        assert np.array_equal(plain.extent(points, mesh.faces[1:]), _extent(points, mesh.faces[1:]))


@pytest.mark.parametrize("n", [3, 4, 5, 12, 40])
def test_a_loop_is_filled_in_one_way(n):
    random = np.random.default_rng(n)
    angles = 2 * np.pi * np.arange(n) / n
    points = np.column_stack([np.cos(angles), np.sin(angles), random.normal(size=n)]) + 0.1 * random.normal(size=(n, 3))
    taken = random.uniform(size=(n, n)) < 0.2
    taken |= taken.T
    assert np.array_equal(_plain_optimal(points, taken), _optimal(points, taken))
    line = np.round(points[:, [0, 0, 1]], 1)  # many costs are equal
    assert np.array_equal(_plain_optimal(line, taken & False), _optimal(line, taken & False))


def ring(n):
    return Mesh(grid(n).vertices, np.delete(grid(n).faces, slice(2 * n + 2, 4 * n - 4), axis=0))


REFUSED = {
    "ring": (ring(9), "2 boundary loops"),
    "torus": (torus(), "genus 1"),
    "two": (Mesh(np.vstack([torus().vertices] * 2), np.vstack([torus().faces, torus().faces + 144])), "genus 1"),
    "holed": (Mesh(grid(20).vertices, grid(20).faces[~np.isin(grid(20).faces, [100, 200]).any(axis=1)]), "--fix would fill 2"),
    "fin": (Mesh(grid(4).vertices, np.vstack([grid(4).faces, [[6, 7, 24]]])), "--fix would cut 1 edge"),
    "bowtie": (Mesh(np.eye(5, 3) + 0.0, np.array([[0, 1, 2], [0, 3, 4]])), "touch in the vertex only"),
    "line": (Mesh(grid(6).vertices * [1.0, 0.0, 0.0], grid(6).faces), "zero area"),
    "voxels": (Mesh(np.round(icosphere(4).vertices * 3), icosphere(4).faces), "--fix would collapse"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_refusal_compiles_nothing(name, tmp_path):
    mesh, words = REFUSED[name]
    pgcp.write_mesh(tmp_path / "mesh.ply", mesh)
    program = """
from numba.core import event
from pgcp.cli.main import main
with event.install_recorder("numba:compile") as recorder:
    status = main(["mesh.ply", "--quiet"])
print(status, len(recorder.buffer))
"""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert words in done.stderr
    assert done.stdout == "2 0\n"
