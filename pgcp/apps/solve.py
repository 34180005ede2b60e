"""Equations on a surface, solved on its map and checked against finite elements on the surface itself."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pgcp.apps.base import App, Call, Group, Made, add_mesh, folds_said, map_record, npz_file
from pgcp.apps.common.joined import Joined, joined
from pgcp.apps.common.values import checked, mesh_with, of_input, source_of
from pgcp.errors import InputError
from pgcp.finish.shape import edge_lengths
from pgcp.io.values import VALUE_FILES, read_values, table_of
from pgcp.options import AUTO
from pgcp.parallel import one_blas_thread
from pgcp.plane.sphere_grid import HarmonicDomain, SphereGrid
from pgcp.report.chart import Scale
from pgcp.report.seen import COLD_WARM, HEAT, Seen, Still, at_vertices, view_rotation
from pgcp.result import Result
from pgcp.runtime.executors import Progress, silent
from pgcp.surface.elements import Elements, lumped_areas
from pgcp.surface.equations import EQUATIONS, Constants, Domain, Equation, Field, History, equation_of, evolve, rise_of
from pgcp.surface.operators import face_areas
from pgcp.surface.topology import examine
from pgcp.targets.registry import TARGETS
from pgcp.types import BoolArray, FloatArray, IntArray, Mesh

EDGES = ("neumann", "dirichlet")
_FRAMES = 41
_LEAST_DEGREE, _MOST_DEGREE = 15, 127  # of harmonics where none is asked for
_MOST_ASKED, _MOST_STEPS = 2000, 1_000_000
_FINEST, _EDGES = 0.01, 2.0  # share of the area on shorter edges than the harmonics must resolve; edges in epsilon
_LEAST_EPSILON = 0.05
_FAR = 0.1  # relative difference of solutions that is worth a word
_PICTURE = 360  # pixels of an animation's pictures
_SHOWN, _HELD = 100, 1500  # milliseconds of its frames, and of the last


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """An equation solved on a map, and on the surface itself, on the same V vertices and with the same time steps.

    values, on_surface (V,): at the end, real or complex; start (V,): the start, of a steady equation its right side f.
    by_map, by_surface: times (T,), energies (T,) and frames (K, V); a steady equation has one of each. differences (K,): of
    the frames, the norm of w on the map less w on the surface over that of w on the surface, both in L2 of the surface.
    areas (V,): of vertices; lengths are in units of ``unit``, the radius of the sphere or disk of the surface's area.
    record: figures, as JSON has them. problem: why the solution is not good, nothing where it is.
    """

    equation: Equation
    constants: Constants
    start: Field
    by_map: History
    by_surface: History
    differences: FloatArray
    areas: FloatArray
    unit: float
    record: dict[str, Any]
    problem: str = ""

    @property
    def values(self) -> Field:
        """The solution on the map (V,), at the end."""
        return np.asarray(self.by_map.frames[-1])

    @property
    def on_surface(self) -> Field:
        """The solution of finite elements on the surface (V,), at the end."""
        return np.asarray(self.by_surface.frames[-1])

    @property
    def difference(self) -> float:
        """Relative difference in L2 at the end."""
        return float(self.differences[-1])


def solve(
    result: Result,
    equation: str = "ginzburg-landau",
    *,
    epsilon: float | None = None,
    alpha: float | None = None,
    beta: float | None = None,
    time: float | None = None,
    step: float | None = None,
    seed: int = 0,
    source: Any = None,
    edge: str | None = None,
    degree: int | None = None,
    progress: Progress = silent,
) -> Solution:
    """Solve an equation on a surface through the area ratio of its map, and by finite elements on the surface.

    equation: one of ``EQUATIONS``, w_t = D Lap w + g(w) or -Lap w = f. Lap of the surface is that of the map over the ratio
    rho of areas, as angles are kept (Lui, Wang, Chan 2005; PGCP 5.7.3). Maps to the sphere are solved by spherical harmonics up
    to ``degree``, which needs the package ducc0; maps to the plane by finite elements of the map with masses of the surface.
    epsilon, alpha, beta: constants, where the equation has them. time, step: end and step. seed: of the noise from which
    solutions start. source (V,): where they start instead, of Poisson's equation f. edge: "neumann", nothing flows over the
    boundary, or "dirichlet", w is 0 there.

    Lengths are in units of the radius of the sphere (closed) or disk (open) that has the surface's area, time is their square.
    Raises InputError for values that make no sense, NumericalError where the solution grows out of bounds.
    """
    asked = equation_of(equation)
    surface, closed = joined(result), TARGETS.get(result.target).space.closed
    areas = face_areas(surface.vertices, surface.faces)
    unit = float(np.sqrt(areas.sum() / (4.0 * np.pi if closed else np.pi)))
    vertices, rim = surface.vertices / unit, _rim(surface.faces, len(surface.vertices))
    mean_edge = float(edge_lengths(Mesh(vertices, surface.faces)).mean())
    constants = _constants(asked, epsilon, alpha, beta, mean_edge)
    time, steps = _steps(asked, time, step)
    held = rim if _edge_of(asked, edge, closed) == "dirichlet" else None
    masses = lumped_areas(areas / unit**2, surface.faces, len(vertices))
    own = Elements(vertices, surface.faces, masses, held)
    if source is None:
        start = _start(asked, constants, Elements(vertices, surface.faces, masses), vertices, rim, mean_edge, seed)
    else:
        kinds, kind = ("iufbc", np.complex128) if asked.is_complex else ("iufb", np.float64)
        start = checked(source, result, "values of the source", kinds).astype(kind)[surface.first]
    said: dict[str, Any] = {}
    if closed:
        domain: Domain = _harmonic(result, surface, masses, degree, said)
    else:
        domain = _flat(surface, masses, held, degree, said)
    with one_blas_thread():  # vectors are too short for threads of BLAS, which wait for each other
        by_map, by_surface = (
            _solved(asked, constants, each, start, time, steps, partial(progress, name))
            for name, each in (("on the map", domain), ("on the surface", own))
        )
    differences = _differences(by_map.frames, by_surface.frames, masses)
    record = _record(asked, constants, time, steps, unit, mean_edge, held is not None, said, by_map, by_surface, differences)
    problem = _problem(asked, constants, by_map, by_surface, domain)
    given_back = surface.given_back
    by_map, by_surface = (replace(each, frames=given_back(each.frames)) for each in (by_map, by_surface))
    whole = given_back(start), by_map, by_surface, differences, given_back(masses)
    return Solution(asked, constants, *whole, unit, record, problem)


def _constants(asked: Equation, epsilon: float | None, alpha: float | None, beta: float | None, mean_edge: float) -> Constants:
    """The constants that are given, usual ones else; epsilon no less than edges can show."""
    given = {name: value for name, value in (("epsilon", epsilon), ("alpha", alpha), ("beta", beta)) if value is not None}
    for name in given:
        if name not in asked.constants:
            raise InputError(f"the equation {asked.name} has no constant {name}")
    constants = Constants(**{"epsilon": max(_LEAST_EPSILON, _EDGES * mean_edge), **given})
    asked.check(constants)
    return constants


def _steps(asked: Equation, time: float | None, step: float | None) -> tuple[float, int]:
    """The end, and into how many equal steps the time until then is cut."""
    if asked.is_steady:
        if time is not None or step is not None:
            raise InputError(f"the equation {asked.name} is steady; it has no time")
        return 0.0, 0
    step = asked.step if step is None else step
    time = asked.time if time is None else time
    for name, value in (("time", time), ("step", step)):
        if not (np.isfinite(value) and value > 0.0):
            raise InputError(f"{name} is {value}; it must be more than 0")
    if time / step > _MOST_STEPS:
        raise InputError(f"{time / step:.3g} steps are more than {_MOST_STEPS:,}; choose a longer step")
    return time, max(int(np.ceil(time / step - 1e-9)), 1)


def _edge_of(asked: Equation, edge: str | None, closed: bool) -> str:
    if edge is not None and edge not in EDGES:
        raise InputError(f"unknown boundary condition {edge!r}; choose from {', '.join(EDGES)}")
    if closed and edge is not None:
        raise InputError("a closed surface has no boundary, and takes no condition there")
    return "neumann" if closed else edge or asked.edge


def _rim(faces: IntArray, count: int) -> BoolArray:
    """Which vertices (V,) are on a boundary."""
    out = np.zeros(count, bool)
    for loop in examine(faces, count).loops:
        out[loop] = True
    return out


def _start(
    asked: Equation, constants: Constants, own: Elements, vertices: FloatArray, rim: BoolArray, edge: float, seed: int
) -> Field:
    """Noise (V,) of the length epsilon and of mean square 1/4, or two opposite points, spread over some edges.

    Poisson's f has the integral 1 around one point and -1 around the other; else the greatest value is 1.
    """
    if asked.from_noise:
        random = np.random.default_rng(seed)
        noise = random.standard_normal((2, len(vertices))) / np.sqrt(own.areas)
        field = own.smoothed(noise[0] + 1j * noise[1] if asked.is_complex else noise[0], 2.0 * constants.epsilon)
        return np.asarray(0.5 * field / np.sqrt(own.areas @ np.abs(field) ** 2 / own.areas.sum()))
    middle = own.areas @ vertices / own.areas.sum()
    spread = np.linalg.eigh((vertices - middle).T @ (own.areas[:, None] * (vertices - middle)))
    reach = 1.2 * np.sqrt(max(spread[0][-1], 0.0) / own.areas.sum()) * spread[1][:, -1]
    points = np.zeros(len(vertices))
    for sign in (1.0, -1.0):
        away = np.where(rim, np.inf, np.linalg.norm(vertices - middle - sign * reach, axis=1))
        place = int(away.argmin())
        points[place] += sign / own.areas[place]
    field = own.smoothed(points, 4.0 * edge)
    return np.asarray(field if asked.is_steady else field / max(float(np.abs(field).max()), 1e-300))


def needed_degree(result: Result) -> int:
    """Degree of harmonics that resolve the mesh on the sphere: pi over an edge that 99 % of the area has no shorter ones than.

    Edges are arcs on the sphere, in radians; a map that squeezes parts of the surface needs a high degree there.
    """
    image, areas = result.coordinates, face_areas(result.mesh.vertices, result.faces)
    corners = image[result.faces]
    chords = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    arcs = 2.0 * np.arcsin(np.clip(0.5 * chords, 0.0, 1.0)).mean(axis=1)
    order = np.argsort(arcs)
    share = np.cumsum(areas[order]) / max(float(areas.sum()), 1e-300)
    shortest = float(arcs[order][min(int(np.searchsorted(share, _FINEST)), len(order) - 1)])
    return int(min(np.ceil(np.pi / max(shortest, 1e-9)), 2**31))


def _flat(surface: Joined, masses: FloatArray, held: BoolArray | None, degree: int | None, said: dict[str, Any]) -> Elements:
    """The plane's domain: triangles of the map with masses of the surface, each its own area times the ratio of areas."""
    if degree is not None:
        raise InputError("degree is that of spherical harmonics, and this surface is mapped to the plane")
    flat = np.pad(surface.image, ((0, 0), (0, 1)))
    said["solved_by"] = "finite elements of the map, masses of the surface"
    return Elements(flat, surface.faces, masses, held)


