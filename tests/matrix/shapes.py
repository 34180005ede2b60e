"""Random shapes by kind: each a function of a random generator and of about how many faces there should be."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from judge import flipped_in_plane, flipped_on_sphere
from meshes import cap, icosphere
from scipy.spatial import ConvexHull, Delaunay
from surfaces import (
    Array,
    Shape,
    between,
    boosted,
    is_disk_or_sphere,
    on_sphere,
    pulled,
    revolved,
    rings_sewn,
    sheet,
    slivers,
    split_quads,
    tube,
    without_unused,
)

Random = np.random.Generator
Maker = Callable[[Random, int], Shape]
KINDS: dict[str, Maker] = {}


def kind(make: Maker) -> Maker:
    """Register a maker by its name."""
    KINDS[make.__name__] = make
    return make


def _round_and_long(random: Random, faces: int, tips: int) -> tuple[int, int]:
    """Vertices around, and rings, of a tube with about so many faces."""
    around = int(np.clip(np.sqrt(faces / 2) * between(random, 0.2, 3), 3, max(3, faces // 4)))
    return around, max(2, round(faces / (2 * around)) + 1 - tips // 2)


def _ball(random: Random, faces: int) -> tuple[Array, Array]:
    """Points of the unit sphere, and faces: an icosphere, or the hull of random points."""
    level = round(np.log(max(faces, 20) / 20) / np.log(4))
    if random.random() < 0.5 and level <= 5:
        ball = icosphere(int(level))
        return ball.vertices, ball.faces
    points = random.normal(size=(max(4, faces // 2 + 2), 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    triangles = ConvexHull(points).simplices.astype(np.int64)
    a, b, c = points[triangles.T[0]], points[triangles.T[1]], points[triangles.T[2]]
    inward = np.einsum("fd,fd->f", np.cross(b - a, c - a), a + b + c - 3 * points.mean(axis=0)) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return points, triangles


def _opened(random: Random, points: Array, faces: Array) -> tuple[Array, Array]:
    """A closed surface without one face, or without those around a point, as long as it is a disk then."""
    middles = points[faces].mean(axis=1)
    from_it = np.linalg.norm(middles - middles[random.integers(len(faces))], axis=1)
    share = random.choice([0.0, 0.02, 0.2, 0.5])
    order = np.argsort(from_it)
    for count in (int(share * len(faces)), int(share * len(faces) / 4), 1):
        left = without_unused(points, faces[np.sort(order[max(count, 1) :])])
        if len(left[1]) and is_disk_or_sphere(left[1]) == "disk":
            return left
    return without_unused(points, np.delete(faces, order[0], axis=0))


def _flat_outline(random: Random, plane: Array, triangles: Array) -> tuple[Array, Array, str]:
    """A planar sheet cut to an outline, or left whole where that is no disk."""
    x, y = (plane[triangles].mean(axis=1) - 0.5).T * 2
    turn, far = np.arctan2(y, x), np.hypot(x, y)
    outlines = {
        "whole": np.ones(len(triangles), bool),
        "L": ~((x > 0.1) & (y > 0.1)),
        "star": far < 0.55 + 0.4 * np.cos(5 * turn),
        "spiral": np.abs((far - 0.12 * (turn + np.pi) / np.pi) % 0.24 - 0.12) < 0.08,
        "comb": (y < -0.6) | (np.sin(20 * x) > 0),
        "slit": ~((np.abs(y) < 0.02) & (x > 0)),
    }
    name = str(random.choice(list(outlines)))
    kept = triangles[outlines[name]]
    if len(kept):
        cut = without_unused(plane, kept)
        if is_disk_or_sphere(cut[1]) == "disk":
            return *cut, name
    return plane, triangles, "whole"


def _plane_mesh(random: Random, faces: int) -> tuple[Array, Array, str]:
    """Points (V, 2) of the unit square and counter-clockwise faces: a grid, even, moved at random or graded; or Delaunay."""
    form = str(random.choice(["grid", "moved", "graded", "delaunay"]))
    if form == "delaunay":
        plane = random.random((max(3, faces // 2 + 2), 2))
        triangles = Delaunay(plane).simplices.astype(np.int64)
        a, b, c = (plane[triangles.T[i]] for i in range(3))
        area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
        triangles[area < 0] = triangles[area < 0][:, ::-1]
        return plane, triangles, form
    rows = int(np.clip(np.sqrt(faces / 2) * between(random, 0.2, 5), 1, max(1, faces // 2)))
    columns = max(1, round(faces / (2 * rows)))
    u, v, triangles = sheet(rows, columns, random if random.random() < 0.5 else None)
    if form == "moved":
        inner = (u > 0) & (u < 1) & (v > 0) & (v < 1)
        u = u + inner * random.uniform(-0.24, 0.24, len(u)) / rows
        v = v + inner * random.uniform(-0.24, 0.24, len(v)) / columns
    if form == "graded":
        decades = random.uniform(1, 9)
        return (
            np.column_stack([10 ** (decades * (u - 1)), v * 10 ** (decades * (u - 1))]),
            triangles,
            f"graded over {decades:.1f} decades",
        )
    return np.column_stack([u, v]), triangles, form


@kind
def flat_sheet(random: Random, faces: int) -> Shape:
    """A sheet in the plane, of any outline and grading, turned and stretched."""
    plane, triangles, form = _plane_mesh(random, faces)
    outline = "whole"
    if not form.startswith("graded"):
        plane, triangles, outline = _flat_outline(random, plane, triangles)
    long = between(random, 1, 300) if random.random() < 0.5 else 1.0
    points = np.column_stack([plane[:, 0] * long, plane[:, 1], np.zeros(len(plane))])
    axes = np.linalg.qr(random.normal(size=(3, 3)))[0]
    axes *= np.sign(np.linalg.det(axes))
    turned = bool(random.random() < 0.5)
    return Shape(
        points @ axes if turned else points, triangles, False, {"form": form, "outline": outline, "long": long}, is_flat=True
    )


@kind
def rolled_sheet(random: Random, faces: int) -> Shape:
    """A sheet rolled up along rulings, into a cylinder's part, a scroll or a wave: developable as a mesh."""
    rows, columns = _round_and_long(random, faces, 0)
    u, v, triangles = sheet(rows, columns, random if random.random() < 0.5 else None)
    form = str(random.choice(["arc", "scroll", "wave", "creased"]))
    at = np.linspace(0, 1, rows + 1)
    turns = between(random, 0.2, 4)
    angle = 2 * np.pi * turns * at
    if form == "arc":
        curve = np.column_stack([np.cos(0.9 * angle / turns), np.sin(0.9 * angle / turns)])
    elif form == "scroll":
        curve = np.column_stack([(0.3 + at) * np.cos(angle), (0.3 + at) * np.sin(angle)])
    elif form == "wave":
        curve = np.column_stack([2 * at, 0.3 * np.sin(angle)])
    else:
        curve = np.cumsum(np.column_stack([np.cos(a := random.uniform(-2, 2, rows + 1)), np.sin(a)]), axis=0)
    wide = between(random, 0.05, 20)
    index = np.round(u * rows).astype(int)
    points = np.column_stack([curve[index, 0], wide * v, curve[index, 1]])
    return Shape(points, triangles, False, {"form": form, "turns": turns, "wide": wide}, is_flat=True)


