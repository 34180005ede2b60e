"""A format is added in one place: this file alone, and the command reads and writes it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from meshes import grid, lifted

import pgcp
from pgcp.cli.main import main
from pgcp.errors import BadFileError
from pgcp.io.formats import FORMATS, Format, register


def read_toy(data, beside):
    """Vertices in the file, faces in another beside it that it names."""
    words = data.split()
    if words[0] != b"toy":
        raise BadFileError("it does not begin with the word toy")
    vertices = np.array(words[2:], np.float64).reshape(-1, 3)
    return vertices, np.array(beside(words[1].decode()).split(), np.int64).reshape(-1, 3)


def write_toy(stream, arrays):
    rows = {name: values.tolist() for name, values in arrays.items()}
    stream.write(json.dumps(rows).encode())


@pytest.fixture(autouse=True)
def toy():
    register(
        Format(
            "toy", (".toy",), "a toy", read=read_toy, write=write_toy, carries=("vertices", "uv"), looks=(rb"toy\s", "a toy")
        )
    )
    yield
    del FORMATS["toy"]


@pytest.fixture
def path(tmp_path):
    mesh = lifted(grid(6))
    (tmp_path / "m.toy").write_text("toy faces.txt\n" + "\n".join(" ".join(map(repr, v)) for v in mesh.vertices.tolist()))
    (tmp_path / "faces.txt").write_text("\n".join(" ".join(map(str, f)) for f in mesh.faces.tolist()))
    return tmp_path / "m.toy"


def test_the_command_reads_and_writes_it(path):
    assert main([str(path), "--patches", "2", "--quiet", "--no-png", "--no-html", "--uv", "surface", "--write", "toy,npz"]) == 0
    out = path.parent / "m_pgcp"
    assert sorted(p.name for p in out.iterdir()) == ["m.npz", "m.toy", "report.json"]
    mesh = lifted(grid(6))
    found = json.loads((out / "m.toy").read_text())
    assert set(found) == {"vertices", "uv", "faces"}
    assert found["vertices"] == mesh.vertices.tolist()
    assert found["faces"] == mesh.faces.tolist()
    with np.load(out / "m.npz") as data:
        assert found["uv"] == data["uv"].tolist()
        assert np.array_equal(data["uv"], pgcp.parameterize(mesh, patches=2).coordinates)


def test_refusals_and_help_know_it(path, capsys):
    path.write_text("dear sir")
    assert main([str(path)]) == 2
    assert capsys.readouterr().err == f"pgcp-run: {path}: not a readable TOY file: it does not begin with the word toy\n"
    path.write_text("toy ../faces.txt 0 0 0")
    assert main([str(path)]) == 2
    assert "lies outside the mesh's folder" in capsys.readouterr().err
    path.with_suffix(".ply").write_text("toy faces.txt")
    assert main([str(path.with_suffix(".ply"))]) == 2
    assert capsys.readouterr().err.endswith("; it looks like a toy; name it .toy\n")
    path.with_suffix(".abc").write_text("dear sir")
    assert main([str(path.with_suffix(".abc"))]) == 2
    assert ".toy" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["--help"])
    assert ".toy" in capsys.readouterr().out
