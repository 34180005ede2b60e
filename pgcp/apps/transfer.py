"""Values carried from one surface to another through their conformal maps: ``pgcp transfer A B``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pgcp.apps.base import App, Call, Group, Made, folds_said, map_record, npz_file
from pgcp.apps.common.matching import MOEBIUS, SCALE, VALUES, Correspondence, alignment_line, matched, spread, vertex_areas
from pgcp.apps.common.pairs import add_pair, landmarks_now, landmarks_of, pair_of
from pgcp.apps.common.values import (
    carried_columns,
    checked,
    colours_in,
    first_field,
    flat_columns,
    mesh_with,
    of_input,
    own_values,
    place_colours,
)
from pgcp.errors import InputError
from pgcp.finish.shape import diagonal
from pgcp.io.text import as_lines
from pgcp.io.values import VALUE_FILES, read_values
from pgcp.plane.align import rigid_motion
from pgcp.report.chart import Scale
from pgcp.report.panels import SMALLER, as_png, in_rows, panel
from pgcp.report.raster import PIXELS
from pgcp.report.seen import FIELD, Seen, at_vertices, view_rotation
from pgcp.result import Result
from pgcp.surface.distortion import angle_errors
from pgcp.types import Columns, FloatArray, IntArray, Mesh


@dataclass(frozen=True, slots=True, eq=False)
class Transfer(Correspondence):
    """Two surfaces that correspond, with values carried both ways.

    a_values, b_values: what each surface has at its vertices, by name; on_b_values: values (V_b, ...) of the first surface at
    the vertices of the second; on_a_values: values (V_a, ...) of the second at those of the first.
    """

    a_values: Columns
    b_values: Columns
    on_b_values: Columns
    on_a_values: Columns

    def round_trip(self) -> dict[str, Any]:
        """How far what is carried to b and back to a is from where it was, over the vertices of a.

        "positions": distances of points, as shares of the diagonal of a; "values": differences of each value, as shares of the
        span of its values. Each has "mean", "p95" and "max".
        """
        points, used = self.a.mesh.vertices, np.unique(self.a.faces)
        away = np.linalg.norm(self.there_and_back(points) - points, axis=1)[used] / diagonal(self.a.mesh)
        fields = {}
        for name, values in flat_columns(self.a_values).items():
            span = float(np.ptp(values.astype(np.float64))) or 1.0
            back = carried_columns({name: values}, self.there_and_back)[name]
            fields[name] = spread(np.abs(back.astype(np.float64) - values)[used] / span)
        return {"positions": spread(away), "values": fields}


def transfer(
    a: Result,
    b: Result,
    *,
    values: Mapping[str, Any] | None = None,
    other_values: Mapping[str, Any] | None = None,
    align: str = SCALE,
    landmarks: Any = None,
    fit: str = MOEBIUS,
) -> Transfer:
    """Carry values between two surfaces that are mapped to the sphere, or to the disk.

    values: by name, (V_a, ...) at the vertices of the map a; other_values: (V_b, ...) at those of b. What the files of the
    meshes have at their vertices is carried too. align: "scale", the maps are turned until their scales are most alike, or
    "values", until the first of the values is; landmarks (n, 2), pairs of vertices, and fit are those of ``matching.matched``.

    Raises InputError where the maps go to different domains, or values and landmarks do not fit them.
    """
    own = [{**own_values(each), **_arrays(each, more)} for each, more in ((a, values), (b, other_values))]
    compared = None
    if align == VALUES:
        found = [first_field(_arrays(each, more)) for each, more in ((a, values), (b, other_values))]
        if found[0] is None or found[1] is None:
            raise InputError("to align by values, values of both surfaces are needed")
        compared = found[0][1], found[1][1]
    match = matched(a, b, align_by=align, values=compared, landmarks=landmarks, fit=fit)
    there, back = carried_columns(own[0], match.to_b), carried_columns(own[1], match.to_a)
    return Transfer(a, b, match.moebius, match.on_b, match.on_a, match.record, own[0], own[1], there, back)


def _arrays(result: Result, values: Mapping[str, Any] | None) -> dict[str, np.ndarray]:
    """Values as arrays; raises InputError where there is not one for every vertex, or one is no finite number."""
    return {name: checked(each, result, f"values {name!r}", most=2) for name, each in (values or {}).items()}


# Files and figures ------------------------------------------------------------------------------------------------------------


def _npz(name: str, done: Transfer) -> dict[str, bytes]:
    """All of it: places of the vertices of each surface on the other, and the values that were carried."""
    arrays: dict[str, Any] = {"moebius": done.moebius}
    for side, places, other, own in (("a", done.on_b, done.b, done.a), ("b", done.on_a, done.a, done.b)):
        arrays |= {
            f"{side}_faces": _faces_of(other, places.faces),
            f"{side}_corners": _vertices_of(other, other.faces[places.faces]),
            f"{side}_weights": places.weights,
            f"{side}_points": places.points,
            f"{side}_inside": places.inside,
            f"{side}_vertices": _vertices_of(own, np.arange(len(own.mesh.vertices))),
        }
    arrays |= {f"on_b_{key}": values for key, values in done.on_b_values.items()}
    arrays |= {f"on_a_{key}": values for key, values in done.on_a_values.items()}
    return npz_file(name, **arrays)


def _vertices_of(result: Result, ids: IntArray) -> IntArray:
    """Vertices of a map in the numbers of the input."""
    return ids if result.vertex_of is None else result.vertex_of[ids]


def _faces_of(result: Result, ids: IntArray) -> IntArray:
    """Faces of a map in the numbers of the input."""
    return ids if result.face_of is None else result.face_of[ids]


def _csv(name: str, done: Transfer) -> dict[str, bytes]:
    """A line for every vertex of a: where it lies on b, and the values of b there."""
    places, values = done.on_b, flat_columns(done.on_a_values)
    corners = _vertices_of(done.b, done.b.faces[places.faces])
    ids = _vertices_of(done.a, np.arange(len(corners)))
    head = ["vertex", "face", "corner_1", "corner_2", "corner_3", "weight_1", "weight_2", "weight_3", "x", "y", "z", "inside"]
    columns = [ids, _faces_of(done.b, places.faces), corners, places.weights, places.points, places.inside, *values.values()]
    rows = np.column_stack([np.asarray(column, np.float64) for column in columns])
    return {name: (",".join([*head, *values]) + "\n").encode() + as_lines(b"", np.ascontiguousarray(rows), b",")}


def _shown(columns: Columns, of_places: Columns) -> tuple[FloatArray, Scale | None, str]:
    """What is drawn: the first values that are no colours, else colours, else colours of places; a scale, and their name."""
    field = first_field(columns)
    if field is not None:
        low, high = (float(each) for each in np.quantile(field[1], [0.01, 0.99]))
        return field[1], Scale.between(low, high, FIELD, 7), field[0]
    colours = colours_in(columns)
    if colours is not None:
        return colours, None, "colours"
    found = colours_in(of_places)
    assert found is not None
    return found, None, "colours by place"


def _picture(name: str, done: Transfer) -> dict[str, bytes]:
    """Both surfaces, seen from corresponding sides, with the same values."""
    a, b = done.a, done.b
    places = place_colours(a.mesh.vertices)
    values, scale, called = _shown(done.a_values, places)
    there, _, _ = _shown(done.on_b_values, carried_columns(places, done.to_b))
    rotation = view_rotation(a.mesh.vertices, a.faces)
    motion, _ = rigid_motion(a.mesh.vertices, done.on_b.points, vertex_areas(a.mesh.vertices, a.faces))
    sides = (
        (a, rotation, values, f"{a.mesh.name}: {called}"),
        (b, rotation @ motion.T, there, f"{b.mesh.name}: carried there"),
    )
    pixels, panels = PIXELS if scale is None else SMALLER, []
    for one, turned, shown, caption in sides:
        drawn = Seen.of(one.mesh.vertices, one.faces, turned).drawn(at_vertices(one.faces, shown, scale), pixels)
        panels.append(panel(caption, drawn, scale))
    return {name: as_png(in_rows(panels, 2).reduce(2))}


def _record(done: Transfer) -> dict[str, Any]:
    """Figures of a transfer."""
    between = Mesh(done.a.mesh.vertices, done.a.faces)
    errors = angle_errors(between, done.on_b.points)
    outside = [int(np.count_nonzero(~places.inside)) for places in (done.on_b, done.on_a)]
    return {
        "a": map_record(done.a),
        "b": map_record(done.b),
        "alignment": done.record,
        "moebius": [[[entry.real, entry.imag] for entry in row] for row in done.moebius.tolist()],
        "angle_mean_deg": float(np.nanmean(errors)),
        "outside": {"of_a_on_b": outside[0], "of_b_on_a": outside[1]},
        "round_trip": done.round_trip(),
        "values": {"of_a_on_b": [*flat_columns(done.on_b_values)], "of_b_on_a": [*flat_columns(done.on_a_values)]},
    }


def _lines(record: Mapping[str, Any]) -> tuple[str, ...]:
    trip = record["round_trip"]
    out = [
        f"{each['name']}: {each['vertices']} vertices, mapped with a mean angle error of {each['angle_mean_deg']:.3g} degrees"
        for each in (record["a"], record["b"])
    ]
    out.append(alignment_line(record["alignment"]))
    for name, errors in (("positions", trip["positions"]), *trip["values"].items()):
        out.append(
            f"{name} there and back: mean {errors['mean']:.2%}, 95 % below {errors['p95']:.2%}, at most {errors['max']:.2%}"
        )
    return tuple(out)


def _run(call: Call) -> Made:
    pair = pair_of(call["a"], call["b"], call.options)
    landmarks = landmarks_of(call["landmarks"], pair, call["fit"])
    given = [
        read_values(path, count) if path else {}
        for path, count in zip((call["values"], call["values_b"]), pair.counts, strict=True)
    ]
    if call["align"] == VALUES and not all(given):
        raise InputError("to align by values, values of both surfaces are needed: --values and --values-b")
    a, b = pair.mapped(call)
    call.shown("align", 0, 0)
    done = transfer(
        a, b, values=of_input(a, given[0]), other_values=of_input(b, given[1]), align=call["align"],
        landmarks=landmarks_now(landmarks, (a, b)), fit=call["fit"],
    )  # fmt: skip
    record = _record(done)
    call.shown("align", 1, 1)
    on_b = done.on_b_values or carried_columns(place_colours(a.mesh.vertices), done.to_b)
    files = {
        ".npz": lambda name: _npz(name, done),
        ".csv": lambda name: _csv(name, done),
        "_b.ply": lambda name: mesh_with(name, b.mesh, on_b),
        ".png": lambda name: _picture(name, done),
    }
    if done.on_a_values:
        files["_a.ply"] = lambda name: mesh_with(name, a.mesh, done.on_a_values)
    return Made(files, record, _lines(record), folds_said(a) or folds_said(b))


def _ask(group: Group) -> None:
    add_pair(group)
    for option, which in (("--values", "first"), ("--values-b", "second")):
        group.add_argument(
            option, type=Path, metavar="FILE",
            help=f"values at the vertices of the {which} mesh, beside those of its own file: {VALUE_FILES}",
        )  # fmt: skip
    group.add_argument(
        "--align", choices=(SCALE, VALUES), default=SCALE,
        help="what is to be alike once the maps are turned: their scale, or the first of the values of both; default scale",
    )  # fmt: skip


APP = App(
    name="transfer",
    summary="which point of one surface corresponds to which of another, and values carried between them",
    writes={
        ".npz": "places of the vertices of each surface on the other, and the values that were carried",
        ".csv": "a line for every vertex of the first: where it lies on the second, and the values of the second there",
        "_b.ply": "the second mesh with the values of the first",
        "_a.ply": "the first mesh with the values of the second, where that has values",
        ".png": "both surfaces with the same values",
    },
    arguments=_ask,
    run=_run,
    reference="Baden, Crane, Kazhdan, Moebius Registration, Computer Graphics Forum 37(5), 2018",
)
