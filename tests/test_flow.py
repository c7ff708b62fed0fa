"""Frames between frames; what finds optical flow runs where OpenCV is installed."""

from __future__ import annotations

import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import evis
from evis import _evis, flow

HEIGHT, WIDTH = 72, 96
SPEED = 150.0
"""Pixels per second."""


def texture(t_s: float) -> np.ndarray:
    """A smooth texture that moves right by `SPEED`."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float64)
    u = x - SPEED * t_s
    waves = np.sin(0.31 * u + 0.17 * y) + np.sin(0.13 * u - 0.29 * y + 1) + np.sin(0.23 * y - 0.4 * u + 2)
    return (0.4 * np.exp(0.5 * waves)).astype(np.float32)


def events_of(frames: Iterator[tuple[int, np.ndarray]]) -> evis.EventArray:
    emulator = evis.EventEmulator(WIDTH, HEIGHT)
    parts = [emulator.push(frame, t_us).to_numpy() for t_us, frame in frames]
    return evis.EventArray(np.concatenate(parts), width=WIDTH, height=HEIGHT)


def film(fps: int, seconds: float = 0.2) -> list[tuple[int, np.ndarray]]:
    return [(round(1e6 * k / fps), texture(k / fps)) for k in range(round(seconds * fps) + 1)]


def f1(events: evis.EventArray, truth: evis.Truth) -> float:
    return evis.metrics.score(events, truth, tolerances_us=(2000,)).at(2000).plain.f1


def test_frames_between_frames_come_closer_to_truth(tmp_path) -> None:  # type: ignore[no-untyped-def]
    pytest.importorskip("cv2", reason="no OpenCV: pip install opencv-python-headless")
    evis.save(tmp_path / "truth.h5", events_of(iter(film(1000))))
    truth = evis.measure.load_truth(tmp_path / "truth.h5")
    given = film(30)
    made = list(flow.upsample(iter(given), step_px=0.5))
    assert len(made) > 5 * len(given)
    times = [t_us for t_us, _ in made]
    assert times == sorted(set(times))
    held = dict(made)
    for t_us, frame in given:
        np.testing.assert_array_equal(held[t_us], frame)
    plain, better = f1(events_of(iter(given)), truth), f1(events_of(iter(made)), truth)
    assert better > plain + 0.1, (plain, better)
    # Canary: frames repeated between frames are no better.
    repeated = [(t_us, given[0][1]) for t_us, _ in made]
    for k, (t_us, _) in enumerate(made):
        repeated[k] = (t_us, next(frame for at, frame in reversed(given) if at <= t_us))
    assert f1(events_of(iter(repeated)), truth) < better - 0.1


def test_still_frames_stay_alone() -> None:
    pytest.importorskip("cv2", reason="no OpenCV: pip install opencv-python-headless")
    still = (texture(0.0) * 200).astype(np.uint8)
    made = list(flow.upsample([(0, still), (33_333, still)]))
    assert [t_us for t_us, _ in made] == [0, 33_333]
    colour = np.repeat(still[..., None], 3, axis=2)
    made = list(flow.upsample([(0, colour)], transfer="rec709"))
    assert made[0][1].shape == still.shape


def test_pairs_below_a_pixel_are_left_alone() -> None:
    pytest.importorskip("cv2", reason="no OpenCV: pip install opencv-python-headless")
    x, y = np.meshgrid(np.arange(96), np.arange(64))

    def moved(by: float) -> np.ndarray:
        return (0.5 + 0.2 * np.sin(0.3 * (x - by)) + 0.2 * np.sin(0.37 * y)).astype(np.float32)

    def times(by: float) -> list[int]:
        return [t_us for t_us, _ in flow.upsample([(0, moved(0)), (10_000, moved(by))], step_px=0.1)]

    assert times(0.5) == [0, 10_000]
    assert len(times(3.0)) > 10


def test_bad_frames_are_refused() -> None:
    pytest.importorskip("cv2", reason="no OpenCV: pip install opencv-python-headless")
    frame = texture(0.0)
    for frames, told in (
        ([(0, frame), (0, frame)], "t_us is 0"),
        ([(0, frame), (9, frame[:-1])], "shape"),
        ([(0, frame.astype(np.int32))], "int32"),
    ):
        with pytest.raises(evis.ConfigError, match=told):
            list(flow.upsample(frames))
    with pytest.raises(evis.ConfigError, match="step_px is 0"):
        list(flow.upsample([(0, frame)], step_px=0))
    with pytest.raises(evis.ConfigError, match="transfer is 'film'"):
        list(flow.upsample([(0, np.zeros((8, 8), np.uint8))], transfer="film"))


class Session:
    """A stand-in of onnxruntime's: what a file of this name computes."""

    def __init__(self, content: bytes, options: Any, providers: list[str]) -> None:
        self._shapes, self._function = NETWORKS[content.decode()]

    def get_inputs(self) -> list[Any]:
        each = enumerate(self._shapes)
        return [types.SimpleNamespace(name=f"in{i}", shape=s, type="tensor(float)") for i, s in each]

    def get_outputs(self) -> list[Any]:
        return [types.SimpleNamespace(name="out", shape=[1, 3, "H", "W"])]

    def run(self, names: None, arrays: dict[str, Any]) -> list[Any]:
        assert all(array.dtype == np.float32 for array in arrays.values())
        return [self._function(*arrays.values())]


