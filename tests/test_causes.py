"""Why events fired: by noise, by light, on frames, on scenes, in files; and when frames were exposed."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

import evis

SIZE = (64, 48)
NOISY = evis.Sensor(
    noise=evis.sensors.Noise(leak_hz=30.0, shot_hz=6.0, hot_share=0.01, hot_hz=40.0),
    refractory=evis.sensors.Refractory(period_us=100),
)


def count(causes: np.ndarray) -> dict[str, int]:
    return dict(zip(evis.packets.CAUSES, np.bincount(causes, minlength=4).tolist(), strict=True))


def test_still_light_fires_by_noise_alone_and_moving_light_without_noise_by_light_alone() -> None:
    still = np.full((SIZE[1], SIZE[0]), 0.3, np.float32)
    for law in ("ramp", "poisson"):
        noise = evis.sensors.Noise(leak_hz=8.0, leak_law=law, shot_hz=6.0, hot_share=0.01, hot_hz=40.0)
        emulator = evis.EventEmulator(*SIZE, evis.Sensor(noise=noise), labels=["cause"], seed=1)
        plain = evis.EventEmulator(*SIZE, evis.Sensor(noise=noise), seed=1)
        found = np.zeros(4, np.int64)
        for k in range(12):
            events = emulator.push(still, 50_000 * k)
            assert events == plain.push(still, 50_000 * k), "asking changes no event"
            assert plain.causes is None
            assert len(emulator.causes) == len(events)
            found += np.bincount(emulator.causes, minlength=4)
        assert found[0] == 0, found
        # 0.55 seconds of 3072 pixels.
        assert found[1] == pytest.approx(8 * 0.55 * 3072, rel=0.15)
        assert found[2] == pytest.approx(6 * 0.55 * 3072, rel=0.4)
        assert 0.4 * 40 * 0.55 * 31 < found[3] < 2 * 40 * 0.55 * 31
    quiet = evis.EventEmulator(*SIZE, labels=["cause"])
    total = 0
    for k in range(5):
        x = np.arange(SIZE[0], dtype=np.float32) * np.ones((SIZE[1], 1), np.float32)
        events = quiet.push((0.5 + 0.4 * np.sin((x - 2 * k) / 3)).astype(np.float32), 1000 * k)
        assert set(quiet.causes.tolist()) <= {0}
        total += len(events)
    assert total > 1000


def test_readout_and_batches_keep_causes_with_their_events() -> None:
    sensor = evis.Sensor(noise=NOISY.noise, readout=evis.sensors.Readout(latency_us=50.0, jitter_us=200.0))
    emulator = evis.EventEmulator(*SIZE, sensor, batch=2, labels=["cause"], seed=3)
    light = np.full((2, SIZE[1], SIZE[0]), 0.3, np.float32)
    for k in range(6):
        lists = emulator.push(light * np.float32(1 + 0.3 * (k == 4)), 20_000 * k)
        causes = emulator.causes
        assert [len(events) for events in lists] == [len(own) for own in causes]
        signal = causes[0] == 0
        # Light rises in the fourth interval only; by jitter some of it comes out in the fifth.
        assert signal.any() == (k == 4) or k == 5
        if k == 4:
            assert lists[0].p[signal].min() == 1
            assert signal.sum() > 0.9 * 3072


def test_scenes_files_and_emulators_agree(tmp_path: Path) -> None:
    scene = evis.Scene.builtin("spinner")
    simulator = evis.Simulator(
        scene, sensor=NOISY, size=SIZE, labels=["cause", "depth"], rate_hz=500, samples=1, seed=2
    )
    assert set(simulator.labels) == {"cause", "depth"}
    path = tmp_path / "events.h5"
    with evis.Writer(path, simulator) as writer:
        packets = []
        for packet in simulator.stream(duration=0.06, packet_us=20_000):
            writer.write(packet)
            packets.append(packet)
            assert packet.causes is not None
            assert len(packet.causes) == len(packet.events)
            assert set(packet.labels) == {"depth"}
    causes = np.concatenate([packet.causes for packet in packets])
    by_name = count(causes)
    assert min(by_name.values()) > 5, by_name
    recording = evis.load(path)
    np.testing.assert_array_equal(recording.view.causes, causes)
    assert set(recording.labels) == {"depth"}
    assert "cause" in recording.labels_present
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file["events/cause"], causes)
    evis.save(tmp_path / "copy.h5", recording)
    np.testing.assert_array_equal(evis.load(tmp_path / "copy.h5").view.causes, causes)
    # Asking changes no event, and without asking there is no answer.
    plain = evis.Simulator(scene, sensor=NOISY, size=SIZE, rate_hz=500, samples=1, seed=2).step(60_000)
    np.testing.assert_array_equal(plain.events, np.concatenate([packet.events for packet in packets]))
    assert plain.causes is None
    # An ideal sensor fires by light alone.
    ideal = evis.Simulator(scene, size=SIZE, labels=["cause"], rate_hz=500, samples=1).step(20_000)
    assert len(ideal.causes) == len(ideal.events) > 0
    assert not ideal.causes.any()


def test_frames_say_when_their_exposure_began_and_ended(tmp_path: Path) -> None:
    simulator = evis.Simulator(
        evis.Scene.builtin("spinner"), size=(32, 24), samples=1, frame_rate_hz=50, exposure_us=6000
    )
    path = tmp_path / "frames.h5"
    with evis.Writer(path, simulator) as writer:
        for packet in simulator.stream(duration=0.05):
            writer.write(packet)
            frames = packet.labels["frame"]
            np.testing.assert_array_equal(frames.end_us - frames.start_us, 6000)
            np.testing.assert_array_equal(frames.start_us + frames.end_us, 2 * frames.t_us)
    held = evis.load(path).labels["frame"]
    assert len(held) >= 2
    start_us, end_us = held.exposure_us(1)
    assert end_us - start_us == 6000
    with h5py.File(path) as file:
        labels = file[file["evis/cameras"].asstr()[0]]["labels"]
        np.testing.assert_array_equal(labels["frame_t_end_us"][:] - labels["frame_t_other_us"][:], 6000)
        assert labels["frame_t_end_us"][1] == end_us


@pytest.mark.parametrize("labels", [["depth"], "cause", ["cause", "hdr"]])
def test_an_emulator_has_no_other_labels(labels: object) -> None:
    with pytest.raises(evis.ConfigError, match="label"):
        evis.EventEmulator(4, 3, labels=labels)  # type: ignore[call-overload]
