"""Maps of long thin surfaces in the logarithm of their position: from a tip at 0 to a tip at infinity, or to the circle.

The conformal image of a long thin part shrinks exponentially, to 1e-65 and less, and no two positions there can be told apart
unless the tip lies at 0 (or infinity), where floating point keeps relative precision. So the tip p is put there, and what is
solved for is w = log z = u + i v, which only grows linearly: harmonic on the surface without the faces around the tips,
v with a period of 2 pi around them, and the flux of u through every closed curve around p equal to that period (for a
conformal map v is the conjugate of u). Around a tip itself z is smooth where w is not: there z is harmonic, with
its tip at 0, and 1 / z at the other one. Both give each other their boundary in turn (Schwarz 1870).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order

from pgcp.elimination.sparse_boundary import applied, either_factor
from pgcp.errors import CrowdedError, SolveFailedError
from pgcp.surface.operators import cotangent_laplacian, face_areas, positive_laplacian
from pgcp.surface.topology import pair_half_edges
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray, Mesh

_LEAST_WEIGHT = 0.1
_CAP = 2.5  # log of a cap's radius to that of the faces around its tip
_TURNS = 4
_LONGEST = 690.0  # log of the smallest number
_LEAST_GAP = 1e-6  # to the mean gap
_FEW_GAPS = 0.02
_SAME = 1e-9
_MOST_KEPT = 4000


@dataclass(frozen=True, slots=True, eq=False)
class Polar:
    """Logarithms w (V,) of positions: -inf at the vertex ``tip``, inf at the vertex ``far``; or far -1, u = 0 on the rim."""

    w: ComplexArray
    tip: int
    far: int


def far_ends(vertices: FloatArray, faces: IntArray, boundary: IntArray, laplacian: csr_array, backend: str) -> tuple[int, int]:
    """Two vertices of a closed surface conformally far from each other, or the one farthest from the boundary, and -1.

    Where u is least with a source at one vertex that flows off evenly over the surface's area; or most with sources all over it
    that flow off through the boundary. Distances along edges would mislead where faces are long and thin.
    """
    share = np.bincount(faces.reshape(-1), np.repeat(face_areas(vertices, faces), 3), len(vertices)) / 3.0
    held = boundary if len(boundary) else faces[0, :1]
    factor = either_factor(laplacian, held, backend)
    none = np.zeros(len(held), np.complex128)

    def farthest(source: int) -> int:
        """Where u is least with a source at a vertex."""
        load = -share.astype(np.complex128)
        load[source] += share.sum()
        return _first_least(factor.solve(load, none).real)

    if len(boundary):
        u = factor.solve(share.astype(np.complex128), none).real
        u[boundary] = 0.0
        return _first_least(-u), -1
    one = farthest(int(faces[0, 0]))
    return one, farthest(one)


def _first_least(u: FloatArray) -> int:
    """The first of the least values, whichever of those is least by rounding."""
    return int(np.argmax(u <= u.min() + _SAME * np.ptp(u)))


def _link(faces: IntArray, vertex: int) -> IntArray:
    """The vertices around an inner vertex, counter-clockwise."""
    around = faces[(faces == vertex).any(axis=1)]
    corner = np.argmax(around == vertex, axis=1)
    rows = np.arange(len(around))
    after = dict(zip(around[rows, (corner + 1) % 3].tolist(), around[rows, (corner + 2) % 3].tolist(), strict=True))
    loop = [int(around[0, (corner[0] + 1) % 3])]
    while len(loop) < len(after):
        loop.append(after[loop[-1]])
    return np.array(loop)


def _crossed(faces: IntArray, twins: IntArray, starts: BoolArray, far: int) -> IntArray:
    """Half-edges (n,) by which a shortest path of faces leaves each of its faces, from the faces ``starts`` on.

    It leads to the faces around the vertex ``far``, or where that is -1 out through the boundary.
    """
    ends: BoolArray = np.any(faces == far if far >= 0 else twins.reshape(-1, 3) < 0, axis=1)
    own = np.flatnonzero(twins >= 0)
    count = len(faces)
    # one more face beside all where the path may start
    rows = np.concatenate([own // 3, np.full(int(starts.sum()), count)])
    columns = np.concatenate([twins[own] // 3, np.flatnonzero(starts)])
    graph = csr_array((np.ones(len(rows), np.int8), (rows, columns)), (count + 1, count + 1))
    order, before = breadth_first_order(graph, count, directed=True)
    f = last = int(order[np.argmax(ends[order[1:]]) + 1])
    out = []
    while not starts[f]:
        previous = int(before[f])
        out.append(next(3 * previous + i for i in range(3) if twins[3 * previous + i] // 3 == f))
        f = previous
    out.reverse()
    if far < 0:
        out.append(3 * last + int(np.argmax(twins[3 * last : 3 * last + 3] < 0)))
    return np.array(out, np.int64)


class _Strip:
    """The surface without the faces around its tips, rolled out: jumps of v along edges, and its harmonic functions."""

    def __init__(self, mesh: Mesh, laplacian: csr_array, tip: IntArray, end: IntArray, jumps: csr_array, backend: str) -> None:
        self.tip, self.end = tip, end
        self._kept = np.concatenate([tip, end])
        weights = -laplacian
        self._load = 2.0j * np.pi * np.asarray(weights.multiply(jumps).sum(axis=1)).reshape(-1)
        self.factor = either_factor(laplacian, self._kept, backend)
        self._at_tip = np.concatenate([np.ones(len(tip)), np.zeros(len(end))]).astype(np.complex128)
        self._flux_of_one = self._flux(self._at_tip, False)[: len(tip)].sum()
        if not np.isfinite(self._flux_of_one) or self._flux_of_one == 0.0:
            raise SolveFailedError("no flux passes from one end of the surface to the other")

    def _flux(self, values: ComplexArray, jumps: bool = True) -> ComplexArray:
        """What flows out of the strip at each of the kept vertices."""
        out = applied(self.factor.schur, values)
        if jumps:
            out = out - self.factor.reduce(self._load)
        return out

    def shifted(self, at_tip: ComplexArray, at_end: ComplexArray) -> ComplexArray:
        """Values at the kept vertices, those at the tip shifted by the number that makes the flux that of a logarithm."""
        values = np.concatenate([at_tip, at_end])
        missing = -2.0 * np.pi - self._flux(values)[: len(self.tip)].sum()
        out: ComplexArray = values + missing / self._flux_of_one * self._at_tip
        return out

    def flux_at_end(self, values: ComplexArray) -> ComplexArray:
        """Flux at each vertex of the other end."""
        return self._flux(values)[len(self.tip) :]

    def solve(self, values: ComplexArray) -> ComplexArray:
        """Values of the harmonic function at all vertices."""
        out = self.factor.solve(self._load, values)
        out[self._kept] = values
        return out


class _Cap:
    """What lies around a tip: z is harmonic here."""

    def __init__(self, mesh: Mesh, inside: BoolArray, tip: int, link: IntArray, sign: float, weights: _Weights) -> None:
        self._tip, self._link, self._sign = tip, link, sign
        here = inside[mesh.faces].any(axis=1)
        self.ids, local = np.unique(mesh.faces[here], return_inverse=True)
        self._held, self.free = np.flatnonzero(~inside[self.ids]), np.flatnonzero(inside[self.ids])
        laplacian = weights.laplacian(mesh.vertices[self.ids], local.reshape(-1, 3))
        self._factor = either_factor(laplacian, self._held, weights.backend)

    def solve(self, w: ComplexArray) -> ComplexArray:
        """Logarithms of positions in the cap (n,), from those on its rim; the sign is -1 where 1 / z is harmonic."""
        around = self._sign * w[self.ids[self._held]]
        middle = float(around.real.mean())
        z: ComplexArray = self._factor.extend(np.exp(around - middle))
        z[self._held] = np.exp(around - middle)
        z -= z[np.searchsorted(self.ids, self._tip)]
        with np.errstate(divide="ignore", invalid="ignore"):
            out: ComplexArray = np.asarray(np.log(z), np.complex128)
        out.real += middle
        return out if self._sign > 0.0 else -out

    def around(self, w: ComplexArray, jumps: csr_array) -> ComplexArray:
        """Logarithms on the link, from those of the cap, each turned by so many periods that they fit across its edges."""
        values = w[np.searchsorted(self.ids, self._link)]
        return _unrolled(values, self._link, jumps)


@dataclass(frozen=True, slots=True)
class _Weights:
    """Cotangent weights, or those raised to 0.1 where they are less."""

    positive: bool
    mollification: float
    backend: str

    def laplacian(self, vertices: FloatArray, faces: IntArray) -> csr_array:
        """Laplacian (n, n) of some faces."""
        if not self.positive:
            return cotangent_laplacian(vertices, faces, self.mollification)
        return positive_laplacian(vertices, faces, np.ones(len(faces), bool), _LEAST_WEIGHT, self.mollification)[0]


def _unrolled(w: ComplexArray, loop: IntArray, jumps: csr_array) -> ComplexArray:
    """Logarithms along a loop, each imaginary part the one nearest to its predecessor's that is right across the edge."""
    step = np.angle(np.exp(1j * np.diff(w.imag)))
    across = np.asarray(jumps[loop[:-1], loop[1:]]).reshape(-1)
    v = w[0].imag + np.concatenate([[0.0], np.cumsum(step - 2.0 * np.pi * across)])
    out: ComplexArray = w.real + 1j * v
    return out


