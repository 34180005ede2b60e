"""Files appear whole or not at all, several of them together; what a killed run left is cleaned away by the next."""

from __future__ import annotations

import contextlib
import errno
import os
import time
import uuid
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import IO

from pgcp.errors import InputError

try:
    import fcntl
except ImportError:  # no locks: nothing is known of what others still write, so nothing is cleaned away
    fcntl = None  # type: ignore[assignment]

PART = ".part"
_TRIES, _PAUSE_S = 20, 0.025  # until a lock is believed to be another run's


def lock(handle: int) -> bool | None:
    """Mark a file as being written, until it is closed; False where another has it or it is gone, None without locks."""
    if fcntl is None:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as problem:
        return False if problem.errno in (errno.EWOULDBLOCK, errno.EACCES) else None
    return os.fstat(handle).st_nlink > 0


def lock_soon(handle: int) -> bool | None:
    """Lock a file, or a directory, as ``lock`` does; what is only looked at, or inherited by a new process, is waited for.

    A process that is being started has the open files and locks of the one that starts it, until it runs its own program.
    """
    for _ in range(_TRIES):
        locked = lock(handle)
        if locked is not False or os.fstat(handle).st_nlink == 0:
            return locked
        time.sleep(_PAUSE_S)
    return False


@contextlib.contextmanager
def abandoned(path: Path) -> Iterator[bool]:
    """Whether the writer of a file is dead, kept from starting to write it again inside."""
    try:
        handle = os.open(path, os.O_RDWR | os.O_NOFOLLOW) if fcntl is not None else -1
    except OSError:
        handle = -1
    if handle < 0:
        yield False
        return
    try:
        yield lock(handle) is True
    finally:
        os.close(handle)


@contextlib.contextmanager
def claimed(directory: Path) -> Iterator[None]:
    """Keep other runs out of a directory, made as needed, inside; what was made goes again where nothing was put there.

    The lock is on the directory itself and ends with the process. Raises InputError where another run has it, or where it
    cannot be made.
    """
    made = [folder for folder in (directory, *directory.parents) if not folder.exists()]
    try:
        handle = _locked(directory)
        try:
            yield
        finally:
            if handle >= 0:
                os.close(handle)
    finally:
        for folder in made:
            with contextlib.suppress(OSError):  # it holds results
                folder.rmdir()


def _locked(directory: Path) -> int:
    """The open lock of a directory, made as needed; -1 where there are no locks."""
    while True:
        try:
            directory.mkdir(parents=True, exist_ok=True)
            handle = os.open(directory, os.O_RDONLY)
        except FileNotFoundError:  # removed just now
            continue
        except OSError as problem:
            if directory.is_dir():  # a system that opens none, or one that may be written, not read
                return -1
            raise InputError(f"{directory}: cannot write the results: {problem.strerror}") from problem
        if lock_soon(handle) is not False:
            return handle
        is_gone = os.fstat(handle).st_nlink == 0
        os.close(handle)
        if not is_gone:
            raise InputError(f"{directory}: another run writes its results here; wait for it, or choose another folder")


class _Part(AbstractContextManager["_Part"]):
    """A file that is written under a temporary name beside its own and renamed to it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        while True:
            self._name = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}{PART}")
            self.stream: IO[bytes] = self._name.open("xb")
            if lock(self.stream.fileno()) is not False:
                return
            self.stream.close()  # another run took it for abandoned before it was locked

    def rename(self) -> None:
        """Give it its own name; the lock is held meanwhile where there are locks."""
        self.stream.flush()
        if fcntl is None:
            self.stream.close()
        os.replace(self._name, self.path)

    def __exit__(self, _kind: object, problem: object, _traceback: object) -> None:
        if isinstance(problem, OSError) and problem.filename is None:
            problem.filename = str(self.path)  # writing to a stream does not say to which
        with contextlib.suppress(OSError):  # what could not be written is not wanted
            self.stream.close()
        self._name.unlink(missing_ok=True)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[IO[bytes]]:
    """Open a file to be written under a temporary name beside ``path`` and renamed to it when it is whole."""
    with _Part(path) as part:
        yield part.stream
        part.rename()


class FileSet:
    """Files of one directory that are written under temporary names and renamed together."""

    def __init__(self, directory: Path, stack: contextlib.ExitStack) -> None:
        self._directory, self._stack = directory, stack
        self._parts: list[_Part] = []
        self._unwanted: list[Path] = []

    def without(self, names: Iterable[str]) -> None:
        """Files of earlier sets that this one has not: they go when it is switched to."""
        self._unwanted += [self._directory / name for name in names]

    def open(self, name: str) -> IO[bytes]:
        """Open the next file of the set."""
        path = self._directory / name
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "there is a directory of this name", str(path))
        part = self._stack.enter_context(_Part(path))
        self._parts.append(part)
        return part.stream

    def sync(self) -> None:
        """Have all that was written on the disk: afterwards the switch takes no room and next to no time."""
        for part in self._parts:
            try:
                part.stream.flush()
                os.fsync(part.stream.fileno())
            except OSError as problem:
                problem.filename = str(part.path)
                raise

    def switch(self) -> list[Path]:
        """Rename all files in the order they were opened; returns their paths."""
        for path in self._unwanted:
            if path.is_file():
                path.unlink()
        for part in self._parts:
            part.rename()
        return [part.path for part in self._parts]


@contextlib.contextmanager
def replacing_together(directory: Path) -> Iterator[FileSet]:
    """Write several files of a directory, made as needed; on any failure before the switch all is as it was.

    Temporary files of the same directory whose writers were killed are removed first.
    """
    made = [folder for folder in (directory, *directory.parents) if not folder.exists()]
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for stale in directory.glob(f".*{PART}"):
            with abandoned(stale) as dead:
                if dead:
                    stale.unlink(missing_ok=True)
        with contextlib.ExitStack() as stack:
            yield FileSet(directory, stack)
    finally:
        for folder in made:
            with contextlib.suppress(OSError):  # it is not empty: it holds the results
                folder.rmdir()
