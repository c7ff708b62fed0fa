"""Keyframes of other renderers: what they become, beside the engine's own splat, and what is refused."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import evis

SIZE = (96, 72)
RATE_HZ = 25.0
END_US = 160_001

Keyframe = tuple[int, npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.float32]]


@pytest.fixture(scope="module")
def scene() -> evis.Scene:
    return evis.Scene.builtin("spinner")


@pytest.fixture(scope="module")
def rendered(scene: evis.Scene) -> tuple[list[Keyframe], list[npt.NDArray[np.float32]], float]:
    """Light, depth and flow as the engine labels them, one sample per pixel; flow to the next; Y_ref."""
    simulator = evis.Simulator(
        scene, size=SIZE, labels=["hdr", "depth", "flow"], label_rate_hz=RATE_HZ, rate_hz=RATE_HZ, samples=1
    )
    labels = simulator.step(END_US).labels
    keyframes, forward = [], []
    for i, t_us in enumerate(labels["hdr"].t_us):
        flows = []
        for kind in ("flow_backward", "flow_forward"):
            flow = labels[kind].images[i].copy()
            flow[labels[f"{kind}_valid"].images[i] == 0] = np.nan
            flows.append(flow)
        keyframes.append((int(t_us), labels["hdr"].images[i], labels["depth"].images[i], flows[0]))
        forward.append(flows[1])
    assert simulator.reference_luminance is not None
    return keyframes, forward, simulator.reference_luminance


def joined(parts: list[evis.EventArray]) -> evis.EventArray:
    return evis.EventArray(np.concatenate([part.to_numpy() for part in parts]), width=SIZE[0], height=SIZE[1])


def test_pushed_keyframes_fire_as_the_engines_splat(scene: evis.Scene, rendered: Any) -> None:
    keyframes, forward, y_ref = rendered
    paper = evis.Warp(variant="evis-paper", keyframe_hz=RATE_HZ, steps=6, margin=0)
    engine = evis.Simulator(
        scene,
        size=SIZE,
        method=paper,
        sensor=evis.Sensor(),
        samples=1,
        texture_taps=4,
        reference_luminance=y_ref,
    )
    truth = evis.Truth.from_events(
        evis.EventArray(engine.step(END_US).events, width=SIZE[0], height=SIZE[1]),
        sensor=evis.Sensor(),
        duration_us=END_US,
    )
    warp = evis.Warp.evis_paper(6)

    def f1(with_forward: bool, sign: float) -> float:
        emulator = evis.EventEmulator(*SIZE, reference_luminance=y_ref)
        parts = []
        for (t_us, hdr, depth, motion), ahead in zip(keyframes, forward, strict=True):
            parts.append(
                emulator.push_keyframe(
                    hdr,
                    depth,
                    sign * motion,
                    t_us,
                    motion_forward=sign * ahead if with_forward else None,
                    warp=warp,
                )
            )
            assert emulator.keyframe_report.steps in (1, 6)
        return evis.metrics.score(joined(parts), truth).at(1000).plain.f1

    # A label stands for a whole pixel, at 4x4 places: the engine's light, rounded otherwise.
    assert f1(True, 1.0) > 0.95
    # Without vectors to the next keyframe, those of the next one are turned around.
    assert f1(False, 1.0) > 0.9
    # Canary: of the wrong convention.
    assert f1(True, -1.0) < 0.8


def test_a_known_rotation_meets_the_convention(rendered: Any) -> None:
    keyframes, _, _ = rendered
    (_, older, _, _), (_, newer, _, motion) = keyframes[1:3]
    right = evis.emulation.check_motion(older, newer, motion)
    assert right.is_right
    # Vectors are exact, but pixels are not: a tenth of a pixel is what rounding to pixels leaves.
    assert right.error < 0.15
    # What a host with the other sign, or y up, would give is named.
    for flip, named in (((-1, -1), "from the last keyframe to this one"), ((1, -1), "y up")):
        found = evis.emulation.check_motion(older, newer, motion * np.array(flip, np.float32))
        assert (found.scale, found.is_right) == (flip, False)
        assert named in found.convention
        assert found.error_given > 2 * found.error


def test_integers_and_colours_tell_a_convention_too() -> None:
    first, second = sliding(0), sliding(1)
    pictures = [np.repeat(each["hdr"][..., None], 3, axis=2) for each in (first, second)]
    codes = [(255 * np.clip(picture, 0, 1)).astype(np.uint8) for picture in pictures]
    motion = -second["motion_vectors"]
    assert evis.emulation.check_motion(*pictures, motion).scale == (-1.0, -1.0)
    assert evis.emulation.check_motion(*codes, motion, transfer="linear").scale == (-1.0, -1.0)
    with pytest.raises(evis.ConfigError, match=r"motion_vectors has shape \(72, 96\)"):
        evis.emulation.check_motion(*pictures, motion[..., 0])
    with pytest.raises(evis.ConfigError, match="fewer than 100 pixels"):
        evis.emulation.check_motion(*pictures, np.zeros_like(motion))


def test_what_a_report_warns_of_is_a_python_warning_once() -> None:
    def pushed(shift: float, count: int = 4) -> list[str]:
        emulator = evis.EventEmulator(*SIZE)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            for k in range(count):
                emulator.push_keyframe(**sliding(k, shift + 0.1 * k), t_us=8000 * k, steps="auto")
                if shift > 4 and k > 0:
                    assert any("render faster" in text for text in emulator.keyframe_report.warnings)
        return [str(warning.message) for warning in caught]

    fast = pushed(9.0)
    assert len(fast) == 1
    assert "9.1 px per gap: render faster, 3 times as often" in fast[0]
    assert pushed(3.0) == [], "canary"


def test_the_number_of_instants_is_a_function_of_what_is_pushed() -> None:
    def run(threads: int, warm: bool, steps: Any = "auto") -> tuple[evis.EventArray, list[int]]:
        emulator = evis.EventEmulator(*SIZE, threads=threads)
        if warm:
            for k in range(3):
                emulator.push_keyframe(**sliding(k, 1.0), t_us=500 * k)
            emulator.reset()
        parts, counts = [], []
        for k in range(4):
            parts.append(emulator.push_keyframe(**sliding(k), t_us=8000 * k, steps=steps))
            counts.append(emulator.keyframe_report.steps)
        return joined(parts), counts

    events, counts = run(1, False)
    assert run(2, True) == (events, counts)
    assert counts[1] > counts[0] == 1
    # Given by hand, the same; canary: another number is another stream.
    assert run(1, False, counts[1])[0] == events
    assert run(1, False, 2 * counts[1])[0] != events
    with pytest.raises(evis.ConfigError, match=r"steps is 'many'.*'auto'"):
        run(1, False, "many")


def sliding(k: int, shift: float = 3.0, channels: int | None = None) -> dict[str, npt.NDArray[np.float32]]:
    height, width = SIZE[1], SIZE[0]
    y, x = np.mgrid[:height, :width].astype(np.float32)
    light = (0.5 + 0.3 * np.sin((x - shift * k) / 3) * np.cos(y / 4)).astype(np.float32)
    if channels:
        light = np.repeat(light[..., None], channels, -1)
    motion = np.zeros((height, width, 2), np.float32)
    motion[..., 0] = -shift
    return {"hdr": light, "depth": np.full((height, width), 2.0, np.float32), "motion_vectors": motion}


class Tensor:
    """A tensor of another library: nothing but DLPack."""

    def __init__(self, array: npt.NDArray[Any], device: tuple[int, int] = (1, 0)) -> None:
        self.array = array
        self.device = device

    def __dlpack__(self, **keywords: Any) -> Any:
        return self.array.__dlpack__(**keywords)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self.device


def test_tensors_colours_and_trailing_axes_are_the_same() -> None:
    def run(convert: Any, channels: int | None = None) -> tuple[evis.EventArray, int]:
        emulator = evis.EventEmulator(*SIZE)
        parts = []
        for k in range(3):
            pictures = {name: convert(name, value) for name, value in sliding(k, channels=channels).items()}
            parts.append(emulator.push_keyframe(**pictures, t_us=8000 * k))
        return joined(parts), emulator.total_report.copies

    plain, copies = run(lambda _, value: value)
    assert len(plain) > 1000
    assert copies == 0
    assert run(lambda _, value: Tensor(value)) == (plain, 0)
    assert run(lambda name, value: value if name == "motion_vectors" else value[..., None]) == (plain, 0)
    assert run(lambda _, value: np.asfortranarray(value)) == (plain, 9)
    colour, _ = run(lambda _, value: value, 3)
    assert abs(len(colour) - len(plain)) < 0.01 * len(plain)


def test_a_batch_gives_lists_and_cuts_one_environment() -> None:
    def both(k: int) -> dict[str, npt.NDArray[np.float32]]:
        slow, fast = sliding(k), sliding(k, 7.0)
        return {name: np.stack([slow[name], fast[name]]) for name in slow}

    batch = evis.EventEmulator(*SIZE, batch=2)
    single = evis.EventEmulator(*SIZE)
    for k in range(3):
        first, second = batch.push_keyframe(**both(k), t_us=9000 * k)
        assert first == single.push_keyframe(**sliding(k), t_us=9000 * k)
    reports = batch.keyframe_report
    assert [report.steps for report in reports] == [10, 24]
    assert len(second) > len(first)
    assert "7.0 px per gap: render faster" in reports[1].warnings[0]
    first, second = batch.push_keyframe(**both(3), t_us=27_000, cut=[False, True])
    assert len(first) > 0
    assert len(second) == 0
    assert [report.cut for report in batch.keyframe_report] == ["none", "declared"]
    batch.reset([0])
    first, second = batch.push_keyframe(**both(4), t_us=36_000)
    assert [len(first) > 0, len(second) > 0] == [False, True]
    batch.push(both(5)["hdr"], 45_000)
    assert batch.keyframe_report is None


def test_state_is_taken_up_between_keyframes() -> None:
    whole = evis.EventEmulator(*SIZE, "v2e-noisy", seed=4)
    for k in range(2):
        whole.push_keyframe(**sliding(k), t_us=8000 * k)
    copies = [pickle.loads(pickle.dumps(whole)), evis.EventEmulator(*SIZE, "v2e-noisy", seed=4, threads=1)]
    copies[1].set_state(whole.get_state())
    expected = whole.push_keyframe(**sliding(2), t_us=16_000)
    assert len(expected) > 1000
    for copy in copies:
        assert copy.push_keyframe(**sliding(2), t_us=16_000) == expected


def turning(k: int, fields: int = 0) -> dict[str, Any]:
    """Return a picture that turns by 0.4 rad a gap, its motion, and that in fine steps where asked for."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]].astype(np.float64)
    u, v = x - (SIZE[0] - 1) / 2, y - (SIZE[1] - 1) / 2

    def turned(angle: float) -> tuple[Any, Any]:
        return u * np.cos(angle) - v * np.sin(angle), u * np.sin(angle) + v * np.cos(angle)

    def motion(angle: float) -> npt.NDArray[np.float32]:
        a, b = turned(-angle)
        return np.stack([a - u, b - v], axis=-1).astype(np.float32)

    a, b = turned(-0.4 * k)
    pictures: dict[str, Any] = {
        "hdr": (0.5 + 0.2 * np.sin(a / 3) + 0.2 * np.cos(b / 3.7)).astype(np.float32),
        "depth": np.full(a.shape, 2.0, np.float32),
        "motion_vectors": motion(0.4),
    }
    if fields:
        pictures["motion_steps"] = np.stack([motion(0.4 / fields)] * fields)
    return pictures


