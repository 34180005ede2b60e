"""A directory of patch files that workers open by path: nothing the size of a patch goes through the scheduler."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from pgcp.files import replacing
from pgcp.types import Patch, PatchMap


@dataclass(frozen=True, slots=True)
class PatchStore:
    """Patches and their solved maps in one directory."""

    directory: Path

    def _path(self, kind: str, index: int) -> Path:
        return self.directory / f"{kind}-{index:05d}.npz"

    def write_patch(self, patch: Patch) -> None:
        """Store a patch."""
        arrays = {f.name: np.asarray(getattr(patch, f.name)) for f in fields(Patch)}
        with replacing(self._path("patch", patch.index)) as stream:
            np.savez(stream, **arrays)  # type: ignore[arg-type]

    def read_patch(self, index: int) -> Patch:
        """Load a patch."""
        with np.load(self._path("patch", index)) as data:
            arrays: dict[str, Any] = {f.name: data[f.name] for f in fields(Patch) if f.name != "index"}
        arrays["mollification"] = float(arrays["mollification"])
        return Patch(index=index, **arrays)

    def write_map(self, solved: PatchMap) -> None:
        """Store a solved map's arrays."""
        with replacing(self._path("map", solved.patch)) as stream:
            np.savez(stream, points=solved.points, mu=solved.mu)

    def read_map(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Load points and mu of a solved map."""
        with np.load(self._path("map", index)) as data:
            return data["points"], data["mu"]

    def _array_path(self, kind: str, index: int) -> Path:
        return self.directory / f"{kind}-{index:05d}.npy"

    def write_array(self, kind: str, index: int, array: np.ndarray) -> None:
        """Store one array of a kind."""
        with replacing(self._array_path(kind, index)) as stream:
            np.save(stream, array)

    def read_array(self, kind: str, index: int) -> Any:
        """Open an array where it lies, memory-mapped."""
        array: np.ndarray = np.load(self._array_path(kind, index), mmap_mode="r")
        return array

    def drop_array(self, kind: str, index: int) -> None:
        """Remove an array that nobody needs any more."""
        self._array_path(kind, index).unlink(missing_ok=True)
