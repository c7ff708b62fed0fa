"""G-buffers of a renderer become events; motion vectors are checked, or made of poses."""

from __future__ import annotations

import ast
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from host_stand_ins import HEIGHT, WIDTH, OnCard, Outputs, sliding

import evis
from evis.gbuffer import (
    EpisodeRecorder,
    EventPipeline,
    MotionFromPoses,
    PipelineSettings,
    check_static,
    motion_from_poses,
)
from evis.motion import ConstantVelocity, Placement, Spin

END_US = 100_001
PAPER = [(1000, 1), (250, 4), (125, 8), (40, 8), (30, 8)]
"""Renders per second, and instants per gap, of the EVIS paper's table."""


def rendered(
    rate_hz: float, start: float = 0.0, end_us: int = END_US
) -> tuple[list[tuple[int, Outputs]], float]:
    """G-buffers of our own renderer in Isaac's shapes, (1, H, W, C), with their times, and Y_ref."""
    simulator = evis.Simulator(
        evis.Scene.builtin("spinner"),
        size=(WIDTH, HEIGHT),
        labels=["hdr", "depth", "flow"],
        label_rate_hz=rate_hz,
        rate_hz=rate_hz,
        samples=1,
        start=start,
    )
    labels = simulator.step(end_us).labels
    made = []
    for i, t_us in enumerate(labels["hdr"].t_us):
        made.append(
            (
                int(t_us),
                {
                    "rgb_radiance": labels["hdr"].images[i][None],
                    "distance_to_image_plane": labels["depth"].images[i][None, ..., None],
                    "motion_vectors": labels["flow_backward"].images[i][None],
                },
            )
        )
    assert simulator.reference_luminance is not None
    return made, simulator.reference_luminance


def joined(parts: list[evis.EventArray]) -> evis.EventArray:
    return evis.EventArray(np.concatenate([part.to_numpy() for part in parts]), width=WIDTH, height=HEIGHT)


def pipeline(envs: int = 2, **settings: Any) -> EventPipeline:
    return EventPipeline(envs, HEIGHT, WIDTH, PipelineSettings(**settings))


# The events.


@pytest.mark.parametrize(("rate_hz", "steps"), PAPER)
def test_the_papers_settings_fire_as_the_engine_does(device: evis.Device, rate_hz: int, steps: int) -> None:
    keyframes, y_ref = rendered(rate_hz)
    sensor = evis.Sensor(threshold_on=0.15, threshold_off=0.15, trigger="latch", log_eps=1e-5)
    warp = evis.Warp(variant="evis-paper", keyframe_hz=rate_hz, steps=steps, margin=0)
    engine = evis.Simulator(
        evis.Scene.builtin("spinner"),
        size=(WIDTH, HEIGHT),
        method=warp,
        sensor=sensor,
        samples=1,
        texture_taps=4,
        reference_luminance=y_ref,
    )
    direct = engine.step(END_US).events
    truth = evis.Truth.from_events(
        evis.EventArray(direct, width=WIDTH, height=HEIGHT), sensor=sensor, duration_us=END_US
    )

    def pushed(sign: float, late: bool = False) -> evis.EventArray:
        own = pipeline(
            1,
            sensor=sensor,
            warp="evis-paper",
            steps=steps,
            reference_luminance=y_ref,
            motion_scale=(sign, sign),
            check_motion=False,
        )
        parts = []
        for i, (t_us, outputs) in enumerate(keyframes):
            parts += own.push(keyframes[max(i - 3, 0)][1] if late else outputs, t_us)
        assert {report.steps for report in own.reports} == {steps}
        return joined(parts)

    # A label's light is the engine's own, rounded otherwise.
    found = evis.metrics.score(pushed(1.0), truth).at(1000).plain.f1
    assert found > 0.95
    assert len(direct) > 1000
    assert evis.metrics.score(pushed(1.0, late=True), truth).at(1000).plain.f1 < found - 0.02, "canary"
    if steps > 1:
        assert evis.metrics.score(pushed(-1.0), truth).at(1000).plain.f1 < found - 0.02, "canary"


