"""Polygons, names, colours, materials, normals and further properties go through to the files that can hold them."""

from __future__ import annotations

import json
import struct
from itertools import pairwise

import numpy as np
import pytest
import pyvista
import trimesh

import pgcp
from pgcp.cli.main import main
from pgcp.io.read import read_source
from pgcp.types import Source

RNG = np.random.default_rng(5)


def quad_ball(n=4):
    """A ball of quads: vertices (V, 3) and quads (Q, 4), counter-clockwise from outside."""
    ticks, points, quads = np.linspace(-1, 1, n + 1), {}, []
    for axis in range(3):
        for side in (-1, 1):
            for i in range(n):
                for j in range(n):
                    quad = []
                    for a, b in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)):
                        place = np.zeros(3)
                        place[[axis, (axis + 1) % 3, (axis + 2) % 3]] = side, ticks[a], ticks[b]
                        quad.append(points.setdefault(tuple(place), len(points)))
                    quads.append(quad[::side])
    vertices = np.array(list(points))
    return vertices / np.linalg.norm(vertices, axis=1)[:, None], np.array(quads)


V, Q = quad_ball()
QUADS = Q.tolist()
COLOURS = RNG.integers(0, 256, (len(V), 3))


def mixed_polygons():
    """The ball with some quads as triangles, and two quads as one hexagon."""
    one, two = Q[0].tolist(), Q[1].tolist()
    shared = [v for v in one if v in two]
    while {one[0], one[3]} != set(shared):
        one = one[1:] + one[:1]
    while {two[0], two[3]} != set(shared):
        two = two[1:] + two[:1]
    polygons = [one + two[1:3], *Q[2:-9].tolist()]
    for a, b, c, d in Q[-9:].tolist():
        polygons += [[a, b, c], [a, c, d]]
    return polygons


MIXED = mixed_polygons()


def write_obj(path, polygons=QUADS, backwards=True):
    lines = ["mtllib ball.mtl", "o Ball"]
    lines += [f"v {x!r} {y!r} {z!r} {r / 255:.6f} {g / 255:.6f} {b / 255:.6f}" for (x, y, z), (r, g, b) in
              zip(V.tolist(), COLOURS.tolist(), strict=True)]  # fmt: skip
    lines += [f"vn {x!r} {y!r} {z!r}" for x, y, z in V.tolist()]
    lines += ["vt 0 0", "g half", "usemtl red"]
    for k, polygon in enumerate(polygons):
        if k == len(polygons) // 2:
            lines += ["g rest", "usemtl blue", "s 1"]
        shift = -len(V) if backwards else 1
        lines.append("f " + " ".join(f"{v + shift}/1/{v + shift}" for v in polygon))
    path.write_text("\n".join(lines) + "\n")
    (path.parent / "ball.mtl").write_text("newmtl red\nKd 1 0 0\n\nnewmtl blue\nKd 0 0 1\n")


def write_ply(path, order):
    """A PLY of mixed polygons, with a property before and one after the list."""
    kind = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[order]
    head = ["ply", f"format {order} 1.0", f"element vertex {len(V)}", *(f"property double {c}" for c in "xyz")]
    head += [*(f"property uchar {c}" for c in ("red", "green", "blue")), "property float confidence"]
    head += [f"element face {len(MIXED)}", "property int flag", "property list uchar int vertex_indices", "property float w"]
    data = ("\n".join([*head, "end_header"]) + "\n").encode()
    for k, (place, colour) in enumerate(zip(V.tolist(), COLOURS.tolist(), strict=True)):
        row = [*place, *colour, k / 8]
        data += (" ".join(map(repr, row)) + "\n").encode() if not kind else struct.pack(kind + "3d3Bf", *row)
    for k, polygon in enumerate(MIXED):
        row = [k, len(polygon), *polygon, k / 4]
        n = len(polygon)
        data += (" ".join(map(repr, row)) + "\n").encode() if not kind else struct.pack(f"{kind}iB{n}if", *row)
    path.write_bytes(data)


def faces_of(path):
    """Faces of an OBJ file, each corner as numbers from 0 of vertex, texture coordinates and normal."""
    lines = [line.split()[1:] for line in path.read_text().splitlines() if line.startswith("f ")]
    return [[[int(number) - 1 for number in corner.split("/")] for corner in line] for line in lines]


def polygons_of(source):
    ends = np.arange(0, len(source.corners) + 1, 3) if source.offsets is None else source.offsets
    return [source.corners[a:b].tolist() for a, b in pairwise(ends)]


def mapped(path, tmp_path, *more):
    out = tmp_path / "out"
    assert main([str(path), "--output-dir", str(out), "--write", "obj,ply,glb,vtp,npz,off", "--quiet", "--no-png", *more]) == 0
    return {kind: out / f"{path.stem}.{kind}" for kind in ("obj", "ply", "glb", "vtp", "npz", "off")}


