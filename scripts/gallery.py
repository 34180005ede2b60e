#!/usr/bin/env python3
"""Run the examples of docs/gallery, and keep their pictures and what they took for the page docs/gallery.md.

    scripts/gallery.py [--meshes DIR] [NAME ...]

Each example is run alone, as a user would run it, and measured from outside: seconds of the whole process, and the most memory
that it and all its children held. Those that show a real surface take it from the folder of meshes; without one they take the
surface that they make themselves. Pictures go to docs/images/gallery, figures to docs/gallery/figures.json. Run
scripts/docs.py afterwards.
"""

from __future__ import annotations

import argparse
import io
import json
import platform
import sys
import tempfile
from datetime import date
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "scripts" / "benchmarks"))
from processes import run_measured  # noqa: E402

from pgcp.parallel import processor_count  # noqa: E402
from pgcp.runtime.versions import package_versions  # noqa: E402

FOLDER = ROOT / "docs" / "gallery"
PICTURES = ROOT / "docs" / "images" / "gallery"
FIGURES = FOLDER / "figures.json"
REAL = {  # files of the folder of meshes that examples show
    "brain": ("closed/brain.ply",),
    "statue": ("closed/armadillo.ply",),
    "picture": ("open/max_planck_disk.ply",),
    "remesh": ("open/human_face.ply",),
    "transfer": ("closed/david_head.ply", "closed/max_planck.ply"),
}
WIDTH, COLOURS = 1100, 160


def small(picture: Image.Image) -> bytes:
    """A picture as a PNG that a page can hold."""
    picture = picture.convert("RGB")
    picture.thumbnail((WIDTH, 4 * WIDTH), Image.Resampling.LANCZOS)
    out = io.BytesIO()
    picture.quantize(COLOURS, dither=Image.Dither.NONE).save(out, "png", optimize=True)
    return out.getvalue()


def run(name: str, meshes: Path | None) -> dict[str, object]:
    """Run an example, keep its picture, and return its figures; raises SystemExit where it fails."""
    given = [meshes.resolve() / path for path in REAL.get(name, ())] if meshes else []
    with tempfile.TemporaryDirectory() as folder:
        done = run_measured([sys.executable, FOLDER / f"{name}.py", *given], folder=folder)
        if done.status:
            raise SystemExit(f"{name} ended with status {done.status}: {done.errors}")
        with Image.open(Path(folder, f"{name}.png")) as picture:
            (PICTURES / f"{name}.png").write_bytes(small(picture))
    versions = {package: version for package, version in package_versions().items() if package in ("python", "pgcp", "numpy")}
    return {
        "seconds": round(done.wall_s, 1),
        "peak_mb": round(done.peak_bytes / 1e6),
        "said": done.output.rstrip().splitlines(),
        "surface": [Path(path).stem for path in given],
        "date": date.today().isoformat(),
        "processors": processor_count(),
        "machine": platform.machine(),
        "versions": versions,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--meshes", type=Path, metavar="DIR", help="folder of real meshes, with open/ and closed/")
    parser.add_argument("names", nargs="*", metavar="NAME", help="examples; all without a name")
    arguments = parser.parse_args()
    PICTURES.mkdir(parents=True, exist_ok=True)
    known = sorted(path.stem for path in FOLDER.glob("*.py"))
    for name in arguments.names or known:
        if name not in known:
            raise SystemExit(f"there is no example {name}; there are {', '.join(known)}")
        figures = json.loads(FIGURES.read_text()) if FIGURES.exists() else {}
        figures[name] = run(name, arguments.meshes)
        FIGURES.write_text(json.dumps(figures, indent=1, sort_keys=True) + "\n")
        print(f"{name}: {figures[name]['seconds']} s, {figures[name]['peak_mb']} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
