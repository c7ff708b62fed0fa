"""The command line, Python and the engine have the same defaults, where each says or stores them."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomllib

import evis
from evis import _commands
from evis._luminance import EXACT_WEIGHTS, WEIGHTS

#: Settings of a run: as they are stored, as Python's parameter, as the command line's option.
RUN = {
    "rate_hz": ("rate_hz", "--rate"),
    "samples": ("samples", "--samples"),
    "audit": ("audit", "--audit"),
    "label_rate_hz": ("label_rate_hz", "--label-rate"),
    "seed": (None, "--seed"),
    "sensor.threshold_on": (None, "--threshold-on"),
    "sensor.threshold_off": (None, "--threshold-off"),
    "sensor.log_eps": (None, "--log-eps"),
}

#: Functions of Python with the command that does the same: parameter and option.
FUNCTIONS: list[tuple[Callable[..., Any], str, dict[str, str]]] = [
    (
        evis.video,
        "video",
        {"seed": "--seed", "reference_luminance": "--reference-luminance", "start": "--start"},
    ),
    (
        evis.chart,
        "chart",
        {
            "duration": "--duration",
            "size": "--size",
            "truth_pixels": "--truth-pixels",
            "repetitions": "--repetitions",
            "start": "--start",
        },
    ),
    (
        evis.measure.verify_scene,
        "verify",
        {
            "duration": "--duration",
            "size": "--size",
            "truth_pixels": "--truth-pixels",
            "rates_hz": "--rates",
            "triggers": "--triggers",
        },
    ),
    (evis.measure.verify_light, "verify", {"at": "--at", "shadows": "--shadows", "size": "--size"}),
]


@cache
def help_of(command: str) -> str:
    """Return the whole help of a command, each option on a line."""
    line = [sys.executable, "-m", "evis", command, "--help"]
    text = subprocess.run(line, capture_output=True, check=True, text=True).stdout
    # Options begin after six columns at most, what is said of them after ten.
    return re.sub(r"\n {10,}|\n\n {10,}", " ", text)


def option_default(command: str, option: str) -> str:
    found = re.search(rf"{option} <[^\n]*?\[default: ([^\]]+)\]", help_of(command))
    assert found, f"{command} {option} says no default"
    return found[1]


def parameter_default(name: str) -> str:
    """Return the number that the documents of `Simulator` name for a parameter that is not given."""
    doc = inspect.getdoc(evis.Simulator) or ""
    part = re.search(rf"(?ms)^{name} : [^\n]*\n(.*?)(?=^\w[\w, ]* : |^Raises)", doc)
    assert part, name
    found = re.search(r"([\d.]+\d|\d) (?:where not given|without a preset)", " ".join(part[1].split()))
    assert found, f"{name}: {part[1]}"
    return found[1]


def stored(table: dict[str, Any], key: str) -> Any:
    for part in key.split("."):
        table = table[part]
    return table


def same(told: str, value: Any) -> bool:
    """Whether a help text means a value."""
    if isinstance(value, (list, tuple)):
        parts = re.split("[,x]", told)
        return len(parts) == len(value) and all(same(p, v) for p, v in zip(parts, value, strict=True))
    if isinstance(value, str):
        return told == value
    return float(re.match(r"[\d.]+", told)[0]) == pytest.approx(value, rel=1e-6)  # type: ignore[index]


def test_runs_have_the_same_defaults_everywhere() -> None:
    sim = evis.Simulator(evis.Scene.builtin("spinner"), method="native", size=(8, 6))
    table = tomllib.loads(sim.config_toml)["run"]
    for key, (parameter, option) in RUN.items():
        value = stored(table, key)
        assert same(option_default("run", option), value), f"{option}, {value}"
        if parameter is not None:
            assert same(parameter_default(parameter), value), f"{parameter}, {value}"


@pytest.mark.parametrize(("function", "command", "options"), FUNCTIONS)
def test_functions_have_the_defaults_of_their_commands(
    function: Callable[..., Any], command: str, options: dict[str, str]
) -> None:
    parameters = inspect.signature(function).parameters
    for parameter, option in options.items():
        default = parameters[parameter].default
        assert same(option_default(command, option), default), f"{command} {option}, {default}"


def test_a_simulator_says_nothing_that_it_was_not_told() -> None:
    defaults = {p.default for p in inspect.signature(evis.Simulator.__init__).parameters.values()}
    assert defaults - {inspect.Parameter.empty} == {None, ()}


def test_other_defaults_are_seen() -> None:
    """Canaries."""
    assert not same("1000", 500.0)
    assert not same("160x120", (160, 121))
    assert not same("maps", "rays")
    with pytest.raises(AssertionError, match="no default"):
        option_default("run", "--report")


def test_completions_know_the_commands_that_are_written_in_python() -> None:
    line = [sys.executable, "-m", "evis", "completions", "bash"]
    script = subprocess.run(line, capture_output=True, check=True, text=True).stdout
    words = set(re.findall(r"[\w-]+", script))
    assert set(_commands.COMMANDS) | {"run", "video", "from-v2e"} <= words
    assert "no-such-command" not in words, "canary"


def test_luminance_has_the_engines_weights() -> None:
    text = (Path(__file__).parent.parent / "crates/evis-core/src/luminance.rs").read_text()
    (row,) = re.findall(r"LUMINANCE_WEIGHTS: \[f64; 3\] = \[([^\]]+)\]", text)
    assert tuple(float(value) for value in row.split(",")) == EXACT_WEIGHTS
    assert np.array_equal(WEIGHTS, np.array(EXACT_WEIGHTS, np.float32))
    files = Path(evis.__file__).parent.glob("*.py")
    holders = [file.name for file in files if re.search(r"[(\[]0\.2126,", file.read_text())]
    assert holders == ["_luminance.py"]