def _harmonic(result: Result, surface: Joined, masses: FloatArray, degree: int | None, said: dict[str, Any]) -> HarmonicDomain:
    """The sphere's domain: rho at the grid by interpolating its logarithm over faces."""
    if degree is not None and not 1 <= degree <= _MOST_ASKED:
        raise InputError(f"degree is {degree}; it must be from 1 to {_MOST_ASKED}")
    needed = needed_degree(result)
    used = int(np.clip(needed, _LEAST_DEGREE, _MOST_DEGREE)) if degree is None else degree
    grid = SphereGrid(used)
    places = result.inverse(grid.points)
    corners = surface.number[result.faces[places.faces]]

    def to_grid(values: Field) -> Field:
        """Values on the grid."""
        return np.asarray(np.einsum("nk,nk->n", places.weights, values[corners]))

    image = lumped_areas(face_areas(surface.image, surface.faces), surface.faces, len(masses))
    rho = np.exp(to_grid(np.log(masses / image)))
    seen = float(grid.weights @ rho) / (4.0 * np.pi)
    said |= {
        "solved_by": "spherical harmonics on a Gauss-Legendre grid",
        "degree": used,
        "degree_needed": needed,
        "area_on_grid": seen,
        "area_ratio_least": float(rho.min()),
        "area_ratio_greatest": float(rho.max()),
    }
    return HarmonicDomain(grid, rho / seen, surface.image, to_grid)