@kind
def noisy_sheet(random: Random, faces: int) -> Shape:
    """A height field with noise, from far less to far more than the spacing."""
    plane, triangles, form = _plane_mesh(random, faces)
    plane, triangles, outline = _flat_outline(random, plane, triangles)
    noise = between(random, 0.01, 10)
    hills = between(random, 0.01, 2)
    height = hills * np.sin(3 * plane[:, 0]) * np.cos(4 * plane[:, 1]) + noise * random.normal(size=len(plane)) / np.sqrt(
        len(plane)
    )
    what = {"form": form, "outline": outline, "noise": noise, "hills": hills}
    return Shape(np.column_stack([plane, height]), triangles, False, what)


@kind
def turning_sheet(random: Random, faces: int) -> Shape:
    """A helicoid or a twisted ribbon of several turns: its free map overlaps itself."""
    rows, columns = max(2, int(np.sqrt(faces) * 2)), max(1, int(np.sqrt(faces) / 4))
    u, v, triangles = sheet(rows, columns, random if random.random() < 0.5 else None)
    turns, inner, rise = between(random, 0.3, 6), between(random, 0.02, 1), between(random, 0.02, 3)
    angle, far = 2 * np.pi * turns * u, inner + v
    points = np.column_stack([far * np.cos(angle), far * np.sin(angle), rise * u])
    return Shape(points, triangles, False, {"turns": turns, "inner": inner, "rise": rise})


