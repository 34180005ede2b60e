"""What can go wrong beside the mathematics: killed, paused and lost processes, full disks, spoiled and foreign files, TLS.

Whatever happens, the run completes, or stops in one sentence and completes when it is resumed; nothing that was finished is
done again; and the map has the bits of a serial run that nothing disturbed.
"""

from __future__ import annotations

import gc
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from clusters import PATCHES, Cluster, Place, Processes, kill, wait_until, watch
from distributed import Client
from meshes import grid, lifted

import pgcp
from pgcp.errors import LostFileError, StoppedError
from pgcp.parallel import limited_to
from pgcp.patches.stored import discard
from pgcp.patches.types import BoundaryCurve
from pgcp.runtime import resume
from pgcp.runtime.executors import DaskExecutor, Tasks, submission
from pgcp.runtime.executors.connection import Connection
from pgcp.runtime.store import PatchStore

ONCE = Counter(
    {("flatten", k): 1 for k in range(PATCHES)}
    | {("weld", k): 1 for k in range(PATCHES, 2 * PATCHES - 1)}
    | {("solve", k): 1 for k in range(PATCHES)}
)
STAGES = ("flatten", "weld", "solve")
ONE_STAGE = [pytest.param(stage, marks=[] if stage == "weld" else [pytest.mark.slow]) for stage in STAGES]
GOOD = (0, "")


@pytest.fixture
def processes():
    started = Processes()
    yield started
    started.end()


@pytest.fixture(scope="module")
def lasting():
    """Processes that several tests use."""
    started = Processes()
    yield started
    started.end()


@pytest.fixture(scope="module")
def mesh_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "hills.obj"
    pgcp.write_mesh(path, lifted(grid(40, 30, jitter=0.2)))
    return path.read_bytes()


@pytest.fixture(scope="module")
def reference(mesh_file, tmp_path_factory):
    """The map of an undisturbed serial run."""
    folder = tmp_path_factory.mktemp("reference")
    (folder / "hills.obj").write_bytes(mesh_file)
    subprocess.run([sys.executable, "-m", "pgcp", "hills.obj", "--patches", str(PATCHES), "--quiet"], cwd=folder, check=True)
    return folder / "hills_pgcp" / "hills.npz"


@pytest.fixture
def place(tmp_path, mesh_file, processes, reference):  # the reference first: it compiles
    return Place(tmp_path, mesh_file, processes)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory, lasting):
    """A scheduler whose workers tests may kill."""
    started = Cluster(tmp_path_factory.mktemp("cluster"), lasting)
    started.start_scheduler()
    return started


@pytest.fixture
def own_cluster(tmp_path, processes):
    """A scheduler and a worker for one test."""
    started = Cluster(tmp_path, processes)
    started.start_scheduler()
    started.have_workers(1)
    return started


def assert_same(place, reference):
    """The map is that of the reference, to the last bit, and nothing is left in the store."""
    with np.load(place.folder / "hills_pgcp" / "hills.npz") as data, np.load(reference) as wanted:
        assert set(data) == set(wanted)
        for name in wanted:
            assert data[name].tobytes() == wanted[name].tobytes(), name
    assert place.runs() == []


def assert_same_result(result, reference):
    with np.load(reference) as wanted:
        assert result.coordinates.tobytes() == wanted["uv"].tobytes()
        assert result.mu.tobytes() == wanted["mu"].tobytes()


def assert_stopped(end, *words):
    """Exit status 4 in one sentence."""
    status, err = end
    assert status == 4, err
    assert err.startswith("pgcp-run: ")
    assert err.count("\n") == 1, err
    for word in (*words, "run again with --resume"):
        assert word in err


# 1. a worker is killed


def test_local_workers_killed_in_every_stage_are_replaced(place, reference):
    for stage in STAGES:
        place.hold(stage)
    process = place.start("--workers", "2", "--quiet")
    for stage in STAGES:
        kill(place.held(process, stage))
    assert place.end_of(process) == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE


@pytest.mark.parametrize("stage", ONE_STAGE)
def test_what_a_killed_worker_had_not_yet_said_is_not_done_again(stage, cluster, place, reference):
    cluster.have_workers(2)
    place.hold(stage, what="late")
    process = place.start("--scheduler", cluster.address, "--quiet")
    kill(place.held(process, stage))
    assert place.end_of(process) == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE


@pytest.mark.parametrize("stage", ONE_STAGE)
def test_another_worker_takes_over_from_a_killed_one(stage, cluster, place, reference):
    cluster.have_workers(2)
    place.hold(stage)
    process = place.start("--scheduler", cluster.address, "--quiet")
    kill(place.held(process, stage))
    assert place.end_of(process) == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE


def test_what_has_been_taken_is_not_done_again_for_a_lost_worker(cluster, monkeypatch):
    cluster.have_workers(1)
    monkeypatch.setattr(submission, "_LOOK_S", 0.05)  # each look in vain leaves references behind that only gc finds
    left = [2, 1, 0]
    gc.disable()
    try:
        with DaskExecutor("kept", scheduler=cluster.address) as executor, Client(cluster.address) as client:

            def wanted():
                names = client.run_on_scheduler(lambda dask_scheduler: list(dask_scheduler.tasks))
                return sum("pgcp-kept-" in str(name) for name in names)

            def none_kept(_):
                count = left.pop(0)
                wait_until(lambda: wanted() == count, f"{count} wanted tasks", seconds=10)

            executor.map(Tasks("sleep", time.sleep, [0.3, 0.3, 0.3]), none_kept)
    finally:
        gc.enable()
    assert left == []


@pytest.mark.slow
def test_a_task_that_kills_every_worker_stops_the_run(place, reference):
    place.hold("flatten", 2, 99, "die")
    assert_stopped(place.end_of(place.start("--workers", "2")), "stage flatten: workers died again and again")
    place.forget()
    assert place.finish("--resume", "--quiet") == GOOD
    assert_same(place, reference)


# welds go on beside the patches that are left


def test_what_can_be_welded_is_while_a_patch_is_still_flattened(place, reference):
    place.hold("flatten", PATCHES - 1, PATCHES)
    process = place.start("--workers", "2", "--quiet")
    place.held(process, "flatten", PATCHES - 1)
    place.wait_for(process, "done", "weld")
    assert len(place.records("curve")) == PATCHES - 1
    place.go()
    assert place.end_of(process) == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE


def test_what_an_idle_worker_prepares_changes_no_bit(place, reference):
    place.hold("weld", PATCHES - 2, PATCHES - 1)  # the last one
    place.hold("prepare", 2, 3)
    process = place.start("--workers", "2", "--quiet")
    place.held(process, "weld", PATCHES - 2)
    place.held(process, "prepare", 2)
    place.go()
    assert place.end_of(process) == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE


def test_a_worker_killed_while_it_prepares_is_not_missed(place, reference):
    place.hold("weld")
    place.hold("prepare")
    process = place.start("--workers", "2", "--quiet")
    place.held(process, "weld")
    kill(place.held(process, "prepare"))
    place.go()
    assert place.end_of(process) == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE


# 2. a worker is paused


def pause_in_first_pass(place, arguments, seconds):
    place.hold("flatten")
    process = place.start("--quiet", *arguments)
    worker = psutil.Process(place.held(process, "flatten"))
    worker.suspend()
    place.go()
    time.sleep(seconds)
    worker.resume()
    assert place.end_of(process) == GOOD


@pytest.mark.parametrize("seconds", [pytest.param(seconds, marks=pytest.mark.slow) for seconds in (5, 60)])
def test_a_paused_worker_goes_on(seconds, cluster, place, reference):
    cluster.have_workers(2)
    pause_in_first_pass(place, ("--scheduler", cluster.address), seconds)
    assert_same(place, reference)
    assert place.done() == ONCE


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [5, 60])
def test_a_paused_local_worker_goes_on(seconds, place, reference):
    pause_in_first_pass(place, ("--workers", "2"), seconds)
    assert_same(place, reference)
    assert place.done() == ONCE