def document(path):
    data = path.read_bytes()
    return json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])


def test_quads_of_an_obj_come_back_with_all_that_was_said_of_them(tmp_path):
    write_obj(tmp_path / "ball.obj")
    files = mapped(tmp_path / "ball.obj", tmp_path)
    corners = np.array(faces_of(files["obj"]))
    assert np.array_equal(corners[:, :, 0], Q)
    assert np.array_equal(corners[:, :, 2], Q)
    text = files["obj"].read_text().splitlines()
    kept = [line for line in text if line.split()[0] in ("mtllib", "o", "g", "usemtl", "s")]
    assert kept == ["mtllib ball.mtl", "o Ball", "g half", "usemtl red", "g rest", "usemtl blue", "s 1"]
    at = text.index("usemtl blue")
    assert sum(line.startswith("f ") for line in text[:at]) == len(Q) // 2
    assert (files["obj"].parent / "ball.mtl").read_text() == (tmp_path / "ball.mtl").read_text()
    vertices = np.array([line.split()[1:] for line in text if line.startswith("v ")], float)
    assert np.abs(vertices[:, :3] - V).max() < 1e-8
    assert np.abs(vertices[:, 3:] * 255 - COLOURS).max() < 1e-3
    # every quad has one place on the texture, also across the date line
    uv = np.array([line.split()[1:] for line in text if line.startswith("vt ")], float)
    away = np.abs(V[:, 2]) < 0.8
    inner = away[Q].all(axis=1)
    assert np.ptp(uv[corners[inner][:, :, 1], 0], axis=1).max() < 0.3
    again = trimesh.load(files["obj"], process=False)
    assert sum(len(one.faces) for one in again.geometry.values()) == 2 * len(Q)


def test_an_obj_s_materials_and_colours_are_in_its_glb(tmp_path):
    write_obj(tmp_path / "ball.obj")
    files = mapped(tmp_path / "ball.obj", tmp_path)
    said = document(files["glb"])
    assert [m["name"] for m in said["materials"]] == ["red", "blue"]
    assert said["materials"][1]["pbrMetallicRoughness"]["baseColorFactor"] == [0, 0, 1, 1]
    primitives = said["meshes"][0]["primitives"]
    assert [p["material"] for p in primitives] == [0, 1]
    assert [said["accessors"][p["indices"]]["count"] for p in primitives] == [3 * len(Q), 3 * len(Q)]
    assert "COLOR_0" in primitives[0]["attributes"]
    scene = trimesh.load(files["glb"], process=False)
    assert sum(len(one.faces) for one in scene.geometry.values()) == 2 * len(Q)
    source = read_source(files["glb"])
    back = np.column_stack([source.of_vertices[name] for name in ("red", "green", "blue")])[: len(V)]
    assert np.abs(back * 255 - COLOURS).max() < 1e-2
    assert np.abs(source.normals[: len(V)] - V).max() < 1e-6


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_polygons_and_properties_of_a_ply_go_through(order, tmp_path):
    write_ply(tmp_path / "ball.ply", order)
    source = read_source(tmp_path / "ball.ply")
    assert polygons_of(source) == MIXED
    files = mapped(tmp_path / "ball.ply", tmp_path)
    back = read_source(files["ply"])
    assert polygons_of(back) == MIXED
    assert back.of_vertices["red"].dtype == np.uint8
    for name, values in source.of_vertices.items():
        assert np.array_equal(back.of_vertices[name], values), name
    assert np.array_equal(back.of_polygons["flag"], np.arange(len(MIXED)))
    assert np.array_equal(back.of_polygons["w"], np.arange(len(MIXED), dtype=np.float32) / 4)
    assert [[corner[0] for corner in face] for face in faces_of(files["obj"])] == MIXED
    assert polygons_of(read_source(files["off"])) == MIXED
    other = pyvista.read(files["ply"])
    assert [list(cell.point_ids) for cell in other.cell] == MIXED
    assert np.array_equal(other.point_data["RGB"], COLOURS)
    vtp = pyvista.read(files["vtp"])
    assert np.array_equal(vtp.point_data["RGB"], COLOURS)
    assert np.array_equal(vtp.cell_data["flag"], vtp.cell_data["polygon_of"])
    assert np.allclose(vtp.point_data["confidence"], np.arange(len(V)) / 8)
    assert vtp.n_cells == sum(len(polygon) - 2 for polygon in MIXED)


