#!/usr/bin/env python3
"""Other ways to map or solve one mesh, each in a process of its own: contestants of benchmark.py.

usage: contestants.py NAME MESH OUT [--threads 2]
Maps or solves MESH and writes the seconds of its parts to OUT, a JSON file. For the names see benchmark.py.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.sparse import block_array, coo_array, csr_array, triu
from scipy.sparse.linalg import splu

import pgcp
from pgcp.elimination import pardiso
from pgcp.surface.operators import cotangent_laplacian
from pgcp.surface.topology import examine

KNOWN = ("pardiso", "pardiso3", "scipy", "lscm")
OPEN_ONLY = ("scipy", "lscm")
SOLVE_ONLY = ("analysis", "factor", "substitute")
_RESIDUAL = 1e-6


class Stopwatch:
    """Seconds of named parts."""

    def __init__(self) -> None:
        self.parts: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """Give the time since the last lap to a part."""
        now = time.perf_counter()
        self.parts[name] = now - self._last
        self._last = now


class Pardiso:
    """One symmetric positive definite system in MKL PARDISO; order 2 is METIS, 3 the parallel METIS."""

    def __init__(self, matrix: csr_array, order: int, threads: int) -> None:
        upper = csr_array(triu(matrix, format="csr"))
        upper.sort_indices()
        self._size = upper.shape[0]
        self._values = np.ascontiguousarray(upper.data, np.float64)
        self._starts, self._columns = upper.indptr.astype(np.int32), upper.indices.astype(np.int32)
        self._handle, self._settings = np.zeros(64, np.int64), np.zeros(64, np.int32)
        self._settings[[0, 1, 9, 34]] = 1, order, 8, 1  # no defaults; ordering; pivots perturbed by 1e-8; indices from zero
        self._order = np.zeros(self._size, np.int32)
        self._library = pardiso.runtime()
        self._library.MKL_Set_Num_Threads(ctypes.c_int(threads))

    def call(self, phase: int, right: np.ndarray, solution: np.ndarray) -> None:
        """Run a phase: 11 analysis, 22 factorization, 33 solve; right and solution (2, n)."""
        numbers = [ctypes.c_int32(v) for v in (1, 1, 2, phase, self._size, 2, 0, 0)]
        factors, matrix, kind, what, size, columns, quiet, status = (ctypes.byref(v) for v in numbers)

        def at(array: np.ndarray) -> ctypes.c_void_p:
            return ctypes.c_void_p(array.ctypes.data)

        self._library.pardiso(
            at(self._handle), factors, matrix, kind, what, size, at(self._values), at(self._starts), at(self._columns),
            at(self._order), columns, at(self._settings), quiet, at(right), at(solution), status,
        )  # fmt: skip
        if numbers[-1].value:
            raise SystemExit(f"PARDISO stopped in phase {phase} with {numbers[-1].value}")


def held_values(mesh: pgcp.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Vertices that are held and where (n, 2): the boundary around a circle, or the first vertex of a closed mesh at 1."""
    loops = examine(mesh.faces, len(mesh.vertices)).loops
    if not loops:
        return np.array([0]), np.ones((1, 2))
    along = np.linalg.norm(np.roll(mesh.vertices[loops[0]], -1, axis=0) - mesh.vertices[loops[0]], axis=1)
    angle = 2 * np.pi * (np.cumsum(along) - along) / along.sum()
    return np.asarray(loops[0]), np.column_stack([np.cos(angle), np.sin(angle)])


