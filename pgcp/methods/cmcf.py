"""cMCF: conformalized mean curvature flow to the sphere (Kazhdan, Solomon, Ben-Chen 2012).

A step solves (D + dt L) X' = D X for the three coordinates: D are the areas of the current surface at its vertices, L is the
Laplacian of the surface that it began with, which makes the flow a conformal one in its limit. D changes in every step, and the
elimination takes no areas; but L, eliminated once and patch by patch, is a preconditioner that leaves conjugate gradients a few
turns a step.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from pgcp.errors import InputError, SolveFailedError
from pgcp.interface.factor import InterfaceFactor
from pgcp.interface.whole_mesh import eliminated
from pgcp.methods.base import Method, OwnOption, whole
from pgcp.methods.common.conjugate_gradients import conjugate_gradients
from pgcp.methods.common.harmonic import mapped_whole
from pgcp.patches.mapped import Mapped
from pgcp.patches.run import Run
from pgcp.patches.stored import Parts
from pgcp.surface.operators import cotangent_laplacian, face_areas
from pgcp.surface.topology import used_vertices
from pgcp.types import BoolArray, FloatArray, IntArray

_ROUND = 0.2  # spread of the radii; that of a coarse surface at rest is not 0
_STILL, _STEADY = 1e-4, 2e-2  # change of the energy in a unit of time, in itself and as a part of the energy
_ACCURATE, _TURNS = 1e-6, 200

Solve = Callable[[FloatArray], FloatArray]


def vertex_areas(points: FloatArray, faces: IntArray) -> FloatArray:
    """A third (V,) of the areas of the faces (F, 3) around each vertex, points (V, 3)."""
    return np.asarray(np.bincount(faces.reshape(-1), np.repeat(face_areas(points, faces) / 3.0, 3), len(points)), np.float64)


def centred(points: FloatArray, areas: FloatArray) -> FloatArray:
    """Points (V, 3) of unit area about their centre, areas (V,) of the vertices."""
    total = areas.sum()
    return np.asarray((points - areas @ points / total) / np.sqrt(total), np.float64)


def spread_of(points: FloatArray, areas: FloatArray) -> float:
    """Standard deviation of the distance from 0 over its mean, by areas (V,)."""
    radius, share = np.linalg.norm(points, axis=1), areas / areas.sum()
    mean = share @ radius
    return float(np.sqrt(share @ (radius - mean) ** 2) / mean)


def flow(
    points: FloatArray, faces: IntArray, laplace: Solve, apply: Solve, step: float, most: int
) -> tuple[FloatArray, list[dict[str, Any]]]:
    """Flow until the surface is a sphere; points (V, 3) of the last step, centred and of unit area, and the record of all.

    laplace takes loads (V, 3) of sum 0 to values whose Laplacian they are; apply is the Laplacian; step: in units of the area.
    Discrete flows have no round surface as their limit, and drift along Moebius maps there: the flow ends where the energy
    stands still. Raises SolveFailedError where it does not within ``most`` steps.
    """
    areas = vertex_areas(points, faces)
    points = centred(points, areas)
    areas = vertex_areas(points, faces)
    steps = [_record(0, points, areas, apply, 0.0, 0)]
    for number in range(1, most + 1):
        change, turns = _step(points, areas, laplace, apply, step)
        points = points + change
        areas = vertex_areas(points, faces)
        points = centred(points, areas)
        areas = vertex_areas(points, faces)
        steps.append(_record(number, points, areas, apply, step, turns))
        if not np.isfinite(points).all():
            break
        if is_at_rest(steps):
            return points, steps
    change = abs(steps[-1]["energy"] - steps[-2]["energy"])
    raise SolveFailedError(
        f"the flow has not come to rest at a sphere in {len(steps) - 1} steps: radii spread by {steps[-1]['spread']:.3g} of "
        f"their mean, and the energy changed by {change:.3g} in the last step; try more steps (--flow-steps), or choose "
        "--method pgcp"
    )


def is_at_rest(steps: list[dict[str, Any]]) -> bool:
    """Whether the last step left the energy as it was, and the surface is round."""
    before, now = steps[-2:]
    little = (_STILL + _STEADY * abs(now["energy"])) * now["step"]
    return bool(now["spread"] <= _ROUND and abs(now["energy"] - before["energy"]) <= little)


def _record(number: int, points: FloatArray, areas: FloatArray, apply: Solve, step: float, turns: int) -> dict[str, Any]:
    """What is recorded of an iterate: its energy, that of the map from the first surface less its area, and the flow's speed.

    The speed across the sphere is the gradient's norm: what remains of L X by areas, less what only makes the sphere smaller.
    """
    image = apply(points)
    energy = 0.5 * float((points * image).sum()) - float(areas.sum())
    weights = np.maximum(areas, np.finfo(np.float64).tiny)[:, None]
    shrinking = float((points * image).sum() / (weights * points**2).sum())
    norm = float(np.sqrt(((image - shrinking * weights * points) ** 2 / weights)[areas > 0.0].sum()))
    record = {"method": "cmcf", "iteration": number, "energy": energy, "gradient_norm": norm, "step": step}
    return record | {"spread": spread_of(points, areas), "inner": turns}


def _step(points: FloatArray, areas: FloatArray, laplace: Solve, apply: Solve, step: float) -> tuple[FloatArray, int]:
    """The change (V, 3) of one step: (D + dt L) change = - dt L points. Constants are an exact part of the preconditioner."""
    total = areas.sum()

    def precondition(load: FloatArray) -> FloatArray:
        """The operator without areas, but for constants, solved for loads (V, 3)."""
        sums = load.sum(axis=0) / total
        values = laplace(load - np.outer(areas, sums)) / step
        return np.asarray(values - areas @ values / total + sums, np.float64)

    return conjugate_gradients(
        lambda x: np.asarray(areas[:, None] * x + step * apply(x), np.float64),
        precondition,
        np.asarray(-step * apply(points), np.float64),
        _ACCURATE,
        _TURNS,
    )


def _solver(factor: InterfaceFactor, used: BoolArray) -> Solve:
    """What solves the Laplacian for loads (V, 3) of sum 0, the kept vertex held at 0: two columns at a time."""
    held = np.zeros(1, np.complex128)

    def laplace(load: FloatArray) -> FloatArray:
        """Values (V, 3) of loads (V, 3)."""
        two = factor.solve(load[:, 0] + 1j * load[:, 1], held)
        one = factor.solve(load[:, 2].astype(np.complex128), held)
        return np.where(used[:, None], np.column_stack([two.real, two.imag, one.real]), 0.0)

    return laplace


def _map(run: Run, parts: Parts) -> Mapped:
    mesh, own = run.mesh, run.options.own
    used = used_vertices(mesh)
    kept = mesh.faces[0, :1].astype(np.int64)
    laplacian = cotangent_laplacian(mesh.vertices, mesh.faces, run.mollification)
    factor = eliminated(run, parts, kept)
    with run.clock.stage("map"):
        start = np.where(used[:, None], mesh.vertices, 0.0)
        solver = _solver(factor, used)
        points, steps = flow(start, mesh.faces, solver, lambda x: laplacian @ x, own["flow_step"], own["flow_steps"])
    record = factor.record()
    factor.release()
    points[~used] = [0.0, 0.0, 1.0]
    radius = np.linalg.norm(points, axis=1)
    if not radius.min() > 0.0:
        raise SolveFailedError("the flow took a vertex to the centre of the sphere; choose --method pgcp")
    details = {"interface": record, "iterations": steps, "converged": True}
    return mapped_whole(run, parts, points / radius[:, None], kept, details)


def _above_zero(name: str) -> Callable[[float], None]:
    def check(value: float) -> None:
        """Raise InputError for a value that is not above 0."""
        if not value > 0:
            raise InputError(f"{name} is {value}, it must be above 0")

    return check


METHOD = Method(
    name="cmcf",
    targets=("sphere",),
    summary="conformalized mean curvature flow: the surface flows to a round sphere, its Laplacian held",
    guarantees="the same map for any cuts; at rest at a sphere, or the run ends and says so; no folds promised",
    reference="Kazhdan, Solomon, Ben-Chen 2012 (cMCF)",
    mapper=whole(_map),
    own=(
        OwnOption("flow_step", "length of a time step, in units of the surface's area", 0.1, check=_above_zero("flow_step")),
        OwnOption("flow_steps", "the most time steps that are made", 100, check=_above_zero("flow_steps")),
    ),
)
