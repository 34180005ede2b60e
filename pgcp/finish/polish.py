"""Polish a finished map: the angle errors of all corners are made smaller, in positions (as ABF does in angles).

Minimised is the sum of (|r| + eps)^p over all corners, r = angle in the map - angle on the surface, by Gauss-Newton steps with
the weights (|r| + eps)^(p - 2); every vertex goes as much of its step as turns no face. All vertices of a free map are free,
boundary vertices of a disk slide on the circle, on the sphere steps are tangential.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from pgcp.elimination.elements import SquaresSolver
from pgcp.errors import SolveFailedError
from pgcp.parallel import one_blas_thread
from pgcp.plane.space import Space, find_folds
from pgcp.surface.distortion import angle_error_slice, corner_angles
from pgcp.surface.operators import face_areas
from pgcp.surface.topology import used_vertices
from pgcp.types import BoolArray, FloatArray, IntArray, Mesh, Positions

_FLOOR = 0.1  # eps by the mean error
_NOTHING = 1e-7  # degrees: below it there is nothing to polish
_DAMPING = 1e-7  # of the mean diagonal entry
_STIFFER, _STIFFEST = 5.0, 1000.0  # faces that a step would turn
_TRIES = 4
_TURNS, _HALVINGS = 200, 12
_LEAST_LEFT = 0.2  # of the area of a face
_SHARES = (1.0, 0.5, 0.2)
_FILLER_SHARE = 0.1
_TINY = 1e-300
_INSIDE, _RIM = 0.3, 0.8  # radii between which steps begin to follow the circle
_LARGEST_QUICK = 100_000  # vertices


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _system(
    points: FloatArray, frames: FloatArray, faces: IntArray, surface: FloatArray, share: FloatArray,
    on_sphere: bool, power: float, least: float, rows: FloatArray, slope: FloatArray,
) -> float:  # fmt: skip
    """Sum of share (|r| + least)^power over the corners of all faces; with rows (F, 3, 6) its linear system too.

    points (n, 3), in the plane z = 0 or on the sphere; frames (n, 2, 3) the directions of the unknowns; surface (F, 3) angles;
    share (F,) of a face. rows times unknowns is the change of the weighted r, slope (n, 2) half of the gradient.
    """
    # long: one compiled loop over faces, whose edges all corners share
    total = 0.0
    u, v, n, across_u, across_v = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        for d in range(3):
            u[d], v[d] = points[b, d] - points[a, d], points[c, d] - points[a, d]
        n[0], n[1], n[2] = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
        side = np.sign(n[0] * points[a, 0] + n[1] * points[a, 1] + n[2] * points[a, 2]) if on_sphere else np.sign(n[2])
        area = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        for i in range(3):
            a, b, c = faces[f, i], faces[f, (i + 1) % 3], faces[f, (i + 2) % 3]
            uu, vv, uv = 0.0, 0.0, 0.0
            for d in range(3):
                u[d], v[d] = points[b, d] - points[a, d], points[c, d] - points[a, d]
                uu += u[d] * u[d]
                vv += v[d] * v[d]
                uv += u[d] * v[d]
            error = side * np.arctan2(area, uv) - surface[f, i]
            size = abs(error) + least
            total += share[f] * size**power
            if rows.shape[0] == 0:
                continue
            if not (area > 0.0 and uu > 0.0 and vv > 0.0):
                rows[f, i] = 0.0
                continue
            weight = np.sqrt(share[f] * size ** (power - 2.0))
            pull = weight * side / area
            for d in range(3):
                e, g = (d + 1) % 3, (d + 2) % 3
                across_u[d] = -pull * (n[e] * u[g] - n[g] * u[e]) / uu
                across_v[d] = pull * (n[e] * v[g] - n[g] * v[e]) / vv
            for j in range(2):
                at_b, at_c, at_a = 0.0, 0.0, 0.0
                for d in range(3):
                    at_b += across_u[d] * frames[b, j, d]
                    at_c += across_v[d] * frames[c, j, d]
                    at_a -= (across_u[d] + across_v[d]) * frames[a, j, d]
                rows[f, i, 2 * i + j] = at_a
                rows[f, i, 2 * ((i + 1) % 3) + j] = at_b
                rows[f, i, 2 * ((i + 2) % 3) + j] = at_c
                slope[a, j] += at_a * weight * error
                slope[b, j] += at_b * weight * error
                slope[c, j] += at_c * weight * error
    return total


@numba.njit(cache=True, nogil=True)
def _moved(
    points: FloatArray, frames: FloatArray, step: FloatArray, part: FloatArray, on_circle: BoolArray, on_sphere: bool
) -> FloatArray:
    """points (n, 3) after so much, part (n,), of a step (n, 2) in frames.

    On the sphere they come back to it. In a disk, where some are ``on_circle``, a step d from z leads to z exp(d / z) near the
    circle: neighbours inside turn with those on it.
    """
    out = points.copy()
    in_disk = on_circle.any()
    for k in range(points.shape[0]):
        if part[k] == 0.0:
            continue
        square = 0.0
        for d in range(3):
            out[k, d] += part[k] * (step[k, 0] * frames[k, 0, d] + step[k, 1] * frames[k, 1, d])
            square += out[k, d] * out[k, d]
        if on_sphere:
            out[k] /= np.sqrt(square)
        elif in_disk:
            z = complex(points[k, 0], points[k, 1])
            near = min(1.0, max(0.0, (abs(z) - _INSIDE) / (_RIM - _INSIDE)))
            if near > 0.0:
                straight = complex(out[k, 0], out[k, 1])
                share = near * near * (3.0 - 2.0 * near)
                there = (1.0 - share) * straight + share * z * np.exp((straight - z) / z)
                if on_circle[k]:
                    there /= abs(there)
                out[k, 0], out[k, 1] = there.real, there.imag
    return out


@numba.njit(cache=True, inline="always")
def _side(points: FloatArray, a: int, b: int, c: int, on_sphere: bool) -> float:
    """Twice the signed area of a face, seen from outside."""
    ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return nx * points[a, 0] + ny * points[a, 1] + nz * points[a, 2] if on_sphere else nz


@numba.njit(cache=True, nogil=True)
def _turned(points: FloatArray, moved: FloatArray, faces: IntArray, on_sphere: bool) -> tuple[int, BoolArray]:
    """How many faces a move turns over or shrinks to next to nothing; and their vertices (n,)."""
    count, out = 0, np.zeros(points.shape[0], np.bool_)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        before = _side(points, a, b, c, on_sphere)
        if before > 0.0 and not _side(moved, a, b, c, on_sphere) > _LEAST_LEFT * before:
            count += 1
            out[a] = out[b] = out[c] = True
    return count, out


@numba.njit(cache=True, nogil=True)
def _stiffened(faces: IntArray, strained: BoolArray, stiffness: FloatArray, by: float) -> None:
    """Make faces (F,) at strained vertices (n,) stiffer."""
    for f in range(faces.shape[0]):
        if strained[faces[f, 0]] or strained[faces[f, 1]] or strained[faces[f, 2]]:
            stiffness[f] = min(by * stiffness[f], _STIFFEST)


@numba.njit(cache=True, nogil=True)
def _limited(
    points: FloatArray, frames: FloatArray, step: FloatArray, faces: IntArray, on_circle: BoolArray, on_sphere: bool
) -> FloatArray:
    """How much of its step (n,) every vertex may go so that no face turns: halved at the corners of such, at last 0."""
    part = np.ones(points.shape[0])
    for turn in range(_TURNS):
        moved = _moved(points, frames, step, part, on_circle, on_sphere)
        found = False
        for f in range(faces.shape[0]):
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            if part[a] + part[b] + part[c] == 0.0:
                continue
            before = _side(points, a, b, c, on_sphere)
            if before > 0.0 and not _side(moved, a, b, c, on_sphere) > _LEAST_LEFT * before:
                found = True
                for v in (a, b, c):
                    part[v] = 0.5 * part[v] if turn < _HALVINGS else 0.0
        if not found:
            return part
    return np.zeros(points.shape[0])


@numba.njit(cache=True, nogil=True)
def _edge_lengths(points: FloatArray, faces: IntArray) -> FloatArray:
    """Root mean square of the lengths of the edges around every point (n,), 0 where there is none."""
    out, count = np.zeros(points.shape[0]), np.zeros(points.shape[0])
    for f in range(faces.shape[0]):
        for i in range(3):
            a, b = faces[f, i], faces[f, (i + 1) % 3]
            square = 0.0
            for d in range(3):
                square += (points[a, d] - points[b, d]) ** 2
            for v in (a, b):
                out[v] += square
                count[v] += 1
    return np.sqrt(out / np.maximum(count, 1))


def _frames(points: FloatArray, lengths: FloatArray, held: BoolArray, on_sphere: bool) -> FloatArray:
    """Directions (n, 2, 3) of moves, as long as the edges there; of those ``held`` on a circle the second is 0."""
    if on_sphere:
        helper = np.eye(3)[np.abs(points).argmin(axis=1)]
        one = np.cross(helper, points)
        one /= np.linalg.norm(one, axis=1)[:, None]
        two = np.cross(points, one)
    else:
        one, two = np.zeros_like(points), np.zeros_like(points)
        one[:, 0], two[:, 1] = 1.0, 1.0
        one[held, 0], one[held, 1], two[held] = -points[held, 1], points[held, 0], 0.0
    frames: FloatArray = np.stack([one, two], axis=1) * lengths[:, None, None]
    return frames


@dataclass(frozen=True, slots=True)
class Aim:
    """What a polish minimises: the power p of the errors; most steps, and the gain, of the sum, of the last of them."""

    power: float
    steps: int
    gain: float


BALANCED = Aim(1.5, 6, 2e-3)  # mean and standard deviation both fall
LEAST_MEAN = Aim(1.1, 8, 1e-3)  # the mean falls most, and the largest errors may rise


@dataclass(frozen=True, slots=True)
class Polish:
    """What a polish did: its Gauss-Newton steps, 0 where the map was left as it was, and the angle errors of all corners."""

    steps: int
    angle_mean_before_deg: float
    angle_mean_after_deg: float
    angle_sd_before_deg: float
    angle_sd_after_deg: float
    angle_max_before_deg: float
    angle_max_after_deg: float


def _errors(mesh: Mesh, coordinates: FloatArray, solid: BoolArray) -> tuple[float, float, float]:
    """Mean, standard deviation and largest of the angle errors (degrees) of faces with an area."""
    errors = angle_error_slice(mesh.vertices, coordinates, mesh.faces, 0, len(mesh.faces))[solid]
    return float(errors.mean()), float(errors.std()), float(errors.max())


class _Work:
    """A map on its way: points (n, 3) of its vertices, all of which faces use, and what every step needs."""

    def __init__(self, mesh: Mesh, points: FloatArray, on_circle: BoolArray, on_sphere: bool, power: float) -> None:
        self.points = points
        self._faces = np.ascontiguousarray(mesh.faces, np.int32)
        self._on_circle, self._on_sphere = on_circle, on_sphere
        self._surface = corner_angles(mesh.vertices, self._faces)
        self._share = (face_areas(mesh.vertices, self._faces) > 0.0).astype(np.float64)
        self._share[len(self._faces) - mesh.filler :] *= _FILLER_SHARE
        self._solver = SquaresSolver(mesh.vertices, self._faces)
        self._power, self._least = power, 0.0
        self._least = _FLOOR * self._sum(points, 1.0) / max(3.0 * self._share.sum(), 1.0)
        self._stiffness = np.ones(len(self._faces))
        self._rows = np.empty((len(self._faces), 3, 6))

    def _sum(self, points: FloatArray, power: float) -> float:
        no_system = np.empty((0, 3, 6)), np.empty((0, 2))
        about = self._faces, self._surface, self._share, self._on_sphere
        return float(_system(points, np.empty((0, 2, 3)), *about, power, self._least, *no_system))

    def _stepped(self, frames: FloatArray, slope: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A step (n, 2), and how much of it (n,) every vertex may go; faces that it would turn are made stiffer first."""
        damping = _DAMPING * max(float(np.einsum("fij,fij", self._rows, self._rows)) / slope.size, _TINY)
        self._stiffness = np.maximum(1.0, self._stiffness / _STIFFER)
        whole = np.ones(len(slope))
        for _ in range(_TRIES):
            self._solver.factor(self._rows * self._stiffness[:, None, None], damping)
            step = -self._solver.solve(slope)
            moved = _moved(self.points, frames, step, whole, self._on_circle, self._on_sphere)
            count, strained = _turned(self.points, moved, self._faces, self._on_sphere)
            if count == 0:
                return step, whole
            _stiffened(self._faces, strained, self._stiffness, _STIFFER)
        return step, _limited(self.points, frames, step, self._faces, self._on_circle, self._on_sphere)

    def go(self) -> float:
        """Make one step; returns what part of the sum it gained, 0 where none helps."""
        frames = _frames(self.points, _edge_lengths(self.points, self._faces), self._on_circle, self._on_sphere)
        slope = np.zeros((len(self.points), 2))
        about = self._faces, self._surface, self._share, self._on_sphere
        before = float(_system(self.points, frames, *about, self._power, self._least, self._rows, slope))
        step, part = self._stepped(frames, slope)
        if not np.isfinite(step).all():
            return 0.0
        for share in _SHARES:
            moved = _moved(self.points, frames, step, share * part, self._on_circle, self._on_sphere)
            after = self._sum(moved, self._power)
            if after < before:
                self.points = moved
                return 1.0 - after / before
        return 0.0