# 3. and 4. the scheduler or all workers are lost


def two_patches_flattened(place, cluster, **options):
    """A run of which two patches are flattened and a third is begun."""
    place.hold("flatten", 2, 99)
    process = place.start("--scheduler", cluster.address, **options)
    place.wait_for(process, "at", "flatten", 2)
    place.held(process, "flatten", 2)
    return process


@pytest.mark.parametrize("seconds", [0, pytest.param(15, marks=pytest.mark.slow)])  # dask's client gives up after 10
def test_a_scheduler_that_is_started_again_goes_on(seconds, own_cluster, place, reference):
    process = two_patches_flattened(place, own_cluster)
    for lost in (own_cluster.scheduler, *own_cluster.workers):
        kill(lost.pid)
    place.go()
    time.sleep(seconds)
    own_cluster.start_scheduler()
    own_cluster.have_workers(1)
    assert place.end_of(process) == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE


@pytest.mark.parametrize(
    ("lost", "words"),
    [
        pytest.param("scheduler", "stage flatten: the scheduler does not answer", marks=pytest.mark.slow),
        ("workers", "stage flatten: there is no worker any more"),
    ],
)
def test_a_cluster_lost_for_good_stops_the_run(lost, words, own_cluster, place, reference):
    process = two_patches_flattened(place, own_cluster, patience=2)
    for gone in [own_cluster.scheduler] * (lost == "scheduler") + own_cluster.workers:
        kill(gone.pid)
    assert_stopped(place.end_of(process), words)
    assert place.records("curve") == sorted(index for _, index in place.done())
    place.go()
    assert place.finish("--resume", "--quiet") == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE


@pytest.mark.slow
@pytest.mark.parametrize("stage", ["weld", "solve"])
def test_a_run_stopped_on_one_cluster_is_resumed_on_another(stage, own_cluster, cluster, place, reference):
    place.hold(stage, 2, 99)
    process = place.start("--scheduler", own_cluster.address, patience=2)
    place.wait_for(process, "at", stage, 2)
    place.held(process, stage, 2)
    for gone in (own_cluster.scheduler, *own_cluster.workers):
        kill(gone.pid)
    assert_stopped(place.end_of(process), f"stage {stage}: the scheduler does not answer")
    place.go()
    cluster.have_workers(2)
    assert place.finish("--resume", "--quiet", "--scheduler", cluster.address) == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE


def test_a_cluster_lost_when_all_is_solved_is_not_missed(own_cluster, place, reference):
    place.hold("gather")
    process = place.start("--quiet", "--scheduler", own_cluster.address)
    place.held(process, "gather")
    for gone in (own_cluster.scheduler, *own_cluster.workers):
        kill(gone.pid)
    place.go()
    assert place.end_of(process) == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE


def test_a_result_that_is_lost_with_its_worker_is_not_waited_for_for_ever(own_cluster, monkeypatch):
    next_done = submission.Submission._next_done

    def unlucky(self, stage):
        done = next_done(self, stage)
        kill(own_cluster.workers[0].pid)
        return done

    monkeypatch.setattr(Connection, "patience_s", 2.0)
    monkeypatch.setattr(submission.Submission, "_next_done", unlucky)
    with (
        DaskExecutor("run", scheduler=own_cluster.address) as executor,
        pytest.raises(StoppedError, match="no worker any more"),
    ):
        executor.map(Tasks("negate", abs, [-1, -2]))


# 5. the main process is killed


@pytest.mark.parametrize(
    ("stage", "number", "workers"),
    [
        ("flatten", 3, 0),
        ("weld", 2, 0),
        ("solve", 3, 0),
        pytest.param("gather", 0, 0, marks=pytest.mark.slow),
        pytest.param("flatten", 3, 2, marks=pytest.mark.slow),
        pytest.param("solve", 3, 2, marks=pytest.mark.slow),
    ],
)
def test_a_killed_run_is_resumed(stage, number, workers, place, reference):
    place.hold(stage, number, 99)
    process = place.start("--workers", str(workers))
    if stage != "gather":
        place.wait_for(process, "at", stage, number)
    place.held(process, stage, number)
    process.kill()
    process.communicate()
    place.go()
    assert place.finish("--resume", "--quiet", "--workers", str(workers)) == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE


