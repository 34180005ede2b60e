"""Measuring scripts are imported, and called in this process: they take the words of a command line."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from meshes import grid, lifted

import pgcp

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts" / "benchmarks"))


@pytest.fixture(scope="session")
def hills_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "hills.ply"
    pgcp.write_mesh(path, lifted(grid(40, jitter=0.2)))
    return path


@pytest.fixture(scope="session")
def table_of():
    """Reads a table with tabs: a dictionary for each row."""

    def read(path):
        head, *rows = [line.split("\t") for line in path.read_text().splitlines()]
        return [dict(zip(head, row, strict=True)) for row in rows]

    return read
