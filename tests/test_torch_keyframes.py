"""Keyframes to events in PyTorch, held against the engine on the same pictures on the CPU."""

from __future__ import annotations

import re
import subprocess
import sys
import types
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from host_stand_ins import HEIGHT, WIDTH, OnCard, Outputs, ProxyArray, install, sliding

import evis
import evis.gbuffer
import evis.isaaclab
from evis.gbuffer import DeviceEvents, EpisodeRecorder, EventPipeline, PipelineSettings

torch = pytest.importorskip("torch", reason="PyTorch is not installed: make test-torch")

from evis._torch_keyframes import TorchKeyframes  # noqa: E402

CROSSING = evis.Sensor(threshold_on=0.2, threshold_off=0.15)
LATCH = evis.Sensor(threshold_on=0.15, threshold_off=0.15, trigger="latch", log_eps=1e-5)

Picture = npt.NDArray[np.float32]
Keyframe = tuple[Picture, Picture, Picture, int]


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Pictures are small: threads that wait for each other on a busy machine take longer."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def moving(
    seed: int, envs: int, size: tuple[int, int], keyframes: int = 4, spoilt: bool = True
) -> list[Keyframe]:
    """Textured rectangles of light over six decades that move before a wall, with what they hide.

    Light, depth, motion vectors and time. Of every third environment the left border has no depth; of every
    third, some light, depth and motion is not known.
    """
    rng = np.random.default_rng(seed)
    height, width = size
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    scenes = []
    for _ in range(envs):
        cards = [
            (rng.uniform((0, 0), (width, height)), rng.uniform(4, width / 2, 2), rng.uniform(-6, 6, 2),
             rng.uniform(0.5, 4), rng.uniform(0.2, 2, 2), 10 ** rng.uniform(-3, 3))
            for _ in range(rng.integers(1, 4))
        ]  # fmt: skip
        wall = (
            np.array([width, height]) / 2,
            np.full(2, np.inf),
            rng.uniform(-3, 3, 2),
            8.0,
            rng.uniform(0.1, 1, 2),
            1.0,
        )
        scenes.append([wall, *sorted(cards, key=lambda card: -card[3])])
    made = []
    for k in range(keyframes):
        light = np.zeros((envs, height, width), np.float32)
        depth = np.full((envs, height, width), np.inf, np.float32)
        motion = np.zeros((envs, height, width, 2), np.float32)
        for env, scene in enumerate(scenes):
            for middle, extent, velocity, z, waves, gain in scene:
                u, v = x - (middle + k * velocity)[0], y - (middle + k * velocity)[1]
                inside = (abs(u) < extent[0] / 2) & (abs(v) < extent[1] / 2)
                texture = gain * (0.55 + 0.5 * np.sin(u * waves[0]) * np.cos(v * waves[1]))
                light[env][inside] = texture[inside]
                depth[env][inside] = z * (1 - 0.02 * k)
                motion[env][inside] = -velocity
            if spoilt and env % 3 == 1:
                depth[env][:, :5] = np.inf
            if spoilt and env % 3 == 2:
                for values, share in ((light, 0.03), (depth, 0.01), (motion, 0.03)):
                    values[env][rng.random((height, width)) < share] = np.nan
        made.append((light, depth, motion, 8000 * k + int(rng.integers(0, 100))))
    return made


def twins(
    envs: int, size: tuple[int, int], sensor: evis.Sensor, warp: evis.Warp, y_ref: float = 0.7
) -> tuple[evis.EventEmulator[list[evis.EventArray]], TorchKeyframes]:
    height, width = size
    engine = evis.EventEmulator(width, height, sensor, batch=envs, reference_luminance=y_ref)
    own = TorchKeyframes(
        envs, height, width, sensor=sensor, warp=warp, reference_luminance=y_ref, device="cpu"
    )
    return engine, own


def tensors(*arrays: npt.NDArray[Any] | None) -> list[Any]:
    return [None if array is None else torch.from_numpy(array) for array in arrays]


def bytes_of(events: Any) -> list[bytes]:
    return [own.to_numpy().tobytes() for own in events]


def f1(one: evis.EventArray, two: evis.EventArray) -> float:
    """Share of events that both have, all of t, x, y and p equal."""
    first, second = (set(map(tuple, events.to_numpy().tolist())) for events in (one, two))
    return 2 * len(first & second) / max(len(first) + len(second), 1)


# The events.