def test_a_run_killed_while_a_cluster_works_for_it_is_resumed_there(cluster, place, reference):
    cluster.have_workers(2)
    place.hold("flatten", 3, 99)
    process = place.start("--scheduler", cluster.address)
    place.wait_for(process, "at", "flatten", 3)
    place.held(process, "flatten", 3)
    kill(process.pid)
    place.go()  # what the workers have begun they may end while the next run begins
    assert place.finish("--resume", "--quiet", "--scheduler", cluster.address) == GOOD
    assert_same(place, reference)
    assert sum((place.done() - ONCE).values()) <= 2


def test_without_resume_all_is_done_anew(place, reference):
    place.hold("solve", 3, 99)
    process = place.start()
    place.wait_for(process, "at", "solve", 3)
    kill(process.pid)
    (run,) = place.runs()
    assert len(place.records("solved")) == 3
    place.forget()
    place.hold("flatten")
    process = place.start("--quiet")
    place.held(process, "flatten")
    assert place.runs() == [run]
    assert (place.records("patch"), place.records("curve"), place.records("solved")) == (list(range(PATCHES)), [], [])
    place.go()
    assert place.end_of(process) == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE


# 6. Ctrl-C and SIGTERM


@pytest.mark.parametrize(
    ("number", "word", "stage", "workers"),
    [
        (signal.SIGINT, "interrupted", "flatten", 2),
        (signal.SIGTERM, "terminated", "solve", 0),
        pytest.param(signal.SIGINT, "interrupted", "weld", 0, marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, "terminated", "solve", 2, marks=pytest.mark.slow),
    ],
)
def test_an_interrupted_run_is_resumed(number, word, stage, workers, place, reference):
    place.hold(stage, 3, 99)
    process = place.start("--resume", "--workers", str(workers))
    place.wait_for(process, "at", stage, 3)
    place.held(process, stage, 3)
    os.killpg(process.pid, number)
    message = f"pgcp-run: {word}; nothing was written; what is finished is kept for --resume\n"
    assert place.end_of(process) == (128 + number, message)
    place.go()
    assert place.finish("--resume", "--quiet") == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE


# 7. the disk is full


def assert_full(end, what):
    status, err = end
    assert status == 2, err
    assert what in err
    assert err.count("\n") == 1, err


@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_files_that_grow_too_large_stop_the_run(workers, place, reference):
    place.hold("flatten", 3, 99, "fill")
    assert_full(place.finish("--workers", str(workers)), "File too large")
    assert len(place.records("curve")) in (2, 3)  # threads of one process have one limit: two may be at work
    (place.folder / "hold").unlink()
    assert place.finish("--resume", "--quiet") == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE


@pytest.fixture
def small_disk(place):
    """Sets the size of the file system that holds the store."""

    def resize(size, *more):
        command = ["mount", "-t", "tmpfs", "-o", ",".join(["size=" + size, *more]), "pgcp-test", str(place.store)]
        if subprocess.run(command, capture_output=True, check=False).returncode:
            pytest.skip("this user may not mount a file system")

    yield resize
    subprocess.run(["umount", "--lazy", str(place.store)], capture_output=True, check=False)


def test_a_disk_that_gets_full_in_the_first_pass_stops_the_run(small_disk, place, reference):
    small_disk("4m")
    place.hold("flatten", 3, 99)
    process = place.start()
    place.wait_for(process, "at", "flatten", 3)
    filler = place.store / "filler"
    with pytest.raises(OSError, match="No space left"), filler.open("wb", 0) as stream:
        while True:
            stream.write(bytes(4096))
    place.go()
    assert_full(place.end_of(process), "No space left on device")
    assert len(place.records("curve")) == 3
    filler.unlink()
    assert place.finish("--resume", "--quiet") == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE


