"""Blender's passes: their conventions on a scene of known motion, rendered once by Cycles (bpy 4.5.15)."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import evis
from evis import blender

pytest.importorskip("OpenEXR", reason="reads EXR files")

FRAMES = Path(__file__).parent / "data/blender"

#: The card moves by 0.2 m to the right and 0.1 m up per frame, 4 m away, with 64 * 50 / 36 pixels of focus.
RIGHT_PX, UP_PX = 64 * 50 / 36 * 0.2 / 4, 64 * 50 / 36 * 0.1 / 4


def test_passes_are_read_in_our_conventions() -> None:
    frames = list(blender.keyframes(FRAMES))
    assert len(frames) == 4
    frame = frames[1]
    assert frame.hdr.shape == (48, 64, 3)
    assert frame.hdr.dtype == frame.depth.dtype == frame.motion_vectors.dtype == np.float32
    # Planar depth, in the corners too, where the distance is up to 0.4 m longer.
    assert np.unique(np.round(frame.depth, 4)).tolist() == [4.0, 6.0]
    # Light as the materials have it, before any view transform.
    assert np.isclose(frame.hdr.max(), 0.9, atol=1e-5)
    assert np.isclose(frame.hdr.min(), 0.1, atol=1e-5)
    card = inner(frame.depth < 5)
    assert card.sum() > 500
    assert np.allclose(frame.motion_vectors[card], [-RIGHT_PX, UP_PX], atol=1e-4), (
        "it came from the left, below"
    )
    assert np.allclose(frame.motion_forward[card], [RIGHT_PX, -UP_PX], atol=1e-4), (
        "it goes to the right and up"
    )
    assert np.allclose(frame.motion_vectors[inner(frame.depth > 5)], 0)
    # The picture says so, too: where the card is in the next frame.
    x1, y1, x2, y2 = (np.flatnonzero((f.depth < 5).any(axis)) for f in frames[1:3] for axis in (0, 1))
    assert x2[0] - x1[0] in (4, 5)
    assert y2[0] - y1[0] in (-3, -2)


def inner(mask: np.ndarray) -> np.ndarray:
    """Pixels whose neighbours up to 2 pixels away are in the mask too: at edges, Cycles averages vectors."""
    padded = np.pad(mask, 2)
    parts = [padded[y : y + mask.shape[0], x : x + mask.shape[1]] for y in range(5) for x in range(5)]
    return np.logical_and.reduce(parts)


def test_the_picture_confirms_direction_and_sign() -> None:
    older, newer = list(blender.keyframes(FRAMES))[1:3]
    found = evis.emulation.check_motion(older.hdr, newer.hdr, newer.motion_vectors)
    assert found.is_right, found.convention
    for wrong in ((-1, 1), (1, -1), (-1, -1)):
        flipped = newer.motion_vectors * np.array(wrong, np.float32)
        assert not evis.emulation.check_motion(older.hdr, newer.hdr, flipped).is_right, "canary"


def edge_errors_us(events: np.ndarray) -> np.ndarray:
    """Mean time of each pixel's events within 2.5 ms of the card's right edge passing it, less that time."""
    found = []
    for x in range(42, 53):
        # The edge lies at 32 + f (0.4 + 0.2 frame) / 4; a frame lasts 10 ms.
        when_us = ((x + 0.5 - 32) * 4 / (64 * 50 / 36) - 0.4) / 0.2 * 10_000
        for y in range(20, 29):
            times = events["t"][(events["x"] == x) & (events["y"] == y)] - when_us
            if (near := np.abs(times) < 2_500).any():
                found.append(times[near].mean())
    return np.array(found)


def pushed(scale: tuple[int, int]) -> np.ndarray:
    """Events of the sequence with its vectors multiplied by ``scale``."""
    emulator = evis.EventEmulator(64, 48)
    parts = []
    for number, frame in enumerate(blender.keyframes(FRAMES)):
        motion, forward = (
            m * np.array(scale, np.float32) for m in (frame.motion_vectors, frame.motion_forward)
        )
        keyframe = frame.hdr, frame.depth, motion, 10_000 * number
        parts.append(emulator.push_keyframe(*keyframe, motion_forward=forward).to_numpy())
    return np.concatenate(parts)


@pytest.mark.filterwarnings("ignore:.*px per gap")
def test_events_come_when_the_cards_edge_passes() -> None:
    made = blender.events(FRAMES, fps=100.0)
    assert made.sensor_size == (64, 48)
    assert int(made.t[0]) > 0
    assert int(made.t[-1]) <= 30_000
    assert np.array_equal(made.to_numpy(), pushed((1, 1)))
    errors = edge_errors_us(made.to_numpy())
    assert len(errors) == 99
    assert np.median(np.abs(errors)) < 500, "a pixel is 2250 us"
    # Canary: with x turned around the edge is elsewhere between frames, with y patterns no longer fit.
    wrong = edge_errors_us(pushed((-1, 1)))
    assert len(wrong) < 60
    assert np.median(np.abs(wrong)) > 750
    assert len(pushed((1, -1))) > 1.2 * len(made)


@pytest.mark.filterwarnings("ignore:.*px per gap")
def test_the_emulators_sensor_and_seed_are_passed_on() -> None:
    noisy = blender.events(FRAMES, fps=100.0, sensor="v2e-noisy", seed=1)
    assert noisy != blender.events(FRAMES, fps=100.0, sensor="v2e-noisy", seed=2)
    assert noisy == blender.events(sorted(FRAMES.glob("*.exr")), fps=100.0, sensor="v2e-noisy", seed=1)


def test_what_cannot_be_used_says_what_would_work(tmp_path: Path) -> None:
    with pytest.raises(evis.ConfigError, match="no folder"):
        blender.events(FRAMES / "frame_0000.exr", fps=24)
    with pytest.raises(evis.ConfigError, match=r"has no \.exr file"):
        blender.events(tmp_path, fps=24)
    with pytest.raises(evis.ConfigError, match="fps is 0"):
        blender.events(FRAMES, fps=0)
    with pytest.raises(evis.ConfigError, match="no view layer 'Layer 2'; it has ViewLayer"):
        blender.read(FRAMES / "frame_0000.exr", layer="Layer 2")
    for number in (0, 2):
        shutil.copy(FRAMES / "frame_0000.exr", tmp_path / f"a_{number:04d}.exr")
    with pytest.raises(evis.ConfigError, match="no frame 1 between 0 and 2"):
        blender.events(tmp_path, fps=24)
    (tmp_path / "bad.exr").write_bytes(b"not an EXR file")
    with pytest.raises(evis.FormatError, match="cannot be read"):
        blender.read(tmp_path / "bad.exr")
    with pytest.raises(FileNotFoundError):
        blender.read(tmp_path / "none.exr")
