"""The engine through Python: streams, steps, determinism, threads."""

from __future__ import annotations

import sys
import threading
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import tomllib
from test_gil import interrupted

import evis
from evis._progress import TimeLeft

SMALL: dict[str, Any] = {"size": (64, 48), "rate_hz": 500.0, "samples": 1}


def streamed(
    scene: evis.Scene, *, duration: float = 0.06, packet_us: int = 10_000, **settings: Any
) -> list[evis.Packet]:
    sim = evis.Simulator(scene, **{**SMALL, **settings})
    with sim.stream(duration=duration, packet_us=packet_us) as stream:
        return list(stream)


def columns(packets: list[evis.Packet]) -> list[npt.NDArray[Any]]:
    """Everything that must not depend on the packet length."""
    views = [packet.view for packet in packets]
    events = np.concatenate([view.events for view in views])
    found = [events[name] for name in ("t", "x", "y", "p")]
    for kind in views[0].labels:
        found.append(np.concatenate([view.labels[kind].t_us for view in views]))
        found.append(np.concatenate([view.labels[kind].data for view in views]))
    found.append(np.concatenate([view.poses.matrix for view in views]))
    return found


def same(one: list[npt.NDArray[Any]], other: list[npt.NDArray[Any]]) -> bool:
    return len(one) == len(other) and all(
        a.shape == b.shape and a.tobytes() == b.tobytes() for a, b in zip(one, other, strict=True)
    )


def test_packets_tile_time(spinner: evis.Scene):
    packets = streamed(spinner, duration=0.025)
    assert [(packet.start_us, packet.end_us) for packet in packets] == [
        (0, 10_000),
        (10_000, 20_000),
        (20_000, 25_000),
    ]
    for packet in packets:
        assert ((packet.t >= packet.start_us) & (packet.t < packet.end_us)).all()
    assert sum(len(packet.events) for packet in packets) > 0
    assert sum(packet.report.events for packet in packets) == sum(len(packet.events) for packet in packets)
    assert all(packet.report.dropped == 0 for packet in packets)


def test_events_are_the_engines_own_memory(spinner: evis.Scene):
    packet = max(streamed(spinner), key=lambda packet: packet.report.events)
    events = packet.events.to_numpy()
    assert packet.events.dtype == events.dtype == evis.EventCD
    assert not events.flags.owndata
    assert events.base is not None
    assert np.shares_memory(packet.t, packet.events)
    assert np.shares_memory(np.from_dlpack(packet.x), packet.events)
    order = np.lexsort((packet.x, packet.y, packet.t))
    assert (order == np.arange(len(order))).all()
    assert packet.x.max() < 64
    assert packet.y.max() < 48
    assert set(np.unique(packet.p)) <= {0, 1}


def test_bytes_do_not_depend_on_the_packet_length(spinner: evis.Scene):
    labels = ("depth", "flow", "instance")
    whole = columns(streamed(spinner, packet_us=60_000, labels=labels))
    assert len(whole[0]) > 0
    for packet_us in (7_001, 10_000):
        assert same(columns(streamed(spinner, packet_us=packet_us, labels=labels)), whole)
    other = columns(streamed(spinner, labels=labels, start=0.01))
    assert not same(other, whole), "canary: another stream has other bytes"


def test_steps_give_the_stream(spinner: evis.Scene):
    sim = evis.Simulator(spinner, **SMALL)
    stepped = [sim.step(until_us) for until_us in (5_000, 30_000, 60_000)]
    assert sim.now_us == 60_000
    assert [packet.start_us for packet in stepped] == [0, 5_000, 30_000]
    assert same(columns(stepped), columns(streamed(spinner)))
    with pytest.raises(evis.ConfigError):
        sim.step(60_000)


