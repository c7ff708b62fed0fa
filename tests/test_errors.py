"""Natural mistakes name the argument, its value and what would work; none comes from inside the package."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

import evis
from evis import _check, _evis
from evis._simulator import LabelName

NAN = float("nan")
SPINNER: Any = evis.Scene.builtin("spinner")
NO_EVENTS: Any = np.zeros(0, _evis.event_dtype())
# Wrong on purpose, all of it: no type checker may stop it.
E: Any = evis


def keyframe(**changes: Any) -> Any:
    light = np.full((3, 4), 0.5, np.float32)
    motion = np.zeros((3, 4, 2), np.float32)
    return E.EventEmulator(4, 3).push_keyframe(light, light, motion, 0, **changes)


def simulator(**settings: Any) -> Any:
    # Checked before a device is looked for.
    return E.Simulator(SPINNER, **settings)


def emulator(width: Any = 4, height: Any = 3, *more: Any, **settings: Any) -> Any:
    return E.EventEmulator(width, height, *more, **settings)


MISTAKES: list[tuple[Callable[[], Any], str]] = [
    # Scenes.
    (lambda: E.Simulator("spinner"), r"scene is 'spinner'; it must be an evis.Scene, .*builtin\('spinner'\)"),
    (lambda: E.Simulator(None), "scene is None; it must be an evis.Scene"),
    (lambda: E.Simulator("spinner", cameras=[evis.EventCamera(name="a")]), "scene is 'spinner'"),
    (lambda: E.chart("spinner"), "scene is 'spinner'"),
    (lambda: E.measure.verify_scene("spinner"), "scene is 'spinner'"),
    (lambda: E.measure.verify_light("spinner"), "scene is 'spinner'"),
    (lambda: E.Scene.builtin("spinner", seed=1.5), "seed is 1.5; it must be a whole number"),
    (lambda: SPINNER.with_cameras(["a"]), "cameras has 'a'; it must hold evis.EventCamera"),
    (lambda: SPINNER.with_cameras([E.EventCamera(name="a", pose=3)]), "pose of 'a' is 3; .*Placement"),
    (lambda: E.SceneBuilder().node("a", pose=(0, 1, 0)), r"pose of 'a' is \(0, 1, 0\); .*Placement"),
    # Sensors.
    (lambda: simulator(sensor=3), "sensor is 3; it must be an evis.Sensor, or the name of a preset"),
    (lambda: simulator(sensor="v2"), r"sensor is 'v2'; it must be 'ideal' or .* \(did you mean 'v2e'\?\)"),
    (lambda: emulator(8, 8, 3), "sensor is 3; it must be an evis.Sensor"),
    (lambda: E.chart(SPINNER, sensor="ideal"), "sensor is 'ideal'; it must be an evis.Sensor"),
    (lambda: E.measure.static_scene(3, 8, 8, duration=1), "sensor is 3"),
    (lambda: E.video("a.npy", "a.h5", sensor=3), "sensor is 3"),
    (lambda: E.Truth.from_events(NO_EVENTS, size=(8, 8), sensor=3), "sensor is 3"),
    (lambda: E.Sensor(diffusion=3).check(), "diffusion is 3; it must be an evis.sensors.Diffusion, or None"),
    (lambda: E.Sensor(threshold_on="x").check(), "threshold_on is 'x'; it must be a number"),
    (lambda: E.Sensor(trigger=3).check(), "trigger is 3; it must be 'crossing' or 'latch'"),
    (lambda: E.Sensor(noise=E.sensors.Noise(shot_hz=None)).check(), "noise.shot_hz is None"),
    (lambda: E.Sensor(most_events=-1).check(), "most_events is -1; it must not be negative"),
    (lambda: E.Sensor(most_events=2**40).check(), r"most_events is 1099511627776; .*below 2\*\*32"),
    (lambda: E.Sensor(refractory=E.sensors.Refractory(period_us=1.5)).check(), "refractory.period_us is 1.5"),
    # Sizes.
    (lambda: simulator(size="64x48"), r"size is '64x48'; it must be width and height.*\(640, 480\)"),
    (lambda: simulator(size="64"), "size is '64'; it must be width and height"),
    (lambda: simulator(size=64), "size is 64; it must be width and height"),
    (lambda: simulator(size=(64,)), r"size is \(64,\); it must be width and height"),
    (lambda: simulator(size=(64.5, 48)), "width is 64.5; it must be a whole number"),
    (lambda: E.frames("a.npy", size=64), "size is 64; it must be width and height"),
    (lambda: E.Truth.from_events(NO_EVENTS, size="64x48"), "size is '64x48'"),
    (lambda: E.EventArray(NO_EVENTS, width=3.5, height=3), "width is 3.5; it must be a whole number"),
    (lambda: emulator("a"), "width is 'a'; it must be a whole number"),
    (lambda: emulator(3.5), "width is 3.5; it must be a whole number"),
    (lambda: emulator(4, True), "height is True; it must be a whole number"),
    # Numbers, names and sequences.
    (lambda: simulator(rate_hz="x"), "rate_hz is 'x'; it must be a number"),
    (lambda: simulator(audit="x"), "audit is 'x'; it must be a number"),
    (lambda: simulator(texture_taps=-1), "texture_taps is -1; it must not be negative"),
    (lambda: simulator(start="x"), "start is 'x'; it must be a number of seconds"),
    (lambda: simulator(seed=2**70), r"seed is 1180591620717411303424; .*2\*\*63 - 1"),
    (lambda: simulator(quality=3), "quality is '3'; it must be 'draft'"),
    (lambda: simulator(labels=3), "labels is 3; it must be a sequence"),
    (lambda: simulator(labels=["frame"]), "labels is 'frame'; .*frame_rate_hz"),
    (lambda: simulator(cameras=3), r"cameras is 3; it must be a sequence, such as \['camera'\]"),
    (lambda: simulator(method=E.Warp(steps=-1)), "steps is -1; it must not be negative"),
    (lambda: simulator(method=E.Warp(variant="x")), "variant is 'x'; it must be 'splat' or 'evis-paper'"),
    (lambda: simulator(method=E.Warp(step_px=0.5)), "step_px is set; it must be not set"),
    (lambda: simulator(exposure_us=4), "exposure_us is 4 us; .*frame_rate_hz"),
    (lambda: E.chart(SPINNER, samples=3), "samples is 3; it must be a sequence"),
    (lambda: E.chart(SPINNER, duration=-1), "duration is -1; it must be above 0 seconds"),
    (
        lambda: E.metrics.score(NO_EVENTS, "a.h5", tolerances_us=3),
        "tolerances_us is 3; it must be a sequence",
    ),
    (lambda: E.statistics(3), "source is 3; it must be an evis.EventArray"),
    (lambda: E.save("a.h5", 3), "source is 3; it must be a Stream"),
    # Files and names.
    (lambda: E.load(Path(__file__).parent), "path is the folder .*tests, which is not in DSEC's layout"),
    (lambda: SPINNER.bodies([0], cameras=["camra"]), r"no camera named 'camra'; .*did you mean 'camera'\?"),
    # The emulator.
    (lambda: emulator(batch=1.5), "batch is 1.5; it must be a whole number"),
    (lambda: emulator(reference_luminance="x"), "reference_luminance is 'x'; it must be a number"),
    (lambda: emulator(labels=3), "labels is 3; it must be a sequence"),
    (lambda: emulator().reset("x"), "env_ids is 'x'; it must be the number of an environment"),
    (lambda: emulator(batch=2).reset(np.array([True, False])), "env_ids is array.*flatnonzero"),
    (lambda: emulator().set_state("x"), "state is 'x'; it must be the bytes"),
    (
        lambda: emulator().push(np.ones((3, 4), np.float32), 2**62),
        r"t_us is 4611686018427387904; .*2\*\*62 - 1",
    ),
    (
        lambda: emulator().push(np.ones((3, 4), bool), 0),
        "dtype of frames is bool; .*uint16, float16 or float64",
    ),
    (
        lambda: emulator().push(np.ones((3, 5), np.float32), 0),
        r"frames have shape \(3, 5\); they must have \(3, 4\), \(3, 4, 3\) or \(3, 4, 4\)",
    ),
    (lambda: emulator().push(np.ones((3, 4), np.float32), "x"), "t_us is 'x'; it must be a whole number"),
    (lambda: keyframe(steps=-1), "steps is -1; it must not be negative"),
    (lambda: keyframe(warp=E.Warp(step_px=NAN)), "step_px is nan; it must be a finite number, or None"),
    (lambda: keyframe(warp=E.Warp(margin=-1)), "margin is -1; it must not be negative"),
    (lambda: keyframe(warp=E.Warp(keyframe_hz=30.0)), "keyframe_hz is 30; it must be not set"),
    (lambda: keyframe(warp=E.Warp(detect_cuts="x")), "detect_cuts is 'x'; it must be True or False"),
    (lambda: keyframe(gamma="x"), "gamma is 'x'; it must be a number"),
]


@pytest.mark.parametrize(("make", "said"), MISTAKES)
def test_mistakes_name_the_argument_the_value_and_the_remedy(make: Callable[[], Any], said: str):
    with pytest.raises(evis.ConfigError, match=said):
        make()


@pytest.mark.parametrize("stage", ["exposure", "photoreceptor", "pattern", "noise", "refractory", "readout"])
def test_stages_of_a_sensor_are_what_they_are_called(stage: str):
    wanted = f"evis.sensors.{stage.capitalize()}"
    with pytest.raises(evis.ConfigError, match=f"^{stage} is 3; it must be an {wanted}$"):
        E.Sensor(**{stage: 3}).check()


def test_numbers_of_numpy_are_numbers():
    sensor = E.Sensor(threshold_on=np.float32(0.25), refractory=E.sensors.Refractory(period_us=np.int64(5)))
    assert (
        sensor.to_toml()
        == evis.Sensor(threshold_on=0.25, refractory=evis.sensors.Refractory(period_us=5)).to_toml()
    )
    keyframe(warp=E.Warp(steps=np.int64(4), step_px=np.float32(0.5), detect_cuts=np.bool_(True)))
    emulator(np.int64(4), np.uint8(3), batch=np.int32(2)).reset(np.array([0, 1]))


def test_the_refused_labels_name_those_that_are_taken():
    taken = {name for name, _, _ in _evis.label_kinds()} - {"frame"} | {"flow", "cause"}
    assert set(get_args(LabelName)) == taken
    with pytest.raises(evis.ConfigError, match="labels is 'zz'") as caught:
        simulator(labels=["zz"])
    assert set(re.findall(r"'(\w+)'", str(caught.value))) - {"zz"} == taken


@pytest.mark.parametrize("settings", [evis.Sensor(), evis.Warp()])
def test_settings_have_fields_of_kinds_that_can_be_checked(settings: Any):
    plain = _check.plain(settings)
    assert list(plain) == [field.name for field in fields(settings)]
    assert all(value is None or isinstance(value, (int, float, str, dict)) for value in plain.values())


def test_long_values_are_shown_in_part():
    with pytest.raises(evis.ConfigError, match=r"^size is \[0, 1, .*\.\.\.; it must be") as caught:
        simulator(size=list(range(10_000)))
    assert len(str(caught.value)) < 250


@pytest.mark.parametrize(
    ("module", "needs", "extra"),
    [("mujoco", "mujoco", "mujoco"), ("gym", "gymnasium", "gym"), ("torch", "torch", "torch")],
)
def test_a_module_whose_package_is_missing_names_the_extra(module: str, needs: str, extra: str):
    code = f"import sys; sys.modules[{needs!r}] = None; import evis.{module}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.splitlines()[-1].endswith(f"pip install 'evis[{extra}]'"), done.stderr
