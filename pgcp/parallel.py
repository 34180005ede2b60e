"""Compiled loops over long arrays on the processors of this process: in slices, whose results come back in order.

The slices depend on the length alone, so sums of their results have the same bits on any machine.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

from threadpoolctl import ThreadpoolController

Result = TypeVar("Result")
_SLICE = 1 << 18
_STRIDE = 64  # parts begin at its multiples, so that loops that take several elements at once take the same ones
_LIBRARIES: dict[int, ThreadpoolController] = {}  # what was found when so many modules were loaded
_LIMIT: ContextVar[int | None] = ContextVar("limit", default=None)


def leave(status: int) -> None:
    """End this process without taking compiled code and libraries apart, which would be a third of a small run.

    Does nothing where a library has to: Intel's OpenMP keeps a file of shared memory.
    """
    if not any(Path("/dev/shm").glob(f"__KMP_REGISTERED_LIB_{os.getpid()}_*")):
        os._exit(status)


def processor_count() -> int:
    """Processors this process may use, here."""
    there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(there, _LIMIT.get() or there)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let BLAS use one thread inside, in all of this process.

    Looking for the libraries takes 3 ms, so it is done again only where modules were loaded since, or one was told of.
    """
    known = len(sys.modules)
    controller = _LIBRARIES.get(known)
    if controller is None:
        controller = ThreadpoolController()
        _LIBRARIES.clear()
        _LIBRARIES[known] = controller
    with controller.limit(limits=1):
        yield


def library_loaded() -> None:
    """Tell that a library with threads was loaded by other means than a module."""
    _LIBRARIES.clear()


@contextmanager
def limited_to(processors: int) -> Iterator[None]:
    """Use no more processors inside, whatever there are."""
    before = _LIMIT.set(processors)
    try:
        yield
    finally:
        _LIMIT.reset(before)


def at_once(*functions: Callable[[], Result]) -> list[Result]:
    """Call functions in as many threads as there are processors, and return what they return."""
    count = min(processor_count(), len(functions))
    if count < 2:
        return [function() for function in functions]
    with ThreadPoolExecutor(count) as pool:
        return [future.result() for future in [pool.submit(copy_context().run, function) for function in functions]]


@contextmanager
def beside(function: Callable[[], Result]) -> Iterator[Callable[[], Result]]:
    """Call a function in a thread of its own while the block runs; yields what waits for its result.

    Where there is one processor, it is called when its result is asked for.
    """
    if processor_count() < 2:
        yield function
        return
    with ThreadPoolExecutor(1) as pool:
        yield pool.submit(copy_context().run, function).result


def _of_ranges(function: Callable[[int, int], Result], ends: Sequence[int]) -> list[Result]:
    return at_once(*(partial(function, begin, end) for begin, end in pairwise(ends)))


def in_slices(function: Callable[[int, int], Result], length: int) -> list[Result]:
    """function(begin, end) for slices that make up ``length``; worth it where it lets other threads run meanwhile."""
    return _of_ranges(function, [*range(0, length, _SLICE), length])


def in_parts(function: Callable[[int, int], Result], length: int, least: int) -> list[Result]:
    """The same in as many parts as there are processors, each of ``least`` or more: for results that are independent."""
    count = max(1, min(processor_count(), length // max(least, _STRIDE)))
    return _of_ranges(function, [k * length // count // _STRIDE * _STRIDE for k in range(count)] + [length])
