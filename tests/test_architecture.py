"""Imports point one way, room by room; each room says what it is."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
GROUND = {"errors", "types", "options", "parallel", "registry"}
MATHEMATICS = {"polygons", "surface", "plane", "elimination", "intake", "folds"}
ROOMS = {  # what each room may import beside itself and the ground
    "surface": set(),
    "plane": {"surface"},
    "elimination": {"surface"},
    "intake": {"surface"},
    "folds": {"elimination", "plane", "surface"},
    "polygons": set(),
    "io": {"polygons"},
    "runtime": {"io"},
    "patches": {"partition", "runtime", "elimination", "plane", "surface"},
    "interface": {"patches", "runtime", "elimination", "plane", "surface"},
    "finish": {"patches", "elimination", "plane", "surface"},
    "methods": {"interface", "patches", "runtime", "elimination", "plane", "surface", "intake"},
    "targets": {"interface", "finish", "patches", "plane", "surface"},
    "retry": {"methods", "targets", "finish", "folds", "patches", "plane", "surface"},
    "report": {"retry", "targets", "finish", "patches", "plane", "surface"},
    "partition": set(),
}
TOP = {"pipeline", "api", "result", "apps", "cli", "__init__", "__main__"}
ABOVE_APPS = {"cli", "pipeline"}
DRAWING = ("PIL", "matplotlib")


def modules():
    for path in sorted((ROOT / "pgcp").rglob("*.py")):
        parts = path.relative_to(ROOT / "pgcp").with_suffix("").parts
        yield path, parts[0], ".".join(parts)


MODULES = [pytest.param(*found, id=found[2]) for found in modules()]


def imported(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize(("path", "room", "name"), MODULES)
def test_a_room_imports_only_rooms_below_it(path, room, name):
    assert room in GROUND | set(ROOMS) | TOP, f"{room} has no place in the picture"
    for target in imported(path):
        words = target.split(".")
        if words[0] == "pgcp" and len(words) > 1:
            other = words[1]
            if room in GROUND:
                assert other in GROUND, f"{name} is ground, but imports {target}"
            elif room == "apps":
                assert other not in ABOVE_APPS, f"{name} imports {target}"
            elif room in ROOMS:
                assert other in ROOMS[room] | GROUND | {room}, f"{name} imports {target}"
            if room == "runtime" and other == "io":
                assert words[2] == "files", f"{name} imports {target}"
        if words[0] == "partition" or words[:2] == ["pgcp", "partition"]:
            assert name in ("patches.split", "patches.plan", "partition.__init__")
        if words[0] in ("dask", "distributed"):
            assert name.startswith("runtime.executors.")
        if words[0] in DRAWING:
            assert room in ("report", "apps")


def names_of(room):
    """Names of a room's things: those of its files that hold one."""
    return {path.stem for path in (ROOT / "pgcp" / room).glob("*.py")} - {"__init__", "base", "registry", "fitting"}


def literals(node):
    return {found.value for found in ast.walk(node) if isinstance(found, ast.Constant) and isinstance(found.value, str)}


@pytest.mark.parametrize(("path", "room", "name"), MODULES)
def test_no_target_or_method_is_told_by_its_name_outside_its_own_file(path, room, name):
    names = names_of("targets") | names_of("methods") - {"pgcp"}
    for node in ast.walk(ast.parse(path.read_text())):
        told = set()
        if isinstance(node, (ast.Compare, ast.match_case)):
            told = literals(node) & names
        elif isinstance(node, ast.Dict) and room != "io":  # there coordinates have names
            told = {key.value for key in node.keys if isinstance(key, ast.Constant)} & names_of("targets")
        assert told <= {path.stem}, f"{name}, line {node.lineno}, tells {told} by name"


SNIFFED = re.compile(r"\.ndim\b|\.shape\[1\] [!=]= [23]|iscomplexobj")
ARRAYS_OF_ANY_KIND = {  # what they look at is not where a map goes
    "types",  # arrays are checked at the border
    "elimination.pardiso",  # one right-hand side, or several
    "interface.merge",  # real or complex columns
    "runtime.store",  # numbers and arrays of a record
    "surface.distortion",  # points in two or three dimensions
}


@pytest.mark.parametrize(("path", "room", "name"), MODULES)
def test_no_shape_of_an_array_tells_the_target(path, room, name):
    if room != "io" and name not in ARRAYS_OF_ANY_KIND:
        assert not SNIFFED.search(path.read_text()), name


def test_the_picture_has_no_circle():
    for room, below in ROOMS.items():
        for other in below:
            assert room not in ROOMS[other], f"{room} and {other} import each other"


def test_mathematics_and_execution_know_nothing_of_each_other():
    for room in MATHEMATICS:
        assert "runtime" not in ROOMS[room]
    assert not ROOMS["runtime"] & MATHEMATICS


def test_few_modules_stand_outside_the_rooms():
    assert len(list((ROOT / "pgcp").glob("*.py"))) <= 10


def test_each_room_says_what_it_is_in_three_lines():
    for room in (path.parent for path in (ROOT / "pgcp").rglob("__init__.py")):
        said = ast.get_docstring(ast.parse((room / "__init__.py").read_text()))
        if room.name not in ("pgcp", "partition"):
            assert said, room
            assert len(said.splitlines()) <= 3, room
            assert "Door" in said, room
            assert "Imports" in said, room


def test_tests_mirror_the_rooms():
    rooms = {path.parent.name for path in (ROOT / "pgcp").glob("*/__init__.py")}
    assert rooms <= {path.name for path in (ROOT / "tests").iterdir() if path.is_dir()}


def test_partition_stands_alone():
    for path in (ROOT / "partition").rglob("*.py"):
        assert not [t for t in imported(path) if t.split(".")[0] in ("pgcp", "dask", "distributed")]


def test_only_the_command_prints_or_exits():
    for path, room, name in modules():
        calls = {
            node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Call)
        }
        if room not in ("cli", "__main__"):
            assert not calls & {"print", "exit", "_exit"} - ({"_exit"} if name == "parallel" else set()), path


@pytest.mark.parametrize(("path", "room", "name"), MODULES)
def test_every_public_function_says_what_it_is(path, room, name):
    tree = ast.parse(path.read_text())
    assert ast.get_docstring(tree), path
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            assert ast.get_docstring(node), f"{name}: {node.name}"
