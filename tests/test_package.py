"""The package as others get it: the wheel, the sdist, and no name at the top but ``pgcp``."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from dataclasses import fields
from pathlib import Path

import pytest
from meshes import grid, lifted
from said import without_progress

import pgcp
from pgcp import errors
from pgcp.options import Options, Running

ROOT = Path(__file__).resolve().parents[1]
BREAKS = "raise SystemError('a partition.py of the user was imported')\n"


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The wheel and the sdist."""
    pytest.importorskip("build")
    folder = tmp_path_factory.mktemp("built")
    source = folder / "source"
    # a copy of what git has, so that nothing is written into the checkout
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False)
    if listed.returncode:
        pytest.skip("the files of the package are told by git, and this is no checkout")
    for name in listed.stdout.decode().split("\0"):
        if name and (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_bytes((ROOT / name).read_bytes())
    command = [sys.executable, "-m", "build", "--no-isolation", "--wheel", "--sdist", "--outdir", folder / "dist", source]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    (wheel,), (sdist,) = (list((folder / "dist").glob(kind)) for kind in ("*.whl", "*.tar.gz"))
    return wheel, sdist


def test_the_wheel_holds_the_package_and_nothing_else(built):
    names = zipfile.ZipFile(built[0]).namelist()
    assert {name.split("/")[0] for name in names} == {"pgcp", f"pgcp-{pgcp.__version__}.dist-info"}
    assert not [name for name in names if re.search(r"\.(nb[ic]|pyc)$|__pycache__", name)]
    modules = {str(path.relative_to(ROOT)) for path in (ROOT / "pgcp").rglob("*.py")}
    modules |= {f"pgcp/{path.relative_to(ROOT)}" for path in (ROOT / "partition").rglob("*.py")}
    assert {name for name in names if name.endswith(".py")} == modules
    templates = {str(path.relative_to(ROOT)) for path in (ROOT / "pgcp/report/templates").iterdir()}
    assert {"pgcp/py.typed", *templates} <= set(names)
    door = zipfile.ZipFile(built[0]).read("pgcp/partition/__init__.py")
    assert door == (ROOT / "partition" / "__init__.py").read_bytes()  # the folder's own, not what stands in for it
    said = zipfile.ZipFile(built[0]).read(f"pgcp-{pgcp.__version__}.dist-info/METADATA").decode()
    assert "License-Expression: BSD-3-Clause" in said
    assert "Programming Language :: Python :: 3.14" in said


def test_the_sdist_holds_what_its_tests_need(built):
    with tarfile.open(built[1]) as sdist:
        names = {name.partition("/")[2] for name in sdist.getnames()}
    for name in ("LICENSE", "CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "README.md", "mkdocs.yml", "partition/kway.py"):
        assert name in names
    for folder in ("tests", "scripts", "docs", "pgcp", "partition"):
        here = {str(path.relative_to(ROOT)) for path in (ROOT / folder).rglob("*.py")}
        assert here <= names
    assert not [name for name in names if re.search(r"\.(nb[ic]|pyc)$", name)]


@pytest.mark.parametrize(
    "options",
    # a map compiles all loops anew
    [("--check-only",), pytest.param(("--patches", "3", "--no-png"), marks=pytest.mark.slow)],
    ids=["checks", "maps"],
)
def test_an_installed_wheel_runs_beside_a_partition_of_the_users(options, built, tmp_path):
    place = tmp_path / "empty"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", place], check=True)
    python = place / "bin" / "python"
    site = Path(sysconfig.get_paths(vars={"base": str(place), "platbase": str(place)})["purelib"])
    zipfile.ZipFile(built[0]).extractall(site)
    # what the package needs, but not the package of this checkout: its own comes first
    (site / "needed.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
    work = tmp_path / "work"
    work.mkdir()
    (work / "partition.py").write_text(BREAKS)
    pgcp.write_mesh(work / "hills.ply", lifted(grid(8)))
    where = "import pgcp, pgcp.partition; print(pgcp.__file__, pgcp.partition.__file__)"
    told = subprocess.run([python, "-c", where], cwd=work, capture_output=True, text=True, check=True).stdout.split()
    assert all(Path(path).is_relative_to(site) for path in told)
    command = [python, "-m", "pgcp", "hills.ply", *options]
    done = subprocess.run(command, cwd=work, capture_output=True, text=True, check=False)
    assert (done.returncode, without_progress(done.stderr)) == (0, "")
    assert (work / "hills_pgcp" / "hills.npz").exists() == ("--patches" in options)


@pytest.mark.slow
def test_tests_pass_from_an_unpacked_sdist(built, tmp_path):
    with tarfile.open(built[1]) as sdist:
        sdist.extractall(tmp_path, filter="data")
    (folder,) = tmp_path.iterdir()
    rooms = [f"tests/{room}" for room in ("patches", "partition", "retry")]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *rooms]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]


def test_a_partition_of_the_users_is_no_matter_in_a_checkout(tmp_path):
    (tmp_path / "partition.py").write_text(BREAKS)
    code = "import pgcp; from pgcp.partition import partition_faces; import pgcp.patches.split"
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)


def test_all_errors_are_exported():
    kinds = {name for name, kind in vars(errors).items() if isinstance(kind, type) and issubclass(kind, errors.PgcpError)}
    assert kinds <= set(pgcp.__all__)
    assert all(getattr(pgcp, name) is getattr(errors, name) for name in kinds)


def test_parameterize_lists_all_options_with_their_defaults():
    given = {name: p.default for name, p in inspect.signature(pgcp.parameterize).parameters.items()}
    wanted = {field.name: field.default for kind in (Options, Running) for field in fields(kind)}
    del wanted["own"]
    assert {name: given[name] for name in wanted} == wanted
    assert set(given) - set(wanted) == {"source", "progress", "own"}
