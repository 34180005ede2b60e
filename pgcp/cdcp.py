"""CDCP: the constructive disk conformal map of Liao, Yueh (2022), Algorithm 1.

The spherical harmonic map of the double cover, with its pole on the central face, takes the boundary close to a circle;
half of it is enough (Theorem 1), and of that only the boundary's equation S g = reduce(r). The geodesic algorithm takes the
boundary onto the circle, a Laplace solve with the same factor follows, and a Moebius map of the disk that lowers the mean
angle error ends it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.sparse import csr_array

from pgcp.beltrami import folded_faces
from pgcp.boundary_energy import goes_round_once, increasing_angles
from pgcp.dirichlet import DirichletFactor
from pgcp.distortion import angle_errors, as_points, corner_angles
from pgcp.errors import CrowdedError, SolveFailedError
from pgcp.geodesic import geodesic_map
from pgcp.mobius import are_apart, shift_disk
from pgcp.operators import face_areas
from pgcp.types import BoolArray, ComplexArray, FloatArray, IntArray, Mesh

HEAT_TIME = 1e4
_SAMPLE = 100_000
_SMALLEST_GAP = 2e-14
_SIMPLEX = 0.05
_STOUT = 0.1


def heat_matrix(laplacian: csr_array, time: float = HEAT_TIME) -> csr_array:
    """Return one implicit step of heat diffusion over ``time``: 1 + time L (n, n) (CDCP eq. 13)."""
    n = laplacian.shape[0]
    ids = np.arange(n)
    return csr_array(time * laplacian + csr_array((np.ones(n), (ids, ids)), shape=(n, n)))


def heat(factor: DirichletFactor) -> FloatArray:
    """Heat (n,) that one step brings from a boundary at 1 (CDCP eq. 13); factor: of ``heat_matrix``, boundary last.

    All heat starts on the boundary, so the boundary's equation S f_B = 1 and its extension are the whole solve.
    """
    on_boundary = solve_symmetric(factor.schur, np.ones((len(factor.schur), 1)))[:, 0]
    return np.asarray(factor.extend(on_boundary.astype(np.complex128)).real, np.float64)


def late_heat(boundary: IntArray, used: BoolArray, factor: DirichletFactor) -> FloatArray:
    """Heat (n,) from a boundary (n_B,) at 1 after a long time, its first value taken off and time times as large.

    used (n,): vertices that some face uses; the others take no heat.

    The limit of CDCP eq. 13: L f = 1_B - n_B / n, n the vertices used. It needs no factor but the Laplacian's own, and one
    time fits all meshes; sections 4.1 and 6.2 find the time and the place of little weight.
    """
    load = np.where(used, -len(boundary) / used.sum(), 0.0).astype(np.complex128)
    load[boundary] += 1.0
    reduced = factor.reduce(load).real
    on_boundary = np.zeros(len(boundary), np.complex128)
    on_boundary[1:] = solve_symmetric(factor.schur[1:, 1:], reduced[1:, None])[:, 0]
    return np.asarray(factor.solve(load, on_boundary).real, np.float64)


@numba.njit(cache=True)
def _coldest(vertices: FloatArray, faces: IntArray, warmth: FloatArray, stout: float) -> int:
    """Face of least warmth among those of a certain height over their longest edge, else the stoutest."""
    best, stoutest, least, most = -1, 0, np.inf, -1.0
    edge = np.empty((3, 3))
    for f in range(faces.shape[0]):
        longest = 0.0
        for i in range(3):
            square = 0.0
            for d in range(3):
                edge[i, d] = vertices[faces[f, (i + 1) % 3], d] - vertices[faces[f, i], d]
                square += edge[i, d] ** 2
            longest = max(longest, square)
        x = edge[0, 1] * edge[1, 2] - edge[0, 2] * edge[1, 1]
        y = edge[0, 2] * edge[1, 0] - edge[0, 0] * edge[1, 2]
        z = edge[0, 0] * edge[1, 1] - edge[0, 1] * edge[1, 0]
        height = np.sqrt(x * x + y * y + z * z) / longest if longest > 0.0 else 0.0
        warm = warmth[faces[f, 0]] + warmth[faces[f, 1]] + warmth[faces[f, 2]]
        if height >= stout and warm < least:
            best, least = f, warm
        if height > most:
            stoutest, most = f, height
    return best if best >= 0 else stoutest


def central_face(vertices: FloatArray, faces: IntArray, warmth: FloatArray) -> int:
    """Face that heat reaches last (CDCP eq. 15), of those whose height is a tenth of their longest edge, if any.

    warmth (V,). The pole's right-hand side (eq. 17) is made of the face's edge and height: a needle carries no direction.
    """
    return int(_coldest(vertices, faces, warmth, _STOUT))


def solve_symmetric(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve a symmetric positive definite system (n, n) for columns (n, k); raise SolveFailedError where it is not definite."""
    try:
        return np.asarray(cho_solve(cho_factor(matrix, check_finite=False), right, check_finite=False), np.float64)
    except LinAlgError as problem:
        raise SolveFailedError(f"a boundary system of {len(matrix)} unknowns is not positive definite") from problem


def dipole(corners: FloatArray) -> ComplexArray:
    """Right-hand side (3,) at the corners (3, 3) of the face that holds the pole (CDCP eq. 17)."""
    i, j, k = corners
    along = j - i
    length = float(np.linalg.norm(along))
    alpha = float((k - i) @ along) / length**2
    height = float(np.linalg.norm(k - (i + alpha * along)))
    return np.array([-1.0 / length, 1.0 / length, 0.0]) + 1j * np.array([1.0 - alpha, alpha, -1.0]) / height


