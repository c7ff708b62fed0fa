"""The wheel's command is the program `evis-rs`."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import evis
from evis import _commands


def run(*args: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "evis", *args], capture_output=True, text=True, check=False)


def test_version_is_the_packages():
    done = run("--version")
    assert done.returncode == 0
    program, version, *commit = done.stdout.split()
    assert (program, version) == ("evis", evis.__version__)
    # Sources without a repository name none.
    assert not commit or re.fullmatch(r"\([0-9a-f]{7,40}\)", commit[0])


def test_the_command_is_installed():
    command = Path(sys.executable).with_name("evis")
    done = subprocess.run([command, "--version"], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert evis.__version__ in done.stdout


def test_bad_input_exits_with_2():
    assert run("run", "no-such-scene", "-o", "out.h5").returncode == 2
    assert run("no-such-command").returncode == 2


def test_near_names_of_commands_in_python_are_suggested():
    for name in _commands.COMMANDS:
        done = run(f"{name}x", "a.h5")
        assert done.returncode == 2
        assert f"'{name}'" in done.stderr, "IN_PYTHON of evis-cli lists the commands in Python"
    assert "tip" not in run("xyzzy").stderr  # canary


def test_choices_and_names_of_commands_in_python_are_suggested():
    for line, near in [
        (["evaluate", "recontruct"], "'reconstruct'"),
        (["evaluate", "reconstruct", "spiner", "--network", "n.onnx"], "'spinner'"),
        (["plot", "a.h5", "--kind", "rate"], "'rates'"),
        (["dataset", "objects2", "-o", "d"], "'objects2d'"),
    ]:
        done = run(*line)
        assert done.returncode == 2
        assert f"(did you mean {near}?)" in done.stderr, done.stderr
    assert "did you mean" not in run("plot", "a.h5", "--kind", "xyzzy").stderr  # canary


def test_help_lists_the_commands_in_python_and_is_short():
    short, whole, bare = run("-h"), run("--help"), run()
    assert (short.returncode, whole.returncode, bare.returncode) == (0, 0, 2)
    lines = short.stdout.splitlines()
    assert len(lines) <= 30
    assert max(map(len, lines)) <= 100
    assert short.stdout.count("\n  evis ") == 4, "examples"
    for name in _commands.COMMANDS:
        for text in (short.stdout, whole.stdout, bare.stderr):
            assert re.search(rf"^  {name} ", text, re.MULTILINE), name
        assert run("help", name).stdout == run(name, "--help").stdout


def test_scenes_are_listed():
    done = run("scenes")
    assert done.returncode == 0
    for name in evis.scenes():
        assert name in done.stdout


@pytest.mark.parametrize(
    "command",
    ["evaluate", "evaluate reconstruct", "evaluate flow", "evaluate match", "view", "plot", "dataset"],
)
def test_help_of_commands_in_python_has_headings_and_examples(command: str) -> None:
    told = run(*command.split(), "-h")
    lines = told.stdout.splitlines()
    assert told.returncode == 0
    assert len(lines) <= 30
    assert max(map(len, lines)) <= 100
    assert "Examples:" in lines
    examples = [line.split() for line in lines[lines.index("Examples:") + 1 :] if line.startswith("  evis ")]
    assert examples
    assert all(example[1 : 1 + len(command.split())] == command.split() for example in examples)
    headings = [line for line in lines if line.endswith(":") and not line.startswith(" ")]
    assert headings[0] == "Input:"
    assert "Options:" not in headings