def _around_circle(mesh: Mesh, loop: IntArray, jumps: csr_array, sign: float) -> ComplexArray:
    """Logarithms of points on the unit circle, by length along a loop."""
    points = mesh.vertices[loop]
    lengths = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    lengths = np.maximum(lengths, 1e-6 * lengths.sum())
    angles = sign * 2.0 * np.pi * (np.cumsum(lengths) - lengths) / lengths.sum()
    return _unrolled(1j * angles.astype(np.complex128), loop, jumps)


def polar_map(mesh: Mesh, boundary: IntArray, mollification: float, backend: str, positive: bool = False) -> Polar:
    """The map of a closed surface, or of an open one with its boundary loop (B,), as logarithms of positions.

    Closed surfaces go to the extended plane, open ones to the unit disk. ``positive`` weights fold least. Raises
    SolveFailedError where the surface has no inner tip or a system cannot be solved, CrowdedError where double precision has
    no numbers small enough.
    """
    used, local = np.unique(mesh.faces, return_inverse=True)
    own = Mesh(mesh.vertices[used], local.reshape(-1, 3))
    rim = np.searchsorted(used, boundary)
    if len(rim) > _MOST_KEPT:
        raise SolveFailedError("the boundary is too long")
    found = _polar(own, rim, _Weights(positive, mollification, backend))
    w = np.zeros(len(mesh.vertices), np.complex128)
    w[used] = found.w
    return Polar(w, int(used[found.tip]), int(used[found.far]) if found.far >= 0 else -1)


