from __future__ import annotations

import gc
import operator
import os
import pickle
import socket
import sys
import threading
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from clusters import Cluster, Processes
from meshes import cap, grid, lifted, similarity_error, spheroid

import pgcp
from pgcp import errors
from pgcp.interface import whole_mesh
from pgcp.methods import pgcp as welds
from pgcp.parallel import limited_to, processor_count
from pgcp.patches.plan import plans
from pgcp.patches.split import split_mesh
from pgcp.patches.tasks import weld_task
from pgcp.patches.weld import Component
from pgcp.runtime.cache import FactorCache, FactorKey, Owner
from pgcp.runtime.executors import EXECUTORS, DaskExecutor, ExecutorKind, Join, JoinTree, LocalExecutor, Speculation, Tasks
from pgcp.runtime.forks import prepare_forks
from pgcp.runtime.job import Job
from pgcp.surface.topology import examine
from pgcp.types import Mesh


@pytest.mark.parametrize("patches", [1, 2, 5, 9])
def test_a_planar_mesh_comes_back_up_to_a_similarity(patches):
    mesh = grid(20, 13, jitter=0.4)
    result = pgcp.parameterize(mesh, patches=patches)
    z = result.coordinates @ [1, 1j]
    assert similarity_error(z, mesh.vertices @ [1, 1j, 0]) < 1e-7
    assert result.quality.angle_max_deg < 1e-4
    assert result.report["quality"]["folds"] == 0


@pytest.mark.parametrize("patches", [1, 3, 7])
def test_a_cap_is_mapped_to_its_stereographic_projection(patches):
    errors_ = []
    for n in (10, 20, 40):
        mesh, exact = cap(n)
        result = pgcp.parameterize(mesh, patches=patches, polish="none")
        errors_.append(similarity_error(result.coordinates @ [1, 1j], exact))
    assert errors_[-1] < 7e-3
    assert np.log2(np.array(errors_[:-1]) / errors_[1:]).mean() > 0.7


def test_patches_change_the_map_little_and_less_under_refinement():
    distances = []
    for n in (16, 32, 64):
        mesh = lifted(grid(n))
        whole = pgcp.parameterize(mesh, patches=1, polish="none")
        results = [pgcp.parameterize(mesh, patches=patches, polish="none") for patches in (2, 4, 8)]
        assert all(r.quality.angle_mean_deg < 1.1 * whole.quality.angle_mean_deg for r in results[:2])
        distances.append(max(similarity_error(r.coordinates @ [1, 1j], whole.coordinates @ [1, 1j]) for r in results))
    assert distances[-1] < 5e-3
    assert np.log2(distances[0] / distances[-1]) / 2 > 0.7


def test_total_area_is_kept_and_the_map_is_not_mirrored(hills):
    result = pgcp.parameterize(hills, patches=4)
    a, b, c = (result.coordinates[hills.faces[:, i]] for i in range(3))
    areas = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    surface = 0.5 * np.linalg.norm(
        np.cross(
            hills.vertices[hills.faces[:, 1]] - hills.vertices[hills.faces[:, 0]],
            hills.vertices[hills.faces[:, 2]] - hills.vertices[hills.faces[:, 0]],
        ),
        axis=1,
    )
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(surface.sum(), rel=1e-12)


@pytest.mark.parametrize("flatten", ["dncp", "scp"])
@pytest.mark.parametrize("backend", ["auto", "superlu"])
def test_every_route_gives_the_same_map(flatten, backend, hills):
    reference = pgcp.parameterize(hills, patches=5)
    result = pgcp.parameterize(hills, patches=5, flatten=flatten, backend=backend)
    limit = 1e-8 if flatten == "dncp" else 0.01
    assert similarity_error(result.coordinates @ [1, 1j], reference.coordinates @ [1, 1j]) < limit


def test_rotation_and_scale_of_the_surface_do_not_matter(hills):
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    moved = Mesh(1e-3 * hills.vertices @ turn.T + [5, -2, 1], hills.faces)
    one, two = pgcp.parameterize(hills, patches=4), pgcp.parameterize(moved, patches=4)
    assert np.array_equal(one.patch, two.patch)
    assert similarity_error(one.coordinates @ [1, 1j], two.coordinates @ [1, 1j]) < 1e-6


