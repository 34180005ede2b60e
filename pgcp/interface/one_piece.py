"""A mesh's Laplacian eliminated in one piece, in this process: for a Laplacian that the patches do not have.

Where nearly all vertices are kept it stays sparse.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import csr_array

from pgcp.elimination.dirichlet import eliminate_interior
from pgcp.elimination.sparse_boundary import AnyFactor, SparseFactor, SparseSchur, stays_sparse
from pgcp.interface.puncture import Charts, alternated, opened_positions
from pgcp.patches.flatten import flatten_boundary
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray


class OnePieceFactor:
    """All vertices but ``kept`` (n_K,) eliminated from a Laplacian (n, n); methods as those of ``InterfaceFactor``.

    used (n,): vertices that some face uses, of an open surface: where nearly all of them are kept, nothing is eliminated.
    """

    def __init__(
        self, laplacian: csr_array, kept: IntArray, backend: str, flattener: str, used: BoolArray | None = None
    ) -> None:
        self._kept, self._flattener = kept, flattener
        self._factor: AnyFactor
        if used is not None and stays_sparse(len(kept), laplacian.shape[0]):
            self._factor = SparseFactor(laplacian, kept, used)
        else:
            self._factor = eliminate_interior(laplacian, kept, backend)

    def free_boundary(self, positions: FloatArray) -> ComplexArray:
        """Free conformal positions z (n_K,) of the kept vertices, a disk's boundary; positions (n_K, 3) on the surface."""
        return flatten_boundary(self._factor.schur, positions, self._flattener)

    @property
    def _dense(self) -> FloatArray:
        assert not isinstance(self._factor.schur, SparseSchur)
        return self._factor.schur

    def opened_positions(self) -> ComplexArray:
        """Planar positions z (n_K,) of the kept vertices of an opened surface."""
        return opened_positions(self._dense)

    def alternated(self, charts: Charts) -> Charts:
        """Kept vertices of an opened surface, harmonic in two charts."""
        return alternated(charts, self._dense)

    def extend(self, boundary_values: ComplexArray) -> ComplexArray:
        """Values (n,) of the discrete harmonic function with the given values at kept vertices (n_K,)."""
        return self._factor.extend(np.asarray(boundary_values, np.complex128))

    def release(self) -> None:
        """Free the factor."""
        self._factor.release()

    def record(self) -> dict[str, Any]:
        """What the report says of it."""
        return {"vertices": len(self._kept), "bytes": 8 * len(self._kept) ** 2, "levels": []}
