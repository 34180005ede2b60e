"""Surfaces of a folder, and what runs of PGCP on them came to: kept in a file, so that nothing is measured twice."""

from __future__ import annotations

import datetime
import json
import math
import os
import platform
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from speedup import measure_started

import pgcp
from pgcp.io.files import replacing
from pgcp.runtime.versions import package_versions
from pgcp.surface.distortion import angle_errors, conformal_energy
from pgcp.targets.registry import TARGETS

_RUNS = 3  # whose median counts where numbers of subdomains are compared
_OPTIONS = {one.name for one in fields(pgcp.Options)}


@dataclass(frozen=True, slots=True)
class Surface:
    """A mesh that can be mapped: its file's name without suffix, how many vertices, whether it is closed."""

    name: str
    vertices: int
    closed: bool


@dataclass(slots=True)
class Results:
    """All that was measured: surfaces, runs by key, and where."""

    surfaces: dict[str, Surface] = field(default_factory=dict)
    runs: dict[str, dict[str, Any]] = field(default_factory=dict)
    machine: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path | None) -> Results:
        """What a file holds; nothing where there is none."""
        if path is None or not path.exists():
            return cls()
        data = json.loads(path.read_text(encoding="utf-8"))
        surfaces = {one["name"]: Surface(**one) for one in data["surfaces"]}
        return cls(surfaces, data["runs"], data["machine"])

    def write(self, path: Path | None) -> None:
        """Write the file, whole or not at all."""
        if path is None:
            return
        data = {"machine": self.machine, "surfaces": [asdict(one) for one in self.surfaces.values()], "runs": self.runs}
        with replacing(path) as stream:
            stream.write(json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False).encode())

    def run(self, surface: Surface, target: str, options: Mapping[str, Any]) -> dict[str, Any] | None:
        """What a run came to, None where it was not measured."""
        return self.runs.get(key_of(surface, target, options))


def key_of(surface: Surface, target: str, options: Mapping[str, Any]) -> str:
    """One run's name in the file."""
    return f"{surface.name}, {surface.vertices}, {target}, {json.dumps(dict(options), sort_keys=True)}"


def is_closed(target: str) -> bool:
    """Whether a target is for closed surfaces."""
    return TARGETS.get(target).space.closed


def find_surfaces(folders: Iterable[Path], limit: int | None) -> dict[Surface, Path]:
    """Meshes of folders with at most so many vertices that PGCP takes, the smallest first, and their files."""
    out: dict[Surface, Path] = {}
    for path in (path for folder in folders for path in sorted(folder.iterdir()) if path.is_file()):
        with suppress(pgcp.InputError):
            mesh = pgcp.read_mesh(path)
            if limit is None or len(mesh.vertices) <= limit:
                out[Surface(path.stem, len(mesh.vertices), pgcp.check_mesh(mesh).is_sphere)] = path
    return dict(sorted(out.items(), key=lambda item: item[0].vertices))


def machine() -> dict[str, Any]:
    """Processor, how many, and versions."""
    name = platform.processor() or platform.machine()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        name = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), name)
    return {"processor": name, "processors": processors(), "system": platform.system(), "versions": package_versions()}


def processors() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def disk_energy(result: pgcp.Parameterization) -> float | None:
    """Conformal energy (CCEM eq. 2.4, 3.4) of a map to the plane, scaled to the area of the unit disk; None on the sphere."""
    if result.coordinates_name != "uv":
        return None
    z = result.coordinates @ np.array([1.0, 1j])
    a, b, c = z[result.mesh.faces].T
    area = 0.5 * float(np.imag(np.conj(b - a) * (c - a)).sum())
    energy = conformal_energy(result.mesh, z)
    scaled = energy if result.quality.conformal_energy is not None else energy * math.pi / area
    return scaled if area > 0 else None


def iterations(steps: Sequence[Mapping[str, Any]]) -> int | None:
    """How many iterations the method made, without those of another that it started from; None of one that has none."""
    own = [step for step in steps if step.get("method") == steps[-1].get("method")]
    return max((step["iteration"] for step in own if "iteration" in step), default=None)