def test_motion_in_fine_steps_is_integrated() -> None:
    def run(fields: int, threads: int = 1, **changes: Any) -> tuple[evis.EventArray, Any]:
        emulator = evis.EventEmulator(*SIZE, threads=threads)
        pictures = [{**turning(k, fields), **changes} for k in range(3)]
        parts = [emulator.push_keyframe(**each, t_us=8000 * k) for k, each in enumerate(pictures)]
        assert emulator.total_report.copies == 0
        return joined(parts), emulator.keyframe_report

    dense, report = run(8)
    assert (report.steps, report.strayed < 0.5) == (8, True)
    assert report.bad_motion > 0, "the corners come from outside"
    assert run(8, threads=2)[0] == dense
    assert run(8, motion_vectors=None)[1].steps == 8
    assert run(8, steps=12)[1].steps == 12
    straight, report = run(0, steps=8)
    assert report.strayed == 0
    assert straight != dense
    # One field is the gap's own motion.
    assert run(1, steps=8)[0] == straight
    assert run(1, steps=8, motion_vectors=None)[0] == straight
    # A batch has an axis before it.
    batch = evis.EventEmulator(*SIZE, batch=2)
    still = {"motion_vectors": np.zeros((*SIZE[::-1], 2), np.float32)}
    parts = []
    for k in range(3):
        one, other = turning(k, 8), {**turning(0, 8), **still}
        other["motion_steps"] = other["motion_steps"] * 0
        lists = batch.push_keyframe(
            **{name: np.stack([one[name], other[name]]) for name in one}, t_us=8000 * k
        )
        parts.append(lists[0])
        assert len(lists[1]) == 0
    assert joined(parts) == dense
    with pytest.raises(evis.ConfigError, match=r"must have \(2, K, 72, 96, 2\)"):
        batch.push_keyframe(
            **{name: np.stack([GOOD[name]] * 2) for name in GOOD},
            t_us=10**6,
            motion_steps=one["motion_steps"],
        )


