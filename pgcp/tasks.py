"""What runs for one patch, on whatever worker: the stages composed; paths and boundary curves in and out.

What takes time leaves a record in the store: where it is there already, the task was finished by a worker that was lost before
it could say so, or by a run that this one goes on with.
"""

from __future__ import annotations

import hashlib
import threading
import zlib
from collections import OrderedDict, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pgcp.curves import crosses_itself
from pgcp.dirichlet import DirichletFactor, DirichletSolver, eliminate_mesh, harmonic_solver
from pgcp.errors import LostFileError, WeldFailedError
from pgcp.flatten import flatten_boundary
from pgcp.interface import Merge, extend_inside, merge_operators, solve_inside
from pgcp.puncture import Charts, alternated, opened_positions
from pgcp.solve import extend_patch, solve_patch
from pgcp.split import cut_patch, cut_patches, plan_welds, split_mesh
from pgcp.store import PatchStore
from pgcp.topology import examine
from pgcp.types import BoundaryCurve, ComplexArray, Component, FloatArray, IntArray, Mesh, Patch, Positions
from pgcp.weld import relax_boundary, run_welds, start_component, subdivide, weld_closed, weld_pair

_RUNS = 100  # that are over, and that tasks may still work for


class FactorCache:
    """Factors kept between the passes, bounded in bytes. One per process."""

    def __init__(self) -> None:
        self._held: OrderedDict[tuple[str, int], DirichletSolver] = OrderedDict()
        self._over: deque[str] = deque(maxlen=_RUNS)
        self._lock = threading.Lock()

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return sum(factor.nbytes for factor in self._held.values())

    def put(self, key: tuple[str, int], factor: DirichletSolver, limit_bytes: int) -> bool:
        """Keep a factor where there is room for it beside those of its run; those of other runs give way, oldest first.

        Returns whether it is kept.
        """
        with self._lock:
            before = self._held.pop(key, None)
            if before is not None and before is not factor:
                before.release()
            is_over = any(key[0].startswith(run) for run in self._over)
            if is_over or not getattr(factor, "is_whole", True) or factor.nbytes > self._room(key[0], limit_bytes):
                factor.release()
                return False
            self._held[key] = factor
            for other in [other for other in self._held if other[0] != key[0]]:
                if self.nbytes > limit_bytes:
                    self._held.pop(other).release()
            return True

    def _room(self, run: str, limit_bytes: int) -> int:
        return limit_bytes - sum(factor.nbytes for key, factor in self._held.items() if key[0] == run)

    def has_room(self, run: str, limit_bytes: int, nbytes: int) -> bool:
        """Whether a factor of so many bytes would be kept."""
        with self._lock:
            return nbytes <= self._room(run, limit_bytes)

    def holds(self, key: tuple[str, int]) -> bool:
        """Whether a factor is held."""
        with self._lock:
            return key in self._held

    def take(self, key: tuple[str, int]) -> Any:
        """Remove and return a factor, or None where it is not held."""
        with self._lock:
            return self._held.pop(key, None)

    def drop(self, run: str) -> None:
        """Free all factors of runs whose name begins so, now and of what still works for them."""
        with self._lock:
            self._over.append(run)
            for key in [key for key in self._held if key[0].startswith(run)]:
                self._held.pop(key).release()


_FACTORS = FactorCache()


def warm_up() -> None:
    """Load what tasks will need, by flattening, welding and solving next to nothing."""
    side = np.arange(7)
    x, y = (k.reshape(-1) for k in np.meshgrid(side, side, indexing="ij"))
    a = (7 * x + y)[(x < 6) & (y < 6)]
    faces = np.concatenate([np.column_stack([a, a + 7, a + 8]), np.column_stack([a, a + 8, a + 1])])
    mesh = Mesh(np.column_stack([x, y, 0.3 * np.sin(x) * y]), faces)
    topology = examine(mesh.faces, len(mesh.vertices))
    split = split_mesh(mesh, topology, 2)
    halves = {}
    for patch in cut_patches(mesh, topology, split):
        factor = factor_patch(patch, "nested")
        curve = flatten_simply(patch, factor, "dncp", "nested")
        halves[patch.index] = start_component(curve, mesh.vertices, split.edges)
        solve_patch(patch, curve.z[np.cumsum(patch.parts) - patch.parts], factor, "nested")
    run_welds(halves, plan_welds(split.table, 2).steps)


def drop_run(run: str) -> None:
    """Free what this process still holds of a run."""
    _FACTORS.drop(run)


@dataclass(frozen=True, slots=True)
class Job:
    """What every task of a run needs: the store, a run id, how to flatten, and whether to store the patches' operators."""

    run: str
    directory: Path
    method: str
    backend: str
    factor_cache_bytes: int
    stores_operators: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class FaceOrder:
    """A patch's faces (Fp,) as the first pass has dissected them."""

    order: IntArray


