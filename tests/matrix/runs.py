"""A random run by its number: which shape, how it is asked for, and what came of it.

As a program it takes numbers of runs, a line each, and prints what came of each as a line of JSON.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from judge import Array, boundary_of, faults_of, flipped_in_plane, mean_error
from shapes import KINDS
from surfaces import Shape

from pgcp.cli.main import main as command
from pgcp.methods.registry import METHODS
from pgcp.targets.registry import TARGETS

_SALT = 17
_MOST_FACES = 50_000
_FLAT_DEG = 1e-6  # free maps of surfaces that unfold
_NEAR = 1.2  # times the exact map's mean angle error at its vertices
_ROUGH_DEG = 0.5, 30.0  # and so much more, and so much over the square root of the number of faces
_FINE = 100  # faces from which on a map is compared with that of the smooth surface
RIGHT, ELSEWHERE, FOLDED, REFUSED, FAILED, FAULT = "right", "right, another map", "marked folded", "refused", "failed", "FAULT"
OUTCOMES = (RIGHT, ELSEWHERE, FOLDED, REFUSED, FAILED, FAULT)


@dataclass(frozen=True, slots=True)
class Case:
    """A run: its number, the shape, what was done to it, the target, the words of the command, and whether it must fit.

    kind: of the shape; beside: whether the command runs in a process of its own.
    """

    number: int
    kind: str
    shape: Shape
    target: str
    method: str
    words: tuple[str, ...]
    fits: bool
    beside: bool

    def told(self) -> dict[str, Any]:
        """What it is, as plain data."""
        what = {"kind": self.kind, "faces": len(self.shape.faces), "vertices": len(self.shape.vertices)}
        return {
            "run": self.number,
            **what,
            "what": {k: str(v) for k, v in self.shape.what.items()},
            "words": " ".join(self.words),
        }


def _changed(shape: Shape, random: np.random.Generator) -> Shape:
    """The shape with, now and then, other units, another place, another numbering, or coordinates of fewer digits."""
    points, faces, what = shape.vertices, shape.faces, dict(shape.what)
    knows: dict[str, Any] = {}
    image = shape.image
    change = random.random()
    if change < 0.04:
        points, what["unit"] = points * 10.0 ** (p := random.integers(-120, 120)), f"1e{p}"
    elif change < 0.08:
        far = 10.0 ** random.integers(2, 6)
        points, what["far"], knows = points + far * np.abs(points).max(), f"{far:.0e}", {"is_flat": False}
    elif change < 0.12:
        points, what["single"], knows = points.astype(np.float32).astype(np.float64), True, {"is_flat": False}
    elif change < 0.16:
        long, axis = 10.0 ** random.uniform(0, 3), random.integers(3)
        points, what["stretched"], knows = (
            points * np.where(np.arange(3) == axis, long, 1),
            f"{long:.3g} along {axis}",
            {"is_flat": False},
        )
        image = None
    elif change < 0.19:
        step = np.ptp(points, axis=0).max() / 10.0 ** random.uniform(0.7, 3)
        points, what["rounded to"], knows = np.round(points / step) * step, f"{step:.3g}", {"is_flat": False}
        image = None
    if random.random() < 0.2:
        order = random.permutation(len(points))
        turn = random.integers(0, 3, len(faces))[:, None]
        faces = np.argsort(order)[faces][np.arange(len(faces))[:, None], (turn + np.arange(3)) % 3]
        points, faces = points[order], random.permutation(faces)
        image, what["renumbered"] = None if image is None else image[order], True
    if random.random() < 0.05:  # vertices that no face uses
        points, what["unused"] = np.vstack([points, points[:2] + 1]), True
        image = None if image is None else np.vstack([image, image[:2]])
    return replace(shape, vertices=points, faces=faces, what=what, image=image, **knows)


def _asked(shape: Shape, random: np.random.Generator) -> tuple[str, str, list[str]]:
    """Target, method and options."""
    targets = [target.name for target in TARGETS.all() if target.space.closed == shape.closed]
    target = str(random.choice(targets))
    able = [m.name for m in METHODS.all() if m.targets is None or target in m.targets]
    method = "pgcp" if random.random() < 0.45 else str(random.choice(able))
    words = ["--target", target, "--method", method]
    if random.random() < 0.5:
        words += ["--patches", str(min(int(random.choice([1, 2, 3, 5, 8, 12])), len(shape.faces)))]
    choices = {
        "--seams": ("relax", "exact") if METHODS.get(method).chooses_seams else (),
        "--moebius": ("none", "area", "angle"),
        "--flatten": ("scp",),
        "--polish": ("none", "angles", "auto"),
        "--backend": ("superlu", "pardiso"),
        "--seed": ("1", "2", "3"),
        "--centre": (str(random.choice(shape.faces[random.integers(len(shape.faces))])),)
        if TARGETS.get(target).has_centre
        else (),
    }
    for word, values in choices.items():
        if values and random.random() < 0.12:
            words += [word, str(random.choice(values))]
    if TARGETS.get(target).has_free_boundary and random.random() < 0.1:
        words += ["--no-overlap"]
    if "--centre" in words and "--moebius" in words and TARGETS.get(target).centre_is_all:
        words[words.index("--moebius") + 1] = "none"
    if "relax" in words and shape.closed:
        words[words.index("relax")] = "exact"
    return target, method, words


def case_of(number: int) -> Case:
    """The run of a number: the same each time, as long as the kinds of shapes, methods and targets are the same."""
    of_shape, of_run = (np.random.default_rng([_SALT, number, k]) for k in range(2))
    kind = str(of_shape.choice(sorted(KINDS)))
    faces = max(1, int(_MOST_FACES ** (of_shape.random() ** 1.4)))
    shape = _changed(KINDS[kind](of_shape, faces), of_shape)
    target, method, words = _asked(shape, of_run)
    fits = True
    if of_run.random() < 0.02:  # a target for other surfaces
        target = str(of_run.choice([t.name for t in TARGETS.all() if t.space.closed != shape.closed]))
        words, method, fits = ["--target", target], "pgcp", False
    beside = bool(of_run.random() < 0.03)
    if beside and of_run.random() < 0.5:
        words += ["--workers", "2"]
    return Case(number, kind, shape, target, method, tuple(words), fits, beside)


def _write(path: Path, shape: Shape) -> None:
    """The mesh as a PLY file of doubles, by this file's own code."""
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(shape.vertices)}\n"
    head += "".join(f"property double {axis}\n" for axis in "xyz")
    head += f"element face {len(shape.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.empty(len(shape.faces), np.dtype([("n", "u1"), ("v", "<i4", 3)]))
    rows["n"], rows["v"] = 3, shape.faces
    path.write_bytes(head.encode() + shape.vertices.astype("<f8").tobytes() + rows.tobytes())


