"""Equations on a surface, each a small thing of one table, and the time steps that solve them on any discrete domain.

An equation is w_t = D Lap w + g(w), or -Lap w = f where it is steady. A domain says what Lap and integrals are: finite
elements of a mesh (``elements``), or spherical harmonics of a map (``plane.sphere_grid``). Both are stepped by the same code.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from pgcp.errors import InputError, NumericalError
from pgcp.types import FloatArray

Field = np.ndarray[Any, Any]  # real or complex (n,)
_BOUND = 1e3  # of a solution that must stay near 1


@dataclass(frozen=True, slots=True)
class Constants:
    """Constants of equations: length ``epsilon`` in units of the surface, ``alpha`` and ``beta`` without units."""

    epsilon: float = 0.1
    alpha: float = 0.0
    beta: float = 1.5


def _nothing(w: Field, _constants: Constants) -> Field:
    return np.zeros_like(w)


def _no_density(w: Field, _constants: Constants) -> FloatArray:
    return np.zeros(len(w))


@dataclass(frozen=True, slots=True)
class Equation:
    """One equation w_t = D Lap w + g(w), or the steady -Lap w = f.

    formula: as it is printed; diffusion(constants): D; reaction(w, constants): g (n,); density(w, constants): what the energy
    D/2 |grad w|^2 has beside it (n,). falls(constants): whether the energy of every solution falls. constants: those that it
    has. time, step: usual ones; from_noise: whether it usually starts from noise, else from two points of opposite sign;
    edge: the usual condition on a boundary, "neumann" (no flow) or "dirichlet" (0); shown: the colours' limit, 0 for the
    field's own.
    """

    name: str
    formula: str
    diffusion: Callable[[Constants], complex]
    reaction: Callable[[Field, Constants], Field] = _nothing
    density: Callable[[Field, Constants], FloatArray] = _no_density
    falls: Callable[[Constants], bool] = lambda _constants: True
    constants: tuple[str, ...] = ()
    time: float = 1.0
    step: float = 0.1
    from_noise: bool = False
    edge: str = "neumann"
    is_complex: bool = False
    is_steady: bool = False
    shown: float = 0.0

    def check(self, constants: Constants) -> None:
        """Raise InputError where constants are none that the equation can be solved with."""
        if not (np.isfinite([constants.epsilon, constants.alpha, constants.beta]).all() and constants.epsilon > 0.0):
            raise InputError(f"epsilon is {constants.epsilon}; it must be more than 0, and alpha and beta finite numbers")


def _double_well(w: Field, _constants: Constants) -> FloatArray:
    return np.asarray(0.25 * (np.abs(w) ** 2 - 1.0) ** 2)


EQUATIONS: dict[str, Equation] = {
    equation.name: equation
    for equation in (
        Equation(
            "ginzburg-landau",
            "A_t = A + epsilon^2 (1 + i alpha) Lap A - (1 + i beta) |A|^2 A",
            diffusion=lambda c: c.epsilon**2 * (1.0 + 1j * c.alpha),
            reaction=lambda w, c: w - (1.0 + 1j * c.beta) * np.abs(w) ** 2 * w,
            density=_double_well,
            falls=lambda c: c.alpha == 0.0 and c.beta == 0.0,
            constants=("epsilon", "alpha", "beta"),
            time=20.0,
            step=0.1,
            from_noise=True,
            is_complex=True,
            shown=1.0,
        ),
        Equation(
            "allen-cahn",
            "w_t = epsilon^2 Lap w + w - w^3",
            diffusion=lambda c: c.epsilon**2,
            reaction=lambda w, _c: w - w**3,
            density=_double_well,
            constants=("epsilon",),
            time=10.0,
            step=0.1,
            from_noise=True,
            shown=1.0,
        ),
        Equation("heat", "w_t = Lap w", diffusion=lambda _c: 1.0, time=0.1, step=0.001),
        Equation("poisson", "-Lap w = f", diffusion=lambda _c: 1.0, is_steady=True, edge="dirichlet"),
    )
}


def equation_of(name: str) -> Equation:
    """The equation of a name; raises InputError where there is none."""
    if name not in EQUATIONS:
        raise InputError(f"unknown equation {name!r}; choose from {', '.join(EQUATIONS)}")
    return EQUATIONS[name]


class Domain(Protocol):
    """A discrete surface: a state is a solution as the domain keeps it, nodes are where it has values and areas.

    areas (n,): of the nodes, which integrate; start(values): the state of values (V,) at the mesh's vertices; nodes(state):
    values (n,); at_vertices(state): values (V,); gradient_energy(state): the integral of |grad w|^2; stepper(c): a function of
    a state and nodal values r (n,) whose result solves w - c Lap w = r; poisson(values): the state of -Lap w = f, the values of
    f (V,) at vertices, less their mean where nothing else fixes w, whose mean is 0 then.
    """

    areas: FloatArray

    def start(self, values: Field) -> Field:
        """The state of values at vertices."""
        ...

    def nodes(self, state: Field) -> Field:
        """Values at the nodes."""
        ...

    def at_vertices(self, state: Field) -> Field:
        """Values at vertices."""
        ...

    def gradient_energy(self, state: Field) -> float:
        """The integral of |grad w|^2."""
        ...

    def stepper(self, coefficient: complex) -> Callable[[Field, Field], Field]:
        """Solves of one implicit step."""
        ...

    def poisson(self, values: Field) -> Field:
        """The state that solves Poisson's equation."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """A solution over time: times (T,) and energies (T,) of all steps, the times (K,) of frames, their values (K, V)."""

    times: FloatArray
    energies: FloatArray
    frame_times: FloatArray
    frames: Field


