#!/usr/bin/env python3
"""Predict how a run scales: task times measured on a mesh, replayed on up to 1,024 workers and a billion vertices.

usage: scaling_model.py [--patches 6,24,64,128] [--repeat 3] [--target auto] [--validate 6] [--vertices 1e6,1e7,1e8,1e9]
                        [--workers 1,2,4,...,1024] [--task-overhead-ms 5] [--latency-ms 0.5] [--bandwidth-gbit 10]
                        [--output-dir DIR] MESH [MESH ...]

measure   every mesh is mapped in each number of patches, one task after the other (recording.py); once more for memory
fit       seconds and bytes as sums of powers of sizes, with factors that are not negative (see TERMS): flatten, prepare (the
          speculative part of solve) and solve by the vertices and boundary edges of a patch, weld by the points of the seam
          and the union, driver stages by vertices and patches; planning the welds also by the square of the patches. Of the
          terms of a weld that grow fastest, and are small on the measured mesh, a least factor is measured (costs.py)
simulate  flatten, the tree of welds beside it, and solve (replay.py), with an overhead for every task; patches go through the
          store's link, curves and unions through the driver's, each of --bandwidth-gbit. Patches are as many as pgcp-run
          takes. The welds are those of a flat square, planned by the package for up to 256 parts, each halved (trees.py)
validate  the first mesh in --validate patches (0: not at all) on 1 and 2 worker processes that have been started before,
          against the measured times replayed (replay) and against the fits (model), without a network
predict   seconds, speedup over one worker, efficiency, memory of a worker and of the driver, and what takes longest
Writes scaling.tsv and scaling.png. Memory is measured on Linux only.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from columns import aligned, draw_stacks, write_tsv
from costs import cycle_seconds, zipper_seconds
from processes import run_pgcp, stage_seconds, warm_up
from recording import Record, Sizes, recorded
from replay import Network, Task, depth_of, passes
from scipy.optimize import nnls
from speedup import PARALLEL, measure_started, numbers
from trees import Tree, weld_tree

import pgcp
from pgcp.runtime.sizing import DEFAULT_PATCHES, make_plan

_PANELS = 1200  # panels of the natural boundary, as in pgcp.plane.natural
_POINTS, _MOST_PARTS = 8000, 8  # points that all seams are subdivided to, as in pgcp.patches.split
_PATCH_BYTES, _MAP_BYTES = 72.0, 48.0  # of a stored patch and its map, per vertex

# n vertices of a patch, or nodes of a union; b boundary edges; s seam points; p panels; c patches in a union; V, K of the run
TERMS: dict[str, Callable[[Sizes], list[Any]]] = {
    "flatten": lambda x: [1.0, x["n"], x["n"] ** 1.5, x["b"] ** 3],
    "weld": lambda x: [1.0, x["n"], x["s"] * x["n"], x["s"] ** 2, x["n"] * x["p"], x["c"] ** 2 * x["n"]],
    "prepare": lambda x: [1.0, x["n"], x["n"] ** 1.5],
    "solve": lambda x: [1.0, x["n"], x["n"] ** 1.5],
    "driver": lambda x: [x["V"], x["K"]],
    "between stages": lambda x: [x["V"], x["K"], x["K"] ** 2],
    "flatten bytes": lambda x: [x["n"], x["b"] ** 2],
    "weld bytes": lambda x: [x["n"], x["c"] * x["n"], x["p"] ** 2],
    "union bytes": lambda x: [x["n"]],
}


def features(kind: str, sizes: Sizes) -> np.ndarray:
    """The terms of a kind, one in a column, for sizes that are numbers or arrays (N,)."""
    columns = np.broadcast_arrays(*TERMS.get(kind, TERMS["driver"])({name: np.asarray(v, float) for name, v in sizes.items()}))
    return np.stack(columns, axis=-1)


def fit_terms(kind: str, sizes: Sizes, values: Any, relative: bool = True, least: Sequence[float] = ()) -> np.ndarray:
    """Factors of the terms, none below ``least`` or else 0, of least squared error to values (N,), relative or not."""
    wanted = np.asarray(values, float)
    matrix = np.atleast_2d(features(kind, sizes))
    floor = np.asarray(least, float) if len(least) else np.zeros(matrix.shape[1])
    weight = 1.0 / np.maximum(wanted, 1e-9) if relative else np.ones(len(wanted))
    rest = (wanted - matrix @ floor) * weight
    matrix = matrix * weight[:, None]
    extent = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    return floor + nnls(matrix / extent, rest)[0] / extent


@dataclass(frozen=True, slots=True)
class Trace:
    """One run: vertices, patches, its tasks one after the other, seconds of the driver's own work by stage."""

    vertices: int
    patches: int
    records: list[Record]
    driver: dict[str, float]

    def of(self, stage: str) -> list[Record]:
        """Tasks of one stage."""
        return [record for record in self.records if record.stage == stage]


