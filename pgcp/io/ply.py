"""PLY files: ascii, and binary of either byte order. The header is not believed before the data are seen to be there."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pgcp.errors import BadFileError
from pgcp.io.formats import Beside, Format, register
from pgcp.io.ply_header import Element, Property, header_of, place_of
from pgcp.io.ply_lists import Lists, whole_corners
from pgcp.io.ply_write import WRITTEN, write_ply
from pgcp.io.strips import triangles_of_strips
from pgcp.io.text import RowReader, as_text, joined, not_a_number, parse, ragged, shown, table, widths
from pgcp.types import FloatArray, IntArray, Source

_XYZ = ("x", "y", "z")


def read_ply(data: bytes, _beside: Beside) -> tuple[FloatArray, IntArray] | Source:
    """Vertices and polygons of a PLY file, with their properties; raises BadFileError saying what is wrong and where."""
    order, elements, start, lines = header_of(data)
    by_name = {element.name: element for element in elements}
    surface = "tristrips" if by_name.keys() >= {"tristrips"} and "face" not in by_name else "face"
    for name in ("vertex", surface):
        if name not in by_name:
            raise BadFileError(f"the PLY has no {name} element, so no surface")
    lists = [p.name for p in by_name[surface].properties if p.count_kind]
    wanted = next((name for name in ("vertex_indices", "vertex_index") if name in lists), None)
    if wanted is None:
        raise BadFileError(f"the PLY's {surface} element has no list vertex_indices")
    scalars = [p.name for p in by_name["vertex"].properties if not p.count_kind]
    if not {"x", "y", "z"} <= set(scalars):
        raise BadFileError("the PLY's vertices have no x, y, z")
    if len(scalars) < len(by_name["vertex"].properties):
        raise BadFileError("the PLY's vertices have a list property, which is not supported")
    if order:
        held = _read_binary(data, start, elements, order, (surface, wanted))
    else:
        held = _read_ascii(as_text(data[start:]), lines + 1, elements, (surface, wanted))
    return held.strips() if surface == "tristrips" else held.source()


@dataclass(slots=True)
class _Held:
    """What the elements of a file hold; corners (C,) of all faces, and sizes (P,) their numbers."""

    vertices: FloatArray | None = None
    of_vertices: dict[str, np.ndarray] = field(default_factory=dict)
    corners: IntArray | None = None
    sizes: IntArray | None = None
    of_polygons: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def is_whole(self) -> bool:
        """Whether vertices and faces are there."""
        return self.vertices is not None and self.corners is not None

    def source(self) -> tuple[FloatArray, IntArray] | Source:
        """The surface."""
        assert self.vertices is not None
        assert self.corners is not None
        assert self.sizes is not None
        offsets = None if (self.sizes == 3).all() else np.append(0, np.cumsum(self.sizes, dtype=np.int64))
        by_vertex, by_polygon = _finite(self.of_vertices), _finite(self.of_polygons)
        if offsets is None and not by_vertex and not by_polygon:
            return self.vertices, self.corners.reshape(-1, 3)
        return Source(self.vertices, self.corners, offsets, of_vertices=by_vertex, of_polygons=by_polygon)

    def strips(self) -> tuple[FloatArray, IntArray]:
        """The surface, where faces are strips of triangles."""
        assert self.vertices is not None
        assert self.corners is not None
        assert self.sizes is not None
        return self.vertices, triangles_of_strips(self.corners, self.sizes)


def _finite(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns without those that hold something else than finite numbers."""
    return {name: values for name, values in columns.items() if np.isfinite(values).all()}


def _read_binary(data: bytes, start: int, elements: list[Element], order: str, surface: tuple[str, str]) -> _Held:
    held = _Held()
    for element in elements:
        least = element.count * element.least_bytes
        if least > len(data) - start:
            raise BadFileError(
                f"the header promises {element.count} of the element {element.name}, at least {least} bytes, "
                f"but only {len(data) - start} bytes follow"
            )
        if element.has_lists:
            rows = Lists(data, start, element, order, surface[1] if element.name == surface[0] else "")
            start = rows.read()
            if element.name == surface[0]:
                held.corners, held.sizes, held.of_polygons = rows.held()
        else:
            kinds = [(f"p{i}", order + p.kind) for i, p in enumerate(element.properties)]
            found = np.frombuffer(data, kinds, element.count, start) if element.count else np.empty(0, kinds)
            start += found.nbytes
            if element.name == "vertex":
                held.vertices = np.empty((element.count, 3))
                for axis, name in enumerate("xyz"):
                    held.vertices[:, axis] = found[f"p{place_of(element, name)}"]
                held.of_vertices = {
                    p.name: found[f"p{i}"].astype(p.kind) for i, p in enumerate(element.properties) if p.name not in _XYZ
                }
        if held.is_whole:
            return held
    raise BadFileError("the PLY has no vertices or no faces")