@dataclass(frozen=True, slots=True)
class SolveReport:
    """What the second pass says of a patch; its arrays are in the store. reused_factor: that of the first pass."""

    patch: int
    fold_count: int
    first_fold_count: int
    raised_weights: int
    mu_max: float
    reused_factor: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """Of arrays in the store: a digest of what they were made from, and a checksum of each."""

    digest: str
    sums: IntArray


@dataclass(frozen=True, slots=True)
class Extended(SolveReport):
    """The same of values on seams, with a digest of them."""

    digest: str = ""


def digest_of(*parts: Any) -> str:
    """A digest of arrays and texts."""
    digest = hashlib.blake2b(digest_size=16)
    for part in parts:
        array = np.ascontiguousarray(part)
        digest.update(f"{array.dtype} {array.shape} ".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _sum_of(array: np.ndarray) -> int:
    return zlib.crc32(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)


def _store_made(store: PatchStore, kind: str, index: int, digest: str, arrays: dict[str, np.ndarray]) -> None:
    """Store arrays, and last what says that all are there."""
    store.drop(kind, index)
    for name, array in arrays.items():
        store.write_array(name, index, array)
    store.write(kind, index, Made(digest, np.array([_sum_of(array) for array in arrays.values()])))


def is_made(store: PatchStore, kind: str, index: int, digest: str, names: Sequence[str]) -> bool:
    """Whether the first arrays of a kind, those of these names, are in the store whole, and were made from this."""
    made = store.find(kind, index, Made)
    if made is None or made.digest != digest:
        return False
    try:
        return all(_sum_of(store.read_array(name, index)) == total for name, total in zip(names, made.sums, strict=False))
    except LostFileError:
        return False


def factor_patch(
    patch: Patch, backend: str, kept: IntArray | None = None, keeps: Callable[[int], bool] | None = None
) -> DirichletFactor:
    """Eliminate a patch's interior, or all but the local vertices ``kept``; the factor itself only where that is kept."""
    kept = patch.boundary if kept is None else kept
    return eliminate_mesh(patch.vertices, patch.faces, kept, backend, patch.mollification, keeps)


def _never(_nbytes: int) -> bool:
    return False


def _keeps(job: Job) -> Callable[[int], bool]:
    """Whether this process would keep a factor of so many bytes for the second pass."""
    return partial(_FACTORS.has_room, job.run, job.factor_cache_bytes)


def flatten_simply(patch: Patch, factor: DirichletFactor, method: str, backend: str) -> BoundaryCurve:
    """Flatten one patch to a boundary curve that does not cross itself, subdivided.

    Where the free boundary overlaps itself, two halves of the patch are flattened and welded: the weld of two simple
    curves is simple. A half that crosses itself is halved again.
    """
    z = flatten_boundary(factor.schur, patch.vertices[patch.boundary], method)
    ids = patch.vertex_ids[patch.boundary]
    if not crosses_itself(z):
        return BoundaryCurve(patch.index, ids, subdivide(z, patch.parts))
    if len(patch.faces) < 2:
        raise WeldFailedError(f"the free boundary of patch {patch.index} crosses itself in a single face")
    mesh = Mesh(patch.vertices, patch.faces, f"patch {patch.index}")
    topology = examine(mesh.faces, len(mesh.vertices))
    split = split_mesh(mesh, topology, 2, mollification=patch.mollification)
    parts = split.edges.parts.copy()
    parts[split.edges.rank(patch.boundary, np.roll(patch.boundary, -1))] = patch.parts
    split = replace(split, edges=replace(split.edges, parts=parts))
    halves, pieces = {}, 0
    for index in range(2):
        half = cut_patch(mesh, topology, split, index)
        half_factor = factor_patch(half, backend)
        curve = flatten_simply(half, half_factor, method, backend)
        half_factor.release()
        halves[index] = start_component(curve, mesh.vertices, split.edges)
        pieces += curve.pieces
    union = run_welds(halves, plan_welds(split.table, 2).steps)
    start = int(np.flatnonzero(union.nodes[union.loop] == patch.boundary[0])[0])
    return BoundaryCurve(patch.index, ids, union.z[np.roll(union.loop, -start)], pieces)


def flatten_task(job: Job, index: int) -> BoundaryCurve:
    """First pass: flatten a stored patch, store and send its boundary curve.

    The factor is kept only where seams are solved as well: to solve anew for known boundary values takes little more time
    than to write a factor to memory that was not in use before, and none of the memory.
    """
    store = PatchStore(job.directory)
    done = None if job.stores_operators else store.find("curve", index, BoundaryCurve)  # to keep the factor as well
    if done is not None:
        return done
    patch = store.read_patch(index)
    factor = factor_patch(patch, job.backend, keeps=_keeps(job) if job.stores_operators else _never)
    curve = flatten_simply(patch, factor, job.method, job.backend)
    if job.stores_operators:
        store.write_array("operator", index, factor.schur)
    order = getattr(factor, "order", None)
    if order is not None:
        store.write("order", index, FaceOrder(order))
    store.write("curve", index, curve)
    if job.stores_operators:
        _FACTORS.put((job.run, index), factor, job.factor_cache_bytes)
    return curve


def relax_task(component: Component) -> Component:
    """Give a single patch its natural boundary."""
    return relax_boundary(component)


def weld_task(job: Job, kind: str, index: int, closed: bool, pair: tuple[Component, Component]) -> Component:
    """Weld two components, the last two of a closed surface along their whole boundaries; store and send the union."""
    store = PatchStore(job.directory)
    union = store.find(kind, index, Component)
    if union is None:
        union = (weld_closed if closed else weld_pair)(*pair)
        store.write(kind, index, union)
    return union


def _solver(job: Job, store: PatchStore, patch: Patch) -> DirichletSolver:
    """What solves a patch for values on its boundary."""
    found = store.find("order", patch.index, FaceOrder)  # else it is found anew
    order = None if found is None else found.order
    return harmonic_solver(patch.vertices, patch.faces, patch.boundary, job.backend, patch.mollification, order)


def _prepared(job: Job, index: int) -> tuple[str, int]:
    """Key of what has been prepared for a patch: a solver of its own, which is no factor for anything else."""
    return f"{job.run}-prepared", index


def prepare_task(job: Job, index: int) -> bool:
    """Do of the second pass for a stored patch what needs no values, and keep it for that; returns whether it is kept."""
    store, key = PatchStore(job.directory), _prepared(job, index)
    return _FACTORS.holds(key) or _FACTORS.put(key, _solver(job, store, store.read_patch(index)), job.factor_cache_bytes)


def solve_task(job: Job, name: str, item: tuple[int, Positions]) -> SolveReport:
    """Second pass: solve a stored patch with its welded boundary; store map and report.

    The boundary is complex (n_B,) in the plane, or unit vectors (n_B, 3).
    """
    index, boundary = item
    store = PatchStore(job.directory)
    done = store.find(f"solved{name}", index, SolveReport)
    if done is not None:
        return done
    patch = store.read_patch(index)
    solver = _FACTORS.take(_prepared(job, index)) or _solver(job, store, patch)
    solved = solve_patch(patch, boundary, solver, job.backend)
    solver.release()
    store.write_map(solved, name)
    report = SolveReport(index, solved.fold_count, solved.first_fold_count, solved.raised_weights, solved.mu_max)
    store.write(f"solved{name}", index, report)
    return report


def eliminate_task(job: Job, item: tuple[int, IntArray]) -> None:
    """First pass with exact seams: eliminate all of a stored patch but some local vertices, and store their operator."""
    index, kept = item
    store, digest = PatchStore(job.directory), digest_of(kept)
    if is_made(store, "eliminated", index, digest, ["operator"]):
        return
    factor = factor_patch(store.read_patch(index), job.backend, kept, _keeps(job))
    _store_made(store, "eliminated", index, digest, {"operator": factor.schur})
    _FACTORS.put((job.run, index), factor, job.factor_cache_bytes)


def merge_task(job: Job, item: tuple[Merge, str]) -> None:
    """Join two stored operators into a third, and store what takes values inside, and a digest of what it was made from."""
    merge, digest = item
    store = PatchStore(job.directory)
    if is_merged(store, merge, digest, with_operator=True):
        return
    left, right = (store.read_array("operator", index) for index in (merge.left, merge.right))
    schur, inside, factor = merge_operators(left, right, merge)
    _store_made(store, "merged", merge.result, digest, {"inside": inside, "pivot": factor, "operator": schur})


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
    factor = _FACTORS.take((job.run, index))
    if factor is None:
        factor = factor_patch(PatchStore(job.directory).read_patch(index), job.backend, kept)
    out = use(factor)
    _FACTORS.put((job.run, index), factor, job.factor_cache_bytes)
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
    return flatten_boundary(np.array(PatchStore(job.directory).read_array("operator", index)), positions, job.method)


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
    patch = store.read_patch(index)
    factor = _FACTORS.take((job.run, index))
    reused = factor is not None
    if factor is None:
        factor = factor_patch(patch, job.backend, kept)
    solved = extend_patch(patch, kept, values, factor)
    _FACTORS.put((job.run, index), factor, job.factor_cache_bytes)
    store.drop("extended", index)
    store.write_map(solved)
    report = Extended(index, solved.fold_count, solved.first_fold_count, 0, solved.mu_max, reused, digest)
    store.write("extended", index, report)
    return report


def release_task(job: Job, index: int) -> None:
    """Free a patch's factor, where it is held here."""
    factor = _FACTORS.take((job.run, index))
    if factor is not None:
        factor.release()
