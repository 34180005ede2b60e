"""Spherical harmonics of a closed surface: its places, and values on it, as sums of harmonics on its map to the sphere."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pgcp.apps.base import App, Call, Group, Made, add_mesh, folds_said, map_record, npz_file
from pgcp.apps.common.joined import joined
from pgcp.apps.common.values import checked, of_input, source_of
from pgcp.errors import InputError, NumericalError
from pgcp.io.values import VALUE_FILES, read_values, table_of
from pgcp.io.write import mesh_files
from pgcp.options import AUTO
from pgcp.parallel import one_blas_thread
from pgcp.plane.harmonics import at_points, degree_and_order, fitted, power_by_degree
from pgcp.result import Result
from pgcp.surface.elements import lumped_areas
from pgcp.surface.operators import face_areas
from pgcp.targets.registry import TARGETS
from pgcp.types import FloatArray, Mesh

_USUAL, _MOST = 20, 80  # degrees
_VERTICES = 4  # for each harmonic, where no degree is asked for
_BAD, _HOPELESS = 1e8, 1e14  # conditions of fits whose single coefficients mean little, or that there are none of
_CONVENTION = (
    "real, orthonormal on the unit sphere, without the Condon-Shortley factor: m >= 0 goes with cos(m phi), m < 0 with "
    "sin(-m phi); l^2 + l + m is the place of l, m"
)


@dataclass(frozen=True, slots=True, eq=False)
class Expansion:
    """A surface, and values on it, as sums of spherical harmonics up to a degree L.

    coefficients ((L + 1)^2, 3 + C): of x, y, z and of C further values, row l^2 + l + m for degree l and order m. errors
    (L + 1, 1 + C): root mean square over the surface of the distance, and of each value's error, by degree; sizes (1 + C,):
    the same of the distance from the centroid, and of values less their mean. power (L + 1, 1 + C): sums of squares over
    orders. condition: of the least squares fit.
    """

    coefficients: FloatArray
    names: tuple[str, ...]
    errors: FloatArray
    sizes: FloatArray
    power: FloatArray
    condition: float
    _fits: tuple[FloatArray, ...]
    _sphere: FloatArray

    @property
    def degree(self) -> int:
        """The highest degree L."""
        return len(self.errors) - 1

    def coefficients_of(self, degree: int) -> FloatArray:
        """Coefficients ((l + 1)^2, 3 + C) of the best fit up to a lower degree; raises InputError for a degree above L."""
        if not 0 <= degree <= self.degree:
            raise InputError(f"degree is {degree}; the expansion goes from 0 to {self.degree}")
        return self._fits[degree]

    def reconstructed(self, degree: int | None = None) -> FloatArray:
        """Places and values (V, 3 + C) of the mesh's vertices by harmonics up to a degree, the highest if not given."""
        return at_points(self.coefficients_of(self.degree if degree is None else degree), self._sphere)