@pytest.mark.parametrize("margin", [0, 5])
@pytest.mark.parametrize("has_depth", [True, False])
@pytest.mark.parametrize("sensor", [CROSSING, LATCH], ids=["crossing", "latch"])
@pytest.mark.parametrize(
    "warp",
    [
        evis.Warp(),
        evis.Warp(steps=5),
        evis.Warp(step_px=1.0, detect_cuts=False),
        evis.Warp.evis_paper(8),
        evis.Warp(variant="evis-paper", detect_cuts=True),
    ],
    ids=["splat", "splat-5", "splat-all", "evis-paper-8", "evis-paper"],
)
def test_events_and_reports_are_the_engines(
    warp: evis.Warp, sensor: evis.Sensor, has_depth: bool, margin: int
) -> None:
    size, envs = (33, 46), 4
    warp = replace(warp, margin=margin)
    engine, own = twins(envs, size, sensor, warp)
    fired = 0
    canvas = (size[0] + 2 * margin, size[1] + 2 * margin)
    for light, depth, motion, t_us in moving(7 * margin + has_depth, envs, canvas):
        depth = depth if has_depth else None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            expected = engine.push_keyframe(light, depth, motion, t_us, warp=warp)
        found = own.push(*tensors(light, depth, motion), t_us)
        assert isinstance(found, DeviceEvents)
        assert list(own.reports) == engine.keyframe_report
        for one, two in zip(expected, found, strict=True):
            if warp.variant == "splat":
                assert one.to_numpy().tobytes() == two.to_numpy().tobytes()
            else:
                # Importances are powers of e in float64, whose last bit libraries round otherwise.
                assert f1(one, two) > 0.9999 or not len(one)
        fired += len(found.t)
    assert fired > 10_000
    if has_depth:
        assert sum(report.bad_depth for report in own.reports) > 5
    assert sum(report.bad_motion for report in own.reports) > 5
    # Canaries: motion of the other sign, a threshold that differs by a thousandth.
    later = t_us + 8000
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        expected = engine.push_keyframe(light, depth, -motion, later, warp=warp)
    found = own.push(*tensors(light, depth, motion), later)
    assert bytes_of(found) != bytes_of(expected)


def test_a_threshold_that_differs_by_a_thousandth_is_seen() -> None:
    warp = evis.Warp(steps=4)
    other = replace(CROSSING, threshold_on=CROSSING.threshold_on * 1.001)
    engine, _ = twins(2, (24, 32), CROSSING, warp)
    _, own = twins(2, (24, 32), other, warp)
    for light, depth, motion, t_us in moving(1, 2, (24, 32), spoilt=False):
        motion = motion.clip(-3, 3)
        expected = engine.push_keyframe(light, depth, motion, t_us, warp=warp)
        found = own.push(*tensors(light, depth, motion), t_us)
    assert min(f1(one, two) for one, two in zip(expected, found, strict=True)) < 0.999


@pytest.mark.parametrize("sensor", [evis.Sensor(threshold_on=0.001, threshold_off=0.001), CROSSING, LATCH])
def test_light_of_any_size_fires_as_often(sensor: evis.Sensor) -> None:
    engine, own = twins(1, (6, 8), sensor, evis.Warp())
    rng = np.random.default_rng(5)
    still = np.zeros((1, 6, 8, 2), np.float32)
    fired = 0
    for k in range(6):
        light = (10.0 ** rng.uniform(-38, 38, (1, 6, 8))).astype(np.float32)
        light[0, 0, :3] = (0, np.nan, np.finfo(np.float32).max)
        t_us = (1 + k) ** 9
        expected = engine.push_keyframe(light, None, still, t_us)
        found = own.push(*tensors(light, None, still), t_us)
        assert bytes_of(expected) == bytes_of(found)
        fired += len(found.t)
    assert fired > (100_000 if sensor.threshold_on == 0.001 else 20)


@pytest.mark.parametrize("warp", [evis.Warp(), evis.Warp.evis_paper(8)], ids=["splat", "evis-paper"])
def test_a_batch_fires_as_each_environment_alone(warp: evis.Warp, monkeypatch: pytest.MonkeyPatch) -> None:
    envs, size = 5, (24, 40)
    keyframes = moving(3, envs, size)
    _, together = twins(envs, size, CROSSING, warp)
    alone = [twins(1, size, CROSSING, warp)[1] for _ in range(envs)]
    # Two at once: environments are warped in groups, those of most instants first.
    monkeypatch.setattr(evis._torch_keyframes, "_CHUNK_PIXELS", 2 * size[0] * size[1])
    fired = 0
    for light, depth, motion, t_us in keyframes:
        found = together.push(*tensors(light, depth, motion), t_us)
        for env, own in enumerate(alone):
            single = own.push(*tensors(*(a[env : env + 1] for a in (light, depth, motion))), t_us)
            assert bytes_of([found[env]]) == bytes_of(single)
            assert together.reports[env] == own.reports[0]
            columns = zip((single.t, single.x, single.y, single.p), "txyp", strict=True)
            begin, end = found.offsets[env], found.offsets[env + 1]
            for column, name in columns:
                assert torch.equal(column, getattr(found, name)[begin:end])
        fired += len(found.t)
    assert fired > 10_000
    assert len({report.steps for report in together.reports}) > (warp.steps is None), "of many instants"


