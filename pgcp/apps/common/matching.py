"""Two maps to one domain, sphere or disk: centred, brought into line, and where each vertex of one lies on the other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, cast

import numpy as np

from pgcp.apps.common.values import carried, checked
from pgcp.errors import InputError
from pgcp.finish.shape import diagonal
from pgcp.plane import align
from pgcp.plane.harmonics import projected, sphere_grid
from pgcp.plane.locate import Places
from pgcp.plane.space import PLANE
from pgcp.result import Result
from pgcp.surface.operators import around_vertices, face_areas
from pgcp.targets.registry import TARGETS
from pgcp.types import ComplexArray, FloatArray, IntArray, Positions

SCALE, VALUES = "scale", "values"
MOEBIUS, ROTATION = "moebius", "rotation"
_DEGREE, _RINGS, _AROUND = 16, 24, 720
_TRIED = 10
_FIRST_SAMPLE, _FIRST_STEPS, _FINER = 600, 6, 2  # vertices and steps for all turns that are tried; how many are made finer
_SAMPLE, _STEPS = 4000, 30  # for these
_APART = 0.25  # radians between turns that are not the same
_CLEARER = 1.25  # by which the next turn has to be worse
_NO_PATTERN = 1e-3  # least standard deviation of what is compared


@dataclass(frozen=True, slots=True, eq=False)
class Correspondence:
    """Two surfaces whose points correspond by Moebius maps of their conformal maps.

    moebius (2, 2): takes the map of a to that of b, on z of the disk, or of the stereographic projection of ``plane.mobius``.
    on_b: where the vertices of a lie on b, each a face of b, weights of its corners, and a point; on_a: those of b on a.
    record: how the maps were brought into line, as JSON has it.
    """

    a: Result
    b: Result
    moebius: ComplexArray
    on_b: Places
    on_a: Places
    record: dict[str, Any]

    def to_b(self, values: Any) -> np.ndarray:
        """Values (V_a, ...) at the vertices of a as values (V_b, ...) at those of b.

        Numbers are interpolated linearly on faces; whole numbers and truth values are those of the nearest corner.
        """
        return carried(values, self.a.faces, self.on_a)

    def to_a(self, values: Any) -> np.ndarray:
        """Values (V_b, ...) at the vertices of b as values (V_a, ...) at those of a, as ``to_b``."""
        return carried(values, self.b.faces, self.on_b)

    def there_and_back(self, values: Any) -> np.ndarray:
        """Values (V_a, ...) carried to the vertices of b and back to those of a."""
        return self.to_a(self.to_b(values))


class _Domain(Protocol):
    """A map that is centred, with a value at every vertex, which is compared, and a weight.

    Weights are halfway between shares of the surface and of the domain: what is small in the domain counts, and what is large.
    """

    values: FloatArray
    weights: FloatArray
    deviation: float

    def turns(self, other: _Domain) -> list[Any]:
        """Turns after which this one's values are most like the other's, best first."""
        ...

    def finer(self, other: _Domain, start: Any, sample: IntArray, most: int) -> tuple[Any, float]:
        """The turn near one after which they are most like, on a sample of vertices, and the mean of squared differences."""
        ...

    def angle(self, one: Any, other: Any) -> float:
        """Radians between two turns."""
        ...

    def onto(self, other: _Domain, turn: Any) -> ComplexArray:
        """The Moebius map from this one's coordinates to the other's that a turn is between the centred ones."""
        ...


def vertex_areas(points: FloatArray, faces: IntArray) -> FloatArray:
    """A third (V,) of the areas of the faces around every vertex, as a share of all."""
    areas = face_areas(points, faces)
    return around_vertices(areas, faces, len(points)) / (3.0 * float(areas.sum()))


def _ranked(values: FloatArray, weights: FloatArray) -> tuple[FloatArray, float]:
    """Values (V,) as the share of all weight at lesser ones, less a half, and the standard deviation of what they were."""
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order]) - 0.5 * weights[order]
    ranks = np.empty(len(values))
    ranks[order] = below / weights.sum() - 0.5
    share = weights / weights.sum()
    return ranks, float(np.sqrt(share @ (values - share @ values) ** 2))


def _quantiles(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Values between which there are equal weights, so many as there are rings."""
    order = np.argsort(values, kind="stable")
    shares = np.cumsum(weights[order]) / weights.sum()
    return np.asarray(np.interp((np.arange(_RINGS) + 0.5) / _RINGS, shares, values[order]), np.float64)


