"""What surrounds the command: closed streams, memory and files that are cut off. One sentence, or no matter at all."""

from __future__ import annotations

import errno
import json
import os
import resource
import subprocess
import sys

import numpy as np
import pytest
from meshes import grid, lifted
from said import without_progress

import pgcp
from pgcp.errors import InputError
from pgcp.runtime import address_space
from pgcp.runtime.address_space import check_address_space

QUIET = ("--no-ply", "--no-png", "--no-html")


@pytest.fixture(scope="module")
def mesh_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "hills.obj"
    pgcp.write_mesh(path, lifted(grid(24, jitter=0.2)))
    return path


def command(folder, *words, before=lambda: None):
    """Status, standard output and error of the command."""
    run = [sys.executable, "-m", "pgcp", *map(str, words)]
    environment = {**os.environ, "PYTHONWARNINGS": ""}
    done = subprocess.run(run, cwd=folder, capture_output=True, text=True, preexec_fn=before, env=environment, check=False)
    return done.returncode, done.stdout, without_progress(done.stderr)


@pytest.mark.parametrize("words", [(), pytest.param(("--json",), marks=pytest.mark.slow), ("--quiet", "--workers", "1")])
@pytest.mark.parametrize("closed", [(1,), (0, 1, 2)])
def test_closed_streams_are_no_matter(closed, words, mesh_file, tmp_path):
    assert command(tmp_path, mesh_file, "--output-dir", "out", *QUIET, *words, before=lambda: list(map(os.close, closed))) == (
        0,
        "",
        "",
    )
    with np.load(tmp_path / "out" / "hills.npz") as data:
        assert np.isfinite(data["uv"]).all()
    json.loads((tmp_path / "out" / "report.json").read_text())


def test_closed_streams_hide_no_failure(tmp_path):
    status, out, err = command(tmp_path, "nowhere.ply", before=lambda: os.close(1))
    assert (status, out) == (2, "")
    assert err == "pgcp-run: nowhere.ply: there is no such file\n"
    assert command(tmp_path, "nowhere.ply", before=lambda: os.close(2)) == (2, "", "")


@pytest.mark.parametrize("words", [(), ("--check-only",), ("--workers", "1")])
def test_little_memory_is_said_before_work_starts(words, mesh_file, tmp_path):
    limit = 600_000 * 1024
    status, out, err = command(
        tmp_path, mesh_file, "--json", *words, before=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    )
    assert status == 2
    assert err == ("pgcp-run: a run needs about 1.2 GB of memory, but this process may have 0.6 GB (ulimit -v); allow more\n")
    assert json.loads(out)["message"] in err
    assert list(tmp_path.iterdir()) == []


def test_the_need_grows_with_the_mesh(monkeypatch):
    check_address_space()
    monkeypatch.setattr(address_space, "address_limit", lambda: 1_500_000_000)
    check_address_space()
    check_address_space(100_000, 199_000, 6)
    with pytest.raises(
        InputError, match=r"^1000000 vertices in 10 patches need about 1\.7 GB of memory, .* 1\.5 GB \(ulimit -v\)"
    ):
        check_address_space(1_000_000, 1_990_000, 10)
    check_address_space(900_000, 1_790_000, 50)
    with pytest.raises(InputError, match="need about"):
        pgcp.parameterize(FakeMesh())


class FakeMesh:
    """A million vertices."""

    vertices = lifted(grid(1000)).vertices
    faces = grid(1000).faces


@pytest.mark.parametrize(("limit", "file", "workers"), [(4_000, "patch-00000.npz", 0), (4_000, "patch-00000.npz", 1)])
def test_a_file_that_may_not_grow_is_named(limit, file, workers, mesh_file, tmp_path):
    words = ("--patches", 6, "--workers", workers, "--store", tmp_path, "--output-dir", tmp_path / "out", *QUIET)
    status, _, err = command(
        tmp_path, mesh_file, *words, before=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    )
    assert status == 2
    assert err.startswith("pgcp-run: ")
    assert err.endswith(f"{file}: File too large\n")
    assert err.count("\n") == 1
    assert list(tmp_path.rglob("*.part")) == []


def test_a_result_that_may_not_grow_is_named(mesh_file, tmp_path, monkeypatch, capsys):
    """The second of three files, as where the disk gets full."""
    from pgcp.cli.main import main

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("pgcp.io.write._write", lambda stream, kind, *_: full() if kind.name == "obj" else {})
    assert main([str(mesh_file), "--output-dir", str(tmp_path), "--write", "npz,obj,ply", "--no-png", "--quiet"]) == 2
    where = f"{tmp_path}: cannot write the results: {tmp_path / 'hills.obj'}: No space left on device"
    assert without_progress(capsys.readouterr().err) == f"pgcp-run: {where}\n"
    assert list(tmp_path.iterdir()) == []


def test_memory_that_runs_out_is_no_bug(mesh_file, tmp_path, monkeypatch, capsys):
    from pgcp.cli.main import main

    def greedy(*_):
        raise MemoryError("Unable to allocate 9 PiB")

    monkeypatch.setattr("pgcp.api.map_surface", greedy)
    assert main([str(mesh_file), "--output-dir", str(tmp_path)]) == 3
    assert capsys.readouterr().err == ("pgcp-run: memory ran out (Unable to allocate 9 PiB); allow more, or use more patches\n")
