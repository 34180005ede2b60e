"""README and docs/: generated parts are current, links lead somewhere, and every command and program on them runs."""

from __future__ import annotations

import dataclasses
import importlib.util
import io
import json
import re
import shlex
import shutil
import subprocess
import sys
from functools import partial
from itertools import pairwise
from pathlib import Path

import nibabel
import numpy as np
import pytest
from meshes import even_sphere, grid, lifted, lumpy, spheroid, torus
from PIL import Image
from test_architecture import ROOMS

import pgcp
from pgcp import options
from pgcp.apps.registry import APPS
from pgcp.cli import apps
from pgcp.cli.main import main
from pgcp.cli.parser import app_parser, build_parser
from pgcp.surface import demo

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").glob("*.md"))]
PAGE = {page.stem: page.read_text() for page in PAGES}
NOT_RUN = {  # commands by how they begin, and why they are not run here
    "scripts/test": "runs this test",
    "pip install": "needs the network",
    "shtab ": "tests/cli/test_usage.py runs it",
    "dask ": "needs a cluster; tests/runtime starts one",
    "pgcp-run bust.ply --scheduler": "needs a cluster; tests/runtime starts one",
}
OF_OTHERS = {"--map", "--normalize"}  # how options of BFF begin
OPTIONS_OF_SCRIPTS = {"--all", "--check", "--help", "--scheduler-file", "--tls-"}