COLOURS, GREY = [1, 3, "H", "W"], [1, 1, "H", "W"]
#: Shapes of the inputs, and a function of them.
NETWORKS: dict[str, tuple[list[list[Any]], Callable[..., Any]]] = {
    "middle": ([COLOURS, COLOURS], lambda a, b: (a + b) / 2),
    "packed": ([[1, 2, "H", "W"]], lambda both: both.mean(axis=1, keepdims=True)),
    "number": ([COLOURS, COLOURS, [1]], lambda a, b, t: a * (1 - t[0]) + b * t[0]),
    "scalar": ([GREY, GREY, []], lambda a, b, t: a * (1 - t) + b * t),
    "picture": ([GREY, GREY, GREY], lambda a, b, t: a * (1 - t) + b * t),
    "three": ([COLOURS, COLOURS, COLOURS], lambda a, b, c: a),
    "small": ([[1, 3, 32, 32], [1, 3, 32, 32]], lambda a, b: a),
    "crop": ([COLOURS, COLOURS], lambda a, b: a[..., :8, :8]),
}


@pytest.fixture
def network(network_files: Callable[[type], Callable[[str], Path]]) -> Callable[[str], Path]:
    """Give the path of a network by its name."""
    return network_files(Session)


class Pair:
    """A stand-in of optical flow: everything moves by 3.2 pixels."""

    def __init__(self, cv2: Any, before: Any, after: Any, eps: float) -> None:
        pass

    def motion(self) -> float:
        return 3.2