def test_a_disk_that_has_no_room_for_the_patches_stops_the_run(small_disk, place, reference):
    small_disk("100k")
    assert_full(place.finish(), "No space left on device")
    stored = place.records("patch")
    assert 0 < len(stored) < PATCHES
    ages = {index: place.record("patch", index).stat().st_mtime_ns for index in stored}
    small_disk("4m", "remount")
    place.hold("flatten")
    process = place.start("--resume", "--quiet")
    place.held(process, "flatten")
    assert ages == {index: place.record("patch", index).stat().st_mtime_ns for index in stored}
    place.go()
    assert place.end_of(process) == GOOD
    assert_same(place, reference)


# 8. files of the store are lost


def losing(kind, which, place, stage, *arguments):
    """How a run ends that loses records while a stage is held."""
    place.hold(stage)
    process = place.start("--quiet", *arguments)
    place.held(process, stage)
    # a patch that is lost while it is flattened is flattened twice
    wait_until(lambda: len(place.lines("done", "flatten")) == PATCHES, "all patches flattened")
    for index in which:
        place.record(kind, index).unlink()
    place.go()
    return place.end_of(process)


@pytest.mark.parametrize("which", [[2], list(range(PATCHES))])
def test_patches_lost_between_the_passes_are_stored_again(which, place, reference):
    assert losing("patch", which, place, "weld") == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE


def test_a_patch_lost_before_a_worker_opens_it_is_stored_again(cluster, place, reference):
    cluster.have_workers(2)
    assert losing("patch", (1, 4), place, "weld", "--scheduler", cluster.address) == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE


@pytest.mark.parametrize("which", [[3], list(range(PATCHES - 1))])
def test_maps_lost_after_the_second_pass_are_solved_again(which, place, reference):
    assert losing("map", which, place, "gather") == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE + Counter(("solve", index) for index in which)


@pytest.fixture(scope="module")
def nearly_done(tmp_path_factory, mesh_file, reference):
    """The store of a run that was killed when all patches were solved."""
    processes = Processes()
    try:
        place = Place(tmp_path_factory.mktemp("nearly"), mesh_file, processes)
        place.hold("gather")
        process = place.start()
        place.held(process, "gather")
    finally:
        processes.end()
    assert place.done() == ONCE
    return place.store


@pytest.fixture
def watched():
    """Tasks of this process log what they do."""
    undo = watch()
    yield
    undo()


def resumed(place, **options):
    return pgcp.parameterize(
        place.folder / "hills.obj", **{"patches": PATCHES, "store": place.store, "resume": True, **options}
    )


SPOIL = {
    "deleted": lambda path: path.unlink(),
    "empty": lambda path: path.write_bytes(b""),
    "cut off": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "changed": lambda path: path.write_bytes(bytes(255 - b if k % 501 == 500 else b for k, b in enumerate(path.read_bytes()))),
}


@pytest.mark.parametrize("how", SPOIL)
@pytest.mark.parametrize(
    ("kind", "index", "redone"),
    [
        ("curve", 1, "flatten"),
        ("union", 2 * PATCHES - 2, "weld"),
        ("map", 2, "solve"),
        ("solved", 3, "solve"),
        ("patch", 4, None),
        ("order", 5, None),
    ],
)
def test_a_spoiled_file_is_made_again_and_nothing_else(kind, index, redone, how, nearly_done, place, reference, watched):
    shutil.copytree(nearly_done, place.store, dirs_exist_ok=True)
    SPOIL[how](place.record(kind, index))
    if redone is None:  # it is not read unless something needs it
        place.record("solved", index).unlink()
    result = resumed(place)
    assert_same_result(result, reference)
    assert place.runs() == []
    assert place.done() == Counter({(redone or "solve", index): 1})


def test_what_a_discarded_split_leaves_is_of_use(nearly_done, place, reference, watched):
    """A run that goes on to another split discards the maps of the first; resumed, it solves them again."""
    shutil.copytree(nearly_done, place.store, dirs_exist_ok=True)
    (directory,) = place.runs()[0].glob(f"{PATCHES}-0")
    discard(SimpleNamespace(job=SimpleNamespace(directory=directory)))
    assert (place.records("patch"), place.records("map")) == ([], [])
    assert_same_result(resumed(place), reference)
    assert place.done() == Counter(("solve", index) for index in range(PATCHES))


