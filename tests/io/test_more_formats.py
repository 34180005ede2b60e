"""FreeSurfer, GIFTI, VTK and NPZ surfaces as the packages of their users write them, packed files, and the standard input."""

from __future__ import annotations

import gzip
import io
import struct
import subprocess
import sys

import numpy as np
import pytest
from meshes import icosphere

import pgcp
from pgcp.io.read import read_mesh, read_source, stem_of

BALL = icosphere(2)
V, F = BALL.vertices, BALL.faces


def by_nibabel(path):
    import nibabel

    if path.suffix == ".gii":
        arrays = (V.astype("f4"), "NIFTI_INTENT_POINTSET"), (F.astype("i4"), "NIFTI_INTENT_TRIANGLE")
        nibabel.save(nibabel.gifti.GiftiImage(darrays=[nibabel.gifti.GiftiDataArray(*array) for array in arrays]), path)
    else:
        nibabel.freesurfer.write_geometry(path, V, F)


def by_pyvista(path, binary=True):
    import pyvista

    pyvista.PolyData.from_regular_faces(V, F).save(path, binary=binary)


def by_meshio(path, **cells):
    import meshio

    meshio.Mesh(V, list({"triangle": F, **cells}.items())).write(path)


def by_numpy(path, names=("vertices", "faces")):
    np.savez_compressed(path, **dict(zip(names, (V, F), strict=True)))


