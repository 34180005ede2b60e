"""A method's own options: declared by the method, and known to the command, the library and the report then."""

from __future__ import annotations

import json

import numpy as np
import pytest
from meshes import grid, lifted

import pgcp
from pgcp.cli.main import main
from pgcp.cli.parser import build_parser
from pgcp.methods.base import Method, OwnOption, whole
from pgcp.methods.common.boundary_energy import on_circle
from pgcp.methods.common.disk import DiskMap, map_disk
from pgcp.methods.registry import METHODS


def _by_length(disk):
    """Boundary by a power of the edges' lengths on the circle, and the harmonic map inside."""
    points, own = disk.run.mesh.vertices[disk.loop], disk.run.options.own
    lengths = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1) ** own["edge_power"]
    lengths = lengths[::-1] if own["order"] == "reversed" else lengths
    angles = 2 * np.pi * (np.cumsum(lengths) - lengths[0]) / lengths.sum()
    return DiskMap(disk.factor.extend(on_circle(angles)), {})


def _positive(power):
    if not power > 0:
        raise pgcp.InputError(f"edge_power is {power}, it must be above 0")


@pytest.fixture
def toy():
    method = Method(
        name="by-power",
        targets=("disk",),
        summary="harmonic",
        guarantees="none",
        reference="none",
        mapper=whole(lambda run, parts: map_disk(run, parts, _by_length)),
        moebius="none",
        own=(
            OwnOption("edge_power", "power of the lengths of edges", 1.0, metavar="P", check=_positive),
            OwnOption("order", "order of the edges", "forward", choices=("forward", "reversed")),
        ),
    )
    yield METHODS.register(method)
    METHODS.remove(method.name)


@pytest.fixture
def bust(tmp_path):
    pgcp.write_mesh(tmp_path / "bust.ply", lifted(grid(8, 12)))
    return str(tmp_path / "bust.ply")


def report_of(bust, *words):
    assert main([bust, "--method", "by-power", "--patches", "2", "--no-png", "--quiet", *words]) == 0
    return json.loads(open(bust.replace(".ply", "_pgcp/report.json")).read())


def test_the_command_takes_it_and_the_report_records_it(toy, bust):
    report = report_of(bust, "--edge-power", "2.0")
    assert (report["options"]["edge_power"], report["options"]["order"]) == (2.0, "forward")
    assert report_of(bust)["options"]["edge_power"] == 1.0


def test_python_takes_it_as_a_keyword_and_it_changes_the_map(toy, bust):
    one, two = (pgcp.parameterize(bust, method=toy.name, edge_power=power).coordinates for power in (1, 2.0))
    assert np.abs(one - two).max() > 1e-3
    own = pgcp.compute(bust, pgcp.Options(method=toy.name, own={"edge_power": 2})).coordinates
    assert np.array_equal(own, two)


def test_the_help_has_it_in_a_group_of_its_own(toy):
    text = build_parser().format_help().split("Options of single methods:")[1]
    assert text.index("--edge-power P") < text.index("--order {forward,reversed}")
    assert "by-power: power of the lengths of edges (default 1.0)" in " ".join(text.split())


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--method", "by-power", "--edge-power", "x"], "edge_power is 'x', it must be a number"),
        (["--method", "by-power", "--edge-power", "-1"], "edge_power is -1.0, it must be above 0"),
        (["--method", "by-power", "--order", "up"], "argument --order: invalid choice: 'up'"),
        (["--edge-power", "2"], "the method pgcp has no option edge_power; it goes with the method by-power"),
        (["--compare", "cem,cdcp", "--edge-power", "2"], "the methods cem, cdcp have no option edge_power; it goes with"),
        (["--edge-powr", "2"], "unrecognized arguments: --edge-powr 2; did you mean --edge-power?"),
    ],
)
def test_a_wrong_one_is_refused_in_a_sentence(toy, bust, capsys, words, sentence):
    assert main([bust, *words]) == 2
    assert sentence in capsys.readouterr().err


def test_python_refuses_a_wrong_one(toy):
    with pytest.raises(pgcp.InputError, match=r"^unknown option 'edge_powr'; did you mean edge_power\?$"):
        pgcp.parameterize("nowhere.ply", method=toy.name, edge_powr=2)
    with pytest.raises(pgcp.InputError, match="order is True, it must be text"):
        pgcp.parameterize("nowhere.ply", method=toy.name, order=True)
    with pytest.raises(pgcp.InputError, match="unknown order 'up'; choose from forward, reversed"):
        pgcp.parameterize("nowhere.ply", method=toy.name, order="up")


def test_a_comparison_gives_it_to_those_that_have_it(toy, bust):
    options = pgcp.Options(target="disk", own={"order": "reversed"})
    rows = pgcp.compare(bust, ["cem", "by-power"], options)
    assert [row.problem for row in rows] == ["", ""]
    assert "order" not in rows[0].result.report["options"]
    assert rows[1].result.report["options"]["order"] == "reversed"


def test_a_name_that_is_taken_is_refused_where_it_is_declared():
    with pytest.raises(ValueError, match="'seed' cannot be the name"):
        OwnOption("seed", "", 0)
    with pytest.raises(ValueError, match="the default of one is None"):
        OwnOption("one", "", None)


def test_kinds_are_read_from_text():
    assert OwnOption("steps", "", 1).made("12") == 12
    assert OwnOption("fast", "", False).made("yes") is True
    for option, text in (
        (OwnOption("steps", "", 1), "1.5"),
        (OwnOption("step", "", 1.0), "nan"),
        (OwnOption("fast", "", False), "perhaps"),
    ):
        with pytest.raises(pgcp.InputError, match=f"^{option.name} is '{text}', it must be "):
            option.made(text)
