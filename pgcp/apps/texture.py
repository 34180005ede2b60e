"""Put a texture on a surface through its map: a picture, a checkerboard, or the colours of a scan's vertices (PGCP 5.7.1)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pgcp.apps.base import App, Call, Group, Made, add_mesh, folds_said, map_record, number, whole_number
from pgcp.apps.common.values import colours_in, own_values
from pgcp.errors import InputError
from pgcp.finish.texels import TexelDensity, at_places, edges_in_texels, heights_in_texels, texel_density, within_square
from pgcp.io.given import COLOURS
from pgcp.io.write import map_files
from pgcp.report.chart import Axis, Scale
from pgcp.report.panels import SMALLER, as_png, panel, sheet
from pgcp.report.raster import View, texels
from pgcp.report.seen import COLD_WARM, Seen, on_faces, view_rotation
from pgcp.report.texture import CHECKER, as_picture, board
from pgcp.targets.registry import TARGETS
from pgcp.types import FloatArray, IntArray, Layout

if TYPE_CHECKING:
    from pgcp.result import Result

_LEAST, _MOST, _USUAL, _BAKED = 16, 16_384, 1024, 4096  # texels along a texture
_BLOCK = 4  # of texels: sizes that are computed are multiples
_CHUNK = 1 << 20  # texels at once
_RESOLVED, _SHARE = 2.0, 0.95  # texels that an edge is to have where colours are baked, and how many edges
_SQUARES = 32  # about so many across
_PICTURE, _DENSITY = "_texture.png", "_density.png"


@dataclass(frozen=True, eq=False)
class Textured:
    """A surface with a texture: the finished map, its texture coordinates and the picture (height, width, 3) uint8."""

    result: Result
    layout: Layout
    image: np.ndarray

    @cached_property
    def density(self) -> TexelDensity:
        """Texels per unit of length of every face."""
        return texel_density(self.result.mesh, self.layout, self.image.shape[1], self.image.shape[0])

    @cached_property
    def png(self) -> bytes:
        """The picture as PNG."""
        from PIL import Image

        return as_png(Image.fromarray(self.image))

    def files(self, name: str) -> dict[str, bytes]:
        """Contents of the OBJ or GLB file of this name, and of those beside it, by name; without colours of vertices."""
        return map_files(name, _uncoloured(self.result), self.layout, self.png)


def size_for(result: Result, texels_per_unit: float, share: float = 0.5) -> tuple[int, int]:
    """Width and height of the smallest texture that gives so many texels to a unit of length, or more, on a share of the area.

    Sizes are multiples of 4. Raises InputError where it would be larger than 16384 texels.
    """
    if not np.isfinite(texels_per_unit) or texels_per_unit <= 0.0:
        raise InputError(f"{texels_per_unit} texels per unit; it must be a number above 0")
    if not 0.0 < share <= 1.0:
        raise InputError(f"the share of the area is {share}; it must be above 0 and at most 1")
    met = texel_density(result.mesh, _layout(result), 1.0, _aspect(result)).met_by(share)
    needed = texels_per_unit / met if met > 0.0 else np.inf
    if needed > _MOST:
        raise InputError(
            f"{texels_per_unit:g} texels per unit on {100 * share:g} % of the surface need a texture of {needed:,.0f} texels; "
            f"the largest has {_MOST:,}"
        )
    return _size(result, max(-(-int(np.ceil(needed)) // _BLOCK) * _BLOCK, _LEAST))


def textured(
    result: Result, picture: Any = CHECKER, size: tuple[int, int] | None = None, square: float | None = None
) -> Textured:
    """A surface with a picture, which covers the square [0, 1]^2 of the layout ``unit``.

    picture: a path, an array (height, width, 3) uint8, a Pillow image, or "checker"; size: width and height that it is resized
    to, its own where none is said. square: side of the checkerboard's squares on the surface, where the map has its middle
    density; about 32 across where none is said. Raises InputError where there is no picture.
    """
    layout = _layout(result)
    if isinstance(picture, (str, Path)) and str(picture) == CHECKER:
        width, height = _size(result, _USUAL) if size is None else size
        side = square_of(result, width, height) if square is None else square
        if not np.isfinite(side) or side <= 0.0:
            raise InputError(f"the checkerboard's squares have a side of {side}; it must be a number above 0")
        median = texel_density(result.mesh, layout, width, height).met_by(0.5)
        return Textured(result, layout, np.asarray(board(width, height, max(side * median, 1e-3))))
    given = as_picture(picture)
    if size is not None and given.size != size:
        from PIL import Image

        given = given.resize(size, Image.Resampling.LANCZOS)
    return Textured(result, layout, np.asarray(given))


def square_of(result: Result, width: int, height: int) -> float:
    """A round length (1, 2 or 5 times a power of ten) for squares of a checkerboard, about 32 across the texture."""
    median = texel_density(result.mesh, _layout(result), width, height).met_by(0.5)
    about = width / _SQUARES / max(median, 1e-300)
    power = 10.0 ** np.floor(np.log10(about))
    return float(power * min((1.0, 2.0, 5.0, 10.0), key=lambda m: abs(np.log(m * power / about))))


def baked(result: Result, size: tuple[int, int] | None = None, colours: FloatArray | None = None) -> Textured:
    """The colours of the surface's vertices as a texture: every texel has that of its place on the surface.

    size: width and height; where none is said, 95 % of the edges have two texels or more, up to 4096 for all. colours (V, 3)
    from 0 to 1; those of the input where none are given. Texels that no face covers have the colour of the nearest that has
    one: nothing else shows at the boundary, in smaller copies of the texture neither. Raises InputError where the input has no
    colours at its vertices.
    """
    from scipy.ndimage import distance_transform_edt

    colours = colours_of(result) if colours is None else np.asarray(colours, np.float64)
    layout = _layout(result)
    width, height = _baked_size(result) if size is None else size
    points, faces, face_of = within_square(layout)
    place, found, weights = texels(points, faces.astype(np.int32), width, height)
    image, covered = np.zeros((height * width, 3), np.uint8), np.zeros(height * width, bool)
    for start in range(0, len(place), _CHUNK):
        some = slice(start, start + _CHUNK)
        mixed = np.einsum("mk,mkd->md", weights[some], colours[result.faces[face_of[found[some]]]])
        image[place[some]] = (255.0 * np.clip(mixed, 0.0, 1.0) + 0.5).astype(np.uint8)
    covered[place] = True
    nearest = distance_transform_edt(~covered.reshape(height, width), return_distances=False, return_indices=True)
    return Textured(result, layout, image.reshape(height, width, 3)[nearest[0], nearest[1]])


def colours_of(result: Result) -> FloatArray:
    """Colours (V, 3) from 0 to 1 that the input has at its vertices; raises InputError where it has none."""
    found = colours_in(own_values(result))
    if found is None:
        raise InputError(f"{result.mesh.name} has no colours at its vertices that could be baked into a texture")
    return found


def baked_error(made: Textured, colours: FloatArray) -> dict[str, float]:
    """How far the texture at the vertices is from their colours (V, 3), in steps of 1/255: mean, 99 % and largest.

    The texture is read between texels linearly, as viewers do. Where vertices lie closer than texels, it cannot have them all:
    ``largest_with_room`` is of vertices around which all faces are two texels high, which are a ``share_with_room`` of all.
    """
    used = np.unique(made.result.faces)
    shown = at_places(made.image, made.layout.points[: len(colours)][used])
    apart = np.abs(shown - 255.0 * colours[used]).max(axis=1)
    room = np.full(len(colours), np.inf)
    heights = heights_in_texels(made.layout, made.image.shape[1], made.image.shape[0])
    np.minimum.at(room, made.result.faces, heights[:, None])
    resolved = room[used] >= _RESOLVED
    return {
        "mean": float(apart.mean()),
        "of_99_percent": float(np.quantile(apart, 0.99)),
        "largest": float(apart.max()),
        "share_with_room": float(resolved.mean()),
        "largest_with_room": float(apart[resolved].max()) if resolved.any() else 0.0,
    }


def _layout(result: Result) -> Layout:
    layout = result.layout("unit")
    assert layout is not None
    return layout


def _aspect(result: Result) -> float:
    """Height over width of a texture on which squares are squares: 1, of the longitudes and latitudes of one sphere 1/2."""
    several = result.origin is not None and result.origin.component_of is not None
    return 0.5 if TARGETS.get(result.target).space.closed and not several else 1.0


def _size(result: Result, width: int) -> tuple[int, int]:
    return width, max(round(width * _aspect(result)), 1)


def _baked_size(result: Result) -> tuple[int, int]:
    """Width and height at which 95 % of the edges have two texels or more, from 256 to 4096."""
    sides = edges_in_texels(_layout(result), 1.0, _aspect(result))
    needed = min(_RESOLVED / max(float(np.quantile(sides, 1.0 - _SHARE)), 1e-300), _BAKED)
    return _size(result, max(-(-int(np.ceil(needed)) // _BLOCK) * _BLOCK, 256))


def _uncoloured(result: Result) -> Result:
    """The same without the input's colours of vertices, which viewers would multiply the texture with."""
    origin = result.origin
    if origin is None or origin.source is None:
        return result
    kept = {name: values for name, values in origin.source.of_vertices.items() if name not in (*COLOURS, "alpha")}
    return replace(result, origin=replace(origin, source=replace(origin.source, of_vertices=kept)))