def test_sources_may_be_paths_and_trimeshes(hills, tmp_path):
    path = tmp_path / "hills.ply"
    pgcp.write_mesh(path, hills)
    loose = trimesh.Trimesh(hills.vertices, hills.faces, process=False)
    results = [pgcp.parameterize(source, patches=3).coordinates for source in (hills, path, str(path), loose)]
    assert all(np.array_equal(results[0], other) for other in results[1:])
    with pytest.raises(errors.InputError, match="expected a path"):
        pgcp.parameterize(42)


# executors


@pytest.fixture(scope="module")
def reference():
    mesh = lifted(grid(40, 30, jitter=0.2))
    return mesh, pgcp.parameterize(mesh, patches=6)


def test_two_serial_runs_give_the_same_bits(reference):
    mesh, first = reference
    again = pgcp.parameterize(mesh, patches=6)
    assert again.coordinates.tobytes() == first.coordinates.tobytes()
    assert again.mu.tobytes() == first.mu.tobytes()


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_local_workers_give_the_bits_of_the_serial_run(workers, reference):
    mesh, first = reference
    seen = []
    result = pgcp.parameterize(mesh, patches=6, workers=workers, progress=lambda *args: seen.append(args))
    assert result.coordinates.tobytes() == first.coordinates.tobytes()
    assert result.mu.tobytes() == first.mu.tobytes()
    assert result.report["executor"]["workers"] == workers
    assert ("flatten", 6, 6) in seen
    assert ("solve", 6, 6) in seen
    assert ("flatten", 0, 6) in seen


def test_factors_are_reused_where_kept_and_remade_where_not(reference):
    mesh, welded = reference
    assert not any(p["reused_factor"] for p in welded.report["patches"])  # a second pass of its own costs less than keeping
    for seams in ("exact", "relax"):
        first = pgcp.parameterize(mesh, patches=6, seams=seams)
        assert all(p["reused_factor"] for p in first.report["patches"])
        result = pgcp.parameterize(mesh, patches=6, seams=seams, factor_cache_bytes=0)
        assert not any(p["reused_factor"] for p in result.report["patches"])
        assert result.coordinates.tobytes() == first.coordinates.tobytes()


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A scheduler and two workers, started as a user would start them; all are gone afterwards, whatever happens."""
    processes = Processes()
    try:
        started = Cluster(tmp_path_factory.mktemp("cluster"), processes)
        started.start_scheduler()
        started.have_workers(2)
        yield started.address, started.info
    finally:
        processes.end()


def test_a_running_cluster_is_used_by_address_and_by_file(cluster, reference, tmp_path):
    mesh, first = reference
    address, info = cluster
    for where in ({"scheduler": address}, {"scheduler_file": info}):
        result = pgcp.parameterize(mesh, patches=6, store=tmp_path, **where)
        assert result.coordinates.tobytes() == first.coordinates.tobytes()
        assert result.report["executor"] == {"kind": "dask cluster", "workers": 2, "threads_per_worker": 1}
    assert list(tmp_path.iterdir()) == []


def passed(mesh, address, more=None):
    """The map in 6 patches, pickled bytes of arguments and results of each stage, the results; ``more`` goes with them."""
    sizes, made = {}, {}

    class Watched(DaskExecutor):
        def map(self, tasks, *others):
            results = super().map(tasks, *others)
            made[tasks.stage] = results
            sent = pickle.dumps((tasks.function, list(tasks.items)))
            sizes[tasks.stage] = len(sent), len(pickle.dumps((results, more)))
            return results

    def make(running, run, *_):
        return Watched(run, scheduler=running.scheduler)

    EXECUTORS.register(ExecutorKind("watched", "", make, has_workers=True))
    try:
        result = pgcp.parameterize(mesh, patches=6, scheduler=address, executor="watched")
    finally:
        EXECUTORS.remove("watched")
    return result, sizes, made


def boundary_counts(mesh, labels):
    """How many vertices lie on the boundary of each patch."""
    counts = []
    for label in range(labels.max() + 1):
        edges = np.sort(mesh.faces[labels == label][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        counts.append(int((np.unique(edges, axis=0, return_counts=True)[1] == 1).sum()))
    return counts


def are_only_boundaries(mesh, result, sizes, made):
    """Whether what passes is the boundary of every patch, subdivided as its curve is, and 200 bytes of wrapping a task."""
    counts = boundary_counts(mesh, result.patch)
    assert sorted(len(curve.vertex_ids) for curve in made["flatten"]) == sorted(counts)
    points = sum(len(curve.z) for curve in made["flatten"])
    positions, few = 16, 200 * len(counts)
    return (
        sizes["flatten"][0] < few
        and sizes["flatten"][1] < positions * points + 8 * sum(counts) + few
        and sizes["solve"][0] < positions * sum(counts) + few
        and sizes["solve"][1] < few
    )


def test_little_passes_through_the_scheduler(cluster):
    """Boundary curves one way, boundary positions the other, no more than one patch's arrays would add."""
    mesh = lifted(grid(40, 30, jitter=0.2))
    result, sizes, made = passed(mesh, cluster[0])
    assert are_only_boundaries(mesh, result, sizes, made)
    smallest = int(np.argmin(np.bincount(result.patch)))
    its_vertices = mesh.vertices[np.unique(mesh.faces[result.patch == smallest])]
    assert not are_only_boundaries(mesh, *passed(mesh, cluster[0], its_vertices))