def test_labels_have_shapes_and_times(spinner: evis.Scene):
    packets = streamed(spinner, labels=("depth", "flow", "normal", "hdr", "semantic"), label_rate_hz=100.0)
    labels = packets[0].labels
    flows = ["flow_forward", "flow_forward_valid", "flow_backward", "flow_backward_valid"]
    assert list(labels) == ["depth", *flows, "semantic", "normal", "hdr"]
    assert labels["depth"].data.shape == (1, 48, 64)
    assert labels["depth"].data.dtype == np.float32
    assert labels["flow_forward"].images[0].shape == (48, 64, 2)
    assert labels["flow_forward_valid"].images[0].dtype == np.uint8
    assert labels["normal"].images[0].shape == (48, 64, 3)
    assert labels["semantic"].images[0].dtype == np.uint32
    times = np.concatenate([packet.labels["depth"].t_us for packet in packets])
    assert times.tolist() == list(range(0, 60_000, 10_000))
    assert np.concatenate([packet.poses.t_us for packet in packets]).tolist() == times.tolist()
    assert np.allclose(np.linalg.norm(packets[0].poses.rotation, axis=1), 1.0)


def test_cameras_can_be_added(spinner: evis.Scene):
    left = evis.EventCamera(
        name="extra left", width=48, height=32, pose=evis.motion.Placement(position=(-0.05, 0.0, 3.0))
    )
    right = evis.EventCamera(
        name="extra right",
        width=32,
        height=32,
        pose=evis.motion.Placement(position=(0.05, 0.0, 3.0)),
        fov_y_degrees=40.0,
    )
    sim = evis.Simulator(spinner, cameras=[left, right], rate_hz=500.0, samples=1)
    assert [(camera.name, camera.width, camera.height) for camera in sim.cameras] == [
        ("extra left", 48, 32),
        ("extra right", 32, 32),
    ]
    packet = sim.step(20_000)
    assert packet["extra left"].poses.position[0].tolist() == [-0.05, 0.0, 3.0]
    assert list(packet.events) == ["extra left", "extra right"]
    assert "extra left" not in spinner.cameras, "the scene that was given stays as it was"


def test_a_stream_has_the_engine_while_it_runs(spinner: evis.Scene):
    sim = evis.Simulator(spinner, **SMALL)
    with sim.stream(duration=10.0) as stream:
        next(stream)
        for use in (lambda: sim.step(10_000), lambda: sim.stream(duration=1.0), sim.reset):
            with pytest.raises(evis.EvisError, match="close the stream"):
                use()
        assert "at 10000 us of 0 to 10000000 us" in repr(stream)
    assert list(stream) == [], "a closed stream has ended"
    assert "Stream(ended" in repr(stream)


def test_a_simulator_streams_again_from_its_start(spinner: evis.Scene):
    sim = evis.Simulator(spinner, labels=["depth"], **SMALL)
    first = list(sim.stream(duration=0.03))
    assert sim.now_us == 0
    again = list(sim.stream(duration=0.03))
    assert same(columns(again), columns(first))
    # After one that was closed early, rendered ahead as it was, and one that nobody holds any more.
    with sim.stream(duration=10.0) as stream:
        next(stream)
    assert sim.step(10_000).events == first[0].events
    assert sim.now_us == 10_000
    next(sim.stream(duration=10.0))
    rest = list(sim.stream(duration=0.03))
    assert same(columns(rest), columns(first))
    # A stream goes on where steps have come.
    stepped = evis.Simulator(spinner, labels=["depth"], **SMALL)
    stepped.step(10_000)
    late = list(stepped.stream(duration=0.02))
    assert [packet.start_us for packet in late] == [10_000, 20_000]
    assert same(columns(late), columns(first[1:]))
    assert not same(columns(late), columns(first[:2])), "canary"


def test_python_runs_while_a_step_renders(spinner: evis.Scene):
    sim = evis.Simulator(spinner, size=(320, 240), samples=4)
    progress = 0
    stop = threading.Event()

    def count() -> None:
        nonlocal progress
        while not stop.is_set():
            progress += 1
            time.sleep(0.0005)

    thread = threading.Thread(target=count)
    thread.start()
    before = progress
    sim.step(50_000)
    during = progress - before
    stop.set()
    thread.join()
    assert during > 3


