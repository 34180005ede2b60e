"""How good a map is: angle errors, Beltrami coefficients, folds, area distortion. In slices: nothing mesh-sized is made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgcp.parallel import in_slices
from pgcp.plane.space import Space, find_folds
from pgcp.surface.distortion import angle_error_slice, log_area_ratios
from pgcp.surface.operators import face_areas
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray, Mesh, Quality

_BINS = 1 << 14
_MOST_DEG = 180.0
_QUANTILES = (0.5, 0.99)
_SAMPLE = 1 << 16  # faces of the sample that predicts the bins of the quantiles
_SURE = 6.0  # standard deviations of a quantile of such a sample


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """What one slice of the faces adds to a map's quality."""

    corners: int
    angle_mean: float
    angle_squares: float  # about that mean
    angle_max: float
    histogram: IntArray
    some: FloatArray  # errors in the predicted bins
    mu_sum: float
    mu_max: float
    log_sum: float
    log_max: float
    without_log: int  # solid faces whose image has no area
    folds: int


def _bins(errors: FloatArray) -> IntArray:
    bins: IntArray = np.minimum(errors * (_BINS / _MOST_DEG), _BINS - 1).astype(np.int32)
    return bins


class _Measured:
    """One map, measured slice by slice."""

    def __init__(self, mesh: Mesh, space: Space, coordinates: FloatArray, mu: ComplexArray) -> None:
        self._mesh, self._space, self._coordinates, self._mu = mesh, space, coordinates, mu
        self._points = space.positions(coordinates)
        self._solid_image = space.in_space(self._points)

    def _areas(self, begin: int, end: int) -> tuple[FloatArray, FloatArray]:
        faces = self._mesh.faces[begin:end]
        return face_areas(self._mesh.vertices, faces), face_areas(self._solid_image, faces)

    def totals(self, begin: int, end: int) -> tuple[float, float]:
        """Area of some faces on the surface and in the image."""
        surface, image = self._areas(begin, end)
        return float(surface.sum()), float(image.sum())

    def likely(self) -> BoolArray:
        """Bins (_BINS,) in which the quantiles most likely lie, by an even sample of the faces."""
        faces = np.ascontiguousarray(self._mesh.faces[:: max(1, len(self._mesh.faces) // _SAMPLE)])
        errors = np.sort(angle_error_slice(self._mesh.vertices, self._coordinates, faces, 0, len(faces)), axis=None)
        out = np.zeros(_BINS, bool)
        for quantile in _QUANTILES:
            reach = _SURE * np.sqrt(quantile * (1.0 - quantile) / len(faces))
            ends = np.clip(np.array([quantile - reach, quantile + reach]) * len(errors), 0, len(errors) - 1).astype(np.int64)
            low, high = _bins(errors[ends])
            out[low : high + 1] = True
        return out

    def errors(self, begin: int, end: int, solid: BoolArray | None = None) -> FloatArray:
        """Angle errors of all corners of solid faces."""
        errors = angle_error_slice(self._mesh.vertices, self._coordinates, self._mesh.faces, begin, end)
        if solid is None:
            solid = face_areas(self._mesh.vertices, self._mesh.faces[begin:end]) > 0.0
        return (errors if solid.all() else errors[solid]).reshape(-1)

    def errors_in(self, begin: int, end: int, wanted: BoolArray) -> FloatArray:
        """Those in the wanted bins."""
        errors = self.errors(begin, end)
        return errors[wanted[_bins(errors)]]

    def part(self, begin: int, end: int, totals: tuple[float, float], likely: BoolArray) -> _Part:
        """Sums, extremes and a histogram of the angle errors."""
        surface, image = self._areas(begin, end)
        solid = surface > 0.0
        errors = self.errors(begin, end, solid)
        mean = float(errors.mean()) if len(errors) else 0.0
        bins = _bins(errors)
        size = np.abs(self._mu[begin:end][solid])
        ratio = np.abs(log_area_ratios(surface, image, totals))
        finite = np.isfinite(ratio)
        return _Part(
            corners=len(errors),
            angle_mean=mean,
            angle_squares=float(((errors - mean) ** 2).sum()),
            angle_max=float(errors.max(initial=0.0)),
            histogram=np.bincount(bins, minlength=_BINS),
            some=errors[likely[bins]],
            mu_sum=float(size.sum()),
            mu_max=float(size.max(initial=0.0)),
            log_sum=float(ratio[finite & solid].sum()),
            log_max=float(ratio[finite].max(initial=0.0)),
            without_log=int((solid & ~finite).sum()),
            folds=len(find_folds(self._space, self._mesh.faces[begin:end], self._points)),
        )


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


def measure_quality(mesh: Mesh, space: Space, coordinates: FloatArray, mu: ComplexArray) -> Quality:
    """Measure a map to the plane, coordinates (V, 2), or to the sphere, (V, 3), by chordal triangles. mu (F,).

    Faces without area on the surface have no angles to keep: they count for folds only. Median and quantile are exact: a
    histogram says in which bins they lie, and what lies in these is sorted.
    """
    measured, face_count = _Measured(mesh, space, coordinates, mu), len(mesh.faces)
    surfaces, images = zip(*in_slices(measured.totals, face_count), strict=True)
    totals, likely = (sum(surfaces), sum(images)), measured.likely()
    parts = in_slices(lambda begin, end: measured.part(begin, end, totals, likely), face_count)
    count = sum(part.corners for part in parts)
    mean = sum(part.angle_mean * part.corners for part in parts) / count
    squares = sum(part.angle_squares + part.corners * (part.angle_mean - mean) ** 2 for part in parts)
    histogram = np.sum([part.histogram for part in parts], axis=0)
    at = _QUANTILES[1] * (count - 1)
    ranks = [(count - 1) // 2, count // 2, int(at), min(int(at) + 1, count - 1)]
    wanted = np.unique(np.searchsorted(np.cumsum(histogram), ranks, side="right"))
    is_wanted = np.isin(np.arange(_BINS), wanted)
    if likely[wanted].all():
        some = np.concatenate([part.some for part in parts])
        some = some[is_wanted[_bins(some)]]
    else:
        some = np.concatenate(in_slices(lambda begin, end: measured.errors_in(begin, end, is_wanted), face_count))
    one, two, low, high = _ranked(ranks, histogram, np.sort(some), wanted)
    largest, without = max(part.log_max for part in parts), sum(part.without_log for part in parts)
    return Quality(
        angle_mean_deg=mean,
        angle_sd_deg=float(np.sqrt(squares / count)),
        angle_median_deg=0.5 * (one + two),
        angle_p99_deg=low + (at - int(at)) * (high - low),
        angle_max_deg=max(part.angle_max for part in parts),
        mu_mean=sum(part.mu_sum for part in parts) / (count // 3),
        mu_max=max(part.mu_max for part in parts),
        folds=sum(part.folds for part in parts),
        log_area_mean=(sum(part.log_sum for part in parts) + without * largest) / (count // 3),
        degree=space.degree(mesh.faces, space.positions(coordinates)),
    )


def single_precision_folds(space: Space, faces: IntArray, coordinates: FloatArray) -> int:
    """How many faces would be folded by coordinates rounded to 32-bit floats, in the plane also as (u, 1 - v) like in glTF."""
    with np.errstate(over="ignore", under="ignore"):
        kinds = [coordinates.astype(np.float32).astype(np.float64)]
        if not space.closed:
            turned = (1.0 - coordinates[:, 1]).astype(np.float32).astype(np.float64)
            kinds.append(np.column_stack([kinds[0][:, 0], 1.0 - turned]))
    if not all(np.isfinite(kind).all() for kind in kinds):
        return len(faces)
    return max(len(find_folds(space, faces, space.positions(kind))) for kind in kinds)
