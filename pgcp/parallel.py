"""Compiled loops over long arrays on all processors of this process: in slices, whose results come back in order.

The slices depend on the length alone, so sums of their results have the same bits on any machine.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

Result = TypeVar("Result")
_SLICE = 1 << 18


def leave(status: int) -> None:
    """End this process without taking compiled code and libraries apart, which would be a third of a small run.

    Does nothing where a library has to: Intel's OpenMP keeps a file of shared memory.
    """
    if not any(Path("/dev/shm").glob(f"__KMP_REGISTERED_LIB_{os.getpid()}_*")):
        os._exit(status)


def processor_count() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_slices(function: Callable[[int, int], Result], length: int) -> list[Result]:
    """function(begin, end) for slices that make up ``length``; worth it where it lets other threads run meanwhile."""
    ends = [(begin, min(begin + _SLICE, length)) for begin in range(0, length, _SLICE)]
    if len(ends) < 2 or processor_count() < 2:
        return [function(*slice_) for slice_ in ends]
    with ThreadPoolExecutor(processor_count()) as pool:
        return list(pool.map(lambda slice_: function(*slice_), ends))


def at_once(*functions: Callable[[], Result]) -> list[Result]:
    """Call functions in threads of their own, and return what they return."""
    if processor_count() < 2:
        return [function() for function in functions]
    with ThreadPoolExecutor(len(functions)) as pool:
        return [future.result() for future in [pool.submit(function) for function in functions]]
