"""The shape of one surface turned into that of another, on one mesh: ``pgcp morph A B``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from pgcp.apps.base import App, Call, Group, Made, folds_said, map_record, npz_file
from pgcp.apps.common.matching import MOEBIUS, Correspondence, alignment_line, matched, spread, vertex_areas
from pgcp.apps.common.pairs import add_pair, landmarks_now, landmarks_of, pair_of
from pgcp.apps.common.values import colours_in, mesh_with, own_colours
from pgcp.errors import InputError
from pgcp.finish.shape import diagonal
from pgcp.io.write import mesh_files
from pgcp.plane.align import rigid_motion
from pgcp.report.panels import animation, as_png, in_rows, panel
from pgcp.report.raster import Paint, view
from pgcp.report.seen import Seen, at_vertices, checkers, map_shapes, turned_box, view_rotation
from pgcp.result import Result
from pgcp.types import FloatArray, Mesh

_STEPS, _MOST = 10, 999
_ACROSS = 5  # shapes in the picture
_DRAWN, _PIXELS = 24, 840  # least number of steps of the animation, and pixels of a frame that is made smaller by half
_HELD, _SHOWN = 700, 60  # milliseconds of the shapes at both ends, and of those between
_SMALL, _CHECKS = 560, 32  # pixels of a shape in the picture; squares across


@dataclass(frozen=True, slots=True, eq=False)
class Morph:
    """Shapes from one surface to another.

    match: which points correspond; end (V_a, 3): where the vertices of a lie on b; rotation (3, 3): that of the rigid motion
    that takes a nearest to there; middles: mean places (3,) of a and of its image, which it takes to each other;
    shares (n + 1,): how far each shape is, from 0 to 1; in_place: whether shapes stay where a is, b being moved there;
    growth: how much larger b is, 1 where sizes are left as they are.
    """

    match: Correspondence
    end: FloatArray
    rotation: FloatArray
    middles: tuple[FloatArray, FloatArray]
    shares: FloatArray
    in_place: bool
    growth: float = 1.0

    def at(self, share: float) -> FloatArray:
        """Vertices (V_a, 3) of the shape at a share of the way: those of a at 0, and on b at 1, or on b moved to a.

        Once the rigid motion, and the growth, are undone, every vertex goes straight. Of both, the same share is done.
        """
        start = self.match.a.mesh.vertices
        if share == 0.0:
            return start.copy()
        if share == 1.0 and not self.in_place:
            return self.end.copy()
        aligned = (self.end - self.middles[1]) @ self.rotation / self.growth
        shape = (1.0 - share) * (start - self.middles[0]) + share * aligned
        shape *= self.growth**share
        if self.in_place:
            return shape + self.middles[0]
        turn = Rotation.from_rotvec(share * Rotation.from_matrix(self.rotation).as_rotvec())
        return np.asarray(turn.apply(shape)) + (1.0 - share) * self.middles[0] + share * self.middles[1]

    @property
    def shapes(self) -> FloatArray:
        """Vertices (n + 1, V_a, 3) of all shapes."""
        return np.stack([self.at(share) for share in self.shares.tolist()])

    def detail_lost(self) -> dict[str, float]:
        """How far the vertices of b are from the last shape, "mean", "p95" and "max", as shares of the diagonal of b.

        Each is compared with the place that corresponds to it.
        """
        b = self.match.b
        away = np.linalg.norm(self.match.to_b(self.end) - b.mesh.vertices, axis=1)[np.unique(b.faces)]
        return spread(away / diagonal(b.mesh))


def morph(
    a: Result,
    b: Result,
    *,
    steps: int = _STEPS,
    in_place: bool = False,
    any_size: bool = False,
    landmarks: Any = None,
    fit: str = MOEBIUS,
) -> Morph:
    """Shapes on the mesh of a from its own to that of b, in so many steps; both are mapped to the sphere, or to the disk.

    The points that correspond are those of ``matching.matched``, which landmarks (n, 2) and fit are of. The rigid motion that
    brings b nearest to a (Kabsch 1976, vertices weighted by area) is done evenly on the way, or, ``in_place``, not at all.
    any_size: shapes go from one to the other as if both were of one size, and grow by an equal factor in each step.

    Raises InputError where the maps go to different domains, or steps are fewer than 1.
    """
    if not 1 <= steps <= _MOST:
        raise InputError(f"there are {steps} steps; there must be from 1 to {_MOST}")
    match = matched(a, b, landmarks=landmarks, fit=fit)
    weights = vertex_areas(a.mesh.vertices, a.faces)
    rotation, _ = rigid_motion(a.mesh.vertices, match.on_b.points, weights)
    middles = weights @ a.mesh.vertices, weights @ match.on_b.points
    growth = _size(match.on_b.points, weights) / _size(a.mesh.vertices, weights) if any_size else 1.0
    return Morph(match, match.on_b.points, rotation, middles, np.linspace(0.0, 1.0, steps + 1), in_place, growth)


def _size(points: FloatArray, weights: FloatArray) -> float:
    """Root of the mean square of distances from the middle."""
    away = points - weights @ points
    return max(float(np.sqrt(weights @ (away**2).sum(axis=1))), 1e-300)


# Files and figures ------------------------------------------------------------------------------------------------------------


def _meshes(name: str, done: Morph, contents: Callable[[str, Mesh], dict[str, bytes]]) -> dict[str, bytes]:
    """A file for every shape: ``_00`` before the ending, ``_01`` and so on."""
    stem, _, ending = name.rpartition(".")
    digits = max(len(str(len(done.shares) - 1)), 2)
    out: dict[str, bytes] = {}
    for k, share in enumerate(done.shares.tolist()):
        out |= contents(f"{stem}_{k:0{digits}d}.{ending}", Mesh(done.at(share), done.match.a.faces))
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Drawing:
    """How shapes are drawn: where a is and of its size, from one side, in a's colours or with a checkerboard of its map."""

    done: Morph
    weights: FloatArray
    rotation: FloatArray
    box: FloatArray
    paint: Paint

    @classmethod
    def of(cls, done: Morph) -> _Drawing:
        """That of a morph: everything is in sight all the time."""
        still, a = replace(done, in_place=True), done.match.a
        rotation, used = view_rotation(a.mesh.vertices, a.faces), np.unique(a.faces)
        weights = vertex_areas(a.mesh.vertices, a.faces)
        box = turned_box([_of_size(still, share, weights)[used] for share in (0.0, 1.0)], rotation)
        own = colours_in(own_colours(a))
        if own is not None:
            return cls(still, weights, rotation, box, at_vertices(a.faces, own))
        shapes = map_shapes(a, view(a.mesh.vertices, a.faces, rotation))
        return cls(still, weights, rotation, box, checkers(a, rotation, shapes, _CHECKS))

    def at(self, share: float, pixels: int) -> Image.Image:
        """A shape."""
        points = _of_size(self.done, share, self.weights)
        return Seen.of(points, self.done.match.a.faces, self.rotation, self.box).drawn(self.paint, pixels)


