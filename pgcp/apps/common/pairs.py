"""Two meshes that an application is given: refused before any is mapped where they do not correspond, else mapped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pgcp.api import surface_of
from pgcp.apps.base import Call, Group, add_mesh
from pgcp.apps.common.matching import MOEBIUS, ROTATION, checked_landmarks
from pgcp.errors import BadFileError, InputError
from pgcp.intake.chosen import inspected
from pgcp.intake.given import ALL
from pgcp.io.read import read_pairs
from pgcp.options import Options
from pgcp.result import Result
from pgcp.targets.fitting import Asked
from pgcp.targets.registry import TARGETS
from pgcp.types import IntArray, Mesh, Source


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two surfaces as they were read: what each is mapped from, how many vertices it has, its name, and where both go."""

    sources: tuple[Mesh | Source, Mesh | Source]
    counts: tuple[int, int]
    names: tuple[str, str]
    target: str

    def mapped(self, call: Call) -> tuple[Result, Result]:
        """Both maps."""
        first, second = (call.mapped(source, self.target) for source in self.sources)
        return first, second


def add_pair(group: Group) -> None:
    """Add arguments for two meshes, and for landmarks on them."""
    add_mesh(group, "a", "file of the first mesh")
    add_mesh(group, "b", "file of the second mesh")
    group.add_argument(
        "--landmarks", type=Path, metavar="FILE",
        help="pairs of vertices that correspond, one a line: a number of the first mesh and one of the second, both from 0; "
        "the maps are brought into line by them alone",
    )  # fmt: skip
    group.add_argument(
        "--fit", choices=(MOEBIUS, ROTATION), default=MOEBIUS,
        help="what landmarks decide: the whole Moebius map (of three pairs and more, of two between open surfaces), or the "
        f"turn of the centred maps alone (of two and more, or one); default {MOEBIUS}",
    )  # fmt: skip


def pair_of(one: Any, other: Any, options: Options) -> Pair:
    """Two surfaces, from paths or objects; raises InputError where one cannot be mapped, or one is closed and one is not."""
    if options.component == ALL:
        raise InputError("component all is several surfaces; two that correspond are one each")
    sources, counts, names, kinds = [], [], [], []
    for given in (one, other):
        surface = surface_of(given)
        mesh = surface.cut.mesh
        _, seen = inspected(mesh, Asked(), options, surface.named)
        topology, _ = seen.accepted()
        sources.append(mesh if surface.source is None else surface.source)
        counts.append(len(mesh.vertices))
        names.append(mesh.name)
        kinds.append(topology.is_sphere)
    if kinds[0] != kinds[1]:
        said = [f"{name} is {'closed' if closed else 'open'}" for name, closed in zip(names, kinds, strict=True)]
        raise InputError(f"{said[0]} and {said[1]}; only two closed surfaces, or two open ones, correspond")
    target = next(t.name for t in TARGETS.all() if t.space.closed == kinds[0] and not t.has_free_boundary)
    return Pair((sources[0], sources[1]), (counts[0], counts[1]), (names[0], names[1]), target)


def landmarks_of(path: Path | None, pair: Pair, fit: str) -> IntArray | None:
    """Landmarks (n, 2) of a file, in the input's numbers; raises BadFileError or InputError for what are none."""
    if path is None:
        return None
    if not path.is_file():
        raise InputError(f"{path}: there is no such file of landmarks")
    closed = TARGETS.get(pair.target).space.closed
    try:
        return checked_landmarks(read_pairs(path, "landmarks"), pair.counts, pair.names, closed, fit)
    except BadFileError:
        raise
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from problem


def landmarks_now(landmarks: IntArray | None, maps: Sequence[Result]) -> IntArray | None:
    """Landmarks in the numbers of the maps; raises InputError where one is on no face that was mapped."""
    if landmarks is None:
        return None
    columns = []
    for column, result in zip(landmarks.T, maps, strict=True):
        of_vertex = np.arange(len(result.mesh.vertices)) if result.vertex_of is None else result.vertex_of
        used = np.unique(result.faces)
        now = np.full(max(int(of_vertex.max()), int(column.max())) + 1, -1)
        now[of_vertex[used]] = used
        lost = np.flatnonzero(now[column] < 0)
        if len(lost):
            raise InputError(
                f"vertex {int(column[lost[0]])} of {result.mesh.name} is a landmark, but no face that is mapped has it"
            )
        columns.append(now[column])
    return np.column_stack(columns)
