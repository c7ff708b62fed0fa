"""The emulator: frames of every kind in, events out, state, and what it refuses."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from host_stand_ins import OnCard

import evis


def frame(k: int, height: int = 30, width: int = 40) -> npt.NDArray[np.float32]:
    y, x = np.mgrid[:height, :width]
    return (0.5 + 0.45 * np.sin(0.3 * x + 0.2 * y + 0.5 * k)).astype(np.float32)


def run(emulator: evis.EventEmulator[evis.EventArray], count: int = 12, first: int = 0) -> evis.EventArray:
    parts = [emulator.push(frame(k), 1000 * k).to_numpy() for k in range(first, count)]
    return evis.EventArray(np.concatenate(parts), width=emulator.width, height=emulator.height)


def test_a_threshold_is_crossed_at_its_time() -> None:
    emulator = evis.EventEmulator(4, 3)
    assert len(emulator.push(np.full((3, 4), 0.5, np.float32), 0)) == 0
    events = emulator.push(np.full((3, 4), 0.7, np.float32), 1000)
    expected = 0.2 / np.log(0.701 / 0.501) * 1000
    assert len(events) == 12
    np.testing.assert_array_equal(events.t, int(expected))
    np.testing.assert_array_equal(events.p, 1)
    np.testing.assert_array_equal(events.x, np.tile(np.arange(4), 3))
    assert (events.width, events.height) == (4, 3)
    assert emulator.report.events == 12
    assert emulator.now_us == 1000


def test_events_are_sorted_and_in_their_intervals() -> None:
    emulator = evis.EventEmulator(40, 30, "v2e-noisy", seed=5)
    last = None
    for k in range(20):
        events = emulator.push(frame(k), 700 * k)
        if len(events):
            assert last is not None
            assert events.t[0] > last
            assert events.t[-1] <= 700 * k
            order = np.lexsort((events.x, events.y, events.t))
            np.testing.assert_array_equal(order, np.arange(len(events)))
        last = 700 * k
    assert emulator.total_report.events > 1000


def test_a_batch_gives_a_list() -> None:
    emulator = evis.EventEmulator(40, 30, batch=2)
    single = evis.EventEmulator(40, 30)
    for k in range(5):
        both = np.stack([frame(k), frame(3 * k)])
        first, second = emulator.push(both, 1000 * k)
        assert first == single.push(frame(k), 1000 * k)
    assert len(second) > 0
    emulator.reset(1)
    assert [len(events) > 0 for events in emulator.push(np.stack([frame(9), frame(9)]), 9000)] == [
        True,
        False,
    ]
    emulator.reset(np.array([0, 1]))
    assert emulator.now_us is None


@pytest.mark.parametrize("transfer", ["srgb", "rec709", "gamma", "linear"])
def test_integers_of_both_widths_agree(transfer: Any) -> None:
    streams = []
    for dtype, scale in ((np.uint8, 1), (np.uint16, 257)):
        emulator = evis.EventEmulator(40, 30)
        codes = [(frame(k) * 255).astype(np.uint8).astype(dtype) * dtype(scale) for k in range(6)]
        parts = [emulator.push(code, 1000 * k, transfer=transfer).to_numpy() for k, code in enumerate(codes)]
        streams.append(np.concatenate(parts))
    assert len(streams[0]) > 1000
    np.testing.assert_array_equal(streams[0], streams[1])


def test_frames_with_nan_are_warned_of_once_and_counted() -> None:
    frame = np.full((3, 4), 0.5, np.float32)
    emulator = evis.EventEmulator(4, 3)
    emulator.push(frame, 0)
    frame[1, 2] = np.nan
    with pytest.warns(UserWarning, match=r"frames hold NaN \(1 values at 1000 us\)") as told:
        emulator.push(frame, 1000)
    assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        emulator.push(frame, 2000)
    assert emulator.report.unknown == 1
    assert emulator.total_report.unknown == 2


def test_rgb_is_luminance() -> None:
    weights = np.array([0.2126, 0.7152, 0.0722])
    rng = np.random.default_rng(1)
    colour, grey = evis.EventEmulator(40, 30), evis.EventEmulator(40, 30)
    for k in range(6):
        rgb = rng.uniform(0.1, 1, (30, 40, 3)).astype(np.float32)
        events = colour.push(rgb, 1000 * k)
        luminance = (rgb.astype(np.float64) @ weights).astype(np.float32)
        plain = grey.push(luminance, 1000 * k)
        # Rounded otherwise, a crossing in thousands may fall to another microsecond or frame.
        assert abs(len(events) - len(plain)) <= 2
    assert colour.total_report.events > 5000


def test_logarithms_are_signals() -> None:
    emulator = evis.EventEmulator(1, 1)
    emulator.push(np.zeros((1, 1), np.float32), 0, transfer="log")
    events = emulator.push(np.full((1, 1), -0.5, np.float32), 1000, transfer="log")
    assert events.t.tolist() == [400, 800]
    assert events.p.tolist() == [0, 0]


def test_arrays_are_not_copied_unless_they_must_be() -> None:
    emulator = evis.EventEmulator(40, 30)
    emulator.push(frame(0), 0)
    assert emulator.report.copies == 0
    emulator.push(np.asfortranarray(frame(1)), 1000)
    assert emulator.report.copies == 1
    events = emulator.push(frame(2)[:, ::-1][:, ::-1], 2000)
    assert emulator.total_report.copies == 1, "a view of the whole array is contiguous"
    reference = evis.EventEmulator(40, 30)
    for k in range(3):
        expected = reference.push(frame(k), 1000 * k)
    assert events == expected


class Tensor:
    """A tensor of another library: nothing but DLPack."""

    def __init__(self, array: npt.NDArray[Any], device: tuple[int, int] = (1, 0)) -> None:
        self.array = array
        self.device = device
        self.taken = 0

    def __dlpack__(self, **keywords: Any) -> Any:
        self.taken += 1
        return self.array.__dlpack__(**keywords)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self.device


def test_tensors_on_a_card_are_copied_and_warned_of_once() -> None:
    emulator, reference = evis.EventEmulator(40, 30), evis.EventEmulator(40, 30)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with pytest.raises(evis.ConfigError, match="they must have"):
            emulator.push(OnCard(frame(0)[:8]), 0)
        for k in range(3):
            assert emulator.push(OnCard(frame(k)), 1000 * k) == reference.push(frame(k), 1000 * k)
            assert emulator.report.copies == 1
    (said,) = [str(warning.message) for warning in caught]
    assert (
        f"tensors are on cuda:0, and events are made on the CPU: each push copies {40 * 30 * 4e-6:.1f}"
        in said
    )
    emulator.reset()
    depth, motion = np.ones((30, 40), np.float32), np.zeros((30, 40, 2), np.float32)
    emulator.push_keyframe(OnCard(frame(0)), OnCard(depth), OnCard(motion), 4000)
    assert emulator.report.copies == 3


@pytest.mark.filterwarnings("error:tensors are on")
def test_dlpack_tensors_are_read_in_place() -> None:
    emulator, reference = evis.EventEmulator(40, 30), evis.EventEmulator(40, 30)
    for k in range(3):
        tensor = Tensor(frame(k))
        assert emulator.push(tensor, 1000 * k) == reference.push(frame(k), 1000 * k)
        assert tensor.taken == 1
        assert emulator.report.copies == 0
    with pytest.raises(evis.ConfigError, match=r"2:0.*CPU"):
        emulator.push(Tensor(frame(4), (2, 0)), 9000)


@pytest.mark.parametrize("name", sorted(evis.Sensor.presets()))
def test_presets_survive_toml_pickle_and_saved_state(name: str, tmp_path: Path) -> None:
    sensor = evis.Sensor.preset(name)
    assert evis.Sensor.from_toml(sensor.to_toml()) == sensor
    file = tmp_path / "sensor.toml"
    file.write_text(sensor.to_toml(), "utf-8")
    assert evis.Sensor.from_toml(file) == sensor
    whole = run(evis.EventEmulator(40, 30, sensor, seed=7))
    first = evis.EventEmulator(40, 30, name, seed=7)
    head = run(first, 6)
    pickled = pickle.loads(pickle.dumps(first))
    other = evis.EventEmulator(40, 30, sensor, seed=7, threads=1)
    other.set_state(first.get_state())
    for emulator in (pickled, other):
        tail = run(emulator, 12, 6)
        np.testing.assert_array_equal(np.concatenate([head.to_numpy(), tail.to_numpy()]), whole.to_numpy())
    with pytest.raises(evis.ConfigError, match="state"):
        evis.EventEmulator(40, 30, sensor, seed=8).set_state(first.get_state())


def test_pixels_may_see_frames_of_light() -> None:
    exposure = evis.sensors.Exposure(time_us=20_000, period_us=33_333)
    sensor = evis.Sensor(exposure=exposure)
    assert evis.Sensor.from_toml(sensor.to_toml()) == sensor
    assert not sensor.thresholds_only
    for preset in evis.Sensor.presets():
        assert evis.Sensor.preset(preset).exposure == evis.sensors.Exposure()

    def lamp(emulator: evis.EventEmulator[evis.EventArray], hertz: float) -> int:
        light = (0.5 + 0.4 * np.sin(2 * np.pi * hertz * 1e-3 * k) for k in range(400))
        return sum(len(emulator.push(np.full((3, 4), y, np.float32), 1000 * k)) for k, y in enumerate(light))

    # Whole periods are averaged.
    assert lamp(evis.EventEmulator(4, 3, sensor), 100.0) == 0
    assert lamp(evis.EventEmulator(4, 3, sensor), 13.0) > 50
    assert lamp(evis.EventEmulator(4, 3), 100.0) > 1000

    short = evis.Sensor(exposure=evis.sensors.Exposure(time_us=2_500, period_us=3_300))
    whole = run(evis.EventEmulator(40, 30, short), 120)
    half = evis.EventEmulator(40, 30, short)
    first = run(half, 50)
    rest = run(pickle.loads(pickle.dumps(half)), 120, 50)
    parts = [first.to_numpy(), rest.to_numpy()]
    assert len(whole) > 1000
    np.testing.assert_array_equal(np.concatenate(parts), whole.to_numpy())


def test_samples_are_drawn_within_their_ranges() -> None:
    base = evis.Sensor()
    ranges = {"threshold_on": (0.05, 0.3), "noise.shot_hz": (0.0, 2.0), "trigger": {"choices": ["latch"]}}
    drawn = [base.sample(ranges, seed) for seed in range(20)]
    assert len({sensor.threshold_on for sensor in drawn}) == 20
    assert all(0.05 <= sensor.threshold_on <= 0.3 and sensor.trigger == "latch" for sensor in drawn)
    assert base.sample(ranges, 3) == drawn[3]
    with pytest.raises(evis.ConfigError, match=r"noise\.leek"):
        base.sample({"noise.leek": (0, 1)}, 0)


def test_noise_of_the_photoreceptor_fires_as_often_as_asked() -> None:
    for order in (1, 2):
        quiet = evis.Sensor(photoreceptor=evis.sensors.Photoreceptor(cutoff_hz=200, order=order))
        noise = quiet.photoreceptor_noise_for(5.0)
        sensor = quiet.sample({"photoreceptor.noise": (noise, noise)}, 0)
        assert sensor.photoreceptor.noise == pytest.approx(noise)
        assert evis.Sensor.from_toml(sensor.to_toml()) == sensor
        emulator = evis.EventEmulator(100, 80, sensor)
        for k in range(201):
            emulator.push(np.full((80, 100), 0.4, np.float32), 10_000 * k)
        rate = emulator.total_report.events / (100 * 80 * 2.0)
        assert rate == pytest.approx(5.0, rel=0.25)
        # v2e's formula as published, by hand.
        x = np.log10(5.0 / (2 * 200))
        ratio = 10 ** (-0.0026 * x**3 - 0.036 * x**2 - 0.1949 * x + 0.321)
        assert quiet.photoreceptor_noise_for(5.0, law="v2e") == pytest.approx(0.2 / ratio, rel=1e-5)
    assert evis.Sensor().photoreceptor.noise == 0
    with pytest.raises(evis.ConfigError, match="cutoff_hz"):
        evis.Sensor().photoreceptor_noise_for(5.0)
    with pytest.raises(evis.ConfigError, match="rate_hz is 500"):
        quiet.photoreceptor_noise_for(500.0)
    with pytest.raises(evis.ConfigError, match="law is 'v2f'"):
        quiet.photoreceptor_noise_for(5.0, law="v2f")  # type: ignore[arg-type]


def test_what_is_probably_not_meant_is_warned_of() -> None:
    sensor = evis.Sensor(
        photoreceptor=evis.sensors.Photoreceptor(cutoff_hz=100),
        readout=evis.sensors.Readout(latency_light_us=10),
    )
    with pytest.warns(UserWarning, match="twice"):
        evis.EventEmulator(2, 2, sensor)


def test_the_simulator_refuses_what_it_would_ignore() -> None:
    with pytest.raises(evis.ConfigError, match="v2f"):
        evis.Simulator(evis.Scene.builtin("spinner"), sensor="v2f")


def test_a_scenes_cameras_bring_their_sensor(tmp_path: Path) -> None:
    text = """
    [[primitives]]
    name = "wall"
    shape = "box"
    size = [1, 1, 1]
    material = "white"
    [[materials]]
    name = "white"
    [[cameras]]
    name = "front"
    size = [8, 6]
    sensor = "sensors/own.toml"
    """
    own = evis.Sensor(threshold_on=0.31, noise=evis.sensors.Noise(shot_hz=3.0))
    assert evis.Sensor.from_toml(own.to_toml()) == own
    (tmp_path / "sensors").mkdir()
    (tmp_path / "sensors" / "own.toml").write_text(own.to_toml())
    (tmp_path / "scene.toml").write_text(text)
    scene = evis.Scene.load(tmp_path / "scene.toml")
    settings: dict[str, Any] = {"rate_hz": 100.0, "samples": 1, "reference_luminance": 1.0}
    assert evis.Simulator(scene, **settings).sensor == own
    assert evis.Simulator(scene, sensor="v2e", **settings).sensor == evis.Sensor.preset("v2e")
    file = str(tmp_path / "sensors" / "own.toml")
    assert evis.Simulator(evis.Scene.builtin("spinner"), sensor=file, **settings).sensor == own
    with pytest.raises(FileNotFoundError, match=r"none\.toml"):
        evis.EventEmulator(8, 6, "none.toml")
    cameras = [evis.EventCamera(name=str(k), width=8, height=6, sensor=own) for k in range(2)]
    assert evis.Simulator(evis.Scene.builtin("spinner"), cameras=cameras, **settings).sensor == own
    mixed = [cameras[0], evis.EventCamera(name="plain", width=8, height=6, threshold_on=0.15)]
    both = evis.Simulator(evis.Scene.builtin("spinner"), cameras=mixed, **settings)
    assert both.sensors == {"0": own, "plain": evis.Sensor(threshold_on=0.15)}
    assert both.sensor == own, "the first camera's"
    assert evis.Simulator(evis.Scene.builtin("spinner"), **settings).sensor == evis.Sensor(), "canary"


GOOD = np.full((3, 4), 0.5, np.float32)


@pytest.mark.parametrize("dtype", [np.float16, np.float64])
def test_other_floats_and_alpha_are_taken_with_a_copy(dtype: Any) -> None:
    rng = np.random.default_rng(5)
    frames = rng.integers(1, 100, (3, 3, 4, 3)).astype(np.float32) / 128
    wanted, other = evis.EventEmulator(4, 3), evis.EventEmulator(4, 3)
    for k, frame in enumerate(frames):
        alpha = rng.random((3, 4, 1)).astype(dtype)
        events = other.push(np.concatenate([frame.astype(dtype), alpha], -1), 1000 * k)
        exact = wanted.push(frame, 1000 * k)
        assert (events.to_numpy() == exact.to_numpy()).all()
        assert (other.report.copies, wanted.report.copies) == (1, 0)
    assert len(exact) > 0


def test_floats_that_are_hardly_light_are_asked_about() -> None:
    with pytest.warns(UserWarning, match=r"frames are 128 on average.*are they 0 to 255"):
        evis.EventEmulator(4, 3).push(np.full((3, 4), 128.0, np.float32), 0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        evis.EventEmulator(4, 3, reference_luminance=100.0).push(np.full((3, 4), 128.0, np.float32), 0)
        evis.EventEmulator(4, 3).push(np.full((3, 4), 128, np.uint8), 0)
        # Frames that are not the first ones are not looked at, and those after a reset are.
        emulator = evis.EventEmulator(4, 3)
        emulator.push(np.full((3, 4), 0.5, np.float32), 0)
        emulator.push(np.full((3, 4), 128.0, np.float32), 1000)
    emulator.reset()
    with pytest.warns(UserWarning, match="are they 0 to 255"):
        emulator.push(np.full((3, 4), 128.0, np.float32), 0)


BAD_FRAMES: list[tuple[Any, dict[str, Any], str]] = [
    (GOOD.astype(np.int64), {}, "int64"),
    (GOOD.astype(np.int32), {}, "int32"),
    (GOOD.astype(">f4"), {}, ">f4"),
    (GOOD[:2], {}, r"\(2, 4\)"),
    (GOOD.T, {}, r"\(4, 3\)"),
    (GOOD[None], {}, r"\(1, 3, 4\)"),
    (np.stack([GOOD] * 5, -1), {}, r"\(3, 4, 5\)"),
    (np.where(np.eye(3, 4) > 0, np.inf, GOOD).astype(np.float32), {}, r"pixel \(0, 0\).* inf"),
    (GOOD - 1, {}, "-0.5"),
    (GOOD, {"transfer": "srgb"}, "srgb"),
    (GOOD, {"transfer": "sgrb"}, "sgrb"),
    (GOOD.astype(np.uint8), {"transfer": "log"}, "log"),
    (GOOD.astype(np.uint8), {"transfer": "gamma", "gamma": -1.0}, "gamma is -1"),
    (np.stack([GOOD] * 3, -1), {"transfer": "log"}, "channels"),
    (np.zeros((0, 3, 4), np.float32), {}, r"\(0, 3, 4\)"),
]


@pytest.mark.parametrize(("frames", "keywords", "said"), BAD_FRAMES)
def test_bad_frames_are_named_and_change_nothing(frames: Any, keywords: dict[str, Any], said: str) -> None:
    emulator = evis.EventEmulator(4, 3, "v2e")
    emulator.push(GOOD, 10)
    state = emulator.get_state()
    with pytest.raises(evis.ConfigError, match=said):
        emulator.push(frames, 20, **keywords)
    assert emulator.get_state() == state
    emulator.push(GOOD, 20)


@pytest.mark.parametrize("t_us", [10, 9, -5, 1.5, 2**63, True, 10 + 2**31])
def test_times_must_increase(t_us: Any) -> None:
    emulator = evis.EventEmulator(4, 3)
    emulator.push(GOOD, 10)
    with pytest.raises(evis.ConfigError, match="t_us"):
        emulator.push(GOOD, t_us)
    emulator.push(GOOD, 11)


BAD_SETTINGS: list[tuple[Callable[[], Any], str]] = [
    (lambda: evis.EventEmulator(0, 3), "width is 0"),
    (lambda: evis.EventEmulator(3, 70000), "height is 70000"),
    (lambda: evis.EventEmulator(3, 3, batch=0), "batch is 0"),
    (lambda: evis.EventEmulator(3, 3, seed=-1), "seed is -1"),
    (lambda: evis.EventEmulator(3, 3, "v2f"), "v2f"),
    (lambda: evis.EventEmulator(3, 3, reference_luminance=0.0), "reference_luminance"),
    (lambda: evis.EventEmulator(3, 3, evis.Sensor(threshold_on=0.0)), "threshold_on is 0"),
    (lambda: evis.EventEmulator(3, 3, evis.Sensor(threshold_off=float("nan"))), "threshold_off"),
    (lambda: evis.EventEmulator(3, 3, evis.Sensor(trigger="lach")), "lach"),  # type: ignore[arg-type]
    (
        lambda: evis.EventEmulator(
            3, 3, evis.Sensor(photoreceptor=evis.sensors.Photoreceptor(cutoff_hz=1e6))
        ),
        "cutoff_hz is 1000000.*Nyquist",
    ),
    (lambda: evis.EventEmulator(3, 3, evis.Sensor(noise=evis.sensors.Noise(shot_hz=-1.0))), "shot_hz is -1"),
    (
        lambda: evis.EventEmulator(3, 3, evis.Sensor(photoreceptor=evis.sensors.Photoreceptor(noise=0.1))),
        "photoreceptor.noise is 0.1.*cutoff_hz",
    ),
    (lambda: evis.Sensor.from_toml("threshold_on = 0"), "threshold_on"),
    (lambda: evis.Sensor(exposure=evis.sensors.Exposure(period_us=5)).check(), "exposure.time_us is 0"),
    (
        lambda: evis.Sensor(exposure=evis.sensors.Exposure(time_us=5, period_us=4)).check(),
        "exposure.period_us is 4",
    ),
    (lambda: evis.Sensor.from_toml("noise = 3\nx = ["), "TOML"),
]


@pytest.mark.parametrize(("make", "said"), BAD_SETTINGS)
def test_bad_settings_are_named(make: Callable[[], Any], said: str) -> None:
    with pytest.raises(evis.ConfigError, match=said):
        make()
