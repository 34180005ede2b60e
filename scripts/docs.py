"""Rewrite the generated parts of README and docs/: options, methods, targets, formats, and the drawing of the rooms.

    scripts/docs.py            rewrite what is not current
    scripts/docs.py --check    name what is not current, and end with status 1

A generated part of a page stands between ``<!-- generated: NAME -->`` and ``<!-- end: NAME -->``.
"""

from __future__ import annotations

import argparse
import ast
import json
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from html import escape
from itertools import pairwise
from pathlib import Path
from typing import Any

import networkx as nx

ROOT = Path(__file__).resolve().parents[1]
DRAWING = ROOT / "docs" / "images" / "rooms.svg"
PART = re.compile(r"(<!-- generated: ([\w-]+) -->\n).*?(<!-- end: \2 -->)", re.DOTALL)


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A Markdown table."""
    lines = [head, tuple("---" for _ in head), *rows]
    return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |\n" for line in lines)


# What is registered -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Listed:
    """What the tables say of a method or a target."""

    name: str
    summary: str
    targets: tuple[str, ...] = ()
    guarantees: str = ""
    reference: str = ""


def methods() -> list[Listed]:
    """All methods, the default first, then by targets."""
    from pgcp.methods.registry import METHODS
    from pgcp.options import METHOD
    from pgcp.targets.registry import TARGETS

    everywhere = TARGETS.names()
    found = [Listed(m.name, m.summary, m.targets or everywhere, m.guarantees, m.reference) for m in METHODS.all()]
    return sorted(found, key=lambda method: (method.name != METHOD, -len(method.targets), method.targets, method.name))


def targets() -> list[Listed]:
    """All targets."""
    from pgcp.targets.registry import TARGETS

    return [Listed(target.name, target.summary) for target in TARGETS.all()]


def formats() -> list[tuple[str, ...]]:
    """Name, suffixes, what it is, whether it is read and written, the arrays a written file has, packages that it needs."""
    from pgcp.io import formats as registry

    return [
        (
            f"`{kind.name}`",
            " ".join(f"`{suffix}`" for suffix in kind.suffixes),
            kind.summary,
            "yes" if kind.read else "",
            ", ".join(f"`{array}`" for array in kind.carries) if kind.write else "",
            ", ".join(kind.needs),
        )
        for kind in registry.formats()
    ]


# Tables -----------------------------------------------------------------------------------------------------------------------


def methods_table() -> str:
    """Every method with what it guarantees and where it comes from."""
    rows = [(f"[`{m.name}`](#{m.name})", ", ".join(m.targets), m.summary, m.guarantees, m.reference) for m in methods()]
    return table(("`--method`", "targets", "what it does", "guarantees", "reference"), rows)


def methods_in_short() -> str:
    """Every method with its summary, for README."""
    rows = [(f"[`{m.name}`](docs/methods.md#{m.name})", ", ".join(m.targets), m.summary) for m in methods()]
    return table(("`--method`", "targets", "what it does"), rows)


def targets_table() -> str:
    """Every target."""
    return table(("`--target`", "where the map goes"), [(f"`{target.name}`", target.summary) for target in targets()])


def formats_table() -> str:
    """Every file format."""
    return table(("format", "suffixes", "what it is", "read", "written, with", "needs"), formats())


def options_table() -> str:
    """Every option of the command line, group by group."""
    from pgcp.cli.parser import build_parser

    parser = build_parser()
    return "".join(group_table(group, parser._get_formatter()) for group in parser._action_groups)


def group_table(group: argparse._ArgumentGroup, formatter: argparse.HelpFormatter) -> str:
    """The options of a group under its title, nothing where there is none."""
    rows = []
    for action in group._group_actions:
        if action.help == argparse.SUPPRESS or "--help" in action.option_strings:
            continue
        names = action.option_strings or [str(action.metavar or action.dest).upper()]
        value = "" if action.nargs == 0 or not action.option_strings else f" {action.metavar or action.dest.upper()}"
        meaning = re.sub(r"\S*\d+\.\d+\.\d+\S*", "VERSION", formatter._expand_help(action)) if action.help else ""
        meaning = re.sub(r"<\w+>\w*", r"`\g<0>`", meaning)
        if action.choices:
            meaning += f". One of {', '.join(f'`{choice}`' for choice in action.choices)}"
        if action.choices and action.default is not None and "default" not in meaning:
            meaning += f"; default `{action.default}`"
        rows.append((", ".join(f"`{name}{value}`" for name in names), meaning))
    if not rows:
        return ""
    title = {"positional arguments": "Argument", "options": "Options"}.get(str(group.title), str(group.title))
    head = ("option" if rows[0][0].startswith("`-") else "argument", "meaning")
    about = f"{group.description}\n\n" if group.description else ""
    return f"### {title[:1].upper()}{title[1:]}\n\n{about}{table(head, rows)}\n"


def apps_table() -> str:
    """Every application."""
    from pgcp.apps.registry import APPS

    return table(("command", "what it does"), [(f"[`pgcp {app.name}`](app-{app.name}.md)", app.summary) for app in APPS.all()])


def app_options(name: str) -> str:
    """What an application asks for, and the files that it writes; the options of maps are those of ``pgcp-run``."""
    from pgcp.apps.registry import APPS
    from pgcp.cli.parser import ASKED, app_parser

    app = APPS.get(name)
    parser = app_parser(app)
    asked = next(group for group in parser._action_groups if group.title == ASKED)
    files = table(("file", "what it is"), [(f"`{ending}`", what) for ending, what in app.writes.items()])
    return f"{group_table(asked, parser._get_formatter())}\n### Files\n\n{files}"


# The gallery ------------------------------------------------------------------------------------------------------------------

GALLERY = ROOT / "docs" / "gallery"
EXAMPLES = (  # in the order of the page
    "brain", "statue", "terrain", "picture", "remesh", "cell", "equation", "transfer", "morph", "methods", "scan", "cluster",
    "speedup", "resume",
)  # fmt: skip


def gallery() -> str:
    """Every example: what it shows, its picture, what it took, and its program."""
    figures = json.loads((GALLERY / "figures.json").read_text())
    return "\n".join(example(GALLERY / f"{name}.py", figures[name]) for name in EXAMPLES)


def example(path: Path, figures: dict[str, Any]) -> str:
    """One example of the gallery."""
    title, _, usage, *about = (ast.get_docstring(parsed(path)) or "").split("\n", 3)
    program = path.read_text().split('"""', 2)[2].strip()
    surface = f" of {' and '.join(figures['surface'])}" if figures["surface"] else ""
    took = (
        f"{figures['seconds']} s and {figures['peak_mb']} MB{surface}, on {figures['processors']} processors, {figures['date']}"
    )
    said = "\n".join(figures["said"])
    return (
        f"## {title.rstrip('.')}\n\n{about[0].strip()}\n\n![{title.rstrip('.')}](images/gallery/{path.stem}.png)\n\n"
        f"`{usage.strip()}` took {took}, and said:\n\n```text\n{said}\n```\n\n```py\n{program}\n```\n"
    )


