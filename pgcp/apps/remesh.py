"""Mesh a surface anew through its map: triangles of one size on the surface, or quads of a lattice (PGCP 5.7.2)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from pgcp.apps.base import App, Call, Group, Made, add_mesh, map_record, number, whole_number
from pgcp.apps.common.joined import joined
from pgcp.apps.common.values import carried, carried_columns, own_colours
from pgcp.errors import FoldError, InputError, NumericalError
from pgcp.finish.lattice import quads_of_plane, quads_of_sphere
from pgcp.finish.resample import Resampled, Sheet, resampled
from pgcp.finish.shape import diagonal, hausdorff_distance, shape_record
from pgcp.finish.unit_square import upright_angle
from pgcp.io.formats import VERTICES, writable
from pgcp.io.given import GivenParts
from pgcp.io.write import mesh_files
from pgcp.options import AUTO
from pgcp.plane.curves import crosses_itself
from pgcp.plane.space import PLANE
from pgcp.polygons.triangulate import triangulated
from pgcp.report.chart import Scale
from pgcp.report.panels import SMALLER, as_png, panel, sheet
from pgcp.report.record import fold_message
from pgcp.report.seen import HEAT, Seen, on_faces, view_rotation
from pgcp.surface.topology import examine
from pgcp.targets.registry import TARGETS
from pgcp.types import BoolArray, Columns, FloatArray, IntArray, Mesh, Source

if TYPE_CHECKING:
    from pgcp.result import Result

_MOST, _LEAST = 2_000_000, 12  # vertices
_TRIES, _NEAR = 4, 0.03  # times that squares are made of another size, for a number of vertices that is so near
_PICTURE = "_remesh.png"
_MAGNIFIED = 24.0  # edges across the magnified panels
_FORMATS = tuple(kind for kind in writable() if VERTICES in kind.carries)


@dataclass(frozen=True, slots=True, eq=False)
class Remeshed:
    """A surface that was meshed anew.

    mesh: the new one, quads cut into triangles; source: the same with its quads, and the input's colours where it has some;
    corner_of (F, 3): which corner of the source each corner of a face is. places: where on the input's surface vertices lie.
    image (N, 2) or (N, 3): where they lie in the map. spacing: the edge length that was aimed at.
    """

    mesh: Mesh
    source: Source
    corner_of: IntArray
    image: FloatArray
    spacing: float

    @property
    def edges(self) -> BoolArray:
        """Whether the edge opposite to each corner of the mesh's faces (F, 3) is one of the polygons."""
        if self.source.offsets is None:
            return np.ones(self.corner_of.shape, bool)
        size = np.diff(self.source.offsets)[np.searchsorted(self.source.offsets, self.corner_of[:, :1], "right") - 1]
        apart = np.abs(np.roll(self.corner_of, -1, axis=1) - np.roll(self.corner_of, -2, axis=1))
        return np.asarray((apart == 1) | (apart == size - 1))

    def files(self, name: str) -> dict[str, bytes]:
        """Contents of the mesh's file of this name, and of those beside it, by name."""
        given = GivenParts(self.source, np.arange(len(self.mesh.vertices)), self.corner_of, self.mesh.faces)
        return mesh_files(name, self.mesh, given=given)


def remesh(
    result: Result, edge: float | None = None, vertices: int | None = None, quads: bool = False, seed: int = 0
) -> Remeshed:
    """Mesh the surface of a finished map anew, with vertices evenly over it (PGCP 5.7.2).

    edge: length of edges on the surface; vertices: how many there are to be; as many as before where neither is said. quads:
    squares of a regular lattice in the map, with triangles along the boundary: their edges have that length in the middle of
    the surface's area, and are as much longer or shorter elsewhere as the map shrinks or stretches. seed: of the samples.
    The new mesh is oriented as the old one and a disk or a sphere as it; its vertices lie on the old faces, those of the
    boundary on the old boundary, corners kept.

    Raises InputError where both or impossible sizes are given, or the surface is not one disk or sphere; FoldError where the
    map has folds; NumericalError where it overlaps itself, or the points give no such mesh.
    """
    if edge is not None and vertices is not None:
        raise InputError("edge and vertices both say how fine the mesh is to be; give one of them")
    sheet = _sheet(result)
    spacing = _spacing(result.mesh, sheet, edge, vertices, quads)
    counted = len(sheet.vertices) if vertices is None and edge is None else vertices
    if quads:
        made, source, spacing = _with_quads(result, sheet, spacing, counted, seed)
    else:
        made = resampled(sheet, spacing, counted, seed)
        source = Source(made.points, made.faces.reshape(-1))
    source = Source(source.vertices, source.corners, source.offsets, of_vertices=_colours(result, made.image), name="remeshed")
    cut = triangulated(source)
    corner_of = np.arange(cut.mesh.faces.size).reshape(-1, 3) if cut.corner_of is None else cut.corner_of
    return Remeshed(cut.mesh, source, corner_of, made.image, spacing)


