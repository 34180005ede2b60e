"""``--compare``: several methods on one mesh, one table."""

from __future__ import annotations

import json

import pytest
from meshes import grid, lifted, spheroid, torus

import pgcp
from pgcp.cli.main import main
from pgcp.errors import SolveFailedError
from pgcp.methods.base import Method, whole
from pgcp.methods.registry import METHODS
from pgcp.report.comparison import as_markdown, as_text, best_of, records

HILLS = lifted(grid(9, jitter=0.3))


@pytest.fixture
def failing():
    """A method that finds no map."""

    def fails(_run, _parts):
        raise SolveFailedError("made to fail | here")

    method = Method("failing", ("disk",), "fails", "nothing", "none", whole(fails))
    yield METHODS.register(method)
    METHODS.remove(method.name)


def test_all_methods_are_compared_on_every_target_that_fits():
    rows = pgcp.compare(HILLS)
    expected = {(t, m.name) for t in ("free", "disk") for m in METHODS.all() if m.targets is None or t in m.targets}
    assert {(row.target, row.method) for row in rows} == expected
    for row in rows:
        alone = pgcp.parameterize(HILLS, method=row.method, target=row.target)
        assert row.result.coordinates.tobytes() == alone.coordinates.tobytes()
    assert {row.target for row in pgcp.compare(spheroid(3, 1.5)[0], ["pgcp"])} == {"sphere"}


def test_the_best_has_no_fold_and_the_least_mean_error():
    rows = pgcp.compare(HILLS)
    for target, best in best_of(rows).items():
        errors = [row.result.quality.angle_mean_deg for row in rows if row.target == target and not row.result.quality.folds]
        assert best.result.quality.angle_mean_deg == min(errors)
    marked = [record for record in records(rows) if record["best"]]
    assert len(marked) == 2


def test_a_method_that_fails_is_a_row(failing):
    rows = pgcp.compare(HILLS, ["cem", "failing"])
    good, bad = rows
    assert good.result is not None
    assert (bad.result, bad.problem) == (None, "made to fail | here")
    assert as_text(rows).splitlines()[2].endswith("made to fail | here")
    assert as_markdown(rows).splitlines()[3].endswith("| made to fail \\| here |")


def test_the_command_prints_the_table_and_writes_it(tmp_path, capsys):
    pgcp.write_mesh(tmp_path / "hills.ply", HILLS)
    assert main([str(tmp_path / "hills.ply"), "--compare", "cem,scp"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[1].split()[:5] == ["target", "method", "mean", "sd", "max"]
    assert [line.split()[:2] for line in said[2:4]] == [["free", "scp"], ["disk", "cem"]]
    out = tmp_path / "hills_pgcp"
    assert sorted(path.name for path in out.iterdir()) == ["compare.json", "compare.md", "compare.png"]
    told = json.loads((out / "compare.json").read_text())
    assert [row["method"] for row in told] == ["scp", "cem"]
    assert main([str(tmp_path / "hills.ply"), "--compare", "all", "--target", "disk", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert {row["target"] for row in rows} == {"disk"}
    assert sum(row["best"] for row in rows) == 1


def test_what_cannot_be_compared_is_said(tmp_path, failing, capsys):
    pgcp.write_mesh(tmp_path / "hills.ply", HILLS)
    pgcp.write_mesh(tmp_path / "torus.ply", torus())
    for words, said in (
        (["torus.ply", "--compare", "all"], "genus 1"),
        (["hills.ply", "--compare", "cpd"], "unknown method 'cpd'"),
        (["hills.ply", "--compare", "cem", "--target", "free"], "of the methods cem, none maps to the target free"),
    ):
        assert main([str(tmp_path / words[0]), *words[1:]]) == 2
        assert said in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hills.ply", "torus.ply"]
    assert main([str(tmp_path / "hills.ply"), "--compare", "failing", "--quiet"]) == 3