class _Ball:
    """A map to the sphere."""

    def __init__(self, result: Result, values: FloatArray | None) -> None:
        self.result = result
        own = self.areas = vertex_areas(result.mesh.vertices, result.faces)
        self.matrix = align.centring_of_sphere(result.coordinates, own)
        self.back = align.undone(self.matrix)
        self.points = align.moved_on_sphere(self.matrix, result.coordinates)
        self.weights = 0.5 * (own + vertex_areas(self.points, result.faces))
        scale = result.log_scale + align.log_scale_on_sphere(self.matrix, result.coordinates) if values is None else values
        self.values, self.deviation = _ranked(scale, self.weights)

    def at(self, points: FloatArray) -> FloatArray:
        """Values (n,) at unit vectors (n, 3) of the centred sphere."""
        places = self.result.inverse(align.moved_on_sphere(self.back, points))
        return carried(self.values, self.result.faces, places)

    def turns(self, other: _Ball) -> list[FloatArray]:
        """See _Domain."""
        grid, weights = sphere_grid(_DEGREE)
        values = [projected(_DEGREE, grid, weights * each.at(grid)) for each in (self, other)]
        areas = [projected(_DEGREE, each.points, each.areas) for each in (self, other)]
        return [turn for one, two in (values, areas) for turn in align.turns_of_sphere(one, two, _TRIED)]

    def finer(self, other: _Ball, start: FloatArray, sample: IntArray, most: int) -> tuple[FloatArray, float]:
        """See _Domain."""
        some = self.points[sample], self.values[sample], self.weights[sample]
        return align.finer_turn_of_sphere(start, *some, other.at, most)

    def angle(self, one: FloatArray, other: FloatArray) -> float:
        """See _Domain."""
        return float(np.arccos(np.clip(0.5 * (np.trace(one @ other.T) - 1.0), -1.0, 1.0)))

    def onto(self, other: _Ball, turn: FloatArray) -> ComplexArray:
        """See _Domain."""
        return other.back @ align.rotation_as_moebius(turn) @ self.matrix


class _Disk:
    """A map to the unit disk."""

    def __init__(self, result: Result, values: FloatArray | None) -> None:
        self.result, z = result, PLANE.positions(result.coordinates)
        own = vertex_areas(result.mesh.vertices, result.faces)
        self.matrix = align.centring_of_disk(z, own)
        self.back = align.undone(self.matrix)
        self.points = align.moved_in_plane(self.matrix, z)
        self.weights = 0.5 * (own + vertex_areas(PLANE.in_space(self.points), result.faces))
        scale = result.log_scale + align.log_scale_in_plane(self.matrix, z) if values is None else values
        self.values, self.deviation = _ranked(scale, self.weights)

    def at(self, z: ComplexArray) -> FloatArray:
        """Values (n,) at points (n,) of the centred disk."""
        places = self.result.inverse(PLANE.coordinates(align.moved_in_plane(self.back, z)))
        return carried(self.values, self.result.faces, places)

    def turns(self, other: _Disk) -> list[float]:
        """See _Domain."""
        radii = _quantiles(np.abs(np.concatenate([self.points, other.points])), np.concatenate([self.weights, other.weights]))
        rings = align.disk_rings(radii, _AROUND)
        one, two = (each.at(rings.reshape(-1)).reshape(rings.shape) for each in (self, other))
        return [float(angle) for angle in align.turns_of_disk(one, two, _TRIED)]

    def finer(self, other: _Disk, start: float, sample: IntArray, most: int) -> tuple[float, float]:
        """See _Domain."""
        some = self.points[sample], self.values[sample], self.weights[sample]
        return align.finer_turn_of_disk(start, *some, other.at, most)

    def angle(self, one: float, other: float) -> float:
        """See _Domain."""
        return abs(float(np.angle(np.exp(1j * (one - other)))))

    def onto(self, other: _Disk, turn: float) -> ComplexArray:
        """See _Domain."""
        return other.back @ align.turn_of_disk(turn) @ self.matrix


