"""The reader against files that are wrong: each is refused with one sentence that says what and where."""

from __future__ import annotations

import gzip
import importlib.util
import json
import os
import struct
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import trimesh
from meshes import grid, lifted
from plyfile import PlyData, PlyElement

from pgcp.errors import BadFileError, InputError
from pgcp.io.read import read_cuts, read_mesh
from pgcp.types import Mesh

_spec = importlib.util.spec_from_file_location("fuzz", Path(__file__).resolve().parents[2] / "scripts" / "fuzz.py")
fuzz = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(fuzz)
GOOD = fuzz.seeds()
V = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
XYZ = "property float x\nproperty float y\nproperty float z\n"
LIST = "property list uchar int vertex_indices\n"


def ply(body, vertex=3, face=1, form="ascii", properties=XYZ, lists=LIST, end="\n"):
    text = f"ply\nformat {form} 1.0\nelement vertex {vertex}\n{properties}element face {face}\n{lists}end_header\n"
    return text.replace("\n", end).encode() + (body.encode() if isinstance(body, str) else body)


def binary(faces, **options):
    return ply(np.zeros(9, "<f4").tobytes() + faces, form="binary_little_endian", **options)


def stl(facets, count=None, start=b""):
    return start.ljust(80) + struct.pack("<I", facets if count is None else count) + bytes(50) * facets


def off(text):
    return ("OFF\n" + text).encode()


def gltf(**changes):
    document = json.loads(GOOD["gltf"][0])
    for path, value in changes.items():
        *keys, last = path.split("__")
        place = document
        for key in keys:
            place = place[int(key) if key.isdigit() else key]
        if value is None:
            del place[last]
        else:
            place[int(last) if last.isdigit() else last] = value
    return json.dumps(document).encode()


