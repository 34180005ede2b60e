"""The geodesic zipper: open two arcs onto the imaginary axis, close them onto each other (PGCP Algorithms 1, 2).

Every map is a Moebius self-map of the right half-plane followed by ``sqrt(w^2 -+ 1)``. The Moebius map is kept as

    M(z) = c z / (1 + i d z),   c > 0, d real,

for which, with z = x + i y,  Re M = c x / |1 + i d z|^2  exactly: real parts keep their relative precision however
small they are, which is what crowded points need. Differences M(z) - M(p) are computed from z - p, so points close
to the end of a slit keep their precision too. Points on the imaginary axis are kept as inverse heights p (z = i / p):
infinity is p = 0 and needs no special case, nor does a collinear arc (d = 0). Their gaps are carried through every map
by formulas of their own, since neighbours may agree in all digits where a curve turns back on itself.
"""

from __future__ import annotations

import numba
import numpy as np

from pgcp.parallel import in_parts
from pgcp.types import ComplexArray, FloatArray

_LEAST_POINTS, _LEAST_VALUES = 1024, 1 << 16  # worth a thread
_LEAST_SQUARE, _MOST_SQUARE = 1e-280, 1e280  # no digits are lost between
_VAST = 2.0**660  # the smallest number times this has a square


@numba.njit(cache=True, error_model="numpy", inline="always")
def _right_root(w_re: float, w_im: float) -> tuple[float, float]:
    """Square root with positive real part, both parts to full relative precision."""
    r = np.sqrt(w_re * w_re + w_im * w_im)
    t = np.sqrt(0.5 * (r + abs(w_re)))
    s = 0.5 * abs(w_im) / t if t > 0.0 else 0.0
    if w_re >= 0.0:
        return t, np.copysign(s, w_im)
    return s, np.copysign(t, w_im)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _open_step(re: FloatArray, im: FloatArray, a: float, b: float) -> None:
    """Open the slit from 0 to xi = a + i b for points off it: z -> sqrt(L(z)^2 - 1), L(xi) = 1 (PGCP eq. 3.12)."""
    square = a * a + b * b
    c, d = a / square, b / square
    for i in range(re.shape[0]):
        x, y = re[i], im[i]
        q_re, q_im = 1.0 - d * y, d * x
        share = 1.0 / (q_re * q_re + q_im * q_im)
        l_re = c * x * share
        l_im = c * (y * q_re - d * x * x) * share
        # L - 1 = (z - xi) / (xi (1 + i d z)), 1 / xi = c - i d
        u, v = x - a, y - b
        e_re, e_im = (u * c + v * d) * share, (v * c - u * d) * share
        m_re, m_im = e_re * q_re + e_im * q_im, e_im * q_re - e_re * q_im
        re[i], im[i] = _right_root(m_re * (l_re + 1.0) - m_im * l_im, 2.0 * l_re * l_im)


@numba.njit(cache=True, error_model="numpy", inline="always")
def _moebius(x: float, y: float, c: float, d: float) -> tuple[float, float]:
    """c z / (1 + i d z) at z = x + i y."""
    q_re, q_im = 1.0 - d * y, d * x
    q2 = q_re * q_re + q_im * q_im
    return c * x / q2, c * (y * q_re - d * x * x) / q2


