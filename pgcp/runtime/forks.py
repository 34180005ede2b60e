"""The process that local workers are forked from: it starts early and imports what they need while the mesh is read.

On Linux only: elsewhere, forking after numerical libraries are loaded is unsafe, and each worker imports them itself.
"""

from __future__ import annotations

import gc
import os
import shutil
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import process, resource_tracker
from pathlib import Path

FORKS = sys.platform == "linux"
WORKER_ENVIRONMENT = {
    "DASK_LOGGING__DISTRIBUTED": "critical",  # silence_logs ends before a worker
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    # memory of one patch serves the next: fresh pages cost as much as the arithmetic on them
    "MALLOC_ARENA_MAX": "1",
    "MALLOC_MMAP_MAX_": "0",
    "MALLOC_TRIM_THRESHOLD_": str(1 << 30),
}
_PRELOADED = ["pgcp.runtime.preload", "distributed", "pgcp.patches.preload"]


def collect_seldom() -> None:
    """Look for garbage in cycles seldom: libraries make a million objects that stay, and would be looked at again and again."""
    gc.set_threshold(50_000, 20, 50)


@contextmanager
def interrupts_for_this_process_only() -> Iterator[None]:
    """Processes started inside never see Ctrl-C, which a terminal sends to all; one that arrives meanwhile waits."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # its start would unblock the signal in the thread that starts processes
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def scratch() -> Path:
    """The folder of this process, made as needed, for what it and its workers keep on the disk beside the store.

    It is removed when the process ends in its own time; see ``leave_nothing`` for one that does not.
    """
    from multiprocessing import util

    return Path(util.get_temp_dir())


def leave_nothing() -> None:
    """Remove the folder that ``scratch`` has made, and semaphores, when all workers have ended."""
    if util := sys.modules.get("multiprocessing.util"):
        util._run_finalizers(0)  # those of semaphores; that of the folder has less priority and bears no file that comes late
    made = process.current_process()._config.get("tempdir")  # type: ignore[attr-defined]
    if made is not None:
        shutil.rmtree(made, ignore_errors=True)


def prepare_forks() -> None:
    """Start the process that workers will be forked from, unless it runs or there is none here; does not wait for it."""
    if not FORKS:
        return
    from multiprocessing import forkserver

    added = {name: value for name, value in WORKER_ENVIRONMENT.items() if name not in os.environ}
    os.environ.update(added)
    try:
        with interrupts_for_this_process_only():
            forkserver.set_forkserver_preload(_PRELOADED)
            forkserver.ensure_running()
    finally:
        for name in added:
            del os.environ[name]
