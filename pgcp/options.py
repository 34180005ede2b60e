"""What a run can be told, checked once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pgcp.errors import InputError

TARGETS = ("auto", "free", "disk", "sphere")
MOEBIUS = ("auto", "none", "area", "angle")
REPAIRS = ("relax", "compose", "average", "untangle", "embed")
FLATTENERS = ("dncp", "scp")
METHODS = ("pgcp", "dncp", "scp", "cdcp", "cem", "ccem")
DISK_METHODS = ("cdcp", "cem", "ccem")
SEAMS = ("weld", "relax", "exact")
# where and how a run runs: its results do not depend on these
RUNNING = frozenset(
    [
        "workers",
        "scheduler",
        "scheduler_file",
        "store",
        "factor_cache_bytes",
        "memory_limit_bytes",
        "resume",
        "tls_ca",
        "tls_cert",
        "tls_key",
    ]
)
_LEAST_MEMORY = 10**9


@dataclass(frozen=True, slots=True)
class Options:
    """Options of a run.

    patches: how many, None for what ``pgcp.plan`` chooses by vertices, workers and memory; workers: 0 for threads of this
    process, else processes on this machine, which is then the number of processors in use;
    target: free, disk or sphere, or auto for free on an open and sphere on a closed surface; centre: vertex that goes to
    the centre of the disk or the north pole of the sphere; moebius: correction of the finished map, none, least area
    distortion, least angle error (disk), or auto for what serves the target;
    scheduler or scheduler_file: a running dask cluster; cuts: a file of cut edges; repair_cuts: mend parts that are
    no disks; method: pgcp, or dncp, scp (free boundary), cdcp, cem, ccem (disk) of the undivided mesh; flatten: dncp or scp;
    seams: weld, relax (welded boundary held, seams solved) or exact (no weld); backend: auto, nested,
    pardiso or superlu; seed: of the partition; store: directory shared with the workers; repairs: which tiers may take folds
    away; no_overlap: where a free map overlaps itself, map to the disk instead; factor_cache_bytes: what factors one process
    may keep between the passes, None for 1.5 GB or what the memory limit leaves; memory_limit_bytes: of all processes together;
    fix: repair the topology of a mesh that the target does not fit; resume: take up what an earlier run of the same mesh and
    options has finished, and keep what this one has when it is interrupted; tls_ca, tls_cert, tls_key: PEM files for a
    scheduler with TLS.
    """

    patches: int | None = None
    workers: int = 0
    target: str = "auto"
    centre: int | None = None
    moebius: str = "auto"
    scheduler: str | None = None
    scheduler_file: Path | None = None
    cuts: Path | None = None
    repair_cuts: bool = False
    method: str = "pgcp"
    flatten: str = "dncp"
    seams: str = "weld"
    backend: str = "auto"
    seed: int = 0
    store: Path | None = None
    repairs: tuple[str, ...] = REPAIRS
    no_overlap: bool = False
    factor_cache_bytes: int | None = None
    memory_limit_bytes: int | None = None
    fix: bool = False
    resume: bool = False
    tls_ca: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None

    @property
    def tls_files(self) -> tuple[Path, Path, Path] | None:
        """Authority, certificate and key where the scheduler is reached by TLS."""
        if self.tls_ca is None or self.tls_cert is None or self.tls_key is None:
            return None
        return self.tls_ca, self.tls_cert, self.tls_key

    @property
    def starts_workers(self) -> bool:
        """Whether the run has worker processes of its own."""
        return self.workers > 0 and self.scheduler is None and self.scheduler_file is None

    def __post_init__(self) -> None:
        if self.patches is not None and self.patches < 1:
            raise InputError(f"patches is {self.patches}, it must be at least 1")
        if self.workers < 0:
            raise InputError(f"workers is {self.workers}, it must be 0 (none) or more")
        if self.seed < 0:
            raise InputError(f"seed is {self.seed}, it must be 0 or more")
        if self.target not in TARGETS:
            raise InputError(f"unknown target {self.target!r}; choose from {', '.join(TARGETS)}")
        if self.moebius not in MOEBIUS:
            raise InputError(f"unknown Moebius correction {self.moebius!r}; choose from {', '.join(MOEBIUS)}")
        if self.centre is not None and self.centre < 0:
            raise InputError(f"centre is vertex {self.centre}, it must be 0 or more")
        if self.method not in METHODS:
            raise InputError(f"unknown method {self.method!r}; choose from {', '.join(METHODS)}")
        wanted = "disk" if self.method in DISK_METHODS else "free"
        if self.method != "pgcp" and self.target not in ("auto", wanted):
            raise InputError(f"the method {self.method} is one for the target {wanted}, not {self.target}")
        if self.method != "pgcp" and self.seams != "weld":
            raise InputError(f"the method {self.method} has no welds to choose seams for; seams goes with the method pgcp")
        if self.flatten not in FLATTENERS:
            raise InputError(f"unknown flattening {self.flatten!r}; choose from {', '.join(FLATTENERS)}")
        if self.seams not in SEAMS:
            raise InputError(f"unknown treatment of seams {self.seams!r}; choose from {', '.join(SEAMS)}")
        if self.scheduler is not None and self.scheduler_file is not None:
            raise InputError("give a scheduler address or a scheduler file, not both")
        given = [path is not None for path in (self.tls_ca, self.tls_cert, self.tls_key)]
        if any(given) and not all(given):
            raise InputError("TLS needs all three of tls_ca, tls_cert and tls_key")
        if any(given) and self.scheduler is None and self.scheduler_file is None:
            raise InputError("TLS goes with a running scheduler: workers on this machine listen to this machine only")
        unknown = [name for name in self.repairs if name not in REPAIRS]
        if unknown:
            raise InputError(f"unknown repair {unknown[0]!r}; choose from {', '.join(REPAIRS)}")
        if self.no_overlap and self.target in ("disk", "sphere"):
            raise InputError(f"a map to the {self.target} does not overlap itself; no_overlap goes with the target free")
        if self.memory_limit_bytes is not None and self.memory_limit_bytes < _LEAST_MEMORY:
            raise InputError(f"the memory limit is {self.memory_limit_bytes} bytes, it must be at least {_LEAST_MEMORY}")
        if self.factor_cache_bytes is not None and self.factor_cache_bytes < 0:
            raise InputError(f"factor_cache_bytes is {self.factor_cache_bytes}, it must be 0 or more")