def figures(result: pgcp.Parameterization) -> dict[str, Any]:
    """Measures of a map, by the names that printed columns have; angles in degrees."""
    quality, fallback = result.quality, result.report["fallback"]
    low, high = np.percentile(angle_errors(result.mesh, result.coordinates), [25, 75])
    measures = {
        "mean": quality.angle_mean_deg,
        "sd": quality.angle_sd_deg,
        "median": quality.angle_median_deg,
        "iqr": float(high - low),
        "area": quality.log_area_mean,
        "folds": quality.folds,
        "energy": disk_energy(result),
        "iterations": iterations(result.report["iterations"] or []),
    }
    finite = {name: value if value is not None and math.isfinite(value) else None for name, value in measures.items()}
    return {**finite, "remark": f"mapped to {fallback['to']} instead: {fallback['reason']}" if fallback else ""}


@contextmanager
def at_most(seconds: float | None) -> Iterator[None]:
    """Stop what is inside after so many seconds with a TimeoutError, where the system has such an alarm."""

    def stop(*_: Any) -> None:
        raise TimeoutError(f"stopped after {seconds:g} seconds")

    if seconds is None or not hasattr(signal, "setitimer"):
        yield
        return
    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def run_once(mesh: pgcp.Mesh, target: str, options: Mapping[str, Any], patience: float | None = None) -> dict[str, Any]:
    """Seconds and measures of one run, or why there is no map; patience: the most seconds that it may take."""
    known = {name: value for name, value in options.items() if name in _OPTIONS}
    own = {name: value for name, value in options.items() if name not in _OPTIONS}
    start = time.perf_counter()
    try:
        with at_most(patience):
            result = pgcp.compute(mesh, pgcp.Options(target=target, **known, own=own))
    except (pgcp.PgcpError, TimeoutError) as problem:
        return {"seconds": time.perf_counter() - start, "problem": str(problem)}
    return {"seconds": time.perf_counter() - start, **figures(result)}


def run_speedup(path: Path, target: str, count: int) -> dict[str, Any]:
    """Median seconds of a run with so many patches, on as many started workers as far as there are processors."""
    workers = min(count, processors())
    try:
        (run,) = measure_started(path, [count], workers, target, _RUNS)
    except (pgcp.PgcpError, SystemExit) as problem:
        return {"problem": str(problem)}
    return {"seconds": run.seconds, "workers": workers}


Job = tuple[Surface, str, Mapping[str, Any]]


class Measuring:
    """Runs what is asked for and not yet measured; every combination of target and options once before, uncounted."""

    def __init__(
        self, files: Mapping[Surface, Path], results: Results, repeat: int, patience: float | None, say: Callable[[str], None]
    ) -> None:
        self._files, self._results, self._repeat, self._patience, self._say = files, results, repeat, patience, say
        self._warm: set[str] = set()

    def run(self, jobs: Iterable[Job], path: Path | None) -> None:
        """Measure, the smallest surfaces first; the file is written after every run."""
        missing = {key_of(*job): job for job in jobs if job[0] in self._files and self._results.run(*job) is None}
        ordered = sorted(missing.items(), key=lambda item: item[1][0].vertices)
        for number, (key, job) in enumerate(ordered):
            self._say(f"{number + 1} of {len(ordered)}: {key}")
            self._results.runs[key] = {**self._measured(*job), **_now()}
            self._results.write(path)

    def _measured(self, surface: Surface, target: str, options: Mapping[str, Any]) -> dict[str, Any]:
        if "workers" in options:
            return run_speedup(self._files[surface], target, options["patches"])
        self._warm_up(target, options)
        mesh = pgcp.read_mesh(self._files[surface])
        runs = [run_once(mesh, target, options, self._patience) for _ in range(self._repeat)]
        return min(runs, key=lambda run: run["seconds"])

    def _warm_up(self, target: str, options: Mapping[str, Any]) -> None:
        kind = f"{target} {json.dumps(dict(options), sort_keys=True)}"
        if kind not in self._warm:
            self._warm.add(kind)
            smallest = next(surface for surface in self._files if surface.closed == is_closed(target))
            run_once(pgcp.read_mesh(self._files[smallest]), target, options, self._patience)


def _now() -> dict[str, Any]:
    """When it is, and how much runs on this machine."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    return {"date": datetime.datetime.now(datetime.timezone.utc).date().isoformat(), "load": round(load, 1)}


def say(line: str) -> None:
    """A line on what goes on, beside the output."""
    print(line, file=sys.stderr, flush=True)