# Rooms ------------------------------------------------------------------------------------------------------------------------

STARTS = {"__init__", "__main__"}


@cache
def parsed(path: Path) -> ast.Module:
    """Syntax tree of a file."""
    return ast.parse(path.read_text())


def ground() -> tuple[str, ...]:
    """Modules that every room may import: those that the test of the rooms names."""
    tree = parsed(ROOT / "tests" / "test_architecture.py")
    found = next(n for n in tree.body if isinstance(n, ast.Assign) and getattr(n.targets[0], "id", "") == "GROUND")
    return tuple(sorted(ast.literal_eval(found.value)))


def is_folder(room: str) -> bool:
    """Whether a room is a folder, and not one file."""
    return room == "partition" or (ROOT / "pgcp" / room).is_dir()


def modules_of(room: str) -> list[Path]:
    """Files of a room, a room of one file being that file."""
    folder = ROOT / "partition" if room == "partition" else ROOT / "pgcp" / room
    return sorted(folder.rglob("*.py")) if folder.is_dir() else [folder.with_suffix(".py")]


def rooms() -> list[str]:
    """All rooms: folders of pgcp/, single files that are no ground, and partition/."""
    folders = {path.parent.name for path in (ROOT / "pgcp").glob("*/__init__.py")}
    files = {path.stem for path in (ROOT / "pgcp").glob("*.py")}
    return sorted(folders | files - STARTS - set(ground()) | {"partition"})


def imported(path: Path) -> Iterator[str]:
    """Rooms that a file imports, those that only a type checker imports left out."""
    tree = parsed(path)
    unseen = {
        id(inside)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"
        for inside in ast.walk(node)
    }
    for node in ast.walk(tree):
        if id(node) not in unseen and isinstance(node, (ast.Import, ast.ImportFrom)):
            whole = f"{node.module}." if isinstance(node, ast.ImportFrom) else ""
            for name in node.names:
                words = f"{whole}{name.name}".split(".")
                if words[0] == "pgcp" and len(words) > 1:
                    yield words[1]
                elif words[0] == "partition":
                    yield "partition"


