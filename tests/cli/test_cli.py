"""The command as a user runs it: real processes, real files, exit statuses."""

from __future__ import annotations

import json
import os
import pty
import re
import shlex
import signal
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import psutil
import pytest
from meshes import grid, lifted, spheroid, tetrahedron, torus
from said import without_progress

import pgcp
from pgcp.cli import parser
from pgcp.cli.main import main
from pgcp.cli.parser import _workers_of, build_parser
from pgcp.report.words import notes

ROOT = Path(__file__).resolve().parents[2]
COMMAND = [sys.executable, "-m", "pgcp"]


def run(*arguments, **options):
    command = [*COMMAND, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, **options)
    done.stderr = without_progress(done.stderr)
    return done


@pytest.fixture
def folder(tmp_path):
    mesh = lifted(grid(16, 12))
    pgcp.write_mesh(tmp_path / "hills.obj", mesh)
    column = np.arange(13) + 13 * 8
    (tmp_path / "cuts.txt").write_text("\n".join(f"{a} {b}" for a, b in pairwise(column.tolist())))
    (tmp_path / "bad_cuts.txt").write_text("\n".join(f"{a} {b}" for a, b in ((40, 41), (41, 54), (54, 53), (53, 40))))
    return tmp_path


def test_a_run_writes_all_results_in_the_order_of_the_file(folder):
    done = run(folder / "hills.obj", "--patches", 4)
    assert done.returncode == 0, done.stderr
    out = folder / "hills_pgcp"
    assert sorted(p.name for p in out.iterdir()) == [
        "hills.html", "hills.npz", "hills.obj", "hills.ply", "hills.png", "report.json",
    ]  # fmt: skip
    mesh = pgcp.read_mesh(folder / "hills.obj")
    with np.load(out / "hills.npz") as data:
        assert {k: (v.shape, v.dtype.kind) for k, v in data.items()} == {
            "uv": ((len(mesh.vertices), 2), "f"),
            "faces": (mesh.faces.shape, "i"),
            "patch": ((len(mesh.faces),), "i"),
            "mu": ((len(mesh.faces),), "c"),
        }
        assert np.array_equal(data["faces"], mesh.faces)
        assert data["uv"].tobytes() == pgcp.parameterize(mesh, patches=4).coordinates.tobytes()
    for name in ("hills.obj", "hills.ply"):
        assert np.array_equal(pgcp.read_mesh(out / name).faces, mesh.faces)
    assert (out / "hills.png").read_bytes().startswith(b"\x89PNG")
    report = json.loads((out / "report.json").read_text())
    assert report["status"] == "good"
    assert set(report["quality"]) == {
        "angle_mean_deg", "angle_sd_deg", "angle_median_deg", "angle_p99_deg", "angle_max_deg",
        "mu_mean", "mu_max", "folds", "log_area_mean", "degree", "conformal_energy",
    }  # fmt: skip
    assert "folds 0" in done.stdout
    assert done.stderr == ""


def test_a_closed_surface_gives_a_sphere(folder):
    mesh = spheroid(3, 2.0)[0]
    pgcp.write_mesh(folder / "egg.ply", mesh)
    done = run(folder / "egg.ply", "--patches", 4, "--centre", 5)
    assert done.returncode == 0, done.stderr
    assert "target sphere" in done.stdout
    assert "folds 0, degree 1" in done.stdout
    out = folder / "egg_pgcp"
    with np.load(out / "egg.npz") as data:
        assert set(data) == {"sphere", "faces", "patch", "mu"}
        sphere = data["sphere"]
    assert sphere.shape == (len(mesh.vertices), 3)
    assert np.abs(np.linalg.norm(sphere, axis=1) - 1).max() < 1e-14
    assert np.allclose(sphere[5], [0, 0, 1], atol=1e-12)
    again = pgcp.read_mesh(out / "egg.obj")
    assert np.array_equal(again.faces, mesh.faces)
    assert np.allclose(again.vertices, mesh.vertices, atol=1e-8)
    assert b"\nvt " in (out / "egg.obj").read_bytes()
    header = (out / "egg.ply").read_bytes()[:400].decode("ascii", "ignore")
    assert "property double sx" in header
    report = json.loads((out / "report.json").read_text())
    assert report["target"] == "sphere"
    assert report["quality"]["degree"] == pytest.approx(1.0)
    assert (out / "egg.png").read_bytes().startswith(b"\x89PNG")