def test_chosen_environments_are_reset() -> None:
    warp, size = evis.Warp(), (24, 40)
    engine, own = twins(3, size, CROSSING, warp)
    for k, (light, depth, motion, t_us) in enumerate(moving(11, 3, size, 5)):
        if k == 2:
            engine.reset([1])
            own.reset([1])
        if k == 3:
            own.reset([])
        if k == 4:
            engine.reset()
            own.reset(range(3))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            expected = engine.push_keyframe(light, depth, motion, t_us, warp=warp)
        found = own.push(*tensors(light, depth, motion), t_us)
        assert bytes_of(expected) == bytes_of(found)
        assert [report.cut == "start" for report in own.reports] == [k in (0, 4), k in (0, 2, 4), k in (0, 4)]
        lengths = found.offsets.diff().tolist()
        assert [length == 0 for length in lengths] == [k in (0, 4), k in (0, 2, 4), k in (0, 4)]


@pytest.mark.parametrize("warp", [evis.Warp(steps=6), evis.Warp.evis_paper(6)], ids=["splat", "evis-paper"])
def test_a_still_scene_fires_nothing(warp: evis.Warp) -> None:
    _, own = twins(2, (24, 40), CROSSING, warp)
    light, depth, motion, _ = moving(2, 2, (24, 40), 1, spoilt=False)[0]
    motion[...] = 0
    for k in range(4):
        found = own.push(*tensors(light, depth, motion), 8000 * k)
        assert len(found.t) == 0
        assert found.offsets.tolist() == [0, 0, 0]
        assert bytes_of(found) == [b"", b""]
    # Canary: light that changes fires.
    assert len(own.push(*tensors(2 * light, depth, motion), 40_000).t) > 1000


def test_what_is_not_known_keeps_a_pixels_memory() -> None:
    _, own = twins(1, (4, 6), CROSSING, evis.Warp())
    still, depth = np.zeros((1, 4, 6, 2), np.float32), np.ones((1, 4, 6), np.float32)
    light = np.full((1, 4, 6), 0.5, np.float32)
    own.push(*tensors(light, depth, still), 0)
    gone = light.copy()
    gone[0, 1] = np.nan
    assert len(own.push(*tensors(gone, depth, still), 1000).t) == 0
    assert own.reports[0].unknown == 6
    # From 0.5 to 1.5, which it has not forgotten: as often as its neighbours.
    counts = own.push(*tensors(3 * light, depth, still), 2000).counts()
    assert counts.shape == (1, 4, 6, 2)
    assert counts[..., 1].unique().tolist() == [5]
    assert counts[..., 0].sum() == 0


def test_modes_of_pytorch_change_nothing() -> None:
    warp, size = evis.Warp(), (24, 32)
    keyframes = moving(4, 2, size)
    _, plain = twins(2, size, CROSSING, warp)
    with torch.inference_mode():
        _, own = twins(2, size, CROSSING, warp)
    default = torch.get_default_dtype()
    try:
        for k, (light, depth, motion, t_us) in enumerate(keyframes):
            expected = plain.push(*tensors(light, depth, motion), t_us)
            torch.set_default_dtype(torch.float64)
            with torch.inference_mode(k % 2 == 0):
                given = [tensor.clone() for tensor in tensors(light, depth, motion)]
                found = own.push(*given, t_us)
            torch.set_default_dtype(default)
            assert bytes_of(expected) == bytes_of(found)
            if k == 1:
                own.reset([0])
                plain.reset([0])
    finally:
        torch.set_default_dtype(default)
    assert len(found.t) > 1000
    assert not found.t.is_inference()


