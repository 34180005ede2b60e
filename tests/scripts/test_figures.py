"""figures.py: one SVG of measured tables."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from datetime import date

import figures
import pytest

HEAD = "mesh\tvertices\tcontestant\trun\tstatus\tpatches\twall_s\tcpu_s\tpeak_mb\troot_peak_mb\n"


@pytest.fixture
def benchmark(tmp_path):
    path = tmp_path / "benchmark.tsv"
    rows = [
        "a\t1000\tpgcp\t0\t0\t6\t1.5\t2\t200\t100",
        "a\t1000\tpgcp\t1\t0\t6\t0.5\t2\t\t100",
        "a\t1000\tpgcp\t2\t0\t6\t0.7\t2\t\t1",
    ]
    rows += [
        "a\t1000\tpardiso\t0\t0\t\t0.4\t1\t90\t90",
        "b\t50000\tpgcp\t0\t0\t6\t3\t4\t500\t400",
        "b\t50000\tlscm\t0\t1\t\t9\t9\t9\t9",
    ]
    path.write_text(HEAD + "\n".join(rows) + "\n")
    return path


def test_medians_of_good_runs_are_taken_and_the_most_memory(benchmark):
    found = figures.by_contestant(figures.rows_of([benchmark]))
    assert found == {"pgcp": [(1000, 0.7, 200.0), (50000, 3.0, 500.0)], "pardiso": [(1000, 0.4, 90.0)]}


def test_the_picture_is_one_svg_with_day_machine_and_versions(benchmark, tmp_path):
    speedup = tmp_path / "speedup.tsv"
    speedup.write_text("workers\tn\tT_n\n1\t2\t4.0\n1\t4\t3.5\n2\t2\t2.5\n2\t4\t2.1\n")
    figures.main([str(benchmark), "--speedup", str(speedup), "--output", str(tmp_path / "out.svg")])
    text = " ".join(ET.parse(tmp_path / "out.svg").getroot().itertext())
    for words in ("pgcp-run", "PARDISO, one Laplacian", "2 workers", date.today().isoformat(), "numpy"):
        assert words in text
    assert "libigl" not in text  # its only run failed


def test_tables_without_rows_are_refused(tmp_path):
    (tmp_path / "empty.tsv").write_text(HEAD)
    with pytest.raises(SystemExit, match="the tables have no rows"):
        figures.main([str(tmp_path / "empty.tsv"), "--output", str(tmp_path / "out.svg")])
