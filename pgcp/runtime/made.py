"""Arrays in the store, with a digest of what they were made from and a checksum of each."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgcp.errors import LostFileError
from pgcp.runtime.store import PatchStore
from pgcp.types import IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """Of arrays in the store: a digest of what they were made from, and a checksum of each."""

    digest: str
    sums: IntArray


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


def store_made(store: PatchStore, kind: str, index: int, digest: str, arrays: dict[str, np.ndarray]) -> None:
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
