"""tables.py: the printed data are consistent, and ours stand beside them in every format."""

from __future__ import annotations

import json
import re
from pathlib import Path

import measured
import numpy as np
import pytest
import tables
from measured import Results, Surface
from meshes import cap
from printed import FAILED, compare, count_of, fits, load

import pgcp
from pgcp.methods.registry import METHODS

PRINTED = load()
PAGE = Path(__file__).resolve().parents[2] / "docs" / "paper-tables.md"
SPHERE = Surface("david_head", 10671, True)


def ear():
    """A cap without some of its rim: 367 vertices, as many as the papers' Ear has."""
    mesh, _ = cap(11)
    faces = mesh.faces[(mesh.faces < len(mesh.vertices) - 30).all(axis=1)]
    used, index = np.unique(faces, return_inverse=True)
    return pgcp.Mesh(mesh.vertices[used], index.reshape(-1, 3), "ear")


@pytest.fixture(scope="module")
def measured_once(tmp_path_factory):
    """Two tables measured on one mesh: the results file, and the text."""
    folder = tmp_path_factory.mktemp("papers")
    (folder / "meshes").mkdir()
    pgcp.write_mesh(folder / "meshes" / "ear.ply", ear())
    (folder / "meshes" / "notes.txt").write_text("no mesh")
    words = [
        "--table",
        "ccem-1",
        "--table",
        "cdcp-1",
        "--meshes",
        str(folder / "meshes"),
        "--results",
        str(folder / "all.json"),
    ]
    tables.main([*words, "--output", str(folder / "all.txt")])
    return folder / "all.json", (folder / "all.txt").read_text()


def again(results, form, capsys):
    """The same tables in another format, nothing measured."""
    tables.main(["--table", "ccem-1", "--table", "cdcp-1", "--results", str(results), "--format", form])
    return capsys.readouterr().out


def markdown_tables(text):
    """Every table as rows of cells."""
    found, rows = [], []
    for line in [*text.splitlines(), ""]:
        if line.startswith("| "):
            rows.append([cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]])
        elif rows:
            found.append(rows)
            rows = []
    return found


def test_markdown_has_ours_beside_what_is_printed(measured_once, capsys):
    results, _ = measured_once
    angles, energies, *_ = markdown_tables(again(results, "markdown", capsys))
    assert {len(row) for row in energies} == {len(energies[0])}
    assert len(energies) == 2 + 16 * 3
    first = dict(zip(energies[0], energies[2], strict=True))
    assert (first["surface"], first["method"], first["E_C"], first["ours on"]) == ("Ear", "FDCP", "0.1653", "ear")
    runs = json.loads(results.read_text())["runs"]
    key = measured.key_of(Surface("ear", 367, False), "disk", {"method": "fdcp", "moebius": "none"})
    assert first["our energy"] == f"{runs[key]['energy']:.5f}"
    assert first["our folds"] == "0"
    last = dict(zip(angles[0], angles[-1], strict=True))
    assert (last["method"], last["SD"], last["our mean"], last["ours on"]) == ("CDCP", "0.52", "-", "-")


def test_latex_rows_have_equal_columns(measured_once, capsys):
    text = again(measured_once[0], "latex", capsys)
    found = re.findall(r"\\begin\{longtable\}\{(l+)\}\n(.*?)\\end\{longtable\}", text, re.DOTALL)
    assert len(found) == text.count(r"\begin{longtable}") >= 2
    for columns, body in found:
        rows = [line for line in body.splitlines() if not re.fullmatch(r"\\hline|\\endhead", line)]
        assert all(row.endswith(r"\\") for row in rows)
        assert {len(re.findall(r"(?<!\\)&", row)) + 1 for row in rows} == {len(columns)}
    bare = re.sub(r"\\(?:begin|end|text\w+|section|subsection)\*?\{[^{}]*\}|\{l+\}|\\[_&%$#{}]", "", text)
    assert not re.search(r"[#$%^_~{}<>|]", bare)


def test_results_are_not_measured_again(measured_once, capsys, monkeypatch):
    results, text = measured_once
    monkeypatch.setattr(measured, "run_once", lambda *_: pytest.fail("it was measured"))
    assert again(results, "text", capsys) == text
    assert "On the same meshes, 9 printed figures of accuracy have one of ours beside them." in text


def test_a_method_that_fails_is_a_row(measured_once, tmp_path, capsys, monkeypatch):
    pgcp.write_mesh(tmp_path / "ear.ply", ear())
    compute = pgcp.compute

    def stops(mesh, options):
        if options.method == "ldm":
            raise pgcp.NumericalError("ear: it does not converge")
        return compute(mesh, options)

    monkeypatch.setattr(pgcp, "compute", stops)
    tables.main(["--table", "cdcp-2", "--meshes", str(tmp_path), "--format", "markdown"])
    text = capsys.readouterr().out
    rows = markdown_tables(text)[0]
    fdcp, ldcp, cdcp = (dict(zip(rows[0], row, strict=True)) for row in rows[2:5])
    assert (ldcp["our mean"], ldcp["remark"]) == ("-", "ear: it does not converge")
    assert float(fdcp["our mean"]) > 0
    assert float(cdcp["our mean"]) > 0
    assert "cdcp-2, Ear, LDCP: ours has no map" in text


