"""Surfaces that other packages hold are mapped as they are; what is none is refused, saying what was given."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import grid, icosphere

import pgcp
from pgcp.api import as_source
from pgcp.io.objects import of_object
from pgcp.types import Mesh, Source

BALL = icosphere(1)
V, F = BALL.vertices, BALL.faces


def gifti(*intents):
    from nibabel.gifti import GiftiDataArray, GiftiImage

    data = {"POINTSET": V.astype("f4"), "TRIANGLE": F.astype("i4")}
    return GiftiImage(darrays=[GiftiDataArray(data[i], f"NIFTI_INTENT_{i}") for i in intents])


def trimesh():
    import trimesh

    return trimesh.Trimesh(V, F, process=False)


def pyvista():
    import pyvista

    return pyvista.PolyData.from_regular_faces(V, F)


def meshio(kind="triangle", cells=F):
    import meshio

    return meshio.Mesh(V, [(kind, cells), ("line", F[:, :2])])


@pytest.mark.parametrize(
    "given",
    [
        lambda: (V, F),
        lambda: [V.tolist(), F.tolist()],
        lambda: BALL,
        trimesh,
        pyvista,
        meshio,
        lambda: gifti("POINTSET", "TRIANGLE"),
    ],
)
def test_a_surface_of_another_package_is_the_same_surface(given):
    mesh = as_source(given())
    assert isinstance(mesh, Mesh)
    assert np.allclose(mesh.vertices, V, atol=1e-7)
    assert np.array_equal(mesh.faces, F)


def test_polygons_of_pyvista_and_meshio_are_kept_and_mapped():
    import meshio
    import pyvista

    plane = pyvista.Plane(i_resolution=3, j_resolution=3)
    quads = plane.faces.reshape(-1, 5)[:, 1:]
    for given in (plane, meshio.Mesh(plane.points, [("quad", quads)]), meshio.Mesh(plane.points, [("polygon", quads)])):
        found = as_source(given)
        assert isinstance(found, Source)
        assert found.sizes.tolist() == [4] * 9
        assert pgcp.compute(given).quality.angle_mean_deg < 1e-6
    mixed = meshio.Mesh(grid(1).vertices, [("triangle", grid(1).faces)])
    assert np.array_equal(as_source(mixed).faces, grid(1).faces)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((V, F.astype(float)), r"faces are of type float64, expected whole numbers; give faces.astype\(int\)"),
        ((V[:, :2], F), r"vertices have shape \(42, 2\), expected \(V, 3\)"),
        ((V, F[:, :2]), r"faces have shape \(80, 2\)"),
        (V, r"not an array of shape \(42, 3\) and type float64"),
        ({"vertices": V}, "not a dict with the keys vertices"),
        (None, "not an object of type NoneType"),
        ((V,), "a mesh is given as tuple of 1; expected two"),
        ((V, F + 100), "face 0 uses vertex"),
        (("a", "b"), "vertices are of type <U1"),
        (([[1, 2], [3]], F), "no tables of numbers"),
    ],
)
def test_what_is_no_surface_is_refused_with_what_was_given(given, said):
    with pytest.raises(pgcp.InputError, match=said):
        pgcp.compute(given)


def test_objects_without_a_surface_are_refused():
    import pyvista

    for given, said in (
        (gifti("POINTSET"), "it holds no surface"),
        (meshio("tetra", np.array([[0, 1, 2, 3]])), "cells of the kind tetra"),
        (meshio("line", F[:, :2]), "it has no polygons"),
        (pyvista.Box().cast_to_unstructured_grid(), r"give its extract_surface\(\)"),
    ):
        with pytest.raises(pgcp.InputError, match=said):
            of_object(given)
