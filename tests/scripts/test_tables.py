"""accuracy.py and seams.py: their tables."""

from __future__ import annotations

import accuracy
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


def test_seams_are_compared(cap_file, tmp_path, capsys):
    seams.main([cap_file, "--targets", "free", "--patches", "3", "--plot", str(tmp_path / "plot.png")])
    header, *rows = rows_of(capsys.readouterr().out)
    assert header[3:7] == ["seams", "mean_deg", "near_deg", "elsewhere_deg"]
    assert [row[3] for row in rows] == ["weld", "relax", "exact"]
    for row in rows:
        mean, near, elsewhere = (float(x) for x in row[4:7])
        assert min(near, elsewhere) <= mean <= max(near, elsewhere)
    assert (tmp_path / "plot.png").read_bytes()[:4] == b"\x89PNG"