def test_environments_fire_as_they_would_alone(device: evis.Device) -> None:
    both = [rendered(125, start, 40_001)[0] for start in (0.0, 0.13)]
    own = pipeline(2, sensor="evis", warp="evis-paper", seed=3, check_motion=False)
    alone = [evis.EventEmulator(WIDTH, HEIGHT, "evis", batch=2, seed=3) for _ in both]
    fired = 0
    for (t_us, first), (_, second) in zip(*both, strict=True):
        together = own.push({name: np.concatenate([first[name], second[name]]) for name in first}, t_us)
        for env, outputs in enumerate((first, second)):
            # Beside a neighbour of other light.
            pair = {name: np.concatenate([array] * 2) for name, array in outputs.items()}
            single = alone[env].push_keyframe(
                pair["rgb_radiance"],
                pair["distance_to_image_plane"],
                pair["motion_vectors"],
                t_us,
                warp="evis-paper",
            )
            assert np.array_equal(together[env].to_numpy(), single[env].to_numpy())
            assert (
                env == 0
                or not np.array_equal(together[0].to_numpy(), single[1].to_numpy())
                or not len(single[1])
            )
        fired += sum(map(len, together))
    assert fired > 1000


def test_dense_arrays_hold_the_events_of_the_gap_or_the_window() -> None:
    gap, window = pipeline(voxel_bins=4), pipeline(voxel_bins=4, window_us=16_000)
    events: list[list[evis.EventArray]] = []
    for k in range(4):
        outputs = sliding(k)
        assert not gap.output["event_counts"].any() or k > 1
        events.append(gap.push(outputs, 8000 * k))
        window.push(outputs, 8000 * k)
    for env in range(2):
        last, two = events[3][env], joined([events[2][env], events[3][env]])
        assert len(last) > 500
        counts, voxels = gap.output["event_counts"], gap.output["event_voxels"]
        assert counts.shape == (2, HEIGHT, WIDTH, 2)
        assert counts.dtype == np.int32
        assert voxels.shape == (2, HEIGHT, WIDTH, 4)
        assert voxels.dtype == np.float32
        assert np.array_equal(counts[env], np.moveaxis(last.counts(), 0, -1))
        grid = last.voxel_grid(4, start_us=16_001, end_us=24_001)
        assert np.array_equal(voxels[env], np.moveaxis(grid, 0, -1))
        wide = window.output["event_counts"][env]
        assert np.array_equal(wide, np.moveaxis(two.counts(), 0, -1))
        assert wide.sum() > counts[env].sum()
    gap.reset([1])
    assert gap.output["event_counts"][0].any()
    assert not gap.output["event_counts"][1].any()


def test_chosen_environments_are_reset() -> None:
    own, still_going = pipeline(3), pipeline(3)
    for k in range(3):
        own.push(sliding(k, 3), 8000 * k)
        still_going.push(sliding(k, 3), 8000 * k)
    own.reset([1])
    # The picture jumps: a teleported robot.
    jump = sliding(3, 3)
    jump["rgb_radiance"][1] = 0.9 - jump["rgb_radiance"][1]
    fired, others = own.push(jump, 24_000), still_going.push(jump, 24_000)
    assert len(fired[1]) == 0
    assert len(others[1]) > 0, "canary: without a reset the jump fires"
    for env in (0, 2):
        assert len(fired[env]) > 0
        assert np.array_equal(fired[env].to_numpy(), others[env].to_numpy())
    assert [report.cut for report in own.reports] == ["none", "start", "none"]
    own.reset()
    assert sum(map(len, own.push(sliding(9, 3), 32_000))) == 0


def test_episodes_are_files_with_a_group_per_camera(tmp_path: Path) -> None:
    settings = PipelineSettings()
    cameras = [EventPipeline(2, HEIGHT, WIDTH, settings, name=name) for name in ("cam0", "cam1")]
    with EpisodeRecorder(tmp_path / "out") as recorder:
        for camera in cameras:
            camera.record(recorder)
        kept: dict[tuple[str, int, int], list[npt.NDArray[np.void]]] = {}
        episodes = [0, 0]
        for k in range(6):
            if k == 3:
                for camera in cameras:
                    camera.reset([1])
                assert [path.name for path in recorder.paths] == ["env0001_ep0000.h5"]
                episodes[1] += 1
            for n, camera in enumerate(cameras):
                lists = camera.push(sliding(k, step=(2.0 + n, 1.0)), 5000 + 8000 * k)
                for env, events in enumerate(lists):
                    start = 5000 + (8000 * 3 if episodes[env] else 0)
                    part = events.to_numpy().copy()
                    part["t"] -= start
                    kept.setdefault((camera.name, env, episodes[env]), []).append(part)
    names = {"env0000_ep0000.h5", "env0001_ep0000.h5", "env0001_ep0001.h5"}
    assert (
        {path.name for path in recorder.paths}
        == names
        == {path.name for path in (tmp_path / "out").iterdir()}
    )
    for (name, env, episode), parts in kept.items():
        recording = evis.load(tmp_path / "out" / f"env{env:04d}_ep{episode:04d}.h5")
        assert recording.complete
        assert np.array_equal(recording[name].events.to_numpy(), np.concatenate(parts))
        assert len(recording[name].events) > 500
    with pytest.raises(evis.ConfigError, match="'cam0', which writes here already"):
        EventPipeline(2, HEIGHT, WIDTH, name="cam0").record(recorder)
    again = EventPipeline(1, HEIGHT, WIDTH, name="cam0")
    again.record(EpisodeRecorder(tmp_path / "out"))
    again.push(sliding(0, 1), 0)
    again.push(sliding(1, 1), 8000)
    with pytest.raises(FileExistsError, match="env0000_ep0000"):
        again.reset()


