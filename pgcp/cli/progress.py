"""What is shown while a run goes on: bars on a terminal, else a line for what lasts, or nothing; and the log file."""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, TextIO

from pgcp.errors import InputError

_SOON, _AGAIN, _LOOK = 0.5, 10.0, 0.1  # seconds until a stage is named, until it is named again, between two looks


class Silent(AbstractContextManager["Silent"]):
    """Shows nothing."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show nothing."""

    def __exit__(self, *_: object) -> None:
        """Nothing to end."""


class Bars(Silent):
    """A bar a stage; one whose tasks are not counted moves to and fro until it ends."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        columns = (TextColumn("{task.description:<14}"), BarColumn(), TextColumn("{task.fields[count]}"), TimeElapsedColumn())
        self._bars = Progress(*columns, console=Console(stderr=True))
        self._tasks: dict[str, Any] = {}

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show so much progress of a stage."""
        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(stage, total=None, count="")
        count = f"{done}/{total}" if total > 1 else ""
        self._bars.update(self._tasks[stage], completed=done, total=total or None, count=count)

    def __enter__(self) -> Bars:
        self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.stop()


class Lines(Silent):
    """A line when a stage has lasted half a second, and one every ten seconds after."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._begun = self._since = time.monotonic()
        self._due = _SOON
        self._stage, self._done, self._total = "", 0, 0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Remember what is being done."""
        if stage != self._stage or total == 0:
            self._since, self._due = time.monotonic(), _SOON
        self._stage, self._done, self._total = stage, done, total

    def _watch(self) -> None:
        while not self._over.wait(_LOOK):
            now = time.monotonic()
            ended = 0 < self._total == self._done
            if self._stage and not ended and now - self._since >= self._due:
                self._due = now - self._since + _AGAIN
                count = f", {self._done} of {self._total}" if self._total > 1 else ""
                try:
                    print(f"{now - self._begun:7.1f} s: {self._stage}{count}", file=self._stream, flush=True)
                except (OSError, ValueError):  # nobody reads them
                    return

    def __enter__(self) -> Lines:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()


def display(quiet: bool) -> Silent:
    """What suits the standard error output."""
    if quiet or sys.stderr is None:
        return Silent()
    return Bars() if sys.stderr.isatty() else Lines(sys.stderr)


@contextmanager
def logged(path: Path | None) -> Iterator[None]:
    """Append what the logger ``pgcp`` hears to a file; raises InputError where it cannot be written."""
    if path is None:
        yield
        return
    try:
        handler = logging.FileHandler(path, encoding="utf-8")
    except OSError as problem:
        raise InputError(f"{path}: cannot write the log: {problem.strerror}") from problem
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    logger = logging.getLogger("pgcp")
    before = logger.level
    logger.setLevel(logging.INFO)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
        handler.close()
