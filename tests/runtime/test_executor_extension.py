"""An executor of one's own: a class in one file, registered, and chosen by its name on the command line."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest
from meshes import grid, lifted

import pgcp
from pgcp.cli.main import main
from pgcp.runtime.executors import EXECUTORS, Executor, ExecutorKind


def copied(item):
    return pickle.loads(pickle.dumps(item))


class Backwards(Executor):
    """The last task first, each a copy that could have come from another process; joins as late as possible."""

    def run_tasks(self, tasks, take):
        for position in reversed(range(len(tasks.items))):
            take(position, self.compute(tasks.stage, tasks.function, copied(tasks.items[position])))

    def run_joins(self, joining):
        while ready := joining.take_ready():
            for node, pair in reversed(ready):
                self.take_joined(joining, node.result, self.compute(joining.stage, node.function, copied(pair)))

    def describe(self):
        return {"kind": "backwards", "workers": 0, "threads_per_worker": 1}


@pytest.fixture
def backwards():
    """The name of the executor, registered for one test."""
    kind = ExecutorKind("backwards", "the last task first", lambda _running, _run, progress, _warm: Backwards(progress))
    yield EXECUTORS.register(kind).name
    EXECUTORS.remove(kind.name)


@pytest.fixture(scope="module")
def hills_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "hills.ply"
    pgcp.write_mesh(path, lifted(grid(24, jitter=0.2)))
    return path


def mapped(hills_file, folder, *words):
    """Coordinates and the report of a run of the command."""
    left_out = "--no-obj", "--no-ply", "--no-png", "--no-html"
    assert main([str(hills_file), "--patches", "5", *left_out, "--quiet", "--output-dir", str(folder), *words]) == 0
    with np.load(folder / "hills.npz") as data:
        return data["uv"].tobytes(), json.loads((folder / "report.json").read_text())


@pytest.mark.parametrize("seams", ["weld", "exact"])
def test_a_registered_executor_runs_the_command(seams, backwards, hills_file, tmp_path):
    usual, first = mapped(hills_file, tmp_path / "threads", "--seams", seams)
    own, report = mapped(hills_file, tmp_path / "own", "--seams", seams, "--executor", backwards)
    assert report["executor"] == {"kind": "backwards", "workers": 0, "threads_per_worker": 1}
    assert {k: v["count"] for k, v in report["tasks"].items()} == {k: v["count"] for k, v in first["tasks"].items()}
    assert own == usual


def test_the_command_offers_what_is_registered(backwards, capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    said = " ".join(capsys.readouterr().out.split())
    assert "--executor {auto,dask,threads,backwards}" in said
    assert "backwards: the last task first" in said


def test_an_executor_that_is_not_registered_is_refused(hills_file, capsys):
    assert main([str(hills_file), "--executor", "backwards"]) == 2
    assert "invalid choice: 'backwards'" in capsys.readouterr().err


def test_threads_are_chosen_by_name_for_a_large_mesh_too(monkeypatch, hills_file, tmp_path):
    monkeypatch.setattr("pgcp.cli.parser._LARGE_FILE", 1)
    monkeypatch.setattr("pgcp.cli.parser.processor_count", lambda: 2)
    _, report = mapped(hills_file, tmp_path, "--executor", "threads")
    assert report["executor"]["workers"] == 0


@pytest.mark.parametrize(("workers", "kind"), [("0", "threads"), ("1", "dask local cluster")])
def test_a_registered_executor_is_not_chosen_unasked(workers, kind, backwards, hills_file, tmp_path):
    _, report = mapped(hills_file, tmp_path, "--workers", workers)
    assert report["executor"]["kind"] == kind
