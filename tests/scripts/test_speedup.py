"""speedup.py: the table of PGCP section 5.6."""

from __future__ import annotations

import pytest
import speedup


def test_lists_and_ranges_of_numbers():
    assert speedup.numbers("2..4,8,3") == [2, 3, 4, 8]
    with pytest.raises(ValueError, match=r"the range 5\.\.4 is empty"):
        speedup.numbers("5..4")


def test_speedups_and_efficiencies_are_those_of_the_paper():
    def measured(patches, workers, seconds, parallel):
        return speedup.Run(patches, workers, 1200, seconds, {"split": seconds - parallel, "flatten": parallel})

    rows = speedup.table(
        [measured(2, 1, 12.0, 8.0), measured(6, 1, 8.0, 6.0), measured(2, 2, 6.0, 5.0), measured(6, 2, 4.0, 3.0)]
    )
    last = dict(zip(rows[0], rows[-1], strict=True))
    wanted = {"workers": "2", "n": "6", "V/n": "200", "T_n": "4.00", "S_n": "1.50", "n/2": "3.00", "E_n": "0.50"}
    assert {name: last[name] for name in wanted} == wanted
    assert (last["parallel"], last["S_w"], last["E_w"], last["S_w par."]) == ("3.00", "2.00", "1.00", "2.00")


def test_speedup_makes_table_and_plot(hills_file, table_of, tmp_path):
    options = ["--patches", "2..3", "--workers", "1,2", "--started", "--output-dir", str(tmp_path / "out")]
    speedup.main([str(hills_file), *options])
    rows = table_of(tmp_path / "out" / "speedup.tsv")
    assert [(row["workers"], row["n"]) for row in rows] == [("1", "2"), ("1", "3"), ("2", "2"), ("2", "3")]
    assert all(float(row["flatten"]) > 0 for row in rows)
    assert (tmp_path / "out" / "speedup.png").read_bytes().startswith(b"\x89PNG")