def test_the_disk_has_its_boundary_on_the_circle(folder):
    assert run(folder / "hills.obj", "--target", "disk").returncode == 0
    boundary = pgcp.check_mesh(pgcp.read_mesh(folder / "hills.obj")).loops[0]
    with np.load(folder / "hills_pgcp" / "hills.npz") as data:
        z = data["uv"] @ [1, 1j]
    assert np.abs(np.abs(z[boundary]) - 1).max() < 1e-12
    angles = np.angle(z[boundary]) % (2 * np.pi)
    assert angles[0] == 0
    assert (np.diff(angles) > 0).all()


OPTION_RUNS = [
    "--workers 1 --store {folder} --factor-cache-mb 1 --output-dir {folder}/out",
    "--flatten scp --backend superlu --seed 4 --target free --quiet --output-dir {folder}/out",
    "--cuts {folder}/cuts.txt --output-dir {folder}/out --debug",
    "--cuts {folder}/bad_cuts.txt --repair-cuts --output-dir {folder}/out",
    "--target disk --moebius angle --output-dir {folder}/out",
    "--target disk --centre 100 --output-dir {folder}/out",
    "--target free --moebius area --output-dir {folder}/out",
    "--no-overlap --repairs relax,untangle --output-dir {folder}/out",
    "--method ccem --write npz,glb,stl --output-dir {folder}/out",
    "--seams exact --target disk --output-dir {folder}/out",
    "--seams relax --flatten scp --output-dir {folder}/out",
    "--patches auto --workers auto --memory-limit 4GB --output-dir {folder}/out",
    "--resume --store {folder} --no-obj --no-ply --no-png --no-html --output-dir {folder}/out",
]


@pytest.mark.parametrize("words", OPTION_RUNS)
def test_options(words, folder):
    done = run(folder / "hills.obj", *shlex.split(words.format(folder=folder)))
    assert done.returncode == 0, done.stderr
    assert (folder / "out" / "hills.npz").exists()
    assert (done.stdout == "") == ("--quiet" in words)


def test_outputs_are_left_out_and_processors_used_for_large_files(folder, monkeypatch):
    done = run(folder / "hills.obj", "--no-obj", "--no-ply", "--no-png", "--no-html")
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in (folder / "hills_pgcp").iterdir()) == ["hills.npz", "report.json"]
    monkeypatch.setattr(parser, "processor_count", lambda: 3)
    for size, arguments, workers in [
        (19_000_000, [], 0),
        (20_000_000, [], 3),
        (20_000_000, ["--workers", "1"], 1),
        (20_000_000, ["--scheduler", "tcp://127.0.0.1:9"], 0),
    ]:
        with (folder / "large.ply").open("wb") as stream:
            stream.truncate(size)
        assert _workers_of(build_parser().parse_args([str(folder / "large.ply"), *arguments])) == workers


def test_cuts_are_followed(folder):
    assert run(folder / "hills.obj", "--cuts", folder / "cuts.txt").returncode == 0
    mesh = pgcp.read_mesh(folder / "hills.obj")
    left = mesh.vertices[mesh.faces].mean(axis=1)[:, 0] < 0.5
    with np.load(folder / "hills_pgcp" / "hills.npz") as data:
        assert np.array_equal(data["patch"] == data["patch"][left][0], left)


def test_cuts_that_leave_no_disks_are_refused_saying_where(folder):
    done = run(folder / "hills.obj", "--cuts", folder / "bad_cuts.txt")
    assert done.returncode == 2
    assert re.search(r"leave 2 parts, and part \d is not a disk: it has 1 hole", done.stderr)
    assert not (folder / "hills_pgcp").exists()


def test_a_cut_that_is_no_edge_is_refused(folder):
    (folder / "wrong.txt").write_text("0 1\n0 100\n")
    done = run(folder / "hills.obj", "--cuts", folder / "wrong.txt")
    assert (done.returncode, done.stderr) == (2, "pgcp-run: cut 2 (0 100) is not an edge of the mesh; 1 such cuts in all\n")


