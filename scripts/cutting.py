"""Cut surfaces open, and show how: a picture of the cuts and maps, and a table of figures.

    scripts/cutting.py [docs/images/cutting.png]           the picture, of two surfaces made by formula
    scripts/cutting.py PICTURE MESH ...                    the same of meshes, one a row
    scripts/cutting.py --table [--bound R] [MESH ...]      the table, in Markdown

A row shows the surface from two sides with one checkerboard on all of it, the cut in red, and the map with the same
checkerboard.
"""

from __future__ import annotations

import argparse
import io
import time
from pathlib import Path

import numpy as np
from PIL import Image

import pgcp
from pgcp.finish.unit_square import standing
from pgcp.report.raster import rasterise, view
from pgcp.report.shade import vertex_shapes

ROOT = Path(__file__).resolve().parents[1]
SIZE, SHARPER, SQUARES, GAP = 330, 3, 48, 14
LIMBS = ((0.0, 0.0, 1.0), (0.8, 0.0, -0.75), (-0.8, 0.1, -0.7), (0.1, 0.95, 0.1), (0.9, -0.3, 0.55), (-0.85, -0.3, 0.6))
DARK, LIGHT, SEAM = np.array([0.20, 0.33, 0.56]), np.array([0.96, 0.95, 0.91]), np.array([0.86, 0.10, 0.12])


