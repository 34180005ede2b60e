"""Results switch together or not at all, whatever ends the run: signals, SIGKILL, a full disk."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import textwrap
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from meshes import grid, lifted
from said import without_progress

import pgcp
from pgcp.cli.main import main
from pgcp.io.files import claimed, replacing_together
from pgcp.runtime.run_directory import run_directory

LOOP = """
import sys, time
from contextlib import contextmanager
from pathlib import Path
import numpy as np
from pgcp.io import write
from pgcp.types import Mesh, Parameterization, Quality

folder = Path(sys.argv[1])
n = 60
i, j = (k.ravel() for k in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
a = (n * i + j)[(i < n - 1) & (j < n - 1)]
faces = np.concatenate([np.column_stack([a, a + n, a + n + 1]), np.column_stack([a, a + n + 1, a + 1])])
mesh = Mesh(np.column_stack([i, j, i * 0.0]), faces)
quality = Quality(*[0.0] * 7, 0, 0.0)

@contextmanager
def marked():
    (folder / "switching").touch()
    yield
    (folder / "switching").unlink()

def one(k):
    uv = np.full((n * n, 2), float(k))
    result = Parameterization(mesh, uv, faces[:, 0], faces[:, 0] * 1j, quality, "free", {"k": k})
    write.write_outputs(folder / "out", "m", result, {".png": b"png %d" % k}, marked())

if len(sys.argv) > 2:
    one(int(sys.argv[2]))
else:
    k = 1
    while True:
        one(k)
        print("x", end="", flush=True)
        k += 1
"""
NAMES = ["m.npz", "m.obj", "m.ply", "m.png", "report.json"]


def versions(out):
    """Which run each of the five files is of."""
    with np.load(out / "m.npz") as data:
        yield data["uv"][-1, 1]
    text = (out / "m.obj").read_text().splitlines()
    yield float(next(line for line in text if line.startswith("vt ")).split()[1])
    assert text[-1].startswith("f ")
    assert len(pgcp.read_mesh(out / "m.ply").faces) == 2 * 59 * 59
    yield float((out / "m.png").read_bytes().split()[1])
    yield json.loads((out / "report.json").read_text())["k"]


def test_a_killed_run_leaves_a_whole_set_and_the_next_cleans_up(tmp_path):
    script = tmp_path / "loop.py"
    script.write_text(LOOP)
    leftovers = 0
    for attempt in range(14):
        process = subprocess.Popen([sys.executable, script, tmp_path], stdout=subprocess.PIPE)
        process.stdout.read(1)  # the first set is there
        time.sleep(0.004 * attempt)
        process.kill()
        process.communicate()
        if (tmp_path / "switching").exists():  # killed between two renames, which take no time to speak of
            (tmp_path / "switching").unlink()
        else:
            assert len(set(versions(tmp_path / "out"))) == 1
        leftovers += sum(p.name.endswith(".part") for p in (tmp_path / "out").iterdir())
    assert leftovers > 0, "no run was killed while it wrote"
    subprocess.run([sys.executable, script, tmp_path, "7"], check=True)
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == NAMES
    assert set(versions(tmp_path / "out")) == {7.0}


# the command itself, made slow at one place
SLOW = """
import os, sys, time
from pathlib import Path
from dataclasses import replace
from pgcp.cli import main as cli
from pgcp.io import ply
from pgcp.io.formats import FORMATS, register
mark = Path(sys.argv[1])

def slow(function, where=""):
    def slowly(*arguments, **options):
        if where in str(arguments[-1]):
            mark.touch()
            time.sleep(float(sys.argv[3]))
        return function(*arguments, **options)
    return slowly

place = sys.argv[2]
if place == "write":
    register(replace(FORMATS["ply"], write=slow(ply.write_ply)))
elif place == "switch":
    os.replace = slow(os.replace, "hills_pgcp")  # not of the store's files
elif place == "solve":
    from pgcp import pipeline
    from pgcp.patches import stored
    pipeline.measure_quality = slow(pipeline.measure_quality)
    stored.collect = slow(stored.collect)
if __name__ == "__main__":
    sys.exit(cli.main(sys.argv[4:]))
"""


@pytest.fixture(scope="module", autouse=True)
def compiled(tmp_path_factory):
    """All that numba keeps is there before a disk is full and before anybody waits."""
    folder = tmp_path_factory.mktemp("warm")
    pgcp.write_mesh(folder / "hills.obj", lifted(grid(16, 12)))
    assert main([str(folder / "hills.obj"), "--patches", "2", "--store", str(folder), "--quiet"]) == 0


@pytest.fixture
def folder(tmp_path):
    pgcp.write_mesh(tmp_path / "hills.obj", lifted(grid(16, 12)))
    (tmp_path / "slow.py").write_text(SLOW)
    (tmp_path / "store").mkdir()
    (tmp_path / "hills_pgcp").mkdir()
    for name in NAMES:
        (tmp_path / "hills_pgcp" / name.replace("m.", "hills.")).write_text(f"earlier {name}")
    return tmp_path


def everything(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file() and p.name != "mark"}


def run(folder, *arguments, **options):
    command = [sys.executable, "-m", "pgcp", "hills.obj", "--patches", "2", "--store", "store", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False, **options)


def slowed(folder, place, seconds=60):
    process = subprocess.Popen(
        [sys.executable, "slow.py", "mark", place, str(seconds), "hills.obj", "--patches", "2", "--store", "store"],
        cwd=folder, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        preexec_fn=lambda: [signal.signal(s, signal.SIG_DFL) for s in (signal.SIGINT, signal.SIGHUP)],  # noqa: PLW1509
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not (folder / "mark").exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    return process


@pytest.mark.parametrize(
    ("place", "number", "word"),
    [
        ("write", signal.SIGHUP, "hung up"),
        ("solve", signal.SIGTERM, "terminated"),
    ],
)
def test_a_signal_leaves_earlier_results_and_nothing_else(place, number, word, folder):
    before = everything(folder)
    process = slowed(folder, place)
    assert len(everything(folder)) > len(before)  # temporary files, of the results or the store
    process.send_signal(number)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out, without_progress(err)) == (128 + number, "", f"pgcp-run: {word}; nothing was written\n")
    assert everything(folder) == before
    assert list((folder / "store").iterdir()) == []


def test_a_killed_command_leaves_earlier_results_and_the_next_cleans_up(folder):
    before = everything(folder)
    for place in ("solve", "write"):
        process = slowed(folder, place)
        process.kill()
        process.communicate()
        after = everything(folder)
        assert {name: after[name] for name in before} == before
        assert set(after) > set(before)
        (folder / "mark").unlink()
    done = run(folder)
    assert done.returncode == 0, done.stderr
    assert set(everything(folder)) == {*before, "hills_pgcp/hills.html"}
    assert list((folder / "store").iterdir()) == []
    assert all(not data.startswith(b"earlier") for data in everything(folder).values())


def test_a_signal_during_the_switch_waits_for_it(folder):
    process = slowed(folder, "switch", 0.1)
    deadline = time.monotonic() + 60
    while (folder / "hills_pgcp" / "hills.npz").read_bytes() == b"earlier m.npz" and time.monotonic() < deadline:
        time.sleep(0.01)
    assert (folder / "hills_pgcp" / "report.json").read_bytes() == b"earlier report.json"
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=60)
    files = everything(folder / "hills_pgcp")
    assert len(files) == 6
    assert all(not data.startswith(b"earlier") for data in files.values())


@pytest.mark.parametrize(
    ("kilobytes", "where", "what"),
    [(40, "hills_pgcp", "hills_pgcp: cannot write the results"), (2, "new/er", "File too large")],
)
def test_a_full_disk_changes_nothing(kilobytes, where, what, folder):
    before = everything(folder)
    limit = lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (kilobytes * 1024,) * 2)  # noqa: E731
    done = run(folder, "--output-dir", where, preexec_fn=limit)
    assert done.returncode == 2, done.stderr
    assert what in done.stderr
    assert without_progress(done.stderr).count("\n") == 1
    assert everything(folder) == before
    assert not (folder / "new").exists()
    assert list((folder / "store").iterdir()) == []


def test_a_full_disk_behind_standard_output_is_said(folder):
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "pgcp", "hills.obj", "--patches", "2", "--json"]
        done = subprocess.run(command, cwd=folder, stdout=full, stderr=subprocess.PIPE, text=True, timeout=120, check=False)
    assert (done.returncode, without_progress(done.stderr)) == (2, "pgcp-run: cannot print: No space left on device\n")
    assert json.loads((folder / "hills_pgcp" / "report.json").read_text())["status"] == "good"


def test_temporary_files_of_living_runs_are_left_alone(tmp_path):
    with replacing_together(tmp_path) as one:
        one.open("a").write(b"one")
        with replacing_together(tmp_path) as two:
            two.open("a").write(b"two")
            two.switch()
        assert (tmp_path / "a").read_bytes() == b"two"
        one.switch()
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {"a": b"one"}
    with run_directory(tmp_path, "key") as one:
        with run_directory(tmp_path, "key") as two:
            assert one.path.is_dir()
            assert one.path != two.path
        assert [p.name for p in tmp_path.iterdir() if p.is_dir()] == [one.path.name]
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


def test_a_lock_that_a_starting_process_has_for_a_moment_makes_no_other_run(tmp_path):
    """A run starts its workers meanwhile: these inherit the locks that it has just then, until they run their own program."""
    with run_directory(tmp_path, "key") as first:
        first.keep = True
        (first.path / "done").touch()
        child = subprocess.Popen(["sleep", "0.15"], pass_fds=_locked_files(first.path))
    with claimed(tmp_path / "results"):
        (tmp_path / "results" / "map").touch()
        other = subprocess.Popen(["sleep", "0.15"], pass_fds=_locked_files(tmp_path / "results"))
    with run_directory(tmp_path, "key", resume=True) as second, claimed(tmp_path / "results"):
        assert child.wait() + other.wait() == 0
        assert second.path == first.path
        assert (second.path / "done").exists()
    assert not first.path.exists()


def _locked_files(folder):
    """Numbers of this process's open files that are the folder, or in it."""
    numbers = []
    for entry in Path("/proc/self/fd").iterdir():
        with suppress(OSError):
            if entry.readlink().is_relative_to(folder):
                numbers.append(int(entry.name))
    assert numbers
    return numbers


def test_a_directory_where_a_result_should_go_stops_all(tmp_path):
    (tmp_path / "b").mkdir()
    (tmp_path / "a").write_text("earlier")

    def write():
        with replacing_together(tmp_path) as files:
            files.open("a").write(b"new")
            files.open("b")

    with pytest.raises(IsADirectoryError):
        write()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "b"]
    assert (tmp_path / "a").read_text() == "earlier"


