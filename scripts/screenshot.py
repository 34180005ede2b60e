#!/usr/bin/env python
"""Take the picture of the report page in the documentation: the demo's page in a headless browser.

    scripts/screenshot.py [docs/images/report-page.png]

Needs Chromium (scripts/browser installs it) and the package playwright.
"""

from __future__ import annotations

import argparse
import io
import shutil
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

import pgcp
from pgcp.report.page import page
from pgcp.surface.demo import demo_mesh

ROOT = Path(__file__).resolve().parents[1]
OPTIONS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
PROGRAMS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
SIZE = {"width": 1240, "height": 1240}


def screenshot(html: bytes, size: dict[str, int]) -> Image.Image:
    """What a browser shows of a page, the pointer on the surface."""
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        path = Path(folder) / "page.html"
        path.write_bytes(html)
        browser = playwright.chromium.launch(executable_path=program, args=OPTIONS)
        shown = browser.new_page(viewport=size)
        shown.goto(path.as_uri())
        shown.wait_for_function("document.body.dataset.ready")
        shown.add_style_tag(content=".two { display: none }")  # the picture is of the views and of the time
        box = shown.locator("#surface").bounding_box()
        assert box is not None
        shown.mouse.move(box["x"] + 0.42 * box["width"], box["y"] + 0.72 * box["height"])
        shown.wait_for_function("document.body.dataset.face")
        shown.wait_for_timeout(300)
        taken = shown.screenshot()
        browser.close()
    return Image.open(io.BytesIO(taken)).convert("RGB")


def main() -> None:
    """Map the demo, write its page, and take the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("path", nargs="?", type=Path, default=ROOT / "docs" / "images" / "report-page.png")
    arguments = parser.parse_args()
    pgcp.parameterize(demo_mesh(), patches=12)  # what is compiled or loaded once is not what the picture is about
    result = pgcp.parameterize(demo_mesh(), patches=12, workers=2)
    taken = screenshot(page(result, ("pgcp-run", "--demo", "--patches", "12", "--workers", "2")), SIZE)
    taken = taken.resize((SIZE["width"] * 3 // 4, SIZE["height"] * 3 // 4), Image.Resampling.LANCZOS)
    taken.quantize(96, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(arguments.path, optimize=True)


if __name__ == "__main__":
    main()
