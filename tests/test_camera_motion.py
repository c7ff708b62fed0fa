"""Cameras of scenes in which nothing moves, and still pictures as scenes."""

from __future__ import annotations

import struct
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest

import evis

STILL = """
textures = [{ name = "t", pattern = "bricks", size = 128 }]
materials = [{ name = "m", model = "unlit", texture = "t" }]
primitives = [{ name = "cube", shape = "box", size = [1, 0.8, 0.6], material = "m" }]
"""
CAMERA = 'cameras = [{ name = "own", position = [0, 0.4, 2.6], size = [64, 48] }]\n'


def events(simulator: evis.Simulator) -> list[tuple[int, int, int, int]]:
    """All events of a short stream."""
    with simulator.stream(duration=0.05) as stream:
        return [
            e
            for p in stream
            for e in zip(p.t.tolist(), p.x.tolist(), p.y.tolist(), p.p.tolist(), strict=True)
        ]


def png(pixels: np.ndarray) -> bytes:
    """A PNG file of uint8 (height, width, 3)."""
    height, width, _ = pixels.shape

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )


def make(scene: evis.Scene, **settings: object) -> evis.Simulator:
    """A simulator that costs little."""
    return evis.Simulator(scene, rate_hz=200.0, samples=1, size=(64, 48), **settings)  # type: ignore[arg-type]


def test_a_model_without_camera_and_motion_orbits_and_warns(device: evis.Device) -> None:
    scene = evis.Scene.from_toml(STILL)
    assert scene.camera_motion is None
    with pytest.warns(UserWarning, match="orbits the model at about 100 px/s"):
        simulator = make(scene)
    assert len(events(simulator)) > 50
    assert simulator.scene.camera_motion is not None
    assert "degrees per second" in simulator.scene.camera_motion
    assert "[camera_motion]" in simulator.config_toml
    assert 'motion = "orbit"' in simulator.config_toml
    # What was chosen once is not said twice, and is the same.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = make(simulator.scene)
        asked = make(scene, camera_motion="orbit", camera_speed=100.0)
    assert events(again) == events(asked)


def test_a_scene_with_its_own_camera_rests_unless_asked(device: evis.Device) -> None:
    scene = evis.Scene.from_toml(CAMERA + STILL)
    with pytest.warns(UserWarning, match="nothing moves and no light changes.*camera_motion='orbit'"):
        simulator = make(scene)
    with pytest.warns(UserWarning, match="no event was fired"):
        assert events(simulator) == []
    moved = scene.with_camera_motion("shake", speed=300.0, size=(64, 48))
    assert scene.camera_motion is None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = events(make(moved))
        assert found == events(make(scene, camera_motion="shake", camera_speed=300.0))
        assert len(found) > 20
        assert events(make(scene, camera_motion="dolly")) != found


def test_the_flow_is_as_fast_as_asked(device: evis.Device) -> None:
    scene = evis.Scene.from_toml(STILL)
    for motion, speed in (("orbit", 100.0), ("orbit", 1000.0)):
        simulator = evis.Simulator(
            scene,
            rate_hz=100.0,
            samples=1,
            size=(320, 240),
            labels=["flow"],
            label_rate_hz=100.0,
            camera_motion=motion,  # type: ignore[arg-type]
            camera_speed=speed,
        )
        with simulator.stream(duration=0.02) as stream:
            packets = [packet.labels for packet in stream]
        valid = next(p["flow_forward_valid"].data[0] for p in packets if len(p["flow_forward"]))[
            60:180, 80:240
        ]
        flow = next(p["flow_forward"].data[0] for p in packets if len(p["flow_forward"]))[60:180, 80:240][
            valid > 0
        ]
        length = np.hypot(flow[..., 0], flow[..., 1])
        measured = length.mean() * 100.0
        assert 0.8 * speed < measured < 1.2 * speed, (motion, speed, measured)


def test_a_picture_is_a_scene(device: evis.Device, tmp_path: Path) -> None:
    path = tmp_path / "photo.png"
    pixels = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    path.write_bytes(png(pixels))
    scene = evis.Scene.load(path)
    assert scene.name == "photo"
    with pytest.warns(UserWarning, match="the camera shakes before it"):
        simulator = make(scene)
    found = events(simulator)
    assert len(found) > 50
    with pytest.warns(UserWarning, match="shakes"):
        assert events(make(evis.Scene.load(path))) == found


def test_poses_come_from_files(device: evis.Device, tmp_path: Path) -> None:
    scene = evis.Scene.from_toml(STILL)
    path = tmp_path / "poses"
    path.write_text("0 0 0 3 0 0 0 1\n0.5 0.5 0 3 0 0 0 1\n")
    moved = scene.with_camera_motion(path)
    assert moved.duration == 0.5
    assert len(events(make(moved))) > 20
    path.write_text("0 0 0 3 0 0 0 1\n0.5 0.5 left 3 0 0 0 1\n")
    with pytest.raises(evis.FormatError, match="line 2, column 9: 'left' is not a number"):
        scene.with_camera_motion(path)
    with pytest.raises(FileNotFoundError):
        scene.with_camera_motion(tmp_path / "missing.csv")


def test_bad_settings_say_what_works() -> None:
    scene = evis.Scene.from_toml(STILL)
    with pytest.raises(evis.ConfigError, match="did you mean 'shake'"):
        scene.with_camera_motion("shaek")
    for speed in (0.0, -1.0, float("nan"), 1e12):
        with pytest.raises(evis.ConfigError, match="speed"):
            scene.with_camera_motion("orbit", speed=speed)
    with pytest.raises(evis.ConfigError, match="moves by itself"):
        evis.Scene.builtin("spinner").with_camera_motion("orbit")