@pytest.mark.parametrize("warp", [evis.Warp(), evis.Warp.evis_paper(8)], ids=["splat", "evis-paper"])
@pytest.mark.parametrize("has_depth", [True, False])
def test_a_hosts_buffers_are_neither_kept_nor_changed(warp: evis.Warp, has_depth: bool) -> None:
    size = (24, 32)
    _, own = twins(2, size, CROSSING, warp)
    _, plain = twins(2, size, CROSSING, warp)
    buffers = tensors(*moving(4, 2, size, 1)[0][:3])
    fired = 0
    for *pictures, t_us in moving(4, 2, size):
        # As a renderer that writes into the same memory each time.
        for buffer, picture in zip(buffers, pictures, strict=True):
            buffer.copy_(torch.from_numpy(picture))
        light, depth, motion = buffers
        expected = plain.push(*tensors(pictures[0], pictures[1] if has_depth else None, pictures[2]), t_us)
        found = own.push(light, depth if has_depth else None, motion, t_us)
        assert bytes_of(expected) == bytes_of(found)
        pairs = zip(buffers, pictures, strict=True)
        assert all(np.array_equal(buffer, picture, equal_nan=True) for buffer, picture in pairs)
        changed = motion.clone()
        changed[0, 0, 0, 0] += 0.01
        assert own.is_last(light, motion)
        assert not own.is_last(light, changed), "canary"
        motion.copy_(changed)
        assert not own.is_last(light, motion)
        fired += len(found.t)
    assert fired > 1000


class OnHost(torch.Tensor):  # type: ignore[misc]
    """A tensor of NumPy's memory, of which nothing is made before it is brought to a device."""

    @classmethod
    def __torch_function__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if func is not torch.Tensor.to:
            raise AssertionError(f"{func} of a tensor on the host")
        with torch._C.DisableTorchFunctionSubclass():
            return func(*args, **(kwargs or {})).as_subclass(torch.Tensor)


@pytest.mark.parametrize("warp", [evis.Warp(), evis.Warp.evis_paper(8)], ids=["splat", "evis-paper"])
def test_nothing_is_made_on_another_device(warp: evis.Warp, monkeypatch: pytest.MonkeyPatch) -> None:
    # On a card, what is made without its device would be on the CPU: here, where nothing can be read.
    size = (24, 32)
    given = [(*tensors(*pictures), t_us) for *pictures, t_us in moving(4, 2, size)]
    _, plain = twins(2, size, CROSSING, warp)
    expected = [plain.push(*keyframe) for keyframe in given]
    from_numpy = torch.from_numpy
    monkeypatch.setattr(torch, "from_numpy", lambda array: from_numpy(array).as_subclass(OnHost))
    with torch.device("meta"):
        _, own = twins(2, size, CROSSING, warp)
        found = [own.push(*keyframe) for keyframe in given]
        own.reset([1])
        rest = found[-1].without([0])
        dense = [(e.counts(1000), e.voxel_grid(3, 1000, 30_000)) for e in (found[-1], rest)]
        codes = own.luminance(torch.zeros((2, *size, 3), dtype=torch.uint8, device="cpu"))
    for values in (codes, *dense[0], *dense[1]):
        assert values.device.type == "cpu"
    monkeypatch.undo()
    assert [bytes_of(one) for one in expected] == [bytes_of(two) for two in found]
    assert dense[0][0].sum() > dense[1][0].sum() > 0
    # Canaries.
    with torch.device("meta"), pytest.raises(RuntimeError, match="device"):
        torch.cat([given[0][0], torch.zeros(1)])
    with pytest.raises(AssertionError, match="on the host"):
        given[0][0] + from_numpy(np.ones(1, np.float32)).as_subclass(OnHost)


