"""The key and the directory of a run: what a later run can take up."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np

from pgcp.errors import InputError, NumericalError, StoppedError
from pgcp.options import Options, Running, plain_options
from pgcp.parallel import at_once
from pgcp.runtime.run_directory import run_directory
from pgcp.runtime.versions import package_versions
from pgcp.types import IntArray, Mesh

_STORE_FORMAT = 2


def _digest(array: np.ndarray) -> bytes:
    digest = hashlib.blake2b(f"{array.shape} {array.dtype}".encode())
    digest.update(array.view(np.uint8).data)
    return digest.digest()


def run_key(mesh: Mesh, options: Options, cuts: IntArray | None, patch_count: int, backend: str) -> str:
    """What a run's results depend on, in short: mesh, cut edges, options that matter, versions. Stores are named by it."""
    digest = hashlib.blake2b(digest_size=12)
    digest.update(
        json.dumps([plain_options(options), patch_count, backend, package_versions(), _STORE_FORMAT], sort_keys=True).encode()
    )
    if cuts is not None:
        digest.update(cuts.tobytes())
    for array_digest in at_once(*(partial(_digest, array) for array in (mesh.vertices, mesh.faces))):
        digest.update(array_digest)
    return digest.hexdigest()


@contextmanager
def resumable(running: Running, key: str) -> Iterator[Path]:
    """The run's directory, kept where the run can be resumed; the error then says so."""
    with run_directory(running.store, key, running.resume) as directory:
        try:
            yield directory.path
        except (StoppedError, OSError) as problem:
            directory.keep = any(directory.path.glob("*/*-*.npz"))
            if isinstance(problem, StoppedError) and directory.keep:
                where = f"what is finished is kept in {directory.path}; run again with --resume"
                raise StoppedError(f"{problem}; {where}") from problem
            raise
        except (InputError, NumericalError):
            raise
        except BaseException:
            directory.keep = running.resume
            raise
