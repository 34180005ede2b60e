"""What the report page draws: the surface with few enough faces, its map, and figures of every face, as packed numbers."""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgcp.finish.unit_square import upright_angle
from pgcp.parallel import in_slices
from pgcp.report.picture import patch_colours
from pgcp.report.seen import view_rotation
from pgcp.report.shade import vertex_shapes
from pgcp.surface.distortion import angle_errors, log_area_ratios
from pgcp.surface.operators import face_areas
from pgcp.targets.registry import TARGETS
from pgcp.types import FloatArray, IntArray, Mesh, Parameterization

MOST_FACES = 200_000
_TRIES = 6
_CELLS_A_FACE = 2.6  # area of the surface in cells' sides squared, by face that is left
_FINE, _FINER = 65_535, (1 << 24) - 1  # steps of the surface's coordinates, and of the map's, which zooms need
_SQUARES = 48  # across the surface
_HALVES = 1024  # steps of a binary logarithm
_MOST_HALVES = 60.0
_LEVEL = 2  # of deflate: others take twice as long for a few percent
_TINY = 1e-300


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A surface and its map with few faces: points (n, 3), image (n, 2) or (n, 3), faces (m, 3), all of them used.

    face_ids (m,): the face of the mesh that each was, whose figures it has.
    """

    points: FloatArray
    image: FloatArray
    faces: IntArray
    face_ids: IntArray


def scene_of(result: Parameterization, most: int = MOST_FACES) -> Scene:
    """The surface and its map with at most so many faces: as they are, or with vertices that are close together as one."""
    mesh, image = result.mesh, result.coordinates
    points, faces = mesh.vertices, mesh.faces
    ids: IntArray = np.arange(len(faces))
    if len(faces) > most:
        points, image, faces, ids = _clustered(result, most)
    first = np.full(len(points), faces.size)
    first[faces.reshape(-1)[::-1]] = np.arange(faces.size)[::-1]  # the last one written counts: the first use of each
    used = np.argsort(first, kind="stable")[: int((first < faces.size).sum())]  # in the order of faces, which packs well
    number = np.zeros(len(points), np.int32)
    number[used] = np.arange(len(used), dtype=np.int32)
    return Scene(points[used], image[used], number[faces], ids)


def _clustered(result: Parameterization, most: int) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
    """Points, image, faces and their ids once all vertices of a patch in one small cube are one, at their mean place.

    The cubes grow until at most ``most`` faces are left (Rossignac, Borrel 1993: vertex clustering). Vertices that look to
    opposite sides stay apart, so that the two sides of a thin fold do.
    """
    mesh, faces = result.mesh, result.mesh.faces
    low = np.array([column.min() for column in mesh.vertices.T])
    extent = _extent(mesh.vertices)
    shapes = vertex_shapes(mesh.vertices, faces, result.coordinates, (extent, 1.0))
    sides = (np.abs(shapes[:, :3]).argmax(axis=1) * 2).astype(np.int64)
    sides += np.take_along_axis(shapes[:, :3], (sides // 2)[:, None], axis=1)[:, 0] > 0.0
    patch = np.zeros(len(mesh.vertices), np.int64)
    for corner in faces.T:
        patch[corner] = result.patch
    apart = patch * 6 + sides
    unit = (mesh.vertices - low) / extent
    side = max(np.sqrt(_CELLS_A_FACE * _area(mesh.vertices, faces) / most) / extent, 1e-6)
    for _ in range(_TRIES):
        across = int(1.0 / side) + 1
        cells = (unit / side).astype(np.int64)
        keys = ((apart * across + cells[:, 0]) * across + cells[:, 1]) * across + cells[:, 2]
        names, place = np.unique(keys, return_inverse=True)
        place = place.reshape(-1)
        ids, fewer = _without_doubles(place[faces], len(names))
        if len(ids) <= most:
            break
        side *= 1.05 * np.sqrt(len(ids) / most)
    else:
        ids, fewer = ids[:: len(ids) // most + 1], fewer[:: len(ids) // most + 1]
    count = np.bincount(place)[:, None]
    points, image = (_means(values, place, count) for values in (mesh.vertices, result.coordinates))
    if TARGETS.get(result.target).space.closed:
        image /= np.maximum(np.linalg.norm(image, axis=1, keepdims=True), _TINY)
    return points, image, fewer, ids


def _area(points: FloatArray, faces: IntArray) -> float:
    """Area of a surface."""
    return sum(in_slices(lambda begin, end: float(face_areas(points, faces[begin:end]).sum()), len(faces)))


def _means(values: FloatArray, place: IntArray, count: IntArray) -> FloatArray:
    return np.column_stack([np.bincount(place, column) for column in values.T]) / count


def _without_doubles(faces: IntArray, count: int) -> tuple[IntArray, IntArray]:
    """Which faces have three unlike corners, one of each three, and these faces."""
    a, b, c = faces.T
    ids = np.flatnonzero((a != b) & (b != c) & (c != a))
    kept = np.sort(faces[ids], axis=1).astype(np.int64)
    if count < 2**21:
        _, first = np.unique((kept[:, 0] * count + kept[:, 1]) * count + kept[:, 2], return_index=True)
    else:
        _, first = np.unique(kept, axis=0, return_index=True)
    ids = ids[np.sort(first)]
    return ids, faces[ids]


@dataclass(frozen=True, slots=True, eq=False)
class Packed:
    """Numbers of a scene as text: ``head`` is plain data on what they are, ``text`` the base64 of their deflated bytes."""

    head: dict[str, Any]
    text: str


def packed(result: Parameterization, scene: Scene) -> Packed:
    """The scene with all that is needed to draw it: colours, angles of view, figures of faces.

    Positions are in units of the surface's extent, and rounded to its 65,535th part; those of the map in units of its own, and
    rounded to its 16,777,215th part, or on the unit sphere.
    """
    closed = TARGETS.get(result.target).space.closed
    points, image = _in_steps(scene.points, _FINE), _in_steps(scene.image, _FINER)
    errors, halves = _figures(result, scene.face_ids)
    largest = max(float(errors.max(initial=0.0)), 1e-12)
    units = _extent(scene.points), 1.0 if closed else _extent(scene.image)
    scales = vertex_shapes(scene.points, scene.faces, scene.image, units)[:, 3] - np.log2(_SQUARES)
    scales += 0.0 if closed else np.rint(np.median(scales)) - np.median(scales)  # squares of one size where most are
    arrays = {
        "points": _Coded(points),
        "image": _Coded(image),
        "faces": _Coded(_new_or_old(scene.faces), is_delta=False),
        "scale": _Coded(np.rint(np.clip(scales, -_MOST_HALVES, _MOST_HALVES) * _HALVES)[:, None]),
        "angle": _Coded(np.rint(np.sqrt(errors / largest) * _FINE)[:, None], is_delta=False),
        "area": _Coded(np.rint(halves * _HALVES)[:, None], is_delta=False),
        "patch": _Coded(result.patch[scene.face_ids][:, None]),
        "edges": _Coded(_edges(scene.faces, result.patch[scene.face_ids])[:, None], is_delta=False),
    }
    if len(scene.faces) < len(result.mesh.faces):
        arrays["ids"] = _Coded(scene.face_ids[:, None])
    count = int(result.patch.max()) + 1
    middle = float(np.median(halves))
    reach = float(np.quantile(np.abs(halves - middle), 0.95))
    head = {
        "arrays": [{"name": name, "shape": array.numbers.shape, "delta": array.is_delta} for name, array in arrays.items()],
        "points": {"low": [0.0] * 3, "step": 1.0 / _FINE},
        "image": {"low": [0.0] * 2, "step": 1.0 / _FINER},
        "halves": _HALVES,
        "angle_max": largest,
        "angle_limit": max(result.quality.angle_p99_deg, 1e-9),
        "area_middle": middle,
        "area_limit": max(1.0, float(np.ceil(min(reach, _MOST_HALVES)))),
        "closed": closed,
        "turn": np.round(view_rotation(scene.points, scene.faces), 6).ravel().tolist(),
        "upright": 0.0 if closed else upright_angle(Mesh(scene.points, scene.faces), scene.image)[0],
        "palette": np.rint(patch_colours(result.report.get("patches", []), count) * 255).astype(int).tolist(),
    }
    if closed:
        head["image"] = {"low": scene.image.min(axis=0).tolist(), "step": _extent(scene.image) / _FINER}
    data = zlib.compress(b"".join(array.planes() for array in arrays.values()), _LEVEL)
    return Packed(head, base64.b64encode(data).decode())


@dataclass(frozen=True, slots=True, eq=False)
class _Coded:
    """Whole numbers (n, k), to be packed: as they are, or each less the one above it."""

    numbers: np.ndarray
    is_delta: bool = True

    def planes(self) -> bytes:
        """Bytes of the numbers, signs last, column by column: all first bytes, all second ones, and so on."""
        columns = self.numbers.T.astype(np.int64)
        steps = np.diff(columns, axis=1, prepend=0) if self.is_delta else columns
        whole = np.ascontiguousarray((steps << 1) ^ (steps >> 63), "<u4")
        return whole.view(np.uint8).reshape(-1, 4).T.tobytes()


def _extent(values: FloatArray) -> float:
    """The largest extent along an axis. Column by column: quicker than rows of three."""
    return max(*(float(np.ptp(column)) for column in values.T), _TINY)


def _in_steps(values: FloatArray, steps: int) -> np.ndarray:
    """Coordinates in whole steps, of which the extent has so many, from their least ones."""
    low = np.array([column.min() for column in values.T])
    return np.rint((values - low) / _extent(values) * steps)


def _new_or_old(faces: IntArray) -> IntArray:
    """Vertex numbers that begin at 0 and are new one after the other: 0 for the next one, else how far back (m, 3)."""
    flat = faces.reshape(-1).astype(np.int64)
    known = np.maximum.accumulate(np.concatenate([[-1], flat[:-1]]))
    return (known + 1 - flat).reshape(-1, 3)


def _edges(faces: IntArray, patch: IntArray) -> np.ndarray:
    """Numbers (m,) whose bits say what the edges 01, 12, 20 of faces are: 1, 2, 4 seams, 8, 16, 32 ends of the surface."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1).astype(np.int64)
    keys = ends[:, 0] * (int(faces.max()) + 1) + ends[:, 1]
    order = np.argsort(keys, kind="stable")
    same = keys[order][1:] == keys[order][:-1]
    has_other = np.zeros(len(keys), bool)
    has_other[order[1:][same]] = has_other[order[:-1][same]] = True
    unlike = same & (patch[order[1:] // 3] != patch[order[:-1] // 3])
    is_seam = np.zeros(len(keys), bool)
    is_seam[order[1:][unlike]] = is_seam[order[:-1][unlike]] = True
    bits = np.array([1, 2, 4])
    return np.asarray(is_seam.reshape(-1, 3) @ bits + ~has_other.reshape(-1, 3) @ (8 * bits))


def _figures(result: Parameterization, ids: IntArray) -> tuple[FloatArray, FloatArray]:
    """Of faces: the mean angle error (m,), degrees, and log2 of the area's share in the map over that on the surface (m,)."""
    mesh, image = result.mesh, result.coordinates
    flat = np.pad(image, ((0, 0), (0, 3 - TARGETS.get(result.target).space.dimension)))
    totals = _area(mesh.vertices, mesh.faces), _area(flat, mesh.faces)
    shown = Mesh(mesh.vertices, mesh.faces[ids], mesh.name)
    surface, mapped = (face_areas(points, shown.faces) for points in (mesh.vertices, flat))
    errors = np.where(surface > 0.0, angle_errors(shown, image).mean(axis=1), 0.0)
    halves = log_area_ratios(surface, mapped, totals) / np.log(2.0)
    return errors, np.clip(np.nan_to_num(halves, posinf=0.0, neginf=-_MOST_HALVES), -_MOST_HALVES, _MOST_HALVES)