def expand(result: Result, degree: int | None = None, values: Any = None, names: tuple[str, ...] = ()) -> Expansion:
    """Expand a closed surface in spherical harmonics on its map to the sphere, by least squares weighted by area.

    The sum of squares is over vertices, each with the area of the surface around it: the fit has the least root mean square
    distance from the surface, which is the error that is stated (Brechbuehler, Gerig, Kuebler 1995, on a conformal map).
    degree: the highest, else 20, or less where there are few vertices. values (V,) or (V, C): further values at vertices.

    Coefficients depend on the map: correct it for least area distortion (``moebius="area"``), which leaves turns of the sphere
    only, and those do not change ``power``.
    Raises InputError for maps to the plane and for degrees that make no sense, NumericalError where the map is too squeezed.
    """
    if not TARGETS.get(result.target).space.closed:
        raise InputError("spherical harmonics are of closed surfaces mapped to the sphere, and this map goes to the plane")
    surface, whole = joined(result), len(result.mesh.vertices)
    given = np.zeros((whole, 0)) if values is None else checked(values, result, most=2).reshape(whole, -1).astype(np.float64)
    count = len(surface.vertices)
    if degree is None:
        degree = max(min(_USUAL, int((count / _VERTICES) ** 0.5) - 1), 1)
    if not 0 <= degree <= _MOST:
        raise InputError(f"degree is {degree}; it must be from 0 to {_MOST}")
    if (degree + 1) ** 2 > count:
        raise InputError(f"degree {degree} has {(degree + 1) ** 2} harmonics, more than the surface has vertices, {count}")
    areas = lumped_areas(face_areas(surface.vertices, surface.faces), surface.faces, count)
    table = np.hstack([surface.vertices, given[surface.first]])
    middle = areas @ table / areas.sum()
    spread = np.sqrt(areas @ (table - middle) ** 2 / areas.sum())
    scale = np.where(spread > 0.0, spread, 1.0)
    scale[:3] = max(float(np.linalg.norm(spread[:3])), 1e-300)
    with one_blas_thread():  # the same bits for any number of processors
        fit = fitted(degree, surface.image, areas, (table - middle) / scale)
    if not fit.condition < _HOPELESS:
        raise NumericalError(f"degree {degree} cannot be fitted: the map squeezes too much of the surface; choose a lower one")
    fits = []
    for k in range(degree + 1):
        found = fit.coefficients(k) * scale
        found[0] += middle * np.sqrt(4.0 * np.pi)
        fits.append(found)
    squares = fit.rest * scale**2
    errors = np.sqrt(np.column_stack([squares[:, :3].sum(axis=1), squares[:, 3:]]))
    sizes = np.concatenate([[np.linalg.norm(spread[:3])], spread[3:]])
    last = fits[-1]
    powers = [power_by_degree(part) for part in (last[:, :3], *last[:, 3:].T[:, :, None])]
    labels = ("x", "y", "z", *(names or tuple(f"value_{k + 1}" for k in range(len(given.T)))))
    return Expansion(last, labels, errors, sizes, np.column_stack(powers), fit.condition, tuple(fits), result.coordinates)


# The command ------------------------------------------------------------------------------------------------------------------


def _ask(group: Group) -> None:
    add_mesh(group)
    group.add_argument(
        "--degree", type=int, metavar="L", help=f"the highest (default {_USUAL}, less where there are few vertices)"
    )
    group.add_argument(
        "--values", type=Path, metavar="FILE", help=f"values at the mesh's vertices, expanded too: {VALUE_FILES}"
    )


def _run(call: Call) -> Made:
    asked = call["degree"]
    if asked is not None and not 0 <= asked <= _MOST:
        raise InputError(f"--degree is {asked}; it must be from 0 to {_MOST}")
    source, count = source_of(call["mesh"])
    given = read_values(call["values"], count) if call["values"] else {}
    moebius = {"moebius": "area"} if call.options.moebius == AUTO else {}
    result = call.mapped(source, _closed_target(), **moebius)
    call.shown("expand", 0, 0)
    expansion = expand(result, asked, table_of(of_input(result, given)) if given else None)
    call.shown("expand", 1, 1)
    return _made(result, expansion)


def _closed_target() -> str:
    return next(target.name for target in TARGETS.all() if target.space.closed)


def _record(result: Result, expansion: Expansion) -> dict[str, Any]:
    """Figures of an expansion."""
    return {
        "map": {**map_record(result), "log_area_mean": result.quality.log_area_mean},
        "degree": expansion.degree,
        "convention": _CONVENTION,
        "names": list(expansion.names),
        "size": float(expansion.sizes[0]),
        "errors": expansion.errors[:, 0].tolist(),
        "errors_relative": (expansion.errors[:, 0] / max(float(expansion.sizes[0]), 1e-300)).tolist(),
        "errors_of_values": expansion.errors[:, 1:].T.tolist(),
        "power": expansion.power[:, 0].tolist(),
        "power_of_values": expansion.power[:, 1:].T.tolist(),
        "condition": expansion.condition,
    }


def _lines(result: Result, expansion: Expansion) -> tuple[str, ...]:
    """What the user is told: the error at some degrees."""
    size = max(float(expansion.sizes[0]), 1e-300)
    head = f"{(expansion.degree + 1) ** 2} harmonics up to degree {expansion.degree}; size (rms) {size:.6g}"
    rows = [
        f"degree {k:3d}: rms distance {expansion.errors[k, 0]:.4g}, {expansion.errors[k, 0] / size:.3%} of the size"
        for k in _some_degrees(expansion.degree)
    ]
    values = [
        f"{name}: error {error:.4g} at degree {expansion.degree}, of {whole:.4g}"
        for name, error, whole in zip(expansion.names[3:], expansion.errors[-1, 1:], expansion.sizes[1:], strict=True)
    ]
    area = f"area distortion of the map (mean |log ratio|) {result.quality.log_area_mean:.3g}"
    return (head, area, *rows, *values)