def is_closed(result: Result) -> bool:
    """Whether a map goes to the sphere."""
    return TARGETS.get(result.target).space.closed


def check_domains(a: Result, b: Result) -> None:
    """Raise InputError where two maps do not go to one sphere or one disk."""
    kinds = [f"{each.mesh.name} is {'closed' if is_closed(each) else 'open'}" for each in (a, b)]
    if is_closed(a) != is_closed(b):
        raise InputError(f"{kinds[0]} and {kinds[1]}; only two closed surfaces, or two open ones, correspond")
    for each in (a, b):
        if TARGETS.get(each.target).has_free_boundary:
            fixed = next(t.name for t in TARGETS.all() if t.space.closed == is_closed(each) and not t.has_free_boundary)
            raise InputError(
                f"{each.mesh.name} is mapped to the target {each.target}, which is no common domain; use target {fixed}"
            )


def matched(
    a: Result,
    b: Result,
    *,
    align_by: str = SCALE,
    values: tuple[Any, Any] | None = None,
    landmarks: Any = None,
    fit: str = MOEBIUS,
) -> Correspondence:
    """Bring two maps to one sphere, or to one disk, into line, and find where each vertex of one lies on the other.

    Both maps are centred: the area of the surface has its mean place at the centre of the ball or the disk, which fixes all but
    a turn (conformal barycentre; Baden, Crane, Kazhdan, Moebius Registration, 2018). The turn is that after which what is
    compared is most alike: ranks of the maps' scale, or, ``align_by="values"``, of values (V_a,) and (V_b,). landmarks (n, 2),
    vertices of a and b, are used instead of both where they are given: by the Moebius map with the least squares of distances
    between them, or by the turn, ``fit="rotation"``. There are no reflections.

    Raises InputError where the maps go to different domains, for words, values and landmarks that do not fit.
    """
    check_domains(a, b)
    if align_by not in (SCALE, VALUES):
        raise InputError(f"unknown alignment {align_by!r}; choose from {SCALE}, {VALUES}")
    if fit not in (MOEBIUS, ROTATION):
        raise InputError(f"unknown fit {fit!r}; choose from {MOEBIUS}, {ROTATION}")
    if landmarks is not None:
        moebius, record = _by_landmarks(a, b, landmarks, fit)
    else:
        if align_by == VALUES and values is None:
            raise InputError("to align by values, values of both surfaces are needed")
        given: list[FloatArray | None] = [None, None]
        if values is not None and align_by == VALUES:
            given = [checked(one, each).astype(np.float64) for each, one in zip((a, b), values, strict=True)]
        moebius, record = _by_likeness(a, b, given)
        record = {"by": align_by, **record}
    return _corresponding(a, b, moebius, record)


def _by_likeness(a: Result, b: Result, values: list[FloatArray | None]) -> tuple[ComplexArray, dict[str, Any]]:
    """The Moebius map after which values are most alike, and what is said of it."""
    kind = cast(Any, _Ball if is_closed(a) else _Disk)
    one, other = (kind(each, own) for each, own in zip((a, b), values, strict=True))
    used = np.random.default_rng(0).permutation(np.unique(a.faces))
    few, sample = used[:_FIRST_SAMPLE], used[:_SAMPLE]
    found = sorted((one.finer(other, start, few, _FIRST_STEPS) for start in one.turns(other)), key=lambda pair: pair[1])
    kept: list[Any] = []
    for turn, _ in found:
        if all(one.angle(turn, earlier) > _APART for earlier in kept):
            kept.append(turn)
    found = sorted((one.finer(other, turn, sample, _STEPS) for turn in kept[:_FINER]), key=lambda pair: pair[1])
    best, error = found[0]
    next_error = next((later for turn, later in found[1:] if one.angle(turn, best) > _APART), None)
    record: dict[str, Any] = {
        "standard_deviation": one.deviation,
        "rms_difference": float(np.sqrt(error)),
        "rms_difference_of_next_turn": None if next_error is None else float(np.sqrt(next_error)),
        "is_sure": bool(one.deviation > _NO_PATTERN and (next_error is None or _CLEARER**2 * error < next_error)),
    }
    return one.onto(other, best), record