def entry(table, surface, number=0):
    return [one for one in PRINTED.tables[table].entries if one.surface == surface][number]


def test_the_nearest_surface_is_said():
    human = [Surface("human_brain", 48463, False), Surface("hand", 53054, False), Surface("man_bust", 25905, False), SPHERE]
    for table, surface, wanted in [
        ("cdcp-1", "Human Brain", ("human_brain", "the same")),
        ("pgcp-2", "Hand", ("hand", "the same")),
        ("cdcp-1", "Left Hand", ("hand", "same model")),
        ("pgcp-1", "Sophie", ("man_bust", "in size")),
        ("pgcp-3", "David", ("david_head", "same model")),
    ]:
        found, relation = tables.nearest(PRINTED, entry(table, surface), human)
        assert (found.name, relation) == wanted
    assert tables.nearest(PRINTED, entry("pgcp-3", "Asian Dragon"), human) is None


def test_printed_numbers_and_verdicts():
    assert [count_of(text) for text in ("48K", "(1M)", "17,334", "")] == [(48000, 1000), (1000000, 1000000), (17334, 1), None]
    assert fits("48K", 48463)
    assert not fits("48K", 48501)
    assert not fits("17,334", 17335)
    assert compare("1.42", 1.4249).is_equal
    worse = compare("1.42", 1.4412)
    assert (worse.is_worse, worse.is_clear) == (True, True)
    assert not compare("1.42", 1.428).is_clear
    assert compare("<0.1", 0.02).is_equal
    assert compare("0.2", 0.14).more == pytest.approx(-0.06)


def by_place(table, label):
    found = [one for one in PRINTED.tables[table].entries if one.label == label]
    return {(one.target, one.surface): (one.vertices, dict(one.values)) for one in found}


def test_tables_of_pgcp_agree_with_each_other():
    own = by_place("pgcp-1", "PGCP") | by_place("pgcp-2", "PGCP") | by_place("pgcp-3", "PGCP")
    assert by_place("pgcp-4", "PGCP") == own
    for label in ("CEM", "PGCP"):
        assert by_place("pgcp-8", label) == by_place("pgcp-2", label)
    for one in (*PRINTED.tables["pgcp-5"].entries, *PRINTED.tables["pgcp-7"].entries):
        if one.vertices:
            known = own.get((one.target, one.surface)) or own["free", one.surface]
            assert one.vertices == f"({known[0]})", one


def test_speedups_and_efficiencies_agree():
    for one in PRINTED.tables["pgcp-6"].entries:
        n, size, speedup, ratio, efficiency = one.values.values()
        assert float(ratio) == int(n) / 2
        assert compare(efficiency, float(speedup) / float(ratio)).is_equal or int(n) == 2
        assert abs(count_of(size)[0] * int(n) - 85_000) <= 1000 * int(n)


def test_tables_of_cdcp_and_ccem_agree():
    angles, seconds = by_place("cdcp-1", "CDCP"), by_place("cdcp-2", "CDCP")
    assert list(angles) == list(seconds)
    energies = by_place("ccem-1", "CCEM")
    shared = [place for place in angles if place in energies]
    assert len(shared) == 12
    assert all(angles[place][0] == seconds[place][0] == energies[place][0] for place in shared)
    for rows in (angles, energies):
        counts = [count_of(vertices)[0] for vertices, _ in rows.values()]
        assert counts == sorted(counts)


@pytest.mark.parametrize("key", PRINTED.tables)
def test_printed_figures_are_numbers_and_methods_exist(key):
    for one in PRINTED.tables[key].entries:
        for measure, value in one.values.items():
            assert value in (None, "", FAILED) or re.fullmatch(r"<?\d+(\.\d+)?K?", value), (one, measure)
        if "method" in one.options:
            assert one.target in (METHODS.get(one.options["method"]).targets or (one.target,))


def test_the_page_has_what_is_printed():
    found = markdown_tables(PAGE.read_text(encoding="utf-8"))
    for (key, table), on_page in zip(PRINTED.tables.items(), found, strict=False):
        rows = tables.put_beside(PRINTED, table, Results())
        wanted = tables.speedup_rows(table, rows) if table.is_speedup else tables.rows_of(table, rows)
        width = wanted[0].index("ours on")
        heads, _, *body = on_page
        assert [cell.replace("\\", "") for cell in heads[:width]] == wanted[0][:width], key
        assert [row[:width] for row in body] == [row[:width] for row in wanted[1:]], key
    assert len(found) >= len(PRINTED.tables)