def is_quick(mesh: Mesh) -> bool:
    """Whether a polish takes less time than the map did."""
    return len(mesh.vertices) <= _LARGEST_QUICK


def polish(
    mesh: Mesh, space: Space, positions: Positions, boundary: IntArray, is_free: bool, aim: Aim
) -> tuple[Positions, Polish]:
    """Lower the angle errors of a map, positions (V,); boundary vertices (B,) slide on the unit circle unless it ``is_free``.

    The polished map is kept where its mean angle error is lower and it has no more folds, else the map is left as it
    was. Filler counts a little; faces without area on the surface do not count.
    """
    bare, used = mesh.bare, np.flatnonzero(used_vertices(mesh))
    solid = face_areas(bare.vertices, bare.faces) > 0.0
    before = _errors(bare, space.coordinates(positions), solid)
    unchanged = Polish(0, before[0], before[0], before[1], before[1], before[2], before[2])
    if not before[0] > _NOTHING:
        return positions, unchanged
    number = np.full(len(mesh.vertices), -1)
    number[used] = np.arange(len(used))
    part = Mesh(mesh.vertices[used], number[mesh.faces], mesh.name, mesh.filler)
    on_circle = np.zeros(len(used), bool)
    on_circle[number[boundary]] = not is_free
    steps = 0
    with one_blas_thread():
        work = _Work(part, space.in_space(positions)[used], on_circle, space.closed, aim.power)
        try:
            for _ in range(aim.steps):
                gain = work.go()
                steps += gain > 0.0
                if gain < aim.gain:
                    break
        except SolveFailedError:
            pass  # with the steps that were made
    polished = positions.copy()
    polished[used] = space.positions(np.ascontiguousarray(work.points[:, : space.dimension]))
    after = _errors(bare, space.coordinates(polished), solid)
    if not after[0] < before[0] or len(find_folds(space, bare.faces, polished)) > len(find_folds(space, bare.faces, positions)):
        return positions, unchanged
    return polished, Polish(steps, before[0], after[0], before[1], after[1], before[2], after[2])