@numba.njit(cache=True, error_model="numpy", inline="always")
def _root_difference(u: float, v: float, re: float, im: float, re_0: float, im_0: float) -> tuple[float, float]:
    """root - before where u + i v = root^2 - before^2, without cancellation; root = re + i im, before = re_0 + i im_0."""
    total_re, total_im = re + re_0, im + im_0
    scale = _VAST if total_re * total_re + total_im * total_im < _LEAST_SQUARE else 1.0
    total_re, total_im = scale * total_re, scale * total_im
    plain_re, plain_im = scale * (re - re_0), scale * (im - im_0)
    square = total_re * total_re + total_im * total_im
    share = 1.0 / square
    u, v = scale * u, scale * v
    if square < plain_re * plain_re + plain_im * plain_im:
        return re - re_0, im - im_0
    return (u * total_re + v * total_im) * share, (v * total_re - u * total_im) * share


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sum_steps(re: FloatArray, im: FloatArray, y: FloatArray, sum_re: FloatArray, sum_im: FloatArray, height: float) -> None:
    """Heights of arc points, and how far they are from the first: what only adds, one by one."""
    along_re, along_im = 0.0, 0.0
    for m in range(1, re.shape[0]):
        height += im[m]
        along_re += re[m]
        along_im += im[m]
        y[m], sum_re[m], sum_im[m] = height, along_re, along_im


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _roots_of_arc(
    x: FloatArray,
    y: FloatArray,
    root_re: FloatArray,
    root_im: FloatArray,
    inverse_re: FloatArray,
    inverse_im: FloatArray,
    c: float,
    d: float,
) -> None:
    """L in place of arc points z = x + i y, roots in place of how far these are from the first, and 1 / (1 + i d z)."""
    for m in range(x.shape[0]):
        u, v = root_re[m], root_im[m]
        q_re, q_im = 1.0 - d * y[m], d * x[m]
        share = 1.0 / (q_re * q_re + q_im * q_im)
        i_re, i_im = share * q_re, -share * q_im
        l_re, l_im = c * x[m] * share, c * (y[m] * i_re - d * x[m] * x[m] * share)
        u, v = u * c + v * d, v * c - u * d  # L - 1 = (z - xi) / (xi (1 + i d z)), 1 / xi = c - i d
        u, v = u * i_re - v * i_im, u * i_im + v * i_re
        x[m], y[m] = l_re, l_im
        inverse_re[m], inverse_im[m] = i_re, i_im
        root_re[m], root_im[m] = _right_root(u * (l_re + 1.0) - v * l_im, 2.0 * l_re * l_im)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _steps_of_arc(
    step_re: FloatArray,
    step_im: FloatArray,
    x: FloatArray,
    y: FloatArray,
    root_re: FloatArray,
    root_im: FloatArray,
    inverse_re: FloatArray,
    inverse_im: FloatArray,
    c: float,
) -> None:
    """Steps from root m to root m + 1 in place of those between the points themselves; L = x + i y and 1 / (1 + i d z)."""
    for m in range(step_re.shape[0]):
        i_re, i_im, j_re, j_im = inverse_re[m + 1], inverse_im[m + 1], inverse_re[m], inverse_im[m]
        u, v = c * (i_re * j_re - i_im * j_im), c * (i_re * j_im + i_im * j_re)
        re, im = step_re[m], step_im[m]
        u, v = u * re - v * im, u * im + v * re  # difference of the two L
        re, im = x[m + 1] + x[m], y[m + 1] + y[m]
        u, v = u * re - v * im, u * im + v * re
        re, im = _root_difference(u, v, root_re[m + 1], root_im[m + 1], root_re[m], root_im[m])
        step_re[m], step_im[m] = re, im


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _open_rest_of_arc(x: FloatArray, re: FloatArray, im: FloatArray, room: FloatArray) -> None:
    """Pass the arc points after the first, which is being opened, through sqrt(L^2 - 1) in place.

    Point m lies re[m] + i im[m] beyond point m - 1, and the one before the first is at 0: positions are sums of steps from the
    tip of the slit on, and steps are carried through the map by themselves, so a part of the arc that looks small from afar is
    as precise as any when the slit reaches it. x holds the real parts, which keep a relative precision of their own. ``room``
    (5, as many) is scratch memory between the loops. Loops without a running sum are vectorised.
    """
    n = x.shape[0]
    if n < 2:
        return
    a, b = x[0], im[0]
    square = a * a + b * b
    c, d = a / square, b / square
    y, root_re, root_im, inverse_re, inverse_im = room[0, :n], room[1, :n], room[2, :n], room[3, :n], room[4, :n]
    _sum_steps(re, im, y, root_re, root_im, b)
    _roots_of_arc(x[1:], y[1:], root_re[1:], root_im[1:], inverse_re[1:], inverse_im[1:], c, d)
    share = 1.0 / ((1.0 - d * b) ** 2 + (d * a) ** 2)
    x[0], y[0], root_re[0], root_im[0] = 1.0, 0.0, 0.0, 0.0
    inverse_re[0], inverse_im[0] = share * (1.0 - d * b), -share * d * a
    _steps_of_arc(re[1:], im[1:], x, y, root_re, root_im, inverse_re, inverse_im, c)
    re[1], im[1] = root_re[1], root_im[1]
    for m in range(1, n):
        x[m] = root_re[m]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _open_gaps(
    p: FloatArray, gaps: FloatArray, count: int, shift: float, scale: float, branch: float, roots: FloatArray
) -> None:
    """Pass inverse heights through sqrt(L^2 - 1) in place: t = (p - shift) / scale, then t / sqrt(1 + t^2).

    Point ``count`` is the new one, at height ``branch``. Gaps between neighbours are carried by themselves: differences
    of nearly equal heights keep their relative precision. ``roots`` is room for as many numbers.
    """
    share = 1.0 / scale
    for i in range(count):
        t = (p[i] - shift) * share
        p[i] = t
        roots[i] = np.sqrt(1.0 + t * t)
    for i in range(count - 1):
        one, two, here, there = roots[i], roots[i + 1], abs(p[i]), abs(p[i + 1])
        both = one * two
        total = abs(p[i] + p[i + 1]) if p[i] * p[i + 1] > 0.0 else there * one + here * two
        along = gaps[i] * share * total / (both * (there * one + here * two))
        gaps[i] = along if p[i] * p[i + 1] > 0.0 else total / both
    last, root = p[count - 1], roots[count - 1]
    gaps[count - 1] = 1.0 / (root * (root + abs(last))) if last * branch > 0.0 else 1.0 + abs(last) / root
    for i in range(count):
        p[i] /= roots[i]
    p[count] = branch


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _open_arc(arc: ComplexArray, others: ComplexArray, branch: float) -> tuple[FloatArray, ComplexArray, int]:
    """See ``open_arc``."""
    k = arc.shape[0] - 1
    count = others.shape[0]
    re, im = np.empty(count), np.empty(count)
    x, step_re, step_im = np.zeros(k + 1), np.zeros(k + 1), np.zeros(k + 1)
    z0, z1 = arc[0], arc[1]
    for i in range(count):
        w = (others[i] - z1) / (others[i] - z0)
        re[i], im[i] = _right_root(w.real, w.imag)
    y_0 = 0.0
    for m in range(2, k + 1):
        w = (arc[m] - z1) / (arc[m] - z0)
        x[m], y = _right_root(w.real, w.imag)
        w = (z1 - z0) * (arc[m] - arc[m - 1]) / ((arc[m] - z0) * (arc[m - 1] - z0))
        step_re[m], step_im[m] = _root_difference(w.real, w.imag, x[m], y, x[m - 1], y_0)
        y_0 = y
    p = np.zeros(k)
    gaps = np.zeros(k - 1)
    room = np.empty((5, k + 1))
    for j in range(2, k + 1):
        a, b = x[j], step_im[j]
        if not (a > 0.0 and np.isfinite(a) and np.isfinite(b)):
            return gaps, others, j
        square = a * a + b * b
        _open_gaps(p, gaps, j - 1, b / square, a / square, branch, room[0])
        _open_rest_of_arc(x[j:], step_re[j:], step_im[j:], room)
        _open_step(re, im, a, b)
    # send the image of z0 to infinity (PGCP eq. 4.13)
    out = np.empty(count, np.complex128)
    for i in range(count):
        u, v = _moebius(re[i], im[i], 1.0, p[0])
        out[i] = complex(u, v)
    return gaps, out, -1