def _of_size(still: Morph, share: float, weights: FloatArray) -> FloatArray:
    """Vertices (V_a, 3) of a shape in place, made as large as a is, in mean squares of distances from the middle."""
    start, shape = still.match.a.mesh.vertices, still.at(share)
    return (shape - still.middles[0]) * (_size(start, weights) / _size(shape, weights)) + still.middles[0]


def _picture(name: str, done: Morph) -> dict[str, bytes]:
    """Some of the shapes in a row, all seen from one side and of one size."""
    shares, drawing = np.linspace(0.0, 1.0, _ACROSS).tolist(), _Drawing.of(done)
    ends = done.match.a.mesh.name, f"the shape of {done.match.b.mesh.name}"
    captions = [ends[0], *(f"{share:.0%} of the way" for share in shares[1:-1]), ends[1]]
    panels = [panel(words, drawing.at(share, _SMALL), pixels=_SMALL) for share, words in zip(shares, captions, strict=True)]
    return {name: as_png(in_rows(panels, _ACROSS).reduce(2))}


def _animation(name: str, done: Morph) -> dict[str, bytes]:
    """The way there and back, over and over."""
    count, drawing = max(len(done.shares) - 1, _DRAWN), _Drawing.of(done)
    frames = [drawing.at(k / count, _PIXELS).reduce(2) for k in range(count + 1)]
    times = [_HELD, *[_SHOWN] * (count - 1), _HELD, *[_SHOWN] * (count - 1)]
    return {name: animation([*frames, *frames[-2:0:-1]], times)}