@pytest.fixture(params=["serial", "dask"])
def executor(request):
    if request.param == "serial":
        with LocalExecutor() as made:
            yield made
    else:
        address, _ = request.getfixturevalue("cluster")
        with DaskExecutor("test", scheduler=address) as made:
            yield made


def joined_by(executor, function):
    """A tree of joins of what negated numbers 1 to 4 give, and the function that gives it."""
    joining = executor.join(JoinTree("join", [Join(0, 1, 4, sum), Join(2, 3, 5, function), Join(4, 5, 6, sum)]))
    return joining, lambda result: joining.put(-result - 1, result)


def test_joins_begin_with_what_is_mapped(executor):
    joining, put = joined_by(executor, sum)
    assert executor.map(Tasks("negate", operator.neg, [1, 2, 3, 4]), put) == [-1, -2, -3, -4]
    assert joining.results() == {6: -10}
    assert {stage: record["count"] for stage, record in executor.taken.items()} == {"negate": 4, "join": 3}


def test_a_join_that_fails_does_not_keep_the_rest_from_being_mapped(executor):
    joining, put = joined_by(executor, operator.itemgetter(2))
    assert executor.map(Tasks("negate", operator.neg, [1, 2, 3, 4]), put) == [-1, -2, -3, -4]
    with pytest.raises(IndexError):
        joining.results()
    assert executor.map(Tasks("negate", operator.neg, [5])) == [-5]


def test_a_tree_ends_with_its_results_with_an_error_and_with_the_next_tree(executor):
    def begun():
        joining, put = joined_by(executor, sum)
        for number in (1, 2, 3, 4):
            put(-number)
        return joining

    finished = begun()
    assert finished.results() == {6: -10}
    failed = begun()
    with pytest.raises(ZeroDivisionError):
        executor.map(Tasks("invert", lambda x: 1 / x, [0]))
    replaced, last = begun(), begun()
    for joining in (finished, failed, replaced):
        with pytest.raises(ValueError, match="has ended"):
            joining.results()
    assert last.results() == {6: -10}


def held_join(executor, offers, is_over):
    """A join of two numbers that waits for something, and what idle workers may do meanwhile."""

    def held_sum(pair):
        deadline = time.monotonic() + 20
        while not is_over() and time.monotonic() < deadline:
            time.sleep(0.02)
        return sum(pair)

    joining = executor.join(JoinTree("join", [Join(0, 1, 2, held_sum)]))
    for work in offers:
        executor.speculate(work)
    joining.put(0, 5)
    joining.put(1, 6)
    return joining.results()


