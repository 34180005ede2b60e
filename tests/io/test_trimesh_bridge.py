"""What is read and written through trimesh: order, places, refusals in one sentence; and only where it is asked for."""

from __future__ import annotations

import importlib.metadata
import logging
import subprocess
import sys
import time
import warnings

import numpy as np
import pytest
from meshes import grid, lifted
from trimesh_files import FACES, ITEM, POINTS, SEEDS, dae_text, numbers, threemf, threemf_object, zipped

import pgcp
from pgcp.cli.main import main
from pgcp.errors import BadFileError, InputError
from pgcp.io import formats
from pgcp.io.formats import readable

THROUGH_TRIMESH = {kind.name: kind for kind in readable() if kind.extra == "formats"}


def require(name):
    try:
        THROUGH_TRIMESH[name].check_packages("testing")
    except InputError as problem:
        pytest.skip(str(problem))


def read(folder, name, data):
    require(name)
    (folder / f"m.{name}").write_bytes(data)
    return pgcp.read_mesh(folder / f"m.{name}")


def test_every_format_through_trimesh_is_tested():
    assert set(SEEDS) == set(THROUGH_TRIMESH)


@pytest.mark.parametrize("name", THROUGH_TRIMESH)
def test_vertices_and_faces_keep_the_order_of_the_file(name, tmp_path):
    mesh = read(tmp_path, name, SEEDS[name])
    assert np.array_equal(mesh.vertices[mesh.faces], POINTS[FACES])
    if name in ("dae", "zae"):  # trimesh hands out corners: vertices are in order of first use
        _, first = np.unique(mesh.faces, return_index=True)
        assert (np.diff(first) > 0).all()
        assert len(mesh.vertices) == len(POINTS)
    else:
        assert np.array_equal(mesh.faces, FACES)


def test_equal_and_unused_vertices_stay(tmp_path):
    points = np.vstack([POINTS, POINTS[:2]])
    mesh = read(tmp_path, "3mf", threemf(threemf_object(1, points, FACES), ITEM))
    assert np.array_equal(mesh.vertices, points)


def test_objects_are_joined_at_their_places_and_mirrored_ones_keep_their_outside(tmp_path):
    objects = threemf_object(1, POINTS, FACES[:9]) + threemf_object(2, POINTS, FACES[9:])
    mesh = read(tmp_path, "3mf", threemf(objects, ITEM + '<item objectid="2" transform="-1 0 0 0 1 0 0 0 2 5 0 1"/>'))
    assert np.array_equal(mesh.vertices, np.vstack([POINTS, POINTS * [-1, 1, 2] + [5, 0, 1]]))
    assert np.array_equal(mesh.faces, np.vstack([FACES[:9], FACES[9:, ::-1] + len(POINTS)]))


