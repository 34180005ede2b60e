"""What runs for one patch, on whatever worker: the stages composed; paths and boundary curves in and out.

What takes time leaves a record in the store: where it is there already, the task was finished by a worker that was lost before
it could say so, or by a run that this one goes on with.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from pgcp.elimination.dirichlet import DirichletSolver, harmonic_solver
from pgcp.elimination.sparse_boundary import AnyFactor
from pgcp.patches.flatten import factor_patch, first_factor, flatten_simply
from pgcp.patches.solve import solve_patch
from pgcp.patches.types import BoundaryCurve, Component, FaceOrder, Patch, SolveReport
from pgcp.patches.weld import relax_boundary, weld_closed, weld_pair
from pgcp.plane.space import Space
from pgcp.runtime.cache import FACTORS
from pgcp.runtime.job import Job
from pgcp.runtime.store import PatchStore
from pgcp.types import Positions

_SECOND_PASS = "second pass"


def keeps_factors(job: Job) -> Callable[[int], bool]:
    """Whether this process would keep a factor of so many bytes for the second pass."""
    return partial(FACTORS.has_room, job.owner, job.factor_cache_bytes)


def flatten_task(job: Job, index: int) -> BoundaryCurve:
    """First pass: flatten a stored patch, store and send its boundary curve.

    The factor is kept only where seams are solved as well: to solve anew for known boundary values takes little more time
    than to write a factor to memory that was not in use before, and none of the memory.
    """
    store = PatchStore(job.directory)
    done = None if job.stores_operators else store.find("curve", index, BoundaryCurve)  # else the factor is needed too
    if done is not None:
        return done
    patch = store.read("patch", index, Patch)
    if job.stores_operators:
        factor = factor_patch(patch, job.backend, keeps=keeps_factors(job))
        curve = flatten_simply(patch, factor, job.flattener, job.backend)
        store.write_array("operator", index, factor.schur)
        _store_curve(store, curve, factor)
        FACTORS.put(job.key(index), factor, job.factor_cache_bytes)
        return curve
    once = first_factor(patch, job.backend)
    curve = flatten_simply(patch, once, job.flattener, job.backend)
    _store_curve(store, curve, once)
    return curve


def _store_curve(store: PatchStore, curve: BoundaryCurve, factor: AnyFactor) -> None:
    """Store the order in which a patch's faces were eliminated, where there is one, and its boundary curve."""
    order = getattr(factor, "order", None)
    if order is not None:
        store.write("order", curve.patch, FaceOrder(order))
    store.write("curve", curve.patch, curve)


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


def prepare_task(job: Job, index: int) -> bool:
    """Do of the second pass for a stored patch what needs no values, and keep it for that; returns whether it is kept."""
    store, key = PatchStore(job.directory), job.for_use(_SECOND_PASS).key(index)
    return FACTORS.holds(key) or FACTORS.put(
        key, _solver(job, store, store.read("patch", index, Patch)), job.factor_cache_bytes
    )


def solve_task(job: Job, space: Space, name: str, item: tuple[int, Positions]) -> SolveReport:
    """Second pass: solve a stored patch with its welded boundary; store map and report.

    The boundary is complex (n_B,) in the plane, or unit vectors (n_B, 3).
    """
    index, boundary = item
    store = PatchStore(job.directory)
    done = store.find(f"solved{name}", index, SolveReport)
    if done is not None:
        return done
    patch = store.read("patch", index, Patch)
    solver = FACTORS.take(job.for_use(_SECOND_PASS).key(index)) or _solver(job, store, patch)
    solved = solve_patch(space, patch, boundary, solver, job.backend)
    solver.release()
    store.write(f"map{name}", index, solved)
    report = SolveReport(index, solved.fold_count, solved.first_fold_count, solved.raised_weights, solved.mu_max)
    store.write(f"solved{name}", index, report)
    return report
