"""An application is one thing, registered: the command ``pgcp`` knows it then."""

from __future__ import annotations

import json

import numpy as np
import pytest
from meshes import grid, lifted

import pgcp
from pgcp.apps.base import App, Made, add_mesh, folds_said, map_record
from pgcp.apps.registry import APPS
from pgcp.cli.apps import main
from pgcp.io.write import mesh_files


def _ask(group):
    add_mesh(group)
    group.add_argument("--times", type=float, default=2.0, help="factor")


def _run(call):
    if call["times"] <= 0.0:
        raise pgcp.InputError(f"--times is {call['times']}; it must be more than 0")
    result = call.mapped(call["mesh"], "disk")
    flat = pgcp.Mesh(np.pad(result.coordinates * call["times"], ((0, 0), (0, 1))), result.faces)
    files = {".obj": lambda name: mesh_files(name, flat), "_note.txt": lambda name: {name: b"flat\n"}}
    return Made(files, {"map": map_record(result)}, (f"{call['times']} times as large",), folds_said(result))


@pytest.fixture
def toy():
    app = App("flat", "the map, as a mesh", {".obj": "the map", "_note.txt": "a note"}, _ask, _run)
    yield APPS.register(app)
    APPS.remove(app.name)


@pytest.fixture
def mesh(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pgcp.write_mesh(tmp_path / "hills.ply", lifted(grid(12)))
    return "hills.ply"


def _names(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def test_a_registered_application_runs_through_the_command(toy, mesh, tmp_path, capsys):
    assert main(["flat", mesh, "--times", "3", "--patches", "2"]) == 0
    assert _names(tmp_path) == ["hills.ply", "hills_flat/flat.json", "hills_flat/hills.obj", "hills_flat/hills_note.txt"]
    assert "3.0 times as large" in capsys.readouterr().out
    flat = pgcp.read_mesh("hills_flat/hills.obj")
    assert np.linalg.norm(flat.vertices, axis=1).max() == pytest.approx(3.0)
    assert json.loads((tmp_path / "hills_flat" / "flat.json").read_text())["map"]["target"] == "disk"


def test_single_files_are_told_by_the_ends_of_their_names(toy, mesh, tmp_path, capsys):
    assert main(["flat", mesh, "-o", "some.txt", "-o", "other.obj", "--json"]) == 0
    assert _names(tmp_path) == ["hills.ply", "other.obj", "some.txt"]
    said = json.loads(capsys.readouterr().out)
    assert (said["status"], said["command"], said["results"]) == (0, "flat", ["some.txt", "other.obj"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["flat", "hills.ply", "-o", "map.stl"], "map.stl: flat writes no such file; it writes .obj, _note.txt"),
        (["flat", "hills.ply", "--times", "-1"], "--times is -1.0; it must be more than 0"),
        (["flat", "hills.ply", "--target", "free"], "this needs a map to the target disk, and --target free asks for another"),
        (["flat", "hills.ply", "--tims", "2"], "unrecognized arguments: --tims 2; did you mean --times"),
        (["flat", "lost.ply"], "lost.ply: there is no such file"),
        (["flat", "hills.ply", "--output-dir", "."], ".: results here would stand among what was given"),
        (["flat"], "the following arguments are required: mesh"),
    ],
)
def test_mistakes_are_said_in_one_sentence_and_nothing_is_written(toy, mesh, tmp_path, capsys, words, message):
    assert main(words) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith(f"pgcp flat: {message}")
    assert _names(tmp_path) == ["hills.ply"]


def test_the_mesh_is_never_overwritten(toy, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    pgcp.write_mesh("hills.obj", lifted(grid(6)))
    before = (tmp_path / "hills.obj").read_bytes()
    assert main(["flat", "hills.obj", "-o", "hills.obj"]) == 2
    assert "would take the place of what was given" in capsys.readouterr().err
    assert (tmp_path / "hills.obj").read_bytes() == before


def test_what_is_no_application_is_refused_with_what_may_be_meant(toy, capsys):
    assert main(["flot"]) == 2
    assert capsys.readouterr().err == "pgcp: unknown command 'flot'; did you mean flat?\n"
    assert main(["run", "--version"]) == 0
    assert capsys.readouterr().out.startswith("pgcp-run ")


def test_help_lists_all_applications(toy, capsys):
    assert main([]) == 0
    said = capsys.readouterr().out
    assert "pgcp run" in said
    assert "pgcp flat" in said
    assert all(f"pgcp {name}" in said for name in APPS.names())


@pytest.mark.parametrize("name", APPS.names())
def test_every_application_says_what_it_is(name):
    app = APPS.get(name)
    assert app.name == name
    assert app.summary
    assert app.writes
    assert set(app.usual) <= set(app.writes)
