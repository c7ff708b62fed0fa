"""Examples and the code in docstrings run."""

from __future__ import annotations

import doctest
import subprocess
import sys
from pathlib import Path

import pytest

import evis

EXAMPLES = sorted((Path(__file__).parent.parent / "examples").glob("*.py"))


def test_there_are_examples():
    assert {path.name for path in EXAMPLES} >= {"quickstart.py", "stereo_labels.py", "batch_environments.py"}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_example_runs(path: Path, device: evis.Device, tmp_path: Path):
    if "import gymnasium" in path.read_text("utf-8"):
        pytest.importorskip("gymnasium", reason="the example needs the extra gym")
    done = subprocess.run(
        [sys.executable, str(path)], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "events" in done.stdout


def test_docstrings_run(device: evis.Device):
    modules = [module for name, module in sys.modules.items() if name.split(".")[0] == "evis"]
    results = [doctest.testmod(module, optionflags=doctest.ELLIPSIS) for module in modules]
    assert sum(result.attempted for result in results) > 0
    assert sum(result.failed for result in results) == 0
