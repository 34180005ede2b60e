"""Draw README's picture: the built-in demo surface beside its map, with one checkerboard on both.

    scripts/picture.py [docs/images/demo.png]

The bust is mapped to the unit disk. Squares of the map halve in size where the map is half as large as the surface, so that
squares on the surface keep their size. A circle magnifies the middle of the disk, where the head lies.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

import pgcp
from pgcp.report.raster import View, rasterise, view
from pgcp.report.shade import vertex_shapes
from pgcp.surface.demo import demo_mesh

ROOT = Path(__file__).resolve().parents[1]
HEIGHT, GAP, MARGIN, SHARPER, COLOURS = 420, 40, 12, 3, 192
SQUARES, MAGNIFIED = 26.0, 15.0  # squares across the surface; magnification of the middle of the disk
INK = (110, 110, 110)
NOSE = np.array([0.0, -1.3, 1.55])
FROM_ABOVE, FROM_THE_FRONT = np.array([0.0, -0.6, 0.8]), np.array([-0.2, -0.75, 0.63])
PATCH_COLOURS = np.array(
    [(78, 121, 167), (225, 129, 62), (89, 161, 143), (200, 88, 92), (150, 118, 176), (214, 178, 62)], np.float64
)


def looked_at_from(eye: tuple[float, float, float]) -> np.ndarray:
    """Rotation (3, 3) of a view from ``eye``, z upright: rows to the right, up and towards the eye."""
    towards = np.array(eye) / np.linalg.norm(eye)
    right = np.cross((0.0, 0.0, 1.0), towards)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(towards, right), towards])


def painter(result: pgcp.Parameterization, light: np.ndarray, darkest: float):
    """Colours (m, 3) of places on faces: the patch's colour, light and dark by a checkerboard of the map.

    Shaded from ``darkest`` to 1 by ``light`` (3,), as the surface itself.
    """
    mesh = result.mesh
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    shapes = vertex_shapes(mesh.vertices, mesh.faces, result.coordinates, (1.0, 1.0)).astype(np.float64)
    facing = np.clip(shapes[:, :3] @ light, 0.0, 1.0)
    hues = PATCH_COLOURS[np.arange(result.patch.max() + 1) % len(PATCH_COLOURS)] / 255.0

    def paint(face_ids: np.ndarray, weights: np.ndarray) -> np.ndarray:
        corners = mesh.faces[face_ids]
        places = np.einsum("ki,kid->kd", weights, result.coordinates[corners])
        log_scale = np.einsum("ki,ki->k", weights, shapes[corners, 3])
        size = np.exp2(np.floor(log_scale + np.log2(extent / SQUARES)))
        dark = np.floor(places / size[:, None]).sum(axis=1) % 2 == 0
        shade = darkest + (1.04 - darkest) * np.einsum("ki,ki->k", weights, facing[corners])
        colour = hues[result.patch[face_ids]]
        colour = np.where(dark[:, None], colour, 0.22 * colour + 0.78)
        return (colour * shade[:, None]).astype(np.float32)

    return paint


def cropped(pixels: np.ndarray) -> Image.Image:
    """Without the white rows and columns around it."""
    rows, columns = ((pixels < 255).any(axis=2).any(axis=axis).nonzero()[0] for axis in (1, 0))
    return Image.fromarray(pixels[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1])


def round_cut(pixels: np.ndarray) -> Image.Image:
    """The largest circle of a square image, with a rim, on white."""
    image, size = Image.fromarray(pixels), len(pixels)
    mask = Image.new("L", image.size, 0)
    ImageDraw.Draw(mask).ellipse((0, 0, size - 1, size - 1), fill=255)
    out = Image.new("RGB", image.size, "white")
    out.paste(image, (0, 0), mask)
    ImageDraw.Draw(out).ellipse((0, 0, size - 1, size - 1), outline=INK, width=2 * SHARPER)
    return out


def centres_and_radii(panels: list[Image.Image], corners: list[tuple[int, int]], nose: np.ndarray) -> tuple[np.ndarray, ...]:
    """Centre (2,) and radius of what is magnified in the drawn disk, and of the lens, in pixels of the sheet."""
    (disk, lens), (at_disk, at_lens) = panels, corners
    radius = disk.width / 2
    found = np.array(at_disk) + radius * (1.0 + nose * [1.0, -1.0])
    return found, np.array(radius / MAGNIFIED), np.array(at_lens) + lens.width / 2, np.array(lens.width / 2)


def join_lens(draw: ImageDraw.ImageDraw, small: np.ndarray, r: np.ndarray, large: np.ndarray, R: np.ndarray) -> None:
    """A circle round what is magnified, and the two outer tangents from it to the lens."""
    draw.ellipse((*(small - r), *(small + r)), outline=INK, width=SHARPER)
    along = large - small
    distance = np.linalg.norm(along)
    lean = np.arccos((r - R) / distance)
    for side in (-1.0, 1.0):
        turn = np.arctan2(along[1], along[0]) + side * lean
        out = np.array([np.cos(turn), np.sin(turn)])
        draw.line((*(small + r * out), *(large + R * out)), fill=INK, width=SHARPER)


def picture(rings: int = 129) -> bytes:
    """PNG bytes of the picture."""
    mesh = demo_mesh(rings)
    result = pgcp.parameterize(mesh, target="disk", patches=6)
    turn = looked_at_from((0.55, -1.0, 0.28))
    light = np.array([-0.35, 0.45, 0.82]) @ turn
    size, gap, margin = HEIGHT * SHARPER, GAP * SHARPER, MARGIN * SHARPER
    disk = view(result.coordinates, mesh.faces)
    nose = result.coordinates[np.argmin(np.linalg.norm(mesh.vertices - NOSE, axis=1))]
    square = np.array([-1.0, 1.0])[:, None] / MAGNIFIED + nose
    middle = View(disk.points, disk.faces, disk.rotation, np.column_stack([square, (0.0, 0.0)]))
    panels = [
        cropped(rasterise(view(mesh.vertices, mesh.faces, turn), painter(result, light, 0.42), size * 6 // 5)),
        cropped(rasterise(disk, painter(result, FROM_ABOVE, 0.74), size)),
        round_cut(rasterise(middle, painter(result, FROM_THE_FRONT, 0.62), size)),
    ]
    sheet = Image.new("RGB", (sum(p.width for p in panels) + 2 * gap + 2 * margin, size + 2 * margin), "white")
    place, corners = margin, []
    for panel in panels:
        corners.append((place, margin + (size - panel.height) // 2))
        sheet.paste(panel, corners[-1])
        place += panel.width + gap
    join_lens(ImageDraw.Draw(sheet), *centres_and_radii(panels[1:], corners[1:], nose))
    out = io.BytesIO()
    small = sheet.resize((sheet.width // SHARPER, sheet.height // SHARPER), Image.Resampling.LANCZOS)
    small.quantize(COLOURS, dither=Image.Dither.NONE).save(out, "png", optimize=True)
    return out.getvalue()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("path", nargs="?", type=Path, default=ROOT / "docs" / "images" / "demo.png")
    path = parser.parse_args().path
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(picture())
    print(f"{path}: {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
