"""Draw the pictures of applications' pages, of the built-in demo surface: scripts/app_pictures.py [NAME ...]."""

from __future__ import annotations

import argparse
import io
from pathlib import Path

from PIL import Image

import pgcp
from pgcp.apps import remesh, texture
from pgcp.surface.demo import demo_mesh

ROOT = Path(__file__).resolve().parents[1]
COLOURS = 192


def demo(rings: int) -> pgcp.Result:
    """The map of the demo surface to the plane."""
    return pgcp.parameterize(demo_mesh(rings), patches=6)


def remesh_picture(rings: int = 60) -> bytes:
    """The demo surface before and after it is meshed anew."""
    result = demo(rings)
    return remesh.drawn(result.mesh, remesh.remesh(result, vertices=4000))


def texture_picture(rings: int = 90) -> bytes:
    """The demo surface with a checkerboard, and the density of its texels."""
    return texture.drawn(texture.textured(demo(rings), size=(2048, 2048)))


PICTURES = {"remesh": remesh_picture, "texture": texture_picture}


def small(png: bytes) -> bytes:
    """The same picture in fewer colours."""
    out = io.BytesIO()
    Image.open(io.BytesIO(png)).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(out, "png", optimize=True)
    return out.getvalue()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=list(PICTURES), metavar="NAME", help=", ".join(PICTURES))
    for name in parser.parse_args().names:
        path = ROOT / "docs" / "images" / f"app-{name}.png"
        path.write_bytes(small(PICTURES[name]()))
        print(path)


if __name__ == "__main__":
    main()
