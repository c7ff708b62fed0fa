"""What `import evis` gives, what it prints, and how values show themselves."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import fields, replace

import numpy as np
import pytest

import evis


def test_the_top_level_is_about_three_dozen_names():
    assert not [name for name in evis.__all__ if type(getattr(evis, name)) is type(evis)], "no modules"
    names = set(evis.__all__) - {"__version__"}
    assert 30 <= len(names) <= 36
    assert {"Scene", "Simulator", "Sensor", "EventArray", "load", "save"} <= names
    assert not [name for name in names if name.endswith(("Report", "Verification", "Point"))]


def test_every_module_has_the_names_that_it_lists():
    for module in (evis.emulation, evis.events, evis.files, evis.measure, evis.packets, evis.sensors):
        assert len(module.__all__) >= 5
        for name in module.__all__:
            is_alias = name in {"Events", "Times", "Trigger"}
            assert getattr(module, name).__doc__ or is_alias, f"{module.__name__}.{name}"


def test_names_that_moved_are_still_found_with_a_warning():
    with pytest.warns(DeprecationWarning, match=r"evis\.View is evis\.packets\.View now"):
        assert evis.View is evis.packets.View
    for name, module in evis._MOVED.items():
        with pytest.warns(DeprecationWarning, match=rf"evis\.{name} is evis\.{module}\.{name} now"):
            assert getattr(evis, name) is getattr(sys.modules[f"evis.{module}"], name)
    assert not set(evis._MOVED) & set(evis.__all__)
    with pytest.warns(DeprecationWarning, match=r"evis\.Noise is evis\.sensors\.Noise now"):
        assert evis.Noise is evis.sensors.Noise
    with pytest.raises(AttributeError, match="no attribute 'Sensro'"):
        _ = evis.Sensro  # type: ignore[attr-defined]


def test_import_and_a_first_step_print_nothing(device: evis.Device):
    code = (
        "import evis\n"
        "sim = evis.Simulator(evis.Scene.builtin('spinner'), size=(64, 48), quality='draft')\n"
        "sim.step(1000)\n"
    )
    bare = {name: value for name, value in os.environ.items() if name != "XDG_RUNTIME_DIR"}
    done = subprocess.run([sys.executable, "-c", code], env=bare, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_a_sensor_tells_what_differs_from_its_preset():
    assert repr(evis.Sensor()) == "Sensor()"
    assert repr(evis.Sensor(threshold_on=0.3)) == "Sensor(threshold_on=0.3)"
    noisy = evis.Sensor(noise=evis.sensors.Noise(leak_hz=0.1), threshold_off=0.25)
    assert repr(noisy) == "Sensor(threshold_off=0.25, noise=Noise(leak_hz=0.1))"
    own = {name: getattr(evis.sensors, name) for name in ("Sensor", "Noise")}
    assert eval(repr(noisy), own) == noisy, "the text makes the value again"
    for name in evis.Sensor.presets():
        if name != "ideal":
            assert repr(evis.Sensor.preset(name)) == f"Sensor.preset({name!r})"
    changed = replace(evis.Sensor.preset("v2e"), threshold_on=0.5)
    assert repr(changed) == "Sensor.preset('v2e') with threshold_on=0.5"
    stage = replace(changed, noise=replace(changed.noise, leak_hz=2.0))
    assert repr(stage) == "Sensor.preset('v2e') with threshold_on=0.5, noise.leak_hz=2.0"
    assert len(repr(stage)) < len(fields(evis.sensors.Noise)) * 8, "canary: shorter than all of its fields"


def test_values_show_themselves_on_a_short_line(spinner: evis.Scene):
    camera = evis.EventCamera(name="eye", width=64, height=48)
    assert repr(camera) == "EventCamera(name='eye', width=64, height=48)"
    assert repr(evis.motion.Placement()) == "Placement()"
    # Arrays are compared element by element, which is no answer; they are shown.
    assert "position=array" in repr(evis.motion.Placement(position=np.array([1.0, 2.0, 3.0])))
    assert repr(evis.Warp()) == "Warp()"
    assert repr(evis.SceneBuilder("x")) == "SceneBuilder('x', empty)"
    sim = evis.Simulator(
        spinner, size=(64, 48), labels=["depth"], label_rate_hz=100.0, rate_hz=500.0, samples=1
    )
    stream = sim.stream(duration=0.02)
    packet = next(stream)
    stream.close()
    shown = [sim, stream, packet, packet[0], packet.view, packet.events, packet.poses, packet.labels["depth"]]
    shown += [sim.cameras[0], sim.scene, sim.sensor]
    for value in shown:
        assert len(repr(value)) < 200, repr(value)
        assert " object at " not in repr(value)
    assert repr(packet.poses) == "Poses(1 poses, t_us 0 to 0)"
    assert repr(packet.view).startswith("View('camera', environment 0, ")


def test_messages_name_arguments_of_python(spinner: evis.Scene):
    with pytest.raises(evis.ConfigError, match=r"start is 1000000.0; it must be between 0 and 86400 seconds"):
        evis.Simulator(spinner, start=1e6)
    with pytest.raises(evis.ConfigError, match=r"camera_speed is -1; it must be from 0.01"):
        evis.Simulator(spinner, camera_speed=-1, camera_motion="orbit")