CORNERS = "0 0 0\n1 0 0\n0 1 0\n"
FAR = 2**63
TRIANGLE = b"\x03" + bytes(12)
BAD = {
    "huge counts": ("ply", ply("0 0 0\n", vertex=10**15), r"promises 1000000000000000 .* do not fit"),
    "huge binary counts": ("ply", binary(b"", face=10**15), r"at least 1000000000000000 bytes, but only 0 bytes follow"),
    "more digits than a count has": ("ply", ply(CORNERS, face=10**30), "line 7: not a line of a PLY header"),
    "negative count": ("ply", ply(CORNERS, face=-1), "line 7: not a line of a PLY header"),
    "rows of no bytes": ("ply", ply("", face=10**17, lists=""), "element 'face' has no properties"),
    "an element of nothing": ("ply", ply(CORNERS, lists=LIST + "element empty 999999999\n"), "has no properties"),
    "missing row": ("ply", ply(CORNERS + "3 0 1 2\n", face=2), "ends after 1 of the 2 faces"),
    "two numbers": ("ply", ply("0 0 0\n1 0\n0 1 0\n3 0 1 2\n"), "line 11: a vertex line with 2 values where 3 belong: '1 0'"),
    "four numbers": ("ply", ply("0 0 0\n1 0 0 7\n0 1 0\n3 0 1 2\n"), "line 11: a vertex line with 4 values where 3 belong"),
    "row longer than its list": ("ply", ply(CORNERS + "3 0 1 2 9\n"), "line 13: the face's lists"),
    "list longer than its row": ("ply", ply(CORNERS + "99 0 1 2\n"), "line 13: the face's lists"),
    "list of negative length": ("ply", ply(CORNERS + "-3 0 1 2\n"), "line 13: the face's lists"),
    "list of nan length": ("ply", ply(CORNERS + "nan 0 1 2\n"), "line 13: the face's lists"),
    "ascii quad": ("ply", ply(CORNERS + "4 0 1 2 0\n3 0 1 2\n", face=2), "face 0 has vertex 0 at two of its corners"),
    "word in ply": ("ply", ply("0 0 0\n1 x 0\n0 1 0\n3 0 1 2\n"), "line 11: the vertex line does not hold numbers: 'x'"),
    "index 1.5": ("ply", ply(CORNERS + "3 0 1 1.5\n"), "face 0 has 1.5 for a vertex number"),
    "index of 2^63": ("ply", ply(CORNERS + f"3 0 1 {FAR}\n"), r"face 0 has 9.22\d*e\+18 for a vertex number"),
    "index -1": ("ply", ply(CORNERS + "3 0 1 -1\n"), "uses vertex -1"),
    "binary in ascii ply": ("ply", ply(b"0 0 0\n\0\0\0\0"), "byte 6 is zero: this is binary data"),
    "text in binary ply": ("ply", ply("0 0 0 hello\n", form="binary_little_endian"), "promises 3 of the element vertex"),
    "cut-off list": ("ply", binary(b"\x03" + bytes(8)), r"ends within face 0 of 1, which begins at byte \d+"),
    "binary list of -1": (
        "ply", binary(b"\xff" * 13, lists=LIST.replace("uchar", "char")), r"face 0, byte \d+: .* the length -1, below zero",
    ),
    "binary list of 2^32": ("ply", binary(b"\xff" * 13, lists=LIST.replace("uchar", "uint")), "ends within face 0"),
    "list with float length": ("ply", ply(CORNERS, lists=LIST.replace("uchar", "float")), "not a line of a PLY header"),
    "float indices": (
        "ply", binary(b"\x03" + struct.pack("<3f", 0, 1, 0.5), lists=LIST.replace("int", "float")), "face 0 has 0.5",
    ),
    "nan indices": (
        "ply", binary(b"\x03" + struct.pack("<3f", 0, 1, np.nan), lists=LIST.replace("int", "float")), "face 0 has nan",
    ),
    "mixed polygons": ("ply", binary(TRIANGLE + b"\x05" + bytes(20) + TRIANGLE, face=3), "face 1 has vertex 0 at two"),
    "no format": ("ply", ply("").replace(b"format ascii 1.0\n", b""), "no format line"),
    "vertices twice": ("ply", ply("", lists=LIST + "element vertex 3\n" + XYZ), "two elements of one name"),
    "no x": ("ply", ply("", properties=XYZ.replace("x", "r")), "no x, y, z"),
    "x is a list": ("ply", ply("", properties=XYZ.replace("float x", "list uchar float x")), "no x, y, z"),
    "unknown type": ("ply", ply("", properties=XYZ.replace("float", "quad")), "line 4: not a line of a PLY header"),
    "decimal commas": ("obj", b"v 1,5 2,0 3,0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "line 1: '1,5' .* decimal comma"),
    "some decimal commas": ("ply", ply("0 0 0\n1 0,5 0\n0 1 0\n3 0 1 2\n"), "line 11: '0,5' .* decimal comma"),
    "underscores": ("obj", b"v 1_0 2 3\n" + V + b"f 1 2 3\n", "line 1: .*'1_0'"),
    "glued statement": ("obj", b"v1 2 3\n" + V + b"f 1 2 3\n", "line 1 begins with no OBJ statement"),
    "bare numbers": ("obj", V + b"4 5 6\nf 1 2 3\n", "line 4 begins with no OBJ statement"),
    "index of 2^63 in obj": ("obj", V + b"f 1 2 9223372036854775809\n", "line 4: .*'9223372036854775809'"),
    "index of -2^63": ("obj", V + b"f 1 2 -9223372036854775809\n", "line 4: .*'-9223372036854775809'"),
    "float in obj face": ("obj", V + b"f 1 2 3.5\n", "line 4: the face line does not hold vertex numbers: '3.5'"),
    "float of one": ("obj", V + b"f 1 2 3.0\n", "line 4: .*'3.0'"),
    "no number before the slash": ("obj", V + b"f 1 2 /3\n", "line 4: .*'/3'"),
    "backwards too far": ("obj", V + b"f 1 2 -4\n", "line 4: face 0 uses vertex -4, .* only 3 vertices stand before it"),
    "continued, then wrong": ("obj", V + b"f 1 \\\n2 \\\n3\nf 1 2 x\n", "line 7: .*'x'"),
    "two corners": ("obj", V + b"f 1 2 3\nf 1 2\n", "line 5: face 1 has 2 corners"),
    "zeros in obj": ("obj", V + b"\0\0\0", "byte 24 is zero: this is binary data"),
    "empty stl": ("stl", b"solid\nendsolid\n", "no faces"),
    "short stl": ("stl", b"\0" * 20, "20 bytes"),
    "stl of more": ("stl", stl(2, 10**9), "promises 1000000000 facets .* hold 2"),
    "stl of less": ("stl", stl(9, 2), "promises 2 facets .* hold 9"),
    "solid stl of more": ("stl", stl(2, 3, b"solid thing"), "promises 3 facets .* hold 2"),
    "cut-off ascii stl": ("stl", GOOD["stl"][1][:-200], "a facet has|cut off"),
    "ascii stl without end": ("stl", GOOD["stl"][1].replace(b"endsolid s\n", b""), "no line 'endsolid'"),
    "two vertices": ("stl", GOOD["stl"][1].replace(b"vertex", b"vortex", 1), "line 2: a facet has 2 vertices"),
    "loose vertices": ("stl", b"solid\nvertex 0 0 0\nendsolid\n", "1 vertices stand before any facet"),
    "stl of words": ("stl", GOOD["stl"][1].replace(b"vertex 0", b"vertex o", 1), "line 4: .*'o"),
    "off counts": ("off", off("999999999999 1 0\n0 0 0\n"), "line 2 promises 999999999999 vertices .* do not fit"),
    "off count of words": ("off", off("3 one 0\n"), "line 2: not the numbers of vertices"),
    "off without rows": ("off", off("3 1 0\n" + CORNERS + "\n" * 40), "ends after 0 of the 1 faces"),
    "off quad": ("off", off("3 1 0\n" + CORNERS + "4 0 1 2 1\n"), "face 0 has vertex 1 at two of its corners"),
    "off short face": ("off", off("3 1 0\n" + CORNERS + "3 0 1\n"), "line 6: a face line with 3 values where 4 belong"),
    "off index 1.5": ("off", off("3 1 0\n" + CORNERS + "3 0 1 1.5\n"), "face 0 has 1.5"),
    "4d off": ("off", b"4OFF\n3 1 0\n", "it is of the kind '4OFF'"),
    "binary off": ("off", b"OFF BINARY\n\0\0", "OFF BINARY"),
    "no off": ("off", b"3 1 0\n", "does not begin with the word OFF"),
    "short glb": ("glb", b"glTF\2\0\0\0", "within the GLB header"),
    "glb of version 1": ("glb", GOOD["glb"][0].replace(b"glTF\2", b"glTF\1"), "version 1"),
    "glb of more": ("glb", GOOD["glb"][0][:-1], r"promises \d+ bytes, but the file has"),
    "glb chunk of more": ("glb", GOOD["glb"][0][:12] + b"\xff\xff\xff\x7f" + GOOD["glb"][0][16:], "chunk at byte 12 promises"),
    "wrong json": ("gltf", b'{"asset": {}, }', "line 1, column"),
    "nested json": ("gltf", b"[" * 100_000, "nested too deeply"),
    "json of long numbers": ("gltf", b'{"asset": ' + b"9" * 5000 + b"}", "JSON is wrong"),
    "no asset": ("gltf", b'{"error": 404}', "has no asset"),
    "latin-1 json": ("gltf", b'{"asset": "\xe9"}', "not UTF-8"),
    "accessor of more": ("gltf", gltf(accessors__1__count=10**12), "accessor 1 promises 1000000000000 values"),
    "accessor of -1": ("gltf", gltf(accessors__1__count=-1), "count of accessor 1 is '-1'"),
    "accessor of 1.5": ("gltf", gltf(accessors__1__count=1.5), "count of accessor 1 is '1.5'"),
    "accessor of true": ("gltf", gltf(accessors__1__count=True), "count of accessor 1 is 'True'"),
    "accessor without view": ("gltf", gltf(accessors__1__bufferView=None), "no buffer view"),
    "accessor offset": ("gltf", gltf(accessors__1__byteOffset=2**60), "byteOffset of accessor 1"),
    "accessor type": ("gltf", gltf(accessors__1__type="VEC2"), "not three 32-bit floats"),
    "index type": ("gltf", gltf(accessors__0__componentType=5126), "not unsigned whole numbers"),
    "index type of lists": ("gltf", gltf(accessors__0__componentType=[1]), "not unsigned whole numbers"),
    "stride of 1": ("gltf", gltf(bufferViews__1__byteStride=1), "byteStride of 1"),
    "view of more": ("gltf", gltf(bufferViews__1__byteLength=10**9), "ends at byte 1000000108 of a buffer of 300"),
    "view of another buffer": ("gltf", gltf(bufferViews__1__buffer=7), "is 7, but the file has 1 buffers"),
    "buffer of more": ("gltf", gltf(buffers__0__byteLength=10**12), "buffer 0 promises 1000000000000 bytes"),
    "buffer that is not base64": ("gltf", gltf(buffers__0__uri="data:;base64,!!"), "base64 data of buffer 0 are wrong"),
    "buffer at no address": ("gltf", gltf(buffers__0__uri="http:\ud800"), "nothing is fetched"),
    "buffer elsewhere": ("gltf", gltf(buffers__0__uri="https://example.org/x.bin"), "nothing is fetched"),
    "buffer by file url": ("gltf", gltf(buffers__0__uri="file:///etc/passwd"), "nothing is fetched"),
    "buffer outside": ("gltf", gltf(buffers__0__uri="../x.bin"), "lies outside the mesh's folder"),
    "buffer outside, encoded": ("gltf", gltf(buffers__0__uri="%2e%2e/x.bin"), "lies outside the mesh's folder"),
    "buffer at the root": ("gltf", gltf(buffers__0__uri="/etc/passwd"), "lies outside the mesh's folder"),
    "buffer of no name": ("gltf", gltf(buffers__0__uri="a\0b"), "no possible name|cannot be opened"),
    "buffer not there": ("gltf", gltf(buffers__0__uri="x.bin"), "no such file"),
    "nodes in a ring": ("gltf", gltf(nodes__1__children=[0]), "node 0 is reached twice"),
    "nodes that share": ("gltf", gltf(nodes__0__children=[1, 1]), "node 1 is reached twice"),
    "node not there": ("gltf", gltf(nodes__0__children=[2]), "is 2, but the file has 2 nodes"),
    "node of text": ("gltf", gltf(nodes__1="hello"), "number 1 of the nodes is no JSON object"),
    "matrix of 2": ("gltf", gltf(nodes__1__matrix=[1, 2]), "not 16 numbers"),
    "rotation of 0": ("gltf", gltf(nodes__1__rotation=[0, 0, 0, 0]), "no unit quaternion"),
    "no mode": ("gltf", gltf(meshes__0__primitives__0__mode=7), "has mode 7, which glTF does not know"),
    "lines only": ("gltf", gltf(meshes__0__primitives__0__mode=1), "no triangles"),
    "no attributes": ("gltf", gltf(meshes__0__primitives__0__attributes=None), "has no attributes"),
    "compressed": ("gltf", gltf(extensionsRequired=["KHR_draco_mesh_compression"]), "KHR_draco_mesh_compression"),
    "used again and again": (
        "gltf", gltf(nodes=[{"mesh": 0}] * 99, scenes__0__nodes=list(range(99))), "again and again",
    ),
    "index too large": ("gltf", gltf(accessors__1__count=3), "uses vertex 15, but it has vertices 0 to 2"),
    "page": ("ply", b"\n <!DOCTYPE html><html>", "it looks like an HTML page"),
    "json": ("obj", b'{"message": "Not Found"}', "it looks like JSON text"),
    "json off": ("off", b'["no"]', "it looks like JSON text"),
    "pointer": ("glb", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "it looks like a git-LFS pointer"),
    "gzip": ("ply", gzip.compress(GOOD["ply"][0], mtime=0), "it looks like gzip"),
    "zip": ("stl", b"PK\3\4" + bytes(200), "it looks like a zip archive"),
    "ply named obj": ("obj", GOOD["ply"][0], "it looks like PLY; name it .ply"),
    "glb named gltf": ("stl", GOOD["glb"][0], "it looks like GLB"),
    "stl named off": ("off", GOOD["stl"][1], "it looks like ascii STL"),
    "utf-16": ("obj", (V + b"f 1 2 3\n").decode().encode("utf-16"), "it looks like UTF-16 text"),
    "utf-16 off": ("off", GOOD["off"][0].decode().encode("utf-16"), "it looks like UTF-16 text"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_contents_are_refused_saying_what_and_where(name, tmp_path):
    suffix, content, words = BAD[name]
    path = tmp_path / f"m.{suffix}"
    path.write_bytes(content)
    start = time.perf_counter()
    with pytest.raises(InputError, match=words) as caught:
        read_mesh(path)
    assert time.perf_counter() - start < 5
    assert "\n" not in str(caught.value)
    assert "m." in str(caught.value)
    if suffix == "gltf":  # it is JSON text, as it should be
        assert "looks like" not in str(caught.value)


LONG = {
    "rows of changing length": ("ply", binary(b"\0\0\1\0" * 250_000, face=600_000, lists=LIST.replace("int", "uchar"))),
    "rows of nothing": ("ply", ply(CORNERS + "0\n" * 400_000, face=400_000)),
    "short vertex lines": ("obj", b"v \n" * 300_000),
    "short face lines": ("obj", V + b"f\n" * 450_000),
    "one long line": ("obj", V + b"f " + b"1 " * 450_000),
    "one long corner": ("obj", V + b"f 1/" + b"/" * 900_000 + b" 2 3 4\n"),
    "joined lines": ("obj", V + b"f 1 2 \\\n" * 100_000),
    "comments": ("off", b"#\n" * 450_000),
    "blanks": ("off", b" " * 900_000),
    "header lines": ("ply", b"ply\n" + b"comment\n" * 110_000),
    "elements": ("ply", b"ply\nformat ascii 1.0\n" + b"element e 0\n" * 80_000 + b"end_header\n"),
    "facets": ("stl", b"solid\n" + b"facet\n" * 150_000),
    "lists of json": ("gltf", b'{"asset": {}, "nodes": [' + b"[], " * 220_000 + b"0]}"),
    "a chain of nodes": ("gltf", json.dumps({"asset": {}, "nodes": [{"children": [i + 1]} for i in range(40_000)]}).encode()),
}


@pytest.mark.parametrize("name", LONG)
def test_files_made_to_take_long_are_refused_soon_and_in_little_memory(name, tmp_path):
    suffix, content = LONG[name]
    path = tmp_path / f"m.{suffix}"
    path.write_bytes(content)
    assert 800_000 < len(content) < 1_200_000
    start = time.process_time()
    with pytest.raises(InputError):
        read_mesh(path)
    assert time.process_time() - start < 5
    if name not in ("rows of nothing", "one long line", "one long corner", "joined lines", "blanks"):
        return  # tracing memory makes many small objects twenty times as slow
    tracemalloc.start()
    try:
        with pytest.raises(InputError):
            read_mesh(path)
        assert tracemalloc.get_traced_memory()[1] < 10 * len(content) + 100e6
    finally:
        tracemalloc.stop()


OTHER_SPELLINGS = {
    "crlf": lambda kind, data: data.replace(b"\n", b"\r\n"),
    "cr": lambda kind, data: data.replace(b"\n", b"\r"),
    "byte order mark": lambda kind, data: data if kind == "ply" else b"\xef\xbb\xbf" + data,
    "blank lines": lambda kind, data: data if kind == "ply" else data.replace(b"\n", b"\n \n"),
    "blanks": lambda kind, data: data.replace(b"\n", b" \t\n"),
    "no last line end": lambda kind, data: data.rstrip(),
}
TEXTS = [("ply", 0), ("obj", 0), ("obj", 1), ("stl", 1), ("off", 0), ("gltf", 0)]


@pytest.mark.parametrize("spelling", OTHER_SPELLINGS)
@pytest.mark.parametrize(("kind", "number"), TEXTS)
def test_line_ends_and_marks_make_no_difference(kind, number, spelling, tmp_path):
    if number == 1 and "blank" in spelling:
        number = kind == "stl"  # a backslash followed by blanks continues no line
    (tmp_path / f"a.{kind}").write_bytes(GOOD[kind][number])
    (tmp_path / f"b.{kind}").write_bytes(OTHER_SPELLINGS[spelling](kind, GOOD[kind][number]))
    one, two = (read_mesh(tmp_path / f"{name}.{kind}") for name in "ab")
    assert np.array_equal(one.vertices, two.vertices)
    assert np.array_equal(one.faces, two.faces)


def test_the_formats_agree(tmp_path):
    meshes = {}
    for kind in fuzz.FORMATS[:-1]:
        for number, data in enumerate(GOOD[kind]):
            (tmp_path / f"m.{kind}").write_bytes(data)
            meshes[kind, number] = read_mesh(tmp_path / f"m.{kind}")
    first = meshes["ply", 0]
    for (kind, _), mesh in meshes.items():
        scale, shift = (2, [2, 0, 0]) if kind.startswith("gl") else (1, 0)
        place = first.vertices * scale + shift
        faces = first.faces[: len(mesh.faces)]
        assert np.allclose(mesh.vertices[mesh.faces][:9], place[faces][:9])


def test_obj_corners_of_every_kind_and_continued_lines(tmp_path):
    (tmp_path / "m.obj").write_text(
        "  v 0 0 0\nv 1 0 \\\n0\nv 0 1 0 # here\nv 1 1 0\nf 1/7 2//8 \\\n3/9/9\n\tf -3 -1/1 -2//2 # \n"
    )
    mesh = read_mesh(tmp_path / "m.obj")
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    assert mesh.faces.tolist() == [[0, 1, 2], [1, 3, 2]]


@pytest.mark.parametrize("form", ["<", ">", "="])
def test_ply_rows_of_lists_of_changing_length(form, tmp_path):
    random = np.random.default_rng(0)
    mesh = lifted(grid(40))
    vertex = np.array([tuple(v) for v in mesh.vertices], [("x", "f8"), ("y", "f8"), ("z", "f8")])
    face = np.empty(len(mesh.faces), [("extra", object), ("vertex_indices", object), ("flags", "i4")])
    face["flags"] = 7
    for k, f in enumerate(mesh.faces):
        # long runs of one length, then changing ones
        face[k] = (np.zeros(2 if k < 900 else random.integers(0, 5), "f4"), f.astype("i4"), 7)
    elements = [PlyElement.describe(vertex, "vertex"), PlyElement.describe(face, "face", val_types={"extra": "f4"})]
    text = form == "="
    PlyData(elements, text=text, byte_order=form).write(str(tmp_path / "m.ply"))
    read = read_mesh(tmp_path / "m.ply")
    assert np.array_equal(read.faces, mesh.faces)
    assert np.array_equal(read.vertices, mesh.vertices)


@pytest.mark.parametrize("suffix", ["off", "glb", "stl"])
def test_trimesh_reads_the_same(suffix, tmp_path):
    mesh = lifted(grid(9))
    path = tmp_path / f"m.{suffix}"
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)
    theirs = trimesh.load(path, process=False, force="mesh")
    ours = read_mesh(path)
    assert np.array_equal(ours.vertices[ours.faces], np.asarray(theirs.vertices, float)[theirs.faces])


def test_a_scene_of_turned_and_mirrored_nodes_is_that_of_trimesh(tmp_path):
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3], [1, 0, 0])
    box = trimesh.Trimesh(grid(3).vertices, grid(3).faces, process=False)
    scene = trimesh.Scene()
    scene.add_geometry(box, transform=turn)
    scene.add_geometry(
        trimesh.Trimesh(lifted(grid(2)).vertices, grid(2).faces, process=False), transform=np.diag([1, 1, -2, 1.0])
    )
    scene.export(tmp_path / "m.glb")
    ours, theirs = read_mesh(tmp_path / "m.glb"), trimesh.load(tmp_path / "m.glb", force="mesh", process=False)
    corners = ours.vertices[ours.faces]
    others = np.asarray(theirs.vertices)[theirs.faces]

    def ordered(points):  # faces in the order of their centres, corners in cyclic order from the lowest on
        points = points[np.lexsort(np.round(points.mean(axis=1), 5).T)]
        start = np.argmin(points @ [1.0, 0.3, 0.1], axis=1)[:, None]
        return points[np.arange(len(points))[:, None], (start + np.arange(3)) % 3]

    assert np.abs(ordered(corners) - ordered(others)).max() < 1e-6