# What hosts give.


class Proxy:
    """What Isaac Lab 3 wraps tensors in: it warns where it is taken for one."""

    def __init__(self, tensor: Any) -> None:
        self._tensor = tensor

    @property
    def torch(self) -> Any:
        return self._tensor

    def __getattr__(self, name: str) -> Any:
        raise AssertionError(f"{name}: a proxy is asked for its tensor, and nothing else")


@pytest.mark.filterwarnings("error:camera. tensors are on")
def test_tensors_and_proxies_fire_as_arrays_do() -> None:
    torch = pytest.importorskip("torch")
    plain, tensors, proxies = pipeline(), pipeline(), pipeline()
    for k in range(3):
        outputs = sliding(k)
        first = plain.push(outputs, 8000 * k)
        as_tensors = {name: torch.from_numpy(array) for name, array in outputs.items()}
        as_tensors["rgb_radiance"].requires_grad_()
        # Four channels, as annotators give light: the fourth is ignored.
        rgba = np.concatenate(
            [outputs["rgb_radiance"], np.full((2, HEIGHT, WIDTH, 1), 7, np.float32)], axis=-1
        )
        wrapped = {name: Proxy(torch.from_numpy(array)) for name, array in outputs.items()}
        wrapped["rgb_radiance"] = Proxy(torch.from_numpy(rgba))
        for other, given in ((tensors, as_tensors), (proxies, wrapped)):
            for one, two in zip(first, other.push(given, 8000 * k), strict=True):
                assert np.array_equal(one.to_numpy(), two.to_numpy())
                assert len(one) > 0 or k == 0


def test_what_is_on_a_card_is_copied_and_said_once() -> None:
    own, plain = pipeline(), pipeline()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for k in range(3):
            outputs = sliding(k)
            there = {name: OnCard(array) for name, array in outputs.items()}
            lists = own.push(there, 8000 * k)
            for one, two in zip(lists, plain.push(outputs, 8000 * k), strict=True):
                assert np.array_equal(one.to_numpy(), two.to_numpy())
    (said,) = [str(warning.message) for warning in caught]
    assert "on cuda:0" in said
    assert f"copies {sum(array.nbytes for array in sliding(0).values()) / 1e6:.1f} MB" in said

    class Lost:
        device = "vulkan:0"

    with pytest.raises(evis.ConfigError, match="motion_vectors is on vulkan:0"):
        own.push({**sliding(3), "motion_vectors": Lost()}, 24_000)


def test_the_source_of_light_is_linear_unless_told_otherwise() -> None:
    base = sliding(0)
    light = base.pop("rgb_radiance")
    codes = (255 * np.clip(light, 0, 1)).astype(np.uint8)
    for name in ("rgb_hdr", "HdrColor"):
        with pytest.raises(
            evis.ConfigError, match=f"light is {name}, whose scale follows the camera's exposure"
        ):
            pipeline().push({**base, name: light}, 0)
        pipeline(exposure_locked=True).push({**base, name: light}, 0)
    with pytest.raises(evis.ConfigError, match="rgb is tone-mapped: light='ldr'"):
        pipeline(exposure_locked=True).push({**base, "rgb": codes}, 0)
    told = pipeline(light="ldr")
    told.push({**base, "rgb": codes}, 0)
    second = sliding(1)
    codes = (255 * np.clip(second.pop("rgb_radiance"), 0, 1)).astype(np.uint8)
    assert sum(map(len, told.push({**second, "rgb": codes}, 8000))) > 500
    # Where there are several, radiance is taken.
    both = pipeline()
    both.push({**base, "rgb_hdr": np.full_like(light, np.nan), "rgb_radiance": light}, 0)
    assert both.reports[0].unknown == 0
    assert both.now_us == 0


