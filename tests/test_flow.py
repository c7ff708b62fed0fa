"""Frames between frames; runs where OpenCV is installed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

import evis
from evis import flow

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