@cache
def arrows() -> nx.DiGraph:
    """Which room imports which."""
    graph = nx.DiGraph()
    graph.add_nodes_from(rooms())
    for room in graph:
        for path in modules_of(room):
            graph.add_edges_from((room, other) for other in imported(path) if other in graph and other != room)
    return graph


def said_by(path: Path) -> str:
    """First line of a file's docstring, without its last dot."""
    lines = (ast.get_docstring(parsed(path)) or "").splitlines()
    return (lines[0] if lines else "").rstrip(".").replace("``", "`")


def about(room: str) -> str:
    """What lives in a room."""
    files = modules_of(room)
    return said_by(next((path for path in files if path.name == "__init__.py"), files[0]))


def files_table(files: list[Path]) -> str:
    """Files with what they are."""
    return table(("file", "what it is"), [(f"`{name_in(path)}`", said_by(path)) for path in files])


def rooms_table() -> str:
    """Every room with what lives there and what it imports, then every file."""
    graph = arrows()
    order = [room for level in levels(graph) for room in level]
    rows = [
        (
            f"[`{room}`](#{room})" if is_folder(room) else f"`{room}`",
            about(room),
            ", ".join(f"`{other}`" for other in sorted(graph[room])) or "-",
        )
        for room in order
    ]
    text = table(("room", "what lives there", "imports, beside the ground"), rows)
    for room in filter(is_folder, order):
        text += f"\n### {room}\n\n{files_table([path for path in modules_of(room) if path.name != '__init__.py'])}"
    singles = [room for room in order if not is_folder(room)]
    for title, names in (("Rooms of one file", singles), ("Ground", ground())):
        text += f"\n### {title}\n\n{files_table([ROOT / 'pgcp' / f'{name}.py' for name in names])}"
    return text


def name_in(path: Path) -> str:
    """Path of a file from the top of the repository."""
    return path.relative_to(ROOT).as_posix()


def levels(graph: nx.DiGraph) -> list[list[str]]:
    """Rooms from the top floor to the lowest: a room stands above all that it imports."""
    height: dict[str, int] = {}
    for room in reversed(list(nx.topological_sort(graph))):
        height[room] = max((height[other] + 1 for other in graph[room]), default=0)
    return [sorted(r for r in graph if height[r] == h) for h in range(max(height.values()), -1, -1)]


# The drawing ------------------------------------------------------------------------------------------------------------------

BOX, BESIDE, FLOOR, EDGE = (132, 34), 26, 74, 18
COLOURS = {"surface": "#d9ead3", "plane": "#d9ead3", "elimination": "#d9ead3", "intake": "#d9ead3", "folds": "#d9ead3"}
COLOURS |= {"partition": "#d9ead3", "runtime": "#cfe2f3", "io": "#cfe2f3"}
OTHER, INK, LINE = "#fff2cc", "#222222", "#888888"


def floors_with_bends(graph: nx.DiGraph) -> tuple[list[list[str]], list[list[str]]]:
    """Floors of rooms and bends, and arrows as chains of them: an arrow bends on every floor that it passes."""
    floors = levels(graph)
    at = {room: k for k, floor in enumerate(floors) for room in floor}
    chains = []
    for upper, lower in sorted(nx.transitive_reduction(graph).edges):
        bends = [f"{upper}>{lower}@{k}" for k in range(at[upper] + 1, at[lower])]
        for k, bend in enumerate(bends, at[upper] + 1):
            floors[k].append(bend)
        chains.append([upper, *bends, lower])
    return floors, chains


def places(floors: list[list[str]], chains: list[list[str]]) -> dict[str, float]:
    """Middle of every room and bend from left to right: near what it is joined to, in an order with few crossings."""
    joined: dict[str, list[str]] = {name: [] for floor in floors for name in floor}
    for chain in chains:
        for a, b in pairwise(chain):
            joined[a].append(b)
            joined[b].append(a)
    width = {name: (BOX[0] if "@" not in name else 14) + BESIDE for name in joined}
    middle = {name: float(200 * k) for floor in floors for k, name in enumerate(floor)}
    for _ in range(60):
        for floor in (*floors, *reversed(floors)):
            wanted = {n: sum(middle[o] for o in joined[n]) / len(joined[n]) if joined[n] else middle[n] for n in floor}
            floor.sort(key=lambda n: (wanted[n], n))
            right = left = None
            from_left, from_right = {}, {}
            for name in floor:
                from_left[name] = left = wanted[name] if left is None else max(wanted[name], left + width[name] / 2)
                left += width[name] / 2
            for name in reversed(floor):
                from_right[name] = right = wanted[name] if right is None else min(wanted[name], right - width[name] / 2)
                right -= width[name] / 2
            for name in floor:
                middle[name] = 0.5 * (from_left[name] + from_right[name])
            for a, b in pairwise(floor):
                middle[b] = max(middle[b], middle[a] + 0.5 * (width[a] + width[b]))
    shift = min(middle[n] - width[n] / 2 for n in middle)
    return {name: round(x - shift + EDGE, 1) for name, x in middle.items()}