@pytest.mark.parametrize(
    ("given", "named", "remedy"),
    [
        ((-1.0, -1.0), "from the last keyframe to this one", "motion_scale=(-1, -1)"),
        ((1.0, -1.0), "y up", "motion_scale=(1, -1)"),
        ((1 / WIDTH, 1 / HEIGHT), "parts of the picture", f"motion_scale=({WIDTH}, {HEIGHT})"),
        ((2 / WIDTH, -2 / HEIGHT), "clip space", f"motion_scale=({WIDTH / 2:g}, {-HEIGHT / 2:g})"),
    ],
)
def test_wrong_motion_vectors_are_refused_and_named(
    given: tuple[float, float], named: str, remedy: str
) -> None:
    def moved(k: int, scale: tuple[float, float]) -> Outputs:
        outputs = sliding(k)
        return {**outputs, "motion_vectors": outputs["motion_vectors"] * np.float32(scale)}

    own = pipeline()
    own.push(moved(0, given), 0)
    assert not own.motion_checked
    with pytest.raises(evis.ConfigError) as refused:
        own.push(moved(1, given), 8000)
    assert named in str(refused.value)
    assert remedy in str(refused.value)
    assert own.now_us == 0, "nothing has changed"
    # What it says works.
    scale = ast.literal_eval(remedy.partition("=")[2])
    mended, right = pipeline(motion_scale=scale), pipeline()
    for k in range(2):
        mended.push(moved(k, given), 8000 * k)
        right.push(sliding(k), 8000 * k)
    assert mended.motion_checked
    assert right.motion_checked, "canary: the right convention passes"
    # Units are the same up to rounding.
    assert abs(len(mended.events[0]) - len(right.events[0])) < 0.01 * len(right.events[0])


def test_exchanged_axes_are_named_and_each_axis_is_checked() -> None:
    own = pipeline()
    own.push(sliding(0), 0)
    outputs = sliding(1)
    with pytest.raises(evis.ConfigError, match="y before x"):
        own.push({**outputs, "motion_vectors": outputs["motion_vectors"][..., ::-1]}, 8000)
    # Motion along x alone says nothing of y.
    flat = pipeline()
    for k in range(3):
        flat.push(sliding(k, step=(3.0, 0.0)), 8000 * k)
        assert not flat.motion_checked
    outputs = sliding(4)
    turned = {**outputs, "motion_vectors": outputs["motion_vectors"] * np.float32([1, -1])}
    flat.reset()
    flat.push(sliding(3), 24_000)
    with pytest.raises(evis.ConfigError, match="y up"):
        flat.push(turned, 32_000)
    flat.push(outputs, 32_000)
    assert flat.motion_checked


