"""How many patches, and what each process may keep: from vertices, workers and memory.

Figures in bytes are those of runs of 1 to 25 million vertices: ``scripts/benchmark.py`` measures them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from pgcp.errors import InputError

DEFAULT_PATCHES = 6
_FEWEST_FACES = 100
_GOOD_VERTICES, _FEW_PATCHES = 120_000, 12  # larger patches take longer per vertex, which more seams soon make up for
_MOST_VERTICES = 200_000
_FEWEST_VERTICES = 20_000
_DRIVER = 300_000_000
_DRIVER_PER_VERTEX, _DRIVER_PER_VERTEX_CLOSED = 290, 420  # a sphere is corrected and turned as a whole
_PROCESS = 250_000_000
_WORK_PER_VERTEX = 2_000
_KEPT_BYTES = 1_500_000_000


@dataclass(frozen=True, slots=True)
class Plan:
    """Number of patches, and bytes of factors that one process may keep."""

    patches: int
    factor_cache_bytes: int


def least_need(vertex_count: int, face_count: int, patches: int, at_once: int) -> int:
    """Bytes that a mesh takes in the main process, so many patches at once, beside libraries and kept factors."""
    return _per_vertex(vertex_count, face_count) * vertex_count + at_once * _WORK_PER_VERTEX * vertex_count // patches


def _per_vertex(vertex_count: int, face_count: int) -> int:
    """Bytes that a vertex takes in the main process."""
    return _DRIVER_PER_VERTEX_CLOSED if face_count >= 2 * (vertex_count - 2) else _DRIVER_PER_VERTEX


def make_plan(
    vertex_count: int,
    face_count: int,
    workers: int,
    patches: int | None = None,
    fewest: int = 1,
    memory_limit_bytes: int | None = None,
    factor_cache_bytes: int | None = None,
) -> Plan:
    """Fill in the number of patches and the bytes of kept factors where they are None.

    The default is six patches. A mesh of fewer than 600 faces gets one for each 100 faces, a mesh of more than 720,000 vertices
    up to twelve of 120,000 vertices, and then as many as keep each below 200,000 vertices. More workers than patches, or a
    memory limit, raise the number: a process needs the memory of one patch at a time (without workers, patches are taken one
    after the other where there is a limit). The memory that is then left goes to factors kept between the passes.

    Raises InputError where the limit is too low for the mesh.
    """
    processes = max(1, workers)
    room: float = math.inf
    if memory_limit_bytes is not None:
        taken = _DRIVER + _per_vertex(vertex_count, face_count) * vertex_count + (processes * _PROCESS if workers else 0)
        room = (memory_limit_bytes - taken) / processes
    if patches is None:
        patches = max(fewest, min(DEFAULT_PATCHES, face_count // _FEWEST_FACES))
        patches = max(patches, min(_FEW_PATCHES, -(-vertex_count // _GOOD_VERTICES)), -(-vertex_count // _MOST_VERTICES))
        if vertex_count > processes * _FEWEST_VERTICES:
            patches = max(patches, processes)
        if room < math.inf:
            most = max(1.0, room / _WORK_PER_VERTEX)
            patches = max(patches, min(-(-vertex_count // _FEWEST_VERTICES), math.ceil(vertex_count / most)))
    work = _WORK_PER_VERTEX * vertex_count / patches
    if work > room:
        need = (memory_limit_bytes or 0) + processes * (work - room)
        raise InputError(
            f"{vertex_count} vertices in {patches} patches on {processes} processes need about {need / 1e9:.1f} GB, more than "
            f"the memory limit of {(memory_limit_bytes or 0) / 1e9:.1f} GB; allow more, or use fewer workers"
        )
    if factor_cache_bytes is None:
        factor_cache_bytes = int(min(_KEPT_BYTES, room - work))
    return Plan(patches, factor_cache_bytes)