def _solved(
    asked: Equation, constants: Constants, domain: Domain, start: Field, time: float, steps: int, shown: Any
) -> History:
    """The solution over time; a steady one has a single frame, at time 0."""
    shown(0, max(steps, 1))
    if not asked.is_steady:
        return evolve(asked, constants, domain, start, time, steps, _FRAMES, shown)
    state = domain.poisson(start)
    w = domain.at_vertices(state)
    energy = -0.5 * domain.gradient_energy(state)  # of a solution, 1/2 |grad w|^2 - f w integrates to this
    shown(1, 1)
    return History(np.zeros(1), np.array([energy]), np.zeros(1), w[None])


def _differences(one: Field, other: Field, areas: FloatArray) -> FloatArray:
    """Relative differences (K,) in L2 of frames (K, V)."""
    size = np.sqrt(np.abs(other) ** 2 @ areas)
    return np.asarray(np.sqrt(np.abs(one - other) ** 2 @ areas) / np.maximum(size, 1e-300))


def _record(
    asked: Equation, constants: Constants, time: float, steps: int, unit: float, edge: float, held: bool, said: dict[str, Any],
    by_map: History, by_surface: History, differences: FloatArray,
) -> dict[str, Any]:  # fmt: skip
    """Figures of a solution."""
    return {
        "equation": asked.name,
        "formula": asked.formula,
        "constants": {name: getattr(constants, name) for name in asked.constants},
        "boundary": "0" if held else "no flow",
        "time": time,
        "steps": steps,
        "unit": unit,
        "mean_edge": edge,
        **said,
        "energy_first": float(by_map.energies[0]),
        "energy_last": float(by_map.energies[-1]),
        "energy_last_on_surface": float(by_surface.energies[-1]),
        "energy_rises": [rise_of(by_map.energies), rise_of(by_surface.energies)],
        "difference": float(differences[-1]),
        "difference_greatest": float(differences.max()),
    }