def _read_ascii(text: bytes, first_line: int, elements: list[Element], surface: tuple[str, str]) -> _Held:
    reader, held = RowReader(text, first_line), _Held()
    for element in elements:
        if 2 * element.count * len(element.properties) > len(text) + 1:
            raise BadFileError(
                f"the header promises {element.count} of the element {element.name}, "
                f"which do not fit into the {len(text)} bytes that follow"
            )
        what = f"rows of the element {element.name}"
        if element.name == surface[0]:
            _ascii_faces(reader, element, surface[1], held)
        elif element.name == "vertex":
            parts = [
                table(numbers, rows, len(element.properties), "vertex", exact=True)
                for numbers, rows in reader.take(element.count, what)
            ]
            values = joined(parts, (0, len(element.properties)), np.float64)
            held.vertices = np.ascontiguousarray(values[:, [place_of(element, name) for name in "xyz"]])
            held.of_vertices = {p.name: _typed(values[:, i], p) for i, p in enumerate(element.properties) if p.name not in _XYZ}
        else:
            for _ in reader.take(element.count, what):
                pass
        if held.is_whole:
            return held
    raise BadFileError("the PLY has no vertices or no faces")


def _typed(values: FloatArray, kept: Property) -> np.ndarray:
    """Values in the type of a property; as they are where they do not fit."""
    kind = np.dtype(kept.kind)
    if kind.kind in "iu":
        ends = np.iinfo(kind)
        fits = np.isfinite(values).all() and (not len(values) or (values.min() >= ends.min and values.max() <= ends.max))
        return values.astype(kind) if fits else values
    with np.errstate(over="ignore"):
        return values.astype(kind)


def _ascii_faces(reader: RowReader, element: Element, wanted: str, held: _Held) -> None:
    place = place_of(element, wanted)
    sizes, corners = list[IntArray](), list[FloatArray]()
    others: dict[int, list[FloatArray]] = {i: [] for i, p in enumerate(element.properties) if not p.count_kind}
    for numbers, rows in reader.take(element.count, "faces"):
        counts = widths(rows)
        flat = parse(rows)
        if flat is None or len(flat) != sum(counts):
            raise not_a_number(numbers, rows, "face")
        starts = np.cumsum(counts) - counts
        at = np.zeros(len(rows), np.int64)
        for i, p in enumerate(element.properties):
            _within(at < counts, numbers, rows)
            if p.count_kind:
                length = flat[starts + at]
                fits = (length >= 0) & (length == np.floor(length)) & (length < counts - at)
                _within(fits, numbers, rows)
                many = length.astype(np.int64)
                if i == place:
                    sizes.append(many)
                    corners.append(flat[ragged(np.asarray(starts + at + 1, np.int64), many)])
                at += many
            else:
                others[i].append(flat[starts + at])
            at += 1
        _within(at == counts, numbers, rows)
    held.sizes = joined(sizes, (0,), np.int64)
    values: FloatArray = joined(corners, (0,), np.float64)
    held.corners = whole_corners(values, 0, [held.sizes])
    held.of_polygons = {
        element.properties[i].name: _typed(joined(parts, (0,), np.float64), element.properties[i])
        for i, parts in others.items()
    }


def _within(fits: np.ndarray, numbers: object, rows: list[bytes]) -> None:
    if not fits.all():
        bad = int(np.argmin(fits))
        raise BadFileError(
            f"line {numbers[bad]}: the face's lists and numbers do not fill its line: {shown(rows[bad].strip())}"  # type: ignore[index]
        )


register(
    Format(
        name="ply",
        suffixes=(".ply",),
        summary="read in ascii and binary; written in binary on the same polygons, the map as s, t or sx, sy, sz",
        read=read_ply,
        write=write_ply,
        carries=(*WRITTEN, "given"),
        looks=(rb"ply[ \t]*[\r\n]", "PLY"),
    )
)