def test_bad_input_is_refused_and_changes_nothing() -> None:
    warp, size = evis.Warp(steps=3), (24, 32)
    _, own = twins(2, size, CROSSING, warp)
    _, twin = twins(2, size, CROSSING, warp)
    keyframes = moving(6, 2, size)
    for one in (own, twin):
        one.push(*tensors(*keyframes[0][:3]), 0)
    light, depth, motion = tensors(*keyframes[1][:3])
    impossible = light.clone()
    impossible[1, 3, 5] = -0.5
    infinite = light.clone()
    infinite[0, 2, 1] = np.inf
    for given, t_us, said in [
        ((light[:1], depth, motion), 8000, r"light has shape \(1, 24, 32\)"),
        ((light, depth.double(), motion), 8000, "depth has shape .* dtype torch.float64"),
        ((light, depth, motion[..., :1]), 8000, r"motion_vectors has shape \(2, 24, 32, 1\)"),
        ((light, depth, motion.to("meta")), 8000, "motion_vectors is on meta; it must be on cpu"),
        ((light, depth.to("meta"), motion), 8000, "depth is on meta"),
        ((light, depth, motion.numpy()), 8000, "motion_vectors is .* it must be a tensor on cpu"),
        ((light, None, motion), 8000, "depth is not given; it must be given, as at the last keyframe"),
        ((impossible, depth, motion), 8000, r"light of pixel \(5, 3\) of environment 1 is -0\.5"),
        ((infinite, depth, motion), 8000, r"light of pixel \(1, 2\) of environment 0 is inf"),
        ((light, depth, motion), 0, "t_us is 0; it must be above 0"),
        ((light, depth, motion), 2**30 + 1, "at most 1073741824 microseconds after"),
    ]:
        with pytest.raises(evis.ConfigError, match=said):
            own.push(*given, t_us)
    found = own.push(light, depth, motion, 8000)
    assert bytes_of(found) == bytes_of(twin.push(light, depth, motion, 8000))
    assert len(found.t) > 100


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"sensor": evis.Sensor.preset("evis")}, "thresholds, log_eps and trigger alone"),
        ({"sensor": evis.Sensor(trigger="difference")}, "thresholds, log_eps and trigger alone"),
        ({"warp": evis.Warp(steps=0)}, "steps"),
        ({"warp": evis.Warp(step_px=1e-3)}, "step_px"),
        ({"warp": evis.Warp(keyframe_hz=30)}, "keyframe_hz"),
        ({"reference_luminance": 0.0}, "reference_luminance"),
        ({"height": 1 << 12, "width": 1 << 12}, "size of a keyframe is 4096x4096"),
    ],
)
def test_settings_that_cannot_be_used_are_named(changed: dict[str, Any], said: str) -> None:
    given: dict[str, Any] = {
        "num_envs": 1, "height": 8, "width": 8, "sensor": CROSSING, "warp": evis.Warp(),
        "reference_luminance": 1.0, "device": "cpu",
    }  # fmt: skip
    with pytest.raises(evis.ConfigError, match=said):
        TorchKeyframes(**given | changed)


def test_constants_are_the_engines() -> None:
    crates = Path(__file__).parent.parent / "crates" / "evis-core" / "src"
    text = "".join(
        (crates / name).read_text()
        for name in (
            "emulator/keyframes/warp.rs", "emulator/keyframes/links.rs", "emulator/keyframes/push.rs",
            "emulator/order.rs", "sensor.rs",
        )
    )  # fmt: skip
    own = evis._torch_keyframes
    same = {
        "SUBPIXEL_BITS": own._SUBPIXEL_BITS,
        "SAME_SURFACE": own._SAME_SURFACE,
        "MOTION_LIMIT": own._MOTION_LIMIT,
        "MOST_PIXELS": own._MOST_PIXELS,
        "SHARPNESS": own._SHARPNESS,
        "MOST_EXPONENT": own._MOST_EXPONENT,
        "HOLE_BELOW": own._HOLE_BELOW,
        "USUAL_STEP_PX": own._STEP_PX,
        "SAME_OVER_TIME": own._SAME_OVER_TIME,
        "LEAST_LINKED": own._LEAST_LINKED,
        "FASTEST_SHARE": own._FASTEST_SHARE,
        "ROUNDS": own._ROUNDS,
        "MOST_STEPS": own._MOST_STEPS,
        "UNDIVIDED_PX": own._UNDIVIDED_PX,
        "NO_DEPTH": own._NO_DEPTH,
        "NEARNESS_PER_PX": own._NEARNESS_PER_PX,
        "LARGEST_INVERSE_DEPTH": own._LARGEST_INVERSE_DEPTH,
        "WARN_GAP_PX": own._WARN_GAP_PX,
        "MAX_INTERVAL_US": own._MOST_INTERVAL_US,
        "MAX_EVENTS_PER_INTERVAL": own._MOST_EVENTS,
    }
    for name, value in same.items():
        (found,) = re.findall(rf"const {name}: \w+ = ([^;]+);", text)
        engine = float(found) if "<<" not in found else 1 << int(found.split("<<")[1])
        assert engine == value, name
    # One pixel around: `_nearest_around`.
    assert re.findall(r"const DILATION: usize = (\d+);", text) == ["1"]


# Events on their device.


