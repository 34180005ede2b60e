"""Several maps of one surface beside each other: a row of figures for each, the best marked, as text, Markdown or JSON."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pgcp.surface.distortion import conformal_energy
from pgcp.targets.registry import TARGETS
from pgcp.types import Parameterization

_HEAD = ("target", "method", "mean", "sd", "max", "folds", "energy", "seconds", "")
_BEST = "best"


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """What one method came to: its map and the seconds it took, or why there is none."""

    method: str
    target: str
    seconds: float
    result: Parameterization | None = None
    problem: str = ""


def best_of(rows: Sequence[Compared]) -> dict[str, Compared]:
    """For each target, the map without folds of least mean angle error."""
    out: dict[str, Compared] = {}
    for row in rows:
        if row.result is not None and not row.result.quality.folds and row.result.target == row.target:
            before = out.get(row.target)
            if before is None or before.result is None or _mean(row) < _mean(before):
                out[row.target] = row
    return out


def _mean(row: Compared) -> float:
    return float("inf") if row.result is None else row.result.quality.angle_mean_deg


def _energy(result: Parameterization) -> float | None:
    """Conformal energy of a map to the plane, in its own unit squared."""
    space = TARGETS.get(result.target).space
    return None if space.closed else float(conformal_energy(result.mesh, space.positions(result.coordinates)))


def records(rows: Sequence[Compared]) -> list[dict[str, Any]]:
    """The rows as plain data: angles in degrees, ``best`` true for the best of its target, ``problem`` where no map is."""
    best = best_of(rows)
    out: list[dict[str, Any]] = []
    for row in rows:
        record: dict[str, Any] = {"target": row.target, "method": row.method, "seconds": round(row.seconds, 3)}
        if row.result is None:
            out.append({**record, "problem": row.problem})
            continue
        quality = row.result.quality
        out.append(
            {
                **record,
                "angle_mean_deg": quality.angle_mean_deg,
                "angle_sd_deg": quality.angle_sd_deg,
                "angle_max_deg": quality.angle_max_deg,
                "folds": quality.folds,
                "energy": _energy(row.result),
                "fallback": row.result.report["fallback"],
                "best": best.get(row.target) is row,
            }
        )
    return out


def _cells(record: dict[str, Any]) -> tuple[str, ...]:
    first = (record["target"], record["method"])
    if "problem" in record:
        return (*first, "-", "-", "-", "-", "-", f"{record['seconds']:.1f}", record["problem"])
    angles = (f"{record[f'angle_{name}_deg']:.4f}" for name in ("mean", "sd", "max"))
    energy = "-" if record["energy"] is None else f"{record['energy']:.4g}"
    fallback = record["fallback"]
    note = f"instead mapped to {fallback['to']}: {fallback['reason']}" if fallback else _BEST if record["best"] else ""
    return (*first, *angles, str(record["folds"]), energy, f"{record['seconds']:.1f}", note)


def as_text(rows: Sequence[Compared]) -> str:
    """The table in columns, numbers to the right."""
    table = [_HEAD, *map(_cells, records(rows))]
    widths = [max(len(line[k]) for line in table) for k in range(len(_HEAD))]
    lines = ("  ".join(_aligned(cell, k, widths[k]) for k, cell in enumerate(line)).rstrip() for line in table)
    return "\n".join(lines)


def _aligned(cell: str, column: int, width: int) -> str:
    return cell.ljust(width) if column in (0, 1, len(_HEAD) - 1) else cell.rjust(width)


def as_picture(rows: Sequence[Compared]) -> bytes:
    """PNG bytes: a column for each row of the table, a checkerboard of its map above where its angles err, in common colours.

    The last colour stands for the largest error that 99 % of the corners of the best map of a target keep.
    """
    from pgcp.report.picture import drawn_beside

    best = best_of(rows)
    limits = [row.result.quality.angle_p99_deg for row in best.values() if row.result is not None]
    columns = [
        (f"{row.method}, {row.target}{' (best)' if best.get(row.target) is row else ''}", row.result, row.problem)
        for row in rows
    ]
    out = io.BytesIO()
    drawn_beside(columns, max([*limits, 1e-9])).save(out, "png", compress_level=4)
    return out.getvalue()


def as_markdown(rows: Sequence[Compared]) -> str:
    """The table in Markdown."""
    lines = [_HEAD, tuple("---" if k in (0, 1, len(_HEAD) - 1) else "--:" for k in range(len(_HEAD)))]
    lines += [tuple(cell.replace("|", "\\|") for cell in _cells(record)) for record in records(rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
