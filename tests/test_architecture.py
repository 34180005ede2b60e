"""Imports point one way: cli -> report, io, pipeline -> executors, tasks -> stages -> mathematics -> types, errors."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LAYERS = [
    {"errors", "files"},
    {"types", "options", "parallel", "forks"},
    {
        "topology",
        "operators",
        "dissection",
        "fronts",
        "dirichlet_nested",
        "dirichlet_superlu",
        "dirichlet_pardiso",
        "dirichlet",
        "beltrami",
        "zipper",
        "curves",
        "regions",
        "untangle",
        "embed",
        "natural",
        "mobius",
        "geodesic",
        "distortion",
        "manifold",
        "holes",
        "mend",
        "boundary_energy",
        "descent",
        "cem",
        "ccem",
        "cdcp",
    },
    {
        "check",
        "plan",
        "split",
        "flatten",
        "weld",
        "interface",
        "puncture",
        "constrain",
        "solve",
        "assemble",
        "quality",
        "repair",
        "correct",
    },
    {"store", "tasks", "executors", "io", "demo"},
    {"run", "exact", "warmed", "early"},
    {"by_welds", "by_interface"},
    {"attempts"},
    {"pipeline", "report"},
    {"cli"},
    {"__main__", "__init__"},
]
STAGES = LAYERS[3]
RANK = {name: rank for rank, layer in enumerate(LAYERS) for name in layer}
DRAWING = ("PIL", "matplotlib")


def modules():
    for path in sorted((ROOT / "pgcp").rglob("*.py")):
        parts = path.relative_to(ROOT / "pgcp").with_suffix("").parts
        yield path, parts[0]


def imported(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            if node.module == "pgcp":
                yield from (f"pgcp.{alias.name}" for alias in node.names)
            else:
                yield node.module


@pytest.mark.parametrize(("path", "name"), list(modules()), ids=lambda value: getattr(value, "name", value))
def test_arrows_point_one_way(path, name):
    assert name in RANK, f"{name} has no place in the picture"
    for target in imported(path):
        top = target.split(".")[0]
        if top == "pgcp" and "." in target:
            other = target.split(".")[1]
            assert RANK[other] <= RANK[name], f"{name} imports {other}"
            if name in STAGES and other in STAGES:
                pytest.fail(f"stage {name} imports stage {other}")
        if top == "partition":
            assert name == "split"
        if top in ("dask", "distributed"):
            assert name == "executors"
        if top in DRAWING:
            assert name == "report"


def test_partition_stands_alone():
    for path in (ROOT / "partition").rglob("*.py"):
        assert not [t for t in imported(path) if t.split(".")[0] in ("pgcp", "dask", "distributed")]


def test_only_the_command_prints_or_exits():
    for path, name in modules():
        calls = {
            node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Call)
        }
        if name not in ("cli", "__main__"):
            assert not calls & {"print", "exit", "_exit"} - ({"_exit"} if name == "parallel" else set()), path


def test_every_public_function_says_what_it_is():
    for path, _ in modules():
        tree = ast.parse(path.read_text())
        assert ast.get_docstring(tree), path
        for node in ast.walk(tree):
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
                assert ast.get_docstring(node), f"{path.name}: {node.name}"
