"""The report page of a finished map: one HTML file that needs nothing else, with the surface and its map to look at.

The views are drawn by WebGL, in scripts of this folder's ``templates``. trimesh carries three.js, but its versions carry
unlike ones under no stable name, and a page needs so little of it that its own scripts are shorter than what would be cut out.
"""

from __future__ import annotations

import re
import shlex
from dataclasses import replace
from importlib.resources import files
from typing import Any

import jinja2
import numpy as np

from pgcp.options import Options, Running, plain_options
from pgcp.report.chart import linear_axis
from pgcp.report.picture import angle_histogram
from pgcp.report.scene import MOST_FACES, Packed, packed, scene_of
from pgcp.report.seen import COLD_WARM, DARK, HEAT, LIGHT
from pgcp.report.timeline import timeline
from pgcp.report.words import counted, course
from pgcp.targets.registry import TARGETS
from pgcp.types import FloatArray, Parameterization

_MODES = (("checker", "Checkerboard"), ("angle", "Angle error"), ("area", "Area"), ("patch", "Patches"), ("plain", "Plain"))
_HINT = "Drag turns the surface, the wheel zooms, a double click resets. Point at a face to see it in both."
_TINY, _SMALL = 1e-300, 1e-60
_WIDTH, _BASE, _HEIGHT, _LEFT = 520.0, 220.0, 265.0, 14.0


def page(result: Parameterization, command: tuple[str, ...] = (), most: int = MOST_FACES, is_framed: bool = False) -> bytes:
    """The page in UTF-8. command: the words that made the map; most: faces that are drawn, of more those of clusters.

    is_framed: whether it stands in a frame of another page, with less room around it.
    """
    result = _of_moderate_size(result)
    scene = scene_of(result, most)
    closed = TARGETS.get(result.target).space.closed
    shown = packed(result, scene)
    look = {"heat": HEAT, "cold_warm": COLD_WARM, "dark": DARK.tolist(), "light": LIGHT.tolist()}
    fewer = len(scene.faces) < len(result.mesh.faces)
    values = {
        **_said(result),
        "modes": _MODES,
        "is_framed": is_framed,
        "map_caption": "the map on the unit sphere" if closed else "the map",
        "heat": _gradient(HEAT),
        "cold_warm": _gradient(COLD_WARM),
        "angle_limit": f"{result.quality.angle_p99_deg:.3g}",
        "area_limit": f"{2.0 ** shown.head['area_limit']:.4g}",
        "hint": _HINT,
        "fewer": f"Drawn with {len(scene.faces):,} of {len(result.mesh.faces):,} faces; figures are of all." if fewer else "",
        "histogram": _histogram(result),
        "timeline": timeline(result.report),
        "words": course(result),
        "command": shlex.join(_printable(word) for word in command) or _call(result),
        "style": _part("page.css"),
        "script": _part("view.js") + _part("page.js"),
        "scene": Packed({**shown.head, **look}, shown.text),
    }
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    return environment.from_string(_part("page.html.jinja")).render(values).encode()


def _part(name: str) -> str:
    """A file of the page."""
    return files("pgcp.report").joinpath("templates", name).read_text(encoding="utf-8")


def _of_moderate_size(result: Parameterization) -> Parameterization:
    """The same map, of a surface whose areas are neither too large nor too small for doubles."""
    points, image = (_moderate(values) for values in (result.mesh.vertices, result.coordinates))
    if points is result.mesh.vertices and image is result.coordinates:
        return result
    return replace(result, mesh=replace(result.mesh, vertices=points), coordinates=image)


def _moderate(points: FloatArray) -> FloatArray:
    """Points as they are, or where their extent is far from 1, in units of it."""
    size = max(float(np.ptp(points)), _TINY)
    return points if _SMALL < size < 1.0 / _SMALL else points / size


def _printable(text: str) -> str:
    """Text of a file name, which may hold bytes that are no text, as it can stand in a page."""
    return text.encode("utf-8", "replace").decode()


def _call(result: Parameterization) -> str:
    """The call from Python that makes such a map, with the options that are not the usual ones."""
    asked, usual = result.report.get("options", {}), {**plain_options(Options()), **plain_options(Running())}
    named = [f"{name}={value!r}" for name, value in asked.items() if not _is_usual(value, usual.get(name))]
    return _printable(f"pgcp.parameterize({', '.join([repr(result.mesh.name), *named])})")