def test_the_stream_renders_ahead(spinner: evis.Scene):
    sim = evis.Simulator(spinner, **SMALL)
    with sim.stream(duration=1.0) as stream:
        next(stream)
        time.sleep(0.5)
        began = time.perf_counter()
        next(stream)
        waited_s = time.perf_counter() - began
    # No measure of speed: a packet that was rendered meanwhile needs only to be handed over.
    assert waited_s < 0.25


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"rate_hz": 0.0}, "rate_hz is 0"),
        ({"samples": 0}, "samples is 0"),
        ({"samples": -1}, "samples is -1"),
        ({"size": (0, 48)}, "width is 0"),
        ({"start": -1.0}, "start is -1"),
        ({"start": float("nan")}, "start is nan"),
        ({"seed": -1}, "seed is -1"),
        ({"label_rate_hz": 0.0}, "label_rate_hz is 0"),
        ({"labels": ["colour"]}, "'depth' or"),
        ({"labels": "depth"}, "sequences"),
        ({"antialias": "none"}, "'samples' or 'edges'"),
        ({"compute": "tpu"}, "'cpu' or 'gpu'"),
        ({"compute": "gpu", "method": "native"}, "compute is gpu"),
        ({"sensor": evis.Sensor(threshold_on=0.0)}, "threshold_on is 0"),
        ({"sensor": evis.Sensor(trigger="edge")}, "'crossing' or 'latch'"),  # type: ignore[arg-type]
        ({"reference_luminance": 0.0}, "reference_luminance is 0"),
        ({"cameras": []}, "cameras is empty"),
    ],
)
def test_unusable_settings_are_named(settings: dict[str, Any], message: str):
    # No device needed: settings are checked before one is looked for.
    scene = evis.Scene.builtin("spinner")
    with pytest.raises(evis.ConfigError, match=message):
        evis.Simulator(scene, **settings)


def test_unknown_cameras_and_devices_are_refused(spinner: evis.Scene):
    with pytest.raises(evis.ConfigError, match="no camera named 'top'; there is"):
        evis.Simulator(spinner, cameras=["top"])
    with pytest.raises(evis.DeviceError):
        evis.Simulator(spinner, device="no such device")


def test_unusable_stream_lengths_are_refused(spinner: evis.Scene):
    sim = evis.Simulator(spinner, **SMALL)
    for settings in ({"duration": 0.0}, {"duration": -1.0}, {"duration": 1.0, "packet_us": 0}):
        with pytest.raises(evis.ConfigError):
            sim.stream(**settings)
    with sim.stream(duration=0.01) as stream:
        assert len(list(stream)) == 1, "a refused stream leaves the engine where it was"


def test_impossible_times_are_named_in_the_unit_that_was_given(spinner: evis.Scene):
    sim: Any = evis.Simulator(spinner, **SMALL)
    for make, said in [
        (lambda: sim.stream(duration=-1), "duration is -1; it must be above 0 seconds"),
        (lambda: sim.stream(duration="x"), "duration is 'x'; it must be a number of seconds"),
        (lambda: sim.stream(duration=1, packet_us=1.5), "packet_us is 1.5; it must be a whole number"),
        (lambda: sim.step(1.5), "until_us is 1.5; it must be a whole number of microseconds"),
        (lambda: sim.step(2**70), r"until_us is 1180591620717411303424; .*2\*\*62 - 1"),
        (lambda: sim.step(9 * 10**15), "until_us is 9000000000000000; it must be at most 4503599627370496"),
    ]:
        with pytest.raises(evis.ConfigError, match=said):
            make()
    assert sim.now_us == 0