def test_idle_workers_do_speculative_work_where_a_task_then_finds_it(cluster, tmp_path):
    begun, finding = tmp_path / "begun", tmp_path / "finding"

    def prepare(name):
        if name == "PLACE8":
            begun.touch()
            deadline = time.monotonic() + 20
            while not finding.exists() and time.monotonic() < deadline:
                time.sleep(0.02)
            time.sleep(0.2)
        os.environ[name] = "prepared"
        return True

    def find(name):
        return os.environ.pop(name, None)

    def progress(stage, *_):
        if stage == "find":
            finding.touch()

    address, _ = cluster
    with DaskExecutor("test", scheduler=address, progress=progress) as executor:
        offers = [Speculation("prepare", place, prepare, f"PLACE{place}") for place in (7, 8, 9)]
        assert held_join(executor, offers, begun.exists) == {2: 11}
        assert executor.map(Tasks("find", find, ["PLACE8"], [8])) == ["prepared"]  # that was still under way
        assert executor.map(Tasks("find", find, ["PLACE9"], [9])) == ["prepared"]
        assert executor.map(Tasks("find", find, ["PLACE7"], [7])) == [None]
    assert executor.taken["prepare"]["count"] == 2


@pytest.mark.parametrize("fails", [False, True])
def test_speculative_work_ends_where_it_is_not_kept(fails, cluster, tmp_path):
    tried = tmp_path / "tried"

    def prepare(_):
        tried.write_text(tried.read_text() + "x" if tried.exists() else "x")
        if fails:
            raise errors.SolveFailedError("made to fail")
        return False

    until = time.monotonic() + 5

    def is_over():
        return tried.exists() and time.monotonic() > until

    address, _ = cluster
    with DaskExecutor("test", scheduler=address) as executor:
        offers = [Speculation("prepare", place, prepare, place) for place in range(5)]
        assert held_join(executor, offers, is_over) == {2: 11}
        assert executor.map(Tasks("negate", operator.neg, [1, 4], [1, 4])) == [-1, -4]
    assert tried.read_text() == "x"


def test_no_speculative_work_begins_after_a_join_has_failed(cluster, tmp_path):
    begun = tmp_path / "begun"

    def prepare(_):
        begun.touch()
        return True

    address, _ = cluster
    with DaskExecutor("test", scheduler=address) as executor:
        joining = executor.join(JoinTree("join", [Join(0, 1, 2, operator.itemgetter(2)), Join(2, 3, 4, sum)]))
        for place in range(5, 9):
            executor.speculate(Speculation("prepare", place, prepare, place))
        joining.put(0, 5)
        joining.put(1, 6)
        executor.map(Tasks("sleep", time.sleep, [1.5]))
        with pytest.raises(IndexError):
            joining.results()
    assert not begun.exists()


def test_a_single_worker_does_no_speculative_work():
    with DaskExecutor("test", 1) as executor:
        assert held_join(executor, [Speculation("prepare", 7, operator.truth, 1)], lambda: True) == {2: 11}
    assert set(executor.taken) == {"join"}


def test_errors_cross_processes(cluster, tmp_path):
    address, _ = cluster
    triangle = np.arange(3)
    edges = np.column_stack([triangle, np.roll(triangle, -1)])
    one, other = (Component(triangle + k, np.array([0, 1, 1j]), triangle, edges, np.ones(3), 99) for k in (0, 10))
    with DaskExecutor("test", scheduler=address) as executor, pytest.raises(errors.WeldFailedError, match="share 0 points"):
        task = partial(weld_task, Job(Owner("test"), tmp_path, "dncp", "nested", 0), "union", 2, False)
        executor.map(Tasks("weld", task, [(one, other)]))


def _surroundings(_item):
    import dask

    quiet = dask.config.get("distributed.worker.profile.enabled"), dask.config.get("distributed.admin.tick.interval")
    garbage = gc.get_threshold()[0] > 10_000, gc.get_freeze_count() > 10_000
    given = os.environ["OMP_NUM_THREADS"], os.environ["MALLOC_ARENA_MAX"]
    return os.getpid(), "pgcp.patches.preload" in sys.modules, garbage, given, quiet


@pytest.mark.skipif(sys.platform != "linux", reason="workers are forked on Linux only")
def test_local_workers_are_forked_warm_and_are_left_in_peace():
    before = dict(os.environ)
    prepare_forks()
    assert dict(os.environ) == before
    with DaskExecutor("test", 2) as executor:
        found = executor.map(Tasks("look", _surroundings, [0, 1]))
    assert os.getpid() not in {pid for pid, *_ in found}
    assert [rest for _, *rest in found] == 2 * [[True, (True, True), ("1", "1"), (False, "1s")]]


