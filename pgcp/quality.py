"""How good a map is: angle errors, Beltrami coefficients, folds, area distortion. In slices: nothing mesh-sized is made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgcp.beltrami import covering_degree, find_folds
from pgcp.distortion import angle_error_slice, log_area_ratios
from pgcp.operators import face_areas
from pgcp.parallel import in_slices
from pgcp.types import ComplexArray, FloatArray, IntArray, Mesh, Quality

_BINS = 1 << 14
_MOST_DEG = 180.0


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """What one slice of the faces adds to a map's quality."""

    corners: int
    angle_sum: float
    angle_max: float
    histogram: IntArray
    mu_sum: float
    mu_max: float
    areas: tuple[float, float]
    folds: int


def _bins(errors: FloatArray) -> IntArray:
    bins: IntArray = np.minimum(errors * (_BINS / _MOST_DEG), _BINS - 1).astype(np.int32)
    return bins


class _Measured:
    """One map, measured slice by slice."""

    def __init__(self, mesh: Mesh, coordinates: FloatArray, mu: ComplexArray) -> None:
        self._mesh, self._coordinates, self._mu = mesh, coordinates, mu
        flat = coordinates.shape[1] == 2
        self._points = coordinates[:, 0] + 1j * coordinates[:, 1] if flat else coordinates
        self._solid_image = np.column_stack([coordinates, np.zeros(len(coordinates))]) if flat else coordinates

    def _areas(self, begin: int, end: int) -> tuple[FloatArray, FloatArray]:
        faces = self._mesh.faces[begin:end]
        return face_areas(self._mesh.vertices, faces), face_areas(self._solid_image, faces)

    def _errors(self, begin: int, end: int, solid: np.ndarray) -> FloatArray:
        errors = angle_error_slice(self._mesh.vertices, self._coordinates, self._mesh.faces, begin, end)
        return errors if solid.all() else errors[solid]

    def first(self, begin: int, end: int) -> _Part:
        """Sums, extremes and a histogram of the angle errors."""
        surface, image = self._areas(begin, end)
        solid = surface > 0.0
        errors = self._errors(begin, end, solid).reshape(-1)
        size = np.abs(self._mu[begin:end][solid])
        return _Part(
            corners=len(errors),
            angle_sum=float(errors.sum()),
            angle_max=float(errors.max(initial=0.0)),
            histogram=np.bincount(_bins(errors), minlength=_BINS),
            mu_sum=float(size.sum()),
            mu_max=float(size.max(initial=0.0)),
            areas=(float(surface.sum()), float(image.sum())),
            folds=len(find_folds(self._mesh.faces[begin:end], self._points)),
        )

    def second(self, begin: int, end: int, mean: float, wanted: IntArray, totals: tuple[float, float]) -> tuple[float, ...]:
        """Squares about the mean, errors in the wanted bins, and the sum, number and largest of log area ratios.

        The last two are the number of solid faces without a finite ratio, and the errors.
        """
        surface, image = self._areas(begin, end)
        solid = surface > 0.0
        errors = self._errors(begin, end, solid).reshape(-1)
        ratio = np.abs(log_area_ratios(surface, image, totals))
        finite = np.isfinite(ratio)
        squares = float(((errors - mean) ** 2).sum())
        some = errors[np.isin(_bins(errors), wanted)]
        largest = float(ratio[finite].max(initial=0.0))
        return squares, float(ratio[finite & solid].sum()), largest, int((solid & ~finite).sum()), some  # type: ignore[return-value]


def _ranked(ranks: list[int], histogram: IntArray, some: FloatArray, wanted: IntArray) -> list[float]:
    """Order statistics of all errors, from the sorted ones of the wanted bins and how many lie in the bins before."""
    before = np.cumsum(histogram) - histogram
    counts = histogram[wanted]
    starts = np.cumsum(counts) - counts
    out = []
    for rank in ranks:
        k = int(np.searchsorted(before[wanted], rank, side="right")) - 1
        out.append(float(some[starts[k] + rank - before[wanted[k]]]))
    return out


def measure_quality(mesh: Mesh, coordinates: FloatArray, mu: ComplexArray) -> Quality:
    """Measure a map to the plane, coordinates (V, 2), or to the sphere, (V, 3), by chordal triangles. mu (F,).

    Faces without area on the surface have no angles to keep: they count for folds only. Median and quantile are exact: a
    histogram says in which bins they lie, and what lies in these is sorted.
    """
    measured = _Measured(mesh, coordinates, mu)
    parts = in_slices(measured.first, len(mesh.faces))
    count = sum(part.corners for part in parts)
    mean = sum(part.angle_sum for part in parts) / count
    histogram = np.sum([part.histogram for part in parts], axis=0)
    at = 0.99 * (count - 1)
    ranks = [(count - 1) // 2, count // 2, int(at), min(int(at) + 1, count - 1)]
    wanted = np.unique(np.searchsorted(np.cumsum(histogram), ranks, side="right"))
    totals = (sum(part.areas[0] for part in parts), sum(part.areas[1] for part in parts))
    more = in_slices(lambda begin, end: measured.second(begin, end, mean, wanted, totals), len(mesh.faces))
    squares, logs, largest, without, some = zip(*more, strict=True)
    one, two, low, high = _ranked(ranks, histogram, np.sort(np.concatenate(some)), wanted)
    return Quality(
        angle_mean_deg=mean,
        angle_sd_deg=float(np.sqrt(sum(squares) / count)),
        angle_median_deg=0.5 * (one + two),
        angle_p99_deg=low + (at - int(at)) * (high - low),
        angle_max_deg=max(part.angle_max for part in parts),
        mu_mean=sum(part.mu_sum for part in parts) / (count // 3),
        mu_max=max(part.mu_max for part in parts),
        folds=sum(part.folds for part in parts),
        log_area_mean=(sum(logs) + sum(without) * max(largest)) / (count // 3),
        degree=None if coordinates.shape[1] == 2 else covering_degree(mesh.faces, coordinates),
    )