@pytest.mark.parametrize("how", ["deleted", "cut off"])
def test_a_lost_operator_is_made_again(how, place, watched):
    """With relaxed seams the second pass needs the operators that the first has stored."""
    wanted = pgcp.parameterize(place.folder / "hills.obj", patches=PATCHES, seams="relax")
    place.forget()
    interrupted(place, "merge", seams="relax")
    for merged in place.store.rglob("merged-*"):  # else it may not be needed
        merged.unlink()
    (operator,) = place.store.rglob("operator-00002.npy")
    SPOIL[how](operator)
    if how == "cut off":  # it is seen when it is opened
        with pytest.raises(StoppedError, match=r"a file of the store was spoiled.*run again with --resume"):
            resumed(place, seams="relax")
    result = resumed(place, seams="relax")
    assert (result.coordinates.tobytes(), result.mu.tobytes()) == (wanted.coordinates.tobytes(), wanted.mu.tobytes())
    assert {what: count for what, count in place.done().items() if what[0] == "flatten" and count > 1} == {("flatten", 2): 2}


@pytest.mark.parametrize("stage", ["eliminate", "merge 1", "merge 2", "merge 3", "solve"])
@pytest.mark.parametrize(("seams", "target"), [("relax", "free"), ("exact", "free"), ("exact", "disk")])
def test_with_exact_seams_what_is_finished_is_not_done_again(seams, target, stage, place, watched):
    if (seams, stage) == ("relax", "eliminate"):
        stage = "flatten"
    wanted = pgcp.parameterize(place.folder / "hills.obj", patches=PATCHES, seams=seams, target=target)
    place.forget()
    resumed(place, seams=seams, target=target)
    undisturbed = place.done()
    assert undisturbed["merge", 2 * PATCHES - 2] == undisturbed["extend", 0] == 1
    place.forget()
    interrupted(place, stage, seams=seams, target=target)
    before = place.done()
    assert sum(before.values()) < sum(undisturbed.values())
    result = resumed(place, seams=seams, target=target)
    assert (result.coordinates.tobytes(), result.mu.tobytes()) == (wanted.coordinates.tobytes(), wanted.mu.tobytes())
    assert place.done() == undisturbed


@pytest.mark.parametrize("lost", ["operator-00010", "inside-00007", "pivot-00010", "merged-00006", "map-00002"])
def test_what_a_merge_lacks_is_made_again(lost, place, watched):
    """A run is killed in its second pass; before it goes on, a file of the store is lost that some merges need, or none."""
    wanted = pgcp.parameterize(place.folder / "hills.obj", patches=PATCHES, seams="exact")
    place.forget()
    interrupted(place, "solve", seams="exact")
    for path in place.store.rglob(f"{lost}.np*"):
        path.unlink()
    result = resumed(place, seams="exact")
    assert (result.coordinates.tobytes(), result.mu.tobytes()) == (wanted.coordinates.tobytes(), wanted.mu.tobytes())


