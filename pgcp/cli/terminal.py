"""Signals, printed lines, exit statuses."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any, NoReturn

from pgcp.errors import InputError
from pgcp.parallel import leave
from pgcp.runtime.compiled import drop_temporary_cache
from pgcp.runtime.forks import collect_seldom, leave_nothing

GOOD, BUG, BAD_INPUT, NUMERICAL, STOPPED = 0, 1, 2, 3, 4
COMMAND: ContextVar[str] = ContextVar("COMMAND", default="pgcp-run")  # what messages begin with

STOPPED_BY = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}  # exit status 128 + the signal's number


def have_streams() -> None:
    """Have standard streams that are closed lead nowhere; the next file that is opened would take their place."""
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        try:
            os.fstat(number)
        except OSError:
            handle = os.open(os.devnull, os.O_RDWR)
            if handle != number:
                os.dup2(handle, number)
                os.close(handle)
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115  # it stays open


def say(text: str) -> None:
    """Print; a reader that has left is no failure, a full disk is one."""
    try:
        print(text, flush=True)
    except OSError as problem:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(problem, BrokenPipeError):
            raise InputError(f"cannot print: {problem.strerror}") from problem


def complain(text: str) -> None:
    """Print a message on the standard error output, after the name of the command."""
    print(f"{COMMAND.get()}: {text}", file=sys.stderr)


class Signals(AbstractContextManager["Signals"]):
    """Signals that end a run are KeyboardInterrupts, so that everything is tidied; only the first counts."""

    def __init__(self) -> None:
        self._before: dict[int, Any] = {}
        self.name = "SIGINT"
        self.received = False

    def __enter__(self) -> Signals:
        if threading.current_thread() is threading.main_thread():
            numbers = [getattr(signal, name) for name in STOPPED_BY if hasattr(signal, name)]
            # one that is ignored, as under nohup, stays so
            self._before = {n: old for n in numbers if (old := signal.getsignal(n)) not in (signal.SIG_IGN, None)}
            self._set(self._stop)
        return self

    def __exit__(self, *_: object) -> None:
        for number, old in self._before.items():
            signal.signal(number, old)

    def _set(self, handler: Any) -> None:
        for number in self._before:
            signal.signal(number, handler)

    def _stop(self, number: int, _frame: object) -> None:
        self._set(signal.SIG_IGN)
        self.name, self.received = signal.Signals(number).name, True
        raise KeyboardInterrupt

    def listen(self) -> None:
        """Take them as at the beginning again, for further work after results were written."""
        if not self.received:
            self._set(self._stop)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Ignore them while results take the place of earlier ones; afterwards they end the process at once."""
        self._set(signal.SIG_IGN)
        yield
        self._set(self._end)

    @staticmethod
    def _end(number: int, _frame: object) -> None:
        """End the process as the signal does by itself, and leave nothing behind."""
        leave_nothing()
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)


def end_with(main: Callable[[], int]) -> NoReturn:
    """Run a command and end the process with its exit status."""
    have_streams()
    collect_seldom()
    status = main()
    with suppress(OSError):
        sys.stdout.flush()
        sys.stderr.flush()
    leave_nothing()
    drop_temporary_cache()
    leave(status)
    raise SystemExit(status)