def test_primitives_that_share_positions_share_vertices(tmp_path):
    halves = [{"attributes": {"POSITION": 1}, "indices": 0}, {"attributes": {"POSITION": 1}, "indices": 2}]
    document = json.loads(gltf(meshes__0__primitives=halves))
    document["accessors"][0]["count"] = 27
    document["accessors"].append({**document["accessors"][0], "byteOffset": 54})
    (tmp_path / "m.gltf").write_text(json.dumps(document))
    (tmp_path / "whole.gltf").write_bytes(GOOD["gltf"][0])
    halves, whole = read_mesh(tmp_path / "m.gltf"), read_mesh(tmp_path / "whole.gltf")
    assert np.array_equal(halves.vertices, whole.vertices)
    assert np.array_equal(halves.faces, whole.faces)


def test_a_buffer_beside_the_file_is_read_and_a_link_out_of_the_folder_is_not(tmp_path):
    import base64

    data = base64.b64decode(json.loads(GOOD["gltf"][0])["buffers"][0]["uri"].split(",")[1])
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "m.gltf").write_bytes(gltf(buffers__0__uri="the%20data.bin"))
    (folder / "the data.bin").write_bytes(data)
    assert len(read_mesh(folder / "m.gltf").faces) == 18
    (folder / "the data.bin").rename(tmp_path / "data.bin")
    (folder / "the data.bin").symlink_to(tmp_path / "data.bin")
    with pytest.raises(BadFileError, match="outside the mesh's folder"):
        read_mesh(folder / "m.gltf")


