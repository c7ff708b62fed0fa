"""Names from files may hold what a terminal obeys; nothing that is printed does."""

from __future__ import annotations

import json
import pickle
import warnings
from pathlib import Path

import pytest

import evis
from evis import _commands, _evis
from evis.motion import Placement

NAME = "\x1b[31mred\x07"
SHOWN = "\\u001b[31mred\\u0007"


def obeyed(text: str) -> bool:
    return any((ord(c) < 32 and c not in "\n\t") or 127 <= ord(c) < 160 for c in text)


def scene(name: str = NAME, x: float = 3.0) -> evis.Scene:
    builder = evis.SceneBuilder("s", duration=0.1, ambient=(1.0, 1.0, 1.0))
    builder.texture("checker", pattern="checker")
    builder.material("painted", texture="checker")
    builder.box("cube", size=(0.8, 0.8, 0.8), material="painted")
    builder.camera(evis.EventCamera(name=name, width=16, height=12, pose=Placement(position=(0, 0, x))))
    return builder.build()


def test_errors_escape_what_terminals_obey() -> None:
    for kind in (evis.EvisError, evis.ConfigError, evis.FormatError, evis.DeviceError):
        error = kind(f"camera {NAME}\nand\tmore")
        assert str(error) == f"camera {SHOWN}\nand\tmore"
        assert str(pickle.loads(pickle.dumps(error))) == str(error)
        assert not obeyed(repr(error))
    assert str(evis.ConfigError()) == ""
    assert _evis.printable("\x9b2J") == "\\u009b2J"
    assert obeyed(NAME), "canary"
    assert not obeyed(SHOWN)


def test_names_in_files_reach_no_terminal(
    device: evis.Device, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = scene()
    assert SHOWN in repr(made)
    sim = evis.Simulator(made, device=device, method="native", rate_hz=200)
    assert SHOWN in repr(sim)
    assert not obeyed(repr(sim) + repr(made) + repr(sim.cameras[0]))
    path = tmp_path / "a.h5"
    evis.save(path, sim.stream(duration=0.01))
    recording = evis.load(path)
    assert recording.cameras[0].name == NAME
    shown = [repr(value) for value in (recording, recording[NAME], recording.cameras)]
    for use in (lambda: recording["zz"], lambda: evis.Simulator(made, cameras=["zz"])):
        with pytest.raises((evis.EvisError, KeyError)) as raised:
            use()
        shown.append(str(raised.value))
    assert not any(map(obeyed, shown)), shown
    for command, output in (("plot", "-o"), ("view", "--save")):
        target = str(tmp_path / f"a.{command}")
        assert _commands.run(command, [str(path), "--camera", "zz", output, target]) == 2
    out, err = capsys.readouterr()
    assert not obeyed(out)
    assert not obeyed(err.replace("\r", ""))
    assert json.loads(json.dumps(NAME)) == NAME


def test_warnings_escape_them_too(device: evis.Device) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        evis.Simulator(scene(x=0.1), device=device, method="native", rate_hz=200)
    told = [str(warning.message) for warning in caught]
    assert any(SHOWN in text for text in told), told
    assert not any(map(obeyed, told))
