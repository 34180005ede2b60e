"""What the command says to mistakes on the command line, and to none."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from pgcp.cli.main import main


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bunny.ply").write_text("ply\n")
    (tmp_path / "scan").mkdir()
    (tmp_path / "scan.zip").write_bytes(b"PK\x03\x04")
    return tmp_path


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["bunny.ply", "--patchs", "3"],
            "unrecognized arguments: --patchs 3; did you mean --patches? (--help lists the options)",
        ),
        (["bunny.ply", "--target", "dsk"], "did you mean disk?"),
        (["bunny.ply", "--target", "xyz"], "invalid choice: 'xyz'"),
        (["bunny.ply", "--backend", "supelu"], "did you mean superlu?"),
        (["bunny.ply", "--zzz"], "unrecognized arguments: --zzz (--help"),
        (["--patches", "3"], "no mesh is named; name a file, or --demo for the built-in one"),
        (["bunyn.ply"], "bunyn.ply: there is no such file; did you mean bunny.ply?"),
        (["zebra.ply"], "zebra.ply: there is no such file\n"),
        (["zebra.abc"], "zebra.abc: there is no such file\n"),
        (["scan"], "scan: it is a folder; name a file in it"),
        (["scan.zip"], "scan.zip: cannot read .zip"),
        (["https://example.org/bunny.ply"], "https addresses are not read; download the file and name it"),
    ],
)
def test_a_mistake_is_one_sentence_with_what_may_be_meant(words, said, folder, capsys):
    assert main(words) == 2
    shown = capsys.readouterr()
    assert said in shown.err
    assert shown.err.startswith("pgcp-run: ")
    assert shown.err.count("\n") == 1
    assert shown.out == ""
    assert main([*words, "--json"]) == 2
    shown = capsys.readouterr()
    told = json.loads(shown.out)
    assert told["status"] == 2
    assert f"pgcp-run: {told['message']}\n" == shown.err


def test_no_word_at_all_shows_three_examples(capsys):
    assert main([]) == 0
    said = capsys.readouterr().out
    assert said.count("\n  pgcp-run ") == 3
    assert "--demo" in said
    assert "--help" in said


def test_the_examples_of_the_short_help_are_understood(capsys):
    from pgcp.cli.parser import build_parser
    from pgcp.cli.usage import SHORT_HELP

    examples = [line.split("  ")[1].split()[1:] for line in SHORT_HELP.splitlines() if line.startswith("  pgcp-run")]
    for words in examples:
        assert [str(mesh) for mesh in build_parser().parse_intermixed_args(words).meshes] == words[:1]


def test_the_version_is_told_alone_or_with_those_of_packages(capsys):
    import numpy

    import pgcp

    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"pgcp-run {pgcp.__version__}\n"
    assert main(["--version", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["pgcp"] == pgcp.__version__
    assert told["numpy"] == numpy.__version__


def test_options_stand_in_groups(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    said = capsys.readouterr().out
    places = [said.index(f"\n{title}:\n") for title in ("Map", "Output", "Mesh", "Running", "Method in detail")]
    assert places == sorted(places)


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_a_shell_gets_its_completion(shell):
    command = [sys.executable, "-m", "shtab", f"--shell={shell}", "--prog=pgcp-run", "pgcp.cli.parser.build_parser"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "--patches" in done.stdout
    assert "sphere" in done.stdout