def test_dense_arrays_are_those_of_the_events() -> None:
    _, own = twins(3, (24, 32), CROSSING, evis.Warp())
    for light, depth, motion, t_us in moving(8, 3, (24, 32)):
        found = own.push(*tensors(light, depth, motion), t_us)
    start_us, end_us = int(found.t.min()) + 2000, t_us + 1
    counts, grid = found.counts(), found.voxel_grid(4, start_us, end_us)
    assert (counts.dtype, grid.dtype) == (torch.int32, torch.float32)
    for env, events in enumerate(found):
        assert len(events) > 300
        assert np.array_equal(counts[env], np.moveaxis(events.counts(), 0, -1))
        late = np.moveaxis(events.counts(start_us=start_us), 0, -1)
        assert np.array_equal(found.counts(start_us)[env], late)
        assert late.sum() < counts[env].sum(), "canary"
        wanted = np.moveaxis(events.voxel_grid(4, start_us=start_us, end_us=end_us), 0, -1)
        assert np.allclose(grid[env], wanted, atol=1e-4)
        assert abs(wanted).max() > 1
        assert not np.allclose(grid[env], np.roll(wanted, 1, axis=-1), atol=1e-4), "canary"
        flat = np.moveaxis(events.voxel_grid(1, start_us=start_us, end_us=end_us), 0, -1)
        assert np.allclose(found.voxel_grid(1, start_us, end_us)[env], flat, atol=1e-4)
    rest = found.without([0, 2])
    assert bytes_of(rest) == [b"", *bytes_of(found)[1:2], b""]
    assert rest.environments.unique().tolist() == [1]
    assert bytes_of(found[1:]) == bytes_of(found)[1:]
    assert "3 environments, 32x24, cpu" in repr(found)


# In the pipeline.


def pipelines(envs: int = 2, **settings: Any) -> tuple[EventPipeline, EventPipeline]:
    """By the engine, and in PyTorch."""
    engine, own = (
        EventPipeline(envs, HEIGHT, WIDTH, PipelineSettings(backend=backend, **settings))
        for backend in ("engine", "torch")
    )
    return engine, own


def as_tensors(outputs: Outputs) -> dict[str, Any]:
    return {name: torch.from_numpy(array.copy()) for name, array in outputs.items()}


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"warp": "evis-paper", "sensor": LATCH},
        {"window_us": 20_000, "voxel_bins": 3, "steps": 4},
        {"motion_scale": (-1.0, -1.0), "reference_luminance": 0.3},
    ],
    ids=["default", "evis-paper", "window", "scaled"],
)
def test_the_pipeline_makes_the_same_of_tensors(settings: dict[str, Any]) -> None:
    engine, own = pipelines(3, **settings)
    assert own.backend is None
    fired = 0
    for k in range(6):
        outputs = sliding(k, 3)
        outputs["motion_vectors"] *= np.float32(settings.get("motion_scale", (1, 1)))
        outputs["rgb_radiance"][1, :4] = np.nan
        expected = engine.push(outputs, 8000 * k)
        given = as_tensors(outputs)
        found = own.push(
            {name: ProxyArray(tensor) for name, tensor in given.items()} if k % 2 else given, 8000 * k
        )
        assert isinstance(found, DeviceEvents)
        assert own.backend == "torch"
        assert own.events is found
        assert bytes_of(expected) == bytes_of(found)
        assert own.reports == engine.reports
        assert own.motion_checked == engine.motion_checked
        for name, array in engine.output.items():
            tensor = own.output[name]
            assert tensor.dtype == getattr(torch, array.dtype.name)
            assert np.allclose(tensor, array, atol=1e-4)
            assert array.any() == (k > 0)
        # A picture that comes twice.
        assert len(own.push(given, 8000 * k + 500).t) == 0
        assert own.now_us == 8000 * k
        fired += len(found.t)
        if k == 3:
            for one in (engine, own):
                one.reset([1])
            assert not own.output["event_counts"][1].any()
            assert np.array_equal(own.output["event_counts"], engine.output["event_counts"])
            assert bytes_of(own.events) == bytes_of(engine.events)
    assert fired > 3000
    assert own.motion_checked


def test_codes_and_black_pictures_are_as_by_the_engine() -> None:
    engine, own = pipelines(2, light="ldr", check_motion=False)
    nothing = {name: np.zeros_like(array) for name, array in sliding(0).items()}
    nothing["rgb"] = nothing.pop("rgb_radiance").astype(np.uint8)
    assert len(own.push(as_tensors(nothing), 0).t) == 0  # type: ignore[attr-defined]
    assert own.now_us is None
    fired = 0
    for k in range(4):
        outputs = sliding(k)
        outputs["rgb"] = (255 * np.clip(outputs.pop("rgb_radiance"), 0, 1)).astype(np.uint8)
        if k == 3:
            # One channel of floats is taken as it is.
            outputs["rgb"] = (outputs["rgb"][..., :1] / np.float32(255)).astype(np.float32)
        expected, found = engine.push(outputs, 8000 * k), own.push(as_tensors(outputs), 8000 * k)
        assert bytes_of(expected) == bytes_of(found)
        fired += len(found[0])
    assert fired > 1000


