"""accuracy.py, matrix.py and seams.py: their tables."""

from __future__ import annotations

import accuracy
import matrix
import pytest
import seams
from meshes import cap

import pgcp


@pytest.fixture(scope="module")
def cap_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "cap.ply"
    pgcp.write_mesh(path, cap(6)[0])
    return str(path)


def rows_of(text):
    return [line.split("\t") for line in text.splitlines()]


def test_the_accuracy_table(cap_file, capsys):
    accuracy.main([cap_file, "--patches", "2,3", "--seeds", "0,1"])
    rows = rows_of(capsys.readouterr().out)
    assert [row[2:4] for row in rows[1:]] == [["1", "-"], ["2", "0"], ["2", "1"], ["3", "0"], ["3", "1"]]
    assert all(0.8 < float(row[5]) < 1.2 and row[6] == "0" for row in rows[1:])


def test_the_matrix_counts_runs_and_resumes(cap_file, tmp_path, capsys):
    words = [cap_file, "--patches", "1,300", "--seeds", "0,1", "--output", str(tmp_path / "out.tsv")]
    matrix.main(words)
    said = capsys.readouterr()
    rows = rows_of(said.out)
    assert [row[1:4] for row in rows] == [[t, k, s] for t in ("free", "disk") for k in ("1", "300") for s in ("0", "1")]
    assert [row[6] for row in rows] == ["weld", "weld", "failed", "failed"] * 2
    assert all(row[5] == "0" for row in rows if row[6] != "failed")
    assert "300 patches were asked for" in rows[2][9]
    assert "8 runs:" in said.err
    assert "failed 4" in said.err
    matrix.main(words)
    again = capsys.readouterr()
    assert again.out == ""
    assert again.err == said.err


def test_seams_are_compared(cap_file, tmp_path, capsys):
    seams.main([cap_file, "--targets", "free", "--patches", "3", "--plot", str(tmp_path / "plot.png")])
    header, *rows = rows_of(capsys.readouterr().out)
    assert header[3:7] == ["seams", "mean_deg", "near_deg", "elsewhere_deg"]
    assert [row[3] for row in rows] == ["weld", "relax", "exact"]
    for row in rows:
        mean, near, elsewhere = (float(x) for x in row[4:7])
        assert min(near, elsewhere) <= mean <= max(near, elsewhere)
    assert (tmp_path / "plot.png").read_bytes()[:4] == b"\x89PNG"
