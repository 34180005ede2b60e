"""The examples of the gallery run, on small surfaces, and draw what they are to show."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from meshes import even_sphere, grid, lifted, lumpy, spheroid
from PIL import Image

import pgcp

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs" / "gallery"
GIVEN = {  # what makes each example small, and what it must say
    "brain": (["closed.ply"], r"folds 0, degree 1\nhalf of all faces change their area by less than 1\.\d\d times"),
    "terrain": (["2500"], r"pgcp.Result of mesh: 2500 vertices.*\n.*target free.*\n.*folds 0\n98 % of the map's lengths"),
    "scan": (["12"], r"target disk.*\n.*folds 0\n.* s a million\n"),
    "methods": (["open.ply"], r"disk +pgcp .*\d\n?"),
    "cluster": (["open.ply"], r"12 patches\n.*folds 0"),
    "speedup": (["open.ply"], r"patches  1 worker  2 workers  speedup\n +2 .*\n +4 .*\n +8 .*\n +16 "),
    "statue": (["closed.ply"], r"target free.*\n.*folds 0\ncut along \d+ edges through \d+ tips; scale ratio 1?\d\.\d"),
    "picture": (["open.ply"], r"texels"),
    "remesh": (["open.ply"], r"angle"),
    "cell": (["closed.ply"], r"harmonics up to degree 16.*\n(.*\n)+degree  16: rms distance 0\.000"),
    "equation": (["closed.ply"], r"relative difference in L2 from finite elements on the surface: \d\.\d+e-"),
    "transfer": (["closed.ply", "other.ply"], r"positions there and back: mean 0\.\d+%"),
    "morph": (["closed.ply", "other.ply"], r"to the shape of other.ply in \d+ steps"),
    "resume": (["open.ply"], r"killed when \d+ of 12 patches were solved\nthe maps are equal to the last bit"),
}

LONG = {"scan", "methods", "cluster", "speedup", "resume", "transfer", "morph"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("gallery")
    pgcp.write_mesh(folder / "open.ply", lifted(grid(30)))
    pgcp.write_mesh(folder / "closed.ply", spheroid(3, 1.5)[0])
    pgcp.write_mesh(folder / "other.ply", pgcp.Mesh(lumpy(even_sphere(500).vertices), even_sphere(500).faces))
    return folder


def test_every_example_is_tested_and_on_the_page():
    known = {path.stem for path in FOLDER.glob("*.py")}
    page = (ROOT / "docs" / "gallery.md").read_text()
    assert known == set(GIVEN)
    assert known == set(json.loads((FOLDER / "figures.json").read_text()))
    assert known == set(re.findall(r"images/gallery/(\w+)\.png", page))


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] if name in LONG else []) for name in GIVEN])
def test_an_example_runs_and_draws(name, folder):
    assert len((FOLDER / f"{name}.py").read_text().splitlines()) < 40
    arguments, said = GIVEN[name]
    command = [sys.executable, str(FOLDER / f"{name}.py"), *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert re.search(said, done.stdout), done.stdout
    with Image.open(folder / f"{name}.png") as picture:
        pixels = np.asarray(picture.convert("RGB"))
    assert 0.02 < (pixels < 240).any(axis=2).mean() < 0.98
