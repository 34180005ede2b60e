"""Tasks of one patch or one union whose seams are solved exactly; arrays lie in the store."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pgcp.elimination.dirichlet import DirichletFactor
from pgcp.interface.merge import Merge, extend_inside, merge_operators, solve_inside
from pgcp.interface.puncture import Charts, alternated, opened_positions
from pgcp.patches.flatten import factor_patch, flatten_boundary
from pgcp.patches.solve import extend_patch
from pgcp.patches.tasks import keeps_factors
from pgcp.patches.types import Patch, SolveReport
from pgcp.runtime.cache import FACTORS
from pgcp.runtime.job import Job
from pgcp.runtime.made import digest_of, is_made, store_made
from pgcp.runtime.store import PatchStore
from pgcp.types import ComplexArray, FloatArray, IntArray, Positions


@dataclass(frozen=True, slots=True)
class Extended(SolveReport):
    """The same of values on seams, with a digest of them."""

    digest: str = ""


def eliminate_task(job: Job, item: tuple[int, IntArray]) -> None:
    """First pass with exact seams: eliminate all of a stored patch but some local vertices, and store their operator."""
    index, kept = item
    store, digest = PatchStore(job.directory), digest_of(kept)
    if is_made(store, "eliminated", index, digest, ["operator"]):
        return
    factor = factor_patch(store.read("patch", index, Patch), job.backend, kept, keeps_factors(job))
    store_made(store, "eliminated", index, digest, {"operator": factor.schur})
    FACTORS.put(job.key(index), factor, job.factor_cache_bytes)


def merge_task(job: Job, item: tuple[Merge, str]) -> None:
    """Join two stored operators into a third, and store what takes values inside, and a digest of what it was made from."""
    merge, digest = item
    store = PatchStore(job.directory)
    if is_merged(store, merge, digest, with_operator=True):
        return
    left, right = (store.read_array("operator", index) for index in (merge.left, merge.right))
    schur, inside, factor = merge_operators(left, right, merge)
    store_made(store, "merged", merge.result, digest, {"inside": inside, "pivot": factor, "operator": schur})


def is_merged(store: PatchStore, merge: Merge, digest: str, with_operator: bool) -> bool:
    """Whether a union that was made from this is in the store: what takes values inside, and its operator where asked for."""
    return is_made(store, "merged", merge.result, digest, ["inside", "pivot", "operator"][: 3 if with_operator else 2])


def extend_inside_task(job: Job, item: tuple[int, Positions]) -> Positions:
    """Values on the seams inside a stored union, from those around it."""
    index, values = item
    return extend_inside(PatchStore(job.directory).read_array("inside", index), values)


def reduce_inside_task(job: Job, item: tuple[int, ComplexArray]) -> ComplexArray:
    """Load on what is kept of a stored union that does what a load on the eliminated vertices does."""
    index, load = item
    inside = PatchStore(job.directory).read_array("inside", index)
    return np.asarray(inside.T @ load.real + 1j * (inside.T @ load.imag), np.complex128)


def solve_inside_task(job: Job, item: tuple[int, ComplexArray, ComplexArray]) -> ComplexArray:
    """Values on the seams inside a stored union, from those around it and the load there."""
    index, values, load = item
    store = PatchStore(job.directory)
    inside: ComplexArray = extend_inside(store.read_array("inside", index), values)
    return inside + solve_inside(store.read_array("pivot", index), load)


def _with_factor(job: Job, index: int, kept: IntArray, use: Callable[[DirichletFactor], ComplexArray]) -> ComplexArray:
    """Use a stored patch's factor, from where it is held here or made anew, and keep it."""
    factor = FACTORS.take(job.key(index))
    if factor is None:
        factor = factor_patch(PatchStore(job.directory).read("patch", index, Patch), job.backend, kept)
    out = use(factor)
    FACTORS.put(job.key(index), factor, job.factor_cache_bytes)
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Load:
    """A load (size,) that is the same nearly everywhere, short enough to be sent: other values at some ids."""

    size: int
    everywhere: complex
    ids: IntArray
    values: ComplexArray

    def unpacked(self) -> ComplexArray:
        """All of it."""
        out = np.full(self.size, self.everywhere, np.complex128)
        out[self.ids] = self.values
        return out


def pack_load(load: ComplexArray) -> Load:
    """Shorten a load (n,) whose middle value is the most frequent one."""
    common = complex(np.median(load.real), np.median(load.imag))
    ids = np.flatnonzero(load != common)
    return Load(len(load), common, ids, load[ids])


def reduce_task(job: Job, item: tuple[int, IntArray, Load]) -> ComplexArray:
    """Load on a stored patch's kept vertices (n_K,) that does what a load in its interior does."""
    index, kept, load = item
    return _with_factor(job, index, kept, lambda factor: factor.reduce(load.unpacked()))


def solve_load_task(job: Job, item: tuple[int, IntArray, Load, ComplexArray]) -> None:
    """Values of a stored patch with a load in its interior and values (n_K,) on kept vertices; they go to the store."""
    index, kept, load, values = item
    solved = _with_factor(job, index, kept, lambda factor: factor.solve(load.unpacked(), values))
    PatchStore(job.directory).write_array("values", index, solved)


def flatten_whole_task(job: Job, item: tuple[int, FloatArray]) -> ComplexArray:
    """Free boundary of the whole mesh by the stored operator on it; positions (n_B, 3) on the surface."""
    index, positions = item
    return flatten_boundary(np.array(PatchStore(job.directory).read_array("operator", index)), positions, job.flattener)


def flatten_opened_task(job: Job, index: int) -> ComplexArray:
    """Positions of an opened surface's kept vertices by the stored operator on them."""
    return opened_positions(np.array(PatchStore(job.directory).read_array("operator", index)))


def alternate_task(job: Job, item: tuple[int, Charts]) -> Charts:
    """Positions of an opened surface's kept vertices in two charts, by the stored operator on them."""
    index, charts = item
    return alternated(charts, np.array(PatchStore(job.directory).read_array("operator", index)))


def extend_task(job: Job, item: tuple[int, IntArray, ComplexArray]) -> SolveReport:
    """Second pass with exact seams: extend values on a stored patch's kept vertices, and keep the factor for more."""
    index, kept, values = item
    store, digest = PatchStore(job.directory), digest_of(kept, values)
    done = store.find("extended", index, Extended)
    if done is not None and done.digest == digest and store.has("map", index):
        return done
    patch = store.read("patch", index, Patch)
    factor = FACTORS.take(job.key(index))
    reused = factor is not None
    if factor is None:
        factor = factor_patch(patch, job.backend, kept)
    solved = extend_patch(patch, kept, values, factor)
    FACTORS.put(job.key(index), factor, job.factor_cache_bytes)
    store.drop("extended", index)
    store.write("map", index, solved)
    report = Extended(index, solved.fold_count, solved.first_fold_count, 0, solved.mu_max, reused, digest)
    store.write("extended", index, report)
    return report


def release_task(job: Job, index: int) -> None:
    """Free a patch's factor, where it is held here."""
    factor = FACTORS.take(job.key(index))
    if factor is not None:
        factor.release()
