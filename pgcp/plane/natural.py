"""The natural free boundary: the conformal change of a planar domain that gives its boundary the surface's lengths.

A weld fixes its union only up to a conformal map (PGCP section 4.3), and the one it happens to give has corners and
spirals where seams end. With s the scale |edge in the plane| / |edge on the surface| along the outer boundary, the
analytic function Phi with Re Phi = -log s on the boundary gives the change g, g' = exp(Phi), after which the boundary
has the lengths it has on the surface (the boundary condition u = 0 of boundary first flattening).

Phi is a Cauchy integral with a real density mu, constant on panels of the boundary,

    Phi(w) = 1/(2 pi i) sum_k mu_k log((s_{k+1} - w) / (s_k - w)),

a second-kind system for mu whose matrix holds the angles under which the panels are seen.
"""

from __future__ import annotations

import numba
import numpy as np

from pgcp.parallel import in_parts
from pgcp.surface.topology import loop_edges
from pgcp.types import ComplexArray, FloatArray, IntArray

_MAX_PANELS = 1200
_GROUP, _TERMS, _AWAY = 24, 26, 4.0  # panels summed at once from four radii on: 4^-26 is 2e-16
_LEAST_ROWS, _LEAST_POINTS = 256, 2048  # worth a thread
_FAR = 0.01  # squared: panels seen from ten times their half-length on
_VERY_FAR = 1e-4
_BLOCK = 512  # points whose sums stay at hand


@numba.njit(cache=True, error_model="numpy", inline="always")
def _panel(
    px: float, py: float, x: FloatArray, y: FloatArray, first: int, last: int, reach: float, own: int
) -> tuple[float, float]:
    """Log ratio and angle of d(log(s - p)) along the boundary from node first to last; ``own`` is the edge p is on, or -1.

    x and y hold the boundary's nodes, the first one again at the end.
    """
    ax, ay = x[first] - px, y[first] - py
    bx, by = x[last] - px, y[last] - py
    # log(b / a) = 2 artanh(t) = 2 (t + t^3 / 3 + ...), t = (b - a) / (b + a): to rounding where t is small
    sx, sy, dx, dy = bx + ax, by + ay, bx - ax, by - ay
    size = sx * sx + sy * sy
    if dx * dx + dy * dy < _FAR * size and (own < first or own >= last):
        tx, ty = (dx * sx + dy * sy) / size, (dy * sx - dx * sy) / size
        qx, qy = tx * tx - ty * ty, 2.0 * tx * ty
        re, im = 2.0 / 15.0, 0.0
        for odd in (13.0, 11.0, 9.0, 7.0, 5.0, 3.0, 1.0):
            re, im = re * qx - im * qy + 2.0 / odd, re * qy + im * qx
        return re * tx - im * ty, re * ty + im * tx
    near = ax * ax + ay * ay
    log_ratio = 0.5 * np.log((bx * bx + by * by) / near)
    if near > reach * reach and (own < first or own >= last):
        return log_ratio, np.arctan2(ax * by - ay * bx, ax * bx + ay * by)
    angle = 0.0
    for e in range(first, last):
        bx, by = x[e + 1] - px, y[e + 1] - py
        angle += np.pi if e == own else np.arctan2(ax * by - ay * bx, ax * bx + ay * by)
        ax, ay = bx, by
    return log_ratio, angle


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _far_angles(px: float, py: float, x: FloatArray, y: FloatArray, angle: FloatArray) -> None:
    """Angle of every panel from x[k], y[k] to the next one that is far from a point, NaN for the others.

    As in ``_panel``, with as many terms as serve here: without a branch the loop takes several panels at once.
    """
    for k in range(angle.shape[0]):
        ax, ay, bx, by = x[k] - px, y[k] - py, x[k + 1] - px, y[k + 1] - py
        sx, sy, dx, dy = bx + ax, by + ay, bx - ax, by - ay
        size = sx * sx + sy * sy
        inverse = 1.0 / size
        tx, ty = (dx * sx + dy * sy) * inverse, (dy * sx - dx * sy) * inverse
        qx, qy = tx * tx - ty * ty, 2.0 * tx * ty
        re, im = 2.0 / 7.0 * qx + 2.0 / 5.0, 2.0 / 7.0 * qy
        re, im = re * qx - im * qy + 2.0 / 3.0, re * qy + im * qx
        re, im = re * qx - im * qy + 2.0, re * qy + im * qx
        angle[k] = re * ty + im * tx if dx * dx + dy * dy < _VERY_FAR * size else np.nan


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _angle_rows(x: FloatArray, y: FloatArray, starts: IntArray, reach: FloatArray, begin: int, stop: int) -> FloatArray:
    """Mean angle / 2 pi under which each panel (column) is seen from the edge midpoints of panels (rows) begin to stop."""
    count = starts.shape[0] - 1
    out = np.zeros((stop - begin, count))
    x_start, y_start, angle = x[starts], y[starts], np.empty(count)
    for row in range(begin, stop):
        share = 1.0 / (2.0 * np.pi * (starts[row + 1] - starts[row]))
        for e in range(starts[row], starts[row + 1]):
            px, py = 0.5 * (x[e] + x[e + 1]), 0.5 * (y[e] + y[e + 1])
            _far_angles(px, py, x_start, y_start, angle)
            for column in range(count):
                if np.isnan(angle[column]):
                    _, angle[column] = _panel(px, py, x, y, starts[column], starts[column + 1], reach[column], e)
                out[row - begin, column] += share * angle[column]
    return out