def energy_of(equation: Equation, constants: Constants, domain: Domain, state: Field) -> float:
    """Integral of Re D/2 |grad w|^2 and the equation's density."""
    density = equation.density(domain.nodes(state), constants)
    gradient = 0.5 * float(np.real(equation.diffusion(constants))) * domain.gradient_energy(state)
    return gradient + float(domain.areas @ density)


def evolve(
    equation: Equation,
    constants: Constants,
    domain: Domain,
    start: Field,
    time: float,
    steps: int,
    frames: int,
    shown: Callable[[int, int], None] = lambda _done, _total: None,
) -> History:
    """Solve an equation from values (V,) at vertices: steps of equal length, diffusion implicit, reaction explicit (Euler).

    Of first order in the step; the energy falls for steps up to 1 where |w| stays within 1 (Shen, Yang 2010). frames: how many
    of the states are kept, the first and the last among them. Raises NumericalError where the solution grows out of bounds.
    """
    length = time / steps
    advance = domain.stepper(length * equation.diffusion(constants))
    kept = set(np.unique(np.linspace(0, steps, min(frames, steps + 1)).round().astype(int)).tolist())
    state, bound = domain.start(start), _BOUND * max(float(np.abs(start).max()), 1.0)
    energies, pictures = [energy_of(equation, constants, domain, state)], [domain.at_vertices(state)]
    for k in range(1, steps + 1):
        values = domain.nodes(state)
        with np.errstate(over="ignore", invalid="ignore"):
            state = advance(state, values + length * equation.reaction(values, constants))
        if not (np.isfinite(state).all() and np.abs(domain.nodes(state)).max() < bound):
            raise NumericalError(f"the solution grows out of bounds at time {k * length:.4g}; a smaller --step may do")
        energies.append(energy_of(equation, constants, domain, state))
        if k in kept:
            pictures.append(domain.at_vertices(state))
        shown(k, steps)
    times = np.asarray(length * np.arange(steps + 1), np.float64)
    return History(times, np.array(energies), times[sorted(kept)], np.array(pictures))


def rise_of(energies: FloatArray) -> float:
    """Greatest rise of an energy from one step to the next, as a share of all that it fell; rounding counts as none."""
    scale = max(float(np.ptp(energies)), 1e-12 * float(np.abs(energies).max()), 1e-300)
    rise = float(np.diff(energies).max(initial=0.0)) / scale
    return rise if rise > 1e-9 else 0.0
