"""Why a run ended: one sentence, and the exit status."""

from __future__ import annotations

import argparse
import errno
import json
import signal
from collections.abc import Callable, Sequence

from pgcp.cli.terminal import BAD_INPUT, BUG, GOOD, NUMERICAL, STOPPED, STOPPED_BY, Signals, complain, say
from pgcp.errors import InputError, NumericalError, PgcpError, SolveFailedError, StoppedError
from pgcp.runtime.address_space import NEEDS_MEMORY

_STATUS = {InputError: BAD_INPUT, NumericalError: NUMERICAL, StoppedError: STOPPED}
_SYSTEM = {
    getattr(errno, name) for name in ("ENOSPC", "EFBIG", "EDQUOT", "EROFS", "EACCES", "EPERM", "EIO") if hasattr(errno, name)
}


def refused(problem: Exception, status: int, as_json: bool) -> int:
    """Say what a problem is; returns the exit status."""
    if as_json:
        say(json.dumps({"status": status, "error": type(problem).__name__, "message": str(problem)}))
    complain(str(problem))
    return status


def of_system(problem: OSError) -> str:
    """What the system says, and of which file."""
    return f"{problem.filename}: {problem.strerror}" if problem.filename else str(problem)


def stopped(signals: Signals, as_json: bool, resume: bool, done: str = "nothing was written") -> int:
    """Say that a signal ended the run; returns the exit status."""
    status: int = 128 + getattr(signal, signals.name)
    message = f"{STOPPED_BY[signals.name]}; {done}"
    if resume:
        message += "; what is finished is kept for --resume"
    if as_json:
        say(json.dumps({"status": status, "error": "KeyboardInterrupt", "message": message}))
    complain(message)
    return status


def told_as(problem: Exception) -> tuple[Exception, int]:
    """A problem as it is told to the user, and its exit status."""
    for kind, status in _STATUS.items():
        if isinstance(problem, kind):
            return problem, status
    if isinstance(problem, MemoryError) or (isinstance(problem, OSError) and problem.errno == errno.ENOMEM):
        return SolveFailedError(f"memory ran out ({problem}); {NEEDS_MEMORY}"), NUMERICAL
    if isinstance(problem, OSError) and problem.errno in _SYSTEM:
        return InputError(of_system(problem)), BAD_INPUT
    return problem, BUG


def failed(problem: Exception, arguments: argparse.Namespace, signals: Signals) -> int:
    """Say why a run ended; returns the exit status."""
    told, status = told_as(problem)
    if signals.received and status in (NUMERICAL, BUG):  # compiled code makes another exception of the interrupt
        return stopped(signals, arguments.json, arguments.resume)
    if status != BUG:
        return refused(told, status, arguments.json)
    if arguments.json:
        say(json.dumps({"status": BUG, "error": type(problem).__name__, "message": str(problem)}))
    complain(of_a_bug(problem))
    return BUG


def of_a_bug(problem: Exception) -> str:
    """What is said of an exception that no mistake of a user explains."""
    return f"a bug: {type(problem).__name__}: {problem} (--debug shows where)"


def answered(
    words: Sequence[str],
    asked: Callable[[Sequence[str]], argparse.Namespace | None],
    work: Callable[[argparse.Namespace, Signals], int],
) -> int:
    """Do what a command line asks for; whatever goes wrong is said in one sentence. Returns the exit status.

    asked(words): what is asked for, None where nothing is left to do; work(arguments, signals): does it.
    """
    try:
        arguments = asked(words)
    except PgcpError as problem:
        return refused(problem, BAD_INPUT if isinstance(problem, InputError) else NUMERICAL, "--json" in words)
    if arguments is None:
        return GOOD
    with Signals() as signals:
        try:
            return work(arguments, signals)
        except KeyboardInterrupt:
            return stopped(signals, arguments.json, arguments.resume)
        except Exception as problem:
            if arguments.debug and not signals.received:
                raise
            return failed(problem, arguments, signals)
