"""Several meshes in one command: one start, one set of workers, a table, and the worst exit status."""

from __future__ import annotations

import json

import numpy as np
import pytest
from meshes import grid, icosphere, lifted, torus

from pgcp.cli.main import main
from pgcp.cli.several import SEVERITY, names_of
from pgcp.io.write import write_mesh

FAST = ("--no-png", "--write", "npz")


@pytest.fixture
def meshes(tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
    write_mesh(tmp_path / "a" / "hills.ply", lifted(grid(6)))
    write_mesh(tmp_path / "b" / "hills.ply", lifted(grid(7)))
    write_mesh(tmp_path / "ball.ply", icosphere(2))
    write_mesh(tmp_path / "ring.ply", torus())
    return tmp_path


def test_each_is_mapped_whatever_becomes_of_the_others(meshes, capsys):
    names = ["a/hills.ply", "b/hills.ply", "ring.ply", "nosuch.ply", "ball.ply"]
    out = meshes / "out"
    assert main([*(str(meshes / name) for name in names), *FAST, "--output-dir", str(out)]) == 2
    said = capsys.readouterr()
    assert said.err.count("pgcp-run: ") == 2
    lines = said.out.splitlines()
    assert lines[0].split()[:2] == ["mesh", "outcome"]
    assert [line.split()[1] for line in lines[1:6]] == ["mapped", "mapped", "refused", "refused", "mapped"]
    assert lines[6] == "3 of 5 meshes mapped"
    assert sorted(path.name for path in out.iterdir()) == ["a_hills", "b_hills", "ball"]
    assert len(np.load(out / "b_hills" / "hills.npz")["uv"]) == 64


def test_one_object_says_all(meshes, capsys):
    assert main([str(meshes / "ball.ply"), str(meshes / "ring.ply"), *FAST, "--json"]) == 2
    said = json.loads(capsys.readouterr().out)
    assert said["status"] == 2
    assert [row["status"] for row in said["meshes"]] == [0, 2]
    assert said["meshes"][0]["quality"]["folds"] == 0
    assert "genus 1" in said["meshes"][1]["message"]
    assert (meshes / "ball_pgcp" / "ball.npz").exists()


def test_workers_are_started_once_and_results_are_those_of_single_runs(meshes, capsys, monkeypatch):
    from pgcp.runtime.executors import connection

    started = []
    begin = connection.start_cluster
    monkeypatch.setattr(connection, "start_cluster", lambda workers: started.append(workers) or begin(workers))
    names = [str(meshes / "a" / "hills.ply"), str(meshes / "ball.ply")]
    assert main([*names, *FAST, "--workers", "2", "--patches", "3", "--output-dir", str(meshes / "both")]) == 0
    assert started == [2]
    for name, stem, key in zip(names, ("hills", "ball"), ("uv", "sphere"), strict=True):
        assert main([name, *FAST, "--patches", "3", "--quiet", "--output-dir", str(meshes / stem)]) == 0
        alone, together = (np.load(meshes / folder / f"{stem}.npz")[key] for folder in (stem, f"both/{stem}"))
        assert alone.tobytes() == together.tobytes()
    capsys.readouterr()


@pytest.mark.parametrize("option", [["-o", "x.npz"], ["--compare", "scp"], ["--centre", "3"]])
def test_options_of_one_mesh_are_refused(option, meshes, capsys):
    assert main([str(meshes / "ball.ply"), str(meshes / "ring.ply"), *option]) == 2
    assert "goes with one mesh, and 2 are named" in capsys.readouterr().err
    assert not (meshes / "ball_pgcp").exists()


def test_check_only_looks_at_each(meshes, capsys):
    assert main([str(meshes / "ball.ply"), str(meshes / "ring.ply"), "--check-only"]) == 2
    said = capsys.readouterr().out
    assert "ball.ply:" in said
    assert "ring.ply:" in said


def test_options_may_stand_between_meshes(meshes, capsys):
    assert main([str(meshes / "ball.ply"), "--no-png", str(meshes / "a" / "hills.ply"), "--write", "npz"]) == 0
    assert "2 of 2 meshes mapped" in capsys.readouterr().out


def test_names_of_results_differ(tmp_path):
    paths = ["a/x.ply", "b/x.ply", "y.ply", "c/z.ply", "c/z.obj"]
    assert names_of([tmp_path / p for p in paths]) == ["a_x", "b_x", "y", "z.ply", "z.obj"]
    assert len(set(names_of([tmp_path / "x.ply"] * 3))) == 3


def test_a_bug_is_worse_than_anything_else():
    assert [max(pair, key=SEVERITY.index) for pair in ((0, 2), (2, 3), (3, 4), (4, 1))] == [2, 3, 4, 1]
