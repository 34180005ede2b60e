"""scaling_model.py: tasks recorded, fitted, and replayed on any number of workers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import recording
import scaling_model
from replay import Network, Task, depth_of, passes, simulate
from trees import weld_tree

import pgcp
from pgcp.runtime.executors import EXECUTORS, Tasks


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
    prepare, solve = ([Task(k, s) for k in range(4)] for s in (1.4, 0.5))
    assert passes(flatten, welds, prepare, solve, 1, Network()) == pytest.approx([17.0, 2.0, 7.6])
    # beside the welds two patches are prepared, and a third is begun
    assert passes(flatten, welds, prepare, solve, 2, Network()) == pytest.approx([8.0, 3.0, 2.9])
    none = [Task(k, 0.0) for k in range(4)]
    assert passes(flatten, welds, none, [Task(k, 2.0) for k in range(4)], 2, Network()) == [8.0, 3.0, 4.0]
    assert passes(flatten, [], prepare, solve, 2, Network(overhead_s=0.5)) == pytest.approx([9.0, 0.0, 4.8])


def test_speculative_work_begins_when_the_driver_knows_of_an_idle_worker():
    jobs = [Task(0, 1.0), Task(1, 1.0, (0,)), Task(2, 5.0, ahead_of=3), Task(3, 1.0, (1,))]
    assert simulate(jobs, 1) == {0: 1.0, 1: 2.0, 3: 8.0}  # 2 is done with 3
    assert simulate(jobs, 2) == {0: 1.0, 1: 2.0, 2: 5.0, 3: 6.0}  # 3 waits for 2
    late = Network(latency_s=1.0)
    assert simulate(jobs, 1, late) == {0: 3.0, 1: 6.0, 3: 14.0}


def test_of_speculative_work_the_last_begins_first():
    jobs = [Task(0, 3.0), *(Task(k, 2.0, ahead_of=k + 2) for k in (1, 2)), *(Task(k, 1.0, (0,)) for k in (3, 4))]
    assert simulate(jobs, 2) == {0: 3.0, 2: 2.0, 1: 4.0, 4: 4.0, 3: 5.0}


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
    seconds = scaling_model.features("flatten", sizes) @ factors
    assert np.allclose(scaling_model.fit_terms("flatten", sizes, seconds), factors, rtol=1e-6)
    falling = scaling_model.fit_terms("driver", {"V": np.array([1.0, 2.0]), "K": np.ones(2)}, [2.0, 1.0])
    assert (falling >= 0.0).all()


@pytest.mark.parametrize("count", [1, 2, 7, 300])
def test_a_tree_of_welds_joins_all_patches(count):
    tree = weld_tree(count)
    assert len(tree.perimeters) == count
    assert len(tree.steps) == count - 1
    there = set(range(count))
    for left, right, result, seam in tree.steps:
        there -= {left, right}
        there |= {result}
        assert seam > 0.0
    assert len(there) == 1


# what is replayed and fitted


@pytest.fixture(scope="module")
def hills_run(hills_file):
    return scaling_model.trace(pgcp.read_mesh(hills_file), 4, "free")


def test_every_task_is_recorded_with_what_it_waits_for(hills_run):
    stages = [record.stage for record in hills_run.records]
    assert {stage: stages.count(stage) for stage in stages} == {"flatten": 4, "weld": 3, "prepare": 4, "solve": 4}
    for k in range(4):
        assert stages.index("weld") < stages.index("solve")
        prepared, solved = (
            next(n for n, r in enumerate(hills_run.records) if (r.stage, r.name) == (s, k)) for s in ("prepare", "solve")
        )
        assert solved == prepared + 1
    done = set(range(4))
    for record in hills_run.of("weld"):
        assert set(record.after) <= done
        done = done - set(record.after) | {record.name}
    assert len(done) == 1
    assert hills_run.of("weld")[-1].sizes["c"] == 4
    assert sum(record.sizes["n"] for record in hills_run.of("flatten")) > 41**2
    assert all(record.seconds > 0 for record in hills_run.records)


def test_a_recorded_map_has_the_bits_of_any_other(hills_file):
    mesh, options = pgcp.read_mesh(hills_file), pgcp.Options(patches=4)
    for again in range(2):  # the recorder is there for one run only
        result, _ = recording.recorded(mesh, options, lambda *_: {}, looks_at_memory=bool(again))
        assert result.coordinates.tobytes() == pgcp.compute(mesh, options).coordinates.tobytes()
    assert recording.NAME not in EXECUTORS.names()


def test_the_memory_of_a_task_is_seen():
    recorder = recording.Recorder(lambda *_: {}, looks_at_memory=True)
    recorder.map(Tasks("fill", lambda size: len(bytes(size).replace(b"\0", b"1")), [1_000, 60_000_000]))
    small, large = (record.memory_bytes for record in recorder.records)
    assert 50e6 < large < 200e6
    assert small < 10e6


def test_one_worker_needs_the_sum_of_all_seconds(hills_run):
    parallel, whole = scaling_model.replay(hills_run, 1, Network())
    assert parallel == pytest.approx(sum(record.seconds for record in hills_run.records))
    assert whole == pytest.approx(parallel + sum(hills_run.driver.values()))
    many, _ = scaling_model.replay(hills_run, 64, Network())
    chain = max(record.seconds for record in hills_run.of("flatten"))
    assert chain < many < parallel


PER_VERTEX = {"flatten": 3e-5, "prepare": 1e-5, "solve": 2e-5}
WELD_S = 0.01


def invented(run):
    """A run with known costs: seconds by the vertices of a patch, for each weld, and by the vertices of the mesh."""
    records = [
        replace(
            r, seconds=WELD_S if r.stage == "weld" else PER_VERTEX[r.stage] * r.sizes["n"], memory_bytes=100.0 * r.sizes["n"]
        )
        for r in run.records
    ]
    return replace(run, records=records, driver={"split": 1e-6 * run.vertices})


def test_the_model_predicts_known_costs(hills_file, monkeypatch):
    monkeypatch.setattr(scaling_model, "zipper_seconds", lambda: 0.0)
    monkeypatch.setattr(scaling_model, "cycle_seconds", lambda: 0.0)
    mesh = pgcp.read_mesh(hills_file)
    runs = [invented(scaling_model.trace(mesh, patches, "free")) for patches in (2, 4, 6)]
    model = scaling_model.fit_model(runs, 1e8, 100.0)
    one = scaling_model.predict(model, 1e6, 48, 1, Network())
    assert one.parts["driver"] == pytest.approx(1.0)
    assert one.total_s - 1.0 == pytest.approx(1e6 * sum(PER_VERTEX.values()) + 47 * WELD_S, rel=1e-3)
    assert one.last_weld_s == pytest.approx(WELD_S, rel=1e-3)
    assert one.worker_bytes >= 1e8 + 0.99 * 100.0 * 1e6 / 48
    assert one.driver_bytes >= 1e8 + 100.0 * 1e6
    assert one.dominant == f"{one.parts['flatten'] / one.total_s:.0%} flatten"
    many = scaling_model.predict(model, 1e6, 48, 48, Network())
    largest = model.spread.max() * 1e6 / 48
    assert many.parts["flatten"] == pytest.approx(PER_VERTEX["flatten"] * largest, rel=1e-3)
    assert many.parts["solve"] <= (PER_VERTEX["prepare"] + PER_VERTEX["solve"]) * largest
    rows = scaling_model.table([one, many])
    assert rows[2][8] == f"{one.total_s / many.total_s:.2f}"  # the speedup
    assert rows[2][9] == f"{one.total_s / many.total_s / 48:.3f}"
    share = (1.0 + WELD_S) / one.total_s
    assert (
        f"which bounds the speedup by {1 / share:.1f}; best is {one.total_s / many.total_s:.1f}, on 48"
        in scaling_model.bounds([one, many])[0]
    )


@pytest.mark.slow
def test_the_model_is_measured_validated_and_used(hills_file, table_of, tmp_path, capsys):
    options = ["--patches", "2,4,6", "--repeat", "1", "--validate", "2", "--vertices", "1e5,1e6", "--workers", "1,2,64"]
    scaling_model.main([str(hills_file), *options, "--output-dir", str(tmp_path / "out")])
    said = capsys.readouterr().out
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