def test_workers_without_this_package_are_said(cluster):
    """A function the scheduler's side cannot import, as when the package is missing there."""
    address, _ = cluster
    with DaskExecutor("test", scheduler=address) as executor, pytest.raises(errors.InputError, match="install pgcp"):
        executor.map(Tasks("fail", test_errors_cross_processes, [1]))


@pytest.mark.slow  # the command is asked the same
def test_no_scheduler_at_the_address_is_said():
    with pytest.raises(errors.InputError, match="no dask scheduler answers"):
        DaskExecutor("x", scheduler=f"tcp://127.0.0.1:{free_port()}")


@pytest.mark.parametrize(("at_once", "kind"), [(1, "serial"), (3, "threads")])
def test_local_progress_and_description(at_once, kind):
    seen = []
    with LocalExecutor(lambda *args: seen.append(args), at_once) as executor:
        assert executor.map(Tasks("square", lambda x: x * x, [1, 2, 3])) == [1, 4, 9]
        assert executor.describe() == {"kind": kind, "workers": 0, "threads_per_worker": at_once}
        assert executor.peak_bytes() > 1_000_000
        assert executor.taken["square"]["count"] == 3
    assert seen == [("square", 0, 3), ("square", 1, 3), ("square", 2, 3), ("square", 3, 3)]