def test_a_ply_of_quads_is_opened_by_others(tmp_path):
    meshio = pytest.importorskip("meshio")
    write_obj(tmp_path / "ball.obj")
    files = mapped(tmp_path / "ball.obj", tmp_path)
    assert np.array_equal(meshio.read(files["ply"]).cells_dict["quad"], Q)
    assert len(trimesh.load(files["ply"], process=False).faces) == 2 * len(Q)


def test_strips_are_triangles(tmp_path):
    n = 5
    points = [(i, j, 0.1 * i * j) for i in range(n) for j in range(n)]
    strips = []
    for i in range(n - 1):
        strips += [corner for j in range(n) for corner in (i * n + j, (i + 1) * n + j)] + [-1]
    text = f"ply\nformat ascii 1.0\nelement vertex {n * n}\nproperty float x\nproperty float y\nproperty float z\n"
    text += "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    text += "".join(f"{x} {y} {z}\n" for x, y, z in points) + f"{len(strips)} {' '.join(map(str, strips))}\n"
    (tmp_path / "strips.ply").write_text(text)
    mesh = pgcp.read_mesh(tmp_path / "strips.ply")
    assert len(mesh.faces) == 2 * (n - 1) ** 2
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    turning = np.cross(b - a, c - a)[:, 2]
    assert (turning < 0).all() or (turning > 0).all()
    assert pgcp.parameterize(mesh, patches=1).quality.folds == 0


def test_colours_and_polygons_of_an_off_file(tmp_path):
    lines = ["COFF", f"{len(V)} {len(MIXED)} 0"]
    lines += [" ".join(map(repr, [*place, *colour, 255])) for place, colour in zip(V.tolist(), COLOURS.tolist(), strict=True)]
    lines += [
        " ".join(map(str, [len(polygon), *polygon, *([0.5, 0.5, 0.5] if k % 2 else [])])) for k, polygon in enumerate(MIXED)
    ]
    (tmp_path / "ball.off").write_text("\n".join(lines) + "\n")
    source = read_source(tmp_path / "ball.off")
    assert polygons_of(source) == MIXED
    files = mapped(tmp_path / "ball.off", tmp_path)
    assert np.array_equal(read_source(files["ply"]).of_vertices["green"], COLOURS[:, 1])


def test_a_split_glb_gives_its_names_materials_and_normals(tmp_path):
    ball = trimesh.creation.icosphere(2)
    flat = trimesh.Trimesh(ball.vertices[ball.faces].reshape(-1, 3), np.arange(ball.faces.size).reshape(-1, 3), process=False)
    flat.visual = trimesh.visual.TextureVisuals(
        uv=np.zeros((len(flat.vertices), 2)),
        material=trimesh.visual.material.PBRMaterial("skin", baseColorFactor=[255, 0, 0, 255]),
    )
    eye = trimesh.creation.icosphere(1)
    scene = trimesh.Scene()
    scene.add_geometry(flat, node_name="Head", geom_name="HeadMesh")
    place = trimesh.transformations.translation_matrix([5, 0, 0])
    scene.add_geometry(eye, node_name="Eye", geom_name="EyeMesh", transform=place)
    flat.vertex_normals  # noqa: B018  trimesh writes them once they are known
    scene.export(tmp_path / "scene.glb")
    files = mapped(tmp_path / "scene.glb", tmp_path)
    assert np.array_equal(read_source(files["ply"]).vertices, flat.vertices.astype(np.float32))
    text = files["obj"].read_text().splitlines()
    assert [line for line in text if line[0] in "mou"] == ["mtllib materials.mtl", "o Head", "usemtl skin"]
    assert document(files["glb"])["materials"][0]["name"] == "skin"
    with np.load(files["npz"]) as data:
        assert len(data["sphere"]) == len(flat.vertices)
    files = mapped(tmp_path / "scene.glb", tmp_path, "--component", "Eye")
    assert len(read_source(files["ply"]).vertices) == len(eye.vertices)
    files = mapped(tmp_path / "scene.glb", tmp_path, "--component", "EyeMesh")
    assert len(read_source(files["ply"]).vertices) == len(eye.vertices)


def test_plain_triangles_are_no_more_than_that(tmp_path):
    ball = trimesh.creation.icosphere(1)
    for name in ("a.ply", "b.off", "c.stl"):
        ball.export(tmp_path / name)
        source = read_source(tmp_path / name)
        assert isinstance(source, Source)
        assert source.is_plain
        assert pgcp.parameterize(tmp_path / name).origin is None


def test_a_result_in_python_has_the_polygons_too(tmp_path):
    write_obj(tmp_path / "ball.obj", MIXED, backwards=False)
    result = pgcp.parameterize(tmp_path / "ball.obj")
    assert result.report["input"][0]["message"].startswith(f"{sum(len(p) > 3 for p in MIXED)} polygons")
    assert polygons_of(result.origin.source) == MIXED
