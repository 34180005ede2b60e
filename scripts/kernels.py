"""Write the list of compiled functions, pgcp/runtime/kernels.txt, in the order in which runs come to need them.

scripts/kernels.py            write the list: maps small meshes by every target and method, compiling all anew; takes minutes
scripts/kernels.py --check    compile the list, make the same maps, and name what they compile beyond it; status 1 if any
"""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import tempfile
from contextlib import redirect_stdout
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LIST = ROOT / "pgcp" / "runtime" / "kernels.txt"


def compiled_by(command: list[str]) -> list[str]:
    """Functions of this package with their types, in order, that a run of the command compiles where nothing is compiled."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        words = [sys.executable, __file__, "--listen", *command]
        return subprocess.run(words, env=environment, stdout=subprocess.PIPE, text=True, check=True).stdout.splitlines()


def listen(commands: list[list[str]]) -> None:
    """Run commands in this process, and print what is compiled."""
    from numba.core import event

    from pgcp.cli.main import main
    from pgcp.parallel import limited_to
    from pgcp.surface import plain

    plain.FEW = 0  # small meshes stand for large ones here
    depth = 0

    class Listener(event.Listener):
        def on_start(self, said):
            nonlocal depth
            depth += 1

        def on_end(self, said):
            nonlocal depth
            depth -= 1
            function = said.data["dispatcher"].py_func
            if depth == 0 and function.__module__.startswith("pgcp."):
                print(function.__module__, function.__qualname__, said.data["args"])

    event.register("numba:compile", Listener())
    with limited_to(1):  # otherwise other processes would compile some
        for command in commands:
            main(command)


def meshes(folder: Path) -> dict[str, Path]:
    """Small meshes on disk: open, closed, with a hole, and one so rough that its map folds."""
    import numpy as np
    from scipy.spatial import ConvexHull

    import pgcp
    from pgcp.surface.demo import demo_mesh

    random, made = np.random.default_rng(0), {}
    made["open"] = demo_mesh(24)
    made["rough"] = pgcp.Mesh(made["open"].vertices + random.normal(0, 0.2, made["open"].vertices.shape), made["open"].faces)
    points = random.normal(size=(900, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    faces = ConvexHull(points).simplices
    first, second, third = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(second - first, third - first), first) < 0
    faces[inward] = faces[inward][:, ::-1]
    made["closed"] = pgcp.Mesh(points * [1, 1, 2], faces)
    made["spiky"] = pgcp.Mesh(points * random.uniform(0.3, 1, (900, 1)), faces)
    made["holed"] = pgcp.Mesh(points, np.delete(faces, [0, 400], axis=0))
    paths = {name: folder / f"{name}.ply" for name in made}
    for name, mesh in made.items():
        pgcp.write_mesh(paths[name], mesh)
    return paths


def commands(folder: Path) -> list[list[str]]:
    """Runs that need all that is compiled: the usual ones first."""
    from pgcp.methods.registry import METHODS
    from pgcp.options import MOEBIUS, SEAMS
    from pgcp.targets.registry import TARGETS

    place = {name: str(path) for name, path in meshes(folder).items()}
    shapes = {target: "closed" if target == "sphere" else "open" for target in TARGETS.names()}
    out = [["--demo"], [place["open"], "--target", "disk"], [place["closed"]], [place["holed"], "--fix"]]
    for target, shape in shapes.items():
        out += [[place[shape], "--target", target, "--seams", seams, "--patches", "4"] for seams in SEAMS]
        out += [[place[shape], "--target", target, "--moebius", moebius] for moebius in MOEBIUS]
        out += [[place[shape], "--target", target, "--backend", "superlu", "--patches", patches] for patches in ("1", "4")]
        for method in METHODS.all():
            if method.targets is None or target in method.targets:
                out.append([place[shape], "--target", target, "--method", method.name, "--patches", "4"])
    out += [[place["rough"], "--target", target] for target, shape in shapes.items() if shape == "open"]
    return [*out, [place["spiky"]], [place["open"], "--flatten", "scp"]]


def check(folder: Path) -> int:
    """Print what is compiled beyond the list; returns the exit status."""
    from pgcp.runtime.compiled import compile_kernel, kernels

    for kernel in kernels():
        compile_kernel(kernel)
    out = io.StringIO()
    with redirect_stdout(out):
        listen([[*command, "--quiet", "--output-dir", str(folder / "out")] for command in commands(folder)])
    print(out.getvalue(), end="")
    return 1 if out.getvalue() else 0


def lines(folder: Path) -> list[str]:
    """The list: usual runs that need a function, the function, the types of its arguments."""
    found: dict[str, list[str]] = {}
    end = ["--quiet", "--output-dir", str(folder / "out")]
    usual, others = commands(folder)[:3], commands(folder)
    for name, command in zip(("free", "disk", "sphere"), usual, strict=True):
        for function in compiled_by([*command, *end]):
            found.setdefault(function, []).append(name)
    (folder / "commands.json").write_text(json.dumps([[*command, *end] for command in others]))
    for function in compiled_by([str(folder / "commands.json")]):
        found.setdefault(function, ["others"])
    return [f"{','.join(runs)} {function}\n" for function, runs in found.items()]


def main() -> int:
    if sys.argv[1:2] == ["--listen"]:
        words = sys.argv[2:]
        listen(json.loads(Path(words[0]).read_text()) if words[0].endswith(".json") else [words])
        return 0
    with tempfile.TemporaryDirectory() as folder:
        if sys.argv[1:] == ["--check"]:
            return check(Path(folder))
        LIST.write_text("".join(lines(Path(folder))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