def _problem(asked: Equation, constants: Constants, by_map: History, by_surface: History, domain: Domain) -> str:
    """Why a solution is not good, nothing where it is."""
    unsolved = getattr(domain, "unsolved", 0)
    if unsolved:
        return f"{unsolved} steps on the sphere were not solved to the accuracy wanted; a smaller --step may do"
    for where, energies in (("map", by_map.energies), ("surface", by_surface.energies)):
        if asked.falls(constants) and rise_of(energies):
            return f"the energy on the {where} rises by {rise_of(energies):.2g} of its fall; a smaller --step may do"
    return ""


# The command ------------------------------------------------------------------------------------------------------------------


def _ask(group: Group) -> None:
    add_mesh(group)
    group.add_argument("--equation", choices=tuple(EQUATIONS), default="ginzburg-landau", help="what is solved")
    group.add_argument(
        "--epsilon",
        type=float,
        help=f"length of the patterns, in units of the radius of the sphere or disk of equal area (default {_LEAST_EPSILON}, "
        "or twice the mean edge where that is longer)",
    )
    group.add_argument("--alpha", type=float, help="of ginzburg-landau: imaginary part of the diffusion (default 0)")
    group.add_argument("--beta", type=float, help="of ginzburg-landau: imaginary part of the reaction (default 1.5)")
    group.add_argument("--time", type=float, help="when the solution ends (default by the equation)")
    group.add_argument("--step", type=float, help="length of a time step (default by the equation)")
    group.add_argument(
        "--source",
        type=Path,
        metavar="FILE",
        help=f"values at the mesh's vertices: the right side of poisson, else where the solution starts; {VALUE_FILES}",
    )
    group.add_argument(
        "--boundary-condition",
        choices=EDGES,
        help="nothing flows over the boundary, or w is 0 there (default neumann, of poisson dirichlet)",
    )
    group.add_argument(
        "--degree",
        type=int,
        help=f"of the spherical harmonics (default what the mesh needs, up to {_MOST_DEGREE})",
    )