SCRIPT = textwrap.dedent("""
    import pgcp
    from pgcp.surface.demo import demo_mesh
    result = pgcp.parameterize(demo_mesh(8), patches=2, workers=1)
    print("folds", result.quality.folds)
""")


def finish(command, **options):
    environment = {**os.environ, "PYTHONWARNINGS": "ignore"}
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, env=environment, **options)


def last_line(done):
    assert done.returncode == 1
    return done.stderr.strip().splitlines()[-1]


def test_scripts_whose_workers_cannot_start_say_why(tmp_path):
    done = finish([sys.executable, "-"], input=SCRIPT)
    assert last_line(done).startswith("pgcp.errors.InputError: worker processes import the main script, but <stdin> is no file")
    assert done.stderr.count("Traceback") == 1
    (tmp_path / "bare.py").write_text(SCRIPT)
    done = finish([sys.executable, tmp_path / "bare.py"])
    assert 'if __name__ == "__main__":' in last_line(done)
    assert "bare.py" in last_line(done)
    assert last_line(done).startswith("pgcp.errors.InputError: the worker processes did not start")
    assert "bootstrapping" not in done.stderr


def test_scripts_given_as_words_do_work():
    done = finish([sys.executable, "-c", SCRIPT])
    assert (done.returncode, done.stdout) == (0, "folds 0\n"), done.stderr
