"""The directory of one run, which a later run can take up."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

from pgcp.io.files import PART, abandoned, lock_soon

_SCRATCH = "pgcp-"
_LOCK = ".lock"
_TRIES, _PAUSE_S = 5, 0.05
_RESUMABLE_S = 7 * 24 * 3600


class RunDirectory:
    """The directory of one run. ``keep`` it for the run to be resumed, or it is removed at the end."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.keep = False


def store_parent(store: Path | None) -> Path:
    """The folder that stores of runs lie in, as workers, which have working directories of their own, find it."""
    return (Path(tempfile.gettempdir()) if store is None else store).absolute()


@contextlib.contextmanager
def run_directory(parent: Path | None, key: str, resume: bool = False) -> Iterator[RunDirectory]:
    """Make a directory for a run, named by its key, in ``parent`` or where temporary files go.

    One of that name which nobody uses is what an earlier run of the same key left: with ``resume`` it is taken up, else
    emptied. Where another run uses it, the name gets an ending. Those of killed runs are removed after a week.
    """
    parent = store_parent(parent)
    _remove_abandoned(parent)
    path, ending = parent / f"{_SCRATCH}{key}", 0
    while True:
        handle = _claimed(path)
        if handle is not None:
            break
        ending += 1
        path = parent / f"{_SCRATCH}{key}-{ending}"
    directory = RunDirectory(path)
    try:
        if not resume:
            _empty(path)
        for stale in path.rglob(f".*{PART}"):
            stale.unlink(missing_ok=True)
        yield directory
    finally:
        if not directory.keep:
            _remove(path)
        os.close(handle)


def _claimed(path: Path) -> int | None:
    """Make a directory, or take it over from a run that is dead: the open lock; None where it is in use or not one's own."""
    with contextlib.suppress(FileExistsError):
        path.mkdir(mode=0o700)
    try:
        if not path.is_dir() or path.is_symlink() or (hasattr(os, "getuid") and path.stat().st_uid != os.getuid()):
            return None
        handle = os.open(path / _LOCK, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)
    except FileNotFoundError:  # removed just now
        return None
    if lock_soon(handle) is False:
        os.close(handle)
        return None
    return handle


def _empty(path: Path) -> None:
    for entry in path.iterdir():
        if entry.is_dir():
            shutil.rmtree(entry, ignore_errors=True)
        elif entry.name != _LOCK:
            entry.unlink(missing_ok=True)


def _remove(path: Path) -> None:
    """Remove a directory that is claimed: it gets another name first, so that neither a late task nor another run is in it."""
    gone = path.with_name(f"{_SCRATCH}{uuid.uuid4().hex}")
    with contextlib.suppress(OSError):
        path.rename(gone)
        for _ in range(_TRIES):
            shutil.rmtree(gone, ignore_errors=True)
            if not gone.exists():
                return
            time.sleep(_PAUSE_S)  # a task was just writing


def _remove_abandoned(parent: Path) -> None:
    for directory in parent.glob(f"{_SCRATCH}*"):
        with contextlib.suppress(OSError), abandoned(directory / _LOCK) as dead:
            state = directory.stat()
            if dead and state.st_uid == os.getuid() and time.time() - state.st_mtime > _RESUMABLE_S:
                _remove(directory)
