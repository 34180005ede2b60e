"""No run leaves anything in the temporary directory or among shared memory, however it ends but by SIGKILL."""

from __future__ import annotations

import os
import signal
import tempfile
import time
from pathlib import Path

import pytest
from clusters import Place, Processes, kill, wait_until
from meshes import grid, lifted

import pgcp

SHARED = Path("/dev/shm")


@pytest.fixture
def processes():
    started = Processes()
    yield started
    started.end()


@pytest.fixture(scope="module")
def mesh_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "hills.obj"
    pgcp.write_mesh(path, lifted(grid(40, 30, jitter=0.2)))
    return path.read_bytes()


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """The folder for temporary files of what is started, near the root: names of sockets in it may not be long."""
    with tempfile.TemporaryDirectory() as folder:
        monkeypatch.setenv("TMPDIR", folder)
        yield Path(folder)


@pytest.fixture
def place(tmp_path, mesh_file, processes, temporary):
    return Place(tmp_path, mesh_file, processes)


def shared():
    """Files of shared memory that no process uses."""
    names = set(os.listdir(SHARED)) if SHARED.is_dir() else set()
    used = ""
    for maps in Path("/proc").glob("[0-9]*/maps"):
        try:
            used += maps.read_text()
        except OSError:
            continue
    return {name for name in names if name not in used}


@pytest.fixture(autouse=True)
def nothing_left(temporary):
    before = shared()
    yield
    assert sorted(temporary.rglob("*")) == []
    wait_until(lambda: shared() <= before, "an end of shared memory", seconds=10)


@pytest.mark.parametrize("words", [(), ("--workers", "2")])
def test_a_run_that_ends_well_leaves_nothing(words, place):
    assert place.finish("--quiet", *words)[0] == 0
    assert place.runs() == []


@pytest.mark.parametrize("words", [("--target", "sphere"), pytest.param(("--cuts", "nowhere"), marks=pytest.mark.slow)])
def test_a_run_that_is_refused_leaves_nothing(words, place):
    assert place.finish("--workers", "2", *words)[0] == 2
    assert place.runs() == []


def test_a_map_with_folds_leaves_nothing(place):
    pgcp.write_mesh(place.folder / "hills.obj", lifted(grid(40, jitter=0.45), 4.0))
    status, _ = place.finish("--workers", "2", "--repairs", "none", "--quiet")
    assert status == 3
    assert place.runs() == []


@pytest.mark.parametrize(
    ("stage", "number"),
    [
        ("flatten", signal.SIGINT),
        ("gather", signal.SIGTERM),
        pytest.param("gather", signal.SIGINT, marks=pytest.mark.slow),
        pytest.param("flatten", signal.SIGTERM, marks=pytest.mark.slow),
        pytest.param("flatten", signal.SIGHUP, marks=pytest.mark.slow),
    ],
)
def test_a_run_that_is_stopped_leaves_nothing(stage, number, place):
    place.hold(stage)
    process = place.start("--workers", "2", "--quiet")
    place.held(process, stage)
    os.killpg(process.pid, number)
    place.go()
    assert place.end_of(process)[0] == 128 + number
    assert place.runs() == []


@pytest.mark.parametrize("seconds", [0.4, *(pytest.param(s, marks=pytest.mark.slow) for s in (0.2, 0.7, 1.0, 1.3))])
def test_a_run_that_is_stopped_while_it_starts_leaves_nothing(seconds, place):
    process = place.start("--workers", "2", "--quiet")
    time.sleep(seconds)
    process.send_signal(signal.SIGTERM)
    assert place.end_of(process)[0] in (-signal.SIGTERM, 128 + signal.SIGTERM)
    assert place.runs() == []


def test_a_run_that_loses_a_worker_leaves_nothing(place):
    place.hold("flatten")
    process = place.start("--workers", "2", "--quiet")
    kill(place.held(process, "flatten"))
    assert place.end_of(process) == (0, "")
    assert place.runs() == []


def test_a_run_from_python_leaves_nothing(place, processes):
    code = "import pgcp\nif __name__ == '__main__': pgcp.parameterize('hills.obj', workers=1)"
    (place.folder / "script.py").write_text(code)
    assert processes.start([os.sys.executable, "script.py"], cwd=place.folder).wait(60) == 0
