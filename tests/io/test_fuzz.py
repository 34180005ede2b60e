"""Spoiled files: whatever is done to a good file, it is read, or refused with one sentence."""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from trimesh_files import SEEDS, TEXTS, THROUGH_OTHERS, packed

import pgcp.report.picture
from pgcp.cli.main import main
from pgcp.errors import InputError
from pgcp.io.formats import readable
from pgcp.io.read import read_cuts, read_mesh

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "fuzz.py"
_spec = importlib.util.spec_from_file_location("fuzz", SCRIPT)
fuzz = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(fuzz)
GOOD = fuzz.seeds() | {kind: [data] for kind, data in (SEEDS | THROUGH_OTHERS).items()}
READ = {kind.name: kind for kind in readable()}
NUMBER = re.compile(rb"-?\d+(?:\.\d+)?")
WORDS = [
    b"nan", b"inf", b"-1", b"0", b"1.5", b"1e308", b"1e999", b"-0", b"2147483648", b"4294967295", b"9223372036854775808",
    b"-9223372036854775809", b"1" * 400, b"1_0", b"1,5", b"0x10", b"", b"[]", b"null", b"\xff",
]  # fmt: skip
RAW = [bytes(4), b"\xff" * 4, b"\xff\xff\xff\x7f", b"\x00\x00\xc0\x7f", b"\x00\x00\x80\x7f", b"\x00\x00\x00\x80", b"\xff" * 8]


@st.composite
def spoiled(draw, kind):
    """A good file of a kind with one to three things done to it, or to a file in it where it is an archive."""
    inside = TEXTS.get(kind, {})
    if "" not in inside and inside and draw(st.booleans()):
        name = draw(st.sampled_from(sorted(inside)))
        return packed({**inside, name: draw(changed(inside[name].encode()))})
    return draw(changed(draw(st.sampled_from(GOOD[kind]))))


@st.composite
def changed(draw, data):
    """These bytes with one to three things done to them."""
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(0, len(data)))
        other = draw(st.integers(0, len(data)))
        change = draw(
            st.sampled_from(["flip", "cut", "splice", "number", "number", "number", "raw", "drop", "double", "insert"])
        )
        numbers = list(NUMBER.finditer(data))
        lines = data.splitlines(keepends=True)
        if change == "flip":
            byte = data[place : place + 1]
            data = data[:place] + bytes(b ^ draw(st.integers(1, 255)) for b in byte) + data[place + 1 :]
        elif change == "cut":
            data = data[:place]
        elif change == "splice":
            data = data[:place] + data[other : other + draw(st.integers(0, 200))] + data[place:]
        elif change == "number" and numbers:
            found = numbers[place % len(numbers)]
            data = data[: found.start()] + draw(st.sampled_from(WORDS)) + data[found.end() :]
        elif change == "raw":
            word = draw(st.sampled_from(RAW))
            data = data[:place] + word + data[place + len(word) :]
        elif change == "drop" and lines:
            del lines[place % len(lines)]
            data = b"".join(lines)
        elif change == "double" and lines:
            lines.insert(other % len(lines), lines[place % len(lines)])
            data = b"".join(lines)
        elif change == "insert":
            data = data[:place] + draw(st.binary(max_size=20)) + data[place:]
    return data


def often(count):
    return settings(max_examples=count, derandomize=True, deadline=None, database=None, suppress_health_check=list(HealthCheck))


def test_every_format_that_is_read_is_spoiled():
    assert set(GOOD) == {*READ, "cuts"}
    assert set(fuzz.FORMATS) == {"cuts", *(name for name, kind in READ.items() if not kind.needs)}


@pytest.mark.parametrize("kind", GOOD)
def test_spoiled_files_are_read_or_refused(kind, tmp_path):
    if kind in SEEDS | THROUGH_OTHERS:
        try:
            READ[kind].check_packages("testing")
        except InputError as problem:
            pytest.skip(str(problem))
    path = tmp_path / f"m.{kind}"
    read = read_cuts if kind == "cuts" else read_mesh
    seen = {"read": 0, "refused": 0}

    @often(150)
    @given(spoiled(kind))
    def check(data):
        path.write_bytes(data)
        start = time.perf_counter()
        tracemalloc.start()
        try:
            read(path)
            seen["read"] += 1
        except InputError as problem:
            seen["refused"] += 1
            assert "\n" not in str(problem)
            assert not isinstance(problem.__cause__, MemoryError)
        finally:
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
        assert time.perf_counter() - start < 5
        assert peak < 10 * len(data) + 100e6

    check()
    assert min(seen.values()) > 0
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("kind", fuzz.FORMATS)
def test_spoiled_files_through_the_command(kind, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(pgcp.report.picture, "draw", lambda _: b"picture")
    path, out = tmp_path / f"m.{kind}", tmp_path / "out"
    words = ["--json", "--patches", "2", "--output-dir", str(out)]
    if kind == "cuts":
        (tmp_path / "m.ply").write_bytes(GOOD["ply"][0])
        words = [str(tmp_path / "m.ply"), "--cuts", str(path), "--repair-cuts", *words]
    else:
        words = [str(path), *words]

    statuses: list[int] = []

    @often(20)
    @example(GOOD[kind][0])
    @given(spoiled(kind))
    def check(data):
        path.write_bytes(data)
        status = main(words)
        said, complaint = capsys.readouterr()
        assert json.loads(said)["status"] == status
        statuses.append(status)
        if out.exists():
            folds = json.loads(said)["quality"]["folds"]
            assert (status, complaint) == (0, "") if folds == 0 else status == 3 and f"the map has {folds} folded" in complaint
            with np.load(out / f"{'m' if kind == 'cuts' else path.stem}.npz") as results:
                assert all(np.isfinite(results[name]).all() for name in results)
            for name in out.iterdir():
                name.unlink()
            out.rmdir()
            return
        assert status in (2, 3), complaint
        assert complaint.count("\n") == 1
        assert complaint.startswith("pgcp-run: ")
        assert "a bug" not in complaint

    check()
    assert {0, 2} <= set(statuses)


def test_the_guided_fuzzer_runs(tmp_path):
    pytest.importorskip("atheris", reason="atheris is not installed (pip install -e .[fuzz])")
    command = [sys.executable, SCRIPT, "--seconds", "4", "--formats", "ply,gltf", "--corpus", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [line.split("\t") for line in done.stdout.splitlines()[:2]]
    assert [(row[0], row[2]) for row in rows] == [("ply", "good"), ("gltf", "good")]
    assert all(int(row[1].split()[0]) > 100 for row in rows)
    assert list(tmp_path.glob("crash-*")) == []