def solve_by_pardiso(path: Path, watch: Stopwatch, order: int, threads: int) -> np.ndarray:
    """The yardstick: the harmonic map (V, 2) with the boundary on a circle."""
    mesh = pgcp.read_mesh(path)
    watch.lap("read")
    laplacian = cotangent_laplacian(mesh.vertices, mesh.faces)
    held, values = held_values(mesh)
    inside = np.setdiff1d(np.arange(len(mesh.vertices)), held)
    matrix = csr_array(laplacian[inside][:, inside])
    right = np.ascontiguousarray(-(laplacian[inside][:, held] @ values).T)
    solution = np.zeros_like(right)
    solver = Pardiso(matrix, order, threads)
    watch.lap("matrix")
    for name, phase in zip(SOLVE_ONLY, (11, 22, 33), strict=True):
        solver.call(phase, right, solution)
        watch.lap(name)
    residual = np.abs(matrix @ solution.T - right.T).max() / np.abs(right).max()
    if not residual < _RESIDUAL:
        raise SystemExit(f"PARDISO left a residual of {residual:.1e}")
    out = np.zeros((len(mesh.vertices), 2))
    out[held], out[inside] = values, solution.T
    return out


def dncp(mesh: pgcp.Mesh, watch: Stopwatch) -> np.ndarray:
    """Discrete natural conformal map (V, 2) of an open mesh in one piece, two boundary vertices pinned (PGCP section 4.2).

    The energy 1/2 x'Lx + 1/2 y'Ly - area, area = x'Ky with K = 1/2, -1/2 along boundary edges, is least where its gradient
    is zero.
    """
    count = len(mesh.vertices)
    loop = np.asarray(examine(mesh.faces, count).loops[0])
    after = np.roll(loop, -1)
    laplacian = cotangent_laplacian(mesh.vertices, mesh.faces)
    half = np.full(len(loop), 0.5)
    entries = (np.concatenate([half, -half]), (np.concatenate([loop, after]), np.concatenate([after, loop])))
    area = coo_array(entries, shape=(count, count))
    system = csr_array(block_array([[laplacian, -area], [area, laplacian]]))
    first = loop[0]
    second = loop[np.argmax(np.linalg.norm(mesh.vertices[loop] - mesh.vertices[first], axis=1))]
    out = np.zeros(2 * count)
    out[second] = np.linalg.norm(mesh.vertices[second] - mesh.vertices[first])
    free = np.setdiff1d(np.arange(2 * count), [first, second, first + count, second + count])
    rows = system[free]
    matrix, right = rows[:, free].tocsc(), -(rows @ out)
    watch.lap("matrix")
    factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    watch.lap("factor")
    out[free] = factor.solve(right)
    watch.lap("substitute")
    return out.reshape(2, count).T


def map_by_scipy(path: Path, watch: Stopwatch) -> np.ndarray:
    """DNCP of a mesh file."""
    mesh = pgcp.read_mesh(path)
    watch.lap("read")
    return dncp(mesh, watch)


def map_by_lscm(path: Path, watch: Stopwatch) -> np.ndarray:
    """igl.lscm of a mesh file, two boundary vertices pinned."""
    import igl

    mesh = pgcp.read_mesh(path)
    watch.lap("read")
    loop = np.asarray(examine(mesh.faces, len(mesh.vertices)).loops[0])
    far = loop[np.argmax(np.linalg.norm(mesh.vertices[loop] - mesh.vertices[loop[0]], axis=1))]
    pins = np.array([loop[0], far], np.int64)
    found = igl.lscm(mesh.vertices, mesh.faces.astype(np.int64), pins, np.array([[0.0, 0.0], [1.0, 0.0]]))
    watch.lap("lscm")
    arrays = (part for part in (found if isinstance(found, tuple) else (found,)) if np.shape(part) == (len(mesh.vertices), 2))
    return next(arrays)


def be_child(name: str, path: Path, out: Path, threads: int) -> None:
    """Be a contestant: map or solve one mesh and write the seconds of its parts."""
    watch = Stopwatch()
    if name == "scipy":
        positions = map_by_scipy(path, watch)
    elif name == "lscm":
        positions = map_by_lscm(path, watch)
    else:
        positions = solve_by_pardiso(path, watch, 3 if name == "pardiso3" else 2, threads)
    if not np.isfinite(positions).all():
        raise SystemExit(f"{name}: positions are not finite")
    out.write_text(json.dumps(watch.parts))


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=KNOWN)
    parser.add_argument("mesh", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args(words)
    be_child(arguments.name, arguments.mesh, arguments.out, arguments.threads)


if __name__ == "__main__":
    main()