def _is_usual(value: Any, usual: Any) -> bool:
    """Whether an option has its usual value; a saved result has lists where there were tuples."""
    return bool(value == (list(usual) if isinstance(value, list) and usual else usual))


def _said(result: Parameterization) -> dict[str, Any]:
    """Words and figures of a map."""
    q, report, target = result.quality, result.report, TARGETS.get(result.target)
    count = int(result.patch.max()) + 1
    stages = report.get("stages", [])
    seconds = f" in {sum(stage['seconds'] for stage in stages):.1f} s" if stages else ""
    options, versions = report.get("options", {}), report.get("versions", {})
    method = f", by the method {options['method']}" if "method" in options else ""
    place = re.split("[:;]", target.summary)[0]
    sizes = f"{len(result.mesh.vertices):,} vertices and {len(result.mesh.faces):,} faces"
    figures = [
        (f"{q.angle_mean_deg:.3g}°", "mean angle error"),
        (f"{q.angle_p99_deg:.3g}°", "99 % of corners below"),
        (f"{q.angle_max_deg:.3g}°", "largest angle error"),
        (f"{q.mu_max:.3g}", "largest Beltrami coefficient"),
        (f"{q.folds:,}", "folds"),
    ]
    return {
        "name": _printable(result.mesh.name),
        "folds": q.folds,
        "lead": f"{sizes}, mapped to {place}{method}, in {counted(count, 'patch', 'patches')}{seconds}.",
        "state": f"The map has {counted(q.folds, 'fold', 'folds')}." if q.folds else "It has no folds.",
        "figures": figures,
        "quality": _quality(result),
        "patch_caption": f"{counted(count, 'patch', 'patches')}, each in a colour of its own.",
        "made_by": ", ".join(f"{name} {version}" for name, version in versions.items()),
    }


def _quality(result: Parameterization) -> list[tuple[str, str]]:
    """The table of quality: what a figure means, and the figure."""
    q = result.quality
    rows = [
        ("|angle in the map - angle on the surface|, mean", f"{q.angle_mean_deg:.4f}°"),
        ("standard deviation", f"{q.angle_sd_deg:.4f}°"),
        ("median", f"{q.angle_median_deg:.4f}°"),
        ("99 % of all corners have less", f"{q.angle_p99_deg:.4f}°"),
        ("largest", f"{q.angle_max_deg:.4f}°"),
        ("|Beltrami coefficient|, mean", f"{q.mu_mean:.4g}"),
        ("largest", f"{q.mu_max:.4g}"),
        ("|log of the area ratio|, mean", f"{q.log_area_mean:.4g}"),
        ("folds", f"{q.folds:,}"),
    ]
    if q.degree is not None:
        rows.append(("how often the sphere is covered", f"{q.degree:.0f}"))
    if q.conformal_energy is not None:
        rows.append(("conformal energy", f"{q.conformal_energy:.4g}"))
    return rows


def _histogram(result: Parameterization) -> dict[str, Any]:
    """The histogram of angle errors as shapes."""
    counts, limit, step = angle_histogram(result)
    axis, width = linear_axis(0.0, limit, (0.0, 0.0)), _WIDTH - 2.0 * _LEFT
    most, wide = max(int(counts.max()), 1), width / len(counts)
    heights = counts * ((_BASE - 14.0) / most)
    bars = [
        {"x": f"{_LEFT + k * wide:.2f}", "y": f"{_BASE - high:.2f}", "width": f"{0.9 * wide:.2f}", "height": f"{high:.2f}"}
        for k, high in enumerate(heights.tolist())
        if high
    ]
    mean = result.quality.angle_mean_deg
    sample = "corners" if step == 1 else f"corners of one face in {step}"
    return {
        "width": _WIDTH,
        "height": _HEIGHT,
        "base": _BASE,
        "bars": bars,
        "mean": f"{_LEFT + width * mean / limit:.2f}" if mean < limit else None,
        "ticks": [
            {"x": f"{_LEFT + width * at / limit:.2f}", "label": f"{label}°"}
            for at, label in zip(axis.ticks, axis.labels, strict=True)
        ],
        "caption": f"|angle error|: {sample}; the line is the mean",
    }


def _gradient(stops: tuple[tuple[float, float, float], ...]) -> str:
    """Colours as a CSS gradient."""
    colours = (f"rgb({' '.join(str(round(255 * part)) for part in stop)})" for stop in np.asarray(stops).tolist())
    return f"linear-gradient(to right, {', '.join(colours)})"
