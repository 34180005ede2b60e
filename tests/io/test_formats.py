"""Every format of the registry: what is written is read back by a reader that is not ours."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from meshes import grid, lifted, spheroid
from plyfile import PlyData

import pgcp
from pgcp.cli.main import main
from pgcp.errors import BadFileError, InputError
from pgcp.io import formats
from pgcp.io.formats import DEFAULT_OUTPUTS, FORMATS, Format, outputs, readable, register, writable
from pgcp.io.write import write_mesh, write_outputs


def by_trimesh(data, kind):
    mesh = trimesh.load_mesh(io.BytesIO(data), file_type=kind, process=False, maintain_order=True)
    found = {"vertices": np.asarray(mesh.vertices), "faces": np.asarray(mesh.faces)}
    uv = getattr(mesh.visual, "uv", None)
    return found if uv is None else {**found, "uv": np.asarray(uv)}


def by_plyfile(data):
    ply = PlyData.read(io.BytesIO(data))
    vertex = ply["vertex"]
    names = {"vertices": ("x", "y", "z"), "uv": ("s", "t"), "sphere": ("sx", "sy", "sz")}
    fields = {p.name for p in vertex.properties}
    found = {name: np.column_stack([vertex[c] for c in columns]) for name, columns in names.items() if {*columns} <= fields}
    return {**found, "faces": np.vstack(ply["face"]["vertex_indices"])}


def by_numpy(data):
    with np.load(io.BytesIO(data)) as arrays:
        return dict(arrays)


def by_collada(data):
    import collada

    triangles = collada.Collada(io.BytesIO(data)).geometries[0].primitives[0]
    found = {"vertices": triangles.vertex, "faces": triangles.vertex_index}
    return {**found, "uv": triangles.texcoordset[0]} if len(triangles.texcoordset) else found


def by_elementtree(data):
    root = ElementTree.fromstring(zipfile.ZipFile(io.BytesIO(data)).read("3D/3dmodel.model"))

    def table(tag, names, kind):
        return np.array([[kind(e.attrib[name]) for name in names] for e in root.iter() if e.tag.endswith(f"}}{tag}")])

    return {"vertices": table("vertex", "xyz", float), "faces": table("triangle", ("v1", "v2", "v3"), int)}


# by format: the reader, and how far a number of about 1 may be off
OTHERS = {
    "npz": (by_numpy, 0.0),
    "obj": (lambda data: by_trimesh(data, "obj"), 1e-8),
    "ply": (by_plyfile, 1e-6),
    "stl": (lambda data: by_trimesh(data, "stl"), 1e-6),
    "off": (lambda data: by_trimesh(data, "off"), 1e-8),
    "glb": (lambda data: by_trimesh(data, "glb"), 1e-6),
    "dae": (by_collada, 1e-6),
    "3mf": (by_elementtree, 1e-15),
}


def check(kind):
    try:
        kind.check_packages("testing")
    except InputError as problem:
        pytest.skip(str(problem))


@pytest.fixture(scope="module")
def maps():
    return {
        "uv": pgcp.parameterize(lifted(grid(8, 6)), patches=2),
        "sphere": pgcp.parameterize(spheroid(2, 1.5)[0], patches=2),
    }


def image(result):
    values = result.coordinates
    return values if values.shape[1] == 3 else np.column_stack([values, 0 * values[:, 0]])


def test_every_format_that_is_written_is_read_back_by_another():
    assert {kind.name for kind in writable()} == set(OTHERS)


@pytest.mark.parametrize("key", ["uv", "sphere"])
@pytest.mark.parametrize("kind", writable(), ids=lambda kind: kind.name)
def test_a_map_is_read_back_as_it_is(kind, key, maps, tmp_path):
    check(kind)
    result = maps[key]
    *paths, report = write_outputs(tmp_path, "m", result, None, kinds=[kind.name])
    assert paths == [tmp_path / f"m{kind.suffixes[0]}"]
    assert report == tmp_path / "report.json"
    other, off = OTHERS[kind.name]
    found = other(paths[0].read_bytes())
    surface = result.mesh.vertices if key in kind.carries else image(result)
    wanted = {"vertices": surface, key: result.coordinates, "patch": result.patch, "mu": result.mu}
    wanted = {name: values for name, values in wanted.items() if name in kind.carries}
    assert set(found) == {*wanted, "faces"}
    if kind.name == "stl":  # corners only
        assert np.abs(found["vertices"][found["faces"]] - surface[result.mesh.faces]).max() < off
        return
    assert np.array_equal(found["faces"], result.mesh.faces)
    for name, values in wanted.items():
        assert np.abs(found[name] - values).max() <= off * max(1.0, np.abs(values).max())


@pytest.mark.parametrize("kind", writable(), ids=lambda kind: kind.name)
def test_what_is_written_is_read_by_ourselves_and_the_same_bytes_come_again(kind, maps, tmp_path):
    check(kind)
    result = maps["uv"]
    if kind.read is None or "vertices" not in kind.carries:
        with pytest.raises(BadFileError, match=f"cannot write {kind.suffixes[0]}"):
            write_mesh(tmp_path / f"m{kind.suffixes[0]}", result.mesh)
        return
    path = tmp_path / f"m{kind.suffixes[0].upper()}"
    write_mesh(path, result.mesh)
    mesh = pgcp.read_mesh(path)
    assert np.abs(mesh.vertices[mesh.faces] - result.mesh.vertices[result.mesh.faces]).max() < 1e-6
    if kind.name in ("dae", "3mf"):
        return  # trimesh writes a random id
    once = path.read_bytes()
    write_mesh(path, result.mesh)
    assert path.read_bytes() == once


def glb_values(data, name):
    """Values of one attribute of the only primitive, by the glTF 2.0 specification."""
    length = struct.unpack_from("<I", data, 12)[0]
    document, binary = json.loads(data[20 : 20 + length]), data[28 + length :]
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"][name]]
    view = document["bufferViews"][accessor["bufferView"]]
    columns = {"VEC2": 2, "VEC3": 3}[accessor["type"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    assert accessor["componentType"] == 5126
    return np.frombuffer(binary, "<f4", columns * accessor["count"], start).reshape(-1, columns)


def test_v_points_down_in_gltf(maps, tmp_path):
    result = maps["uv"]
    write_mesh(tmp_path / "m.glb", result.mesh, result.coordinates)
    data = (tmp_path / "m.glb").read_bytes()
    u, v = result.coordinates.T
    assert np.abs(glb_values(data, "TEXCOORD_0") - np.column_stack([u, 1 - v])).max() < 1e-6
    assert np.array_equal(glb_values(data, "POSITION"), result.mesh.vertices.astype("<f4"))


def test_normals_of_stl_are_unit_and_outward_and_those_of_no_area_zero(tmp_path):
    points = np.vstack([spheroid(2, 1.5)[0].vertices, np.eye(3)])
    n = len(points)
    mesh = pgcp.Mesh(points, np.vstack([spheroid(2, 1.5)[0].faces, [n - 1, n - 1, n - 2]]))
    write_mesh(tmp_path / "m.stl", mesh)
    normals = np.frombuffer((tmp_path / "m.stl").read_bytes(), "<f4,<f4,<f4,V38", offset=84)
    normals = np.column_stack([normals[f"f{axis}"] for axis in range(3)])
    wanted = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).face_normals
    assert np.abs(normals - wanted).max() < 1e-6
    assert not normals[-1].any()


def test_small_and_large_numbers_survive_in_off(tmp_path):
    mesh = pgcp.Mesh(grid(3).vertices * [1e-12, 1e12, 1] + [3e-13, 0, 1 / 3], grid(3).faces)
    write_mesh(tmp_path / "m.off", mesh)
    found = by_trimesh((tmp_path / "m.off").read_bytes(), "off")["vertices"]
    assert np.allclose(found, mesh.vertices, rtol=1e-8, atol=0)


@pytest.mark.parametrize("kind", writable(), ids=lambda kind: kind.name)
def test_equal_and_unused_vertices_are_written(kind, tmp_path):
    check(kind)
    if kind.name in ("npz", "stl", "dae"):
        return  # no vertices; corners only
    points = np.vstack([grid(2).vertices, grid(2).vertices[:2]])
    write_mesh(tmp_path / f"m{kind.suffixes[0]}", pgcp.Mesh(points, np.vstack([grid(2).faces[1:], [9, 10, 4]])))
    found = pgcp.read_mesh(tmp_path / f"m{kind.suffixes[0]}")
    assert np.array_equal(found.vertices, points)
    assert found.faces[-1].tolist() == [9, 10, 4]


@pytest.mark.parametrize("kind", writable(), ids=lambda kind: kind.name)
def test_coordinates_without_a_place_or_of_another_shape_are_refused(kind, maps, tmp_path):
    check(kind)
    path = tmp_path / f"m{kind.suffixes[0]}"
    for key, name in (("uv", "coordinates uv; choose from"), ("sphere", "coordinates sphere; choose from .ply")):
        result = maps[key]
        if key in kind.carries:
            with pytest.raises(BadFileError if "vertices" not in kind.carries else InputError, match=r"shape|cannot write"):
                write_mesh(path, result.mesh, **{key: result.coordinates[:, :1]})
        else:
            with pytest.raises(BadFileError, match=f"a {kind.suffixes[0]} file has no place for the {name}"):
                write_mesh(path, result.mesh, **{key: result.coordinates})
    assert list(tmp_path.iterdir()) == []


def test_a_map_as_a_trimesh(maps):
    for key, result in maps.items():
        mesh = result.to_trimesh()
        assert isinstance(mesh, trimesh.Trimesh)
        assert np.array_equal(mesh.vertices, result.mesh.vertices)
        assert np.array_equal(mesh.faces, result.mesh.faces)
        found = mesh.visual.uv if key == "uv" else mesh.vertex_attributes["sphere"]
        assert np.array_equal(found, result.coordinates)
        assert np.array_equal(mesh.face_attributes["patch"], result.patch)
        assert np.array_equal(mesh.face_attributes["mu"], result.mu)
        again = pgcp.parameterize(mesh, patches=2)
        assert np.array_equal(again.coordinates, result.coordinates)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_files_of_an_earlier_run_go_and_those_of_the_user_stay(maps, tmp_path):
    result = maps["uv"]
    for name in ("m.stl", "m.off", "n.glb", "m.txt"):
        (tmp_path / name).write_text("the user's own")
    write_outputs(tmp_path, "m", result, b"picture", kinds=["npz", "glb", "off"])
    assert json.loads((tmp_path / "report.json").read_text())["files"] == ["m.npz", "m.glb", "m.off", "m.png", "report.json"]
    assert names(tmp_path) == ["m.glb", "m.npz", "m.off", "m.png", "m.stl", "m.txt", "n.glb", "report.json"]
    write_outputs(tmp_path, "m", result, None, kinds=["obj"])
    assert names(tmp_path) == ["m.obj", "m.stl", "m.txt", "n.glb", "report.json"]
    assert (tmp_path / "m.stl").read_text() == "the user's own"


@pytest.mark.parametrize("said", [b"", b"[]", b'{"files": 3}', b'{"files": [[], "../m.glb", "m.stl"]}', b"\xff"])
def test_an_earlier_report_is_not_believed_beyond_its_files(said, maps, tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    for path in (tmp_path / "m.glb", folder / "m.stl", folder / "m.glb"):
        path.write_text("earlier")
    (folder / "report.json").write_bytes(said)
    write_outputs(folder, "m", maps["uv"], None, kinds=["npz"])
    assert names(folder) == ["m.glb", "m.npz", *([] if b"m.stl" in said else ["m.stl"]), "report.json"]
    assert (tmp_path / "m.glb").exists()


def test_the_command_writes_what_is_asked_for(tmp_path, capsys):
    write_mesh(tmp_path / "m.obj", lifted(grid(6)))
    words = [str(tmp_path / "m.obj"), "--patches", "2", "--no-png", "--json"]
    for more, wanted in (
        ([], ["m.npz", "m.obj", "m.ply"]),
        (["--no-obj", "--no-ply"], ["m.npz"]),
        (["--write", "glb, off,glb"], ["m.glb", "m.off"]),
        (["--write", "ply,stl", "--no-ply"], ["m.stl"]),
    ):
        assert main([*words, *more]) == 0
        assert names(tmp_path / "m_pgcp") == [*wanted, "report.json"]
        files = json.loads(capsys.readouterr().out)["files"]
        assert files == [str(tmp_path / "m_pgcp" / name) for name in [*wanted, "report.json"]]


@pytest.mark.parametrize("text", ["xyz", "", "npz,", "gltf", ".ply"])
def test_unknown_formats_are_refused_before_anything_is_computed(text, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("pgcp.api.compute", lambda *_: pytest.fail("computed before the formats were looked at"))
    write_mesh(tmp_path / "m.obj", grid(2))
    assert main([str(tmp_path / "m.obj"), "--write", text]) == 2
    known = ", ".join(kind.name for kind in writable())
    assert capsys.readouterr().err.endswith(f"of results; choose from {known}\n")
    assert names(tmp_path) == ["m.obj"]


def test_help_names_all_formats(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    said = " ".join(capsys.readouterr().out.split())
    assert all(suffix in said for kind in readable() for suffix in kind.suffixes)
    assert ", ".join(kind.name for kind in writable()) in said


def test_the_registry_holds_together():
    kinds = formats.formats()
    assert [kind.name for kind in kinds] == sorted(FORMATS)
    suffixes = [suffix for kind in kinds for suffix in kind.suffixes]
    assert len(set(suffixes)) == len(suffixes)
    for kind in kinds:
        assert kind.read is not None or kind.write is not None
        assert kind.summary
        assert all(suffix.startswith(".") and suffix == suffix.lower() for suffix in kind.suffixes)
        if kind.write is not None:
            assert set(kind.carries) <= {"vertices", "uv", "sphere", "patch", "mu", "vertex_of", "face_of"}
    assert [kind.name for kind in outputs(DEFAULT_OUTPUTS)] == list(DEFAULT_OUTPUTS)


def test_a_suffix_belongs_to_one_format(monkeypatch):
    monkeypatch.setattr(formats, "FORMATS", dict(FORMATS))
    with pytest.raises(ValueError, match=r"the suffix .ply of the format toy is one of the format ply"):
        register(Format("toy", (".toy", ".ply"), "a toy"))
    assert register(Format("ply", (".ply", ".toy"), "another")) is formats.FORMATS["ply"]