def test_unknown_scenes_are_refused():
    with pytest.raises(evis.ConfigError, match="warehouse"):
        evis.Scene.builtin("barehouse")
    with pytest.raises(evis.ConfigError, match=r"\.toml, \.gltf or \.glb"):
        evis.Scene.load("scene.obj")
    assert {"warehouse", "spinner", "street", "desk"} <= set(evis.scenes())


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
def test_ctrl_c_stops_a_stream_and_keeps_its_file(device: evis.Device, tmp_path: Path):
    path = tmp_path / "out.h5"
    script = f"""
        import time
        import evis

        sim = evis.Simulator(evis.Scene.builtin("spinner"), size=(64, 48), samples=1)
        try:
            with sim.stream(duration=100_000.0) as stream, evis.Writer({str(path)!r}, sim) as writer:
                for number, packet in enumerate(stream):
                    writer.write(packet)
                    if number == 3:
                        print("ready", flush=True)
        except KeyboardInterrupt:
            print("stopped", flush=True)
    """
    began = time.perf_counter()
    assert "stopped" in interrupted(script)
    assert time.perf_counter() - began < 30.0
    recording = evis.load(path)
    assert not recording.complete
    assert len(recording.events) > 0
    assert recording.poses.t_us[-1] >= 20_000


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
def test_ctrl_c_ends_a_long_step_and_loses_nothing(device: evis.Device):
    script = """
        import time
        import evis

        def simulator():
            return evis.Simulator(evis.Scene.builtin("spinner"), size=(64, 48), rate_hz=500.0, samples=1)

        sim = simulator()
        sim.step(10_000)
        print("ready", flush=True)
        began = time.perf_counter()
        try:
            sim.step(1_000_000_000)
        except KeyboardInterrupt:
            print("stopped after", time.perf_counter() - began, flush=True)
        assert sim.now_us == 10_000, sim.now_us
        other = simulator()
        other.step(10_000)
        assert sim.step(50_000).events.tobytes() == other.step(50_000).events.tobytes()
        print("the same", flush=True)
    """
    text = interrupted(script)
    assert "stopped after" in text, text
    assert "the same" in text, text


def test_reports_say_what_a_device_has_evaluated_and_what_rested(device: evis.Device):
    scene = evis.Scene.builtin("desk")
    reports = []
    for compute in ("cpu", "gpu"):
        sim = evis.Simulator(scene, size=(48, 36), method="decoupled", compute=compute)
        reports.append([sim.step(until_us).report for until_us in (50_000, 100_000, 150_000)])
    own, other = reports
    for report in own:
        assert report.drawn_pixels > 0
        assert (report.on_device, report.refollowed) == (0, 0)
    for report in other:
        assert 0 < report.on_device < report.drawn_pixels
        assert report.refollowed > 0, "so small a picture has pixels that see many facets"
    # The camera stands: of most of the desk nothing changes, whatever follows its pixels.
    assert [report.resting for report in own] == [report.resting for report in other]
    assert sum(report.resting for report in own) > 48 * 36