def jittered(kind: str, k: int) -> Outputs:
    """A still, textured picture that a renderer's filters change."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    bricks = ((x // 16 + y // 12) % 2).astype(np.float32)
    picture = 0.2 + 0.6 * bricks
    if kind == "auto-exposure":
        picture = picture * np.float32(1.1) ** k
    elif kind == "temporal antialiasing":
        picture = 0.2 + 0.6 * (((x + 0.5 * (k % 2) * 2) // 16 + y // 12) % 2).astype(np.float32)
    elif kind == "denoiser":
        picture = picture * np.exp(np.random.default_rng(k).normal(0, 0.2, picture.shape)).astype(np.float32)
    outputs = sliding(0)
    outputs["rgb_radiance"] = np.repeat(picture[None, ..., None], 2, axis=0) * np.ones(3, np.float32)
    outputs["motion_vectors"][...] = 0
    return outputs


@pytest.mark.parametrize("kind", ["auto-exposure", "temporal antialiasing", "denoiser"])
def test_still_pictures_that_fire_name_a_suspect(kind: str) -> None:
    first, last = (jittered(kind, k)["rgb_radiance"][0] for k in (0, 5))
    found = check_static(first, last)
    assert found.suspect == kind
    assert found.share > 0.01
    own = pipeline()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        fired = sum(len(events) for k in range(6) for events in own.push(jittered(kind, k), 8000 * k))
    (said,) = [str(warning.message) for warning in caught]
    assert found.advice in said
    assert fired > 100


def test_still_pictures_and_moving_ones_warn_of_nothing() -> None:
    own, moving = pipeline(), pipeline()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for k in range(6):
            own.push(jittered("none", k), 8000 * k)
            moving.push(sliding(k), 8000 * k)
    still = jittered("none", 0)["rgb_radiance"][0]
    assert check_static(still, still).suspect == "nothing"
    with pytest.raises(evis.ConfigError, match="two pictures of the same size"):
        check_static(still, still[1:])


def test_black_pictures_of_a_renderer_that_loads_are_left_out() -> None:
    own = pipeline()
    black = {name: np.zeros_like(array) for name, array in sliding(0).items()}
    assert sum(map(len, own.push(black, 0))) == 0
    assert own.now_us is None
    own.push(sliding(0), 8000)
    assert own.now_us == 8000
    # Later, black is light as any other.
    assert sum(map(len, own.push({**sliding(1), "rgb_radiance": black["rgb_radiance"]}, 16_000))) > 1000


def test_bad_input_is_refused_and_changes_nothing() -> None:
    own, twin = pipeline(), pipeline()
    own.push(sliding(0), 0)
    twin.push(sliding(0), 0)
    good = sliding(1)
    light, depth, motion = good.values()
    for bad, said in [
        ({"rgb_radiance": light[0]}, r"rgb_radiance has shape \(48, 64, 3\); it must have \(2, 48, 64, 3\)"),
        ({"rgb_radiance": light.transpose(0, 3, 1, 2)}, r"shape \(2, 3, 48, 64\)"),
        ({"rgb_radiance": light.astype(np.int64)}, "dtype of rgb_radiance is int64"),
        ({"rgb_radiance": -light}, "light|luminance"),
        ({"rgb_radiance": light * np.inf}, "light|luminance"),
        ({"rgb_radiance": [[["x"]]]}, "rgb_radiance"),
        ({"rgb_radiance": object()}, "it must be an array or a tensor of numbers"),
        ({"distance_to_image_plane": depth[:1]}, r"depth has shape \(1, 48, 64, 1\)"),
        ({"motion_vectors": motion[..., :1]}, r"motion_vectors has shape \(2, 48, 64, 1\)"),
        ({"motion_vectors": motion.astype(np.int32)}, "dtype of motion_vectors is int32"),
    ]:
        with pytest.raises(evis.ConfigError, match=said):
            own.push({**good, **bad}, 8000)
    for missing, said in [
        ("rgb_radiance", "it must have linear light: 'rgb_radiance' or 'rgb_hdr' or 'HdrColor'"),
        ("motion_vectors", "MotionFromPoses"),
    ]:
        with pytest.raises(evis.ConfigError, match=said):
            own.push({name: array for name, array in good.items() if name != missing}, 8000)
    along_rays = {"rgb_radiance": light, "distance_to_camera": depth, "motion_vectors": motion}
    with pytest.raises(evis.ConfigError, match="measured along rays"):
        own.push(along_rays, 8000)
    for t_us, said in [(0, "above 0"), (-5, "above 0"), (1.5, "whole number")]:
        with pytest.raises(evis.ConfigError, match=said):
            own.push(good, t_us)  # type: ignore[arg-type]
    with pytest.raises(evis.ConfigError, match="outputs is"):
        own.push([1, 2], 8000)  # type: ignore[arg-type]
    for ids, said in [
        ([2], "env_ids has 2"),
        ([-1], "env_ids has -1"),
        ([0.5], "env_ids"),
        ([True], "flatnonzero"),
    ]:
        with pytest.raises(evis.ConfigError, match=said):
            own.reset(ids)
    with pytest.raises(evis.ConfigError, match="hold has 7"):
        own.push(good, 8000, hold=[7])
    for one, two in zip(own.push(good, 8000), twin.push(good, 8000), strict=True):
        assert np.array_equal(one.to_numpy(), two.to_numpy())
        assert len(one) > 100


def test_a_picture_that_comes_twice_is_left_out() -> None:
    own, once = pipeline(), pipeline()
    for k in range(3):
        events = own.push(sliding(k), 8000 * k)
        assert np.array_equal(events[0].to_numpy(), once.push(sliding(k), 8000 * k)[0].to_numpy())
        assert len(events[0]) > 0 or k == 0
        assert sum(map(len, own.push(sliding(k), 8000 * k + 2000))) == 0
        assert own.now_us == 8000 * k
        assert own.output["event_counts"].any() == (k > 0), "what was seen last stays"
    # Canary: a picture that differs in one number is none that came before.
    outputs = sliding(2)
    outputs["motion_vectors"][0, 0, 0, 0] += 0.001
    own.push(outputs, 20_000)
    assert own.now_us == 20_000
    # A still scene goes on: noise has its time.
    still = pipeline()
    for k in range(3):
        still.push(jittered("none", 0), 8000 * k)
        assert still.now_us == 8000 * k


def test_nan_is_unknown_and_counted() -> None:
    own = pipeline()
    own.push(sliding(0), 0)
    outputs = sliding(1)
    outputs["rgb_radiance"][0, :10] = np.nan
    outputs["distance_to_image_plane"][0, 20:22] = np.nan
    outputs["motion_vectors"][0, 30:32] = np.nan
    events = own.push(outputs, 8000)
    first, second = own.reports
    assert (first.bad_depth, first.bad_motion) == (2 * WIDTH, 2 * WIDTH)
    assert first.unknown > second.unknown + 5 * WIDTH
    assert (second.bad_depth, second.bad_motion) == (0, 0)
    assert len(events[0]) < len(events[1])


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"light": "rgb"}, "light is 'rgb'"),
        ({"warp": "linear"}, "warp is 'linear'"),
        ({"steps": 0}, "steps"),
        ({"margin": -1}, "margin"),
        ({"margin": 4, "warp": evis.Warp(margin=3)}, "warp.margin 3"),
        ({"motion_scale": (1.0,)}, "motion_scale"),
        ({"motion_scale": (1.0, 0.0)}, "motion_scale"),
        ({"voxel_bins": 0}, "voxel_bins"),
        ({"window_us": -1}, "window_us"),
        ({"sensor": "no such"}, "no such"),
        ({"reference_luminance": 0.0}, "reference_luminance"),
    ],
)
def test_settings_that_cannot_be_used_are_named(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(evis.ConfigError, match=said):
        pipeline(**settings).push(sliding(0), 0)


# Motion from poses.


@pytest.fixture(scope="module")
def posed(device: evis.Device) -> dict[str, Any]:
    """A camera that flies past a box that spins and a ball that flies, with the poses of all three."""
    builder = evis.SceneBuilder("posed", ambient=(1.0, 1.0, 1.0))
    builder.texture("checker", pattern="checker")
    builder.material("painted", model="unlit", texture="checker")
    builder.plane("wall", size=(20, 20), material="painted", instance_id=1, pose=facing((0, 0, -6)))
    builder.box(
        "box",
        size=(1, 1, 1),
        material="painted",
        instance_id=7,
        pose=Placement(position=(-0.8, 0, -3), motion=Spin(degrees_per_s=90.0)),
    )
    builder.sphere(
        "ball",
        radius=0.5,
        material="painted",
        instance_id=9,
        pose=Placement(position=(0.8, 0, -2.5), motion=ConstantVelocity(velocity=(0.0, 1.5, 0.5))),
    )
    builder.camera(
        evis.EventCamera(
            name="eye",
            width=WIDTH,
            height=HEIGHT,
            pose=Placement(motion=ConstantVelocity(velocity=(1.0, -0.5, 0.3))),
        )
    )
    simulator = evis.Simulator(
        builder.build(),
        labels=["hdr", "depth", "flow", "instance"],
        label_rate_hz=20,
        rate_hz=20,
        samples=1,
        reference_luminance=0.5,
    )
    packet = simulator.step(150_001)
    labels = packet.labels
    seconds = labels["depth"].t_us / 1e6
    return {
        "depth": np.stack(labels["depth"].images),
        "instance": np.stack(labels["instance"].images),
        "flow": np.stack(labels["flow_backward"].images),
        "valid": np.stack(labels["flow_backward_valid"].images),
        "hdr": np.stack(labels["hdr"].images),
        "t_us": labels["depth"].t_us,
        "intrinsics": simulator.cameras[0].matrix,
        "camera": np.stack([moved(t, velocity=(1.0, -0.5, 0.3)) for t in seconds]),
        "box": np.stack([moved(t, (-0.8, 0, -3), turn=np.radians(90.0)) for t in seconds]),
        "ball": np.stack([moved(t, (0.8, 0, -2.5), (0.0, 1.5, 0.5)) for t in seconds]),
        "poses": packet.views[0].poses,
    }


def facing(position: tuple[float, float, float]) -> Placement:
    return Placement(position=position, rotation_degrees=(90.0, 0.0, 0.0))


def moved(
    t: float,
    position: tuple[float, float, float] = (0, 0, 0),
    velocity: tuple[float, float, float] = (0, 0, 0),
    turn: float = 0.0,
) -> npt.NDArray[np.float64]:
    """World-from-body at `t` seconds of what flies straight, or turns about its own Y."""
    pose = np.eye(4)
    c, s = np.cos(turn * t), np.sin(turn * t)
    pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    pose[:3, 3] = np.add(position, np.multiply(velocity, t))
    return pose


def error_px(posed: dict[str, Any], **changed: Any) -> float:
    """The largest distance from our own flow labels, where these are known, in the picture of 50 ms."""
    given = {
        "camera": posed["camera"][1],
        "camera_before": posed["camera"][0],
        "instances": posed["instance"][1].astype(np.int32),
        "bodies": {7: (posed["box"][1], posed["box"][0]), 9: (posed["ball"][1], posed["ball"][0])},
    } | changed
    made = motion_from_poses(posed["depth"][1], posed["intrinsics"], **given)
    known = posed["valid"][1] != 0
    assert np.isfinite(made[known]).all()
    return float(np.linalg.norm(made - posed["flow"][1], axis=-1)[known].max())


def test_motion_from_poses_equals_the_labels(posed: dict[str, Any]) -> None:
    assert np.allclose(posed["poses"].matrix[1], posed["camera"][1], atol=1e-6), "the poses are the scene's"
    assert all((posed["instance"][1] == body).sum() > 30 for body in (1, 7, 9))
    assert np.linalg.norm(posed["flow"][1], axis=-1).max() > 2
    assert error_px(posed) < 0.01
    # Canaries: the camera at rest, bodies at rest, now and before exchanged, axes of another convention.
    assert error_px(posed, camera_before=posed["camera"][1]) > 0.5
    assert error_px(posed, bodies={7: (posed["box"][1], posed["box"][0])}) > 0.5
    assert error_px(posed, bodies={}) > 0.5
    assert error_px(posed, camera=posed["camera"][0], camera_before=posed["camera"][1]) > 0.5
    assert error_px(posed, axes="ros") > 0.5


def test_other_axes_and_quaternions_say_the_same(posed: dict[str, Any]) -> None:
    # The same camera, described in ROS' axes and in those of Isaac's world convention, on a known rotation.
    ros = np.diag([1.0, -1.0, -1.0, 1.0])
    world = np.array([[0.0, -1, 0, 0], [0, 0, 1, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
    for axes, turn in (("ros", ros), ("world", world)):
        now, before = (posed["camera"][k] @ turn for k in (1, 0))
        assert error_px(posed, camera=now, camera_before=before, axes=axes) < 0.01
    # Without a rotation, a quaternion is 0, 0, 0, 1; the box's turns about Y.
    cameras = [[*posed["camera"][k][:3, 3], 0, 0, 0, 1] for k in (1, 0)]
    angles = [np.radians(90.0) * posed["t_us"][k] / 2e6 for k in (1, 0)]
    box = [[-0.8, 0, -3, 0, np.sin(angle), 0, np.cos(angle)] for angle in angles]
    bodies = {7: (box[0], box[1]), 9: (posed["ball"][1], posed["ball"][0])}
    assert error_px(posed, camera=cameras[0], camera_before=cameras[1], bodies=bodies) < 0.01
    swapped = [[*pose[:3], pose[6], *pose[3:6]] for pose in box]  # w first
    assert error_px(posed, bodies={**bodies, 7: tuple(swapped)}) > 0.5, "canary"


def test_the_sky_turns_and_does_not_shift() -> None:
    depth = np.full((HEIGHT, WIDTH), np.inf, np.float32)
    intrinsics = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
    moved_only = motion_from_poses(depth, intrinsics, [5, 1, 2, 0, 0, 0, 1], [0, 0, 0, 0, 0, 0, 1])
    assert np.abs(moved_only).max() < 1e-4
    angle = 0.02  # turned left, about Y: pictures move right, they were further left
    turned = [0, 0, 0, 0, np.sin(angle / 2), 0, np.cos(angle / 2)]
    made = motion_from_poses(depth, intrinsics, turned, [0, 0, 0, 0, 0, 0, 1])
    assert made[24, 32, 0] == pytest.approx(-60 * np.tan(angle), abs=0.05)
    depth[:2] = [[np.nan], [0.0]]
    assert np.isnan(motion_from_poses(depth, intrinsics, turned, turned)[:2]).all()


def test_motion_step_by_step_feeds_the_pipeline(posed: dict[str, Any]) -> None:
    maker = MotionFromPoses(2, posed["intrinsics"])
    own, labelled = pipeline(2, check_motion=False), pipeline(2, check_motion=False)
    fired = 0
    for k, t_us in enumerate(posed["t_us"]):
        depth = np.stack([posed["depth"][k]] * 2)[..., None]
        outputs = {"rgb_radiance": np.stack([posed["hdr"][k]] * 2), "depth": depth}
        camera, ids = posed["camera"][k][None].repeat(2, 0), posed["instance"][k].astype(np.int32)
        motion = maker(
            depth, camera, instances=np.stack([ids] * 2), bodies={7: posed["box"][k], 9: posed["ball"][k]}
        )
        assert np.isnan(motion).all() == (k == 0)
        made = own.push(outputs, int(t_us), motion_vectors=motion, hold=maker.held)
        flow = np.stack([posed["flow"][k]] * 2)
        wanted = labelled.push({**outputs, "motion_vectors": flow}, int(t_us))
        # Rounding moves a time by a microsecond, and a pixel between surfaces to the other one.
        assert abs(len(made[0]) - len(wanted[0])) <= 0.01 * len(wanted[0])
        fired += len(made[0])
    assert fired > 500


@pytest.mark.filterwarnings("ignore:0 % of the picture is linked")
def test_an_environment_of_bad_poses_is_held_until_its_reset(posed: dict[str, Any]) -> None:
    maker, own = MotionFromPoses(2, posed["intrinsics"]), pipeline(2, check_motion=False)

    def step(k: int, second: Any) -> list[evis.EventArray]:
        depth = np.stack([posed["depth"][k % 3]] * 2)
        camera = np.stack([posed["camera"][k % 3], second])
        motion = maker(depth, camera)
        light = np.stack([posed["hdr"][k % 3]] * 2)
        return own.push(
            {"rgb_radiance": light, "depth": depth}, 8000 * k, motion_vectors=motion, hold=maker.held
        )

    step(0, posed["camera"][0])
    assert all(map(len, step(1, posed["camera"][1])))
    stretched = 2 * posed["camera"][2]
    for bad in (stretched, np.full((4, 4), np.nan)):
        events = step(2, bad) if bad is stretched else step(3, bad)
        assert maker.held == (1,)
        assert len(events[0]) > 0
        assert len(events[1]) == 0
    assert len(step(4, posed["camera"][1])[1]) == 0, "it is held until it is reset"
    for each in (maker, own):
        each.reset([1])
    assert maker.held == ()
    assert len(step(5, posed["camera"][2])[1]) == 0
    assert all(map(len, step(6, posed["camera"][0])))


def test_poses_that_do_not_fit_are_named(posed: dict[str, Any]) -> None:
    depth, intrinsics, eye = posed["depth"][1], posed["intrinsics"], posed["camera"][1]
    for change, said in [
        ({"camera": 2 * eye}, "camera of environment 0 is not rigid"),
        ({"camera": [0, 0, 0, 0, 0, 0, 0]}, "camera of environment 0 is not rigid"),
        ({"camera": eye[:3]}, r"camera has shape \(3, 4\)"),
        ({"intrinsics": intrinsics[:2]}, r"intrinsics has shape \(2, 3\)"),
        ({"intrinsics": 0 * intrinsics}, "fx and fy above 0"),
        ({"depth": depth[0]}, "depth is float32 of shape"),
        ({"axes": "blender"}, "axes is 'blender'"),
        ({"camera": "x"}, "camera is 'x'; it must be an array"),
        ({"camera": [[1], [1, 2]]}, "camera is"),
        ({"bodies": {"box": (eye, eye)}}, "an id of bodies is 'box'"),
        ({"bodies": {7: (eye, eye)}}, "instances"),
        ({"bodies": {7: eye}, "instances": posed["instance"][1]}, r"bodies\[7\]"),
        ({"bodies": {7: (eye, eye)}, "instances": posed["hdr"][1]}, "not the colours"),
    ]:
        given = {"depth": depth, "intrinsics": intrinsics, "camera": eye, "camera_before": eye} | change
        with pytest.raises(evis.ConfigError, match=said):
            motion_from_poses(**given)
    maker = MotionFromPoses(2, intrinsics)
    for call, said in [
        (lambda: maker(depth[None], eye), "depth is of 1 environments; there are 2"),
        (lambda: maker.reset([2]), "numbers from 0 to 1"),
        (lambda: maker(depth[None].repeat(2, 0), eye, bodies={"box": eye}), "an id of bodies is 'box'"),
        (lambda: MotionFromPoses(0, intrinsics), "num_envs"),
    ]:
        with pytest.raises(evis.ConfigError, match=said):
            call()
