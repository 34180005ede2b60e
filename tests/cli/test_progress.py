"""What is shown while a run goes on."""

from __future__ import annotations

import io
import logging
import re
import time

import pytest
from meshes import grid, lifted

import pgcp
from pgcp.cli import progress
from pgcp.cli.main import main


@pytest.fixture
def hills_file(tmp_path):
    pgcp.write_mesh(tmp_path / "hills.ply", lifted(grid(10)))
    return tmp_path / "hills.ply"


def test_a_line_names_what_lasts_and_again_what_lasts_longer(monkeypatch):
    monkeypatch.setattr(progress, "_SOON", 0.2)
    monkeypatch.setattr(progress, "_AGAIN", 0.2)
    monkeypatch.setattr(progress, "_LOOK", 0.01)
    out = io.StringIO()
    with progress.Lines(out) as lines:
        lines("short", 0, 0)
        lines("short", 1, 1)
        time.sleep(0.4)  # between stages nothing is said
        assert out.getvalue() == ""
        lines("long", 0, 0)
        lines("long", 1, 6)
        deadline = time.monotonic() + 20
        while out.getvalue().count("\n") < 2 and time.monotonic() < deadline:
            time.sleep(0.01)
    assert len(re.findall(r"(?m)^ +\d+\.\d s: long, 1 of 6$", out.getvalue())) >= 2


def test_a_closed_stream_ends_the_lines_and_nothing_else(monkeypatch):
    monkeypatch.setattr(progress, "_SOON", 0.0)
    monkeypatch.setattr(progress, "_LOOK", 0.01)
    out = io.StringIO()
    with progress.Lines(out) as lines:
        out.close()
        lines("read", 0, 0)
        time.sleep(0.05)
    assert not lines._thread.is_alive()


def test_every_stage_is_shown_as_it_begins_and_ends(hills_file, monkeypatch, tmp_path):
    heard = []

    class Heard(progress.Silent):
        def __call__(self, *said):
            heard.append(said)

    monkeypatch.setattr("pgcp.cli.main.display", lambda _quiet: Heard())
    assert main([str(hills_file), "--patches", "3"]) == 0
    stages = list(dict.fromkeys(stage for stage, _, _ in heard))
    assert stages[:3] == ["start", "read", "check"]
    assert stages[-3:] == ["measure", "draw", "write"]
    for stage in stages:
        told = [(done, total) for name, done, total in heard if name == stage]
        assert told[0] == (0, 0), stage
        assert told[-1][0] == told[-1][1] > 0, stage
    assert ("flatten", 3, 3) in heard


def test_the_log_file_has_every_stage_and_is_added_to(hills_file, tmp_path):
    for _ in range(2):
        assert main([str(hills_file), "--patches", "2", "--quiet", "--log-file", str(tmp_path / "run.log")]) == 0
    lines = (tmp_path / "run.log").read_text().splitlines()
    assert sum(line.endswith("INFO read: begun") for line in lines) == 2
    assert sum(bool(re.search(r"INFO measure: \d+\.\d\d s$", line)) for line in lines) == 2
    assert logging.getLogger("pgcp").handlers == []


def test_a_log_file_that_cannot_be_written_is_said(hills_file, tmp_path, capsys):
    assert main([str(hills_file), "--log-file", str(tmp_path / "no" / "run.log")]) == 2
    assert (
        capsys.readouterr().err == f"pgcp-run: {tmp_path / 'no' / 'run.log'}: cannot write the log: No such file or directory\n"
    )
    assert not (tmp_path / "hills_pgcp").exists()


def test_python_hears_of_stages_by_the_logger(hills_file, caplog):
    with caplog.at_level(logging.INFO, logger="pgcp"):
        pgcp.parameterize(hills_file, patches=2)
    assert "flatten: begun" in caplog.messages