def test_local_tasks_run_at_the_same_time_on_a_share_of_the_processors_each():
    met = threading.Barrier(2, timeout=60)

    def meet(number):
        met.wait()
        return number, processor_count()

    with limited_to(5), LocalExecutor(at_once=2) as executor:
        share = max(1, processor_count() // 2)
        assert executor.map(Tasks("meet", meet, [1, 2, 3, 4])) == [(1, share), (2, share), (3, share), (4, share)]
        joins = executor.join(JoinTree("meet", [Join(0, 1, 4, meet), Join(2, 3, 5, meet)]))
        for number, name in enumerate("abcd"):
            joins.put(number, name)
        assert {pair for pair, _ in joins.results().values()} == {("a", "b"), ("c", "d")}


@pytest.mark.parametrize("seams", ["weld", "exact"])
def test_threads_give_the_bits_of_tasks_one_after_the_other(seams, monkeypatch):
    mesh = lifted(grid(30, jitter=0.2))
    found = []
    for at_once in (1, 3):
        monkeypatch.setattr("pgcp.runtime.executors.threads._MOST_AT_ONCE", at_once)
        monkeypatch.setattr("pgcp.runtime.executors.threads.processor_count", lambda: 3)
        result = pgcp.parameterize(mesh, patches=5, seams=seams)
        assert result.report["threads"] == at_once
        found.append((result.coordinates.tobytes(), result.mu.tobytes()))
    assert found[0] == found[1]


def test_a_callback_that_stops_a_run_stops_its_threads():
    begun = []

    def work(number):
        begun.append(number)
        time.sleep(0.1)

    def progress(_stage, done, _total):
        if done == 1:
            raise KeyboardInterrupt

    executor = LocalExecutor(progress, 2)

    def join():
        joining = executor.join(JoinTree("work", [Join(2 * k, 2 * k + 1, 100 + k, work) for k in range(40)]))
        for name in range(80):
            joining.put(name, name)
        return joining.results()

    for run in (lambda: executor.map(Tasks("work", work, list(range(40)))), join):
        begun.clear()
        with pytest.raises(KeyboardInterrupt):
            run()
        time.sleep(0.5)
        assert len(begun) < 6


@pytest.mark.parametrize("at_once", [1, 2])
def test_what_goes_wrong_in_a_local_task_is_said_and_begins_no_more(at_once):
    begun = []

    def fails(number):
        begun.append(number)
        if number == 1:
            raise MemoryError
        time.sleep(0.2)

    with (
        LocalExecutor(at_once=at_once) as executor,
        pytest.raises(errors.SolveFailedError, match="stage try ran out of memory"),
    ):
        executor.map(Tasks("try", fails, list(range(50))))
    assert len(begun) < 10


class Held:
    def __init__(self, nbytes):
        self.nbytes, self.released = nbytes, False

    def release(self):
        self.released = True


def key(run, patch):
    return FactorKey(Owner(run), patch)


def test_the_factor_cache_is_bounded_and_drops_the_oldest_of_other_runs():
    cache = FactorCache()
    a, b, c, huge = Held(40), Held(40), Held(40), Held(1000)
    for run, factor in zip("abc", (a, b, c), strict=True):
        cache.put(key(run, 0), factor, 100)
    assert a.released
    assert not b.released
    assert cache.nbytes == 80
    cache.put(key("c", 1), huge, 100)
    assert huge.released
    assert cache.take(key("a", 0)) is None
    assert cache.take(key("b", 0)) is b
    assert cache.take(key("b", 0)) is None
    assert cache.has_room(Owner("c"), 100, 60)
    assert not cache.has_room(Owner("c"), 100, 61)
    late = Held(61)  # those of its own run do not give way
    assert not cache.put(key("c", 2), late, 100)
    assert late.released
    assert cache.holds(key("c", 0))
    assert cache.take(key("c", 0)) is c
    assert not cache.holds(key("c", 0))


def test_the_factor_cache_keeps_nothing_more_of_a_run_that_is_over():
    cache = FactorCache()
    held, late, other = Held(40), Held(40), Held(40)
    assert cache.put(FactorKey(Owner("run", "6-0", "exact"), 0), held, 100)
    cache.drop("run")
    assert not cache.put(FactorKey(Owner("run", "6-0"), 1), late, 100)
    assert cache.put(key("running", 1), other, 100)
    assert [factor.released for factor in (held, late, other)] == [True, True, False]


def fail_first_welds(monkeypatch, times, exact=True):
    original, calls = welds.weld, []

    def failing(*arguments):
        calls.append(1)
        if len(calls) <= times:
            raise errors.WeldFailedError("made to fail")
        return original(*arguments)

    def never(*_):
        raise errors.SolveFailedError("made to fail, too")

    monkeypatch.setattr(welds, "weld", failing)
    monkeypatch.setattr("pgcp.retry.course.may_be_solved_in_logarithms", lambda *_: False)
    if not exact:
        monkeypatch.setattr(whole_mesh, "eliminated", never)
    return calls


def orders_of(hills, patches, seed=0):
    split = split_mesh(hills, examine(hills.faces, len(hills.vertices)), patches, seed)
    return [order for order, _ in plans(split, closed=False)]


@pytest.mark.parametrize("workers", [0, 1])
def test_a_failed_weld_is_tried_again_in_another_order_and_with_another_seed(workers, monkeypatch, hills):
    other = pgcp.parameterize(hills, patches=4, seed=1)
    orders = orders_of(hills, 4)
    assert len(orders) > 1
    fail_first_welds(monkeypatch, len(orders), exact=False)
    result = pgcp.parameterize(hills, patches=4, seed=0, workers=workers)
    assert result.report["seed"] == 1
    assert result.report["retries"] == [
        *({"patches": 4, "seed": 0, "route": order, "folds": None, "reason": "made to fail"} for order in orders),
        {"patches": 4, "seed": 0, "route": "exact", "folds": None, "reason": "made to fail, too"},
    ]
    assert result.coordinates.tobytes() == other.coordinates.tobytes()


def test_where_welds_fail_seams_are_solved_exactly(monkeypatch, hills):
    exact = pgcp.parameterize(hills, patches=4, seams="exact")
    fail_first_welds(monkeypatch, 1000)
    result = pgcp.parameterize(hills, patches=4)
    assert result.coordinates.tobytes() == exact.coordinates.tobytes()
    assert {r["route"] for r in result.report["retries"]} == set(orders_of(hills, 4))


def test_fewer_patches_are_the_last_resort_of_a_weld(monkeypatch, hills):
    tries = sum(len(orders_of(hills, 5, seed)) for seed in range(3))
    fail_first_welds(monkeypatch, tries, exact=False)
    result = pgcp.parameterize(hills, patches=5)
    assert len(result.report["patches"]) == 2
    assert len(result.report["retries"]) == tries + 1
    assert result.quality.folds == 0


def test_a_weld_that_fails_every_time_is_an_error(monkeypatch, hills):
    calls = fail_first_welds(monkeypatch, 1000, exact=False)
    with pytest.raises(errors.WeldFailedError, match="made to fail"):
        pgcp.parameterize(hills, patches=4, repairs=())
    assert len(calls) == sum(len(orders_of(hills, 4, seed)) for seed in range(3)) + 2


# refusals


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"patches": 0}, "patches is 0"),
        ({"workers": -1}, "workers is -1"),
        ({"seed": -3}, "seed is -3"),
        ({"method": "magic"}, "unknown method 'magic'"),
        ({"method": "cdcp", "target": "free"}, "the method cdcp is one for the target disk, not free"),
        ({"method": "dncp", "target": "disk"}, "the method dncp is one for the target free, not disk"),
        ({"method": "ccem", "seams": "exact"}, "has no welds to choose seams for"),
        ({"flatten": "magic"}, "unknown flattening 'magic'"),
        ({"repairs": ("relax", "magic")}, "unknown repair 'magic'"),
        ({"target": "disk", "no_overlap": True}, "no_overlap goes with the target free"),
        ({"target": "moon"}, "unknown target 'moon'"),
        ({"backend": "magic"}, "unknown sparse backend"),
        ({"patches": 10_000}, "10000 patches were asked for"),
        ({"executor": "magic"}, "unknown executor 'magic'; choose from dask, threads"),
        ({"executor": "threads", "workers": 2}, "the executor threads has no workers"),
        ({"executor": "dask"}, "the executor dask needs workers or a scheduler"),
        ({"scheduler": "a", "scheduler_file": Path("b")}, "give one of"),
        ({"scheduler": "a", "client": 3}, "give one of"),
        ({"factor_cache_bytes": -1}, "factor_cache_bytes"),
    ],
)
def test_impossible_options_are_refused(options, words, hills):
    with pytest.raises(errors.InputError, match=words):
        pgcp.parameterize(hills, **options)