def checked_landmarks(landmarks: Any, counts: tuple[int, int], names: tuple[str, str], closed: bool, fit: str) -> IntArray:
    """Pairs (n, 2) of vertices of two surfaces with so many; raises InputError where they are none, or too few for a fit."""
    pairs = np.asarray(landmarks)
    if pairs.dtype.kind not in "iu" or pairs.shape[1:] != (2,):
        raise InputError(f"landmarks have shape {pairs.shape} and type {pairs.dtype}, expected (n, 2) whole numbers")
    for column, count, name in zip(pairs.T, counts, names, strict=True):
        bad = np.flatnonzero((column < 0) | (column >= count))
        if len(bad):
            where = f"pair {int(bad[0]) + 1} of the landmarks has vertex {int(column[bad[0]])}"
            raise InputError(f"{where}, but {name} has {count} vertices")
    needed = (1 if fit == ROTATION else 2) + closed
    different = min((len(np.unique(column)) for column in pairs.T), default=0)
    if different < needed:
        raise InputError(f"there are {different} pairs of different landmarks; a fit by {fit} needs {needed} here")
    return pairs


def _by_landmarks(a: Result, b: Result, landmarks: Any, fit: str) -> tuple[ComplexArray, dict[str, Any]]:
    """The Moebius map that takes landmarks to landmarks as nearly as it can, and what is said of it."""
    closed, counts = is_closed(a), (len(a.mesh.vertices), len(b.mesh.vertices))
    pairs = checked_landmarks(landmarks, counts, (a.mesh.name, b.mesh.name), closed, fit)
    kind = cast(Any, _Ball if closed else _Disk)
    one, other = kind(a, None), kind(b, None)
    fitted = align.landmarks_on_sphere if closed else align.landmarks_in_disk
    middle = cast(Any, fitted)(one.points[pairs[:, 0]], other.points[pairs[:, 1]], fit == ROTATION)
    return other.back @ middle @ one.matrix, {"by": "landmarks", "fit": fit, "pairs": pairs.tolist()}


def _corresponding(a: Result, b: Result, moebius: ComplexArray, record: Mapping[str, Any]) -> Correspondence:
    """Where the vertices of each surface lie on the other."""

    def moved(matrix: ComplexArray, result: Result) -> Positions:
        """Coordinates of all vertices after a Moebius map."""
        if is_closed(result):
            return align.moved_on_sphere(matrix, result.coordinates)
        return PLANE.coordinates(align.moved_in_plane(matrix, PLANE.positions(result.coordinates)))

    moebius = moebius / np.abs(moebius).max()
    on_b, on_a = b.inverse(moved(moebius, a)), a.inverse(moved(align.undone(moebius), b))
    said = dict(record)
    if "pairs" in said:
        pairs = np.array(said["pairs"])
        away = np.linalg.norm(on_b.points[pairs[:, 0]] - b.mesh.vertices[pairs[:, 1]], axis=1) / diagonal(b.mesh)
        said |= {"mean_distance": float(away.mean()), "max_distance": float(away.max())}
    return Correspondence(a, b, moebius, on_b, on_a, said)


def spread(errors: FloatArray) -> dict[str, float]:
    """Mean, 95 % and greatest of errors."""
    return {"mean": float(errors.mean()), "p95": float(np.quantile(errors, 0.95)), "max": float(errors.max())}


def alignment_line(record: Mapping[str, Any]) -> str:
    """What is said of how two maps were brought into line."""
    if "pairs" in record:
        count, mean, most = len(record["pairs"]), record["mean_distance"], record["max_distance"]
        return f"{count} landmarks, brought to within {mean:.2%} of the diagonal on average, {most:.2%} at most"
    said = f"aligned by {record['by']}: ranks differ by {record['rms_difference']:.2%} rms"
    if not record["is_sure"]:
        return f"{said}; another turn does nearly as well: landmarks would decide"
    return said
