"""``--cut``: any connected oriented surface gets texture coordinates by corner, on the vertices of the input."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

import pgcp
from pgcp.cli.main import main
from pgcp.errors import InputError, NotManifoldError, NotSimplyConnectedError
from pgcp.surface.topology import examine
from tests.meshes import double_torus, grid, holed, icosphere, limbed, torus


def corners_of(path):
    """Positions, texture coordinates, and both numbers of every corner of an OBJ file."""
    rows = {b"v": [], b"vt": [], b"f": []}
    for line in path.read_bytes().splitlines():
        head, *words = line.split()
        if head in rows:
            rows[head].append([word.split(b"/")[:2] for word in words] if head == b"f" else [float(word) for word in words])
    corners = np.array([[[int(one), int(two)] for one, two in face] for face in rows[b"f"]]) - 1
    return np.array(rows[b"v"])[:, :3], np.array(rows[b"vt"]), corners[..., 0], corners[..., 1]


def edges_where_sides_differ(faces, at):
    """Inner edges (n, 2) of faces (F, k) whose two sides have other texture coordinates, by their numbers at (F, k)."""
    found, differ = {}, []
    for face, places in zip(faces.tolist(), at.tolist(), strict=True):
        for k in range(len(face)):
            one, two = face[k - 1], face[k]
            side = {one: places[k - 1], two: places[k]}
            other = found.setdefault(frozenset((one, two)), side)
            if other != side:
                differ.append((one, two))
    return differ


@pytest.mark.parametrize("mesh", [torus(16), double_torus(), icosphere(3), holed()], ids=lambda mesh: mesh.name)
def test_texture_coordinates_by_corner_agree_but_across_the_cut(mesh, tmp_path, capsys):
    pgcp.write_mesh(tmp_path / "in.obj", mesh)
    assert main([str(tmp_path / "in.obj"), "--cut", "auto", "-o", str(tmp_path / "uv.obj"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    vertices, uv, faces, at = corners_of(tmp_path / "uv.obj")
    assert np.array_equal(faces, mesh.faces)
    assert np.allclose(vertices, mesh.vertices, atol=1e-8)
    assert examine(at, len(uv)).is_disk
    assert len(edges_where_sides_differ(faces, at)) == said["cut"]["edges"]
    assert said["cut"]["scale_ratio"] <= said["cut"]["bound"] == 20.0
    assert said["overlap"]["crossings"] == 0
    assert said["quality"]["folds"] == 0
    a, b, c = (uv[at[:, k]] for k in range(3))
    assert ((b - a)[:, 0] * (c - a)[:, 1] > (b - a)[:, 1] * (c - a)[:, 0]).all()
    again = trimesh.load(tmp_path / "uv.obj", process=False)
    assert len(again.visual.uv) == len(np.unique(at)) > len(np.unique(faces))
    assert len(again.faces) == len(mesh.faces)


def test_in_python_faces_are_of_split_vertices_and_the_way_back_is_told():
    mesh = torus(12)
    result = pgcp.parameterize(mesh, cut="auto", patches=1)
    assert np.array_equal(result.vertex_of[result.faces], mesh.faces)
    assert np.array_equal(result.vertex_of[: len(mesh.vertices)], np.arange(len(mesh.vertices)))
    assert np.array_equal(result.face_of, np.arange(len(mesh.faces)))
    assert examine(result.faces, len(result.coordinates)).is_disk
    assert result.uv.shape == (len(result.vertex_of), 2)
    assert len(result.texture().visual.uv) == len(result.uv)
    assert result.target == "free"
    assert result.report["cut"]["genus"] == 1


def test_formats_that_repeat_vertices_repeat_them_last_with_smooth_normals(tmp_path):
    mesh = torus(12)
    pgcp.write_mesh(tmp_path / "in.ply", mesh)
    files = [str(tmp_path / name) for name in ("out.ply", "out.glb", "out.npz")]
    assert main([str(tmp_path / "in.ply"), "--cut", "auto", "--quiet", *(word for file in files for word in ("-o", file))]) == 0
    ply = trimesh.load(tmp_path / "out.ply", process=False)
    assert np.allclose(ply.vertices[:144], mesh.vertices)
    arrays = np.load(tmp_path / "out.npz")
    assert np.array_equal(arrays["vertex_of"][arrays["faces"]], mesh.faces)
    glb = next(iter(trimesh.load(tmp_path / "out.glb", process=False).geometry.values()))
    assert np.allclose(glb.vertices, mesh.vertices[arrays["vertex_of"]], atol=1e-6)
    normals = np.asarray(glb.vertex_normals)
    assert np.allclose(normals, normals[arrays["vertex_of"]], atol=1e-5)


def loops_file(path, n=12):
    k = np.arange(n)
    pairs = np.concatenate([np.column_stack([k * n, (k + 1) % n * n]), np.column_stack([k, (k + 1) % n])])
    path.write_text("# round the ring, then the tube\n" + "\n".join(f"{a}, {b}" for a, b in pairs.tolist()) + "\n")
    return path


def test_a_planted_cut_is_the_one_that_is_made(tmp_path):
    mesh = torus(12)
    result = pgcp.parameterize(mesh, cut=loops_file(tmp_path / "cut.txt"), patches=1)
    assert result.report["cut"]["edges"] == 24
    assert result.report["cut"]["bound"] is None
    split = np.bincount(result.vertex_of)
    assert split[0] == 4
    assert set(np.flatnonzero(split == 2)) == {*range(1, 12), *range(12, 144, 12)}


def test_a_bound_makes_scales_more_even():
    mesh = limbed(3)
    loose, tight = (pgcp.compute(mesh, pgcp.Options(cut="auto", max_area_distortion=bound, patches=1)) for bound in (1e4, 9.0))
    ratios = [one.report["cut"]["scale_ratio"] for one in (loose, tight)]
    assert ratios[0] > 20.0
    assert ratios[1] <= 9.0


def test_each_component_is_cut(tmp_path):
    one, two = torus(12), icosphere(2)
    mesh = pgcp.Mesh(np.concatenate([one.vertices, two.vertices + 9.0]), np.concatenate([one.faces, two.faces + 144]), "two")
    result = pgcp.parameterize(mesh, cut="auto", component="all")
    assert np.array_equal(result.vertex_of[result.faces], mesh.faces)
    assert [row["target"] for row in result.report["components"]] == ["free", "free"]
    assert result.report["cut"]["genus"] == 1
    pgcp.write_mesh(tmp_path / "two.obj", mesh)
    out = str(tmp_path / "uv.obj")
    assert main([str(tmp_path / "two.obj"), "--cut", "auto", "--component", "all", "-o", out, "--quiet"]) == 0
    vertices, _, faces, at = corners_of(tmp_path / "uv.obj")
    assert np.array_equal(faces, mesh.faces)
    assert len(vertices) == len(mesh.vertices)
    assert len(edges_where_sides_differ(faces, at)) == result.report["cut"]["edges"]


def test_quads_stay_quads_and_colours_stay(tmp_path):
    mesh = torus(12)
    half = len(mesh.faces) // 2
    quads = np.column_stack([mesh.faces[:half], mesh.faces[half:, 2]]) + 1
    lines = [f"v {x} {y} {z} {k % 2} 0 0" for k, (x, y, z) in enumerate(mesh.vertices.tolist())]
    lines += ["f " + " ".join(map(str, quad)) for quad in quads.tolist()]
    (tmp_path / "quads.obj").write_text("\n".join(lines) + "\n")
    assert main([str(tmp_path / "quads.obj"), "--cut", "auto", "-o", str(tmp_path / "uv.obj"), "--quiet"]) == 0
    vertices, uv, faces, _ = corners_of(tmp_path / "uv.obj")
    assert np.array_equal(np.sort(faces), np.sort(quads - 1))
    assert np.allclose(vertices, mesh.vertices, atol=1e-8)
    assert len(uv) > len(vertices)
    assert (tmp_path / "uv.obj").read_text().splitlines()[1].endswith(" 1.0 0.0 0.0")


def test_a_seam_of_the_input_is_joined_before_another_is_cut(tmp_path):
    first = pgcp.parameterize(torus(12), cut="auto", patches=1)
    again = pgcp.parameterize(first.mesh, cut="auto", patches=1)
    assert again.report["cut"]["genus"] == 1
    assert np.array_equal(again.mesh.vertices[again.faces], first.mesh.vertices[first.faces])
    assert len(again.mesh.vertices) >= len(first.mesh.vertices)


def test_holes_are_filled_first_where_that_is_asked_for():
    result = pgcp.parameterize(holed(), cut="auto", fix=True, patches=1)
    assert result.report["cut"]["genus"] == 0
    assert np.array_equal(result.mesh.vertices[result.faces], holed().vertices[holed().faces])


def test_without_a_cut_all_is_as_before():
    with pytest.raises(
        NotSimplyConnectedError, match=r"genus 1, closed; no target fits it: .*\(--cut auto opens it to a disk\)$"
    ):
        pgcp.parameterize(torus())
    assert pgcp.parameterize(grid(4), patches=1).report["cut"] is None


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"cut": "auto", "target": "sphere"}, "--cut opens the surface, and sphere takes closed ones; --cut goes with"),
        ({"cut": "auto", "method": "flash"}, "--cut opens the surface, and sphere takes closed ones; --cut goes with"),
        ({"cut": "auto", "cuts": "seams.txt"}, r"cuts \(seams.txt\) names the seams between patches"),
        ({"max_area_distortion": 20}, "max_area_distortion bounds what a cut that is found leads to; it goes with cut auto"),
        ({"cut": "auto", "max_area_distortion": 1.0}, "max_area_distortion is 1.0, it must be a number above 1"),
        ({"cut": "auto", "max_area_distortion": float("nan")}, "max_area_distortion is nan, it must be a number above 1"),
        ({"cut": ""}, "cut is empty, it must be auto, none or a path"),
        ({"cut": 3}, "cut is 3, it must be text"),
        ({"cut": "nowhere.txt"}, "nowhere.txt"),
        ({"cut": "c.txt", "component": "all"}, "a cut along given edges"),
    ],
)
def test_what_a_cut_does_not_go_with_is_said_before_any_work(options, said):
    def progress(stage, done, total):
        assert stage in ("read", "check", "cut")

    with pytest.raises(InputError, match=said):
        pgcp.parameterize(torus(), progress=progress, **options)


def test_a_moebius_band_is_refused_in_a_sentence():
    k = np.arange(20)
    turn, half = 2 * np.pi * k / 20, np.pi * k / 20
    edge = [np.column_stack([(1 + s * np.cos(half)) * np.cos(turn), (1 + s * np.cos(half)) * np.sin(turn), s * np.sin(half)])
            for s in (-0.3, 0.3)]  # fmt: skip
    after = np.append(k[1:], 20), np.append(k[1:] + 20, 0)
    after[0][-1] = 20
    faces = np.concatenate([np.column_stack([k, after[0], k + 20]), np.column_stack([after[0], after[1], k + 20])])
    with pytest.raises(NotManifoldError, match="not orientable"):
        pgcp.parameterize(pgcp.Mesh(np.concatenate(edge), faces, "band"), cut="auto")


def test_a_mesh_is_looked_at_and_methods_are_compared_as_it_will_be_cut(tmp_path, capsys):
    pgcp.write_mesh(tmp_path / "torus.ply", torus(8))
    assert main([str(tmp_path / "torus.ply"), "--check-only", "--cut", "auto"]) == 0
    assert "targets that fit: free, disk, once it is cut open" in capsys.readouterr().out
    rows = pgcp.compare(torus(8), ["bff", "dncp"], pgcp.Options(cut="auto", target="free"))
    assert [row.problem for row in rows] == ["", ""]
    assert main([str(tmp_path / "torus.ply"), "--cut", "auto", "--output-dir", str(tmp_path / "out")]) == 0
    out = capsys.readouterr().out
    assert "cut open along " in out
    assert "(genus 1, 0 boundaries)" in out
    assert "the map does not overlap itself" in out


@pytest.mark.slow
@pytest.mark.parametrize("name", ["horse", "armadillo", "cow", "camel", "elephant", "spot", "brain", "fandisk"])
def test_real_closed_surfaces_are_laid_out_evenly_without_overlap(name, mesh_folder):
    result = pgcp.parameterize(mesh_folder / "closed" / f"{name}.ply", cut="auto", max_area_distortion=20)
    assert result.report["cut"]["scale_ratio"] <= 20.0
    assert result.report["overlap"]["crossings"] == 0
    assert result.quality.angle_mean_deg < 5.0