def test_bad_geometry_is_counted_and_held() -> None:
    emulator = evis.EventEmulator(*SIZE)
    for k in range(4):
        pictures = sliding(k)
        if k == 2:
            pictures["depth"][::3] = np.array([0, -1, np.nan, -np.inf], np.float32).repeat(24)
            pictures["motion_vectors"][1::3] = np.nan
            pictures["motion_vectors"][2::3, ::2] = 1e6
        events = emulator.push_keyframe(**pictures, t_us=8000 * k)
        report = emulator.keyframe_report
        assert (report.bad_depth > 0) == (report.bad_motion > 0) == (k == 2)
        if len(events):
            assert events.t[0] > 8000 * (k - 1)
            assert events.t[-1] <= 8000 * k


@pytest.mark.parametrize("warp", ["splat", "evis-paper"])
def test_displacement_takes_the_place_of_depth(warp: Any) -> None:
    def run(with_depth: bool) -> evis.EventArray:
        emulator = evis.EventEmulator(*SIZE)
        parts = []
        for k in range(4):
            pictures = sliding(k)
            if not with_depth:
                pictures["depth"] = None
            parts.append(emulator.push_keyframe(**pictures, t_us=8000 * k, steps=8, warp=warp))
            assert emulator.keyframe_report.bad_depth == 0
        return joined(parts)

    known, unknown = run(True), run(False)
    assert len(known) > 1000
    truth = evis.Truth.from_events(known, sensor=evis.Sensor(), duration_us=24_001)
    assert evis.metrics.score(unknown, truth).at(1000).plain.f1 > 0.9
    emulator = evis.EventEmulator(*SIZE)
    emulator.push_keyframe(**sliding(0), t_us=0)
    with pytest.raises(evis.ConfigError, match="depth is not given"):
        emulator.push_keyframe(**{**sliding(1), "depth": None}, t_us=8000)