def sizes_of(stage: str, item: Any, result: Any) -> Sizes:
    """What the cost of a task depends on, as far as the task shows it."""
    if stage == "flatten":
        return {"points": len(getattr(result, "z", ()))}
    if stage != "weld":
        return {}
    left, right = item
    arrays = (getattr(result, field.name) for field in fields(result))
    seam = len(left.nodes) + len(right.nodes) - len(result.nodes)
    nbytes = sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))
    return {"n": len(result.nodes), "s": seam, "p": panels(max(len(result.corners), 1)), "bytes": float(nbytes)}


def panels(corners: float) -> float:
    """Panels of the natural boundary of a loop with so many mesh vertices."""
    return corners / np.ceil(corners / _PANELS)


def trace(mesh: pgcp.Mesh, patches: int, target: str, looks_at_memory: bool = False) -> Trace | None:
    """Map once, one task after the other; None where it needed more than one attempt."""
    start = time.perf_counter()
    result, records = recorded(mesh, pgcp.Options(patches=patches, target=target), sizes_of, looks_at_memory)
    wall, rows = time.perf_counter() - start, result.report["patches"]
    if result.report["retries"] or len(rows) != patches:
        return None
    inside: dict[int, int] = dict.fromkeys(range(patches), 1)
    for record in records:
        if record.stage == "weld":
            record.sizes["c"] = inside[record.name] = sum(inside[part] for part in record.after)
        else:
            record.sizes.update(n=rows[record.name]["vertices"], b=rows[record.name]["boundary"])
    stages = stage_seconds(result.report)
    driver = {name: seconds for name, seconds in stages.items() if name not in PARALLEL}
    driver["around tasks"] = sum(stages.get(name, 0.0) for name in PARALLEL) - sum(record.seconds for record in records)
    driver["between stages"] = wall - sum(stages.values())
    return Trace(len(mesh.vertices), patches, records, driver)


def middle(traces: Sequence[Trace], memory: Trace) -> Trace:
    """Of equal runs the medians of all seconds; memory of another."""
    records = [
        replace(same[0], seconds=median(record.seconds for record in same), memory_bytes=heavy.memory_bytes)
        for same, heavy in zip(zip(*(t.records for t in traces), strict=True), memory.records, strict=True)
    ]
    return replace(
        traces[0], records=records, driver={k: median(t.driver.get(k, 0.0) for t in traces) for k in traces[0].driver}
    )