def test_a_preset_and_its_settings_by_hand_or_by_file_fire_the_same(device: evis.Device, tmp_path: Path):
    scene = evis.Scene.builtin("spinner")
    standard = evis.Simulator(scene, size=(48, 36))
    method = "decoupled" if device.kind == "cpu" else "native"
    assert (standard.method, standard.quality, standard.notes) == (method, "standard", ())
    usual = standard.step(40_000)
    assert usual.report.drawn_pixels > 0
    assert usual.report.rendered_tiles == 0
    assert len(usual.view.events) > 50
    held = tomllib.loads(standard.config_toml)["run"]
    assert held["quality"] == "standard"
    if method == "decoupled":
        by_hand = evis.Simulator(scene, size=(48, 36), method=method, adaptive_px=held["adaptive_px"])
        assert by_hand.quality is None
        assert np.array_equal(by_hand.step(40_000).view.events, usual.view.events)
        settings = tmp_path / "decoupled.toml"
        settings.write_text(standard.config_toml)
        again = evis.Simulator(scene, settings=settings)
        assert np.array_equal(again.step(40_000).view.events, usual.view.events)
        with pytest.raises(evis.ConfigError, match=r"samples is '?36.*decoupled"):
            evis.Simulator(scene, settings=settings, samples=36)
    draft = evis.Simulator(scene, size=(48, 36), quality="draft")
    packet = draft.step(40_000)
    high = evis.Simulator(scene, size=(48, 36), quality="high").step(40_000)
    assert not np.array_equal(packet.view.events, high.view.events), "canary"
    held = tomllib.loads(draft.config_toml)["run"]
    names = ["method", "adaptive_px"]
    if held["method"] == "native":
        names += ["rate_hz", "antialias", "samples", "texture_taps"]
    by_hand = evis.Simulator(scene, size=(48, 36), **{name: held[name] for name in names})
    assert (by_hand.method, by_hand.quality) == (held["method"], None)
    assert np.array_equal(by_hand.step(40_000).view.events, packet.view.events)
    # What a recording stores runs again; arguments stand over it.
    settings = tmp_path / "settings.toml"
    settings.write_text(draft.config_toml)
    again = evis.Simulator(scene, settings=settings)
    assert again.config_toml == draft.config_toml
    assert np.array_equal(again.step(40_000).view.events, packet.view.events)
    other = evis.Simulator(scene, settings=settings, adaptive_px=0.7, seed=3)
    assert (tomllib.loads(other.config_toml)["run"]["adaptive_px"], other.seed) == (0.7, 3)


def test_sampling_that_contradicts_itself_is_refused(device: evis.Device, tmp_path: Path):
    scene = evis.Scene.builtin("spinner")
    with pytest.raises(evis.ConfigError, match=r"quality.*high.*splat"):
        evis.Simulator(scene, quality="high", method="splat")
    with pytest.raises(evis.ConfigError, match=r"quality.*'fine'.*draft"):
        evis.Simulator(scene, quality="fine")  # type: ignore[arg-type]
    with pytest.raises(evis.ConfigError, match=r"adaptive_px.*above 0"):
        evis.Simulator(scene, adaptive_px=-1.0)
    with pytest.raises(evis.ConfigError, match=r"rate.*500.*splat"):
        evis.Simulator(scene, method="splat", rate_hz=500)
    settings = tmp_path / "settings.toml"
    settings.write_text("nonsense")
    with pytest.raises(evis.ConfigError, match=r"settings.toml.*evis tune"):
        evis.Simulator(scene, settings=settings)
    settings.write_text('evis = "7.0.0"\n[run]\n')
    with pytest.raises(evis.ConfigError, match=r"settings.toml.*7\.0\.0"):
        evis.Simulator(scene, settings=settings)
    with pytest.raises(FileNotFoundError, match="gone"):
        evis.Simulator(scene, settings=tmp_path / "gone.toml")


def test_clipped_light_is_counted_and_warned_of_once(device: evis.Device):
    scene = evis.Scene.builtin("spinner")

    def simulator(reference_luminance: float) -> evis.Simulator:
        settings: Any = {"method": "evis-paper", "reference_luminance": reference_luminance}
        return evis.Simulator(scene, size=(48, 36), **settings)

    bright = simulator(1e-6)
    with pytest.warns(UserWarning, match=r"camera 'camera' of environment 0, from 0 us on"):
        first = bright.step(20_000)
    assert first.report.clipped > 0
    assert [text for text in first.report.clipped_light if "65536 Y_ref" in text]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert bright.step(40_000).report.clipped > 0
        with bright.stream(duration=0.01) as stream:
            list(stream)
        quiet = simulator(0.1).step(20_000)
    assert (quiet.report.clipped, quiet.report.clipped_light) == (0, [])


