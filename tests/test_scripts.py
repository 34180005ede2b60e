"""Scripts that measure: what they compute from what they measure, and that they run."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from meshes import grid, lifted

import pgcp

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"
sys.path.insert(0, str(SCRIPTS))

import benchmark  # noqa: E402
import scaling_model  # noqa: E402
import speedup  # noqa: E402
from scaling_model import Network, Task, depth_of, passes, simulate  # noqa: E402


def run(name, *arguments, cwd):
    command = [sys.executable, SCRIPTS / f"{name}.py", *map(str, arguments)]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def table_of(path):
    head, *rows = [line.split("\t") for line in path.read_text().splitlines()]
    return [dict(zip(head, row, strict=True)) for row in rows]


@pytest.fixture(scope="module")
def hills_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "hills.ply"
    pgcp.write_mesh(path, lifted(grid(40, jitter=0.2)))
    return path


# benchmark


def test_memory_and_seconds_are_those_of_all_processes():
    child = "b = bytearray(200_000_000); import time; t = time.process_time()\nwhile time.process_time() < t + 0.5: pass"
    code = f"import subprocess, sys; b = bytearray(100_000_000); subprocess.run([sys.executable, '-c', {child!r}]); sys.exit(7)"
    measured = benchmark.run_measured([sys.executable, "-c", code])
    assert measured.status == 7
    assert 300e6 < measured.peak_bytes < 400e6
    assert 100e6 < measured.root_peak_bytes < 150e6
    assert 0.5 < measured.cpu_s < 3.0
    assert measured.wall_s > 0.5


def test_the_map_of_scipy_is_that_of_the_package(hills_file):
    mesh = pgcp.read_mesh(hills_file)
    ours = pgcp.parameterize(mesh, method="dncp", moebius="none").coordinates @ [1, 1j]
    theirs = benchmark.dncp(mesh, benchmark.Stopwatch()) @ [1, 1j]
    ours, theirs = ours - ours.mean(), theirs - theirs.mean()
    turn = np.vdot(theirs, ours) / np.vdot(theirs, theirs)
    assert np.abs(turn * theirs - ours).max() < 1e-3 * np.abs(ours).max()  # other vertices are pinned


def test_contestants_run_in_turns_and_every_run_is_told(hills_file, tmp_path):
    copy = f"{sys.executable} -c 'import shutil, sys; shutil.copy(*sys.argv[1:])' {{mesh}} {{out}}"
    against = ["--against", "pardiso,scipy", "--external", copy, "--repeat", 2, "--workers", 0]
    said = run("benchmark", *against, "--output-dir", "out", hills_file, cwd=tmp_path)
    rows = table_of(tmp_path / "out" / "benchmark.tsv")
    names = list(dict.fromkeys(row["contestant"] for row in rows))
    assert [row["contestant"] for row in rows] == 2 * names
    assert names[0] == "pgcp"
    assert names[-1] == f"{Path(sys.executable).name} (1)"
    assert {row["status"] for row in rows} == {"0"}
    assert all(float(row["wall_s"]) > 0 for row in rows)
    assert all(float(row["peak_mb"]) > 1 for row in rows[: len(names)])  # memory is looked at in the first run
    assert {row["peak_mb"] for row in rows[len(names) :]} == {""}
    assert all(float(row["flatten_s"]) > 0 for row in rows if row["contestant"] == "pgcp")
    assert said.splitlines()[0].split()[:3] == ["mesh", "vertices", "contestant"]
    assert (tmp_path / "out" / "benchmark.png").read_bytes().startswith(b"\x89PNG")


# speedup


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


def test_speedup_makes_table_and_plot(hills_file, tmp_path):
    run("speedup", hills_file, "--patches", "2..3", "--workers", "1,2", "--output-dir", "out", cwd=tmp_path)
    rows = table_of(tmp_path / "out" / "speedup.tsv")
    assert [(row["workers"], row["n"]) for row in rows] == [("1", "2"), ("1", "3"), ("2", "2"), ("2", "3")]
    assert all(float(row["flatten"]) > 0 for row in rows)
    assert (tmp_path / "out" / "speedup.png").read_bytes().startswith(b"\x89PNG")


# scaling model


def seconds(jobs, *arguments):
    return max(simulate(jobs, *arguments).values())


def test_tasks_are_replayed_on_workers():
    jobs = [Task(k, s) for k, s in enumerate([3.0, 1.0, 1.0, 2.0])]
    assert seconds(jobs, 1) == 7.0
    assert seconds(jobs, 2) == 4.0
    assert seconds(jobs, 9) == 3.0
    chain = [Task(0, 2.0), Task(1, 1.0), Task(2, 4.0, (0, 1)), Task(3, 1.0, (2,))]
    assert simulate(chain, 5) == {0: 2.0, 1: 1.0, 2: 6.0, 3: 7.0}
    assert seconds(chain, 1) == 8.0
    with pytest.raises(ValueError, match="2 tasks wait for each other"):
        simulate([Task(0, 1.0), Task(1, 1.0, (2,)), Task(2, 1.0, (1,))], 2)


def test_welds_are_replayed_beside_the_patches_that_are_left():
    joins = [(2, 3, 4), (1, 4, 5), (0, 5, 6)]
    assert depth_of(range(4), joins) == {0: 3, 1: 2, 2: 1, 3: 1}
    flatten = [Task(k, 4.0, rank=depth) for k, depth in depth_of(range(4), joins).items()]
    welds = [Task(result, 1.0, (left, right), rank=-1.0) for left, right, result in joins]
    prepare, solve = ([Task(k, s) for k in range(4)] for s in (1.5, 0.5))
    assert passes(flatten, welds, prepare, solve, 1, Network()) == [17.0, 2.0, 8.0]
    assert passes(flatten, welds, prepare, solve, 2, Network()) == [8.0, 3.0, 2.5]  # two are prepared during the welds
    none = [Task(k, 0.0) for k in range(4)]
    assert passes(flatten, welds, none, [Task(k, 2.0) for k in range(4)], 2, Network()) == [8.0, 3.0, 4.0]
    assert passes(flatten, [], prepare, solve, 2, Network(overhead_s=0.5)) == [9.0, 0.0, 5.0]


def test_spare_work_begins_when_the_driver_knows_of_an_idle_worker():
    jobs = [Task(0, 1.0), Task(1, 1.0, (0,)), Task(2, 5.0, rank=9.0, spare_until=1)]
    assert simulate(jobs, 1) == {0: 1.0, 1: 2.0}
    assert simulate(jobs, 2) == {0: 1.0, 1: 2.0, 2: 5.0}
    late = Network(latency_s=1.0)
    assert simulate(jobs, 1, late) == {0: 3.0, 1: 6.0}


def test_transfers_of_one_link_wait_for_each_other():
    network = Network(overhead_s=0.5, latency_s=0.25, bytes_per_s=100.0)
    assert seconds([Task(0, 1.0)], 1, network) == 0.5 + 0.25 + 1.0 + 0.25
    stored = [Task(k, 1.0, store_bytes=200.0) for k in range(3)]
    assert seconds(stored, 3, network) == 0.75 + 3 * 2.0 + 1.0 + 0.25
    sent = [Task(k, 1.0, out_bytes=100.0) for k in range(2)]
    assert seconds(sent, 2, network) == 0.75 + 1.0 + 2 * 1.0 + 0.25


def test_factors_are_found_again_and_never_negative():
    rng = np.random.default_rng(0)
    sizes = {"n": rng.uniform(1e3, 1e5, 60), "b": rng.uniform(1e2, 1e3, 60)}
    factors = np.array([0.02, 3e-6, 2e-8, 1e-10])
    seconds = scaling_model.evaluate("flatten", factors, sizes)
    assert np.allclose(scaling_model.fit_terms("flatten", sizes, seconds), factors, rtol=1e-6)
    falling = scaling_model.fit_terms("driver", {"V": np.array([1.0, 2.0]), "K": np.ones(2)}, [2.0, 1.0])
    assert (falling >= 0.0).all()


@pytest.mark.parametrize("count", [1, 2, 7, 300])
def test_a_tree_of_welds_joins_all_patches(count):
    tree = scaling_model.weld_tree(count)
    assert len(tree.perimeters) == count
    assert len(tree.steps) == count - 1
    there = set(range(count))
    for left, right, result, seam in tree.steps:
        there -= {left, right}
        there |= {result}
        assert seam > 0.0
    assert len(there) == 1


@pytest.mark.slow
def test_the_model_is_measured_validated_and_used(hills_file, tmp_path):
    options = ["--patches", "2,4,6", "--repeat", 1, "--validate", 2, "--vertices", "1e5,1e6", "--workers", "1,2,64"]
    said = run("scaling_model", hills_file, *options, "--output-dir", "out", cwd=tmp_path)
    assert said.count("whole run") == 2
    rows = table_of(tmp_path / "out" / "scaling.tsv")
    assert [(row["vertices"], row["workers"]) for row in rows] == [
        (v, w) for v in ("100000", "1000000") for w in ("1", "2", "64")
    ]
    for one, two, many in (rows[:3], rows[3:]):
        assert float(one["speedup"]) == 1.0
        assert float(two["flatten_s"]) <= float(one["flatten_s"])
        assert float(many["speedup"]) < 64.0
    assert (tmp_path / "out" / "scaling.png").read_bytes().startswith(b"\x89PNG")
