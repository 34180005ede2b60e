"""A directory of files that workers open by path: nothing the size of a patch goes through the scheduler.

Patches, their curves and maps, and the unions that welds make are records: plain data in one .npz each, written whole or
not at all, with a checksum of every array that is looked at when it is read. What is in the store is finished: a run that
is resumed does not do it again.
"""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from pgcp.errors import LostFileError
from pgcp.files import replacing
from pgcp.types import Patch, PatchMap

Record = TypeVar("Record")


@dataclass(frozen=True, slots=True)
class PatchStore:
    """Records and arrays in one directory, each of a kind and with a number."""

    directory: Path

    def _path(self, kind: str, index: int) -> Path:
        return self.directory / f"{kind}-{index:05d}.npz"

    def has(self, kind: str, index: int) -> bool:
        """Whether a record is there."""
        return self._path(kind, index).exists()

    def write(self, kind: str, index: int, record: Any) -> None:
        """Store a dataclass of arrays and numbers."""
        arrays = {f.name: np.asarray(getattr(record, f.name)) for f in fields(record)}
        with replacing(self._path(kind, index)) as stream:
            np.savez(stream, **arrays)  # type: ignore[arg-type]

    def read(self, kind: str, index: int, record: type[Record]) -> Record:
        """Load a dataclass of arrays and numbers; raises LostFileError where the file is missing or spoiled."""
        names = [f.name for f in fields(record)]  # type: ignore[arg-type]
        arrays = zip(names, self._arrays(kind, index, names), strict=True)
        return record(**{name: array.item() if array.ndim == 0 else array for name, array in arrays})

    def read_field(self, kind: str, index: int, name: str) -> Any:
        """Load one array of a record."""
        return self._arrays(kind, index, [name])[0]

    def _arrays(self, kind: str, index: int, names: list[str]) -> list[np.ndarray]:
        path = self._path(kind, index)
        try:
            with np.load(path) as data:
                return [data[name] for name in names]
        except OSError as problem:
            what = "missing" if isinstance(problem, FileNotFoundError) else f"not readable: {problem.strerror}"
            raise LostFileError(f"{path}: a file of the store is {what}", kind, index) from problem
        except (ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as problem:
            path.unlink(missing_ok=True)  # whoever resumes makes it again
            raise LostFileError(f"{path}: a file of the store was spoiled: {problem}", kind, index) from problem

    def drop(self, kind: str, index: int) -> None:
        """Remove a record."""
        self._path(kind, index).unlink(missing_ok=True)

    def write_patch(self, patch: Patch) -> None:
        """Store a patch."""
        self.write("patch", patch.index, patch)

    def read_patch(self, index: int) -> Patch:
        """Load a patch."""
        return self.read("patch", index, Patch)

    def write_map(self, solved: PatchMap, name: str = "") -> None:
        """Store a solved map, of several under a name."""
        self.write(f"map{name}", solved.patch, solved)

    def read_map(self, index: int, name: str = "") -> PatchMap:
        """Load a solved map."""
        return self.read(f"map{name}", index, PatchMap)

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