@pytest.mark.parametrize("changed", ["inside-00007", "pivot-00010", "operator-00010"])
def test_a_changed_array_of_a_run_before_is_not_believed(changed, place, watched):
    wanted = pgcp.parameterize(place.folder / "hills.obj", patches=PATCHES, seams="exact")
    place.forget()
    interrupted(place, "solve", seams="exact")
    (path,) = place.store.rglob(f"{changed}.npy")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2] + bytes(len(data) - len(data) // 2))  # as a power failure may leave it
    result = resumed(place, seams="exact")
    assert (result.coordinates.tobytes(), result.mu.tobytes()) == (wanted.coordinates.tobytes(), wanted.mu.tobytes())
    assert place.done()["merge", int(changed[-5:])] == 2


def test_no_changed_byte_of_a_record_goes_unseen(tmp_path):
    """Every byte of a record, changed in several ways: it is refused, or what is read is what was written."""
    store = PatchStore(tmp_path)
    curve = BoundaryCurve(7, np.arange(9), np.exp(1j * np.arange(9)))
    store.write("curve", 7, curve)
    path = tmp_path / "curve-00007.npz"
    whole = path.read_bytes()
    refused = 0
    for place in range(len(whole)):
        for mask in (0x01, 0x08, 0x10, 0x80, 0xFF):
            path.write_bytes(whole[:place] + bytes([whole[place] ^ mask]) + whole[place + 1 :])
            try:
                again = store.read("curve", 7, BoundaryCurve)
            except LostFileError as problem:
                assert (problem.kind, problem.index) == ("curve", 7)
                refused += 1
            else:
                assert (again.patch, again.pieces) == (7, curve.pieces)
                assert again.vertex_ids.tobytes() == curve.vertex_ids.tobytes()
                assert again.z.tobytes() == curve.z.tobytes()
    assert refused > 3 * len(whole)


# 9. stale and foreign stores, several runs in one


def interrupted(place, at="solve", source=None, **options):
    """A run that stops half-way through a stage, by default in the second pass, kept to be resumed."""

    def progress(stage, done, total):
        if stage.startswith(at) and done >= total // 2:
            raise KeyboardInterrupt

    options = {"patches": PATCHES, "store": place.store, "resume": True, **options}
    # one task after the other: of several threads all may be done before the first result has been seen
    with limited_to(1), pytest.raises(KeyboardInterrupt):
        pgcp.parameterize(place.folder / "hills.obj" if source is None else source, progress=progress, **options)


def everything(folder):
    return {path: (path.stat().st_mtime_ns, path.is_file() and path.read_bytes()) for path in folder.rglob("*")}


def test_stores_of_other_runs_are_not_used_nor_touched(place, reference, monkeypatch, watched):
    interrupted(place, source=lifted(grid(40, 30, jitter=0.1)))
    interrupted(place, patches=5)
    interrupted(place, seed=1)
    interrupted(place, target="disk")
    with monkeypatch.context() as patched:
        patched.setattr(resume, "_STORE_FORMAT", 0)
        interrupted(place)
    with monkeypatch.context() as patched:
        patched.setattr(resume, "package_versions", lambda: {"pgcp": "0.0.1"})
        interrupted(place)
    foreign = place.store / "pgcp-foreign"
    foreign.mkdir()
    (foreign / "notes").write_text("of somebody else")
    before = everything(place.store)
    assert len(place.runs()) == 7
    place.forget()
    assert_same_result(resumed(place), reference)
    assert place.done() == ONCE
    assert everything(place.store) == before
    place.forget()
    interrupted(place)
    assert len(place.runs()) == 8
    assert_same_result(resumed(place), reference)
    assert place.done() == ONCE
    assert everything(place.store) == before


def test_where_and_how_a_run_runs_does_not_make_it_another(place, reference, watched):
    interrupted(place)
    assert_same_result(resumed(place, workers=1, factor_cache_bytes=0), reference)
    assert place.runs() == []


def test_two_runs_at_once_do_not_disturb_each_other(place, reference):
    place.hold("weld", 0, 2 * PATCHES)  # all: the first run may begin several before the second is there
    both = [place.start("--quiet", "--resume", "--output-dir", name) for name in ("hills_pgcp", "other")]
    wait_until(lambda: len({words[-1] for words in place.lines("held", "weld")}) == 2, "welds of both runs")
    assert len(place.runs()) == 2
    place.go()
    assert [place.end_of(process) for process in both] == [GOOD, GOOD]
    assert_same(place, reference)
    assert place.done() == ONCE + ONCE
    assert (place.folder / "other" / "hills.npz").read_bytes() == place.result()


def test_a_second_run_into_the_same_folder_says_so_before_it_works(place, reference):
    place.hold("weld")
    first = place.start("--quiet")
    place.held(first, "weld")
    assert (place.folder / "hills_pgcp").is_dir()
    status, err = place.finish("--output-dir", "hills_pgcp/../hills_pgcp")
    assert (status, err.count("\n")) == (2, 1)
    assert "hills_pgcp: another run writes its results here; wait for it, or choose another folder" in err
    assert place.done() - ONCE == Counter()
    assert len(place.runs()) == 1
    place.go()
    assert place.end_of(first) == GOOD
    assert_same(place, reference)
    assert place.finish("--quiet") == GOOD


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_the_lock_of_a_folder_ends_with_its_run(number, place, reference):
    place.hold("weld")
    process = place.start("--quiet")
    place.held(process, "weld")
    process.send_signal(number)
    place.go()
    place.end_of(process)
    assert (place.folder / "hills_pgcp").exists() == (number == signal.SIGKILL)
    assert place.finish("--quiet", "--resume") == GOOD
    assert_same(place, reference)


# 10. TLS


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    """Two authorities with a certificate each."""
    if shutil.which("openssl") is None:
        pytest.skip("there is no openssl to make certificates with")
    folder = tmp_path_factory.mktemp("tls")

    def openssl(*arguments):
        subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)

    for name in ("ours", "theirs"):
        key = ("-newkey", "rsa:2048", "-nodes", "-keyout")
        openssl("req", "-x509", *key, f"{name}-ca.key", "-out", f"{name}-ca.pem", "-subj", f"/CN={name}", "-days", "2")
        openssl("req", *key, f"{name}.key", "-out", f"{name}.csr", "-subj", "/CN=127.0.0.1")
        authority = ("-CA", f"{name}-ca.pem", "-CAkey", f"{name}-ca.key", "-set_serial", "1")
        openssl("x509", "-req", "-in", f"{name}.csr", *authority, "-out", f"{name}.pem", "-days", "2")

    return {name: [folder / f"{name}{end}" for end in ("-ca.pem", ".pem", ".key")] for name in ("ours", "theirs")}