def _called(case: Case, words: list[str], folder: Path) -> tuple[int, str]:
    """Run the command; returns its status and what it says on standard error."""
    if case.beside:
        program = [sys.executable, "-W", "always", "-m", "pgcp", *words]
        done = subprocess.run(program, capture_output=True, text=True, check=False, timeout=900)
        return done.returncode, done.stderr
    said, kept = io.StringIO(), os.dup(2)
    with (folder / "stderr").open("w+") as stream, warnings.catch_warnings():  # libraries print there by themselves
        warnings.simplefilter("always")
        os.dup2(stream.fileno(), 2)
        try:
            with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
                status = command(words)
        finally:
            os.dup2(kept, 2)
            os.close(kept)
        stream.seek(0)
        return status, said.getvalue() + stream.read()


def run(case: Case) -> dict[str, Any]:
    """Do a run; returns what it was, its outcome, what is wrong, seconds and mean angle error."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        out, temporary = folder / "out", folder / "temporary"
        temporary.mkdir()
        _write(folder / "m.ply", case.shape)
        before, tempfile.tempdir = tempfile.tempdir, str(temporary)
        environment, os.environ["TMPDIR"] = os.environ.get("TMPDIR"), str(temporary)
        start = time.perf_counter()
        try:
            words = [
                str(folder / "m.ply"),
                *case.words,
                "--output-dir",
                str(out),
                "--write",
                "npz,ply",
                "--no-png",
                "--json",
                "--quiet",
            ]
            status, said = _called(case, words, folder)
        finally:
            tempfile.tempdir = before
            os.environ.pop("TMPDIR")
            if environment is not None:
                os.environ["TMPDIR"] = environment
        seconds = time.perf_counter() - start
        left = sorted(path.name for path in temporary.iterdir())
        outcome, faults, error = _judged(case, status, said.replace(name, ""), out)
        if left:
            faults.append(f"left behind: {', '.join(left)}")
        if (folder / "m_pgcp").exists() or (status in (1, 2) and out.exists()):
            faults.append("files of a run that was refused")
        shutil.rmtree(out, ignore_errors=True)
    told = {"outcome": FAULT if faults else outcome, "faults": faults, "said": said.replace(name, "").strip()[:400]}
    return {**case.told(), **told, "status": status, "seconds": round(seconds, 2), "error": error}


def _judged(case: Case, status: int, said: str, out: Path) -> tuple[str, list[str], float | None]:
    """The outcome, what is wrong, and the mean angle error where there is a map."""
    if status in (2, 3) and not out.exists():
        faults = [] if said.count("\n") == 1 and said.startswith("pgcp-run: ") else ["not one sentence"]
        is_centre = "--centre" in case.words and "cannot be the centre" in said
        if status == 2 and case.fits and "rounded to" not in case.shape.what and not is_centre:
            faults.append("refused, though it fits")
        return (REFUSED if status == 2 else FAILED), faults, None
    if status not in (0, 3):
        return FAULT, [f"status {status}"], None
    report = json.loads((out / "report.json").read_text())
    faces, target = case.shape.faces, report["target"]
    with np.load(out / "m.npz") as data:
        coordinates = data["sphere" if target == "sphere" else "uv"]
        faults = [f"{name} has numbers that are not finite" for name in data if not np.isfinite(data[name]).all()]
        if not np.array_equal(data["faces"], faces):
            faults.append("other faces")
    used = np.unique(faces)
    found = faults_of(coordinates[used], np.searchsorted(used, faces), target, np.arange(len(used)))
    error = round(mean_error(case.shape.vertices, faces, coordinates), 9)
    if status == 3:
        faults += [] if said.count("\n") == 1 and "folded" in said else ["not one sentence"]
        faults += [] if any("folds" in fault for fault in found) else ["marked folded, but there are no folds"]
        return FOLDED, faults, error
    faults += [*found, *_faults_of_file(out / "m.ply", target, report["texture"].get("folds", 0))]
    faults += ["said something"] if said else []
    fallback = report["fallback"]
    if not fallback or target == case.target:
        faults += _inexact(case, target, error)
    return (ELSEWHERE if fallback else RIGHT), faults, error


def _faults_of_file(path: Path, target: str, told: int) -> list[str]:
    """Folds of a PLY file's texture coordinates, more than are told; those of a sphere are cut and are not looked at."""
    if target == "sphere":
        return []
    from plyfile import PlyData

    data = PlyData.read(str(path))
    points = np.column_stack([data["vertex"]["s"], data["vertex"]["t"]]).astype(np.float64)
    folds = flipped_in_plane(points, np.vstack(data["face"]["vertex_indices"]))
    return [f"{folds} folds in the PLY file, {told} told"] if folds > told else []


