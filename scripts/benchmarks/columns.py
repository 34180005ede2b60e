"""Tables in columns, in Markdown and in LaTeX, and bars of stages, of the scripts that measure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np


def aligned(table: Sequence[Sequence[str]]) -> str:
    """A table in columns: the first to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(w) if k == 0 else cell.rjust(w) for k, (cell, w) in enumerate(zip(line, widths, strict=True)))
        for line in table
    )


def write_tsv(path: Path, table: Sequence[Sequence[str]]) -> None:
    """A table with tabs between its columns."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join("\t".join(row) + "\n" for row in table))


def as_markdown(table: Sequence[Sequence[str]]) -> str:
    """A table in Markdown, its first row the heads."""
    lines = [table[0], ["---"] * len(table[0]), *table[1:]]
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines)


_LATEX = {"\\": r"\textbackslash{}", "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", "~": r"\textasciitilde{}"}
_LATEX |= {"^": r"\textasciicircum{}"} | {sign: f"\\{sign}" for sign in "&%$#_{}"}


def latex_text(text: str) -> str:
    """Text with what LaTeX takes for commands, and for a dash, written as signs."""
    return "".join(_LATEX.get(sign, sign) for sign in text).replace("--", r"-\/-")


def as_latex(table: Sequence[Sequence[str]]) -> str:
    """A longtable (package longtable), its first row the heads that every page repeats."""
    head, *rows = [" & ".join(map(latex_text, line)) + r" \\" for line in table]
    begin = rf"\begin{{longtable}}{{{'l' * len(table[0])}}}"
    return "\n".join([begin, r"\hline", head, r"\hline", r"\endhead", *rows, r"\hline", r"\end{longtable}"])


def draw_stacks(axes: Any, stacks: Sequence[dict[str, float]], labels: Sequence[str], unit: str = "seconds") -> None:
    """Stacked bars, one colour per part; parts that are never more than a hundredth of a bar are drawn as one."""
    from matplotlib import colormaps

    tall = max((sum(stack.values()) for stack in stacks), default=0.0)
    names = list(dict.fromkeys(name for stack in stacks for name, seconds in stack.items() if seconds > 0.01 * tall))
    floor = np.zeros(len(stacks))
    for k, name in enumerate([*names, "small parts"]):
        heights = [
            stack.get(name, 0.0) if name in names else sum(v for part, v in stack.items() if part not in names)
            for stack in stacks
        ]
        axes.bar(range(len(stacks)), heights, bottom=floor, color=colormaps["tab20"](k % 20), label=name, width=0.8)
        floor += heights
    axes.set_xticks(range(len(stacks)), labels, rotation=90, fontsize=8)
    axes.set_ylabel(unit)
    axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0))
