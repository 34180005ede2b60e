"""Compiled code of this machine: where it is kept, and compiling all of it at once on all processors.

numba compiles a function when it is first called with arguments of some types, and keeps the result in a cache. The file
``kernels.txt`` beside this one lists functions and types in the order in which runs come to need them; ``scripts/kernels.py``
writes it.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

from pgcp.errors import NumericalError

Progress = Callable[[str, int, int], None]

_LIST = Path(__file__).with_name("kernels.txt")
_CACHE = "NUMBA_CACHE_DIR"
_STAGE = "compile for this machine, once"
_PACKAGE = Path(__file__).resolve().parents[1]


class Kernel(NamedTuple):
    """A compiled function: usual runs that need it, its module, its name, the types of its arguments as numba writes them."""

    runs: str
    module: str
    function: str
    types: str


def kernels(run: str = "") -> list[Kernel]:
    """Compiled functions in the order in which runs need them: those of a usual run, named by its target, or all."""
    found = [Kernel(*line.split(" ", 3)) for line in _LIST.read_text().splitlines()]
    return [kernel for kernel in found if not run or run in kernel.runs.split(",")]


def compile_kernel(kernel: Kernel) -> None:
    """Compile one function, or load it where that has been done."""
    from numba.core import types

    function = getattr(importlib.import_module(kernel.module), kernel.function)
    function.compile(eval(kernel.types, {"__builtins__": {}}, vars(types)))


# Where compiled code is kept --------------------------------------------------------------------------------------------------


def _can_be_made(folder: Path) -> bool:
    """Make a folder where there is none; returns whether files can be made in it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK)


def _has_a_cache() -> bool:
    """Whether numba will find a folder for what it compiles: beside the package, or the user's."""
    if os.environ.get(_CACHE):
        return _can_be_made(Path(os.environ[_CACHE]))
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path(os.path.expanduser("~")) / ".cache")
    return _can_be_made(_PACKAGE / "__pycache__") or _can_be_made(user / "numba")


_TEMPORARY: list[tempfile.TemporaryDirectory[str]] = []


def find_cache() -> None:
    """Give numba a temporary folder where it would find none, and refuse to be imported; worker processes share it."""
    if not _has_a_cache():
        _TEMPORARY.append(tempfile.TemporaryDirectory(prefix="pgcp-compiled-", ignore_cleanup_errors=True))
        os.environ[_CACHE] = _TEMPORARY[0].name


def cache_is_temporary() -> bool:
    """Whether what is compiled is lost when this process ends."""
    return bool(_TEMPORARY)


def drop_temporary_cache() -> None:
    """Remove the temporary folder; a process that ends in the usual way does so by itself."""
    for folder in _TEMPORARY:
        folder.cleanup()


# Compiling --------------------------------------------------------------------------------------------------------------------


def _each_line(heard: Callable[[], None], process: subprocess.Popen[bytes]) -> None:
    for _ in process.stdout or ():
        heard()


class _Helpers:
    """Processes that compile functions of the list, the last first, and write a line as they have compiled one."""

    def __init__(self) -> None:
        self._processes: list[subprocess.Popen[bytes]] = []

    def start(self, run: str, count: int) -> None:
        """Share out the functions of a usual run, or of all, among so many processes."""
        for number in range(count):
            with suppress(OSError):
                words = [sys.executable, "-m", __name__, run, str(number), str(count)]
                self._processes.append(subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL))

    def wait(self, heard: Callable[[], None]) -> bool:
        """Wait for all, and call ``heard`` for each function; returns whether all have ended well."""
        with ThreadPoolExecutor(max(1, len(self._processes))) as pool:
            list(pool.map(partial(_each_line, heard), self._processes))
        return all(process.wait() == 0 for process in self._processes)

    def end(self) -> None:
        """End those that still run."""
        for process in self._processes:
            process.kill()
            process.wait()
            if process.stdout is not None:
                process.stdout.close()


@contextmanager
def compiled_together(run: str, helpers: int, progress: Progress) -> Iterator[None]:
    """Where something has to be compiled inside, let other processes compile meanwhile what this one will need later.

    run: the usual run that comes nearest, named by its target; helpers: how many processes. ``progress`` hears of it as of a
    stage. Costs nothing where all is compiled.
    """
    from numba.core import event

    depth, count, begun, others = 0, 0, False, _Helpers()

    class Listener(event.Listener):  # type: ignore[misc]
        """Counts what is compiled, but not what that needs."""

        def on_start(self, said: Any) -> None:
            """Start the helpers at the first."""
            nonlocal depth, begun
            depth += 1
            if not begun:
                begun = True
                progress(_STAGE, 0, 0)
                others.start(run, helpers)

        def on_end(self, said: Any) -> None:
            """Count."""
            nonlocal depth, count
            depth -= 1
            if depth == 0:
                count += 1

    listener = Listener()
    event.register("numba:compile", listener)
    try:
        yield
    finally:
        event.unregister("numba:compile", listener)
        others.end()
        if begun:
            progress(_STAGE, max(count, 1), max(count, 1))


def compile_all(processes: int, progress: Progress) -> None:
    """Compile all functions of the list; raises NumericalError where that fails."""
    count, total, lock = 0, len(kernels()), Lock()
    progress(_STAGE, 0, 0)

    def heard() -> None:
        """Count one more."""
        nonlocal count
        with lock:
            count += 1
            progress(_STAGE, count, total)

    helpers = _Helpers()
    try:
        helpers.start("", processes)
        whole = helpers.wait(heard)
    finally:
        helpers.end()
    if not whole or count < total:
        raise NumericalError(f"only {count} of {total} functions were compiled")


def main(words: Sequence[str]) -> None:
    """Compile every ``count``-th function of the list, the last first."""
    run, number, count = words[0], int(words[1]), int(words[2])
    for kernel in kernels(run)[::-1][number::count]:
        compile_kernel(kernel)
        sys.stdout.write(f"{kernel.function}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