def drawn(made: Textured) -> bytes:
    """PNG bytes: the surface with its texture, and the density of texels on the surface and on the texture."""
    mesh, layout, density = made.result.mesh, made.layout, made.density
    median = max(density.met_by(0.5), 1e-300)
    order = np.log2(np.maximum(density.mean, 1e-300) / median)
    limit = int(np.clip(np.ceil(np.quantile(np.abs(order[density.areas > 0.0]), 0.95)), 1, 30))
    powers = range(-limit, limit + 1, -(-limit // 3))
    scale = Scale(Axis(-limit, limit, [float(k) for k in powers], [f"{median * 2.0**k:.3g}" for k in powers], []), COLD_WARM)
    seen, dense = Seen.of(mesh.vertices, mesh.faces, view_rotation(mesh.vertices, mesh.faces)), on_faces(order, scale)

    def picture(face_ids: IntArray, weights: FloatArray) -> np.ndarray:
        """The texture."""
        places = np.einsum("mk,mkd->md", weights, layout.points[layout.faces[face_ids]])
        return at_places(made.image, places) / 255.0

    height, width = made.image.shape[:2]
    points, faces, face_of = within_square(layout)
    flat = np.pad(points * np.array([1.0, height / width]), ((0, 0), (0, 1)))
    whole = View(flat, faces.astype(np.int32), np.eye(3), np.array([[0.0, 0.0, 0.0], [1.0, height / width, 0.0]]))
    panels = [
        panel(f"the surface with its texture of {width} x {height} texels", seen.drawn(picture)),
        panel("texels per unit of length, on the surface", seen.drawn(dense, SMALLER), scale),
        panel("the same on the texture", Seen(whole).drawn(on_faces(order[face_of], scale), SMALLER), scale),
    ]
    return as_png(sheet(mesh.name, panels))


def _arguments(group: Group) -> None:
    add_mesh(group)
    group.add_argument("image", type=Path, nargs="?", help="picture that covers the texture (default: a checkerboard)")
    group.add_argument(
        "--texels-per-unit", type=number, metavar="D", help="texels for a unit of length on the surface: sets the size"
    )
    group.add_argument(
        "--share", type=number, default=0.5, metavar="S",
        help="share of the surface's area that gets so many texels or more (default 0.5; 1: all)",
    )  # fmt: skip
    group.add_argument(
        "--size",
        type=whole_number,
        metavar="N",
        help="width of the texture in texels, its height too but for a sphere (half of it)",
    )
    group.add_argument(
        "--square", type=number, metavar="L", help="side of the checkerboard's squares on the surface, at the middle density"
    )
    group.add_argument("--bake", action="store_true", help="make the texture from the colours of the mesh's vertices")


def _check(call: Call) -> None:
    """Raise InputError where what is asked for is impossible or does not go together, before anything is mapped."""
    size, per_unit, square, image = call["size"], call["texels_per_unit"], call["square"], call["image"]
    if size is not None and per_unit is not None:
        raise InputError("--size and --texels-per-unit both say how large the texture is to be; give one of them")
    if size is not None and not _LEAST <= size <= _MOST:
        raise InputError(f"--size is {size}; from {_LEAST} to {_MOST} texels are made")
    for name, value in (("--texels-per-unit", per_unit), ("--square", square)):
        if value is not None and not (np.isfinite(value) and value > 0.0):
            raise InputError(f"{name} is {value}; it must be a number above 0")
    if not 0.0 < call["share"] <= 1.0:
        raise InputError(f"--share is {call['share']}; it must be above 0 and at most 1")
    if call["bake"] and image is not None:
        raise InputError(f"--bake makes the texture from the mesh's colours, and {image} would be another one")
    if square is not None and (call["bake"] or (image is not None and str(image) != CHECKER)):
        raise InputError("--square is for the checkerboard, which is not asked for")
    if image is not None and str(image) != CHECKER:
        as_picture(image)


def _made(call: Call, result: Result) -> tuple[Textured, dict[str, Any], list[str]]:
    """The textured surface that is asked for, with figures and lines of its own."""
    size = None if call["size"] is None else _size(result, call["size"])
    if call["texels_per_unit"] is not None:
        size = size_for(result, call["texels_per_unit"], call["share"])
    if call["bake"]:
        colours = colours_of(result)
        made = baked(result, size, colours)
        apart = baked_error(made, colours)
        said = f"baked colours at vertices: off by {apart['mean']:.2f} of 255 on average, {apart['of_99_percent']:.1f} for 99 %"
        room = f"where faces are two texels high ({100.0 * apart['share_with_room']:.1f} % of the vertices)"
        return made, {"baked_error_of_255": apart}, [f"{said}, at most {apart['largest_with_room']:.1f} {room}"]
    if call["image"] is not None and str(call["image"]) != CHECKER:
        return textured(result, call["image"], size), {}, []
    width, height = _size(result, _USUAL) if size is None else size
    side = square_of(result, width, height) if call["square"] is None else call["square"]
    line = f"squares of the checkerboard are {side:g} wide on the surface where the density is the median"
    return textured(result, CHECKER, (width, height), side), {"square": side}, [line]


def _run(call: Call) -> Made:
    _check(call)
    result = call.mapped(call["mesh"])
    call.shown("texture", 0, 0)
    made, own, lines = _made(call, result)
    record = made.density.record()
    call.shown("texture", 1, 1)
    height, width = made.image.shape[:2]
    first = f"texture of {width} x {height} texels"
    if call["texels_per_unit"] is not None:
        first += f", the smallest with {call['texels_per_unit']:g} per unit on {100.0 * call['share']:g} % of the surface"
    if record:
        lines = [
            first,
            f"texels per unit of length: least {record['texels_per_unit_least']:.4g}, median "
            f"{record['texels_per_unit_median']:.4g}, greatest {record['texels_per_unit_greatest']:.4g}",
            f"texels are {record['texel_ratio_median']:.3f} times as long as wide in the middle, "
            f"{record['texel_ratio_worst']:.3g} at worst; stretch {record['stretch_mean']:.3g} on average, "
            f"{record['stretch_worst']:.3g} at worst",
            *lines,
        ]
    files: dict[str, Any] = {".glb": made.files, ".obj": made.files}
    files |= {_PICTURE: lambda name: {name: made.png}, _DENSITY: partial(_density_file, made)}
    asked = {"texels_per_unit_asked": call["texels_per_unit"], "share": call["share"]} if call["texels_per_unit"] else {}
    figures = {"map": map_record(result), "width": width, "height": height, **asked, **record, **own}
    return Made(files, figures, tuple(lines), folds_said(result))


def _density_file(made: Textured, name: str) -> dict[str, bytes]:
    """The picture's file."""
    return {name: drawn(made)}


APP = App(
    name="texture",
    summary="a texture on the surface: a picture, a checkerboard, or the baked colours of its vertices",
    writes={
        ".glb": "the surface with its texture, in one file",
        ".obj": "the same as OBJ, with its material (.mtl) and the picture (_texture.png) beside it",
        _PICTURE: "the texture's picture alone",
        _DENSITY: "the surface with its texture, and how many texels its parts get",
    },
    arguments=_arguments,
    run=_run,
    usual=(".glb", ".obj", _DENSITY),
    reference="Choi, Leung-Liu, Gu, Lui (2020), section 5.7.1; stretch by Sander, Snyder, Gortler, Hoppe (2001)",
)
