"""Errors that a caller can act on.

PgcpError
|- InputError(ValueError)            exit status 2
|  |- BadFileError                   the file cannot be read as a mesh
|  |- NotManifoldError               an edge or a vertex is not manifold, or faces disagree in orientation
|  |- NotSimplyConnectedError        genus, several boundary loops, several components, closed
|  |- DegenerateError                the geometry carries no conformal structure
|  `- PartitionInputError            cut edges or a patch count that give no valid patches
|- NumericalError(ArithmeticError)   exit status 3
|  |- SolveFailedError               a factorization or a solve failed
|  |- WeldFailedError                two patches could not be welded
|  |- CrowdedError                   parts of the surface are too long and thin for the target
|  `- FoldError                      the finished map has folded faces
`- StoppedError(RuntimeError)        exit status 4
   `- LostFileError                  a file of the store is missing or spoiled
"""

from __future__ import annotations

from typing import Any


class PgcpError(Exception):
    """Base of every error this package raises on purpose."""


class InputError(PgcpError, ValueError):
    """The input, or the way it was asked to be handled, cannot give a map."""


class BadFileError(InputError):
    """A file cannot be read as a triangle mesh."""


class NotManifoldError(InputError):
    """An edge or a vertex is not manifold, or faces disagree in orientation."""


class NotSimplyConnectedError(InputError):
    """The surface is not a disk (or, for closed targets, not a sphere)."""


class DegenerateError(InputError):
    """The geometry carries no conformal structure (zero area, not finite)."""


class PartitionInputError(InputError):
    """The cut edges or the patch count asked for give no valid patches."""


class NumericalError(PgcpError, ArithmeticError):
    """The input is valid but a numerical step failed."""


class SolveFailedError(NumericalError):
    """A factorization or a linear solve failed or gave values that are not finite."""


class WeldFailedError(NumericalError):
    """Two boundary curves could not be welded."""


class BlurredError(WeldFailedError):
    """Points of welded patches come so close that double precision cannot tell them apart."""


class CrowdedError(NumericalError):
    """Parts of the surface are so long and thin that the target has no room for them in double precision."""


class FoldError(NumericalError):
    """The finished map has folded faces; ``result`` holds it."""

    def __init__(self, message: str, result: Any = None) -> None:
        super().__init__(message, result)

    def __str__(self) -> str:
        return str(self.args[0])

    @property
    def result(self) -> Any:
        """The map with its folds, or None."""
        return self.args[1]


class StoppedError(PgcpError, RuntimeError):
    """Workers, scheduler or store did not let the run finish; what is finished is kept, and the run can be resumed."""


class LostFileError(StoppedError):
    """A file of the store is missing or spoiled; ``kind`` and ``index`` say which."""

    def __init__(self, message: str, kind: str = "", index: int = -1) -> None:
        super().__init__(message, kind, index)

    def __str__(self) -> str:
        return str(self.args[0])

    @property
    def kind(self) -> str:
        """What it holds."""
        return str(self.args[1])

    @property
    def index(self) -> int:
        """Of which patch or union."""
        return int(self.args[2])
