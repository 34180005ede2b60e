"""Factors that a process keeps between the passes of a run."""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from dataclasses import dataclass
from typing import Any, Protocol

_REMEMBERED = 100  # ended runs, remembered so that late tasks cache nothing


class Held(Protocol):
    """What can be kept: it has a size, and can be freed."""

    @property
    def nbytes(self) -> int:
        """Bytes it takes."""
        ...

    def release(self) -> None:
        """Free it."""
        ...


@dataclass(frozen=True, slots=True)
class Owner:
    """Whose factors are kept: those of one run, one split of its mesh, and one use, such as a pass through the patches."""

    run: str
    split: str = ""
    use: str = ""


@dataclass(frozen=True, slots=True)
class FactorKey:
    """The factor of one patch."""

    owner: Owner
    patch: int


class FactorCache:
    """Factors kept between the passes, bounded in bytes. One per process."""

    def __init__(self) -> None:
        self._held: OrderedDict[FactorKey, Held] = OrderedDict()
        self._ended: deque[str] = deque(maxlen=_REMEMBERED)
        self._lock = threading.Lock()

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return sum(factor.nbytes for factor in self._held.values())

    def put(self, key: FactorKey, factor: Held, limit_bytes: int) -> bool:
        """Keep a factor where there is room for it beside those of its owner; those of others give way, oldest first.

        Returns whether it is kept. Nothing is kept for a run that has ended.
        """
        with self._lock:
            before = self._held.pop(key, None)
            if before is not None and before is not factor:
                before.release()
            has_ended = key.owner.run in self._ended
            if has_ended or not getattr(factor, "is_whole", True) or factor.nbytes > self._room(key.owner, limit_bytes):
                factor.release()
                return False
            self._held[key] = factor
            for other in [other for other in self._held if other.owner != key.owner]:
                if self.nbytes > limit_bytes:
                    self._held.pop(other).release()
            return True

    def _room(self, owner: Owner, limit_bytes: int) -> int:
        return limit_bytes - sum(factor.nbytes for key, factor in self._held.items() if key.owner == owner)

    def has_room(self, owner: Owner, limit_bytes: int, nbytes: int) -> bool:
        """Whether a factor of so many bytes would be kept."""
        with self._lock:
            return nbytes <= self._room(owner, limit_bytes)

    def holds(self, key: FactorKey) -> bool:
        """Whether a factor is held."""
        with self._lock:
            return key in self._held

    def take(self, key: FactorKey) -> Any:
        """Remove and return a factor, or None where it is not held."""
        with self._lock:
            return self._held.pop(key, None)

    def drop(self, run: str) -> None:
        """Free all factors of a run, and keep none for it from now on."""
        with self._lock:
            self._ended.append(run)
            for key in [key for key in self._held if key.owner.run == run]:
                self._held.pop(key).release()


FACTORS = FactorCache()


def drop_run(run: str) -> None:
    """Free what this process still holds of a run."""
    FACTORS.drop(run)
