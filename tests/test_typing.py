"""The package is typed: mypy accepts it and the examples, and the stubs match the binary."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent


def run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True)


def test_mypy_accepts_package_and_examples():
    done = run("mypy", "--strict")
    assert done.returncode == 0, done.stdout + done.stderr


def test_mypy_refuses_a_wrong_call(tmp_path: Path):
    wrong = tmp_path / "wrong.py"
    wrong.write_text("import evis\nevis.Simulator(evis.Scene.builtin('spinner'), samples='4')\n")
    done = run("mypy", "--strict", str(wrong))
    assert done.returncode == 1, "canary: a wrong type must be seen"
    assert "samples" in done.stdout


def test_stubs_match_the_binary():
    done = run("mypy.stubtest", "evis._evis")
    assert done.returncode == 0, done.stdout + done.stderr


def test_ruff_accepts_the_python_code():
    done = run("ruff", "check", "python", "examples", "tests")
    assert done.returncode == 0, done.stdout + done.stderr