def harmonic_boundary(vertices: FloatArray, face: IntArray, factor: DirichletFactor) -> ComplexArray:
    """Boundary (n_B,) of the reduced spherical harmonic map (CDCP eq. 18), its mean at 0, with the pole on ``face`` (3,).

    It goes clockwise: the surface lies outside, its pole at infinity.
    """
    load = np.zeros(len(vertices), np.complex128)
    load[face] = dipole(vertices[face])
    reduced = factor.reduce(load)
    # the dipole sums to 0: what rounding leaves over would all go out through the pinned vertex
    reduced = reduced - reduced.mean()
    # one value is free (their h_B(1) = 0); the pinned rest is definite
    solved = solve_symmetric(factor.schur[1:, 1:], np.column_stack([reduced.real, reduced.imag])[1:])
    h: ComplexArray = np.concatenate([[0.0], solved[:, 0] + 1j * solved[:, 1]])
    return h - h.mean()


def circle_boundary(h: ComplexArray) -> ComplexArray:
    """Boundary points (n_B,) on the unit circle, the first at 1: the conformal map of what lies outside h (CDCP eq. 1-6).

    h (n_B,) clockwise around 0; infinity, the pole, goes to 0. Raises SolveFailedError where h crosses itself, CrowdedError
    where points cannot be told apart on the circle.
    """
    curve = np.abs(h).mean() / h
    plane = geodesic_map(curve, np.zeros(1, np.complex128))
    if isinstance(plane, int):
        raise SolveFailedError(f"the harmonic boundary of {len(h)} points crosses itself near its point {plane}")
    gaps = plane.circle_gaps(plane.inside[0])
    if not float(gaps.min()) > _SMALLEST_GAP:
        raise CrowdedError(
            "the surface has parts so long and thin that they would span less of the unit circle than double precision can tell"
        )
    angles = 2.0 * np.pi * np.concatenate([[0.0], np.cumsum(gaps[:-1])]) / gaps.sum()
    z: ComplexArray = np.exp(1j * angles)
    return z


def start_angles(h: ComplexArray) -> FloatArray:
    """Increasing angles (n_B,) from 0 of h, clockwise around 0, on the circle: the start of CEM (CDCP Remark 7).

    Seen from 0 where that keeps the order, by the geodesic algorithm, which always does, elsewhere; raises as that does.
    """
    seen = np.asarray(np.conj(h) / np.abs(h), np.complex128)
    return increasing_angles(seen if goes_round_once(seen) else circle_boundary(h))


def _in_disk(v: FloatArray) -> complex:
    """Point of the unit disk at hyperbolic distance 2 |v| from 0."""
    size = float(np.linalg.norm(v))
    return complex(*(v * (np.tanh(size) / size))) if size > 0.0 else 0.0j


def least_angle_shift(vertices: FloatArray, faces: IntArray, z: ComplexArray) -> complex:
    """Point omega of the disk whose Moebius map leaves the least mean angle error (CDCP eq. 20), by Nelder-Mead.

    vertices (V, 3), faces (F, 3), z (V,). Of more than 100,000 faces the mean is taken over a sample of so many.
    """
    count = len(faces)
    chosen = faces if count <= _SAMPLE else faces[np.random.default_rng(0).choice(count, _SAMPLE, False)]
    ids, corners = np.unique(chosen, return_inverse=True)
    corners = corners.reshape(-1, 3)
    surface, image = corner_angles(vertices[ids], corners), z[ids]

    def mean_error(v: FloatArray) -> float:
        """Mean |angle error| (radians) after the map."""
        points = as_points(shift_disk(image, _in_disk(v)))
        return float(np.abs(corner_angles(points, corners) - surface).mean())

    simplex = np.array([[0.0, 0.0], [_SIMPLEX, 0.0], [0.0, _SIMPLEX]])
    options = {"initial_simplex": simplex, "xatol": 1e-4, "fatol": 1e-8}
    from scipy.optimize import minimize

    return _in_disk(minimize(mean_error, np.zeros(2), method="Nelder-Mead", options=options).x)


@dataclass(frozen=True, slots=True, eq=False)
class ConstructiveMap:
    """A CDCP map: z (V,) in the closed unit disk, and the omega of its Moebius correction, 0 where there was none."""

    z: ComplexArray
    omega: complex


def cdcp_map(mesh: Mesh, boundary: IntArray, factor: DirichletFactor, centre: int, corrected: bool = True) -> ConstructiveMap:
    """Map a disk-like surface conformally to the unit disk (CDCP Algorithm 1, lines 5-11).

    boundary (n_B,) the loop, counter-clockwise; factor: the Laplacian's, boundary last; centre: the central face. The
    correction (lines 9-10, section 6.3) is kept where it lowers the mean angle error of all faces and folds none more.
    """
    z = factor.extend(circle_boundary(harmonic_boundary(mesh.vertices, mesh.faces[centre], factor)))
    if not np.isfinite(z).all():
        raise SolveFailedError("the disk map is not finite")
    if not corrected:
        return ConstructiveMap(z, 0.0j)
    omega = least_angle_shift(mesh.vertices, mesh.faces, z)
    moved = shift_disk(z, omega)
    moved *= np.conj(moved[boundary[0]]) / np.abs(moved[boundary[0]])
    moved[boundary] /= np.abs(moved[boundary])
    if not are_apart(moved, boundary) or len(folded_faces(mesh.faces, moved)) > len(folded_faces(mesh.faces, z)):
        return ConstructiveMap(z, 0.0j)
    solid = face_areas(mesh.vertices, mesh.faces) > 0.0
    better = angle_errors(mesh, moved)[solid].mean() < angle_errors(mesh, z)[solid].mean()
    return ConstructiveMap(moved, omega) if better else ConstructiveMap(z, 0.0j)
