"""Stages and tasks over time, with memory, as shapes that the report page draws."""

from __future__ import annotations

import colorsys
from typing import Any

from pgcp.report.chart import linear_axis

_WIDTH, _LEFT, _RIGHT, _ROW, _GAP, _MEMORY = 1140.0, 110.0, 20.0, 22.0, 7.0, 70.0
_LEAST = 0.6  # width of a bar
_LEAST_S = 0.005  # of a stage that the key names
_MOST_ROWS, _MOST_TASKS = 64, 4000


def timeline(report: dict[str, Any]) -> dict[str, Any] | None:
    """Rows of bars: the stages, and below them each worker with its tasks; then memory. None of a report without stages."""
    stages = [stage for stage in report.get("stages", []) if "begin" in stage]
    if not stages:
        return None
    known = sorted(report.get("timeline", []), key=lambda task: -float(task["seconds"]))
    tasks = [{**task, "begin": max(task["begin"], 0.0)} for task in known[:_MOST_TASKS]]
    ends = [entry["begin"] + entry["seconds"] for entry in (*stages, *tasks)]
    axis = linear_axis(0.0, max(*ends, 1e-3), (0.0, 0.0), 8)
    per_second = (_WIDTH - _LEFT - _RIGHT) / axis.high
    names = list(dict.fromkeys(entry[key] for entries, key in ((stages, "name"), (tasks, "stage")) for entry in entries))
    colours = {name: _colour(k) for k, name in enumerate(names)}

    def bar(name: str, begin: float, seconds: float, where: str = "") -> dict[str, Any]:
        """A bar of a stage or a task."""
        x, width = _LEFT + begin * per_second, max(seconds * per_second, _LEAST)
        title = f"{name}{where}: {seconds:.3g} s, from {begin:.2f} s"
        return {"x": round(x, 2), "width": round(width, 2), "colour": colours[name], "title": title}

    lanes = [("stages", [bar(s["name"], s["begin"], s["seconds"]) for s in stages])]
    for label, own in _lanes(tasks):
        lanes.append((label, [bar(t["stage"], t["begin"], t["seconds"], f" on {label}") for t in own]))
    rows = []
    for k, (label, bars) in enumerate(lanes[:_MOST_ROWS]):
        y = k * (_ROW + _GAP)
        rows.append({"label": label, "bars": bars, "y": y, "middle": y + _ROW / 2, "height": _ROW})
    base = len(rows) * (_ROW + _GAP)
    memory = _memory(stages, per_second, base + 20.0)
    base += _MEMORY + 24.0 if memory else 0.0
    ticks = [
        {"x": round(_LEFT + at * per_second, 2), "label": f"{label} s"}
        for at, label in zip(axis.ticks, axis.labels, strict=True)
    ]
    used = {name: sum(stage["seconds"] for stage in stages if stage["name"] == name) for name in names}
    within = {task["stage"] for task in tasks}
    key = [
        {"label": f"{name} {used[name]:.2f} s" if used[name] else f"{name}, beside others", "colour": colours[name]}
        for name in names
        if used[name] >= _LEAST_S or name in within
    ]
    return {
        "width": _WIDTH, "height": base + 28.0, "base": base, "left": _LEFT,
        "rows": rows, "ticks": ticks, "key": key, "memory": memory,
        "left_out": _left_out(len(known) - len(tasks), len(lanes) - len(rows)),
    }  # fmt: skip


def _left_out(tasks: int, rows: int) -> str:
    """What is not shown, in a sentence."""
    few = [f"the {tasks:,} shortest tasks"] * (tasks > 0) + [f"{rows:,} more workers"] * (rows > 0)
    return f"Not shown: {' and '.join(few)}." if few else ""


def _lanes(tasks: list[dict[str, Any]]) -> list[tuple[str, list[dict[str, Any]]]]:
    """Tasks by worker; those of this process, which has threads, in as few rows as they need."""
    workers = sorted({task["worker"] for task in tasks})
    own: dict[int, list[dict[str, Any]]] = {worker: [] for worker in workers}
    for task in sorted(tasks, key=lambda task: float(task["begin"])):
        own[task["worker"]].append(task)
    out = []
    for worker in workers:
        rows: list[list[dict[str, Any]]] = []
        for task in own[worker]:
            free = (row for row in rows if row[-1]["begin"] + row[-1]["seconds"] <= task["begin"] + 1e-4)
            row = next(free, None)
            if row is None:
                rows.append([task])
            else:
                row.append(task)
        what = "thread" if worker == 0 else "worker"
        out += [(f"{what} {k + 1 if worker == 0 else worker}", row) for k, row in enumerate(rows)]
    return out


def _memory(stages: list[dict[str, Any]], per_second: float, top: float) -> dict[str, Any] | None:
    """The largest resident size of a process so far, as steps."""
    known = [stage for stage in stages if stage["peak_bytes"]]
    if not known:
        return None
    most, base = max(stage["peak_bytes"] for stage in known), top + _MEMORY
    path, x = [f"M{_LEFT:.1f} {base:.1f}"], _LEFT
    for stage in known:
        y, end = base - _MEMORY * stage["peak_bytes"] / most, _LEFT + (stage["begin"] + stage["seconds"]) * per_second
        path.append(f"V{y:.1f}H{max(end, x):.1f}")
        x = max(end, x)
    label = f"{most / 1e9:.2f} GB" if most >= 1e9 else f"{most / 1e6:.0f} MB"
    text = f"{label}, the largest size of one process so far"
    return {"path": "".join(path) + f"V{base:.1f}Z", "middle": top + _MEMORY / 2, "x": round(x, 1), "y": top, "label": text}


def _colour(k: int) -> str:
    """Colours that differ from those before, of the same strength, for light and dark pages."""
    r, g, b = colorsys.hls_to_rgb((0.58 + 0.381966 * k) % 1.0, 0.58 if k % 2 else 0.48, 0.42)
    return f"#{round(r * 255):02x}{round(g * 255):02x}{round(b * 255):02x}"