def test_check_only_says_what_the_mesh_is_and_lists_defects(folder, capsys):
    assert main([str(folder / "hills.obj"), "--check-only", "--target", "sphere"]) == 2
    assert "  refused: hills.obj is an open surface (a disk)" in capsys.readouterr().out
    assert main([str(folder / "hills.obj"), "--check-only"]) == 0
    assert "an open surface (a disk) with one boundary loop of 56 edges" in capsys.readouterr().out
    pgcp.write_mesh(folder / "closed.ply", tetrahedron())
    assert main([str(folder / "closed.ply"), "--check-only"]) == 0
    assert "a sphere" in capsys.readouterr().out
    mesh = grid(4)
    faces = np.vstack([mesh.faces, mesh.faces[3:5]])
    pgcp.write_mesh(folder / "twice.obj", pgcp.Mesh(mesh.vertices, faces))
    assert main([str(folder / "twice.obj"), "--check-only"]) == 2
    out = capsys.readouterr().out
    assert "2 faces are listed twice: faces 32, 33" in out
    assert "edges have more than two faces" in out


def test_a_mesh_with_defects_is_refused_with_what_would_mend_it_and_mapped_with_fix(folder, capsys):
    mesh = pgcp.read_mesh(folder / "hills.obj")
    pgcp.write_mesh(folder / "holed.ply", pgcp.Mesh(mesh.vertices, np.delete(mesh.faces, [150, 151], axis=0)))
    done = run(folder / "holed.ply")
    assert done.returncode == 2
    assert done.stderr.endswith("; --fix would fill 1 hole (4 edges) with 2 faces\n")
    assert main([str(folder / "holed.ply"), "--check-only"]) == 2
    assert "  --fix would fill 1 hole (4 edges) with 2 faces\n" in capsys.readouterr().out
    assert main([str(folder / "holed.ply"), "--check-only", "--fix"]) == 0
    assert "  fixed: filled 1 hole (4 edges) with 2 faces\n  then it is an open surface" in capsys.readouterr().out
    done = run(folder / "holed.ply", "--fix", "--patches", 3)
    assert done.returncode == 0, done.stderr
    assert "  fixed: filled 1 hole (4 edges) with 2 faces\n" in done.stdout
    done = run(folder / "holed.ply", "--fix", "--patches", 3, "--json")
    record = {"step": "fill", "count": 1, "message": "filled 1 hole (4 edges) with 2 faces"}
    assert json.loads(done.stdout)["fixes"] == [record]
    out = folder / "holed_pgcp"
    assert json.loads((out / "report.json").read_text())["fixes"] == [record]
    with np.load(out / "holed.npz") as data:
        assert set(data) == {"uv", "faces", "patch", "mu", "vertex_of", "face_of"}
        assert len(data["faces"]) == len(data["mu"]) == len(data["patch"]) == 382
        assert np.array_equal(data["vertex_of"], np.arange(len(mesh.vertices)))
        assert np.array_equal(data["face_of"], np.arange(382))
    assert all(len(pgcp.read_mesh(out / f"holed{suffix}").faces) == 382 for suffix in (".obj", ".ply"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.ply"], "no such file"),
        (["hills.obj", "--patches", "0"], "patches is 0"),
        (["hills.obj", "--workers", "-2"], "workers is -2"),
        (["hills.obj", "--patches", "some"], "'some' is neither a whole number nor auto"),
        (["hills.obj", "--memory-limit", "plenty"], "'plenty' is no size such as 500MB"),
        (["hills.obj", "--memory-limit", "8MB"], "the memory limit is 8000000 bytes, it must be at least"),
        (["hills.obj", "--tls-ca", "cuts.txt"], "TLS needs all three of"),
        (["hills.obj", "--backend", "magic"], "invalid choice: 'magic' (choose from"),
        (["hills.obj", "--patches", "9999"], "9999 patches were asked for, but the mesh has only 384 faces"),
        (["hills.obj", "--store", "nowhere"], "no such store"),
        (["hills.obj", "--scheduler-file", "nowhere.json"], "no such scheduler file"),
        (["hills.obj", "--scheduler", "tcp://127.0.0.1:9"], "no dask scheduler answers"),
        (["hills.obj", "--output-dir", "cuts.txt"], "there is a file of this name"),
        (["hills.obj", "--output-dir", "."], "results here would take the place of hills.obj"),
        (["hills.obj", "--store", "hills.obj"], "the store is no directory"),
        (["hills.obj", "--cuts", "hills.obj"], "line 1 is not a pair of vertex ids"),
        (["hills.obj", "--no-such-option"], "unrecognized arguments"),
        (["closed.ply", "--target", "disk"], "closed surface of genus 0 (a sphere), which the target disk does not fit; use"),
        (["closed.ply", "--target", "free"], "use target sphere"),
        (["hills.obj", "--target", "sphere"], "one boundary loop of 56 edges, which the target sphere does not fit; use"),
        (["torus.ply"], "genus 1, closed; no target fits it"),
        (["torus.ply", "--target", "sphere"], "genus 1, closed; no target fits it"),
        (["torus.ply", "--fix"], "closed surface of genus 0 (--cut auto opens it to a disk); --fix does not change the genus"),
        (
            ["hills.obj", "--fix", "--target", "sphere"],
            "--fix does not fill the hole of 56 edges at vertex 0: a flat disk of its",
        ),
        (["ring.ply", "--fix", "--target", "disk", "--centre", "0"], "vertex 0 is on the boundary"),
        (["island.ply", "--fix", "--target", "disk", "--centre", "1"], "the centre is vertex 1, which --fix leaves out"),
        (["island.ply", "--fix", "--cuts", "cuts.txt"], "the cut edges name vertices that --fix renumbers"),
        (["ring.ply", "--target", "disk"], "2 boundary loops; no target fits it"),
        (["hills.obj", "--centre", "3"], "the target free has no centre"),
        (["hills.obj", "--target", "disk", "--centre", "-3"], "centre is vertex -3"),
        (["hills.obj", "--target", "disk", "--centre", "3000"], "the centre is vertex 3000, but the mesh has 221 vertices"),
        (["hills.obj", "--target", "disk", "--centre", "0"], "vertex 0 is on the boundary"),
        (["hills.obj", "--target", "disk", "--centre", "100", "--moebius", "area"], "leaves no Moebius correction"),
    ],
)
def test_mistakes_get_one_sentence_and_status_2(arguments, words, folder):
    pgcp.write_mesh(folder / "closed.ply", tetrahedron())
    pgcp.write_mesh(folder / "torus.ply", torus())
    pgcp.write_mesh(folder / "ring.ply", pgcp.Mesh(grid(6).vertices, np.delete(grid(6).faces, [30], axis=0)))
    island = np.vstack([grid(1).faces, grid(6).faces + 4])
    pgcp.write_mesh(folder / "island.ply", pgcp.Mesh(np.vstack([grid(1).vertices + 9, grid(6).vertices]), island))
    before = sorted(folder.iterdir())
    done = run(*arguments, cwd=folder)
    assert done.returncode == 2
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.count("\n") == 1
    assert sorted(folder.iterdir()) == before