TLS = ("--tls-ca", "--tls-cert", "--tls-key")


def options_of(files):
    return [str(word) for pair in zip(TLS, files, strict=True) for word in pair]


@pytest.fixture(scope="module")
def encrypted(tmp_path_factory, lasting, certificates):
    from distributed.security import Security

    ca, certificate, key = map(str, certificates["ours"])
    tls = ("--tls-ca-file", ca, "--tls-cert", certificate, "--tls-key", key)
    started = Cluster(tmp_path_factory.mktemp("encrypted"), lasting, "tls", tls)
    started.start_scheduler()
    security = Security(tls_ca_file=ca, tls_client_cert=certificate, tls_client_key=key, require_encryption=True)
    started.have_workers(1, security)
    return started


def test_a_cluster_is_reached_by_tls(encrypted, certificates, place, reference):
    assert place.finish("--quiet", "--scheduler", encrypted.address, *options_of(certificates["ours"])) == GOOD
    assert_same(place, reference)
    assert place.done() == ONCE


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (lambda files: [], "speaks TLS; give --tls-ca, --tls-cert and --tls-key"),
        (lambda files: options_of(files["ours"])[:2], "TLS needs all three of"),
        (lambda files: options_of(files["theirs"]), "no dask scheduler answers at tls://127.0.0.1:"),
    ],
    ids=["none", "one", "of another authority"],
)
def test_a_cluster_is_not_reached_without_the_right_certificates(given, words, encrypted, certificates, place):
    status, err = place.finish("--scheduler", encrypted.address, *given(certificates))
    assert (status, err.count("\n")) == (2, 1), err
    assert words in err


# 11. who can reach a local cluster


def test_a_local_cluster_listens_to_this_machine_only(place, reference):
    place.hold("flatten")
    process = place.start("--workers", "2", "--quiet")
    place.held(process, "flatten")
    tree = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
    listening = [c.laddr.ip for p in tree for c in p.net_connections("inet") if c.status == psutil.CONN_LISTEN]
    assert len(listening) >= 3  # the scheduler and two workers
    assert set(listening) == {"127.0.0.1"}
    place.go()
    assert place.end_of(process) == GOOD
    assert_same(place, reference)