def _run(call: Call) -> Made:
    asked = equation_of(call["equation"])
    _steps(asked, call["time"], call["step"])
    _constants(asked, call["epsilon"], call["alpha"], call["beta"], 1.0)
    mesh, count = source_of(call["mesh"])
    given = read_values(call["source"], count) if call["source"] else {}
    moebius = {"moebius": "area"} if call.options.moebius == AUTO else {}
    if given and (width := table_of(given).shape[-1]) > (2 if asked.is_complex else 1):
        raise InputError(f"{call['source']}: it holds {width} values a line, more than the equation has")
    result = call.mapped(mesh, **moebius)
    source = None
    if given:
        values = table_of(of_input(result, given))
        source = values @ [1.0, 1.0j] if values.shape[-1] > 1 else values[:, 0]
    names = ("epsilon", "alpha", "beta", "time", "step", "degree")
    solution = solve(
        result, asked.name, seed=call.options.seed, source=source, edge=call["boundary_condition"], progress=call.shown,
        **{name: call[name] for name in names},
    )  # fmt: skip
    return _made(result, solution)


def _lines(solution: Solution) -> tuple[str, ...]:
    """What the user is told."""
    said, asked = solution.record, solution.equation
    constants = "".join(f", {name} {value:g}" for name, value in said["constants"].items())
    until = "" if asked.is_steady else f", until time {said['time']:g} in {said['steps']} steps"
    lines = [f"{asked.formula}{constants}{until}; lengths in units of {solution.unit:.6g}"]
    if "degree" in said:
        short = "" if said["degree"] >= said["degree_needed"] else ", which leaves the finest parts unresolved"
        lines.append(f"spherical harmonics up to degree {said['degree']}; the mesh needs {said['degree_needed']}{short}")
    else:
        lines.append(said["solved_by"])
    if said["constants"].get("epsilon", np.inf) < 0.99 * _EDGES * said["mean_edge"]:
        lines.append(f"edges are longer than half of epsilon (mean {said['mean_edge']:.3g}): patterns are not well resolved")
    first = "" if asked.is_steady else f"{said['energy_first']:.6g} at first, "
    lines.append(f"energy {first}{said['energy_last']:.6g} at the end")
    lines.append(f"relative difference in L2 from finite elements on the surface: {solution.difference:.3g}")
    if solution.difference > _FAR and said.get("degree", 0) < said.get("degree_needed", 0):
        lines.append("the harmonics do not resolve this map: trust w_surface, the solution on the surface, rather than w")
    return tuple(lines)


def _made(result: Result, solution: Solution) -> Made:
    def npz(name: str) -> dict[str, bytes]:
        """Arrays."""
        return npz_file(
            name, w=solution.values, w_surface=solution.on_surface, start=solution.start, times=solution.by_map.times,
            energy=solution.by_map.energies, energy_surface=solution.by_surface.energies,
            frame_times=solution.by_map.frame_times, frames=_single(solution.by_map.frames), differences=solution.differences,
        )  # fmt: skip

    def fields(name: str) -> dict[str, bytes]:
        """The surface with the fields."""
        columns = {"w": solution.values, "w_surface": solution.on_surface}
        return mesh_with(name, result.mesh, columns, **{result.coordinates_name: result.coordinates})

    files = {
        ".npz": npz,
        ".vtp": fields,
        ".ply": fields,
        ".png": lambda name: {name: picture(result, solution)},
        ".gif": lambda name: {name: film(result, solution)},
    }
    if solution.equation.is_steady:
        del files[".gif"]
    return Made(files, {"map": map_record(result), **solution.record}, _lines(solution), folds_said(result) or solution.problem)


