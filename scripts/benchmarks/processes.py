"""Processes measured from outside: seconds and memory of a command and all its children, pgcp-run as one of them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

_LOOK_S = 0.05
_FIND_S = 0.3  # between two searches for children, which look at every process there is
_GROWTH = 1.02


@dataclass(frozen=True, slots=True)
class Measured:
    """One finished command: exit status, seconds, peak memory of the tree and of its root alone, the end of what it said."""

    status: int
    wall_s: float
    cpu_s: float
    peak_bytes: int
    root_peak_bytes: int
    output: str
    errors: str


class Watch:
    """Memory and CPU seconds of a process and all its children, as far as seen; what all hold together on request only."""

    def __init__(self, pid: int, looks_at_memory: bool) -> None:
        self._looks_at_memory = looks_at_memory
        self.root = psutil.Process(pid)
        self.peak_bytes = self.root_peak_bytes = 0
        self._resident = 0.0
        self._processes = [self.root]
        self._found = 0.0
        self._cpu: dict[tuple[int, float], float] = {}

    @property
    def cpu_s(self) -> float:
        """Seconds of all processes seen, up to when they were last seen."""
        return sum(self._cpu.values())

    def look(self) -> None:
        """Look once."""
        with suppress(psutil.Error):
            if time.monotonic() > self._found + _FIND_S:
                self._processes = [self.root, *self.root.children(recursive=True)]
                self._found = time.monotonic()
            sizes = [self._size(process) for process in self._processes]
            self.root_peak_bytes = max(self.root_peak_bytes, sizes[0])
            if self._looks_at_memory and sum(sizes) > _GROWTH * self._resident:
                self._resident = sum(sizes)
                self.peak_bytes = max(self.peak_bytes, sum(self._share(process) for process in self._processes))

    def _size(self, process: psutil.Process) -> int:
        with suppress(psutil.Error):
            times = process.cpu_times()
            self._cpu[process.pid, process.create_time()] = times.user + times.system
            return int(process.memory_info().rss)
        return 0

    @staticmethod
    def _share(process: psutil.Process) -> int:
        with suppress(psutil.Error):
            try:
                return int(process.memory_full_info().pss)
            except AttributeError:
                return int(process.memory_info().rss)
        return 0


@contextmanager
def watched(pid: int, looks_at_memory: bool = True) -> Iterator[Watch]:
    """Look at a process and its children every 50 ms while what is inside runs."""
    watch, ended = Watch(pid, looks_at_memory), threading.Event()

    def keep_looking() -> None:
        while not ended.is_set():
            watch.look()
            ended.wait(_LOOK_S)

    thread = threading.Thread(target=keep_looking)
    thread.start()
    try:
        yield watch
    finally:
        ended.set()
        thread.join()


def run_measured(command: Sequence[str | Path], looks_at_memory: bool = True, folder: str | Path | None = None) -> Measured:
    """Run a command to its end, in a folder if one is named, and measure it with all processes it starts."""
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        start = time.perf_counter()
        words = [str(word) for word in command]
        process = subprocess.Popen(words, stdout=output, stderr=errors, stdin=subprocess.DEVNULL, cwd=folder)
        with watched(process.pid, looks_at_memory) as watch:
            _, status, usage = os.wait4(process.pid, 0)
            wall_s = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        texts = []
        for stream in (output, errors):
            stream.seek(0)
            texts.append(stream.read().decode(errors="replace"))
    # what the kernel adds up leaves out children that nobody has waited for
    cpu_s = max(usage.ru_utime + usage.ru_stime, watch.cpu_s)
    return Measured(process.returncode, wall_s, cpu_s, watch.peak_bytes, watch.root_peak_bytes, *texts)


def stage_seconds(report: dict[str, Any]) -> dict[str, float]:
    """Seconds by stage of a report of pgcp-run; what was tried again is added up."""
    out: dict[str, float] = {}
    for stage in report["stages"]:
        out[stage["name"]] = out.get(stage["name"], 0.0) + stage["seconds"]
    return out


def pgcp_command(mesh: Path | None, out: Path, options: dict[str, Any]) -> list[str]:
    """The command for one run, of the demo where there is no mesh, without pictures; options that are None are left out."""
    words = [f"--{name}={value}" for name, value in options.items() if value is not None]
    words += ["--no-obj", "--no-ply", "--no-png", "--no-html", f"--output-dir={out}"]
    return [sys.executable, "-m", "pgcp", "--demo" if mesh is None else str(mesh), *words]


def run_pgcp(
    path: Path, options: dict[str, Any], looks_at_memory: bool = True
) -> tuple[Measured, dict[str, Any] | None, float]:
    """Run pgcp-run once: its report, and the seconds it says it took; None and nan where it has failed."""
    with tempfile.TemporaryDirectory() as folder:
        measured = run_measured([*pgcp_command(path, Path(folder), options), "--json", "--quiet"], looks_at_memory)
        report = Path(folder) / "report.json"
        if not report.exists():
            return measured, None, float("nan")
        return measured, json.loads(report.read_text()), float(json.loads(measured.output)["seconds"])


def warm_up(options: dict[str, Any]) -> Measured:
    """Let pgcp-run map its demo once, so that nothing is compiled in the runs that count."""
    with tempfile.TemporaryDirectory() as folder:
        return run_measured(pgcp_command(None, Path(folder), options))
