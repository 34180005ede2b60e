"""Files of at most 500 lines and functions of at most 60, or a reason in them: a line ``# long: ...``."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MOST_LINES, MOST_OF_A_FUNCTION = 500, 60
SOURCES = sorted(path for room in ("pgcp", "partition", "scripts") for path in (ROOT / room).rglob("*.py"))


def has_reason(lines):
    return any(len(line.strip().removeprefix("# long: ")) > 10 for line in lines if line.strip().startswith("# long: "))


def too_long(text):
    """What is too long in a source without a reason: the file, or functions by name."""
    lines = text.splitlines()
    found = {}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            own = lines[node.lineno - 1 : node.end_lineno]
            if len(own) > MOST_OF_A_FUNCTION and not has_reason(own):
                found[node.name] = len(own)
    if len(lines) > MOST_LINES and not has_reason(line for line in lines if line.startswith("#")):
        found["the file"] = len(lines)
    return found


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_and_functions_are_short(path):
    assert too_long(path.read_text(encoding="utf-8")) == {}


@pytest.mark.parametrize(
    ("reason", "found"),
    [
        ("", {"f": 62, "the file": 505}),
        ("# long: cases of one table", {"the file": 505}),
        ("# long: ", {"f": 62, "the file": 505}),
    ],
)
def test_a_reason_in_a_function_is_one_for_the_function(reason, found):
    text = "def f():\n    " + reason + "\n" + 60 * "    x = 1\n" + 443 * "y = 2\n"
    assert too_long(text) == found
    assert "the file" not in too_long("# long: a table of constants\n" + text)
    assert too_long("def f():\n" + 59 * "    x = 1\n" + 440 * "y = 2\n") == {}
