"""Workers of a running cluster are asked first whether they have this package and see the store; live clients are taken."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time

import numpy as np
import pytest
from clusters import Cluster, Processes, wait_until
from distributed import Client, LocalCluster
from meshes import grid, lifted

import pgcp
from pgcp.errors import InputError
from pgcp.runtime.executors.probe import check_workers

HILLS = lifted(grid(20, jitter=0.2))


@pytest.fixture
def processes():
    started = Processes()
    yield started
    started.end()


@pytest.fixture
def cluster(tmp_path, processes):
    """A scheduler with one worker that is as it should be."""
    started = Cluster(tmp_path, processes)
    started.start_scheduler()
    started.have_workers(1)
    return started


@pytest.fixture
def store(tmp_path):
    folder = tmp_path / "store"
    folder.mkdir()
    return folder


def add_worker(cluster, processes, folder, before=(), **environment):
    """Start another worker, by a command that comes before it or with an environment of its own; its address."""
    with Client(cluster.address, timeout="60s") as client:
        known = set(client.scheduler_info(n_workers=-1)["workers"])
        where = ("--local-directory", str(folder), "--host", "127.0.0.1", "--nthreads", "1", "--no-nanny", "--no-dashboard")
        processes.start(
            [*before, str(shutil.which("dask", path=os.path.dirname(sys.executable))), "worker", cluster.address, *where],
            env={**os.environ, "PYTHONWARNINGS": "", **environment},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        return wait_until(lambda: set(client.scheduler_info(n_workers=-1)["workers"]) - known, "a worker").pop()


def refused(cluster, store):
    """What a run says, and how long that takes."""
    start = time.monotonic()
    with pytest.raises(InputError) as refusal:
        pgcp.parameterize("nowhere.ply", scheduler=cluster.address, store=store)
    return str(refusal.value), time.monotonic() - start


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("__version__ = '0.0.1'", "has pgcp 0.0.1, this run has "),
        ("raise ImportError('not here')", "has no package pgcp, this run has "),
    ],
)
def test_a_worker_with_another_version_is_named(text, words, cluster, processes, store, tmp_path):
    other = tmp_path / "other" / "pgcp"
    other.mkdir(parents=True)
    (other / "__init__.py").write_text(text)
    address = add_worker(cluster, processes, tmp_path, PYTHONPATH=str(other.parent))
    said, seconds = refused(cluster, store)
    assert said == f"the worker {address} {words}{pgcp.__version__}; install one version on all machines"
    assert seconds < 5
    assert list(store.iterdir()) == []


@pytest.mark.parametrize(
    ("mount", "words"),
    [
        ("mount -t tmpfs none {0}", "cannot read (No such file or directory) the store {0}; give --store a folder that all"),
        ("mount --bind {0} {0} && mount -o remount,ro,bind {0}", "cannot write to (Read-only file system) the store {0}"),
    ],
)
def test_a_worker_that_does_not_see_the_store_is_named(mount, words, cluster, processes, store, tmp_path):
    alone = ("unshare", "--mount", "sh", "-c", f'{mount.format(store)} && exec "$0" "$@"')
    if subprocess.run([*alone, "true"], capture_output=True, check=False).returncode:
        pytest.skip("this user may not mount a file system")
    address = add_worker(cluster, processes, tmp_path, alone)
    said, seconds = refused(cluster, store)
    assert said.startswith(f"the worker {address} {words.format(store)}")
    assert seconds < 5
    assert list(store.iterdir()) == []


def test_a_store_that_is_not_there_is_said(cluster, tmp_path):
    said, _ = refused(cluster, tmp_path / "nowhere")
    assert said == f"{tmp_path / 'nowhere'}: cannot write to the store: No such file or directory"


def test_a_worker_that_does_not_answer_is_waited_for_later(cluster, store):
    worker = cluster.workers[0]
    with Client(cluster.address) as client:
        known = client.scheduler_info(n_workers=-1)["workers"]
        worker.send_signal(19)
        try:
            start = time.monotonic()
            check_workers(client, known, store)
            assert 3 < time.monotonic() - start < 20
        finally:
            worker.send_signal(18)
        check_workers(client, known, store)
    assert list(store.iterdir()) == []


def test_a_live_client_is_taken_and_stays_open(tmp_path):
    wanted = pgcp.parameterize(HILLS, patches=3)
    with (
        LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0", local_directory=tmp_path) as local,
        Client(local) as client,
    ):
        for _ in range(2):
            result = pgcp.parameterize(HILLS, patches=3, client=client, store=tmp_path)
            assert result.coordinates.tobytes() == wanted.coordinates.tobytes()
            assert result.report["executor"] == {"kind": "dask cluster", "workers": 1, "threads_per_worker": 1}
            assert str(client.scheduler.address) in result.report["options"]["client"]
        assert client.submit(sum, [1, 2]).result() == 3
        assert client.run_on_scheduler(lambda dask_scheduler: [k for k in dask_scheduler.tasks if "pgcp" in str(k)]) == []
    with pytest.raises(InputError, match="client is closed; give one that is connected"):
        pgcp.parameterize(HILLS, client=client)


@pytest.mark.parametrize("wrong", ["tcp://1.2.3.4:8786", 3, np.zeros(2)])
def test_what_is_no_client_is_named(wrong):
    with pytest.raises(InputError, match=r"^client is .*, it must be a dask\.distributed\.Client"):
        pgcp.parameterize(HILLS, client=wrong)


def test_one_cluster_is_named_once():
    with pytest.raises(InputError, match="give one of a scheduler address, a scheduler file and a client"):
        pgcp.parameterize(HILLS, client=3, scheduler="tcp://1.2.3.4:8786")
    with pytest.raises(InputError, match="a client has its own TLS files"):
        pgcp.parameterize(HILLS, client=3, tls_ca="a", tls_cert="b", tls_key="c")
