"""A surface known by the lengths of its edges alone: angles, cotangents, and discrete conformal equivalence.

Lengths are conformally equivalent where they are l_ij exp((u_i + u_j) / 2) for scale factors u of the vertices (Luo 2004;
Springborn, Schroeder, Pinkall 2008). Edge i of a face is opposite corner i.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import bernoulli, factorial

from pgcp.types import BoolArray, FloatArray, IntArray

_SPAN = 300.0
_TERMS = np.arange(1, 21)
# Clausen's integral at 0 and at pi, less what is singular, as series in the square of the distance
_AT_0 = np.abs(bernoulli(40)[2::2]) / (2 * _TERMS * factorial(2 * _TERMS + 1))
_AT_PI = _AT_0 * (4.0**_TERMS - 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """Angles (F, 3), radians, and their cotangents (F, 3); which faces (F,) break the triangle inequality.

    A broken face is taken as flat: pi opposite its longest edge, 0 elsewhere, all cotangents 0. So the energy stays convex.
    """

    angles: FloatArray
    cotangents: FloatArray
    broken: BoolArray


def edge_lengths(vertices: FloatArray, faces: IntArray, mollification: float = 0.0) -> FloatArray:
    """Lengths (F, 3) of the edges, all of them longer by ``mollification`` (Sharp, Crane 2020)."""
    corners = vertices[faces]
    edges = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)
    return np.asarray(np.linalg.norm(edges, axis=2) + mollification, np.float64)


def scaled_lengths(lengths: FloatArray, faces: IntArray, factors: FloatArray) -> FloatArray:
    """Lengths (F, 3) under scale factors u (V,)."""
    u = factors[faces]
    return np.asarray(lengths * np.exp(np.clip(0.5 * (np.roll(u, 1, axis=1) + np.roll(u, -1, axis=1)), -_SPAN, _SPAN)))


def shapes_of(lengths: FloatArray) -> Shapes:
    """Shapes of faces with edges of given lengths (F, 3): the tangent of half an angle from sums and differences of lengths."""
    others = np.roll(lengths, 1, axis=1), np.roll(lengths, -1, axis=1)
    spare = np.maximum(others[0] + others[1] - lengths, 0.0)  # what the edge could be longer
    broken = np.asarray(~(spare > 0.0).all(axis=1), np.bool_)
    high = np.sqrt(np.roll(spare, 1, axis=1) * np.roll(spare, -1, axis=1))
    low = np.sqrt(lengths.sum(axis=1, keepdims=True) * spare)
    angles = 2.0 * np.arctan2(high, low)
    with np.errstate(divide="ignore", invalid="ignore"):
        cotangents = 0.5 * (low / high - high / low)
    cotangents[broken] = 0.0
    return Shapes(angles, cotangents, broken)


def lobachevsky(angles: FloatArray) -> FloatArray:
    """Lobachevsky's function of angles from 0 to pi, - int_0^x log |2 sin t| dt: half of Clausen's integral of 2 x."""
    double = np.abs(2.0 * angles)
    sign = np.where(double > np.pi, -0.5, 0.5)
    x = np.where(double > np.pi, 2.0 * np.pi - double, double)
    near = x < 2.0 * np.pi / 3.0
    distance = np.where(near, x, np.pi - x)
    square = distance**2
    at_0 = 1.0 - np.log(np.where(distance > 0.0, distance, 1.0)) + square * np.polyval(_AT_0[::-1], square)
    at_pi = np.log(2.0) - square * np.polyval(_AT_PI[::-1], square)
    return np.asarray(sign * distance * np.where(near, at_0, at_pi), np.float64)


def angle_sums(angles: FloatArray, faces: IntArray, vertex_count: int) -> FloatArray:
    """Sums (V,) of the angles at the vertices."""
    return np.asarray(np.bincount(faces.reshape(-1), angles.reshape(-1), vertex_count), np.float64)


def conformal_equivalence_energy(
    lengths: FloatArray, shapes: Shapes, faces: IntArray, factors: FloatArray, targets: FloatArray
) -> float:
    """The convex energy of scale factors u (V,) whose gradient is half of target angles (V,) less angle sums.

    lengths (F, 3) and shapes under the scale factors; Springborn, Schroeder, Pinkall 2008, eq. 9.
    """
    by_corner = shapes.angles * np.log(lengths) + lobachevsky(shapes.angles) - 0.5 * np.pi * factors[faces]
    return float(by_corner.sum() + 0.5 * targets @ factors)
