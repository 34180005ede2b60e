"""Workers, scheduler and command of a real cluster are killed at random moments, and the other faults at some.

The map has the bits of an undisturbed run; or the run stops with status 4, or dies, and has them after ``--resume``.
``PGCP_MOMENTS`` says how many moments each, 20 unless it does; the table of what happened is printed.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter

import numpy as np
import psutil
import pytest
from clusters import PATCHES, Cluster, Place, Processes, kill
from meshes import grid, lifted

import pgcp

pytestmark = pytest.mark.slow

MOMENTS = int(os.environ.get("PGCP_MOMENTS", "20"))
LEAST_S = 0.5  # before it the command has not begun


@pytest.fixture(scope="module")
def mesh_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "hills.obj"
    pgcp.write_mesh(path, lifted(grid(60, 50, jitter=0.2)))
    return path.read_bytes()


@pytest.fixture(scope="module")
def reference(mesh_file, tmp_path_factory):
    """The map of an undisturbed run without workers."""
    folder = tmp_path_factory.mktemp("reference")
    (folder / "hills.obj").write_bytes(mesh_file)
    subprocess.run([sys.executable, "-m", "pgcp", "hills.obj", "--patches", str(PATCHES), "--quiet"], cwd=folder, check=True)
    with np.load(folder / "hills_pgcp" / "hills.npz") as data:
        return {name: data[name].tobytes() for name in data}


@pytest.fixture
def processes():
    started = Processes()
    yield started
    started.end()


@pytest.fixture
def cluster(tmp_path, processes):
    started = Cluster(tmp_path, processes)
    started.start_scheduler()
    started.have_workers(2)
    return started


def result_of(place):
    with np.load(place.folder / "hills_pgcp" / "hills.npz") as data:
        return {name: data[name].tobytes() for name in data}


def length_of_a_run(folder, mesh_file, cluster, processes, reference):
    """Seconds of an undisturbed run."""
    folder.mkdir()
    place, start = Place(folder, mesh_file, processes), time.monotonic()
    assert place.finish("--scheduler", cluster.address, "--quiet") == (0, "")
    assert result_of(place) == reference
    return time.monotonic() - start


def disturb_worker(_place, _process, cluster):
    kill(random.choice(cluster.workers).pid)


def disturb_scheduler(_place, _process, cluster):
    kill(cluster.scheduler.pid)


def disturb_client(_place, process, _cluster):
    kill(process.pid)


def disturb_pause(_place, _process, cluster):
    worker = psutil.Process(random.choice(cluster.workers).pid)
    worker.suspend()
    time.sleep(2)
    worker.resume()


def disturb_file(place, _process, _cluster):
    """A file of the store is lost, if there is one."""
    files = [path for path in place.store.rglob("*.np*") if not path.name.startswith(".")]
    if files:
        random.choice(files).unlink(missing_ok=True)


def disturb_disk(place, process, cluster):
    """No process may write a file any more, as on a full disk."""
    for one in (process.pid, *(worker.pid for worker in cluster.workers)):
        psutil.Process(one).rlimit(psutil.RLIMIT_FSIZE, (0, psutil.RLIM_INFINITY))
    time.sleep(1)
    for one in (process.pid, *(worker.pid for worker in cluster.workers)):
        if psutil.pid_exists(one) and psutil.Process(one).status() != psutil.STATUS_ZOMBIE:
            psutil.Process(one).rlimit(psutil.RLIMIT_FSIZE, (psutil.RLIM_INFINITY, psutil.RLIM_INFINITY))


FAULTS = {
    "worker": disturb_worker,
    "scheduler": disturb_scheduler,
    "client": disturb_client,
    "pause": disturb_pause,
    "file": disturb_file,
    "disk": disturb_disk,
}
# how a disturbed run may end: 4, 2 where no file can be written or no scheduler answers at first; killed
ALLOWED = {
    "worker": {0},
    "pause": {0},
    "scheduler": {0, 2, 4},
    "client": {0, -signal.SIGKILL},
    "file": {0, 4},
    "disk": {0, 2, 4},
}


@pytest.mark.parametrize("fault", FAULTS)
def test_at_any_moment(fault, mesh_file, cluster, processes, reference, tmp_path):
    usual = length_of_a_run(tmp_path / "usual", mesh_file, cluster, processes, reference)
    random.seed(fault)
    ends: Counter[int] = Counter()
    count = MOMENTS if fault in ("worker", "scheduler", "client") else max(1, MOMENTS // 4)
    for number in range(count):
        if cluster.scheduler.poll() is not None:
            cluster.start_scheduler()
        cluster.have_workers(2)
        (tmp_path / str(number)).mkdir()
        place = Place(tmp_path / str(number), mesh_file, processes)
        process = place.start("--scheduler", cluster.address, "--quiet", "--resume", patience=8)
        moment = random.uniform(LEAST_S, max(usual, 2 * LEAST_S))
        time.sleep(moment)
        if process.poll() is None:
            FAULTS[fault](place, process, cluster)
        status, err = place.end_of(process)
        ends[status] += 1
        print(f"{fault} {number}: after {moment:.2f} s, status {status} {err.strip()}", flush=True)
        assert status in ALLOWED[fault], (number, moment, err)
        assert status != 2 or fault != "scheduler" or "no dask scheduler answers" in err, (number, moment, err)
        assert err.count("\n") <= (status != 0), (number, moment, err)
        if status:
            assert place.finish("--resume", "--quiet") == (0, ""), (number, moment)
        assert result_of(place) == reference, (number, moment)
        assert place.runs() == [], (number, moment)
    print(f"{fault}: {count} moments in {usual:.1f} s; ends {dict(ends)}")


def test_two_runs_on_one_store(mesh_file, cluster, processes, reference, tmp_path):
    for number in range(max(1, MOMENTS // 4)):
        (tmp_path / str(number)).mkdir()
        place = Place(tmp_path / str(number), mesh_file, processes)
        words = ("--scheduler", cluster.address, "--quiet", "--resume", "--output-dir")
        first = place.start(*words, "hills_pgcp")
        time.sleep(random.Random(number).uniform(0, 2))
        second = place.start(*words, "other")
        assert [place.end_of(process) for process in (first, second)] == [(0, ""), (0, "")]
        assert result_of(place) == reference
        assert (place.folder / "other" / "hills.npz").read_bytes() == place.result()
        assert place.runs() == []