@pytest.mark.parametrize("channels", [1, 3])
def test_held_environments_are_as_by_the_engine(channels: int) -> None:
    engine, own = pipelines()
    for k in range(4):
        outputs, hold = sliding(k), [1] if k == 1 else []
        outputs["rgb_radiance"] = outputs["rgb_radiance"][..., :channels]
        given = as_tensors(outputs)
        expected, found = engine.push(outputs, 8000 * k, hold=hold), own.push(given, 8000 * k, hold=hold)
        assert bytes_of(expected) == bytes_of(found)
        assert (len(found[1]) != len(found[0])) == (k > 0), "its own events, of what it saw last"
        assert not given["rgb_radiance"].isnan().any(), "the host's picture is left alone"


def test_wrong_vectors_and_still_pictures_that_fire_are_named() -> None:
    _, own = pipelines()
    own.push(as_tensors(sliding(0)), 0)
    outputs = sliding(1)
    with pytest.raises(evis.ConfigError, match=r"set motion_scale=\(-1, -1\)"):
        own.push(as_tensors({**outputs, "motion_vectors": -outputs["motion_vectors"]}), 8000)
    assert own.now_us == 0
    own.push(as_tensors(outputs), 8000)
    assert own.motion_checked
    engine, own = pipelines()
    said: list[list[str]] = []
    for one in (engine, own):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            for k in range(6):
                outputs = sliding(0)
                outputs["motion_vectors"][...] = 0
                outputs["rgb_radiance"] *= np.float32(1.1) ** k
                one.push(as_tensors(outputs), 8000 * k)
        said.append([str(warning.message) for warning in caught])
    assert said[0] == said[1]
    assert "automatic exposure" in said[1][0]
    # What moves by more than 4 px per gap is said once.
    _, own = pipelines(check_motion=False)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for k in range(3):
            own.push(as_tensors(sliding(k, step=(7.0 + k, 0.0))), 8000 * k)
    assert ["px per gap: render faster" in str(warning.message) for warning in caught] == [True]


def test_episodes_are_written_of_events_on_a_device(tmp_path: Path) -> None:
    for name, one in zip(("engine", "torch"), pipelines(), strict=True):
        with EpisodeRecorder(tmp_path / name) as recorder:
            one.record(recorder)
            for k in range(5):
                if k == 3:
                    one.reset([1])
                one.push(as_tensors(sliding(k)), 5000 + 8000 * k)
    names = sorted(path.name for path in (tmp_path / "engine").iterdir())
    assert names == ["env0000_ep0000.h5", "env0001_ep0000.h5", "env0001_ep0001.h5"]
    for name in names:
        first, second = (evis.load(tmp_path / one / name) for one in ("engine", "torch"))
        assert np.array_equal(first["camera"].events.to_numpy(), second["camera"].events.to_numpy())
        assert len(first["camera"].events) > 500


def test_bad_input_of_the_pipeline_changes_nothing() -> None:
    _, own = pipelines()
    _, twin = pipelines()
    for one in (own, twin):
        one.push(as_tensors(sliding(0)), 0)
    good = as_tensors(sliding(1))
    light, depth, motion = good.values()
    for bad, said in [
        ({"rgb_radiance": light[0]}, r"rgb_radiance has shape \(48, 64, 3\); it must have \(2, 48, 64, 3\)"),
        ({"rgb_radiance": light.long()}, "dtype of rgb_radiance is int64; it must be float32"),
        ({"rgb_radiance": -light}, "light of pixel"),
        ({"rgb_radiance": object()}, "it must be an array or a tensor of numbers"),
        ({"rgb_radiance": light.to("meta")}, "rgb_radiance is on meta; it must be on cpu"),
        ({"distance_to_image_plane": depth[:1]}, r"depth has shape \(1, 48, 64, 1\)"),
        ({"distance_to_image_plane": depth.to("meta")}, "depth is on meta; .* or set backend='engine'"),
        ({"motion_vectors": motion[..., :1]}, r"motion_vectors has shape \(2, 48, 64, 1\)"),
        ({"motion_vectors": motion.to("meta")}, "motion_vectors is on meta"),
    ]:
        with pytest.raises(evis.ConfigError, match=said):
            own.push({**good, **bad}, 8000)
    assert own.now_us == 0
    # Halves, doubles and arrays are taken.
    given = {**good, "distance_to_image_plane": depth.double(), "motion_vectors": motion.numpy()}
    found = own.push({**given, "rgb_radiance": light.double()}, 8000)
    assert bytes_of(found) == bytes_of(twin.push(good, 8000))
    assert len(found[0]) > 100
    with pytest.raises(evis.ConfigError, match="stages beyond its thresholds"):
        pipelines(sensor="evis")
    with pytest.raises(evis.ConfigError, match="backend is 'cuda'"):
        EventPipeline(2, HEIGHT, WIDTH, PipelineSettings(backend="cuda"))  # type: ignore[arg-type]


