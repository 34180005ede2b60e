"""Parallel global conformal maps of huge triangle meshes by partial welding.

import pgcp
result = pgcp.parameterize("bust.ply", patches=6, workers=2)
result.coordinates      # (V, 2), in the order of the file's vertices
"""

from __future__ import annotations

from pgcp.errors import (
    BadFileError,
    DegenerateError,
    FoldError,
    InputError,
    NotManifoldError,
    NotSimplyConnectedError,
    NumericalError,
    PartitionInputError,
    PgcpError,
    SolveFailedError,
    WeldFailedError,
)
from pgcp.io import read_mesh, write_mesh
from pgcp.options import Options
from pgcp.pipeline import check_mesh, compute, parameterize
from pgcp.types import Mesh, Parameterization, Quality

__version__ = "0.1.0"
__all__ = [
    "BadFileError",
    "DegenerateError",
    "FoldError",
    "InputError",
    "Mesh",
    "NotManifoldError",
    "NotSimplyConnectedError",
    "NumericalError",
    "Options",
    "Parameterization",
    "PartitionInputError",
    "PgcpError",
    "Quality",
    "SolveFailedError",
    "WeldFailedError",
    "check_mesh",
    "compute",
    "parameterize",
    "read_mesh",
    "write_mesh",
]
