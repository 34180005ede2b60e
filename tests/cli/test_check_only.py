"""--check-only: what it says of a mesh, and that it looks at every mesh once."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import grid, lifted, tetrahedron, torus

import pgcp
from pgcp.cli.main import main
from pgcp.intake import check, mend
from pgcp.surface import topology


def holed():
    mesh = lifted(grid(8))
    return pgcp.Mesh(mesh.vertices, np.delete(mesh.faces, [50, 51], axis=0))


def fin():
    """A surface with a face too many at one of its edges."""
    mesh = lifted(grid(8))
    a, b, _ = mesh.faces[60]
    return pgcp.Mesh(np.vstack([mesh.vertices, [0, 0, 9.0]]), np.vstack([mesh.faces, [a, b, len(mesh.vertices)]]))


@pytest.fixture
def looked_at(monkeypatch):
    """The arrays of faces that ``examine`` and the meshes that ``measure`` and ``mend`` are called with."""
    calls = {"examine": [], "measure": [], "mend": []}

    def noted(name, function):
        def call(first, *more):
            calls[name].append(first)
            return function(first, *more)

        return call

    for module, name in (
        (topology, "examine"),
        (check, "examine"),
        (mend, "examine"),
        (check, "measure"),
        (check, "mend"),
        (mend, "mend"),
    ):
        monkeypatch.setattr(module, name, noted(name, getattr(module, name)))
    return calls


# the mesh, options, exit status, meshes examined, measured and mended
LOOKS = {
    "good": (lifted(grid(8)), [], 0, 1, 1, 0),
    "good fix": (lifted(grid(8)), ["--fix"], 0, 1, 1, 1),
    "holed": (holed(), [], 2, 2, 2, 1),  # as it is and filled
    "holed fix": (holed(), ["--fix"], 0, 2, 1, 1),
    "fin": (fin(), [], 2, 2, 2, 1),  # as it is and without the fin
    "fin fix": (fin(), ["--fix"], 0, 2, 1, 1),
    "hopeless": (torus(), [], 2, 1, 1, 1),
    "hopeless fix": (torus(), ["--fix"], 2, 1, 0, 1),
}


@pytest.mark.parametrize("name", LOOKS)
def test_every_mesh_is_examined_once_and_the_given_one_mended_at_most_once(name, looked_at, tmp_path):
    mesh, options, status, *counts = LOOKS[name]
    pgcp.write_mesh(tmp_path / "mesh.ply", mesh)
    assert main([str(tmp_path / "mesh.ply"), "--check-only", *options]) == status
    assert [len(calls) for calls in looked_at.values()] == counts
    assert len({faces.tobytes() for faces in looked_at["examine"]}) == counts[0]


@pytest.mark.parametrize("fix", [False, True])
@pytest.mark.parametrize("make", [lambda: lifted(grid(8)), holed, fin])
def test_a_map_examines_every_mesh_once(make, fix, looked_at):
    try:
        pgcp.parameterize(make(), fix=fix)
    except pgcp.InputError:
        assert not fix
    assert len({faces.tobytes() for faces in looked_at["examine"]}) == len(looked_at["examine"]) <= 2
    assert len(looked_at["mend"]) <= 1


def test_check_only_says_what_the_mesh_is_and_lists_defects(tmp_path, capsys):
    pgcp.write_mesh(tmp_path / "hills.obj", lifted(grid(16, 12)))
    assert main([str(tmp_path / "hills.obj"), "--check-only", "--target", "sphere"]) == 2
    assert "  refused: hills.obj is an open surface (a disk)" in capsys.readouterr().out
    assert main([str(tmp_path / "hills.obj"), "--check-only"]) == 0
    assert "an open surface (a disk) with one boundary loop of 56 edges" in capsys.readouterr().out
    pgcp.write_mesh(tmp_path / "closed.ply", tetrahedron())
    assert main([str(tmp_path / "closed.ply"), "--check-only"]) == 0
    assert "a sphere" in capsys.readouterr().out
    mesh = grid(4)
    faces = np.vstack([mesh.faces, mesh.faces[3:5]])
    pgcp.write_mesh(tmp_path / "twice.obj", pgcp.Mesh(mesh.vertices, faces))
    assert main([str(tmp_path / "twice.obj"), "--check-only"]) == 2
    out = capsys.readouterr().out
    assert "2 faces are listed twice: faces 32, 33" in out
    assert "edges have more than two faces" in out


def test_what_fix_would_do_and_does(tmp_path, capsys):
    pgcp.write_mesh(tmp_path / "holed.ply", holed())
    assert main([str(tmp_path / "holed.ply"), "--check-only"]) == 2
    out = capsys.readouterr().out
    assert "  --fix would fill 1 hole (4 edges) with 2 faces\n" in out
    assert "; no target fits it: free and disk need one open disk with one boundary loop, sphere one closed surface" in out
    assert out.endswith(" of genus 0 (--cut auto opens it to a disk); --fix would fill 1 hole (4 edges) with 2 faces\n")
    assert main([str(tmp_path / "holed.ply"), "--check-only", "--fix"]) == 0
    assert "  fixed: filled 1 hole (4 edges) with 2 faces\n  then it is an open surface" in capsys.readouterr().out
    pgcp.write_mesh(tmp_path / "torus.ply", torus())
    assert main([str(tmp_path / "torus.ply"), "--check-only", "--fix"]) == 2
    assert capsys.readouterr().err.endswith("; --fix does not change the genus\n")
