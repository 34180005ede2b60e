from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
import trimesh
from meshes import grid, lifted

from pgcp.errors import BadFileError, InputError
from pgcp.io.files import replacing
from pgcp.io.read import read_cuts, read_mesh
from pgcp.io.write import write_mesh
from pgcp.types import Mesh


@pytest.fixture(scope="module")
def mesh():
    base = lifted(grid(6, 5))
    order = np.random.default_rng(0).permutation(len(base.vertices))
    inverse = np.argsort(order)
    faces = np.random.default_rng(1).permutation(inverse[base.faces])
    return Mesh(base.vertices[order], faces, "shuffled")


def ply_header(mesh, form, scalar="double", index="int", count="uchar"):
    return (
        f"ply\nformat {form} 1.0\ncomment made for a test\nelement vertex {len(mesh.vertices)}\nproperty {scalar} x\n"
        f"property {scalar} y\nproperty {scalar} z\nelement face {len(mesh.faces)}\n"
        f"property list {count} {index} vertex_indices\nend_header\n"
    )


def ascii_ply(mesh):
    rows = [" ".join(repr(float(c)) for c in v) for v in mesh.vertices]
    rows += ["3 " + " ".join(str(i) for i in f) for f in mesh.faces]
    return (ply_header(mesh, "ascii") + "\n".join(rows) + "\n").encode()


def binary_ply(mesh, order):
    face = np.empty(len(mesh.faces), [("n", "u1"), ("v", f"{order}i4", (3,))])
    face["n"], face["v"] = 3, mesh.faces
    form = "binary_little_endian" if order == "<" else "binary_big_endian"
    return ply_header(mesh, form).encode() + mesh.vertices.astype(f"{order}f8").tobytes() + face.tobytes()


def obj_text(mesh):
    lines = ["# comment", "o thing"]
    lines += ["v " + " ".join(repr(float(c)) for c in v) for v in mesh.vertices]
    lines += ["vt 0 0", "vn 0 0 1", "l 1 2"]
    for k, f in enumerate(mesh.faces + 1):
        a, b, c = f
        lines.append([f"f {a} {b} {c}", f"f {a}/1 {b}/1 {c}/1", f"f {a}//1 {b}//1 {c}//1", f"f {a}/1/1 {b}/1/1 {c}/1/1"][k % 4])
    return "\n".join(lines).encode()


@pytest.mark.parametrize("kind", ["ascii ply", "little ply", "big ply", "obj", "off", "glb", "gltf-free obj with colours"])
def test_vertices_and_faces_keep_the_order_of_the_file(kind, mesh, tmp_path):
    exact = True
    if kind.endswith("ply"):
        path = tmp_path / "m.ply"
        path.write_bytes(ascii_ply(mesh) if kind.startswith("ascii") else binary_ply(mesh, "<" if "little" in kind else ">"))
    elif kind == "obj":
        path = tmp_path / "m.OBJ"
        path.write_bytes(obj_text(mesh))
    elif "colours" in kind:
        path = tmp_path / "m.obj"
        rows = ["v " + " ".join(map(repr, v.tolist())) + " 0.5 0.5 0.5" for v in mesh.vertices]
        path.write_text("\n".join(rows + ["f " + " ".join(map(str, f)) for f in mesh.faces + 1]))
    else:
        path = tmp_path / f"m.{kind}"
        trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)
        exact = False
    read = read_mesh(path)
    assert np.array_equal(read.faces, mesh.faces)
    if exact:
        assert np.array_equal(read.vertices, mesh.vertices)
    else:
        assert np.abs(read.vertices - mesh.vertices).max() < 1e-6


def test_stl_corners_become_vertices_in_order_of_first_use(mesh, tmp_path):
    path = tmp_path / "m.stl"
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)
    read = read_mesh(path)
    assert len(read.vertices) == len(mesh.vertices)
    assert np.abs(read.vertices[read.faces] - mesh.vertices[mesh.faces]).max() < 1e-6
    assert np.array_equal(np.unique(read.faces, return_index=True)[1], np.sort(np.unique(read.faces, return_index=True)[1]))


def test_negative_obj_indices_count_from_the_end(tmp_path):
    path = tmp_path / "relative.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 1 1 0\nf -3 -1 -2\n")
    assert read_mesh(path).faces.tolist() == [[0, 1, 2], [1, 3, 2]]


@pytest.mark.parametrize("suffix", [".obj", ".ply"])
def test_what_is_written_reads_back_with_its_texture_coordinates(suffix, mesh, tmp_path):
    uv = np.random.default_rng(0).random((len(mesh.vertices), 2))
    path = tmp_path / f"out{suffix}"
    write_mesh(path, mesh, uv)
    read = read_mesh(path)
    assert np.array_equal(read.faces, mesh.faces)
    assert np.abs(read.vertices - mesh.vertices).max() < 1e-8
    if suffix == ".obj":
        lines = path.read_text().splitlines()
        vt = np.array([line.split()[1:] for line in lines if line.startswith("vt ")], float)
        assert np.abs(vt - uv).max() < 1e-8
        first = next(line for line in lines if line.startswith("f "))
        assert first == "f " + " ".join(f"{i}/{i}" for i in mesh.faces[0] + 1)
    else:
        from plyfile import PlyData

        vertex = PlyData.read(str(path))["vertex"]
        assert np.abs(np.column_stack([vertex["s"], vertex["t"]]) - uv).max() < 1e-6