def _sheet(result: Result) -> Sheet:
    """The surface of a map without folds and overlaps, vertices that seams split joined."""
    if result.quality.folds:
        raise FoldError(fold_message(result), result)
    space = TARGETS.get(result.target).space
    surface = joined(result)
    topology = examine(surface.faces, len(surface.vertices))
    if not topology.fits(space.closed):
        raise InputError(f"{result.mesh.name} is {topology.describe()}; one surface without holes can be remeshed")
    sheet = Sheet(surface.vertices, surface.faces, surface.image, space)
    if sheet.rim is not None and crosses_itself(PLANE.positions(sheet.rim.image)):
        raise NumericalError("the map overlaps itself; --no-overlap, or --target disk, gives one that does not")
    return sheet


def _spacing(mesh: Mesh, sheet: Sheet, edge: float | None, vertices: int | None, quads: bool) -> float:
    """The edge length that is asked for, on the surface; raises InputError where it or the number of vertices is impossible."""
    length = diagonal(Mesh(sheet.vertices, sheet.faces))
    if edge is not None:
        if not np.isfinite(edge) or edge <= 0.0:
            raise InputError(f"the edge length is {edge}; it must be a number above 0")
        if edge > length:
            raise InputError(f"the edge length {edge:g} is longer than {mesh.name}, whose diagonal is {length:.4g}")
        if sheet.count_for(edge) > _MOST:
            raise InputError(f"edges of length {edge:g} make {sheet.count_for(edge):,} vertices; at most {_MOST:,} are made")
        return edge
    wanted = len(sheet.vertices) if vertices is None else vertices
    if vertices is not None and not _LEAST <= vertices <= _MOST:
        raise InputError(f"{vertices:,} vertices are asked for; from {_LEAST} to {_MOST:,} are made")
    if quads:
        return float(np.sqrt(sheet.areas.sum() / max(wanted, 6)))
    return sheet.spacing_for(max(wanted, _LEAST))


def _with_quads(
    result: Result, sheet: Sheet, spacing: float, vertices: int | None, seed: int
) -> tuple[Resampled, Source, float]:
    """The mesh of a lattice, the same with quads, and the side that squares were to have.

    Where the number of vertices is asked for, the side is corrected by how many there are, up to four times.
    """
    angle = 0.0 if sheet.rim is None else upright_angle(Mesh(sheet.vertices, sheet.faces), sheet.image)[0]
    for again in range(_TRIES, -1, -1):
        if sheet.rim is None:
            made, source = quads_of_sphere(sheet, spacing, seed)
        else:
            made, source = quads_of_plane(sheet, spacing, angle, seed)
        count = len(made.points)
        if vertices is None or not again or abs(count - vertices) <= _NEAR * vertices:
            break
        spacing *= float(np.sqrt(count / vertices))
    return made, source, spacing


def _colours(result: Result, image: FloatArray) -> Columns:
    """Colours of the input at places of the map, in the type that they have there; none where it has none."""
    own = own_colours(result)
    if not own or not len(image):
        return {}
    places = result.inverse(image)
    return carried_columns(own, lambda values: carried(values, result.faces, places))


def record_of(before: Mesh, made: Remeshed) -> dict[str, Any]:
    """Figures of both meshes, and how far they are apart: sampled as ``pgcp.finish.shape.hausdorff_distance`` says."""
    one, two = hausdorff_distance(before, made.mesh)
    length = diagonal(before)
    offsets = made.source.offsets
    sizes = np.full(len(made.mesh.faces), 3) if offsets is None else np.diff(offsets)
    return {
        "edge": made.spacing,
        "before": shape_record(before),
        "after": shape_record(made.mesh),
        "quads": int((sizes == 4).sum()),
        "triangles": int((sizes == 3).sum()),
        "from_before": one,
        "from_after": two,
        "hausdorff": max(one, two),
        "hausdorff_of_diagonal": max(one, two) / length if length > 0.0 else 0.0,
    }


def _said(record: dict[str, Any]) -> tuple[str, ...]:
    """What the user is told."""
    before, after = record["before"], record["after"]
    kinds = (
        f"{record['quads']:,} quads and {record['triangles']:,} triangles"
        if record["quads"]
        else f"{after['faces']:,} triangles"
    )
    return (
        f"{after['vertices']:,} vertices, {kinds}, before {before['vertices']:,} and {before['faces']:,}",
        f"smallest angle of a triangle: median {after['min_angle_median_deg']:.1f}, least {after['min_angle_least_deg']:.1f} "
        f"degrees, before {before['min_angle_median_deg']:.1f} and {before['min_angle_least_deg']:.1f}",
        f"edges: mean {after['edge_mean']:.4g}, variation {after['edge_variation']:.3f}, before {before['edge_mean']:.4g} and "
        f"{before['edge_variation']:.3f}",
        f"farthest from the input's surface: {record['hausdorff']:.3g}, {100.0 * record['hausdorff_of_diagonal']:.3f} % of its "
        "diagonal (sampled)",
    )