def test_a_method_samples_instants_from_keyframes(device: evis.Device):
    scene = evis.Scene.builtin("spinner")

    def run(**settings: Any) -> tuple[evis.Simulator, evis.Packet]:
        sim = evis.Simulator(scene, size=(48, 36), **settings)
        return sim, sim.step(50_000)

    _, native = run(method="native")
    assert (native.report.keyframes, native.report.unknown) == (0, 0)
    sim, splat = run(method=evis.Warp(keyframe_hz=50, steps=4))
    assert (sim.method, splat.report.keyframes) == ("splat", 4)
    assert "splat" in sim.config_toml
    assert 0 < len(splat.view.events) < 2 * len(native.view.events)
    sim, paper = run(method="evis-paper")
    assert (sim.method, sim.sensor.trigger, sim.sensor.log_eps) == ("evis-paper", "latch", 1e-5)
    own, same = run(method=evis.Warp.evis_paper(), sensor=sim.sensor)
    assert own.method == "evis-paper"
    assert np.array_equal(paper.view.events, same.view.events)
    for wrong, name in [
        ({"method": "warp"}, "method"),
        ({"method": "splat", "rate_hz": 500.0}, "rate_hz"),
        ({"method": evis.Warp(steps=0)}, "steps"),
        ({"method": evis.Warp(keyframe_hz=float("inf"))}, "keyframe_hz is inf"),
    ]:
        with pytest.raises(evis.ConfigError, match=name):
            evis.Simulator(scene, size=(48, 36), **wrong)


@pytest.mark.parametrize("name", ["v2e", "gen4-like"])
def test_every_stage_of_a_sensor_runs_on_scenes(spinner: evis.Scene, name: str):
    def run(packet_us: int = 10_000, **settings: Any) -> list[npt.NDArray[Any]]:
        return columns(streamed(spinner, packet_us=packet_us, **settings))

    seen = run(sensor=name, seed=3)
    assert len(seen[0]) > 200
    # The same from a preset's values, in packets of another length.
    assert same(seen, run(7_777, sensor=evis.Sensor.preset(name), seed=3))
    assert not same(seen, run(sensor=name, seed=4)), "canary: another seed, other noise"
    assert not same(seen, run(sensor="ideal", seed=3)), "canary: another sensor"
    simulator = evis.Simulator(spinner, **SMALL, sensor=name)
    assert simulator.sensor == evis.Sensor.preset(name)
    assert "refractory" in simulator.config_toml


def test_cameras_have_sensors_of_their_own(tmp_path: Path):
    names = ("plain", "noisy", "walk")
    cameras = [
        evis.EventCamera(name=name, width=64, height=48, pose=evis.motion.Placement(position=(0, 0.3, 3)))
        for name in names
    ]
    noisy = evis.Sensor(threshold_off=0.25, noise=evis.sensors.Noise(shot_hz=20.0))
    sensors: dict[str, evis.Sensor | str] = {"noisy": noisy, "walk": "davis346"}
    settings: dict[str, Any] = {"rate_hz": 500.0, "samples": 1, "reference_luminance": 1.0, "seed": 2}
    scene = evis.Scene.builtin("spinner").with_cameras(cameras)

    def run(which: tuple[str, ...], **more: Any) -> tuple[evis.Simulator, dict[str, npt.NDArray[Any]]]:
        sim = evis.Simulator(scene, cameras=which, **{"sensor": sensors, **settings, **more})
        return sim, {view.camera.name: view.events for view in sim.step(60_000).views}

    for adaptive_px in (None, 0.4):
        sim, together = run(names, adaptive_px=adaptive_px)
        for name in names:
            _, alone = run((name,), adaptive_px=adaptive_px)
            assert len(alone[name]) > 100
            assert alone[name].tobytes() == together[name].tobytes(), name
        _, turned = run(names[::-1], adaptive_px=adaptive_px)
        assert all(turned[name].tobytes() == together[name].tobytes() for name in names)
        _, one = run(names, adaptive_px=adaptive_px, sensor="ideal")
        kept = [one[name].tobytes() == together[name].tobytes() for name in names]
        assert kept == [True, False, False], "canary: two of them have other sensors"

    davis = evis.Sensor.preset("davis346")
    assert sim.sensors == {"plain": evis.Sensor(), "noisy": noisy, "walk": davis}
    again, repeated = run(names, adaptive_px=0.4, sensor=sim.sensors)
    assert again.sensors == sim.sensors
    assert all(repeated[name].tobytes() == together[name].tobytes() for name in names)
    run_settings = tomllib.loads(sim.config_toml)["run"]
    assert set(run_settings["sensors"]) == {"noisy", "walk"}
    assert run_settings["sensors"]["noisy"]["noise"]["shot_hz"] == 20.0
    assert "diffusion" in run_settings["sensors"]["walk"]
    # A recording tells which thresholds each camera had.
    with evis.Simulator(scene, cameras=names, sensor=sensors, **settings).stream(duration=0.02) as stream:
        evis.save(tmp_path / "a.h5", stream)
    recording = evis.load(tmp_path / "a.h5")
    stored = [evis.Truth.load(tmp_path / "a.h5", camera=name).sensor for name in recording]
    assert [sensor.threshold_off for sensor in stored] == pytest.approx([0.2, 0.25, davis.threshold_off])


