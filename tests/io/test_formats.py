"""Every format of the registry: what is written is read back by a reader that is not ours."""

from __future__ import annotations

import gzip
import io
import json
import struct
import zipfile
from types import SimpleNamespace
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
from pgcp.io.write import within, write_files, write_mesh, write_outputs
from pgcp.report.texture import as_png


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


def by_pyvista(data, suffix, tmp_path):
    pyvista = pytest.importorskip("pyvista")
    (tmp_path / f"x{suffix}").write_bytes(data)
    surface = pyvista.read(tmp_path / f"x{suffix}")
    found = {"vertices": np.asarray(surface.points), "faces": surface.regular_faces}
    arrays = {name: np.asarray(surface.point_data[name]) for name in surface.point_data.keys()}  # noqa: SIM118
    return {**found, **arrays, **{name: np.asarray(surface.cell_data[name]) for name in surface.cell_data.keys()}}  # noqa: SIM118


def by_nibabel(data, suffix, tmp_path):
    nibabel = pytest.importorskip("nibabel")
    (tmp_path / f"x{suffix}").write_bytes(data)
    if suffix == ".sphere":
        points, faces = nibabel.freesurfer.read_geometry(tmp_path / "x.sphere")
        return {"vertices": points, "faces": faces}
    arrays = nibabel.load(tmp_path / f"x{suffix}").darrays
    names = {"NIFTI_INTENT_POINTSET": "vertices", "NIFTI_INTENT_TRIANGLE": "faces", "NIFTI_INTENT_SHAPE": "log_scale"}
    return {names[nibabel.nifti1.intent_codes.niistring[array.intent]]: array.data for array in arrays}


def by_genfromtxt(data):
    rows = np.genfromtxt(io.BytesIO(data), delimiter=",", names=True)
    names = {"vertices": ("x", "y", "z"), "uv": ("u", "v"), "sphere": ("sx", "sy", "sz")}
    tables = {n: np.column_stack([rows[c] for c in columns]) for n, columns in names.items() if columns[0] in rows.dtype.names}
    return {**tables, **{name: rows[name] for name in ("log_scale",) if name in rows.dtype.names}}