def test_the_papers_setting_is_there() -> None:
    emulator = evis.EventEmulator(*SIZE, evis.Sensor(trigger="latch", log_eps=1e-5))
    for k in range(3):
        events = emulator.push_keyframe(**sliding(k), t_us=8000 * k, warp="evis-paper")
    assert emulator.keyframe_report.steps == 8
    assert len(events) > 0
    assert set(np.unique(events.t).tolist()) <= {8000 + 1000 * step for step in range(1, 9)}


def test_integers_are_the_light_that_their_curve_says() -> None:
    def light(codes: Any, transfer: str, most: int) -> Any:
        value = codes / most
        if transfer == "srgb":
            return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
        return value if transfer == "linear" else value**1.8

    for dtype, transfer, rgb in [
        (np.uint8, "srgb", False),
        (np.uint16, "gamma", False),
        (np.uint8, "linear", True),
        (np.uint16, "srgb", True),
    ]:
        most = int(np.iinfo(dtype).max)
        codes, floats, other = (evis.EventEmulator(*SIZE) for _ in range(3))
        count = 0
        for k in range(4):
            pictures = sliding(k)
            hdr = np.clip(pictures.pop("hdr"), 0, 1)
            hdr = np.stack([hdr, hdr**2, 1 - hdr], axis=-1) if rgb else hdr
            integers = np.round(hdr * most).astype(dtype)
            linear = light(integers.astype(np.float64), transfer, most).astype(np.float32)
            got = codes.push_keyframe(integers, **pictures, t_us=8000 * k, transfer=transfer, gamma=1.8)
            expected = floats.push_keyframe(linear, **pictures, t_us=8000 * k)
            wrong = other.push_keyframe(integers, **pictures, t_us=8000 * k, transfer="rec709")
            # RGB sums round in another order: a microsecond, or an event in a hundred.
            assert abs(len(got) - len(expected)) <= len(expected) * (0.01 if rgb else 0)
            if not rgb:
                # Powers of two libraries differ in their last place: a microsecond.
                pair = [got.to_numpy(), expected.to_numpy()]
                by_pixel = [one[np.lexsort((one["t"], one["x"], one["y"]))] for one in pair]
                assert all(np.array_equal(by_pixel[0][key], by_pixel[1][key]) for key in "xyp")
                assert np.abs(by_pixel[0]["t"] - by_pixel[1]["t"]).max(initial=0) <= 1
            assert k == 0 or len(wrong) != len(expected), "canary: another curve is other light"
            count += len(got)
        assert count > 1000, count