LAUGHS = "<!ENTITY a0 '1 '>" + "".join(f"<!ENTITY a{i} '{f'&a{i - 1};' * 10}'>" for i in range(1, 10))
SECRET = '<!ENTITY e SYSTEM "secret">'
BAD = {
    "nothing of that name": ("3mf", threemf(threemf_object(1), ITEM + '<item objectid="7"/>'), "not read all of it: id 7"),
    "word for a number": ("3mf", threemf(threemf_object(1).replace('x="1"', 'x="one"', 1), ITEM), "not be read to its end"),
    "vertex not there": ("3mf", threemf(threemf_object(1).replace('v1="5"', 'v1="99"', 1), ITEM), "vertices that it does not"),
    "no model": ("3mf", zipped({"a": "b"}), "trimesh cannot read it: StopIteration"),
    "no archive": ("3mf", b"hello", "trimesh cannot read it: BadZipFile"),
    "page": ("3mf", b"<!DOCTYPE html><html></html>", "it looks like an HTML page"),
    "cut-off archive": ("3mf", SEEDS["3mf"][:-30], "no whole zip archive"),
    "bomb": ("3mf", zipped({"3D/3dmodel.model": " " * 20_000_000}), r"unpacks to 20000000; at most 16777216 are read"),
    "bomb in collada": ("zae", zipped({"m.dae": " " * 20_000_000}), "unpacks to 20000000"),
    "no scene": ("zae", zipped({"m.txt": "m"}), "trimesh cannot read it"),
    "corner of 99": ("dae", dae_text(numbers(FACES).replace("15", "99")).encode(), "maxindex=99"),
    "word in collada": ("dae", dae_text(positions="0 0 one").encode(), "Corrupted float array"),
    "text": ("dae", b"dear sir", "XML Parsing Error"),
    "page for collada": ("dae", b"<!DOCTYPE html><html></html>", "it looks like an HTML page"),
    "json": ("xaml", b'{"a": 1}', "it looks like JSON"),
    "empty xaml": ("xaml", b"<a/>", "trimesh cannot read it: ValueError"),
    "other file": ("dae", dae_text(before=f"<!DOCTYPE x [{SECRET}]>", positions="0 0 0 1 0 0 0 &e; 0").encode(), "'e'|entit"),
    "laughs": ("dae", dae_text(before=f"<!DOCTYPE x [{LAUGHS}]>", positions="0 0 0 &a9;").encode(), "amplification"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_with_one_sentence(name, tmp_path, caplog, capsys):
    suffix, data, words = BAD[name]
    (tmp_path / "secret").write_text("1")
    start = time.perf_counter()
    with pytest.raises(BadFileError, match=words) as caught:
        read(tmp_path, suffix, data)
    assert time.perf_counter() - start < 5
    assert "\n" not in str(caught.value)
    assert ("looks like" in str(caught.value)) == ("looks like" in words)
    assert str(caught.value).startswith(f"{tmp_path / 'm'}.{suffix}: not a readable {suffix.upper()} file: ")
    assert capsys.readouterr() == ("", "")
    assert logging.getLogger("trimesh").propagate


def test_what_trimesh_says_of_textures_does_not_matter_and_what_it_leaves_out_does(tmp_path, monkeypatch):
    require("3mf")
    from trimesh.exchange import load

    def log(words):
        logging.getLogger("trimesh").warning(words)

    def warn(words):
        warnings.warn(words, DeprecationWarning, stacklevel=1)

    for say, words, matters in (
        (log, "unable to load emissive texture", False),
        (log, "skipping `a`: too large", True),
        (warn, "a name has changed", False),
        (warn, "string or file could not be read to its end due to unmatched data", True),
    ):

        def loader(say=say, words=words, **_):
            say(words)
            return {"vertices": POINTS, "faces": FACES}

        monkeypatch.setitem(load.mesh_loaders, "3mf", loader)
        if matters:
            with pytest.raises(BadFileError, match=f"trimesh cannot read .*{words}"):
                read(tmp_path, "3mf", SEEDS["3mf"])
        else:
            assert np.array_equal(read(tmp_path, "3mf", SEEDS["3mf"]).faces, FACES)


@pytest.mark.parametrize("name", THROUGH_TRIMESH)
def test_a_missing_package_is_named_before_anything_is_done(name, tmp_path, monkeypatch, capsys):
    def missing(package):
        raise importlib.metadata.PackageNotFoundError(package)

    monkeypatch.setattr(formats, "distribution", missing)
    package = THROUGH_TRIMESH[name].needs[0]
    (tmp_path / f"m.{name}").write_bytes(SEEDS[name])
    said = f"reading .{name} needs the package {package}, which is not installed: pip install 'pgcp.formats.'"
    with pytest.raises(InputError, match=said):
        pgcp.read_mesh(tmp_path / f"m.{name}")
    pgcp.write_mesh(tmp_path / "m.ply", lifted(grid(2)))
    if THROUGH_TRIMESH[name].write is None:
        return
    with pytest.raises(InputError, match=f"writing .{name} needs the package {package}"):
        pgcp.write_mesh(tmp_path / f"n.{name}", lifted(grid(2)))
    monkeypatch.setattr("pgcp.api.compute", lambda *_: pytest.fail("computed before the formats were looked at"))
    assert main([str(tmp_path / "m.ply"), "--write", name]) == 2
    assert capsys.readouterr().err.startswith(f"pgcp-run: writing .{name} needs the package {package}")
    assert not (tmp_path / "m_pgcp").exists()


def test_a_usual_run_does_not_import_trimesh(tmp_path):
    pgcp.write_mesh(tmp_path / "m.ply", lifted(grid(4)))
    code = f"""
import sys
from pgcp.cli.main import main
assert main(["--version"]) == 0
assert not {{"trimesh", "networkx", "lxml", "collada"}} & set(sys.modules)
assert main([{str(tmp_path / "m.ply")!r}, "--patches", "2", "--quiet"]) == 0
assert "trimesh" not in sys.modules
assert main([{str(tmp_path / "m.ply")!r}, "--patches", "2", "--quiet", "--write", "dae"]) == 0
assert "trimesh" in sys.modules
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert b"COLLADA" in (tmp_path / "m_pgcp" / "m.dae").read_bytes()
