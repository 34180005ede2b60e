"""Real processes to be disturbed: the command, a dask scheduler and dask workers, whose tasks log what they do and can be held.

As a script this is the command itself, as a preload of dask workers it treats their tasks alike. All control is by files in
the folder that the store lies in: ``log``; ``hold``, which starts of which stage wait; ``go``, which lets all of them go on.
"""

from __future__ import annotations

import ctypes
import functools
import os
import resource
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import psutil
from said import without_progress

PATIENCE = "PATIENCE_S"
PATCHES = 6
_LONG_S = 120


def wait_until(condition, what, seconds=_LONG_S):
    """Return what a condition gives as soon as it is true."""
    deadline = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < deadline, f"waited {seconds} s for {what}"
        time.sleep(0.02)
    return found


# inside the processes


def note(folder, *words):
    """Append a line to the log, whole."""
    handle = os.open(folder / "log", os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(handle, (" ".join(map(str, words)) + "\n").encode())
    os.close(handle)


def _ticket(folder, stage):
    """The how manieth start of a stage this is, over all processes."""
    number = 0
    while True:
        try:
            (folder / f"ticket-{stage}-{number}").touch(exist_ok=False)
            return number
        except FileExistsError:
            number += 1


def _wait_where_told(folder, stage):
    """Wait at the start of a task; returns what waits at its end."""
    if not (folder / "hold").exists():
        return lambda: None
    number = _ticket(folder, stage)

    def wait():
        note(folder, "held", stage, number, os.getpid())
        wait_until((folder / "go").exists, "go")

    for line in (folder / "hold").read_text().splitlines():
        held, first, last, what = line.split()
        if held != stage or not int(first) <= number < int(last):
            continue
        if what == "fill":
            resource.setrlimit(resource.RLIMIT_FSIZE, (1024, resource.RLIM_INFINITY))
        elif what == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        elif what == "late":
            return wait
        else:
            wait()
    return lambda: None


def _watched(function, stage, directory_of):
    @functools.wraps(function)
    def watched(*arguments):
        wait_at_end = _wait_where_told(directory_of(arguments[:2]).parents[2], stage)
        out = function(*arguments)
        wait_at_end()
        return out

    return watched


def _noting(write):
    """What writes a record, and notes those that finish a task."""
    stages = {"curve": "flatten", "union": "weld", "solved": "solve"}
    stages |= {"eliminated": "eliminate", "merged": "merge", "extended": "extend"}  # with exact seams

    @functools.wraps(write)
    def noting(store, kind, index, record):
        write(store, kind, index, record)
        stage = stages.get(kind.split("-")[0])
        if stage is not None:
            note(store.directory.parents[2], "done", stage, index)

    return noting


def watch():
    """Have the tasks of this process, and what follows the second pass, log and wait; returns how to undo it."""
    from pgcp.methods import pgcp as by_welds
    from pgcp.patches import tasks
    from pgcp.runtime.store import PatchStore

    before = [(PatchStore, "write", PatchStore.write)]
    PatchStore.write = _noting(PatchStore.write)

    def replace(modules, name, stage, directory_of):
        function = _watched(getattr(by_welds, name), stage, directory_of)
        for module in modules:
            before.append((module, name, getattr(module, name)))
            setattr(module, name, function)

    job_first = lambda two: two[0].directory  # noqa: E731
    both = (tasks, by_welds)
    replace(both, "flatten_task", "flatten", job_first)
    replace(both, "weld_task", "weld", job_first)
    replace(both, "prepare_task", "prepare", job_first)
    replace(both, "solve_task", "solve", job_first)
    replace((by_welds,), "gathered", "gather", lambda two: two[1].job.directory)
    return lambda: [setattr(*one) for one in before[::-1]]


def dask_setup(_worker):
    """Called in a dask worker that preloads this file."""
    watch()


def main():
    """The command, with a log of what has arrived in its own process."""
    from pgcp.cli import main as cli
    from pgcp.cli.progress import Silent
    from pgcp.runtime.executors.connection import Connection

    class Heard(Silent):
        def __call__(self, stage, done, total):
            note(Path(), "at", stage, done, total)

    cli.display = lambda _quiet: Heard()
    Connection.patience_s = float(os.environ.get(PATIENCE, Connection.patience_s))
    cli.run()


if __name__ in ("__main__", "__mp_main__"):  # the latter in worker processes of a local cluster
    watch()
if __name__ == "__main__":
    main()


# outside


_DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG


def _as_child():
    """In a new process: Ctrl-C is not ignored, and on Linux it is killed if this process, killed itself, cannot end it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)


class Processes:
    """Processes that are ended with all they have started, whatever happens."""

    def __init__(self):
        self._all = []

    def start(self, command, **options):
        """Start one in a process group of its own, to which Ctrl-C can be sent."""
        self._all.append(subprocess.Popen(command, start_new_session=True, preexec_fn=_as_child, **options))  # noqa: PLW1509
        return self._all[-1]

    def end(self):
        """Kill what is left."""
        for process in self._all:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            for stream in (process.stdout, process.stderr):
                if stream is not None:
                    stream.close()


def kill(pid):
    """Kill a process and wait until it is gone, with all its threads, or only its parent knows of it."""
    process = psutil.Process(pid)

    def gone():
        with suppress(psutil.NoSuchProcess, FileNotFoundError):
            return process.status() == psutil.STATUS_ZOMBIE and len(os.listdir(f"/proc/{pid}/task")) < 2
        return True

    process.kill()
    wait_until(gone, f"the end of {pid}")


class Place:
    """A folder with a mesh, a store and results, and the command run in it."""

    def __init__(self, folder, mesh, processes):
        self.folder, self.store, self._processes = folder, folder / "store", processes
        self.store.mkdir(exist_ok=True)
        (folder / "hills.obj").write_bytes(mesh)

    def hold(self, stage, first=0, last=1, what="wait"):
        """Have some starts of a stage wait, also when all is done but said (late), fill the disk or die."""
        with (self.folder / "hold").open("a") as stream:
            stream.write(f"{stage} {first} {last} {what}\n")

    def go(self):
        """Let all go on, now and later."""
        (self.folder / "go").touch()

    def lines(self, *words):
        """Lines of the log that begin so, as words."""
        path = self.folder / "log"
        rows = [line.split() for line in path.read_text().splitlines()] if path.exists() else []
        return [row for row in rows if row[: len(words)] == [str(word) for word in words]]

    def wait_for(self, process, *words):
        """Wait for a line of the log that begins so; its last word."""

        def looked():
            found = self.lines(*words)
            assert found or process.poll() is None, f"ended without {words}: {process.communicate()}"
            return found

        return wait_until(looked, " ".join(map(str, words)))[0][-1]

    def held(self, process, stage, number=0):
        """Wait until a start of a stage is held; the id of its process."""
        return int(self.wait_for(process, "held", stage, number))

    def done(self):
        """How often what was done, stage by stage."""
        return Counter((stage, int(index)) for _, stage, index in self.lines("done"))

    def forget(self):
        """Begin a new log, without holds."""
        for path in (self.folder / "log", self.folder / "hold", self.folder / "go", *self.folder.glob("ticket-*")):
            path.unlink(missing_ok=True)

    def start(self, *arguments, patience=None):
        """Start the command."""
        usual = ("hills.obj", "--patches", str(PATCHES), "--store", "store", "--no-obj", "--no-ply", "--no-png", "--no-html")
        environment = {**os.environ, "PYTHONWARNINGS": ""}
        if patience is not None:
            environment[PATIENCE] = str(patience)
        command = [sys.executable, __file__, *usual, *arguments]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        return self._processes.start(command, cwd=self.folder, env=environment, **pipes)

    def finish(self, *arguments):
        """Run the command to its end: exit status and standard error."""
        return self.end_of(self.start(*arguments))

    @staticmethod
    def end_of(process):
        """Exit status and standard error."""
        _, err = process.communicate(timeout=_LONG_S)
        return process.returncode, without_progress(err)

    def runs(self):
        """Directories of runs in the store."""
        return sorted(path for path in self.store.iterdir() if path.is_dir() and path.name.startswith("pgcp-"))

    def records(self, kind):
        """Numbers of the records of a kind that are in the store."""
        return sorted(int(path.stem.split("-")[-1]) for path in self.store.rglob(f"{kind}-*.npz"))

    def record(self, kind, index):
        """The file of a record."""
        (path,) = self.store.rglob(f"{kind}-*{index:05d}.npz")
        return path

    def result(self):
        """What the command has written."""
        return (self.folder / "hills_pgcp" / "hills.npz").read_bytes()


class Cluster:
    """A scheduler and workers, started as a user would start them on several machines, all on this one."""

    def __init__(self, folder, processes, protocol="tcp", tls=()):
        with socket.socket() as s:
            s.bind(("127.0.0.1", 0))
            self.port = s.getsockname()[1]
        self.address = f"{protocol}://127.0.0.1:{self.port}"
        self._folder, self._processes, self._tls, self._protocol = folder, processes, tls, protocol
        self.scheduler = None
        self.workers = []

    def _start(self, what, *arguments):
        dask = str(Path(sys.executable).with_name("dask"))
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        command = [dask, what, *arguments, *self._tls, "--no-dashboard"]
        return self._processes.start(command, cwd=self._folder, env={**os.environ, "PYTHONWARNINGS": ""}, **quiet)

    @property
    def info(self):
        """The file in which the scheduler says where it is."""
        return self._folder / "scheduler.json"

    def start_scheduler(self):
        """Start the scheduler, on the same port every time."""
        where = ("--protocol", self._protocol, "--host", "127.0.0.1", "--port", str(self.port))
        self.scheduler = self._start("scheduler", *where, "--scheduler-file", str(self.info))

    def have_workers(self, count, security=None):
        """Start workers until there are so many, and wait until all are there and no others."""
        from distributed import Client

        def as_many():
            self.workers = [worker for worker in self.workers if worker.poll() is None]
            while len(self.workers) < count:
                where = ("--local-directory", str(self._folder), "--host", "127.0.0.1")
                which = ("--nthreads", "1", "--no-nanny", "--preload", __file__)
                self.workers.append(self._start("worker", self.address, *where, *which))
            there = client.run(os.getpid, on_error="ignore")
            return set(there.values()) == {worker.pid for worker in self.workers}

        with Client(self.address, timeout="60s", security=security) as client:
            wait_until(as_many, f"{count} workers")