def drawn(before: Mesh, made: Remeshed) -> bytes:
    """PNG bytes: both meshes in colours of the smallest angles of faces, whole and magnified."""
    from pgcp.surface.distortion import corner_angles

    scale = Scale.between(0.0, 60.0, HEAT[::-1])
    rotation = view_rotation(before.vertices, before.faces)
    centre = _in_front(before, rotation)
    rows: list[list[Any]] = [[], []]
    for name, mesh, edges in (("before", before, None), ("after", made.mesh, made.edges)):
        paint = on_faces(np.degrees(corner_angles(mesh.vertices, mesh.faces).min(axis=1)), scale)
        whole = Seen.of(mesh.vertices, mesh.faces, rotation)
        near = whole.window(centre, _MAGNIFIED * made.spacing)
        caption = f"{name}: {len(np.unique(mesh.faces)):,} vertices, {len(mesh.faces):,} triangles"
        rows[0].append(panel(caption, whole.drawn(paint)))
        words = "magnified; colours: smallest angle of each triangle (degrees)"
        rows[1].append(panel(words, near.drawn(near.with_edges(paint, edges), SMALLER), scale))
    return as_png(sheet(before.name, [*rows[0], *rows[1]], 2))


def _in_front(mesh: Mesh, rotation: FloatArray) -> FloatArray:
    """The middle (3,) of the surface as it is seen."""
    middles = mesh.vertices[mesh.faces].mean(axis=1) @ rotation.T
    low, high = middles[:, :2].min(axis=0), middles[:, :2].max(axis=0)
    away = np.linalg.norm(middles[:, :2] - 0.5 * (low + high), axis=1) / max(float((high - low).max()), 1e-300)
    near = np.flatnonzero(away <= max(0.05, float(away.min())))
    return np.asarray(middles[near[int(np.argmax(middles[near, 2]))]] @ rotation)


def _arguments(group: Group) -> None:
    add_mesh(group)
    group.add_argument("--edge", type=number, metavar="L", help="length of edges on the surface, in the mesh's unit")
    group.add_argument(
        "--vertices",
        type=whole_number,
        metavar="N",
        help="how many vertices the new mesh is to have (default: as many as before)",
    )
    group.add_argument(
        "--quads",
        action="store_true",
        help="squares of a lattice in the map, with triangles along the boundary and where sizes change",
    )


def _run(call: Call) -> Made:
    edge, vertices = call["edge"], call["vertices"]
    if edge is not None and vertices is not None:
        raise InputError("--edge and --vertices both say how fine the mesh is to be; give one of them")
    if edge is not None and (not np.isfinite(edge) or edge <= 0.0):
        raise InputError(f"--edge is {edge}; it must be a number above 0")
    if vertices is not None and not _LEAST <= vertices <= _MOST:
        raise InputError(f"--vertices is {vertices}; from {_LEAST} to {_MOST:,} are made")
    asked = call.options.target
    free = asked == AUTO or TARGETS.get(asked).has_free_boundary
    result = call.mapped(call["mesh"], no_overlap=call.options.no_overlap or free)
    call.shown("remesh", 0, 0)
    made = remesh(result, edge, vertices, call["quads"], call.options.seed)
    record = record_of(result.mesh, made)
    call.shown("remesh", 1, 1)
    files: dict[str, Any] = {kind.suffixes[0]: made.files for kind in _FORMATS}
    files[_PICTURE] = partial(_picture, result.mesh, made)
    return Made(files, {"map": map_record(result), **record}, _said(record))


def _picture(before: Mesh, made: Remeshed, name: str) -> dict[str, bytes]:
    """The picture's file."""
    return {name: drawn(before, made)}


APP = App(
    name="remesh",
    summary="a surface meshed anew through its map: triangles of one size on the surface, or quads",
    writes={
        **{kind.suffixes[0]: f"the new mesh, as {kind.suffixes[0]}" for kind in _FORMATS},
        _PICTURE: "both meshes, whole and magnified, in colours of the smallest angles",
    },
    arguments=_arguments,
    run=_run,
    usual=(".obj", ".ply", _PICTURE),
    reference="Choi, Leung-Liu, Gu, Lui (2020), section 5.7.2; points by Du, Faber, Gunzburger (1999)",
)