@dataclass(frozen=True)
class Device:
    type: str
    index: int = 0


class Tensor:
    """A tensor of a stand-in of PyTorch."""

    def __init__(self, kind: str, index: int = 0) -> None:
        self.device = Device(kind, index)

    def detach(self) -> Tensor:
        return self


def test_pytorch_is_chosen_where_all_tensors_are_on_one_card(monkeypatch: pytest.MonkeyPatch) -> None:
    on_one_card = evis.gbuffer._on_one_card
    monkeypatch.setitem(sys.modules, "torch", types.SimpleNamespace(Tensor=Tensor))
    here = Tensor("cuda")
    assert on_one_card((here, Tensor("cuda"), ProxyArray(here)))
    assert on_one_card((here, None, here)), "without depth"
    for other in (Tensor("cpu"), Tensor("cuda", 1), np.zeros(3), OnCard(np.zeros(3)), [0.0]):
        assert not on_one_card((here, here, other))
    assert not on_one_card((Tensor("cpu"), Tensor("cpu"), Tensor("cpu")))
    assert not on_one_card((Tensor("mps"), Tensor("mps"), Tensor("mps"))), "there are no float64 there"
    monkeypatch.delitem(sys.modules, "torch")
    assert not on_one_card((here, here, here))


def test_the_choice_is_made_once_and_follows_the_sensor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evis.gbuffer, "_on_one_card", lambda given: True)
    ideal, noisy = (EventPipeline(2, HEIGHT, WIDTH, PipelineSettings(sensor=name)) for name in (None, "evis"))
    for k in range(2):
        ideal.push(as_tensors(sliding(k)), 8000 * k)
        noisy.push(as_tensors(sliding(k)), 8000 * k)
    assert (ideal.backend, noisy.backend) == ("torch", "engine")
    monkeypatch.undo()
    plain = EventPipeline(2, HEIGHT, WIDTH)
    plain.push(as_tensors(sliding(0)), 0)
    assert plain.backend == "engine", "tensors on the CPU"
    with pytest.warns(UserWarning, match="copies .* MB .*; the sensor has stages beyond its thresholds"):
        noisy.push({name: OnCard(array) for name, array in sliding(2).items()}, 16_000)


# In Isaac Lab.


@pytest.mark.parametrize("release", ["2.3.2", "3.0.0"])
def test_isaac_labs_sensor_reads_no_picture_on_the_host(
    release: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(monkeypatch, release)
    light = "HdrColor" if release < "3" else "rgb_hdr"
    made = []
    for backend in ("engine", "torch"):
        configuration = evis.isaaclab.EventCameraCfg(
            prim_path="{ENV_REGEX_NS}/cam", spawn=None, width=WIDTH, height=HEIGHT, exposure_locked=True,
            data_types=[], backend=backend,
        )  # fmt: skip
        camera = configuration.class_type(configuration)
        shown = iter(range(99))

        def render(camera: Any = camera, shown: Any = shown) -> Outputs:
            outputs = sliding(next(shown))
            outputs[light] = outputs.pop("rgb_radiance")
            return {name: outputs[name] for name in camera.cfg.data_types}

        camera.render = render
        camera.play()
        made.append(camera)
    engine, own = made
    for camera in made:
        for _ in range(3):
            camera.update(0.008)
    assert own.pipeline.motion_checked, "until then, pictures of one environment are read"
    read: list[int] = []
    for name in ("cpu", "numpy", "tolist", "item", "__array__"):
        was = getattr(torch.Tensor, name)

        def recorded(tensor: Any, *args: Any, was: Any = was, **kwargs: Any) -> Any:
            read.append(tensor.numel())
            return was(tensor, *args, **kwargs)

        monkeypatch.setattr(torch.Tensor, name, recorded)
    own.update(0.008)
    output = own.data.output
    assert read
    assert max(read) <= 16, "numbers per environment, and nothing per pixel or event"
    # Canary: reading the events of an environment copies them.
    assert len(own.pipeline.events[0]) > 100
    assert max(read) > 100
    monkeypatch.undo()
    engine.update(0.008)
    for name in ("event_counts", "event_voxels"):
        one, two = (
            each.torch if isinstance(each, ProxyArray) else each
            for each in (engine.data.output[name], output[name])
        )
        assert isinstance(two, torch.Tensor)
        assert torch.allclose(one.float(), two.float(), atol=1e-4)
        assert two.any()
    evis.isaaclab._classes.cache_clear()


def test_importing_evis_imports_no_pytorch() -> None:
    code = "import sys, evis, evis.gbuffer, evis.isaaclab; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