def open_arc(arc: ComplexArray, others: ComplexArray, branch: float) -> tuple[FloatArray, ComplexArray, int]:
    """Bring a boundary curve to its intermediate form (PGCP Algorithm 1).

    arc (k+1,) is opened onto the imaginary axis, others (n,) into the right half-plane; ``branch`` is +1 where the
    domain lies to the left of the arc and -1 where it lies to the right. With p[j] the inverse height of point j, at
    i / p[j], p[0] = 0 (infinity) and ``branch * p`` increasing (point k is at 0): returns the gaps |p[j+1] - p[j]|
    (k-1,), the others, and the number of the arc point that could not be opened (its image is not inside the
    half-plane), or -1.
    """
    parts = in_parts(lambda begin, end: _open_arc(arc, others[begin:end], branch), len(others), _LEAST_POINTS)
    return parts[0][0], np.concatenate([moved for _, moved, _ in parts]), parts[0][2]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _close_step(re: FloatArray, im: FloatArray, p: float, q: float) -> None:
    """Close the slit from i / p to i / q through 0: z -> sqrt(T(z)^2 + 1), T(i/p) = i, T(i/q) = -i (PGCP eq. 4.14-4.16)."""
    c, d = 0.5 * (p - q), 0.5 * (p + q)
    for i in range(re.shape[0]):
        x, y = re[i], im[i]
        q_re, q_im = 1.0 - d * y, d * x
        share = 1.0 / (q_re * q_re + q_im * q_im)
        t_re = c * x * share
        t_im = c * (y * q_re - d * x * x) * share
        # T - i = (p z - i) / (1 + i d z),  T + i = (i - q z) / (1 + i d z)
        up, down = p * y - 1.0, 1.0 - q * y
        m_re = -p * q * x * x - up * down
        m_im = x * (p * down - q * up)
        s_re, s_im = q_re * q_re - q_im * q_im, 2.0 * q_re * q_im
        re[i], im[i] = _right_root((m_re * share) * (s_re * share) + (m_im * share) * (s_im * share), 2.0 * t_re * t_im)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _close_gaps(gaps: FloatArray, count: int, other_total: float, room: FloatArray) -> float:
    """Pass the gaps of one side through sqrt(T^2 + 1) in place; point ``count`` is being welded.

    With half the distance of the two points being welded as the unit, point i is at depth r = sum of the gaps from it to
    point ``count``, and its new inverse height is (1 - r) / sqrt(r (2 - r)). Returns that of point count - 1. ``room`` (3, at
    least count) is for what the loops, which add one by one or take several points at once, leave to the next.
    """
    depth, product, height = room[0], room[1], room[2]
    total = other_total
    for i in range(count):
        product[i] = total  # beyond point i
        total += gaps[i]
    half = 0.5 * total
    below = 0.0
    for i in range(count - 1, -1, -1):
        below += gaps[i]
        depth[i] = below
    share = 1.0 / half
    for i in range(count):
        r = depth[i] * share
        depth[i] = r
        product[i] = r * max(2.0 - r, product[i] * share)
    for i in range(count):
        height[i] = (1.0 - depth[i]) / np.sqrt(product[i])
    for i in range(count - 1):
        one, two = 1.0 - depth[i], 1.0 - depth[i + 1]
        both = abs(height[i]) + abs(height[i + 1])
        along = gaps[i] * share * abs(one + two) / (product[i] * product[i + 1] * both)
        gaps[i] = along if one * two > 0.0 else both
    return height[count - 1]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _close_arcs(upper: FloatArray, lower: FloatArray, others: ComplexArray) -> tuple[ComplexArray, ComplexArray, int]:
    """See ``close_arcs``."""
    k = upper.shape[0] + 1
    count = others.shape[0]
    re = np.empty(k + count)
    im = np.empty(k + count)
    for i in range(count):
        re[k + i], im[k + i] = others[i].real, others[i].imag
    # slot j - 1 holds the welded point j, from the moment it is welded
    re[k - 1] = im[k - 1] = 0.0
    u, v = upper.copy(), lower.copy()
    p, q = u.sum(), -v.sum()
    far, room = 0.0, np.empty((3, k))
    for j in range(k - 1, 0, -1):
        above, below = 0.0, 0.0
        for i in range(j):
            above += u[i]
            below += v[i]
        if not (above > 0.0 and below > 0.0 and np.isfinite(p) and np.isfinite(q)):
            return np.empty(0, np.complex128), others, j
        _close_step(re[j:], im[j:], p, q)
        re[j - 1] = im[j - 1] = 0.0
        # infinity lies ``above`` below p and ``below`` above q
        far = 0.5 * (below - above) / np.sqrt(above * below)
        p = _close_gaps(u, j, below, room)
        q = -_close_gaps(v, j, above, room)
    arc = np.empty(k, np.complex128)
    out = np.empty(count, np.complex128)
    for i in range(k + count):
        x, y = _moebius(re[i], im[i], 1.0, far)
        square = complex(x * x - y * y, 2.0 * x * y)
        if i < k:
            arc[i] = square
        else:
            out[i - k] = square
    return arc, out, -1