def script(name):
    """A script as a module."""
    spec = importlib.util.spec_from_file_location(f"script_{name}", ROOT / "scripts" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


DOCS = script("docs")


def blocks(text):
    """Language and content of all fenced blocks."""
    return re.findall(r"^```(\w*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def commands(block):
    """Words and expected exit status of the commands of a block."""
    for line in block.splitlines():
        command, _, remark = line.partition("  #")
        if command.strip():
            status = re.search(r"status (\d+)", remark)
            yield command.strip(), int(status[1]) if status else 0


ALL_COMMANDS = [
    command for text in PAGE.values() for kind, block in blocks(text) if kind == "sh" for command, _ in commands(block)
]


def is_not_run(command):
    return any(command.startswith(beginning) for beginning in NOT_RUN)


@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    """The files that pages speak of."""
    folder = tmp_path_factory.mktemp("meshes")
    bust = lifted(grid(30))
    pgcp.write_mesh(folder / "bust.ply", bust)
    pgcp.write_mesh(folder / "holed.ply", pgcp.Mesh(bust.vertices, np.delete(bust.faces, [850, 851], axis=0)))
    pgcp.write_mesh(folder / "ball.ply", spheroid(3, 1.5)[0])
    ball = pgcp.read_mesh(folder / "ball.ply")
    nibabel.freesurfer.write_geometry(folder / "lh.pial", ball.vertices, ball.faces)
    pgcp.write_mesh(folder / "bust2.ply", lifted(grid(26), 0.4))
    pgcp.write_mesh(folder / "ball2.ply", pgcp.Mesh(lumpy(even_sphere(500).vertices), even_sphere(500).faces))
    np.savetxt(folder / "pattern.txt", np.sin(9.0 * bust.vertices[:, 0]))
    (folder / "landmarks.txt").write_text("0 0  # corners and the middle\n30 26\n930 702\n960 728\n480 364\n")
    pgcp.write_mesh(folder / "statue.obj", torus(12))
    loops = [(12 * k, 12 * (k + 1) % 144) for k in range(12)] + [(k, (k + 1) % 12) for k in range(12)]
    (folder / "seams.txt").write_text("\n".join(f"{a} {b}" for a, b in loops))
    column = np.arange(31) + 31 * 15
    (folder / "cuts.txt").write_text("\n".join(f"{a} {b}" for a, b in pairwise(column.tolist())))
    return folder


def run_command(command, folder):
    """Exit status of a command: in this process, but for workers, which are processes."""
    words = shlex.split(command)
    if words[0] == "cp":
        shutil.copy(folder / words[1], folder / words[2])
        return 0
    if words[0] == "pgcp":
        return apps.main(words[1:])
    assert words[0] in ("pgcp-run", "scripts/run"), f"{command}: neither run here nor listed in NOT_RUN"
    if "--workers" in words:
        return subprocess.run([sys.executable, "-m", "pgcp", *words[1:]], cwd=folder, check=False, timeout=300).returncode
    return main(words[1:] if words[0] == "pgcp-run" else ["--demo", *words[1:]])


def run_program(text, folder):
    """Run a Python program: in this process, but for those that start workers, which import it."""
    if "workers=" in text:
        (folder / "program.py").write_text(text)
        done = subprocess.run(
            [sys.executable, "program.py"], cwd=folder, check=False, timeout=300, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
    else:
        exec(compile(text, "program of the page", "exec"), {"__name__": "__main__"})


LONG = {"app-morph", "app-remesh", "app-solve", "app-transfer"}
RUN = [name for name, text in PAGE.items() if {"sh", "python"} & {kind for kind, _ in blocks(text)}]


@pytest.mark.parametrize("page", [pytest.param(name, marks=[pytest.mark.slow] if name in LONG else []) for name in RUN])
def test_commands_and_programs_of_a_page_run_one_after_the_other(page, meshes, tmp_path, monkeypatch):
    folder = tmp_path / "here"
    shutil.copytree(meshes, folder)
    monkeypatch.chdir(folder)
    monkeypatch.setattr(demo, "demo_mesh", partial(demo.demo_mesh, 24))
    for kind, block in blocks(PAGE[page]):
        if kind == "python":
            run_program(block, folder)
        elif kind == "sh":
            for command, status in commands(block):
                if not is_not_run(command):
                    assert run_command(command, folder) == status, command


def test_what_is_not_run_is_on_a_page():
    for beginning in NOT_RUN:
        assert any(command.startswith(beginning) for command in ALL_COMMANDS), beginning


def test_generated_parts_are_current():
    assert sorted(path.name for path in DOCS.stale()) == [], "run scripts/docs.py"


def test_a_generated_part_is_rewritten():
    page = "before\n<!-- generated: options -->\nSTALE\n<!-- end: options -->\nafter\n"
    text = DOCS.current(page)
    assert text.startswith("before\n<!-- generated: options -->\n")
    assert text.endswith("<!-- end: options -->\nafter\n")
    assert "STALE" not in text
    assert all(f"| `{option}" in text for option in options_of(build_parser()) - {"--help"})
    assert DOCS.current(text) == text


def test_readme_is_short():
    assert len(README.read_text().splitlines()) <= 120


def options_of(parser):
    return {option for action in parser._actions for option in action.option_strings if option.startswith("--")}


def test_every_option_is_documented_and_exercised():
    known = options_of(build_parser()) - {"--help"}
    tests = "".join(p.read_text() for p in (ROOT / "tests").rglob("*.py") if p != Path(__file__))
    run = " ".join(command for command in ALL_COMMANDS if not is_not_run(command))
    for option in known:
        assert f"`{option}" in PAGE["command-line"], f"{option} is not documented"
        assert option in tests + run, f"{option} is not exercised"
    known |= {option for app in APPS.all() for option in options_of(app_parser(app))}
    for page, text in PAGE.items():
        for option in re.findall(r"(--[a-z][a-z-]*)", "".join(re.findall(r"`[^`\n]+`", text))):
            assert option in known | OPTIONS_OF_SCRIPTS | OF_OTHERS, f"{page} has {option}, the command has not"


def test_every_name_of_the_library_is_documented():
    for name in pgcp.__all__:
        assert re.search(rf"\b{name}\b", PAGE["python-api"] + PAGE["errors"]), name
    kinds = [kind for kind in vars(options).values() if dataclasses.is_dataclass(kind)]
    for field in {field.name for kind in kinds for field in dataclasses.fields(kind)}:
        assert f"`{field}`" in PAGE["python-api"], field
    for field in dataclasses.fields(pgcp.Parameterization):
        assert f"`{field.name}`" in PAGE["python-api"], field.name


def test_every_key_of_a_result_is_documented(meshes, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main([str(meshes / "holed.ply"), "--fix", "--target", "disk", "--output-dir", "out", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    report = json.loads(Path("out/report.json").read_text())
    with np.load("out/holed.npz") as data:
        names = {*data.files, *report, *report["quality"]}
    for name in names:
        assert f"`{name}`" in PAGE["formats"], name
    good, bad = (json.loads(line) for line in re.search(r"```json\n(.*\})\n(.*)\n```", PAGE["errors"], re.DOTALL).groups())
    assert set(good) == set(said)
    assert set(bad) == {"status", "error", "message"}


@pytest.mark.parametrize("method", [method.name for method in DOCS.methods()])
def test_every_method_has_a_section(method):
    assert re.search(rf"^## {method}$", PAGE["methods"], re.MULTILINE)


@pytest.mark.parametrize("target", [target.name for target in DOCS.targets()])
def test_every_target_has_a_paragraph(target):
    assert re.search(rf"^\*\*{target}\.\*\*", PAGE["methods"], re.MULTILINE)


@pytest.mark.parametrize("name", APPS.names())
def test_every_application_has_a_page_with_commands_and_a_picture(name):
    text = PAGE[f"app-{name}"]
    assert f"<!-- generated: app-{name} -->" in text
    assert any(
        command.startswith(f"pgcp {name} ") for kind, block in blocks(text) if kind == "sh" for command, _ in commands(block)
    )
    assert re.search(r"!\[[^\]]+\]\(images/", text)


def anchors(text):
    """Places of a page that links can lead to."""
    heads = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", head).strip().lower()) for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_somewhere(page):
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if "://" not in link:
            path, _, anchor = link.partition("#")
            target = page.parent / path if path else page
            assert target.exists(), link
            if anchor:
                assert anchor in anchors(target.read_text()), link


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_files_that_are_named_exist(page):
    for path in re.findall(r"`((?:scripts|pgcp|partition|tests|docs)/[\w./-]*)", page.read_text()):
        assert (ROOT / path).exists(), path


def test_the_drawing_shows_the_rooms_and_arrows_that_are_allowed():
    graph, picture = DOCS.arrows(), DOCS.DRAWING.read_text()
    for room in graph:
        assert f">{room}</text>" in picture, room
        if room in ROOMS:
            assert set(graph[room]) <= ROOMS[room], room
    assert set(ROOMS) <= set(graph)
    down = {name: float(y) for y, name in re.findall(r'y="([\d.]+)" text-anchor="middle" fill="#222222">(\w+)<', picture)}
    for upper, lower in graph.edges:
        assert down[upper] < down[lower], f"the arrow from {upper} to {lower} points up"


def test_the_site_builds_and_needs_no_network(tmp_path):
    pytest.importorskip("mkdocs")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    for page in tmp_path.glob("*.html"):
        fetched = re.findall(r"<(?:script|link|img)[^>]*(?:src|href)=\"(?:https?:)?//[^\"]*", page.read_text())
        assert not fetched, page.name


def test_the_picture_is_small_and_can_be_drawn_again():
    kept = ROOT / "docs" / "images" / "demo.png"
    assert kept.stat().st_size < 150_000
    drawn = Image.open(io.BytesIO(script("picture").picture(rings=24)))
    assert drawn.height == Image.open(kept).height
    pixels = np.asarray(drawn.convert("RGB"))
    assert 0.3 < (pixels < 250).any(axis=2).mean() < 0.9