def _run(call: Call) -> Made:
    if not 1 <= call["steps"] <= _MOST:
        raise InputError(f"--steps is {call['steps']}; it must be from 1 to {_MOST}")
    pair = pair_of(call["a"], call["b"], call.options)
    landmarks = landmarks_of(call["landmarks"], pair, call["fit"])
    a, b = pair.mapped(call)
    call.shown("align", 0, 0)
    done = morph(
        a, b, steps=call["steps"], in_place=call["in_place"], any_size=call["any_size"],
        landmarks=landmarks_now(landmarks, (a, b)), fit=call["fit"],
    )  # fmt: skip
    lost, colours = done.detail_lost(), own_colours(done.match.a)
    call.shown("align", 1, 1)
    record = {
        "a": map_record(a),
        "b": map_record(b),
        "alignment": done.match.record,
        "steps": call["steps"],
        "rotation": done.rotation.tolist(),
        "detail_lost": lost,
    }
    files = {
        ".ply": lambda name: _meshes(name, done, lambda each, mesh: mesh_with(each, mesh, colours)),
        ".obj": lambda name: _meshes(name, done, mesh_files),
        ".npz": lambda name: npz_file(name, vertices=done.shapes, faces=a.faces, shares=done.shares),
        ".gif": lambda name: _animation(name, done),
        ".png": lambda name: _picture(name, done),
    }
    said = f"mean {lost['mean']:.2%}, 95 % below {lost['p95']:.2%}, at most {lost['max']:.2%} of the diagonal"
    lines = (
        f"{a.mesh.name}, {len(a.mesh.vertices)} vertices, to the shape of {b.mesh.name} in {call['steps']} steps",
        alignment_line(done.match.record),
        f"vertices of {b.mesh.name} from the last shape: {said}",
    )
    return Made(files, record, lines, folds_said(a) or folds_said(b))


def _ask(group: Group) -> None:
    add_pair(group)
    group.add_argument(
        "--steps", type=int, default=_STEPS, metavar="N", help=f"from the first shape to the last; default {_STEPS}"
    )
    group.add_argument(
        "--any-size", action="store_true", help="shapes change as if both were of one size, and grow evenly, by factors"
    )
    group.add_argument(
        "--in-place",
        action="store_true",
        help="shapes stay where the first mesh is; the last is the second mesh's, moved there",
    )


APP = App(
    name="morph",
    summary="the shape of one surface turned into that of another, step by step, on the first one's mesh",
    writes={
        ".ply": "a mesh for every shape: `_00` before the ending, `_01` and so on, with the first mesh's colours",
        ".obj": "the same as OBJ files",
        ".npz": "all shapes in one file: `vertices` (n + 1, V, 3), `faces`, `shares`",
        ".gif": "the way there and back, animated",
        ".png": "five of the shapes in a row",
    },
    arguments=_ask,
    run=_run,
    usual=(".ply", ".gif", ".png"),
    reference="Baden, Crane, Kazhdan, Moebius Registration, Computer Graphics Forum 37(5), 2018",
)
