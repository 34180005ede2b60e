"""Worker processes on this machine, and clients of schedulers that run elsewhere."""

from __future__ import annotations

import logging
import multiprocessing
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pgcp.errors import InputError
from pgcp.runtime.forks import FORKS, WORKER_ENVIRONMENT, interrupts_for_this_process_only, scratch

_ANSWER_S = "10s"
_QUIET = {  # what dask does beside tasks a hundred times a second, on the processors that they need
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
}


@dataclass(frozen=True, slots=True)
class Security:
    """Files for TLS: certificate of the authority, own certificate and key, all PEM."""

    ca: Path
    certificate: Path
    key: Path


def check_that_workers_can_start() -> None:
    """Raise InputError where the main script is no file that worker processes could import."""
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        # this is such a process, importing a script that starts workers without asking whether it is the main one
        raise SystemExit(1)
    script = _script()
    if script is not None and not script.exists():
        raise InputError(f"worker processes import the main script, but {script} is no file; put it into one or use workers=0")


def _script() -> Path | None:
    """The file that worker processes import as the main module, if they do."""
    main = sys.modules["__main__"]
    name = getattr(main, "__file__", None)
    return None if name is None or getattr(main, "__spec__", None) is not None else Path(name)


def start_cluster(workers: int) -> Any:
    """Start worker processes, a LocalCluster reached from this machine only.

    Raises InputError where the main script does not let them. ``prepare_forks`` called before makes it faster.
    """
    import dask
    import distributed.utils
    from distributed import LocalCluster

    settings: dict[str, Any] = {f"distributed.nanny.pre-spawn-environ.{name}": v for name, v in WORKER_ENVIRONMENT.items()}
    settings |= _QUIET
    settings["temporary-directory"] = str(scratch())
    if FORKS and hasattr(distributed.utils, "get_mp_context"):  # an older dask cannot be told so late
        settings["distributed.worker.multiprocessing-method"] = "forkserver"
    try:
        with interrupts_for_this_process_only(), dask.config.set(settings):
            return LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
                local_directory=str(scratch()),
            )
    except RuntimeError as problem:
        script = _script()
        if script is None or "failed to start" not in str(problem):
            raise
        unguarded = "__main__" not in script.read_text(encoding="utf-8", errors="replace")
        raise InputError(
            f"the worker processes did not start ({str(problem).rstrip('.')}); they import {script}, whose work must stand "
            'under `if __name__ == "__main__":`, or use workers=0'
        ) from (None if unguarded else problem)


@contextmanager
def silenced() -> Iterator[None]:
    """Have dask log nothing of workers and schedulers that come and go: errors say what matters."""
    import distributed  # noqa: F401  # it sets levels of its own

    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def checked_client(client: Any) -> Any:
    """The same client; raises InputError for what is none, or none that can be used."""
    from distributed import Client

    if not isinstance(client, Client):
        raise InputError(f"client is {client!r}, it must be a dask.distributed.Client (of a cluster, its get_client())")
    if client.asynchronous:
        raise InputError("client is asynchronous; give one made with asynchronous=False")
    if client.status != "running":
        raise InputError(f"client is {client.status}; give one that is connected to its scheduler")
    return client


def at_scheduler(scheduler: str | None, scheduler_file: Path | None, security: Security | None) -> Any:
    """A client of a running scheduler; raises InputError where none answers."""
    from distributed import Client
    from distributed.security import Security as DaskSecurity

    where = scheduler or scheduler_file
    if security is None and scheduler is not None and scheduler.startswith("tls://"):
        raise InputError(f"the scheduler at {scheduler} speaks TLS; give --tls-ca, --tls-cert and --tls-key")
    options: dict[str, Any] = {}
    if security is not None:
        files = (str(security.ca), str(security.certificate), str(security.key))
        names = ("tls_ca_file", "tls_client_cert", "tls_client_key")
        options["security"] = DaskSecurity(require_encryption=True, **dict(zip(names, files, strict=True)))
    try:
        return Client(
            address=scheduler, scheduler_file=str(scheduler_file) if scheduler_file else None, timeout=_ANSWER_S, **options
        )
    except (OSError, ValueError, RuntimeError, TypeError) as problem:
        raise InputError(f"no dask scheduler answers at {where}: {problem}") from problem