@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        ({"left": "ideal"}, "no camera named 'left'; there is"),
        ({"camera": "v2f"}, "camera 'camera': .*v2f"),
        ({"camera": evis.Sensor(threshold_off=0.0)}, "camera 'camera': threshold_off is 0"),
        ({"camera": None}, "'camera': None; it must map names of cameras"),
        ({0: "ideal"}, "0: 'ideal'; it must map names of cameras"),
    ],
)
def test_unusable_sensors_are_named_with_their_camera(sensor: Any, message: str):
    scene = evis.Scene.builtin("spinner")
    with pytest.raises(evis.ConfigError, match=message):
        evis.Simulator(scene, sensor=sensor, **SMALL)


def test_lost_events_are_counted(spinner: evis.Scene):
    sensor = evis.Sensor(
        threshold_on=0.05,
        threshold_off=0.05,
        refractory=evis.sensors.Refractory(period_us=5_000),
        readout=evis.sensors.Readout(rate_limit_hz=20_000.0),
    )
    reports = [packet.report for packet in streamed(spinner, sensor=sensor)]
    assert sum(report.suppressed for report in reports) > 100
    assert sum(report.dropped for report in reports) > 100


def test_frames_come_beside_events(spinner: evis.Scene):
    def frames(**settings: Any) -> list[evis.Packet]:
        return streamed(spinner, frame_rate_hz=100.0, exposure_us=4_000, **settings)

    packets = frames()
    labels = [packet.labels["frame"] for packet in packets]
    times = np.concatenate([each.t_us for each in labels])
    assert times.tolist() == [2_000, 12_000, 22_000, 32_000, 42_000, 52_000]
    starts = np.concatenate([each.t_other_us for each in labels])
    assert (times - starts == 2_000).all()
    image = labels[1].images[0]
    assert (image.shape, image.dtype) == ((48, 64), np.float32)
    assert (image > 0).all()
    assert not np.array_equal(image, labels[2].images[0])
    plain = np.concatenate([packet.events for packet in streamed(spinner)])
    assert np.array_equal(plain, np.concatenate([packet.events for packet in packets]))


def test_pixels_may_see_frames_of_light(spinner: evis.Scene):
    def events(packet: int, **exposure: Any) -> Any:
        sensor = evis.Sensor(exposure=evis.sensors.Exposure(**exposure))
        sim = evis.Simulator(spinner, **SMALL, sensor=sensor)
        return np.concatenate([sim.step(until).events for until in range(packet, 60_001, packet)])

    blurred = events(60_000, time_us=20_000)
    assert len(blurred) > 100
    assert np.array_equal(blurred, events(7_500, time_us=20_000))
    assert not np.array_equal(blurred, events(60_000))