@numba.njit(cache=True, nogil=True)
def _moments(
    x: FloatArray, y: FloatArray, starts: IntArray, density: FloatArray
) -> tuple[ComplexArray, FloatArray, ComplexArray]:
    """Groups of neighbouring panels: centres, radii, and what they do from afar, by powers of radius / (point - centre).

    For a point w far from a group's centre c, log(s - w) = log(c - w) - sum_p ((s - c) / (w - c))^p / p along all of it.
    """
    count = -(-density.shape[0] // _GROUP)
    centres, radii = np.empty(count, np.complex128), np.empty(count)
    moments = np.zeros((count, _TERMS), np.complex128)
    for g in range(count):
        first, last = g * _GROUP, min((g + 1) * _GROUP, density.shape[0])
        low, high = starts[first], starts[last]
        centre = complex(x[low : high + 1].mean(), y[low : high + 1].mean())
        radius = 0.0
        for e in range(low, high + 1):
            radius = max(radius, abs(complex(x[e], y[e]) - centre))
        centres[g], radii[g] = centre, radius
        if radius == 0.0:
            continue
        for k in range(first, last):
            one = (complex(x[starts[k]], y[starts[k]]) - centre) / radius
            two = (complex(x[starts[k + 1]], y[starts[k + 1]]) - centre) / radius
            power_one, power_two = one, two
            for p in range(_TERMS):
                moments[g, p] -= density[k] * (power_two - power_one) / (p + 1.0)
                power_one, power_two = power_one * one, power_two * two
    return centres, radii, moments


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _add_from_afar(
    px: FloatArray,
    py: FloatArray,
    centre: complex,
    radius: float,
    away: float,
    moments: ComplexArray,
    re: FloatArray,
    im: FloatArray,
) -> None:
    """Add to 2 pi Phi what one group does to the points that are farther than the root of ``away`` from its centre.

    Short loops without branches, which take several points at once.
    """
    count = px.shape[0]
    tx, ty = np.empty(count), np.empty(count)
    ax, ay = np.zeros(count), np.zeros(count)
    for i in range(count):
        dx, dy = px[i] - centre.real, py[i] - centre.imag
        size = dx * dx + dy * dy
        inverse = radius / size if size > away else 0.0
        tx[i], ty[i] = dx * inverse, -dy * inverse
    for p in range(_TERMS - 1, -1, -1):
        one, two = moments[p].real, moments[p].imag
        for i in range(count):
            ax[i], ay[i] = ax[i] * tx[i] - ay[i] * ty[i] + one, ax[i] * ty[i] + ay[i] * tx[i] + two
    for i in range(count):
        re[i] += ax[i] * ty[i] + ay[i] * tx[i]
        im[i] -= ax[i] * tx[i] - ay[i] * ty[i]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _phi_at(
    points: ComplexArray,
    own: IntArray,
    x: FloatArray,
    y: FloatArray,
    starts: IntArray,
    reach: FloatArray,
    density: FloatArray,
    centres: ComplexArray,
    radii: FloatArray,
    moments: ComplexArray,
) -> ComplexArray:
    """Phi at points inside the boundary or, where own >= 0, at the midpoint of that boundary edge.

    Groups of panels that are far from a point are summed by their moments (see ``_moments``), to rounding.
    """
    px, py = points.real.copy(), points.imag.copy()
    re, im = np.zeros(points.shape[0]), np.zeros(points.shape[0])
    for begin in range(0, points.shape[0], _BLOCK):
        block = slice(begin, min(begin + _BLOCK, points.shape[0]))
        for g in range(centres.shape[0]):
            away = (_AWAY * radii[g]) ** 2
            _add_from_afar(px[block], py[block], centres[g], radii[g], away, moments[g], re[block], im[block])
            for i in range(block.start, block.stop):
                if (px[i] - centres[g].real) ** 2 + (py[i] - centres[g].imag) ** 2 > away:
                    continue
                for k in range(g * _GROUP, min((g + 1) * _GROUP, density.shape[0])):
                    log_ratio, angle = _panel(px[i], py[i], x, y, starts[k], starts[k + 1], reach[k], own[i])
                    re[i] += density[k] * angle
                    im[i] -= density[k] * log_ratio
    out = np.empty(points.shape[0], np.complex128)
    for i in range(points.shape[0]):
        out[i] = complex(re[i], im[i]) / (2.0 * np.pi)
    return out


def _cauchy(
    points: ComplexArray,
    own: IntArray,
    x: FloatArray,
    y: FloatArray,
    starts: IntArray,
    reach: FloatArray,
    density: FloatArray,
) -> ComplexArray:
    """Phi at points (n,); see ``_phi_at``."""
    given = x, y, starts, reach, density, *_moments(x, y, starts, density)
    return np.concatenate(
        in_parts(lambda begin, end: _phi_at(points[begin:end], own[begin:end], *given), len(points), _LEAST_POINTS)
    )


@numba.njit(cache=True, nogil=True)
def _spanning_tree(
    node_count: int, edges: IntArray, order: IntArray, root: int
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Tree of the first edges in ``order`` that close no cycle: nodes from the root on, parents, edge to the parent, chords."""
    leader = np.arange(node_count)
    used = np.zeros(len(edges), np.bool_)
    degree = np.zeros(node_count + 1, np.int64)
    for e in order:
        ends = np.empty(2, np.int64)
        for i in range(2):
            v = edges[e, i]
            while leader[v] != v:
                leader[v] = leader[leader[v]]
                v = leader[v]
            ends[i] = v
        if ends[0] != ends[1]:
            leader[ends[0]] = ends[1]
            used[e] = True
            degree[edges[e, 0] + 1] += 1
            degree[edges[e, 1] + 1] += 1
    starts = np.cumsum(degree)
    fill = starts[:-1].copy()
    incident = np.empty(starts[-1], np.int64)
    for e in range(len(edges)):
        if used[e]:
            for i in range(2):
                incident[fill[edges[e, i]]] = e
                fill[edges[e, i]] += 1
    parent = np.full(node_count, -1, np.int64)
    link = np.full(node_count, -1, np.int64)
    nodes = np.empty(node_count, np.int64)
    nodes[0] = root
    parent[root] = root
    count, head = 1, 0
    while head < count:
        v = nodes[head]
        head += 1
        for p in range(starts[v], starts[v + 1]):
            e = incident[p]
            w = edges[e, 0] + edges[e, 1] - v
            if parent[w] < 0:
                parent[w], link[w] = v, e
                nodes[count] = w
                count += 1
    return nodes[:count], parent, link, np.flatnonzero(~used)


@numba.njit(cache=True, nogil=True)
def _cycles(edges: IntArray, nodes: IntArray, parent: IntArray, link: IntArray, chords: IntArray) -> FloatArray:
    """Fundamental cycles (C, M): +1 or -1 where a cycle runs along or against an edge."""
    depth = np.zeros(len(parent), np.int64)
    for v in nodes[1:]:
        depth[v] = depth[parent[v]] + 1
    out = np.zeros((len(chords), len(edges)))
    for c in range(len(chords)):
        a, b = edges[chords[c], 0], edges[chords[c], 1]
        out[c, chords[c]] = 1.0
        while a != b:  # from b back to a through the tree
            if depth[a] > depth[b]:
                out[c, link[a]] += 1.0 if edges[link[a], 1] == a else -1.0
                a = parent[a]
            else:
                out[c, link[b]] += 1.0 if edges[link[b], 0] == b else -1.0
                b = parent[b]
    return out


def _integrate(node_count: int, edges: IntArray, steps: ComplexArray) -> ComplexArray:
    """Positions whose differences along edges (M, 2) are the steps (M,), in the least squares sense relative to |step|.

    Steps are summed along the tree of shortest edges, from its shortest one, so small parts keep their precision beside
    large ones; what cycles fail to close by is shared out first: min sum |d|^2 / |step|^2 with every cycle closed.
    """
    size = np.abs(steps)
    if not (np.isfinite(size).all() and (size > 0).all()):
        return np.full(node_count, complex(np.nan, np.nan))
    order = np.argsort(size, kind="stable")
    nodes, parent, link, chords = _spanning_tree(node_count, edges, order, int(edges[order[0], 0]))
    cycles = _cycles(edges, nodes, parent, link, chords)
    weighted = cycles * size
    with np.errstate(over="ignore"):
        extent = np.sqrt((weighted**2).sum(axis=1))
    weighted /= extent[:, None]
    share = np.linalg.lstsq(weighted @ weighted.T, -(cycles @ steps) / extent, rcond=None)[0]
    steps = steps + size * (weighted.T @ share)
    out = np.zeros(node_count, np.complex128)
    for v in nodes[1:].tolist():
        e = link[v]
        out[v] = out[parent[v]] + (steps[e] if edges[e, 1] == v else -steps[e])
    return out


def natural_boundary(
    z: ComplexArray, edges: IntArray, lengths: FloatArray, loop: IntArray, corners: IntArray, strength: float = 1.0
) -> ComplexArray:
    """Move all points by the conformal map that gives the outer boundary the surface's lengths, up to one scale.

    z (N,) positions; edges (M, 2) with lengths (M,) on the surface join them all; loop (B,) the outer boundary,
    counter-clockwise and simple; corners: increasing positions in loop at which panels may end, from 0. ``strength``
    below 1 goes part of the way: every value gives a conformal map. Positions are not finite where the curve is so crowded
    that the system cannot be solved.
    """
    s = z[loop]
    after = np.roll(loop, -1)
    n = len(z)
    outer = loop_edges(edges, loop, n)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_scale = np.log(np.abs(z[after] - s) / lengths[outer])
        log_scale -= np.average(log_scale, weights=lengths[outer])
    if not np.isfinite(log_scale).all():
        return np.full(n, complex(np.nan, np.nan))
    group = -(-len(corners) // _MAX_PANELS)
    starts = np.append(corners[::group], len(loop))
    steps = np.abs(np.roll(s, -1) - s)
    reach = 1.5 * np.add.reduceat(steps, starts[:-1])
    data = np.add.reduceat(log_scale, starts[:-1]) / np.diff(starts)
    x, y = np.append(s.real, s.real[0]), np.append(s.imag, s.imag[0])
    rows = in_parts(lambda begin, end: _angle_rows(x, y, starts, reach, begin, end), len(data), _LEAST_ROWS)
    try:
        density = np.linalg.solve(np.concatenate(rows), -strength * data)
    except np.linalg.LinAlgError:
        return np.full(n, complex(np.nan, np.nan))
    own = np.full(len(edges), -1, np.int64)
    own[outer] = np.arange(len(loop))
    middle = 0.5 * (z[edges[:, 0]] + z[edges[:, 1]])
    phi = _cauchy(middle, own, x, y, starts, reach, density)
    with np.errstate(over="ignore", invalid="ignore"):
        steps = (z[edges[:, 1]] - z[edges[:, 0]]) * np.exp(phi)
    return _integrate(n, edges, steps)
