"""Surfaces cut open, with their vertices split along the cut only."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pgcp.errors import InputError, NotSimplyConnectedError
from pgcp.intake.mend import unmended
from pgcp.intake.opened import Opener
from pgcp.surface.topology import examine
from pgcp.types import Mesh
from tests.meshes import cap, double_torus, holed, icosphere, limbed, tetrahedron, torus

SURFACES = [torus(), double_torus(), icosphere(2), limbed(3), tetrahedron(), holed()]


def opener(mesh):
    return Opener(mesh, examine(mesh.faces, len(mesh.vertices)))


@pytest.mark.parametrize("mesh", SURFACES, ids=lambda mesh: mesh.name)
def test_any_surface_becomes_one_oriented_disk_on_the_same_places(mesh):
    opened = opener(mesh).automatic(20.0)
    assert opened.topology.is_disk
    assert np.array_equal(opened.vertex_of[opened.mesh.faces], mesh.faces)
    assert np.array_equal(opened.vertex_of[: len(mesh.vertices)], np.arange(len(mesh.vertices)))
    assert np.array_equal(opened.mesh.vertices, mesh.vertices[opened.vertex_of])
    # the cut is twice on the boundary, once on each side
    loop = opened.topology.loops[0]
    before = sum(map(len, examine(mesh.faces, len(mesh.vertices)).loops))
    assert len(loop) == 2 * len(opened.edges) + before == 2 * opened.record["edges"] + before


def test_what_is_split_is_the_cut_alone():
    mesh = torus()
    opened = opener(mesh).automatic(20.0)
    split = np.unique(opened.vertex_of[len(mesh.vertices) :])
    assert set(split) <= set(opened.edges.reshape(-1).tolist())


def test_a_disk_whose_scales_are_even_is_not_cut():
    mesh = cap(8)[0]
    opened = opener(mesh).automatic(20.0)
    assert len(opened.edges) == 0
    assert opened.mesh is mesh
    assert opened.after(unmended(mesh)).mesh is mesh


def test_limbs_are_cut_to_their_tips_and_the_bound_is_foretold_to_be_kept():
    mesh = limbed()
    loose, tight = (opener(mesh).automatic(bound) for bound in (1e6, 9.0))
    assert loose.record["foretold_scale_ratio"] > 20.0
    assert tight.record["foretold_scale_ratio"] <= 9.0
    assert tight.record["length_by_diagonal"] > loose.record["length_by_diagonal"]
    assert mesh.vertices[tight.edges.reshape(-1), 2].max() > 3.3  # the limb ends at 3.5


def test_a_cut_is_led_to_where_a_map_squeezes_most():
    mesh = limbed()
    first = opener(mesh)
    opened = first.automatic(1e6)
    on_cut = np.isin(np.arange(len(mesh.vertices)), opened.edges)
    place = int(np.argmax(np.where(on_cut, -np.inf, -mesh.vertices[:, 1])))
    scales = -np.exp(-8.0 * ((mesh.vertices - mesh.vertices[place]) ** 2).sum(axis=1))[opened.vertex_of] * 4.0
    further = first.further(opened, scales, 9.0)
    assert place in further.tips
    assert further.topology.is_disk
    assert first.further(opened, np.zeros(len(scales)), 9.0) is None


def test_polygons_stay_whole_and_chosen_edges_are_all_sides():
    mesh = torus()  # quads of two triangles each
    half = len(mesh.faces) // 2
    quads = np.tile(np.arange(half), 2)
    opened = Opener(mesh, examine(mesh.faces, len(mesh.vertices)), quads).automatic(20.0)
    sides = {tuple(sorted(pair)) for a, b, c in mesh.faces[:half].tolist() for pair in ((a, b), (b, c))}
    sides |= {tuple(sorted(pair)) for a, c, d in mesh.faces[half:].tolist() for pair in ((c, d), (d, a))}
    assert {tuple(pair) for pair in opened.edges.tolist()} <= sides


def grid_loops(n):
    """Edges of a torus round it and round its tube."""
    k = np.arange(n)
    return np.concatenate([np.column_stack([k * n, (k + 1) % n * n]), np.column_stack([k, (k + 1) % n])])


def test_given_edges_are_cut_and_no_others():
    opened = opener(torus(12)).along(grid_loops(12), Path("cut.txt"))
    assert opened.topology.is_disk
    assert {tuple(sorted(pair)) for pair in grid_loops(12).tolist()} == {tuple(pair) for pair in opened.edges.tolist()}


@pytest.mark.parametrize(
    ("mesh", "pairs", "kind", "said"),
    [
        (torus(12), [(0, 30)], InputError, "cut.txt: 0-30 is no edge of torus"),
        (torus(12), [(0, 999)], InputError, "cut.txt: 0-999 is no edge of torus"),
        (
            torus(12),
            grid_loops(12)[:12],
            NotSimplyConnectedError,
            "12 edges, torus is a surface of genus 0, 2 boundary loops; a cut",
        ),
        (icosphere(1), [(0, 12)], NotSimplyConnectedError, "icosphere is a closed surface of genus 0"),
    ],
)
def test_edges_that_open_no_disk_are_refused(mesh, pairs, kind, said):
    if mesh.name == "icosphere":
        pairs = mesh.faces[:1, :2]
    with pytest.raises(kind, match=said):
        opener(Mesh(mesh.vertices, mesh.faces, mesh.name)).along(np.array(pairs), Path("cut.txt"))
