"""benchmark.py: seconds and memory of processes, contestants in turns, their tables."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import benchmark
import contestants
import numpy as np
import processes
import pytest

import pgcp
from pgcp.elimination import pardiso


def test_memory_and_seconds_are_those_of_all_processes():
    child = "b = bytearray(80_000_000); import time; t = time.process_time()\nwhile time.process_time() < t + 0.5: pass"
    code = f"import subprocess, sys; b = bytearray(40_000_000); subprocess.run([sys.executable, '-c', {child!r}]); sys.exit(7)"
    measured = processes.run_measured([sys.executable, "-c", code])
    assert measured.status == 7
    assert 120e6 < measured.peak_bytes < 170e6
    assert 40e6 < measured.root_peak_bytes < 80e6
    assert 0.5 < measured.cpu_s < 3.0
    assert measured.wall_s > 0.5


def test_the_map_of_scipy_is_that_of_the_package(hills_file):
    mesh = pgcp.read_mesh(hills_file)
    ours = pgcp.parameterize(mesh, method="dncp", moebius="none").coordinates @ [1, 1j]
    theirs = contestants.dncp(mesh, contestants.Stopwatch()) @ [1, 1j]
    ours, theirs = ours - ours.mean(), theirs - theirs.mean()
    turn = np.vdot(theirs, ours) / np.vdot(theirs, theirs)
    assert np.abs(turn * theirs - ours).max() < 1e-3 * np.abs(ours).max()  # other vertices are pinned


@pytest.mark.skipif(not pardiso.is_available(), reason="the package mkl is not installed")
def test_the_yardstick_times_its_parts(hills_file, tmp_path):
    contestants.main(["pardiso", str(hills_file), str(tmp_path / "out")])
    parts = json.loads((tmp_path / "out").read_text())
    assert set(contestants.SOLVE_ONLY) < set(parts)
    assert all(seconds > 0 for seconds in parts.values())


def test_the_solution_of_the_yardstick_is_checked(hills_file, tmp_path, monkeypatch):
    monkeypatch.setattr(contestants.Pardiso, "__init__", lambda *_: None)
    monkeypatch.setattr(contestants.Pardiso, "call", lambda *_: None)
    with pytest.raises(SystemExit, match=r"PARDISO left a residual of 1\.0e\+00"):
        contestants.main(["pardiso", str(hills_file), str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_contestants_run_in_turns_and_every_run_is_told(hills_file, table_of, tmp_path, capsys):
    copy = f"{sys.executable} -c 'import shutil, sys; shutil.copy(*sys.argv[1:])' {{mesh}} {{out}}"
    against = ["--against", "scipy", "--external", copy, "--repeat", "2", "--workers", "0"]
    benchmark.main([*against, "--output-dir", str(tmp_path / "out"), str(hills_file)])
    said = capsys.readouterr().out
    rows = table_of(tmp_path / "out" / "benchmark.tsv")
    names = list(dict.fromkeys(row["contestant"] for row in rows))
    assert [row["contestant"] for row in rows] == 2 * names
    assert names[0] == "pgcp"
    assert names[-1] == f"{Path(sys.executable).name} (1)"
    assert {row["status"] for row in rows} == {"0"}
    assert all(float(row["wall_s"]) > 0 for row in rows)
    assert all(float(row["peak_mb"]) > 1 for row in rows[: len(names)])  # memory is looked at in the first run
    assert {row["peak_mb"] for row in rows[len(names) :]} == {""}
    assert all(float(row["flatten_s"]) > 0 for row in rows if row["contestant"] == "pgcp")
    assert said.splitlines()[0].split()[:3] == ["mesh", "vertices", "contestant"]
    assert (tmp_path / "out" / "benchmark.png").read_bytes().startswith(b"\x89PNG")