GOOD = sliding(0)


def bad_pushes() -> Iterator[tuple[dict[str, Any], str]]:
    yield {"t_us": 10}, "t_us is 10"
    yield {"t_us": 9}, "t_us is 9"
    yield {"hdr": GOOD["hdr"].astype(np.int64)}, "dtype of hdr is int64"
    yield {"hdr": (GOOD["hdr"] * 255).astype(np.int8)}, "dtype of hdr is int8.*uint16"
    yield {"transfer": "log"}, "logarithms"
    yield {"transfer": "srgb"}, "transfer is srgb.*float32"
    yield {"hdr": (GOOD["hdr"] * 255).astype(np.uint8), "transfer": "pq"}, "transfer is pq"
    yield {"hdr": (GOOD["hdr"] * 255).astype(np.uint8), "transfer": "gamma", "gamma": 0.0}, "gamma is 0"
    yield {"hdr": GOOD["hdr"][1:]}, r"hdr has shape \(71, 96\)"
    yield {"hdr": GOOD["hdr"] - 3}, "light of pixel"
    yield {"hdr": np.full_like(GOOD["hdr"], np.inf)}, "light of pixel"
    yield {"depth": GOOD["depth"].T}, r"depth has shape \(96, 72\)"
    yield {"motion_vectors": GOOD["motion_vectors"][..., 0]}, "motion_vectors has shape"
    yield {"motion_vectors": GOOD["motion_vectors"].transpose(2, 0, 1)}, "motion_vectors has shape"
    yield {"motion_vectors": None}, "motion_vectors is None.*motion_steps"
    yield {"motion_steps": GOOD["motion_vectors"]}, r"motion_steps has shape \(72, 96, 2\).*\(K, 72, 96, 2\)"
    yield {"motion_steps": GOOD["motion_vectors"][None, :0]}, r"motion_steps has shape \(1, 0, 96, 2\)"
    yield {"motion_steps": np.zeros((0, 72, 96, 2), np.float32)}, "K at least 1"
    yield {"motion_steps": np.zeros((1, 72, 96, 2), int)}, "dtype of motion_steps is int64"
    yield {"motion_forward": GOOD["depth"]}, "motion_forward has shape"
    yield {"depth": Tensor(GOOD["depth"], (2, 0))}, "depth: on DLPack device 2:0.*CPU"
    yield {"cut": [True, False]}, "cut is"
    yield {"cut": 1}, "cut is 1"
    yield {"steps": 0}, "steps is 0"
    yield {"steps": -1}, "steps|u32"
    yield {"warp": "splatt"}, "splatt"
    yield {"warp": evis.Warp(margin=5)}, r"\(82, 106\)"
    yield {"warp": evis.Warp(step_px=0.0)}, "step_px"
    yield {"warp": evis.Warp(variant="color")}, "color"  # type: ignore[arg-type]


@pytest.mark.parametrize(("changes", "said"), list(bad_pushes()))
def test_bad_pushes_are_named_and_change_nothing(changes: dict[str, Any], said: str) -> None:
    emulator = evis.EventEmulator(*SIZE)
    emulator.push_keyframe(**GOOD, t_us=10)
    state = emulator.get_state()
    with pytest.raises(evis.ConfigError, match=said):
        emulator.push_keyframe(**{**GOOD, "t_us": 20, **changes})
    assert emulator.get_state() == state
    emulator.push_keyframe(**GOOD, t_us=20)