def _polar(mesh: Mesh, rim: IntArray, weights: _Weights) -> Polar:
    """See ``polar_map``; every vertex is used."""
    faces, n = mesh.faces.astype(np.int64), len(mesh.vertices)
    tip, far = far_ends(mesh.vertices, faces, rim, weights.laplacian(mesh.vertices, faces), weights.backend)
    if tip in rim:
        raise SolveFailedError("the surface has no inner tip")
    links = [_link(faces, tip)] + ([_link(faces, far)] if far >= 0 else [])
    if len(np.intersect1d(links[0], rim if far < 0 else links[1])) or (far >= 0 and far in links[0]):
        raise SolveFailedError("the surface has no two ends apart from each other")
    at_tip, at_far = (faces == tip).any(axis=1), (faces == far).any(axis=1)
    twins = pair_half_edges(faces, n)
    crossed = _crossed(faces, twins, at_tip, far)
    one, two = faces.reshape(-1)[crossed], faces[:, [1, 2, 0]].reshape(-1)[crossed]
    # counter-clockwise around the tip, a half-edge of the face nearer to it runs across the path in the sense of growing v
    jumps = csr_array((np.tile([1.0, -1.0], (len(one), 1)).T.reshape(-1), (np.r_[one, two], np.r_[two, one])), (n, n))
    strip_faces = faces[~(at_tip | at_far)]
    laplacian = weights.laplacian(mesh.vertices, strip_faces)
    missing = np.setdiff1d(np.array([tip, far]), [-1])
    laplacian = laplacian + csr_array((np.ones(len(missing)), (missing, missing)), (n, n))
    end = links[1][::-1] if far >= 0 else rim
    strip = _Strip(mesh, laplacian, links[0], end, jumps, weights.backend)
    return _alternated(mesh, strip, jumps, tip, far, weights)