def test_folds_give_status_3_and_marked_results(folder, monkeypatch, capsys):
    from pgcp.patches import stored as running

    def mirrored(mesh, _parts, _target):
        return mesh.vertices @ [1, -1j, 0], np.zeros(len(mesh.faces), complex)

    monkeypatch.setattr(running, "collect", mirrored)
    assert main([str(folder / "hills.obj"), "--repairs", "untangle"]) == 3
    message = capsys.readouterr().err
    assert re.search(r"the map has 384 folded faces of 384: faces 0, 1, 2, 3, 4, \.\.\. in patches 0, 1, 2", message)
    assert "repairs tried: untangle (to 384) of 384" in message
    assert json.loads((folder / "hills_pgcp" / "report.json").read_text())["status"] == "folded"


def test_numerical_failures_and_bugs_have_their_own_status(folder, monkeypatch, capsys):
    from pgcp.errors import WeldFailedError
    from pgcp.patches import stored as running

    def fail(*_):
        raise WeldFailedError("seam 3 is lost")

    monkeypatch.setattr(running, "split_mesh", fail)
    assert main([str(folder / "hills.obj")]) == 3
    assert capsys.readouterr().err == "pgcp-run: seam 3 is lost\n"
    monkeypatch.setattr(running, "split_mesh", lambda *_: 1 / 0)
    assert main([str(folder / "hills.obj")]) == 1
    assert "a bug: ZeroDivisionError" in capsys.readouterr().err
    with pytest.raises(ZeroDivisionError):
        main([str(folder / "hills.obj"), "--debug"])