def test_flat_meshes_are_refused():
    line = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 1, 2]]))
    with pytest.raises(errors.DegenerateError, match="zero area"):
        pgcp.parameterize(line, patches=1)
    points = lifted(grid(9)).vertices
    with pytest.raises(errors.DegenerateError, match=r"zero area"):
        pgcp.parameterize(Mesh(0.0 * points, grid(9).faces))
    far = Mesh((points + 1e7).astype(np.float32), grid(9).faces)
    with pytest.raises(errors.DegenerateError, match=r"zero area; it lies 1e\+07 times its own size from the origin"):
        pgcp.parameterize(far)


def spoiled(mesh, kind, seed=0):
    """A mesh with a dozen faces of no area, or next to none."""
    rng = np.random.default_rng(seed)
    points = mesh.vertices.copy()
    for a, b, c in mesh.faces[rng.choice(len(mesh.faces), 12, replace=False)]:
        if kind == "coincident":
            points[a] = points[b]
        elif kind == "collinear":
            points[a] = 0.5 * (points[b] + points[c])
        else:
            points[a] = points[b] + 1e-13 * rng.normal(size=3)
    return Mesh(points, mesh.faces)


@pytest.mark.parametrize("patches", [2, 5])
@pytest.mark.parametrize("kind", ["coincident", "collinear", "nearly"])
@pytest.mark.parametrize("target", ["free", "disk", "sphere"])
def test_faces_without_area_are_mapped_all_the_same(target, kind, patches):
    base = spheroid(3, 2.0)[0] if target == "sphere" else lifted(grid(12, jitter=0.3))
    mesh = spoiled(base, kind)
    result = pgcp.parameterize(mesh, patches=patches, target=target)
    assert result.quality.folds == 0
    assert np.isfinite(result.coordinates).all()
    assert np.isfinite(result.mu).all()
    assert 0 < result.report["mollification"] < 1e-4
    assert np.array_equal(result.mesh.vertices, mesh.vertices)


@pytest.mark.parametrize("unit", [1e-200, 1e-20, 3.7, 1e18, 1e150])
@pytest.mark.parametrize("target", ["free", "disk", "sphere"])
def test_the_unit_of_length_makes_no_difference(target, unit):
    mesh = spheroid(3, 2.0)[0] if target == "sphere" else lifted(grid(20, jitter=0.3))
    one = pgcp.parameterize(mesh, patches=5, target=target)
    other = pgcp.parameterize(Mesh(mesh.vertices * unit, mesh.faces), patches=5, target=target)
    scale = unit if target == "free" else 1.0
    assert np.abs(other.coordinates / scale - one.coordinates).max() < 1e-9
    assert other.quality.angle_mean_deg == pytest.approx(one.quality.angle_mean_deg, rel=1e-9)