def _alternated(mesh: Mesh, strip: _Strip, jumps: csr_array, tip: int, far: int, weights: _Weights) -> Polar:
    """Solve the strip and the caps in turn."""
    at_tip = _around_circle(mesh, strip.tip, jumps, 1.0)
    at_end = _around_circle(mesh, strip.end, jumps, 1.0)
    values = strip.shifted(at_tip, at_end)
    if far < 0:
        at_end = _on_circle(strip, values, jumps)
        values = strip.shifted(at_tip, at_end)
    w = strip.solve(values)
    u = w.real
    low = u < u[strip.tip].max() + _CAP
    low[far if far >= 0 else tip] = False
    caps = [_Cap(mesh, _bounded(low, tip, strip, 0), tip, strip.tip, 1.0, weights)]
    if far >= 0:
        high = u > u[strip.end].min() - _CAP
        high[tip] = False
        caps.append(_Cap(mesh, _bounded(high, far, strip, 1), far, strip.end, -1.0, weights))
    for turn in range(_TURNS):
        solved = [cap.solve(w) for cap in caps]
        if turn == _TURNS - 1:
            break
        around = [cap.around(s, jumps) for cap, s in zip(caps, solved, strict=True)]
        values = strip.shifted(around[0], around[1] if far >= 0 else at_end)
        if far < 0:
            at_end = _on_circle(strip, values, jumps)
            values = strip.shifted(around[0], at_end)
        w = strip.solve(values)
    for cap, s in zip(caps, solved, strict=True):
        w[cap.ids[cap.free]] = s[cap.free]
    w[tip] = -np.inf
    if far >= 0:
        w[far] = np.inf
    others = np.setdiff1d(np.arange(len(w)), [tip, far])
    if not np.isfinite(w[others]).all():
        raise SolveFailedError("the map in logarithms is not finite")
    reach = np.ptp(w[others].real) * (0.5 if far >= 0 else 1.0)
    if reach > _LONGEST:
        raise CrowdedError("the surface has parts so long and thin that double precision has no numbers small enough for them")
    return Polar(w, tip, far)


def _bounded(chosen: BoolArray, tip: int, strip: _Strip, which: int) -> BoolArray:
    """Vertices of a cap: those chosen and around the tip, but none of the other end."""
    out = chosen.copy()
    out[strip.tip if which == 0 else strip.end] = True
    out[strip.end if which == 0 else strip.tip] = False
    out[tip] = True
    return out


def _on_circle(strip: _Strip, values: ComplexArray, jumps: csr_array) -> ComplexArray:
    """Logarithms of the boundary's points on the unit circle, from the flux of u through it (its conjugate's steps)."""
    flux = strip.flux_at_end(values).real
    gaps = 0.5 * (flux + np.roll(flux, -1))
    least = _LEAST_GAP * 2.0 * np.pi / len(gaps)
    if (gaps < least).sum() > _FEW_GAPS * len(gaps):
        raise CrowdedError("the circle has no room for some parts of the boundary when the tip is at its centre")
    gaps = np.maximum(gaps, least)
    angles = 2.0 * np.pi * (np.cumsum(gaps) - gaps) / gaps.sum()
    return _unrolled(1j * angles, strip.end, jumps)


def sphere_of(polar: Polar, mesh: Mesh) -> FloatArray:
    """Unit vectors (V, 3), the tip at the north pole, the far end at the south pole, half of the area on either side."""
    w = polar.w
    inner = np.isfinite(w.real)
    share = np.zeros(len(w))
    np.add.at(share, mesh.faces.reshape(-1), np.repeat(face_areas(mesh.vertices, mesh.faces), 3))
    order = np.argsort(w.real, kind="stable")
    total = np.cumsum(share[order])
    known = np.isfinite(w.real[order])
    u = w.real - np.interp(0.5 * total[-1], total[known], w.real[order][known])
    with np.errstate(over="ignore"):
        radius = np.where(inner, 1.0 / np.cosh(np.where(inner, u, 0.0)), 0.0)
    v = np.where(inner, w.imag, 0.0)
    return np.column_stack([radius * np.cos(v), radius * np.sin(v), -np.tanh(u)])


def disk_of(polar: Polar) -> ComplexArray:
    """Positions (V,) in the unit disk, the tip at 0."""
    inner = np.isfinite(polar.w.real)
    out: ComplexArray = np.where(inner, np.exp(np.where(inner, polar.w, 0.0)), 0.0)
    return out