def _some_degrees(degree: int) -> list[int]:
    """Some degrees up to the highest."""
    return sorted({*(k for k in (1, 2, 3, 5, 8, 12, 16, 20, 30, 40, 60) if k < degree), degree})


def coefficients_json(expansion: Expansion) -> bytes:
    """Coefficients with their degrees and orders, as JSON."""
    degrees, orders = degree_and_order(expansion.degree)
    rows = [[int(k), int(m), *row] for k, m, row in zip(degrees, orders, expansion.coefficients.tolist(), strict=True)]
    said = {
        "degree": expansion.degree,
        "convention": _CONVENTION,
        "columns": ["l", "m", *expansion.names],
        "coefficients": rows,
    }
    return json.dumps(said, allow_nan=False).encode() + b"\n"


def _made(result: Result, expansion: Expansion) -> Made:
    def npz(name: str) -> dict[str, bytes]:
        """Arrays."""
        degrees, orders = degree_and_order(expansion.degree)
        return npz_file(
            name, coefficients=expansion.coefficients, degrees=degrees, orders=orders, names=np.array(expansion.names),
            errors=expansion.errors, sizes=expansion.sizes, power=expansion.power, reconstructed=expansion.reconstructed(),
            sphere=result.coordinates,
        )  # fmt: skip

    def mesh(name: str) -> dict[str, bytes]:
        """The reconstructed surface."""
        return mesh_files(name, Mesh(expansion.reconstructed()[:, :3], result.faces, result.mesh.name))

    files = {
        "_coefficients.json": lambda name: {name: coefficients_json(expansion)},
        ".npz": npz,
        ".ply": mesh,
        ".png": lambda name: {name: picture(result, expansion)},
    }
    problem = folds_said(result)
    if not problem and not expansion.condition < _BAD:
        problem = (
            f"the fit is badly conditioned ({expansion.condition:.1e}), so single coefficients mean little: "
            "the map squeezes parts of the surface; choose a lower --degree"
        )
    return Made(files, _record(result, expansion), _lines(result, expansion), problem)


def picture(result: Result, expansion: Expansion) -> bytes:
    """PNG bytes: the surface, reconstructions at some degrees, and the error and the power by degree."""
    from pgcp.report.panels import as_png, curves, panel, sheet
    from pgcp.report.seen import Seen, plain, view_rotation

    mesh, size = result.mesh, max(float(expansion.sizes[0]), 1e-300)
    rotation = view_rotation(mesh.vertices, result.faces)
    panels = [panel("the surface", Seen.of(mesh.vertices, result.faces, rotation).drawn(plain))]
    top = expansion.degree
    for degree in sorted({max(min(2, top), 0), round(0.4 * top), top}):
        places = expansion.reconstructed(degree)[:, :3]
        drawn = Seen.of(places, result.faces, rotation).drawn(plain)
        panels.append(panel(f"degree {degree}: error {expansion.errors[degree, 0] / size:.2%} of the size", drawn))
    errors = np.maximum(expansion.errors / np.maximum(expansion.sizes, 1e-300), 1e-16)
    power = np.maximum(expansion.power[:, :1], 1e-32 * float(expansion.power[:, 0].max()))
    degrees = np.arange(top + 1.0)
    if top:
        said = "error over size (blue: places" + (", then values)" if errors.shape[-1] > 1 else ")")
        panels.append(curves(said, "highest degree", degrees, list(errors.T), log=True, dots=6))
        panels.append(
            curves("power by degree, the same for all turns", "degree", degrees[1:], list(power[1:].T), log=True, dots=6)
        )
    return as_png(sheet(f"{mesh.name}: spherical harmonics up to degree {top}", panels))


APP = App(
    name="harmonics",
    summary="expand a closed surface in spherical harmonics, and put it together again from them",
    writes={
        "_coefficients.json": "coefficients by degree and order",
        ".npz": "coefficients, errors, power and the reconstructed places, as arrays",
        ".ply": "the reconstructed surface",
        ".png": "the picture",
    },
    arguments=_ask,
    run=_run,
    reference="Brechbuehler, Gerig, Kuebler 1995",
)