@pytest.mark.parametrize("target", ["free", "disk", "sphere"])
def test_the_place_and_the_direction_make_no_difference(target):
    mesh = spheroid(3, 2.0)[0] if target == "sphere" else lifted(grid(20, jitter=0.3))
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    one = pgcp.parameterize(mesh, patches=5, target=target).coordinates
    other = pgcp.parameterize(Mesh(mesh.vertices @ turn.T + [30, -70, 11], mesh.faces), patches=5, target=target).coordinates
    assert np.abs(other - (one @ turn.T if target == "sphere" else one)).max() < 1e-9


@pytest.mark.parametrize("patches", [1, 2])
def test_the_smallest_meshes(patches):
    result = pgcp.parameterize(grid(1), patches=patches)
    assert similarity_error(result.coordinates @ [1, 1j], grid(1).vertices @ [1, 1j, 0]) < 1e-9
    one = Mesh(np.array([[0.0, 0, 0], [4, 0, 0], [0, 3, 1]]), np.array([[0, 1, 2]]))
    assert pgcp.parameterize(one, patches=1).quality.angle_max_deg < 1e-6


def test_a_small_mesh_gets_fewer_patches_unless_told_otherwise():
    assert len(pgcp.parameterize(grid(3)).report["patches"]) == 1
    assert len(pgcp.parameterize(grid(13)).report["patches"]) == 3
    assert len(pgcp.parameterize(grid(20)).report["patches"]) == 6
    assert len(pgcp.parameterize(grid(3), patches=6).report["patches"]) == 6


def test_unused_vertices_stay_in_the_order():
    mesh = grid(5)
    padded = Mesh(np.vstack([[9, 9, 9], mesh.vertices, [7, 7, 7]]), mesh.faces + 1)
    result = pgcp.parameterize(padded, patches=3)
    assert result.coordinates.shape == (38, 2)
    assert np.array_equal(result.coordinates[[0, -1]], np.zeros((2, 2)))
    assert np.allclose(result.coordinates[1:-1], pgcp.parameterize(mesh, patches=3).coordinates, atol=1e-9)


def test_a_map_with_folds_is_not_passed_off_as_good(hills, monkeypatch):
    from pgcp.patches import stored

    monkeypatch.setattr(
        stored, "collect", lambda mesh, parts, space: ((mesh.vertices @ [1, -1j, 0]), np.zeros(len(mesh.faces), complex))
    )
    with pytest.raises(errors.FoldError, match="folded faces of 1152") as caught:
        pgcp.parameterize(hills, patches=2, repairs=())
    assert caught.value.result.quality.folds == len(hills.faces)
    assert caught.value.result.report["status"] == "folded"


@pytest.mark.parametrize("kind", [c for c in vars(errors).values() if isinstance(c, type) and issubclass(c, errors.PgcpError)])
def test_errors_survive_pickling(kind):
    problem = kind("patch 3: 7 of 5")
    again = pickle.loads(pickle.dumps(problem))
    assert type(again) is kind
    assert str(again) == "patch 3: 7 of 5"


def test_the_report_holds_what_it_promises(reference):
    _, result = reference
    report = result.report
    assert [s["name"] for s in report["stages"]] == [
        "read", "check", "split", "store", "flatten", "weld", "constrain", "solve", "assemble", "correct", "repair",
        "place", "measure",
    ]  # fmt: skip
    assert all(s["seconds"] >= 0 and s["peak_bytes"] > 0 for s in report["stages"])
    assert sum(p["faces"] for p in report["patches"]) == len(result.mesh.faces)
    assert {"numpy", "scipy", "numba", "python"} <= set(report["versions"])
    assert report["options"]["patches"] == 6
    assert report["seed"] == 0
    assert report["backend"] == "nested"
    assert report["threads"] == processor_count()
    assert len(report["welds"]) == 5