def test_text_has_nine_digits_of_every_coordinate(tmp_path):
    rng = np.random.default_rng(7)
    points = grid(30).vertices * 10.0 ** rng.integers(-13, 7, (961, 3)) * rng.choice([-1.0, 1.0], (961, 3))
    points += rng.normal(size=(961, 3)) * np.abs(points)
    points[:4] = [[0.0, -0.0, 1.0], [123456789.0, 0.1, 1e-20], [1e300, -5e-324, 2.0**40], [0.9999999994, 1e22, 0.5]]
    path = tmp_path / "out.obj"
    write_mesh(path, Mesh(points, grid(30).faces))
    lines = [line.split()[1:] for line in path.read_text().splitlines() if line.startswith("v ")]
    assert len(lines) == 961
    for words, row in zip(lines, points.tolist(), strict=True):
        for word, value in zip(words, row, strict=True):
            usual = value == 0.0 or not 1e-14 < abs(value) < 1e9
            assert float(word) == (value if usual else float(f"{value:.9g}"))
            assert usual or len(word.partition("e")[0].replace(".", "").strip("-0")) <= 9


def test_large_meshes_are_written_in_pieces(tmp_path):
    mesh = lifted(grid(360))
    uv = mesh.vertices[:, :2].copy()
    assert len(mesh.vertices) > 100_000
    for suffix in (".ply", ".obj"):
        write_mesh(tmp_path / f"warm{suffix}", grid(2), grid(2).vertices[:, :2])
        path = tmp_path / f"out{suffix}"
        tracemalloc.start()
        write_mesh(path, mesh, uv)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 0.75 * path.stat().st_size
        read = read_mesh(path)
        assert np.array_equal(read.faces, mesh.faces)
        assert np.abs(read.vertices - mesh.vertices).max() < 1e-8


CLOUD = b"""ply
format ascii 1.0
element vertex 1
property float x
property float y
property float z
end_header
0 0 0
"""
BAD = {
    "empty.ply": (b"", "the file is empty"),
    "text.ply": (b"dear sir\nthis is a letter\n", "not a readable PLY"),
    "header.ply": (b"ply\nformat ascii 1.0\nelement vertex 3\n", "not a readable PLY"),
    "cloud.ply": (CLOUD, "no face element"),
    "short.ply": (None, "not a readable PLY"),
    "quads.obj": (b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\nf 1 3 2 3\n", "face 1 has vertex 2 at two of its corners"),
    "zero.obj": (b"v 0 0 0\nv 1 0 0\nv 1 1 0\nf 0 1 2\n", "numbers vertices from 1"),
    "range.obj": (b"v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 9\n", "uses vertex 8"),
    "nan.obj": (b"v 0 0 0\nv nan 0 0\nv 1 1 0\nf 1 2 3\n", "vertex 1 has a coordinate"),
    "words.obj": (b"v 0 zero 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n", "does not hold numbers"),
    "page.obj": (b"<!DOCTYPE html><html></html>", "no vertex lines"),
    "flat.obj": (b"v 0 0\nv 1 0\nv 1 1\nf 1 2 3\n", "fewer than three coordinates"),
    "nofaces.obj": (b"v 0 0 0\nv 1 0 0\n", "no faces"),
    "mesh.xyz": (b"0 0 0\n", "cannot read .xyz"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_with_one_sentence(name, mesh, tmp_path):
    content, words = BAD[name]
    path = tmp_path / name
    path.write_bytes(binary_ply(mesh, "<")[:-40] if content is None else content)
    with pytest.raises(InputError, match=words) as caught:
        read_mesh(path)
    assert "\n" not in str(caught.value)


def test_a_ply_of_quads_is_read_as_triangles(tmp_path):
    text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
    text += "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n"
    (tmp_path / "q.ply").write_text(text)
    assert read_mesh(tmp_path / "q.ply").faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(BadFileError, match="no such file"):
        read_mesh(tmp_path / "nowhere.ply")


def test_cut_files(tmp_path):
    path = tmp_path / "cuts.txt"
    path.write_text("# a path\n0 1\n1, 2   # and on\n\n2 7\n")
    assert read_cuts(path).tolist() == [[0, 1], [1, 2], [2, 7]]
    for text, words in (("0 1\n1 two\n", "line 2"), ("0 1 2\n", "line 1"), ("# none\n", "no cut edges"), ("0 -1\n", "line 1")):
        path.write_text(text)
        with pytest.raises(BadFileError, match=words):
            read_cuts(path)
    with pytest.raises(BadFileError, match="no such file"):
        read_cuts(tmp_path / "nowhere")


def test_a_write_that_fails_leaves_the_earlier_file_and_nothing_else(tmp_path):
    path = tmp_path / "result.bin"
    path.write_bytes(b"earlier")

    def fail():
        with replacing(path) as stream:
            stream.write(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert path.read_bytes() == b"earlier"
    assert [p.name for p in tmp_path.iterdir()] == ["result.bin"]