def close_arcs(upper: FloatArray, lower: FloatArray, others: ComplexArray) -> tuple[ComplexArray, ComplexArray, int]:
    """Weld the points of the upper half-axis to those of the lower one (PGCP Algorithm 2).

    upper, lower (k-1,): gaps between inverse heights of points 0..k-1, point 0 being infinity on both sides; point k of
    both is 0; others (n,) in the right half-plane move along. Returns the common images of points 1..k, the images of
    the others, and -1 or the number of the point that could not be welded. The image of point 0 is infinity.
    """
    parts = in_parts(lambda begin, end: _close_arcs(upper, lower, others[begin:end]), len(others), _LEAST_POINTS)
    return parts[0][0], np.concatenate([moved for _, moved, _ in parts]), parts[0][2]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _scale_variation(
    tails: ComplexArray, heads: ComplexArray, log_lengths: FloatArray, weights: FloatArray, poles: ComplexArray
) -> FloatArray:
    """See ``scale_variation``."""
    out = np.empty(poles.shape[0])
    for n in range(poles.shape[0]):
        total, mean, square = 0.0, 0.0, 0.0
        for e in range(tails.shape[0]):
            t, h = tails[e] - poles[n], heads[e] - poles[n]
            product = (t.real * t.real + t.imag * t.imag) * (h.real * h.real + h.imag * h.imag)
            if _LEAST_SQUARE < product < _MOST_SQUARE:
                value = log_lengths[e] - 0.5 * np.log(product)
            else:
                value = log_lengths[e] - np.log(abs(t)) - np.log(abs(h))
            if not np.isfinite(value):
                continue
            total += weights[e]
            mean += weights[e] * value
            square += weights[e] * value * value
        out[n] = square / total - (mean / total) ** 2
    return out


def scale_variation(
    tails: ComplexArray, heads: ComplexArray, log_lengths: FloatArray, weights: FloatArray, poles: ComplexArray
) -> FloatArray:
    """Weighted variance of log(|edge in the plane| / |edge on the surface|) after 1 / (z - pole), for each pole.

    |1/(p - c) - 1/(q - c)| = |p - q| / (|p - c| |q - c|): only the distances to the pole change. Edges with an end at
    infinity are left out.
    """
    least = -(-_LEAST_VALUES // max(1, len(tails)))
    return np.concatenate(
        in_parts(lambda begin, end: _scale_variation(tails, heads, log_lengths, weights, poles[begin:end]), len(poles), least)
    )