@pytest.mark.parametrize("read", [read_mesh, read_cuts])
def test_what_is_no_file_is_refused_at_once(read, tmp_path):
    (tmp_path / "folder.ply").mkdir()
    os.mkfifo(tmp_path / "pipe.ply")
    (tmp_path / "null.ply").symlink_to("/dev/zero")
    (tmp_path / "ring.ply").symlink_to(tmp_path / "ring.ply")
    said = {"folder": "it is a folder", "pipe": "pipe", "null": "pipe or device", "ring": "cannot be opened"}
    for name, words in said.items():
        with pytest.raises(BadFileError, match=words):
            read(tmp_path / f"{name}.ply")
    with pytest.raises(BadFileError, match=r"cannot be opened|no such file"):
        read("a\0b.ply")
    with pytest.raises(BadFileError, match="cannot be opened"):
        read("x" * 5000 + ".ply")


def test_an_unreadable_file_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "m.ply"
    path.write_bytes(GOOD["ply"][0])
    path.chmod(0)
    if os.access(path, os.R_OK):  # an administrator may read everything
        opened = os.open
        monkeypatch.setattr(
            os, "open", lambda p, *a: opened(p, *a) if p != path else (_ for _ in ()).throw(PermissionError(13, "no"))
        )
    with pytest.raises(BadFileError, match="cannot be opened"):
        read_mesh(path)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"0 1\n" + b"9" * 5000 + b" 1\n", "line 2 has a vertex id that no mesh has"),
        (b"0 1\n9223372036854775808 1\n", "line 2 has a vertex id that no mesh has"),
        ("0 \u00b2\n".encode(), "line 1 is not a pair"),
        ("0 \u0663\n".encode(), "line 1 is not a pair"),
        (b"0 1.0\n", "line 1 is not a pair"),
        (b"0 nan\n", "line 1 is not a pair"),
        ("0 1\n".encode("utf-16"), "it looks like UTF-16"),
        (b"\0\1\2", "binary data"),
        (gzip.compress(b"0 1\n" * 99, mtime=0), "binary data.*gzip|gzip"),
    ],
)
def test_bad_cut_files_are_refused(data, words, tmp_path):
    (tmp_path / "cuts").write_bytes(data)
    with pytest.raises(BadFileError, match=words):
        read_cuts(tmp_path / "cuts")


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_cut_files_with_any_line_end(end, tmp_path):
    (tmp_path / "cuts").write_bytes(b"\xef\xbb\xbf" + f"0 1{end}{end}1,2{end}".encode())
    assert read_cuts(tmp_path / "cuts").tolist() == [[0, 1], [1, 2]]


def test_many_blocks_are_one_file(tmp_path, monkeypatch):
    from pgcp.io import ply_lists as ply_module
    from pgcp.io import text

    mesh = lifted(grid(30))
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    for name, options in {
        "m.ply": {"encoding": "ascii"},
        "m.obj": {},
        "m.off": {},
        "m.stl": {"file_type": "stl_ascii"},
    }.items():
        solid.export(tmp_path / name, **options)
        monkeypatch.setattr(text, "_BLOCK", 1 << 22)
        once = read_mesh(tmp_path / name)
        monkeypatch.setattr(text, "_BLOCK", 300)
        again = read_mesh(tmp_path / name)
        assert np.array_equal(once.faces, again.faces)
        assert np.array_equal(once.vertices, again.vertices)
    monkeypatch.setattr(ply_module, "_MOST_AHEAD", 100)
    solid.export(tmp_path / "b.ply")
    assert np.array_equal(read_mesh(tmp_path / "b.ply").faces, mesh.faces)


def test_a_mesh_keeps_its_own_refusals():
    with pytest.raises(InputError, match="expected \\(F, 3\\) integers"):
        Mesh(np.zeros((3, 3)), np.zeros((1, 3)))
