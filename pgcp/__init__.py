"""Parallel global conformal maps of huge triangle meshes by partial welding.

    import pgcp
    result = pgcp.parameterize("bust.ply", patches=6, workers=2)
    result.coordinates      # (V, 2), in the order of the file's vertices

Names are imported when they are first used, so that the command answers at once.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from pgcp.runtime.compiled import find_cache

if TYPE_CHECKING:
    from pgcp.api import check_mesh, compare, compute, parameterize
    from pgcp.errors import (
        BadFileError,
        BlurredError,
        CrowdedError,
        DegenerateError,
        FoldError,
        InputError,
        LostFileError,
        NotManifoldError,
        NotSimplyConnectedError,
        NumericalError,
        PartitionInputError,
        PgcpError,
        SolveFailedError,
        StoppedError,
        WeldFailedError,
    )
    from pgcp.io.read import read_mesh
    from pgcp.io.write import write_mesh
    from pgcp.options import Options, Running
    from pgcp.result import Result
    from pgcp.types import Mesh, Parameterization, Quality

find_cache()
__version__ = "0.1.0"
__all__ = [
    "BadFileError",
    "BlurredError",
    "CrowdedError",
    "DegenerateError",
    "FoldError",
    "InputError",
    "LostFileError",
    "Mesh",
    "NotManifoldError",
    "NotSimplyConnectedError",
    "NumericalError",
    "Options",
    "Parameterization",
    "PartitionInputError",
    "PgcpError",
    "Quality",
    "Result",
    "Running",
    "SolveFailedError",
    "StoppedError",
    "WeldFailedError",
    "check_mesh",
    "compare",
    "compute",
    "parameterize",
    "read_mesh",
    "write_mesh",
]
_HOMES = {
    "read_mesh": "io.read",
    "write_mesh": "io.write",
    "Options": "options",
    "Running": "options",
    "check_mesh": "api",
    "compare": "api",
    "compute": "api",
    "parameterize": "api",
    "Result": "result",
    "Mesh": "types",
    "Parameterization": "types",
    "Quality": "types",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'pgcp' has no attribute {name!r}")
    return getattr(importlib.import_module(f"pgcp.{_HOMES.get(name, 'errors')}"), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