def drawing() -> str:
    """The rooms as an SVG picture: floors, and the arrows that follow from no others."""
    floors, chains = floors_with_bends(arrows())
    across = places(floors, chains)
    down = {name: EDGE + k * FLOOR + BOX[1] / 2 for k, floor in enumerate(floors) for name in floor}
    width = round(max(x + BOX[0] / 2 for n, x in across.items()) + EDGE)
    bottom = EDGE + len(floors) * FLOOR
    height = bottom + BOX[1] + EDGE
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'font-family="sans-serif" font-size="14">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
        f'<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        f'<path d="M0 0L8 4L0 8z" fill="{LINE}"/></marker></defs>',
    ]
    for chain in chains:
        points = [(across[name], down[name]) for name in chain]
        points[0] = points[0][0], points[0][1] + BOX[1] / 2
        points[-1] = points[-1][0], points[-1][1] - BOX[1] / 2 - 2
        path = f"M{points[0][0]:g} {points[0][1]:g}"
        for (x0, y0), (x1, y1) in pairwise(points):
            bend = 0.5 * (y1 - y0)
            path += f"C{x0:g} {y0 + bend:g} {x1:g} {y1 - bend:g} {x1:g} {y1:g}"
        out.append(f'<path d="{path}" fill="none" stroke="{LINE}" stroke-width="1.3" marker-end="url(#tip)"/>')
    for name, x in sorted(across.items()):
        if "@" not in name:
            out.append(box(name, x - BOX[0] / 2, down[name] - BOX[1] / 2, BOX[0], COLOURS.get(name, OTHER), about(name)))
    label = "ground: " + "  ".join(ground())
    out.append(box(label, EDGE, bottom, width - 2 * EDGE, "#eeeeee", "imported by every room; imports no room"))
    return "\n".join([*out, "</svg>", ""])


def box(name: str, x: float, y: float, width: float, colour: str, title: str) -> str:
    """A room."""
    return (
        f'<g><title>{escape(title)}</title><rect x="{x:g}" y="{y:g}" width="{width:g}" height="{BOX[1]}" rx="6" '
        f'fill="{colour}" stroke="{INK}"/><text x="{x + width / 2:g}" y="{y + BOX[1] / 2 + 5:g}" text-anchor="middle" '
        f'fill="{INK}">{escape(name)}</text></g>'
    )


# The notebook -----------------------------------------------------------------------------------------------------------------


def notebook_cells() -> str:
    """The cells of the notebook; their language is called py, as they run in one kernel, not each by itself."""
    cells = json.loads((ROOT / "docs" / "notebook.ipynb").read_text())["cells"]
    texts = [("".join(cell["source"]), cell["cell_type"] == "code") for cell in cells]
    return "\n\n".join(f"```py\n{text}\n```" if is_code else re.sub(r"^# .*\n+", "", text) for text, is_code in texts)


# Pages ------------------------------------------------------------------------------------------------------------------------

PARTS: dict[str, Callable[[], str]] = {
    "options": options_table,
    "methods": methods_table,
    "methods-in-short": methods_in_short,
    "targets": targets_table,
    "formats": formats_table,
    "rooms": rooms_table,
    "apps": apps_table,
    "notebook": notebook_cells,
    "gallery": gallery,
}
APP = "app-"


def part(name: str) -> str:
    """A generated part by its name; that of an application is called after it."""
    return app_options(name.removeprefix(APP)) if name.startswith(APP) else PARTS[name]()


def current(text: str) -> str:
    """A page with its generated parts as they should be."""
    return PART.sub(lambda found: f"{found[1]}\n{part(found[2]).strip()}\n\n{found[3]}", text)


def stale() -> dict[Path, str]:
    """Files that are not current, with what they should hold."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    wanted = {page: current(page.read_text()) for page in pages} | {DRAWING: drawing()}
    return {path: text for path, text in wanted.items() if not path.exists() or path.read_text() != text}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; status 1 where something is not current")
    checking = parser.parse_args().check
    found = stale()
    for path, text in found.items():
        print(f"{path.relative_to(ROOT)} {'is not current' if checking else 'rewritten'}")
        if not checking:
            path.write_text(text)
    return 1 if checking and found else 0


if __name__ == "__main__":
    sys.exit(main())
