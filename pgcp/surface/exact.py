"""Signs of determinants of doubles, exact, many at once: sums of products as expansions (Shewchuk 1997)."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from pgcp.types import BoolArray, FloatArray

_SPLIT = 134217729.0  # 2^27 + 1 (Veltkamp)
_FEW = 40  # so many are done one after the other in less time


def _two_sum(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """a + b rounded, and what rounding left out."""
    total = a + b
    other = total - a
    return total, (a - (total - other)) + (b - other)


def _two_product(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """a b rounded, and what rounding left out (Dekker 1971)."""
    product = a * b
    a_high, b_high = (_SPLIT * x - (_SPLIT * x - x) for x in (a, b))
    a_low, b_low = a - a_high, b - b_high
    return product, a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low)


def _signs_of_sums(terms: Sequence[FloatArray]) -> FloatArray:
    """Signs (n,) of the exact sums of terms, each (n,): the sign of the largest component that is not 0."""
    expansion: list[FloatArray] = []
    for term in terms:
        rest = term
        for k, component in enumerate(expansion):
            rest, expansion[k] = _two_sum(rest, component)
        expansion.append(rest)
    sign = np.zeros(len(terms[0]))
    for component in expansion:
        sign = np.where(component != 0.0, np.sign(component), sign)
    return sign


def _scaled(corners: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Of corners (n, 3, d): where no product of d coordinates over- or underflows once the largest is about 2^k, and those so.

    k is 960 / d. Only powers of 2 are multiplied with; coordinates that are 0 are as good as any.
    """
    most = 960 // corners.shape[2]
    _, exponent = np.frexp(np.abs(corners).max(axis=(1, 2), initial=0.0))
    with np.errstate(under="ignore"):
        scaled = np.ldexp(corners, (most - exponent)[:, None, None])
    size = np.abs(scaled)
    plain = ((size > 2.0 ** (20 - most)) | (corners == 0.0)).all(axis=(1, 2)) & (len(corners) > _FEW)
    return plain, scaled[plain]


def plane_signs(corners: FloatArray) -> FloatArray:
    """Signs (n,) of the areas of triangles in the plane, corners (n, 3, 2), exact whatever the doubles are."""
    plain, scaled = _scaled(corners)
    out = np.zeros(len(corners))
    x, y = scaled[:, :, 0].T, scaled[:, :, 1].T
    terms = [p for i, j in ((0, 1), (1, 2), (2, 0)) for p in (*_two_product(x[i], y[j]), *_two_product(-x[j], y[i]))]
    out[plain] = _signs_of_sums(terms)
    for f in np.flatnonzero(~plain):
        (ax, ay), (bx, by), (cx, cy) = (map(Fraction, row) for row in corners[f].tolist())
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        out[f] = (area > 0) - (area < 0)
    return out


def space_signs(corners: FloatArray) -> FloatArray:
    """Signs (n,) of det(a, b, c) of triangles with corners a, b, c in space (n, 3, 3), exact whatever the doubles are."""
    plain, scaled = _scaled(corners)
    out = np.zeros(len(corners))
    a, b, c = (scaled[:, k].T for k in range(3))
    terms = []
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        for first, second in ((b[j], c[k]), (-b[k], c[j])):
            terms += [p for part in _two_product(first, second) for p in _two_product(part, a[i])]
    out[plain] = _signs_of_sums(terms)
    for f in np.flatnonzero(~plain):
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = (map(Fraction, row) for row in corners[f].tolist())
        volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        out[f] = (volume > 0) - (volume < 0)
    return out