# by format: the reader, and how far a number of about 1 may be off
OTHERS = {
    "npz": (by_numpy, 0.0),
    "obj": (lambda data: by_trimesh(data, "obj"), 1e-8),
    "ply": (by_plyfile, 1e-6),
    "stl": (lambda data: by_trimesh(data, "stl"), 1e-6),
    "off": (lambda data: by_trimesh(data, "off"), 1e-8),
    "glb": (lambda data: by_trimesh(data, "glb"), 1e-6),
    "dae": (by_collada, 1e-6),
    "csv": (by_genfromtxt, 0.0),
    "vtp": (lambda data, path: by_pyvista(data, ".vtp", path), 0.0),
    "surf.gii": (lambda data, path: by_nibabel(data, ".surf.gii", path), 1e-6),
    "shape.gii": (lambda data, path: by_nibabel(data, ".shape.gii", path), 1e-6),
    "sphere": (lambda data, path: by_nibabel(data, ".sphere", path), 1e-6),
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


def image(result, kind):
    values = result.coordinates
    return values * kind.sphere_radius if values.shape[1] == 3 else np.column_stack([values, 0 * values[:, 0]])


def read_back(kind, data, folder):
    """What another reader finds in a file's bytes."""
    other, off = OTHERS[kind.name]
    return (other(data, folder) if other.__code__.co_argcount == 2 else other(data)), off


def test_every_format_that_is_written_is_read_back_by_another():
    assert {kind.name for kind in writable()} == set(OTHERS)


@pytest.mark.parametrize("key", ["uv", "sphere"])
@pytest.mark.parametrize("kind", writable(), ids=lambda kind: kind.name)
def test_a_map_is_read_back_as_it_is(kind, key, maps, tmp_path):
    check(kind)
    result = maps[key]
    *paths, report = write_outputs(tmp_path, "m", result, {}, kinds=[kind.name])
    assert paths == [tmp_path / f"m{kind.suffixes[0]}"]
    assert report == tmp_path / "report.json"
    found, off = read_back(kind, paths[0].read_bytes(), tmp_path)
    surface = result.mesh.vertices if key in kind.carries else image(result, kind)
    wanted = {"vertices": surface, key: result.coordinates}
    wanted |= {name: getattr(result, name) for name in ("patch", "mu", "log_scale", "angle_error", "area_ratio")}
    wanted = {name: values for name, values in wanted.items() if name in kind.carries}
    if kind.name == "vtp":
        wanted["mu_abs"] = np.abs(wanted.pop("mu"))
    assert set(found) == {*wanted, *(() if kind.name in ("csv", "shape.gii") else ("faces",))}
    if kind.name == "stl":  # corners only
        assert np.abs(found["vertices"][found["faces"]] - surface[result.mesh.faces]).max() < off
        return
    assert np.array_equal(found.get("faces", result.mesh.faces), result.mesh.faces)
    for name, values in wanted.items():
        assert np.abs(found[name] - values).max() <= off * max(1.0, np.abs(values).max())


@pytest.mark.parametrize("kind", [kind for kind in writable() if "uv" in kind.carries], ids=lambda kind: kind.name)
def test_texture_coordinates_are_those_of_the_layout_and_exact_ones_stay(kind, maps, tmp_path):
    check(kind)
    result = maps["uv"]
    layout = result.layout()
    path, report = write_outputs(tmp_path, "m", result, {}, kinds=[kind.name], layout=layout)
    found, off = read_back(kind, path.read_bytes(), tmp_path)
    assert np.abs(found["uv"] - (result.uv if kind.is_exact else layout.points)).max() <= off
    assert kind.is_exact == (kind.name in ("npz", "csv"))
    said = json.loads(report.read_text())["texture"]
    turn = np.exp(1j * np.radians(said["angle_deg"])) * said["scale"]
    z = (result.uv @ [1, 1j]) * turn + np.dot(said["shift"], [1, 1j])
    assert np.abs(np.column_stack([z.real, z.imag]) - layout.points).max() < 1e-12


def corner_places(data):
    """Places and texture coordinates (F, 3, 2) of all corners of an OBJ file, read line by line."""
    v, vt, f = [], [], []
    for line in data.decode().splitlines():
        head, *words = line.split() or [""]
        if head in ("v", "vt"):
            (v if head == "v" else vt).append([float(word) for word in words])
        elif head == "f":
            f.append([[int(number) - 1 for number in word.split("/")] for word in words])
    f = np.array(f)
    return np.array(v), f[..., 0], np.array(vt)[f[..., 1]]


def test_a_sphere_has_longitude_and_latitude_at_the_corners(maps, tmp_path):
    result = maps["sphere"]
    layout = result.layout()
    names = [tmp_path / name for name in ("m.obj", "m.glb", "m.npz", "m.ply")]
    assert write_files(names, result, layout=layout) == names
    vertices, faces, corners = corner_places(names[0].read_bytes())
    assert np.array_equal(faces, result.faces)
    assert np.abs(vertices - result.mesh.vertices).max() < 1e-8
    wanted = layout.points[layout.faces]
    assert np.abs(corners - wanted).max() < 1e-8
    found = by_trimesh(names[1].read_bytes(), "glb")
    assert np.abs(found["uv"][found["faces"]] - wanted).max() < 1e-6
    assert np.abs(found["vertices"][: len(vertices)] - result.mesh.vertices).max() < 1e-6
    assert np.abs(found["vertices"][found["faces"]] - result.mesh.vertices[result.faces]).max() < 1e-6
    assert np.array_equal(by_numpy(names[2].read_bytes())["sphere"], result.sphere)
    assert np.array_equal(by_plyfile(names[3].read_bytes())["sphere"], result.sphere)


def test_textured_files_open_elsewhere_with_their_picture(maps, tmp_path):
    png, result = as_png("checker"), maps["uv"]
    wanted = [tmp_path / name for name in ("m.obj", "m.obj.gz", "m.glb")]
    paths = write_files(wanted, result, layout=result.layout(), texture=png)
    assert {path.name for path in paths} == {"m.obj", "m.obj.gz", "m.glb", "m.mtl", "m_texture.png"} == {*names(tmp_path)}
    assert (tmp_path / "m_texture.png").read_bytes() == png
    for name in ("m.obj", "m.glb"):
        mesh = trimesh.load_mesh(tmp_path / name, process=False, maintain_order=True)
        material = mesh.visual.material
        picture = material.image if name == "m.obj" else material.baseColorTexture
        assert picture.size == (1024, 1024)
        assert np.abs(mesh.visual.uv - result.layout().points).max() < 1e-6
    assert material.doubleSided is False
    assert np.abs(np.linalg.norm(mesh.vertex_normals, axis=1) - 1).max() < 1e-6
    normals = glb_values((tmp_path / "m.glb").read_bytes(), "NORMAL")
    by_angle = trimesh.Trimesh(result.mesh.vertices, result.faces, process=False).vertex_normals
    assert (normals * by_angle).sum(axis=1).min() > 0.99
    assert gzip.decompress((tmp_path / "m.obj.gz").read_bytes()) == (tmp_path / "m.obj").read_bytes()


@pytest.mark.parametrize("name", ["m.xyz", "m", "m.gz", "m.png.gz", "obj"])
def test_names_that_say_no_format_are_refused_before_anything_is_computed(name, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("pgcp.api.compute", lambda *_: pytest.fail("computed before the names were looked at"))
    write_mesh(tmp_path / "in.obj", grid(2))
    assert main([str(tmp_path / "in.obj"), "-o", str(tmp_path / name)]) == 2
    assert "does not say what to write" in capsys.readouterr().err
    assert main([str(tmp_path / "in.obj"), "--output", str(tmp_path / "in.obj")]) == 2
    assert "take the place of the mesh" in capsys.readouterr().err
    assert names(tmp_path) == ["in.obj"]


def test_the_command_writes_files_by_name_and_a_folder_only_if_asked(tmp_path, capsys):
    write_mesh(tmp_path / "m.obj", lifted(grid(6)))
    words = [str(tmp_path / "m.obj"), "--patches", "2", "--quiet"]
    wanted = [str(tmp_path / "out" / name) for name in ("a.glb", "b.png", "c.csv")]
    assert main([*words, *(word for path in wanted for word in ("-o", path)), "--up", "z"]) == 0
    assert names(tmp_path / "out") == ["a.glb", "b.png", "c.csv"]
    assert (tmp_path / "out" / "b.png").read_bytes().startswith(b"\x89PNG")
    assert names(tmp_path) == ["m.obj", "out"]
    assert main([*words, "-o", wanted[0], "--output-dir", str(tmp_path / "two"), "--no-png", "--texture", "checker"]) == 0
    assert names(tmp_path / "two") == ["m.html", "m.mtl", "m.npz", "m.obj", "m.ply", "m_texture.png", "report.json"]
    assert main([*words, "--output-dir", str(tmp_path / "two"), "--no-png", "--no-html", "--uv", "surface"]) == 0
    assert names(tmp_path / "two") == ["m.npz", "m.obj", "m.ply", "report.json"]
    assert json.loads((tmp_path / "two" / "report.json").read_text())["texture"] == {"kind": "surface"}
    exact = by_numpy((tmp_path / "two" / "m.npz").read_bytes())["uv"]
    assert np.abs(by_plyfile((tmp_path / "two" / "m.ply").read_bytes())["uv"] - exact).max() < 1e-6
    assert main([*words, "--texture", str(tmp_path / "m.obj")]) == 2
    assert "it is no picture" in capsys.readouterr().err


def test_usual_results_of_large_binary_files_leave_out_obj(maps):
    result = maps["uv"]
    assert within(DEFAULT_OUTPUTS, result, 10) == DEFAULT_OUTPUTS
    large = pgcp.Result.of(result)
    object.__setattr__(large, "mesh", SimpleNamespace(vertices=range(500_000), faces=range(1_000_000)))
    assert within(DEFAULT_OUTPUTS, large, 19_000_000) == ("npz", "ply")
    assert within(DEFAULT_OUTPUTS, large, 60_000_000) == DEFAULT_OUTPUTS


@pytest.mark.parametrize("kind", writable(), ids=lambda kind: kind.name)
def test_what_is_written_is_read_by_ourselves_and_the_same_bytes_come_again(kind, maps, tmp_path):
    check(kind)
    result = maps["uv"]
    if kind.read is None and "vertices" in kind.carries:
        write_mesh(tmp_path / f"m{kind.suffixes[0].upper()}", result.mesh)
        found, off = read_back(kind, (tmp_path / f"m{kind.suffixes[0].upper()}").read_bytes(), tmp_path)
        assert np.abs(found["vertices"] - result.mesh.vertices).max() <= off
        return
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
    if kind.read is None or kind.name in ("stl", "dae", "npz"):
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
    for key, name in (("uv", "coordinates uv; choose from"), ("sphere", "coordinates sphere; choose from .csv, .ply, .vtp")):
        result = maps[key]
        if key in kind.carries:
            with pytest.raises(BadFileError if "vertices" not in kind.carries else InputError, match=r"shape|cannot write"):
                write_mesh(path, result.mesh, **{key: result.coordinates[:, :1]})
        else:
            with pytest.raises(BadFileError, match=f"{kind.suffixes[0]} file has no place for the {name}|cannot write .shape"):
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
    write_outputs(tmp_path, "m", result, {".png": b"picture"}, kinds=["npz", "glb", "off"])
    assert json.loads((tmp_path / "report.json").read_text())["files"] == ["m.npz", "m.glb", "m.off", "m.png", "report.json"]
    assert names(tmp_path) == ["m.glb", "m.npz", "m.off", "m.png", "m.stl", "m.txt", "n.glb", "report.json"]
    write_outputs(tmp_path, "m", result, {}, kinds=["obj"])
    assert names(tmp_path) == ["m.obj", "m.stl", "m.txt", "n.glb", "report.json"]
    assert (tmp_path / "m.stl").read_text() == "the user's own"


@pytest.mark.parametrize("said", [b"", b"[]", b'{"files": 3}', b'{"files": [[], "../m.glb", "m.stl"]}', b"\xff"])
def test_an_earlier_report_is_not_believed_beyond_its_files(said, maps, tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    for path in (tmp_path / "m.glb", folder / "m.stl", folder / "m.glb"):
        path.write_text("earlier")
    (folder / "report.json").write_bytes(said)
    write_outputs(folder, "m", maps["uv"], {}, kinds=["npz"])
    assert names(folder) == ["m.glb", "m.npz", *([] if b"m.stl" in said else ["m.stl"]), "report.json"]
    assert (tmp_path / "m.glb").exists()


def test_the_command_writes_what_is_asked_for(tmp_path, capsys):
    write_mesh(tmp_path / "m.obj", lifted(grid(6)))
    words = [str(tmp_path / "m.obj"), "--patches", "2", "--no-png", "--no-html", "--json"]
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
            assert set(kind.carries) <= {"vertices", "uv", "uv_faces", "sphere", "patch", "mu", "vertex_of", "face_of"} | {
                "normals", "log_scale", "angle_error", "area_ratio", "given", "polygon_of", "component_of",
            }  # fmt: skip
    assert [kind.name for kind in outputs(DEFAULT_OUTPUTS)] == list(DEFAULT_OUTPUTS)


def test_a_suffix_belongs_to_one_format(monkeypatch):
    monkeypatch.setattr(formats, "FORMATS", dict(FORMATS))
    with pytest.raises(ValueError, match=r"the suffix .ply of the format toy is one of the format ply"):
        register(Format("toy", (".toy", ".ply"), "a toy"))
    assert register(Format("ply", (".ply", ".toy"), "another")) is formats.FORMATS["ply"]