def test_json_says_what_was_made_and_what_went_wrong(folder):
    done = run(folder / "hills.obj", "--json", "--target", "disk")
    said = json.loads(done.stdout)
    assert done.returncode == said["status"] == 0
    assert said["target"] == "disk"
    assert said["mesh"]["faces"] == 384
    assert said["quality"]["folds"] == 0
    assert all(Path(name).exists() for name in said["files"])
    done = run(folder / "hills.obj", "--json", "--target", "sphere")
    said = json.loads(done.stdout)
    assert (done.returncode, said["status"], said["error"]) == (2, 2, "NotSimplyConnectedError")
    assert said["message"] in done.stderr


def test_version_is_printed():
    assert run("--version").stdout.startswith("pgcp-run 0.")


def test_the_command_and_the_package_import_nothing_heavy_before_they_need_it():
    code = "import sys, pgcp.cli.main; print([m for m in ('numba', 'scipy', 'distributed', 'PIL') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
    assert all(getattr(pgcp, name) is not None for name in pgcp.__all__)
    assert set(pgcp.__all__) <= set(dir(pgcp))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = pgcp.nothing


def test_the_demo_runs_without_a_mesh(tmp_path):
    done = run("--demo", "--patches", 4, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    with np.load(tmp_path / "demo_pgcp" / "demo.npz") as data:
        assert 45_000 < len(data["uv"]) < 55_000
    assert json.loads((tmp_path / "demo_pgcp" / "report.json").read_text())["quality"]["folds"] == 0


def test_bars_are_drawn_on_a_terminal_and_nowhere_else(folder):
    main_end, their_end = pty.openpty()
    process = subprocess.Popen(
        [*COMMAND, str(folder / "hills.obj"), "--patches", "3"], stderr=their_end, stdout=subprocess.DEVNULL,
        env={**os.environ, "TERM": "xterm", "COLUMNS": "100"},
    )  # fmt: skip
    os.close(their_end)
    seen = b""
    while True:
        try:
            chunk = os.read(main_end, 65536)
        except OSError:
            break
        if not chunk:
            break
        seen += chunk
    assert process.wait(60) == 0
    text = seen.decode(errors="replace")
    assert "flatten" in text
    assert "3/3" in text
    assert "solve" in text
    assert run(folder / "hills.obj", "--patches", "3").stderr == ""


def test_an_interrupt_that_compiled_code_turns_into_an_error_is_one(folder, monkeypatch, capsys):
    from pgcp import api

    def interrupted(*_):
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(10)
        except KeyboardInterrupt as problem:
            raise SystemError("returned a result with an exception set") from problem

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr(api, "compute", interrupted)
    try:
        assert main([str(folder / "hills.obj")]) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err == "pgcp-run: interrupted; nothing was written\n"


@pytest.mark.parametrize("workers", ["0", "2"])
def test_an_interrupt_stops_cleanly_and_leaves_no_process(workers, tmp_path):
    pgcp.write_mesh(tmp_path / "big.ply", lifted(grid(420)))
    (tmp_path / "store").mkdir()
    process = subprocess.Popen(
        [*COMMAND, "big.ply", "--workers", workers, "--patches", "8", "--store", "store"],
        cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True,
        # a test run in the background of a shell hands down an ignored SIGINT
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not [*(tmp_path / "store").rglob("curve-*")] and time.monotonic() < deadline:
        time.sleep(0.01)
    family = psutil.Process(process.pid).children(recursive=True)
    os.killpg(process.pid, signal.SIGINT)  # what Ctrl-C does: every process of the group gets it
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert without_progress(err).strip() == "pgcp-run: interrupted; nothing was written"
    _, alive = psutil.wait_procs(family, timeout=20)
    assert alive == []
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["big.ply", "store"]


def test_nothing_in_the_library_prints(folder, capfd):
    pgcp.parameterize(folder / "hills.obj", patches=3)
    assert capfd.readouterr() == ("", "")


def test_an_embedding_is_told_in_a_sentence_that_does_not_contradict_itself():
    report = {"repairs": [], "overlap": None, "single_precision_folds": 2}
    told = "\n".join(notes({**report, "fallback": {"from": "sphere", "to": "sphere (embedding)", "reason": "no weld closes"}}))
    assert "instead of sphere" not in told
    assert "took the place of the conformal map to the sphere: no weld closes" in told
    assert "rounded to 32-bit floats the map has 2 folds: PLY and OBJ files hold all digits, GLB files do not" in told
    told = "\n".join(notes({**report, "fallback": {"from": "free", "to": "disk", "reason": "3 folds are left"}}))
    assert "instead of free, mapped to disk: 3 folds are left" in told