def test_frames_survive_a_file(spinner: evis.Scene, tmp_path: Path):
    sim = evis.Simulator(spinner, **SMALL, frame_rate_hz=50.0)
    path = tmp_path / "frames.h5"
    evis.save(path, sim.stream(duration=0.05))
    recorded = evis.load(path).labels["frame"]
    assert recorded.t_us.tolist() == [5_000, 25_000, 45_000]
    assert [recorded.interval_us(k) for k in range(3)] == [(5_000, 0), (25_000, 20_000), (45_000, 40_000)]


@pytest.mark.parametrize("exposure_us", [0, 7, 20_002])
def test_impossible_exposures_are_named(spinner: evis.Scene, exposure_us: int):
    with pytest.raises(evis.ConfigError, match="exposure"):
        evis.Simulator(spinner, frame_rate_hz=50.0, exposure_us=exposure_us)


@pytest.mark.parametrize(
    ("rate_hz", "exposure_us"), [(50.0, 10_000), (100.0, 10_000), (500.0, 2_000), (300.0, 3_332), (3e5, 2)]
)
def test_exposures_fit_between_frames(spinner: evis.Scene, rate_hz: float, exposure_us: int):
    # As on the command line: 10 ms, or what fits, rounded down to even.
    sim = evis.Simulator(spinner, **SMALL, frame_rate_hz=rate_hz)
    assert tomllib.loads(sim.config_toml)["run"]["exposure_us"] == exposure_us


def test_labels_say_what_they_hold_in_a_line(spinner: evis.Scene):
    sim = evis.Simulator(spinner, **SMALL, frame_rate_hz=100.0)
    packet = sim.step(30_000)
    assert repr(packet.labels["frame"]) == "Labels('frame', 3 images, 64x48, t_us 5000 to 25000)"
    assert repr(evis.Simulator(spinner, **SMALL, labels=["depth"]).step(1).labels["depth"]).startswith(
        "Labels('depth', 1 images, 64x48, t_us 0 to 0"
    )


def test_progress_is_told_after_every_packet(spinner: evis.Scene, capsys: pytest.CaptureFixture[str]) -> None:
    seen: list[Any] = []
    sim = evis.Simulator(spinner, **SMALL)
    with sim.stream(duration=0.03, progress=seen.append) as stream:
        events = [packet.report.events for packet in stream]
    assert [told.t_us for told in seen] == [10_000, 20_000, 30_000]
    assert [told.events for told in seen] == np.cumsum(events).tolist()
    assert {(told.start_us, told.end_us) for told in seen} == {(0, 30_000)}
    assert all(told.left_s is None for told in seen if told.elapsed_s < 1)
    with evis.Simulator(spinner, **SMALL).stream(duration=0.02, progress=True) as stream:
        assert sum(packet.report.events for packet in stream) == sum(events[:2]), "a bar changes nothing"
    assert capsys.readouterr().err == "", "no terminal, and no ten seconds"


def test_the_time_left_never_rises() -> None:
    left = TimeLeft()
    assert left.after(0.5, 0.5) is None
    assert [left.after(*at) for at in ((2.0, 0.5), (10.0, 0.6), (10.0, 0.9))] == [
        2.0,
        2.0,
        pytest.approx(10 / 9),
    ]


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_more_simulators_take_no_more_address_space(device: evis.Device, spinner: evis.Scene) -> None:
    """The device and its instance are shared; what a simulator had goes with it."""

    def size() -> int:
        fields = Path("/proc/self/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in fields if line.startswith("VmSize")) * 1024

    def use(count: int) -> None:
        for method in ["native", "decoupled"] * (count // 2):
            evis.Simulator(spinner, size=(64, 48), device=device, method=method).step(4000)

    use(4)
    before = size()
    use(12)
    assert size() - before < 20 << 20
