"""A method is one thing, registered: the command and the library know it then."""

from __future__ import annotations

import json

import numpy as np
import pytest
from meshes import cap, grid, lifted, spheroid

import pgcp
from pgcp.cli.main import main
from pgcp.methods.base import Method, whole
from pgcp.methods.common.boundary_energy import on_circle
from pgcp.methods.common.disk import DiskMap, map_disk
from pgcp.methods.registry import METHODS
from pgcp.registry import Registry
from pgcp.targets.registry import TARGETS


def _by_length(disk):
    """Tutte's boundary, by length on the circle, and the harmonic map inside."""
    points = disk.run.mesh.vertices[disk.loop]
    lengths = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    angles = 2 * np.pi * (np.cumsum(lengths) - lengths[0]) / lengths.sum()
    return DiskMap(disk.factor.extend(on_circle(angles)), {"iterations": [], "converged": True})


@pytest.fixture
def toy():
    method = Method(
        name="by-length",
        targets=("disk",),
        summary="harmonic, boundary by length",
        guarantees="boundary in order",
        reference="Tutte 1963",
        mapper=whole(lambda run, parts: map_disk(run, parts, _by_length)),
        moebius="none",
    )
    yield METHODS.register(method)
    METHODS.remove(method.name)


def test_a_registered_method_runs_through_the_command(toy, tmp_path):
    mesh, exact = cap(9)
    pgcp.write_mesh(tmp_path / "cap.ply", mesh)
    assert main([str(tmp_path / "cap.ply"), "--method", toy.name, "--patches", "3", "--no-png"]) == 0
    report = json.loads((tmp_path / "cap_pgcp" / "report.json").read_text())
    assert (report["target"], report["options"]["method"], report["converged"]) == ("disk", toy.name, True)
    uv = np.load(tmp_path / "cap_pgcp" / "cap.npz")["uv"] @ [1, 1j]
    rim = exact[-54:] / np.abs(exact[-54:])
    # an even boundary by length is that of the exact map, up to a turn
    assert np.ptp(np.angle(uv[-54:] / rim * np.conj(uv[-54] / rim[0]))) < 1e-12


def test_a_registered_method_runs_from_python_on_any_number_of_patches(toy):
    maps = [pgcp.parameterize(lifted(grid(14)), method=toy.name, patches=patches).coordinates for patches in (1, 5)]
    assert np.abs(maps[0] - maps[1]).max() < 1e-9


def test_its_targets_are_held(toy):
    with pytest.raises(pgcp.InputError, match="the method by-length is one for the target disk, not free"):
        pgcp.parameterize(grid(3), method=toy.name, target="free")


def test_without_it_the_method_is_unknown(capsys):
    assert main(["mesh.ply", "--method", "by-length"]) == 2
    assert "invalid choice: 'by-length'" in capsys.readouterr().err
    with pytest.raises(pgcp.InputError, match=r"unknown method 'by-length'; choose from .*ccem, cdcp"):
        pgcp.parameterize(grid(3), method="by-length")


@pytest.mark.parametrize("name", METHODS.names())
def test_every_method_says_what_it_is_and_maps_to_all_its_targets(name):
    method = METHODS.get(name)
    assert method.name == name
    assert all((method.summary, method.guarantees, method.reference))
    for target in method.targets or TARGETS.names():
        mesh = spheroid(2, 1.3)[0] if TARGETS.get(target).space.closed else lifted(grid(8))
        result = pgcp.parameterize(mesh, method=name, target=target, patches=2)
        assert (result.target, result.quality.folds) == (target, 0)


def test_a_new_file_of_a_room_is_found_by_its_name(tmp_path, monkeypatch):
    room = tmp_path / "things_for_a_test"
    room.mkdir()
    (room / "__init__.py").write_text("")
    (room / "base.py").write_text("")
    (room / "one.py").write_text("class THING:\n    name = 'one'\n")
    monkeypatch.syspath_prepend(tmp_path)
    things = Registry("thing", "things_for_a_test", "THING", ("base",))
    assert things.names() == ("one",)
    (room / "two.py").write_text("raise SystemError('imported too early')\n")
    assert things.names() == ("one", "two")
    assert things.get("one").name == "one"
    with pytest.raises(pgcp.InputError, match="unknown thing 'base'; choose from one, two"):
        things.get("base")
