"""A directory of files that workers open by path: nothing the size of a patch goes through the scheduler.

Patches, their curves and maps, and the unions that welds make are records: plain data in one .npz each, written whole or
not at all, with a checksum of every array that is looked at when it is read. What is in the store is finished: a run that
is resumed does not do it again.
"""

from __future__ import annotations

import errno
import io
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from pgcp.errors import LostFileError
from pgcp.io.files import replacing

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

    def find(self, kind: str, index: int, record: type[Record]) -> Record | None:
        """Load a record, or None where there is none that can be read."""
        if not self.has(kind, index):
            return None
        try:
            return self.read(kind, index, record)
        except LostFileError:
            return None

    def read_field(self, kind: str, index: int, name: str) -> Any:
        """Load one array of a record."""
        return self._arrays(kind, index, [name])[0]

    def _arrays(self, kind: str, index: int, names: list[str]) -> list[np.ndarray]:
        path = self._path(kind, index)
        with self._whole(path, kind, index), zipfile.ZipFile(path) as data:
            # read whole, so that the checksum is looked at before the header of an array is believed
            return [np.lib.format.read_array(io.BytesIO(data.read(f"{name}.npy"))) for name in names]

    @contextmanager
    def _whole(self, path: Path, kind: str, index: int) -> Iterator[None]:
        """Say of a file that cannot be read inside that it is lost, and remove it where it is spoiled."""
        try:
            yield
        except MemoryError:
            raise
        except Exception as problem:  # a spoiled file raises nearly anything
            if isinstance(problem, FileNotFoundError):
                what = "is missing"
            elif isinstance(problem, OSError) and problem.errno not in (None, errno.EINVAL):
                what = f"is not readable: {problem.strerror}"
            else:
                path.unlink(missing_ok=True)  # whoever resumes makes it again
                what = f"was spoiled: {problem}"
            raise LostFileError(f"{path}: a file of the store {what}", kind, index) from problem

    def drop(self, kind: str, index: int) -> None:
        """Remove a record."""
        self._path(kind, index).unlink(missing_ok=True)

    def _array_path(self, kind: str, index: int) -> Path:
        return self.directory / f"{kind}-{index:05d}.npy"

    def write_array(self, kind: str, index: int, array: np.ndarray) -> None:
        """Store one array of a kind."""
        with replacing(self._array_path(kind, index)) as stream:
            np.save(stream, array)

    def read_array(self, kind: str, index: int) -> Any:
        """Open an array where it lies, memory-mapped; raises LostFileError where it is missing or cut off."""
        path = self._array_path(kind, index)
        with self._whole(path, kind, index):
            array: np.ndarray = np.load(path, mmap_mode="r")
        return array

    def has_array(self, kind: str, index: int) -> bool:
        """Whether an array is there."""
        return self._array_path(kind, index).exists()

    def drop_array(self, kind: str, index: int) -> None:
        """Remove an array that nobody needs any more."""
        self._array_path(kind, index).unlink(missing_ok=True)