def _profile(random: Random, rings: int, from_tip: bool, to_tip: bool) -> tuple[Array, Array, dict[str, object]]:
    """Radii and heights (rings,) of a surface of revolution, which at a tip would go on to radius 0."""
    form = str(random.choice(["ellipsoid", "dumbbell", "vase", "cone"]))
    long = between(random, 0.01, 40)
    at = (np.arange(rings) + 1) / (rings + 1)
    t = np.pi * np.interp(at, [0, 1], [0.0 if from_tip else 0.3, 1.0 if to_tip else 0.7])
    radii, heights = np.sin(t), -long * np.cos(t)
    if form == "dumbbell":
        radii = radii * (between(random, 0.01, 0.5) + np.cos(t) ** 2)
    elif form == "vase":
        radii = radii * np.exp(random.uniform(0, 1.5) * np.sin(random.uniform(1, 12) * t + random.uniform(0, 6)))
    elif form == "cone":
        radii, heights = (t if from_tip else 1 + t) * (np.pi - t if to_tip else 1.0), long * t
    return radii, heights, {"form": form, "long": long}


@kind
def revolution_open(random: Random, faces: int) -> Shape:
    """A surface of revolution with a tip and a rim."""
    around, rings = _round_and_long(random, faces, 1)
    radii, heights, what = _profile(random, rings, True, False)
    points, logs = revolved(radii, heights, around)
    tip = [0.0, 0.0, heights[0] - (heights[1] - heights[0]) * between(random, 0.1, 1)]
    turn = np.exp(2j * np.pi * np.arange(around) / around)
    with np.errstate(under="ignore"):
        w = np.append((np.exp(logs - logs[-1])[:, None] * turn).ravel(), 0.0)
    # seen from outside, about the direction away from the tip: the disk is seen from inside, mirrored
    image = np.column_stack([w.real, -w.imag])
    faces_made = rings_sewn(rings, around, True, False, random if random.random() < 0.5 else None)
    what |= {"around": around, "rings": rings, "range": float(f"{np.ptp(logs):.3g}")}
    known = image if np.ptp(logs) < 30 else None
    return Shape(np.vstack([points, tip]), faces_made, False, what, image=known)


@kind
def revolution_closed(random: Random, faces: int) -> Shape:
    """A surface of revolution with two tips: ellipsoids, thin and flat, dumbbells, vases, spindles."""
    around, rings = _round_and_long(random, faces, 2)
    radii, heights, what = _profile(random, rings, True, True)
    points, logs = revolved(radii, heights, around)
    tips = [[0.0, 0.0, 1.5 * heights[0] - 0.5 * heights[1]], [0.0, 0.0, 1.5 * heights[-1] - 0.5 * heights[-2]]]
    turn = np.exp(2j * np.pi * np.arange(around) / around)
    with np.errstate(under="ignore", over="ignore"):
        w = np.append((np.exp(0.5 * (logs[0] + logs[-1]) - logs)[:, None] * turn).ravel(), [np.inf, 0.0])
    image = on_sphere(w)
    faces_made = rings_sewn(rings, around, True, True, random if random.random() < 0.5 else None)
    what |= {"around": around, "rings": rings, "range": float(f"{np.ptp(logs):.3g}")}
    return Shape(np.vstack([points, tips]), faces_made, True, what, image=image if np.ptp(logs) < 30 else None)