WRITERS = {
    "lh.pial": by_nibabel,
    "rh.white": by_nibabel,
    "a.sphere": by_nibabel,
    "a.surf.gii": by_nibabel,
    "a.gii": by_nibabel,
    "a.vtk": by_pyvista,
    "text.vtk": lambda path: by_pyvista(path, False),
    "a.vtp": by_pyvista,
    "text.vtp": lambda path: by_pyvista(path, False),
    "a.vtu": by_meshio,
    "a.npz": by_numpy,
    "vf.npz": lambda path: by_numpy(path, ("v", "f")),
}


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("packed", [False, True])
def test_what_other_packages_write_is_read(name, packed, tmp_path):
    path = tmp_path / name
    WRITERS[name](path)
    if packed:
        path = tmp_path / f"{name}.gz"
        path.write_bytes(gzip.compress((tmp_path / name).read_bytes()))
    mesh = read_mesh(path)
    assert mesh.name == name
    assert np.allclose(mesh.vertices, V, atol=1e-7)
    assert np.array_equal(mesh.faces, F)


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_that_is_cut_off_is_refused_in_one_line(name, tmp_path, capfd):
    path = tmp_path / name
    WRITERS[name](path)
    data = path.read_bytes()
    for size in (len(data) // 2, 40):
        path.write_bytes(data[:size])
        with pytest.raises(pgcp.BadFileError, match=path.name) as problem:
            read_source(path)
        assert "\n" not in str(problem.value)
    path.write_bytes(data)
    packed = path.with_name(f"{name}.gz")
    packed.write_bytes(gzip.compress(data)[:-9])
    with pytest.raises(pgcp.BadFileError, match="cut off"):
        read_source(packed)
    assert capfd.readouterr() == ("", "")


def test_values_are_no_surface(tmp_path):
    import nibabel

    nibabel.freesurfer.write_morph_data(tmp_path / "lh.thickness", V[:, 0])
    shape = nibabel.gifti.GiftiImage(darrays=[nibabel.gifti.GiftiDataArray(V[:, 0].astype("f4"), "NIFTI_INTENT_SHAPE")])
    nibabel.save(shape, tmp_path / "a.shape.gii")
    np.savez(tmp_path / "a.npz", x=V)
    np.savez(tmp_path / "b.npz", vertices=V, faces=np.column_stack([F, F[:, 0]]))
    np.savez(tmp_path / "c.npz", vertices=V, faces=F.astype(float))
    by_meshio(tmp_path / "a.vtu", tetra=np.array([[0, 1, 2, 3]]))
    (tmp_path / "lh.old").write_bytes(b"\xff\xff\xfe" + b"x" * 50)
    for name, said in (
        ("lh.thickness", "cannot read .thickness"),
        ("a.shape.gii", "it holds no surface"),
        ("a.npz", "it holds x; a mesh has the arrays vertices and faces"),
        ("b.npz", "faces have the shape"),
        ("c.npz", "faces of type float64"),
        ("a.vtu", "1 cells that are no flat polygons"),
        ("lh.old", "no two lines"),
    ):
        with pytest.raises(pgcp.BadFileError, match=said):
            read_source(tmp_path / name)


def test_a_file_that_unpacks_to_far_more_than_it_is_is_refused(tmp_path):
    (tmp_path / "a.ply.gz").write_bytes(gzip.compress(b"\0" * 50_000_000))
    with pytest.raises(pgcp.BadFileError, match="unpack to more than"):
        read_source(tmp_path / "a.ply.gz")
    (tmp_path / "b.ply.gz").write_bytes(b"ply\n")
    with pytest.raises(pgcp.BadFileError, match="gzip data are wrong"):
        read_source(tmp_path / "b.ply.gz")


def test_polygons_and_strips_of_vtk(tmp_path):
    import pyvista

    plane = pyvista.Plane(i_resolution=2, j_resolution=2)
    plane["height"] = np.arange(9.0)
    plane.save(tmp_path / "quads.vtp")
    found = read_source(tmp_path / "quads.vtp")
    assert found.sizes.tolist() == [4] * 4
    assert found.of_vertices["height"].tolist() == list(range(9))
    strip = pyvista.PolyData()
    strip.points = np.array([[0.0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [2, 0, 0]])
    strip.strips = [5, 0, 1, 2, 3, 4]
    strip.save(tmp_path / "strip.vtk")
    mesh = read_mesh(tmp_path / "strip.vtk")
    assert mesh.faces.tolist() == [[0, 1, 2], [2, 1, 3], [2, 3, 4]]


def glb(tmp_path, name, mode, corners, sparse=False):
    """A GLB file of a flat strip of points, whose primitive has a mode, perhaps with positions that are sparse."""
    import json

    points = np.array([[0.0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [2, 0, 0]], "<f4")
    stored = np.zeros_like(points) if sparse else points
    where, index = np.arange(5, dtype="<u2"), np.array(corners, "<u2")
    blocks = [stored.tobytes(), index.tobytes(), where.tobytes(), points.tobytes()]
    padded = [block + b"\0" * (-len(block) % 4) for block in blocks]
    starts = np.cumsum([0, *map(len, padded)])
    views = [{"buffer": 0, "byteOffset": int(s), "byteLength": len(b)} for s, b in zip(starts[:-1], blocks, strict=True)]
    place = {"bufferView": 0, "componentType": 5126, "count": 5, "type": "VEC3"}
    if sparse:
        del place["bufferView"]
        place["sparse"] = {"count": 5, "indices": {"bufferView": 2, "componentType": 5123}, "values": {"bufferView": 3}}
    document = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": int(starts[-1])}],
        "bufferViews": views,
        "accessors": [place, {"bufferView": 1, "componentType": 5123, "count": len(corners), "type": "SCALAR"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": mode}]}],
        "nodes": [{"mesh": 0}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", int(starts[-1]), 0x004E4942) + b"".join(padded)
    path = tmp_path / name
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
    return path


def test_strips_and_fans_and_sparse_positions_of_gltf(tmp_path):
    for sparse in (False, True):
        path = glb(tmp_path, "strip.glb", 5, [0, 1, 2, 3, 4], sparse)
        mesh = read_mesh(path)
        assert mesh.faces.tolist() == [[0, 1, 2], [2, 1, 3], [2, 3, 4]]
        assert mesh.vertices[4].tolist() == [2, 0, 0]
        assert mesh.vertices[3].tolist() == [1, 1, 0]
    fan = read_mesh(glb(tmp_path, "fan.glb", 6, [0, 2, 3, 1]))
    assert fan.faces.tolist() == [[0, 2, 3], [0, 3, 1]]
    with pytest.raises(pgcp.BadFileError, match="mode 7"):
        read_mesh(glb(tmp_path, "bad.glb", 7, [0, 1, 2]))


def test_the_name_of_results(tmp_path):
    from pathlib import Path

    names = {"a.ply": "a", "a.b.OBJ.gz": "a.b", "x.surf.gii": "x", "lh.pial": "lh.pial", "-": "stdin", "lh.pial.gz": "lh.pial"}
    assert {name: stem_of(Path(name)) for name in names} == names


def test_ply_on_the_standard_input(tmp_path):
    from pgcp.io.ply_write import write_ply

    stream = io.BytesIO()
    write_ply(stream, {"vertices": V, "faces": F})
    command = [sys.executable, "-m", "pgcp", "-", "--no-png", "--write", "npz", "--quiet"]
    done = subprocess.run(command, input=stream.getvalue(), cwd=tmp_path, capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")
    with np.load(tmp_path / "stdin_pgcp" / "stdin.npz") as result:
        assert len(result["sphere"]) == len(V)
    done = subprocess.run(command, input=b"", cwd=tmp_path, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (2, b"pgcp-run: stdin.ply: the file is empty\n")


def test_a_missing_package_is_named_with_its_extra(tmp_path, monkeypatch):
    import importlib.metadata

    from pgcp.io import formats

    def missing(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(formats, "distribution", missing)
    for name, extra in (("a.vtk", "vtk"), ("a.gii", "brain"), ("a.3mf", "formats")):
        (tmp_path / name).write_bytes(b"x")
        with pytest.raises(pgcp.InputError, match=rf"is not installed: pip install 'pgcp\[{extra}\]'"):
            read_source(tmp_path / name)
