"""What every task of a run needs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from pgcp.runtime.cache import FactorKey, Owner


@dataclass(frozen=True, slots=True)
class Job:
    """Whose factors a task keeps, the store, how to flatten and eliminate, and whether to store the patches' operators."""

    owner: Owner
    directory: Path
    flattener: str
    backend: str
    factor_cache_bytes: int
    stores_operators: bool = False

    def key(self, patch: int) -> FactorKey:
        """Under which a patch's factor is kept."""
        return FactorKey(self.owner, patch)

    def of_split(self, name: str) -> Job:
        """The job for one split of the mesh, with a directory of its own of that name."""
        return replace(self, owner=replace(self.owner, split=name), directory=self.directory / name)

    def for_use(self, use: str) -> Job:
        """The same patches for another use: its factors are not those of the others."""
        return replace(self, owner=replace(self.owner, use=use))