def _inexact(case: Case, target: str, error: float) -> list[str]:
    """Whether a map is worse than the exact map that is known, where the run is asked for a good one."""
    shape, words = case.shape, case.words
    if "angle" in words or "area" in words or "angles" in words:
        return []
    if target == "free" and shape.is_flat and error > _FLAT_DEG:
        return [f"a surface that unfolds has a mean error of {error} degrees"]
    if (
        "--moebius" in words
        or shape.image is None
        or len(shape.faces) < _FINE
        or case.method != "pgcp"
        or {"scp", "relax"} & set(words)
    ):
        return []
    most = (
        _NEAR * mean_error(shape.vertices, shape.faces, shape.image) + _ROUGH_DEG[0] + _ROUGH_DEG[1] / np.sqrt(len(shape.faces))
    )
    return [f"mean error {error:.3f} degrees, the exact map's allows {most:.3f}"] if error > most else []


def main() -> None:
    """Answer numbers, until there are no more, with what the run is and then with what came of it."""
    for line in sys.stdin:
        case = case_of(int(line))
        print(json.dumps(case.told()), flush=True)
        print(json.dumps(run(case)), flush=True)


if __name__ == "__main__":
    main()


__all__ = ["OUTCOMES", "Array", "boundary_of", "case_of", "run"]