def _curve(random: Random, count: int) -> tuple[Array, str]:
    """A smooth curve (count, 3) of length about 10 or more, and what it is."""
    t = np.linspace(0, 1, count)
    form = str(random.choice(["straight", "coil", "knot", "wandering"]))
    if form == "straight":
        return np.column_stack([10 * t, 0 * t, 0 * t]), form
    if form == "coil":
        return np.column_stack([np.cos(20 * t) * (1 + t), np.sin(20 * t) * (1 + t), 4 * t]), form
    if form == "knot":
        s = 6 * t
        return np.column_stack([np.sin(s) + 2 * np.sin(2 * s), np.cos(s) - 2 * np.cos(2 * s), -np.sin(3 * s)]), form
    waves, phase = random.normal(size=(4, 3)), random.uniform(0, 6, (4, 3))
    return 10 * t[:, None] * [1, 0, 0] + sum(waves[k] * np.sin((k + 1) * 3 * t[:, None] + phase[k]) for k in range(4)), form


def _tube(random: Random, faces: int, ends: int) -> Shape:
    around, rings = _round_and_long(random, faces, ends)
    rings = max(rings, 3)
    curve, form = _curve(random, rings)
    radius, taper = between(random, 0.02, 0.4), between(random, 0.1, 1)
    points = tube(curve, radius * np.linspace(1, taper, rings), around)
    tips = [curve[0], curve[-1]] if ends == 2 else [curve[-1]]
    faces_made = rings_sewn(rings, around, ends == 2, True, random if random.random() < 0.5 else None)
    what = {"curve": form, "radius": radius, "taper": taper, "around": around, "rings": rings}
    return Shape(np.vstack([points, tips]), faces_made, ends == 2, what)


@kind
def tube_closed(random: Random, faces: int) -> Shape:
    """A tube along a curve, closed at both ends."""
    return _tube(random, faces, 2)


@kind
def tube_open(random: Random, faces: int) -> Shape:
    """A tube along a curve, open at one end."""
    return _tube(random, faces, 1)