def measure(path: Path, counts: Sequence[int], target: str, repeat: int) -> list[Trace]:
    """Traces of one mesh; numbers of patches that it is too small for, or that need several attempts, are left out."""
    start = time.perf_counter()
    mesh, out = pgcp.read_mesh(path), list[Trace]()
    read_s = time.perf_counter() - start
    for patches in (k for k in counts if 2 <= k <= len(mesh.faces) // 100):
        heavy, *runs = [trace(mesh, patches, target, looks_at_memory) for looks_at_memory in [True] + repeat * [False]]
        good = [run for run in runs if run is not None]
        if heavy is not None and len(good) == repeat:
            out.append(middle(good, heavy))
            out[-1].driver["read"] = read_s
    if not out:
        raise SystemExit(f"{path}: no number of patches could be mapped at the first attempt")
    return out


@dataclass(frozen=True, slots=True)
class Model:
    """All that has been fitted: factors by kind and driver stage; boundary edges by sqrt(n), points added to a patch's edges.

    spread: sizes of patches relative to their mean; bytes of a process that has mapped next to nothing, and of the driver
    per vertex.
    """

    factors: dict[str, np.ndarray]
    driver: dict[str, np.ndarray]
    boundary: float
    extra_points: float
    spread: np.ndarray
    base_bytes: float
    driver_bytes: float

    def of(self, kind: str, sizes: Sizes) -> Any:
        """Value of a fit."""
        return features(kind, sizes) @ (self.factors | self.driver)[kind]


def edge_parts(edges: float) -> int:
    """Into how many parts every edge of the seams is cut, away from their ends."""
    return int(np.clip(_POINTS // edges, 1, _MOST_PARTS))


def gathered(records: Iterable[Record]) -> Sizes:
    """Sizes of tasks as arrays."""
    rows = [record.sizes for record in records]
    return {name: np.array([row[name] for row in rows], float) for name in rows[0]} if rows else {}


def fit_model(traces: Sequence[Trace], base_bytes: float, driver_bytes: float) -> Model:
    """Fit all there is to fit."""
    pools = {stage: [record for t in traces for record in t.of(stage)] for stage in ("flatten", "weld", "prepare", "solve")}
    sizes = {stage: gathered(pool) for stage, pool in pools.items()}
    least = {"weld": (0.0, 0.0, zipper_seconds(), 0.0, 0.0, cycle_seconds())}
    factors = {k: fit_terms(k, sizes[k], [r.seconds for r in pool], least=least.get(k, ())) for k, pool in pools.items()}
    for stage in ("flatten", "weld"):
        kind, grown = f"{stage} bytes", [record.memory_bytes for record in pools[stage]]
        factors[kind] = fit_terms(kind, sizes[stage], grown, relative=False)
    factors["union bytes"] = fit_terms("union bytes", sizes["weld"], sizes["weld"]["bytes"], relative=False)
    runs = {"V": np.array([t.vertices for t in traces], float), "K": np.array([t.patches for t in traces], float)}
    driver = {
        name: fit_terms(name, runs, [max(t.driver.get(name, 0.0), 0.0) for t in traces], relative=False)
        for name in dict.fromkeys(name for t in traces for name in t.driver)
    }
    own = [gathered(t.of("flatten")) for t in traces]
    extra = [(x["points"].sum() - edge_parts(x["b"].sum() / 2) * x["b"].sum()) / len(x["b"]) for x in own]
    largest = max(own, key=lambda x: len(x["n"]))["n"]
    boundary, more = float(np.median(sizes["flatten"]["b"] / np.sqrt(sizes["flatten"]["n"]))), max(float(np.median(extra)), 0.0)
    return Model(factors, driver, boundary, more, largest / largest.mean(), base_bytes, driver_bytes)


def weld_tasks(model: Model, tree: Tree, edges: float, points: float) -> tuple[list[Task], list[Sizes]]:
    """Tasks of a tree of welds whose patches have so many boundary edges and points, and the sizes of their unions."""
    loop = {k: points * p for k, p in enumerate(tree.perimeters)}
    nodes, inside = dict(loop), dict.fromkeys(loop, 1)
    bytes_of = {k: float(model.of("union bytes", {"n": n})) for k, n in nodes.items()}
    jobs, sizes = [], []
    for left, right, result, share in tree.steps:
        seam = min(points * share, loop[left], loop[right])
        nodes[result] = nodes[left] + nodes[right] - seam
        loop[result] = max(loop[left] + loop[right] - 2 * seam, 1.0)
        inside[result] = inside[left] + inside[right]
        corners = max(loop[result] * edges / points, 1.0)
        sizes.append({"n": nodes[result], "s": seam, "p": panels(corners), "c": inside[result]})
        bytes_of[result] = float(model.of("union bytes", sizes[-1]))
        in_bytes = bytes_of[left] + bytes_of[right]
        seconds = float(model.of("weld", sizes[-1]))
        jobs.append(Task(result, seconds, (left, right), in_bytes=in_bytes, out_bytes=bytes_of[result], rank=-1.0))
    return jobs, sizes


@dataclass(frozen=True, slots=True)
class Prediction:
    """Seconds and memory of one run: ``parts`` are driver, flatten, weld and solve; ``driver`` its stages."""

    vertices: float
    patches: int
    workers: int
    driver: dict[str, float]
    parts: dict[str, float]
    last_weld_s: float
    worker_bytes: float
    driver_bytes: float

    @property
    def total_s(self) -> float:
        """Seconds of the whole run."""
        return sum(self.parts.values())

    @property
    def dominant(self) -> str:
        """The part that takes longest and its share of the whole."""
        name = max(self.parts, key=lambda part: self.parts[part])
        stage = max(self.driver, key=lambda stage: self.driver[stage])
        more = f", the last one {self.last_weld_s / max(self.parts['weld'], 1e-9):.0%} of them" if name == "weld" else ""
        if name == "driver" and self.driver[stage] > 0.5 * self.parts["driver"]:
            more = f", most of it {stage}"
        return f"{self.parts[name] / self.total_s:.0%} {'welds' if name == 'weld' else name}{more}"


def predict(model: Model, vertices: float, patches: int, workers: int, network: Network) -> Prediction:
    """Predict one run."""
    mean = vertices / patches
    n = mean * np.resize(model.spread, patches)
    b = model.boundary * np.sqrt(n)
    edges = model.boundary * np.sqrt(mean)
    points = edge_parts(patches * edges / 2) * edges + model.extra_points
    flatten = model.of("flatten", {"n": n, "b": b})
    prepare, solve = (model.of(kind, {"n": n}) for kind in ("prepare", "solve"))
    tree = weld_tree(patches)
    depth = depth_of(range(patches), (step[:3] for step in tree.steps))
    first = [Task(k, t, (), _PATCH_BYTES * n[k], 0.0, 16.0 * points, depth[k]) for k, t in enumerate(flatten)]
    ahead = [Task(k, t, (), _PATCH_BYTES * n[k]) for k, t in enumerate(prepare)]
    last = [Task(k, t, (), (_PATCH_BYTES + _MAP_BYTES) * n[k], 16.0 * b[k], 100.0) for k, t in enumerate(solve)]
    welds, unions = weld_tasks(model, tree, edges, points)
    flatten_s, weld_s, solve_s = passes(first, welds, ahead, last, workers, network)
    weld_bytes = max((float(model.of("weld bytes", sizes)) for sizes in unions), default=0.0)
    work = max(float(model.of("flatten bytes", {"n": mean, "b": edges})), weld_bytes)
    union = float(model.of("union bytes", unions[-1])) if unions else 0.0
    driver = {name: float(model.of(name, {"V": vertices, "K": patches})) for name in model.driver}
    parts = {"driver": sum(driver.values()), "flatten": flatten_s, "weld": weld_s, "solve": solve_s}
    driver_bytes = model.base_bytes + model.driver_bytes * vertices + 2 * union
    last_s, worker_bytes = welds[-1].seconds if welds else 0.0, model.base_bytes + work
    return Prediction(vertices, patches, workers, driver, parts, last_s, worker_bytes, driver_bytes)


def replay(run: Trace, workers: int, network: Network) -> tuple[float, float]:
    """Seconds of the parallel stages, and of the whole, when measured tasks run on so many workers."""
    flatten, prepare, solve = ([Task(r.name, r.seconds) for r in run.of(stage)] for stage in ("flatten", "prepare", "solve"))
    welds = [Task(r.name, r.seconds, r.after, rank=-1.0) for r in run.of("weld")]
    parallel = sum(passes(flatten, welds, prepare, solve, workers, network))
    return parallel, parallel + sum(run.driver.values())


def validation(path: Path, run: Trace, model: Model, target: str, repeat: int, network: Network) -> list[list[str]]:
    """Real runs on 1 and 2 started workers, the measured tasks replayed, and the model; errors in percent."""
    rows = [["workers", "what", "real_s", "replay_s", "error", "model_s", "error"]]
    local = Network(network.overhead_s)
    for workers in (1, 2):
        (real,) = measure_started(path, [run.patches], workers, target, repeat)
        replayed = replay(run, workers, local)
        guess = predict(model, run.vertices, run.patches, workers, local)
        parallel = guess.total_s - guess.parts["driver"]
        lines = ("parallel stages", real.parallel_s, parallel), ("whole run", real.seconds, guess.total_s)
        for (what, seconds, modelled), again in zip(lines, replayed, strict=True):
            errors = [f"{100 * (x / seconds - 1):+.0f}%" for x in (again, modelled)]
            rows.append([str(workers), what, f"{seconds:.2f}", f"{again:.2f}", errors[0], f"{modelled:.2f}", errors[1]])
    return rows


def table(predictions: Sequence[Prediction]) -> list[list[str]]:
    """A row per prediction; speedup is over the least number of workers for the same mesh."""
    seconds = ["driver_s", "flatten_s", "weld_s", "solve_s", "total_s"]
    rows = [["vertices", "patches", "workers", *seconds, "speedup", "efficiency", "worker_gb", "driver_gb", "most of it"]]
    for p in predictions:
        base = min((q for q in predictions if q.vertices == p.vertices), key=lambda q: q.workers)
        gain = base.total_s / p.total_s
        figures = [f"{x:.1f}" for x in (*p.parts.values(), p.total_s)]
        figures += [f"{gain:.2f}", f"{gain * base.workers / p.workers:.3f}"]
        figures += [f"{x / 1e9:.1f}" for x in (p.worker_bytes, p.driver_bytes)]
        rows.append([f"{p.vertices:.0f}", str(p.patches), str(p.workers), *figures, p.dominant])
    return rows


def bounds(predictions: Sequence[Prediction]) -> list[str]:
    """What no number of workers can improve on (Amdahl): a sentence per mesh size."""
    out = []
    for vertices in dict.fromkeys(p.vertices for p in predictions):
        own = [p for p in predictions if p.vertices == vertices]
        one, best = own[0], min(own, key=lambda p: p.total_s)
        share = (one.parts["driver"] + one.last_weld_s) / one.total_s
        out.append(
            f"{vertices:.0f} vertices: the driver's own work and the last weld are {share:.0%} of the run on {one.workers} "
            f"workers, which bounds the speedup by {1 / share:.1f}; best is {one.total_s / best.total_s:.1f}, on {best.workers}"
        )
    return out


def draw(predictions: Sequence[Prediction], path: Path) -> None:
    """Total seconds by workers, and the parts of the largest mesh."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.5), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2)
    for vertices in dict.fromkeys(p.vertices for p in predictions):
        own = [p for p in predictions if p.vertices == vertices]
        workers = np.array([p.workers for p in own], float)
        (line,) = left.loglog(workers, [p.total_s for p in own], "o-", markersize=3, label=f"{vertices:.0e} vertices")
        left.loglog(workers, own[0].total_s * workers[0] / workers, ":", linewidth=0.8, color=line.get_color())
    left.set_xlabel("workers (dotted: ideal)")
    left.set_ylabel("seconds")
    left.legend(fontsize=8)
    largest = max(p.vertices for p in predictions)
    own = [p for p in predictions if p.vertices == largest]
    shares = [{name: seconds / p.total_s for name, seconds in p.parts.items()} for p in own]
    draw_stacks(right, shares, [str(p.workers) for p in own], "share of the run")
    right.set_xlabel(f"workers, {largest:.0e} vertices")
    figure.savefig(path)


def process_bytes(path: Path, target: str, vertices: int) -> tuple[float, float]:
    """Bytes of a process that has mapped next to nothing, and bytes per vertex that the driver of one worker needs more."""
    small = warm_up({"workers": 1}).root_peak_bytes
    whole, report, _ = run_pgcp(path, {"workers": 1, "target": target})
    if report is None:
        raise SystemExit(f"{path}: {whole.errors.strip()}")
    return float(small), max(whole.root_peak_bytes - small, 0) / vertices


def parsed(words: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+", type=Path)
    parser.add_argument("--patches", type=numbers, default=numbers("6,24,64,128"))
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--target", default="auto")
    parser.add_argument("--validate", type=int, default=DEFAULT_PATCHES, metavar="K")
    parser.add_argument("--vertices", default="1e6,1e7,1e8,1e9")
    parser.add_argument("--workers", type=numbers, default=[2**k for k in range(11)])
    for name, default in (("--task-overhead-ms", 5.0), ("--latency-ms", 0.5), ("--bandwidth-gbit", 10.0)):
        parser.add_argument(name, type=float, default=default)
    parser.add_argument("--output-dir", type=Path, default=Path())
    return parser.parse_args(words)


def main(words: Sequence[str] | None = None) -> None:
    arguments = parsed(words)
    network = Network(arguments.task_overhead_ms / 1e3, arguments.latency_ms / 1e3, arguments.bandwidth_gbit * 1e9 / 8)
    counts = sorted({*arguments.patches, *([arguments.validate] if arguments.validate else [])})
    first, target = arguments.meshes[0], arguments.target
    trace(pgcp.read_mesh(first), max(2, counts[0]), target)  # compiles what has to be
    by_mesh = [measure(path, counts, target, arguments.repeat) for path in arguments.meshes]
    model = fit_model([t for traces in by_mesh for t in traces], *process_bytes(first, target, by_mesh[0][0].vertices))
    print("fitted to " + ", ".join(f"{t.vertices} vertices in {t.patches}" for traces in by_mesh for t in traces))
    for kind, factors in (model.factors | model.driver).items():
        print(f"  {kind}: " + " ".join(f"{x:.2e}" for x in factors))
    run = next((t for t in by_mesh[0] if t.patches == arguments.validate), None)
    if run is not None:
        print(aligned(validation(first, run, model, target, arguments.repeat, network)))
    runs = [(float(v), w) for v in arguments.vertices.split(",") for w in arguments.workers]
    predictions = [predict(model, v, make_plan(int(v), 2 * int(v), w).patches, w, network) for v, w in runs]
    rows = table(predictions)
    print(aligned(rows))
    print("\n".join(bounds(predictions)))
    write_tsv(arguments.output_dir / "scaling.tsv", rows)
    draw(predictions, arguments.output_dir / "scaling.png")


if __name__ == "__main__":
    main()