@pytest.mark.parametrize("name", ["middle", "packed", "number", "scalar", "picture"])
def test_networks_of_every_shape_give_the_frames_between(
    name: str, network: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(flow, "_opencv", lambda: None)
    monkeypatch.setattr(flow, "_Pair", Pair)
    upsampler = flow.Upsampler(network(name))
    assert str(upsampler).startswith(f"{name}.onnx, sha256 ")
    # No multiple of what networks are padded to.
    before, after = np.full((24, 40, 3), 40, np.uint8), np.full((24, 40, 3), 200, np.uint8)
    made = upsampler.between((1000, before), (9000, after), transfer="linear")
    # 3.2 pixels in steps of one at most.
    assert [t_us for t_us, _ in made] == [3000, 5000, 7000]
    for t_us, light in made:
        assert light.shape == (24, 40)
        assert light.dtype == np.float32
        np.testing.assert_allclose(light, (40 + 160 * (t_us - 1000) / 8000) / 255, atol=1e-6)
    # Networks see stored values: halfway between them is not halfway between lights.
    (curved,) = (light for t_us, light in upsampler.between((1000, before), (9000, after)) if t_us == 5000)
    np.testing.assert_allclose(curved, ((120 / 255 + 0.055) / 1.055) ** 2.4, rtol=1e-5)
    # Floats are light, and given stored values.
    lights = [np.full((24, 40), value, np.float32) for value in (0.1, 0.9)]
    stored = [1.055 * light[0, 0] ** (1 / 2.4) - 0.055 for light in lights]
    (middle,) = (light for t, light in upsampler.between((0, lights[0]), (8, lights[1])) if t == 4)
    np.testing.assert_allclose(middle, ((sum(stored) / 2 + 0.055) / 1.055) ** 2.4, rtol=1e-5)


def test_networks_that_do_not_fit_are_refused(
    network: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(flow, "_opencv", lambda: None)
    monkeypatch.setattr(flow, "_Pair", Pair)
    with pytest.raises(evis.ConfigError, match=r"three\.onnx takes .*two pictures"):
        flow.Upsampler(network("three"))
    frames = [(t_us, np.full((48, 64), 0.1 + t_us / 1e5, np.float32)) for t_us in (0, 10_000)]
    for name, told in (("small", "pictures of 32x32; the frames are 64x48"), ("crop", "must give a picture")):
        with pytest.raises(evis.ConfigError, match=told):
            list(flow.upsample(frames, network=network(name)))
    with pytest.raises(FileNotFoundError):
        flow.Upsampler("none.onnx")


class Halves:
    """A stand-in of `flow.Upsampler`: the mean of two frames, in the middle."""

    def __init__(self, network: Path | None = None) -> None:
        self.network = network

    def __str__(self) -> str:
        return f"halves of {self.network}"

    def between(self, before: Any, after: Any, *, transfer: str) -> list[tuple[int, Any]]:
        assert transfer == "srgb"
        if self.network is not None:
            raise evis.ConfigError("this network is tired")
        (start_us, first), (end_us, last) = before, after
        lights = [flow._light(frame, transfer) for frame in (first, last)]
        return [((start_us + end_us) // 2, (lights[0] + lights[1]) / np.float32(2))]


def test_the_command_and_the_function_put_frames_between_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    stack = rng.random((4, 12, 16), np.float32)
    np.save(tmp_path / "film.npy", stack)
    given = [(10_000 * k, frame) for k, frame in enumerate(stack)]
    halves = [(10_000 * k + 5000, (stack[k] + stack[k + 1]) / np.float32(2)) for k in range(3)]
    emulator = evis.EventEmulator(16, 12)
    wanted = [
        emulator.push(frame, t_us).to_numpy() for t_us, frame in sorted(given + halves, key=lambda f: f[0])
    ]

    report = evis.video(tmp_path / "film.npy", tmp_path / "a.h5", fps=100, upsampler=Halves())  # type: ignore[arg-type]
    assert (report.frames, report.between) == (4, 3)
    recording = evis.load(tmp_path / "a.h5")
    np.testing.assert_array_equal(recording.events.to_numpy(), np.concatenate(wanted))
    assert 'upsampler = "halves of None"' in recording.config_toml
    plain = evis.video(tmp_path / "film.npy", tmp_path / "b.h5", fps=100)
    assert plain.between == 0
    assert evis.load(tmp_path / "b.h5").events != recording.events, "canary"

    # Coloured codes: the frames between are light.
    codes = rng.integers(0, 256, (4, 12, 16, 3), dtype=np.uint8)
    np.save(tmp_path / "colours.npy", codes)
    report = evis.video(tmp_path / "colours.npy", tmp_path / "d.h5", fps=100, upsampler=Halves())  # type: ignore[arg-type]
    lights = [flow._light(frame, "srgb") for frame in codes]
    emulator = evis.EventEmulator(16, 12)
    count = len(emulator.push(lights[0], 0))
    for k in range(3):
        count += len(emulator.push((lights[k] + lights[k + 1]) / np.float32(2), 10_000 * k + 5000))
        count += len(emulator.push(lights[k + 1], 10_000 * (k + 1)))
    # But for roundings of the luminance.
    assert report.between == 3
    assert report.events == pytest.approx(count, rel=0.005)

    monkeypatch.setattr(flow, "Upsampler", Halves)
    line = ["evis", "video", str(tmp_path / "film.npy"), "-o", str(tmp_path / "c.h5"), "--fps", "100"]
    assert _evis.run_cli([*line, "--upsample"]) == 0
    assert evis.load(tmp_path / "c.h5").events == recording.events
    assert "frames   4 and 3 between them, stack" in capfd.readouterr().out
    assert _evis.run_cli([*line, "--force", "--upsample", "tired.onnx"]) == 2
    assert "frames between frames: this network is tired" in capfd.readouterr().err