@kind
def tree(random: Random, faces: int) -> Shape:
    """A tree of tubes: limbs pulled out of a ball, open or closed."""
    steps = max(1, min(faces // 8, 3000))
    ball = icosphere(int(random.integers(0, 3))) if faces > 40 else icosphere(0)
    length, thin = between(random, 0.3, 6), between(random, 0.7, 1.05)
    points, triangles = pulled(ball.vertices, ball.faces, random, steps, length, thin)
    what = {"steps": steps, "length": length, "thin": thin}
    if random.random() < 0.5:
        return Shape(*_opened(random, points, triangles), False, what)
    return Shape(points, triangles, True, what)


@kind
def spiky_ball(random: Random, faces: int) -> Shape:
    """A ball with spikes, closed, or without a face or a part."""
    points, triangles = _ball(random, faces)
    spikes, high, sharp = int(random.integers(1, 16)), between(random, 0.1, 10), between(random, 0.003, 0.3)
    ways = random.normal(size=(spikes, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    points = points * (1 + high * np.exp(-(1 - points @ ways.T) / sharp).sum(axis=1))[:, None]
    what = {"spikes": spikes, "high": high, "sharp": sharp}
    if random.random() < 0.4:
        return Shape(*_opened(random, points, triangles), False, what)
    return Shape(points, triangles, True, what)


@kind
def plate(random: Random, faces: int) -> Shape:
    """A thin plate with a round rim of slivers, closed or without a part."""
    points, triangles = _ball(random, faces)
    power, thin = between(random, 0.1, 1), between(random, 0.001, 1)
    points = np.sign(points) * np.abs(points) ** power * [1, between(random, 0.1, 1), thin]
    what = {"power": power, "thin": thin}
    if random.random() < 0.4:
        return Shape(*_opened(random, points, triangles), False, what)
    return Shape(points, triangles, True, what)


@kind
def noisy_ball(random: Random, faces: int) -> Shape:
    """A ball with noise and slivers, closed or without a part."""
    points, triangles = _ball(random, faces)
    noise = between(random, 0.001, 1) / np.sqrt(len(points)) * 3
    points = points * (1 + noise * random.normal(size=(len(points), 1)))
    points, triangles = slivers(points, triangles, int(random.integers(0, 6)), random)
    if random.random() < 0.4:
        return Shape(*_opened(random, points, triangles), False, {"noise": noise})
    return Shape(points, triangles, True, {"noise": noise})


@kind
def moebius_disk(random: Random, faces: int) -> Shape:
    """The unit disk in the plane after a Moebius map of it, which is its conformal map."""
    mesh, z = cap(max(1, round(np.sqrt(faces / 6))))
    z = z / np.abs(z).max()
    rim = np.abs(z) > 1 - 1e-12
    a = (1 - between(random, 0.01, 1)) * np.exp(1j * random.uniform(0, 6))
    w = (z - a) / (1 - np.conj(a) * z)
    w[rim] /= np.abs(w[rim])
    plane = np.column_stack([w.real, w.imag])
    if flipped_in_plane(plane, mesh.faces):
        plane = np.column_stack([z.real, z.imag])
    return Shape(np.pad(plane, ((0, 0), (0, 1))), mesh.faces, False, {"a": float(abs(a))}, is_flat=True, image=plane)


@kind
def moebius_sphere(random: Random, faces: int) -> Shape:
    """The unit sphere after a Moebius map of it, which is its conformal map."""
    points, triangles = _ball(random, faces)
    towards = random.normal(size=3)
    away = between(random, 0.003, 1)
    image = boosted(points, (1 - away) * towards / np.linalg.norm(towards))
    image /= np.linalg.norm(image, axis=1)[:, None]
    known = None if flipped_on_sphere(image, triangles) else image
    return Shape(image, triangles, True, {"away": away}, image=known)


@kind
def voxels(random: Random, faces: int) -> Shape:
    """The surface of a blob of voxels, closed, or without its lowest faces."""
    side = int(np.clip(np.sqrt(faces / 12), 1, 60))
    for smooth in (0.6, 0.3, 0.1, 0.0):
        at = (
            np.stack(np.meshgrid(*[np.linspace(-1, 1, side)] * 3, indexing="ij"), axis=-1)
            if side > 1
            else np.zeros((1, 1, 1, 3))
        )
        way, phase = random.normal(size=(3, 3)) * 2, random.uniform(0, 6, 3)
        field = np.linalg.norm(at, axis=-1) + smooth * np.sin(at @ way.T + phase).mean(axis=-1)
        made = _voxel_surface(field <= max(0.9, float(field.min())))
        if made is not None:
            break
    assert made is not None
    points, triangles = made
    what: dict[str, object] = {"side": side, "smooth": smooth}
    lowest = points[triangles][..., 2].max(axis=1) == points[:, 2].min()
    if random.random() < 0.4 and len(triangles) > 12:
        cut = without_unused(points, triangles[~lowest])
        if is_disk_or_sphere(cut[1]) == "disk":
            return Shape(*cut, False, what)
    return Shape(points, triangles, True, what)


def _voxel_surface(inside: Array) -> tuple[Array, Array] | None:
    """Faces between voxels inside and outside, two a square, where they make up a sphere."""
    inside = np.pad(inside, 1)
    shape = np.array(inside.shape) + 1
    quads = []
    for axis in range(3):
        one, two = (axis + 1) % 3, (axis + 2) % 3
        for sign in (1, -1):
            open_side = inside & ~np.roll(inside, -sign, axis)
            base = np.argwhere(open_side)
            base[:, axis] += sign > 0
            corners = np.repeat(base[:, None], 4, axis=1)
            order = [(0, 0), (1, 0), (1, 1), (0, 1)] if sign > 0 else [(0, 0), (0, 1), (1, 1), (1, 0)]
            for k, (p, q) in enumerate(order):
                corners[:, k, one] += p
                corners[:, k, two] += q
            quads.append(np.ravel_multi_index(tuple(corners.reshape(-1, 3).T), tuple(shape)).reshape(-1, 4))
    numbers, index = np.unique(np.concatenate(quads), return_inverse=True)
    triangles = split_quads(index.reshape(-1, 4))
    points = np.column_stack(np.unravel_index(numbers, tuple(shape))).astype(np.float64)
    return (points, triangles) if is_disk_or_sphere(triangles) == "sphere" else None


@kind
def stairs(random: Random, faces: int) -> Shape:
    """A sheet of steps, as of voxels: level squares and upright ones, along one direction or two by turns."""
    rows, columns = _round_and_long(random, faces, 0)
    u, v, triangles = sheet(rows, columns, None)
    i, j = np.round(u * rows), np.round(v * columns)
    along = np.column_stack([np.ceil(i / 2), np.floor(i / 2)])
    high = between(random, 0.05, 20)
    two = bool(random.random() < 0.5)
    points = np.column_stack([along[:, 0], j, high * along[:, 1]])
    if two:
        points = points + np.column_stack([0 * j, -np.floor(j / 2), np.floor(j / 2) * high])
    return Shape(points, triangles, False, {"high": high, "two": two}, is_flat=not two)


@kind
def cad_rod(random: Random, faces: int) -> Shape:
    """A rod or a plate over a polygon, its lids fans from one corner, its sides needles; closed or without a lid."""
    n = max(3, faces // 4)
    high, star = between(random, 0.001, 300), random.random() < 0.4
    turn = 2 * np.pi * np.arange(n) / n
    far = 1 + (0.3 * np.cos(5 * turn) if star and n > 12 else 0.0)
    ring = np.column_stack([far * np.cos(turn), far * np.sin(turn)])
    points = np.column_stack([np.vstack([ring, ring]), np.repeat([0, high], n)])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    k = np.arange(1, n - 1)
    sides = split_quads(np.column_stack([i, j, n + j, n + i]))
    bottom = np.column_stack([0 * k, k + 1, k])
    top = np.column_stack([0 * k + n, n + k, n + k + 1])
    closed = bool(random.random() < 0.6)
    parts = [sides, bottom, top] if closed else [sides, bottom]
    return Shape(points, np.concatenate(parts), closed, {"corners": n, "high": high, "star": star})


@kind
def fan(random: Random, faces: int) -> Shape:
    """Faces around one vertex: a cone, flat or high, a saddle; or two such, closed."""
    n = max(3, faces)
    turn = 2 * np.pi * np.arange(n) / n
    high, waves = between(random, 0.001, 100), int(random.choice([0, 0, 2, 5]))
    ring = np.column_stack([np.cos(turn), np.sin(turn), 0.3 * np.sin(waves * turn)])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    up = np.column_stack([0 * i + n, i, j])
    if random.random() < 0.6:
        return Shape(np.vstack([ring, [0, 0, high]]), up, False, {"high": high, "waves": waves})
    n2 = max(3, n // 2)
    turn = 2 * np.pi * np.arange(n2) / n2
    ring = np.column_stack([np.cos(turn), np.sin(turn), 0.3 * np.sin(waves * turn)])
    i, j = np.arange(n2), (np.arange(n2) + 1) % n2
    both = np.concatenate([np.column_stack([0 * i + n2, i, j]), np.column_stack([0 * i + n2 + 1, j, i])])
    low = -between(random, 0.001, 100)
    return Shape(np.vstack([ring, [0, 0, high], [0, 0, low]]), both, True, {"high": high, "low": low, "waves": waves})


@kind
def strip(random: Random, faces: int) -> Shape:
    """A strip of triangles, all vertices on its boundary: straight, bent out of the plane, or wound up."""
    n = max(1, faces)
    i = np.arange(n + 2)
    k = np.arange(n)
    odd = (k % 2 == 1)[:, None]
    triangles = np.where(odd, np.column_stack([k + 1, k, k + 2]), np.column_stack([k, k + 1, k + 2]))
    wide, twist = between(random, 0.01, 10), random.choice([0.0, 1.0]) * between(random, 0.001, 1)
    side = (i % 2) * wide
    # a zigzag bent about lines across: every three vertices span a plane, and all vertices are on the boundary, so it unfolds
    points = np.column_stack([0.5 * i, side * np.cos(twist * i), side * np.sin(twist * i)])
    return Shape(points, triangles[:, ::-1], False, {"wide": wide, "twist": float(twist)}, is_flat=True)
