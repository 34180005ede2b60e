"""``--compare``: one table of the maps of several methods, printed and written."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from pgcp.cli.progress import Silent
from pgcp.cli.terminal import GOOD, NUMERICAL, say
from pgcp.options import Options, Running

_ALL = ("all",)


def compared(arguments: argparse.Namespace, options: Options, running: Running, shown: Silent) -> int:
    """Map a mesh by several methods, say how good the maps are; returns the exit status: good where one of them is.

    The folder of the results gets the table as ``compare.md`` and ``compare.json``, and the picture ``compare.png``.
    """
    from pgcp.api import as_mesh, compare
    from pgcp.io.files import claimed, replacing_together
    from pgcp.io.read import stem_of
    from pgcp.report.comparison import as_markdown, as_picture, as_text, best_of, records
    from pgcp.surface.demo import demo_mesh

    mesh = demo_mesh() if arguments.mesh is None else as_mesh(arguments.mesh)
    stem = "demo" if arguments.mesh is None else stem_of(arguments.mesh)
    directory: Path = arguments.output_dir or (Path() if arguments.mesh is None else arguments.mesh.parent) / f"{stem}_pgcp"
    with claimed(directory):
        methods = None if arguments.compare == _ALL else arguments.compare
        rows = compare(mesh, methods, options, running, shown)
        shown("draw", 0, 0)
        picture = None if arguments.no_png else as_picture(rows)
        shown("draw", 1, 1)
        with replacing_together(directory) as files:
            files.open("compare.md").write(as_markdown(rows).encode())
            files.open("compare.json").write(json.dumps(records(rows), indent=1).encode())
            if picture is not None:
                files.open("compare.png").write(picture)
            files.switch()
    if arguments.json:
        say(json.dumps(records(rows)))
    elif not arguments.quiet:
        say(f"{mesh.name}: angle errors in degrees\n{as_text(rows)}\n  table in {directory / 'compare.md'}")
    return GOOD if best_of(rows) else NUMERICAL