def _single(values: Field) -> Field:
    return values.astype(np.complex64 if np.issubdtype(values.dtype, np.complexfloating) else np.float32)


def _limit(solution: Solution) -> float:
    """The value that the last colour stands for."""
    return solution.equation.shown or float(np.quantile(np.abs(solution.values.real), 0.995))


def picture(result: Result, solution: Solution) -> bytes:
    """PNG bytes: start, solution, the solution on the map, that on the surface, the difference, and energies over time."""
    from pgcp.report.panels import SMALLER, as_png, curves, panel, sheet

    asked, said = solution.equation, solution.record
    on, plane = _stills(result, SMALLER)
    part = "real part of A" if asked.is_complex else "w"
    scale, error = _around_zero(_limit(solution)), np.abs(solution.values - solution.on_surface)
    first = scale if asked.shown else _around_zero(float(np.abs(solution.start.real).max()))
    wrong = Scale.between(0.0, float(error.max()) or 1.0, HEAT, 5)
    end = "" if asked.is_steady else f" at time {said['time']:g}"
    shown = (
        ("the source f" if asked.is_steady else f"{part} at time 0", on, solution.start.real, first),
        (f"{part}{end}, solved on the map", on, solution.values.real, scale),
        ("the same on the map", plane, solution.values.real, scale),
        (f"{part}{end}, by finite elements on the surface", on, solution.on_surface.real, scale),
        (f"|difference| of the two, {solution.difference:.2g} in L2", on, error, wrong),
    )
    panels = [panel(caption, still.painted(at_vertices(result.faces, w, own)), own) for caption, still, w, own in shown]
    if not asked.is_steady:
        energies = [solution.by_map.energies, solution.by_surface.energies]
        panels.append(curves("energy on the map (blue), on the surface (red)", "time", solution.by_map.times, energies))
    return as_png(sheet(f"{result.mesh.name}: {asked.formula}", panels))


def _stills(result: Result, pixels: int) -> list[Still]:
    """The surface and its map, as they are seen."""
    rotation = view_rotation(result.mesh.vertices, result.faces)
    return [Seen.of(points, result.faces, rotation).still(pixels) for points in (result.mesh.vertices, result.coordinates)]


def _around_zero(limit: float) -> Scale:
    """Blue below 0, red above, up to a limit."""
    limit = limit or 1.0
    return Scale.between(-limit, limit, COLD_WARM, 5)


def film(result: Result, solution: Solution) -> bytes:
    """GIF bytes: the solution over time on the surface and on the map."""
    from pgcp.report.panels import animation, captioned

    stills, values = _stills(result, _PICTURE), solution.by_map.frames.real
    scale = _around_zero(solution.equation.shown or float(np.abs(values[0]).max()))
    captions = [f"{solution.equation.name}, time {t:.4g}" for t in solution.by_map.frame_times]
    frames = [
        captioned([still.painted(at_vertices(result.faces, w, scale)) for still in stills], caption)
        for w, caption in zip(values, captions, strict=True)
    ]
    return animation(frames, [_SHOWN] * (len(frames) - 1) + [_HELD])


APP = App(
    name="solve",
    summary="solve an equation on the surface through its map: Ginzburg-Landau, Allen-Cahn, heat, Poisson",
    writes={
        ".npz": "the solution at every vertex and over time, as arrays",
        ".vtp": "the surface with the solution at its vertices, for ParaView",
        ".ply": "the same as PLY",
        ".png": "the picture",
        ".gif": "the solution over time",
    },
    arguments=_ask,
    run=_run,
    reference="Lui, Wang, Chan 2005; PGCP 5.7.3",
)
