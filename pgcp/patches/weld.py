"""Partial welding of flattened patches, boundary points only (PGCP section 4.3, Algorithm 2).

A component is what welds have made so far: all boundary and seam points of its patches, and its outer loop. One
weld joins two components whose outer loops share exactly one arc.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from pgcp.errors import BlurredError, WeldFailedError
from pgcp.patches.types import BoundaryCurve, Component, EdgeTable, WeldStep
from pgcp.plane.curves import crosses_itself
from pgcp.plane.natural import natural_boundary
from pgcp.plane.zipper import close_arcs, open_arc, scale_variation
from pgcp.types import ComplexArray, FloatArray, IntArray

SECTOR_LIMIT = 0.7 * np.pi
_FAN_ANGLES = 5
_FAN_RADII = 300
_VARIATION_SAMPLE = 500
_BEST_POLES = 100
_SAME_ARC = 1e-10
_LEAST_STRENGTH = 0.1


def _edge_and_step(parts: IntArray) -> tuple[IntArray, IntArray]:
    """For every point of a subdivided loop: the edge it is on, and its number on that edge, 0 for the tail."""
    edge = np.repeat(np.arange(len(parts)), parts)
    return edge, np.arange(len(edge)) - np.repeat(np.cumsum(parts) - parts, parts)


def subdivide(z: ComplexArray, parts: IntArray) -> ComplexArray:
    """Points of a closed polygon z (B,), edge i in parts[i] equal parts."""
    edge, t = _edge_and_step(parts)
    points: ComplexArray = z[edge] + (t / parts[edge]) * (np.roll(z, -1) - z)[edge]
    return points


def start_component(curve: BoundaryCurve, vertices: FloatArray, table: EdgeTable) -> Component:
    """Make a component of one patch from its subdivided boundary curve.

    A flattened patch is piecewise linear, so points inside a boundary edge are known exactly; with them the zipper
    follows the straight edge instead of an arc that only meets its end points, and the boundary's curved image is
    resolved.
    """
    ids = np.asarray(curve.vertex_ids, np.int64)
    after = np.roll(ids, -1)
    rank = table.rank(ids, after)
    parts = table.parts[rank]
    lengths = np.maximum(np.linalg.norm(vertices[after] - vertices[ids], axis=1), table.mollification)
    edge, t = _edge_and_step(parts)
    from_lower = np.where((ids < after)[edge], t, parts[edge] - t)
    n = len(edge)
    return Component(
        nodes=np.where(t == 0, ids[edge], table.inserted_node(rank[edge], from_lower)),
        z=curve.z,
        loop=np.arange(n),
        edges=np.column_stack([np.arange(n), np.roll(np.arange(n), -1)]),
        lengths=(lengths / parts)[edge],
        vertex_count=len(vertices),
    )


def run_welds(components: dict[int, Component], steps: Iterable[WeldStep]) -> Component:
    """Run all steps of a plan one after the other and return the last union. Components no longer needed are dropped."""
    for step in steps:
        weld = weld_closed if step.closed else weld_pair
        components[step.result] = weld(components.pop(step.left), components.pop(step.right))
    (union,) = components.values()
    return union


def shared_arc(left: IntArray, right: IntArray) -> tuple[IntArray, IntArray]:
    """Rotate two loops of node ids so that each starts with the arc they share.

    Returns the left loop from the arc's start, and the right loop reversed from the same node: both begin with the
    same k + 1 nodes. Raises WeldFailedError where the loops share no edge or more than one arc.
    """
    backward = right[::-1]
    position = dict(zip(backward.tolist(), range(len(backward)), strict=True))
    place = np.array([position.get(node, -1) for node in left.tolist()])
    follows = (place >= 0) & (np.roll(place, -1) >= 0)
    follows &= (place + 1) % len(backward) == np.roll(place, -1)
    shared_edges, shared_nodes = int(follows.sum()), int((place >= 0).sum())
    starts = np.flatnonzero(follows & ~np.roll(follows, 1))
    if len(starts) != 1 or shared_nodes != shared_edges + 1:
        raise WeldFailedError(
            f"two boundary loops share {shared_nodes} points in {max(len(starts), shared_nodes - shared_edges)} arcs, "
            "a weld needs exactly one arc"
        )
    start = int(starts[0])
    return np.roll(np.arange(len(left)), -start), np.roll(np.arange(len(right))[::-1], -place[start])


def _power_about_half_axis(
    others: ComplexArray, gaps: FloatArray, side: float, power: float
) -> tuple[ComplexArray, FloatArray]:
    """Apply z -> i side (z / (i side))^power: conformal on the sector, keeps 0, infinity and the half-axis.

    Inverse heights p, given by their gaps from 0 on, become p^power.
    """
    angle = power * np.arctan2(others.real, side * others.imag)
    radius = np.abs(others) ** power
    before = np.concatenate([[0.0], np.cumsum(gaps)[:-1]])
    ratio = np.divide(gaps, before, out=np.zeros_like(gaps), where=before > 0.0)
    powered = np.where(before > 0.0, before**power * np.expm1(power * np.log1p(ratio)), gaps**power)
    return radius * np.sin(angle) + 1j * side * radius * np.cos(angle), powered


def _sector(others: ComplexArray, side: float) -> float:
    """Angle from the half-axis ``i side`` to the farthest point."""
    return float(np.arctan2(others.real, side * others.imag).max(initial=0.0))


def _one_scale(
    a: ComplexArray, gaps_a: FloatArray, b: ComplexArray, gaps_b: FloatArray
) -> tuple[ComplexArray, FloatArray, ComplexArray, FloatArray]:
    """Scale both intermediate forms so that their seam points match in the log mean: the scale of either is free."""
    if len(gaps_a) == 0:
        return a, gaps_a, b, gaps_b
    if not (gaps_a[0] > 0.0 and gaps_b[0] > 0.0):
        raise WeldFailedError("a seam is so crowded at its start that its points cannot be told apart")
    scale_a = np.exp(np.mean(np.log(np.cumsum(gaps_a))))
    scale_b = np.exp(np.mean(np.log(np.cumsum(gaps_b))))
    return a * scale_a, gaps_a / scale_a, b * scale_b, gaps_b / scale_b


def _separate(
    a: ComplexArray, gaps_a: FloatArray, b: ComplexArray, gaps_b: FloatArray
) -> tuple[ComplexArray, FloatArray, ComplexArray, FloatArray, float, float]:
    """Make the two intermediate forms disjoint, and bring them to one scale.

    A fills a sector from the positive half-axis, B one from the negative. Where they would meet, the same power map
    shrinks both so that a gap is left.
    """
    wide_a, wide_b = _sector(a, 1.0), _sector(b, -1.0)
    if wide_a + wide_b > SECTOR_LIMIT:
        power = SECTOR_LIMIT / (wide_a + wide_b)
        a, gaps_a = _power_about_half_axis(a, gaps_a, 1.0, power)
        b, gaps_b = _power_about_half_axis(b, gaps_b, -1.0, power)
        wide_a, wide_b = wide_a * power, wide_b * power
    return *_one_scale(a, gaps_a, b, gaps_b), wide_a, wide_b


def _gap_fan(a: ComplexArray, b: ComplexArray, wide_a: float, wide_b: float) -> ComplexArray:
    """Points in the gap between the two sectors, outside both sides: where infinity may come from."""
    radius = np.abs(np.concatenate([a, b]))
    radius = radius[radius > 0]
    low, high = (np.log(radius.min()) - 2.0, np.log(radius.max()) + 2.0) if len(radius) else (-5.0, 5.0)
    fractions = (np.arange(_FAN_ANGLES) + 0.5) / _FAN_ANGLES
    angles = wide_b - 0.5 * np.pi + fractions * (np.pi - wide_a - wide_b)
    return (np.exp(np.linspace(low, high, _FAN_RADII))[:, None] * np.exp(1j * angles)[None, :]).reshape(-1)


def _variation(z: ComplexArray, edges: IntArray, lengths: FloatArray, poles: ComplexArray) -> FloatArray:
    """Variance of log(|edge in the plane| / |edge on the surface|) for each pole (N,), infinite where undefined."""
    tails, heads = z[edges[:, 0]], z[edges[:, 1]]
    with np.errstate(divide="ignore", invalid="ignore"):
        log_lengths = np.log(np.abs(tails - heads) / lengths)
    out = scale_variation(tails, heads, log_lengths, lengths, poles)
    out[~np.isfinite(out)] = np.inf
    return out


def normalise(z: ComplexArray, edges: IntArray, lengths: FloatArray, poles: ComplexArray) -> ComplexArray:
    """Send to infinity the pole that leaves the least variation of scale, and make the mean log scale 0.

    z may hold one point at infinity. The variance of log(|edge in the plane| / |edge on the surface|) is taken over an
    even sample of the edges first, and over all of them for the poles that are best by the sample. Raises
    WeldFailedError where no pole serves.
    """
    poles = poles[np.isfinite(poles)]
    stride = max(1, len(edges) // _VARIATION_SAMPLE)
    rough = _variation(z, edges[::stride], lengths[::stride], poles)
    poles = poles[np.argsort(rough, kind="stable")[:_BEST_POLES]]
    variation = _variation(z, edges, lengths, poles)
    if len(variation) == 0 or not np.isfinite(variation.min()):
        raise WeldFailedError("no point outside the welded union could be sent to infinity")
    pole = poles[int(np.argmin(variation))]
    with np.errstate(divide="ignore", invalid="ignore"):
        image = 1.0 / (z - pole)
    image[~np.isfinite(z)] = 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.log(np.abs(image[edges[:, 0]] - image[edges[:, 1]]) / lengths)
    if not np.isfinite(scale).all():
        raise BlurredError("points of welded patches come so close that double precision cannot tell them apart")
    return (image - image.mean()) * np.exp(-np.average(scale, weights=lengths))


def _similarity(fixed: ComplexArray, moving: ComplexArray) -> tuple[complex, complex, float]:
    """Least squares a, b with a * moving + b near fixed; and the largest miss relative to the extent."""
    centre_fixed, centre_moving = fixed.mean(), moving.mean()
    u, v = fixed - centre_fixed, moving - centre_moving
    if not (np.abs(u).max() > 0.0 and np.vdot(v, v).real > 0.0):
        raise WeldFailedError("a union is so crowded that some of its points cannot be told apart")
    a = complex(np.vdot(v, u) / np.vdot(v, v))
    miss = float(np.abs(u - a * v).max() / np.abs(u).max())
    return a, complex(centre_fixed - a * centre_moving), miss


def _opened(side: Component, arc: IntArray, others: IntArray, branch: float) -> tuple[FloatArray, ComplexArray]:
    """Open an arc of a component's loop (see ``open_arc``): gaps of its points, and the other points.

    Raises WeldFailedError where the curve is not simple, or so crowded that it is not in numbers.
    """
    try:
        gaps, moved, stuck = open_arc(side.z[arc], side.z[others], branch)
    except ZeroDivisionError:
        stuck = 0
    if stuck >= 0:
        raise WeldFailedError(f"a boundary curve of {len(side.loop)} points crosses itself near point {stuck} of its seam")
    return gaps, moved


def weld_pair(left: Component, right: Component) -> Component:
    """Weld two components along the arc their outer loops share (PGCP Algorithm 2).

    Where a similarity brings the two arcs together it is the weld: pieces of a plane stay what they are. Raises
    WeldFailedError where the loops share no single arc or where the boundary curves cannot be opened.
    """
    order_left, order_right = shared_arc(left.nodes[left.loop], right.nodes[right.loop])
    loop_left, loop_right = left.loop[order_left], right.loop[order_right]
    k = int(np.isin(left.nodes[left.loop], right.nodes[right.loop]).sum()) - 1
    arc_left, arc_right = loop_left[: k + 1], loop_right[: k + 1]
    union, sides = _join(left, right, loop_left, loop_right, k)
    a, b, miss = _similarity(left.z[arc_left], right.z[arc_right])
    if miss < _SAME_ARC:
        z = np.concatenate([left.z[arc_left], left.z[sides[0]], a * right.z[sides[1]] + b])
        if not crosses_itself(z[union.loop]):
            return replace(union, z=z)
    gaps_a, z_a = _opened(left, arc_left, sides[0], 1.0)
    gaps_b, z_b = _opened(right, arc_right, sides[1], -1.0)
    z_a, gaps_a, z_b, gaps_b, wide_a, wide_b = _separate(z_a, gaps_a, z_b, gaps_b)
    fan = _gap_fan(z_a, z_b, wide_a, wide_b)
    arc, moved, stuck = close_arcs(gaps_a, gaps_b, np.concatenate([z_a, z_b, fan]))
    if stuck >= 0:
        raise WeldFailedError(f"a seam of {k} edges could not be closed at its point {stuck}")
    z = np.concatenate([[np.inf], arc, moved[: len(z_a) + len(z_b)]])
    z = normalise(z, union.edges, union.lengths, moved[len(z_a) + len(z_b) :])
    if not np.isfinite(z).all():
        raise WeldFailedError(f"welding along {k} edges gave positions that are not finite")
    return relax_boundary(replace(union, z=z))


def weld_closed(left: Component, right: Component) -> Component:
    """Weld two components along their whole outer loops into a closed union (PGCP section 4.4.2).

    Both loops are opened entirely, which leaves two quadrants; they meet along the real axis, the image of the loops' last
    edge, and closing the imaginary axis makes them the extended plane. The loop's first point is at infinity. Raises
    WeldFailedError where the loops are not the same or cannot be opened.
    """
    left, right = (relax_boundary(side) if len(side.loop) == len(side.nodes) else side for side in (left, right))
    loop_left, loop_right = left.loop, right.loop[::-1]
    nodes_left, nodes_right = left.nodes[loop_left], right.nodes[loop_right]
    start = np.flatnonzero(nodes_right == nodes_left[0])
    if len(start) == 1:
        loop_right = np.roll(loop_right, -int(start[0]))
    if not np.array_equal(nodes_left, right.nodes[loop_right]):
        raise WeldFailedError("the last two components do not share their whole boundaries")
    k = len(loop_left) - 1
    union, sides = _join(left, right, loop_left, loop_right, k)
    gaps_a, z_a = _opened(left, loop_left, sides[0], 1.0)
    gaps_b, z_b = _opened(right, loop_right, sides[1], -1.0)
    z_a, gaps_a, z_b, gaps_b = _one_scale(z_a, gaps_a, z_b, gaps_b)
    arc, moved, stuck = close_arcs(gaps_a, gaps_b, np.concatenate([z_a, z_b]))
    if stuck >= 0:
        raise WeldFailedError(f"a closed seam of {k + 1} edges could not be closed at its point {stuck}")
    if not (np.isfinite(arc).all() and np.isfinite(moved).all()):
        raise WeldFailedError(f"welding along a closed seam of {k + 1} edges gave positions that are not finite")
    return replace(union, z=np.concatenate([[np.inf], arc, moved]))


def _join(
    left: Component, right: Component, loop_left: IntArray, loop_right: IntArray, k: int
) -> tuple[Component, tuple[IntArray, IntArray]]:
    """Join two components that share the first k + 1 points of both loops, positions still to be set.

    Points of the union: the arc, then the rest of the left one, then the rest of the right one; the rests are returned.
    """
    arc_left, arc_right = loop_left[: k + 1], loop_right[: k + 1]
    rest_left = np.setdiff1d(np.arange(len(left.nodes)), arc_left)
    rest_right = np.setdiff1d(np.arange(len(right.nodes)), arc_right)
    to_left = np.empty(len(left.nodes), np.int64)
    to_left[arc_left], to_left[rest_left] = np.arange(k + 1), k + 1 + np.arange(len(rest_left))
    to_right = np.empty(len(right.nodes), np.int64)
    to_right[arc_right], to_right[rest_right] = np.arange(k + 1), k + 1 + len(rest_left) + np.arange(len(rest_right))
    nodes = np.concatenate([left.nodes[arc_left], left.nodes[rest_left], right.nodes[rest_right]])
    # the left loop runs n_0 .. n_k, rest; the right one, reversed, n_0 .. n_k, rest; the union n_k, left rest, n_0, right rest
    closed = k == len(loop_left) - 1 == len(loop_right) - 1
    loop = np.concatenate([to_left[loop_left[k:]], [0], to_right[loop_right[k + 1 :]][::-1]])
    edges_right = to_right[right.edges]
    apart = np.abs(edges_right[:, 0] - edges_right[:, 1])
    welded = (edges_right.max(axis=1) <= k) & ((apart == 1) | (closed & (apart == k)))
    start = 0 if closed else int(np.flatnonzero(nodes[loop] < left.vertex_count)[0])
    union = Component(
        nodes=nodes,
        z=np.zeros(len(nodes), np.complex128),
        loop=loop[:0] if closed else np.roll(loop, -start),
        edges=np.concatenate([to_left[left.edges], edges_right[~welded]]),
        lengths=np.concatenate([left.lengths, right.lengths[~welded]]),
        vertex_count=left.vertex_count,
    )
    return union, (rest_left, rest_right)


def relax_boundary(union: Component) -> Component:
    """Give a component its natural boundary, or as much of it as leaves the boundary curve simple.

    Where the whole displacement would make the boundary cross itself, half of it is tried, and so on. From a displaced curve
    twice as much is tried next, since the curve is resolved better there. A failure after a success ends it: the curve nearly
    touches itself.
    """
    z, strength, is_moved = union.z, 1.0, False
    while strength >= _LEAST_STRENGTH:
        moved = natural_boundary(z, union.edges, union.lengths, union.loop, union.corners, strength)
        if np.isfinite(moved).all() and not crosses_itself(moved[union.loop]):
            z, is_moved = moved, True
            if strength == 1.0:
                break
            strength = min(1.0, 2.0 * strength)
        elif is_moved:
            break
        else:
            strength *= 0.5
    return replace(union, z=z)
