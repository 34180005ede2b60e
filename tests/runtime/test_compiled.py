"""Compiled code: all of it is listed, it is kept somewhere, and several processes share a first run's compiling."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from meshes import grid
from said import without_progress

import pgcp
from pgcp.runtime import compiled

ROOT = Path(__file__).resolve().parents[2]
FEW = [kernel for kernel in compiled.kernels() if kernel.function in ("_pair", "_component_count", "_extent")]


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.mark.slow
def test_no_run_compiles_what_is_not_listed():
    command = [sys.executable, ROOT / "scripts" / "kernels.py", "--check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    assert done.stdout == "", "run scripts/kernels.py"
    assert done.returncode == 0, done.stderr


def test_every_usual_run_has_its_functions():
    for run in ("free", "disk", "sphere"):
        assert 40 < len(compiled.kernels(run)) < len(compiled.kernels())


def shortened(code):
    """A program in which the list has a few functions only."""
    names = {kernel.function for kernel in FEW}
    return f"""
import sys
from pgcp.runtime import compiled
every = compiled.kernels
compiled.kernels = lambda run="": [k for k in every(run) if k.function in {names!r}]
{code}
"""


def test_processes_compile_the_list_and_later_ones_find_it(cache):
    words = [sys.executable, "-c", shortened("compiled.main(sys.argv[1:])")]
    both = [subprocess.Popen([*words, "", str(n), "2"], stdout=subprocess.PIPE, text=True) for n in range(2)]
    told = [process.communicate(timeout=300)[0].split() for process in both]
    assert [process.returncode for process in both] == [0, 0]
    assert sorted(told[0] + told[1]) == sorted(kernel.function for kernel in FEW)
    assert abs(len(told[0]) - len(told[1])) <= 1
    heard = shortened("""
from numba.core import event
with event.install_recorder("numba:compile") as recorder:
    for kernel in compiled.kernels():
        compiled.compile_kernel(kernel)
print(len(recorder.buffer))
""")
    done = subprocess.run([sys.executable, "-c", heard], capture_output=True, text=True, check=True, timeout=300)
    assert done.stdout == "0\n"


def test_compiling_is_told_as_a_stage(cache):
    program = """
from pgcp.surface import plain
from pgcp.surface.topology import examine
import numpy as np
plain.FEW = 0
heard = []
if __name__ == "__main__":
    with compiled.compiled_together("free", 1, lambda *said: heard.append(said)):
        examine(np.array([[0, 1, 2]]), 3)
    print(heard[0], heard[-1][1] == heard[-1][2] > 0, len(heard))
    heard.clear()
    with compiled.compiled_together("free", 1, lambda *said: heard.append(said)):
        examine(np.array([[0, 1, 2]]), 3)
    print(heard)
"""
    done = subprocess.run([sys.executable, "-c", shortened(program)], capture_output=True, text=True, check=True, timeout=300)
    assert done.stdout == "('compile for this machine, once', 0, 0) True 2\n[]\n"
    assert done.stderr == ""


def test_where_no_cache_can_be_written_a_run_says_so_and_goes_on(tmp_path):
    ring = pgcp.Mesh(grid(3).vertices, np.delete(grid(3).faces, [8, 9], axis=0))
    pgcp.write_mesh(tmp_path / "ring.ply", ring)
    (tmp_path / "temporary").mkdir()
    environment = {**os.environ, "NUMBA_CACHE_DIR": "/proc/nowhere", "TMPDIR": str(tmp_path / "temporary")}

    def run(*words):
        command = [sys.executable, "-m", "pgcp", *words]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=300)

    done = run(tmp_path / "ring.ply")
    first, second = without_progress(done.stderr).splitlines()
    assert first.startswith("pgcp-run: no folder for compiled code can be written")
    assert "2 boundary loops" in second
    assert done.returncode == 2
    assert "NUMBA_CACHE_DIR may name a folder" in run("--warm-up").stderr
    assert list((tmp_path / "temporary").iterdir()) == []


def test_without_a_place_of_its_own_the_cache_is_temporary(tmp_path, monkeypatch):
    monkeypatch.setattr(compiled, "_TEMPORARY", [])
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "own" / "cache"))
    compiled.find_cache()
    assert not compiled.cache_is_temporary()
    assert (tmp_path / "own" / "cache").is_dir()
    (tmp_path / "file").write_text("")
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setattr(compiled, "_PACKAGE", tmp_path / "file")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    compiled.find_cache()
    assert not compiled.cache_is_temporary()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    compiled.find_cache()
    assert compiled.cache_is_temporary()
    folder = Path(os.environ["NUMBA_CACHE_DIR"])
    assert folder.is_dir()
    compiled.drop_temporary_cache()
    assert not folder.exists()