def starfish(levels: int = 5) -> pgcp.Mesh:
    """A sphere with six limbs: genus 0."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=levels)
    directions = np.array(LIMBS) / np.linalg.norm(LIMBS, axis=1)[:, None]
    radius = 1.0 + 1.7 * np.exp(24.0 * (ball.vertices @ directions.T - 1.0)).sum(axis=1)
    return pgcp.Mesh(ball.vertices * radius[:, None], ball.faces, "ball with six limbs")


def horned_ring(n: int = 120, m: int = 60) -> pgcp.Mesh:
    """A torus with five horns: genus 1."""
    i, j = (k.ravel() for k in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    u, v = 2.0 * np.pi * i / n, 2.0 * np.pi * j / m
    along = np.abs((u[:, None] - 2.0 * np.pi * np.arange(5) / 5 + np.pi) % (2.0 * np.pi) - np.pi)
    horn = np.exp(-18.0 * along**2).sum(axis=1) * np.exp(3.0 * (np.cos(v) - 1.0))
    radius = 0.55 + 1.2 * horn
    points = np.column_stack(
        [(2.0 + radius * np.cos(v)) * np.cos(u), (2.0 + radius * np.cos(v)) * np.sin(u), radius * np.sin(v)]
    )
    a, b, c, d = i * m + j, (i + 1) % n * m + j, (i + 1) % n * m + (j + 1) % m, i * m + (j + 1) % m
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return pgcp.Mesh(points, faces, "ring with five horns")


def rotation(vertices: np.ndarray, faces: np.ndarray, turn: float) -> np.ndarray:
    """A view (3, 3) of a surface that stands, from the side and a little above, turned about its upright axis."""
    up = np.eye(3)[int(np.argmax(standing(vertices, faces) * [0.2, 1.0, 1.0]))]
    flat = np.roll(up, 1)
    eye = 0.94 * (np.cos(turn) * flat + np.sin(turn) * np.cross(up, flat)) + 0.34 * up
    eye /= np.linalg.norm(eye)
    right = np.cross(up, eye)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(eye, right), eye])


def seams(result: pgcp.Result) -> np.ndarray:
    """Whether the edge opposite each corner (F, 3) was cut."""
    ends = np.sort(result.faces[:, [[1, 2], [2, 0], [0, 1]]], axis=2).reshape(-1, 2)
    key = ends[:, 0].astype(np.int64) * len(result.mesh.vertices) + ends[:, 1]
    _, place, count = np.unique(key, return_inverse=True, return_counts=True)
    return (count[place] == 1).reshape(-1, 3)


def painter(result: pgcp.Result, places: np.ndarray, light: np.ndarray, width: float):
    """Colours (m, 3) of places on faces: a checkerboard of texture coordinates (V, 2), edges that were cut red."""
    mesh, cut = result.mesh, seams(result)
    shapes = vertex_shapes(mesh.vertices, mesh.faces, result.coordinates, (1.0, 1.0)).astype(np.float64)
    facing = np.abs(shapes[:, :3] @ light)  # of what is seen; a surface may be inside out
    sides = np.linalg.norm(np.diff(mesh.vertices[mesh.faces[:, [1, 2, 0, 1]]], axis=1), axis=2)
    heights = 2.0 * result._areas[0][:, None] / np.maximum(sides, 1e-300)

    def paint(face_ids: np.ndarray, weights: np.ndarray) -> np.ndarray:
        corners = mesh.faces[face_ids]
        at = np.einsum("ki,kid->kd", weights, places[corners])
        dark = np.floor(at * SQUARES).sum(axis=1) % 2 == 0
        colour = np.where(dark[:, None], DARK, LIGHT)
        near = (cut[face_ids] & (weights * heights[face_ids] < width)).any(axis=1)
        colour = np.where(near[:, None], SEAM, colour)
        return (colour * (0.45 + 0.6 * np.einsum("ki,ki->k", weights, facing[corners]))[:, None]).astype(np.float32)

    return paint


def row(result: pgcp.Result) -> list[np.ndarray]:
    """The surface from two sides, and the map."""
    mesh, layout = result.mesh, result.layout()
    assert layout is not None
    width = 0.005 * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    panels = []
    for turn in (0.7, 0.7 + np.pi):
        turned = rotation(mesh.vertices, mesh.faces, turn)
        paint = painter(result, layout.points, np.array([-0.35, 0.45, 0.82]) @ turned, width)
        panels.append(rasterise(view(mesh.vertices, mesh.faces, turned), paint, SIZE * SHARPER))
    paint = painter(result, layout.points, np.array([0.0, 0.0, 0.0]), 0.0)
    flat = view(layout.points, mesh.faces)
    panels.append(rasterise(flat, lambda f, w: paint(f, w) / 0.45, SIZE * SHARPER))
    return panels


def picture(results: list[pgcp.Result]) -> bytes:
    """PNG bytes: a row for each map."""
    rows = [
        np.concatenate([np.pad(p, ((0, 0), (0, GAP), (0, 0)), constant_values=255) for p in row(one)], axis=1)
        for one in results
    ]
    sheet = Image.fromarray(np.concatenate(rows))
    out = io.BytesIO()
    small = sheet.resize((sheet.width // SHARPER, sheet.height // SHARPER), Image.Resampling.LANCZOS)
    small.quantize(128, dither=Image.Dither.NONE).save(out, "png", optimize=True)
    return out.getvalue()


def mapped(mesh: pgcp.Mesh, bound: float | None) -> tuple[pgcp.Result, float]:
    """The map of a mesh that is cut open, and its seconds."""
    start = time.perf_counter()
    result = pgcp.compute(mesh, pgcp.Options(cut="auto", max_area_distortion=bound))
    return result, time.perf_counter() - start


def line(result: pgcp.Result, seconds: float) -> str:
    """A line of the table."""
    cut, q = result.report["cut"], result.quality
    name = result.mesh.name.removesuffix(".ply")
    areas, largest = cut["scale_ratio"], cut["largest_scale_ratio"]
    overlap = "-" if result.report["overlap"] is None else result.report["overlap"]["crossings"]
    return (
        f"| {name} | {cut['genus']} | {cut['boundaries']} | {cut['tips']} | {cut['edges']} | {cut['length_by_diagonal']:.2f} | "
        f"{cut['length_by_root_of_area']:.2f} | {areas:.1f} | {areas**0.5:.1f} | {largest:.0f} | "
        f"{q.angle_mean_deg:.2f} | {q.folds} | {overlap} | {cut['rounds']} | {seconds:.0f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("path", nargs="?", type=Path, default=ROOT / "docs" / "images" / "cutting.png")
    parser.add_argument("meshes", nargs="*", type=Path)
    parser.add_argument("--table", action="store_true")
    parser.add_argument("--bound", type=float)
    asked = parser.parse_args()
    named = [asked.path, *asked.meshes] if asked.table and asked.path.suffix != ".png" else asked.meshes
    meshes = [pgcp.read_mesh(path) for path in named] or [starfish(), horned_ring()]
    results = []
    for mesh in meshes:
        result, seconds = mapped(mesh, asked.bound)
        results.append(result)
        print(line(result, seconds), flush=True)
    if not asked.table:
        asked.path.write_bytes(picture(results))
        print(f"{asked.path}: {asked.path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
