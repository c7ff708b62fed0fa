"""Frames from elsewhere: through the engine, and as arrays."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from test_gil import HEED_CTRL_C

import evis

WIDTH, HEIGHT, COUNT = 16, 12, 10


def codes() -> np.ndarray:
    """A pattern that drifts: (T, H, W), uint8."""
    x, k = np.arange(WIDTH), np.arange(COUNT)
    wave = 127 + 100 * np.sin(0.3 + 0.9 * x[None] - 0.4 * k[:, None])
    return np.repeat(wave[:, None], HEIGHT, axis=1).astype(np.uint8)


def expected(
    frames: np.ndarray, times_us: list[int], transfer: str = "srgb", sensor: str = "ideal", seed: int = 0
) -> np.ndarray:
    emulator = evis.EventEmulator(WIDTH, HEIGHT, sensor, seed=seed)
    parts = [
        emulator.push(frame, t_us, transfer=transfer).to_numpy()
        for frame, t_us in zip(frames, times_us, strict=True)
    ]
    return np.concatenate(parts)


def find_ffmpeg() -> str | None:
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except ImportError:
        return shutil.which("ffmpeg")


def test_a_stack_gives_what_the_emulator_gives(tmp_path: Path) -> None:
    np.save(tmp_path / "in.npy", codes())
    report = evis.video(tmp_path / "in.npy", tmp_path / "out.h5", sensor="v2e-noisy", seed=5, fps=1000)
    times = [1000 * k for k in range(COUNT)]
    want = expected(codes(), times, sensor="v2e-noisy", seed=5)
    recording = evis.load(tmp_path / "out.h5")
    assert recording.complete
    np.testing.assert_array_equal(recording.events.to_numpy(), want)
    assert (report.frames, report.events, report.kind, report.transfer) == (COUNT, len(want), "stack", "srgb")
    assert report.on == int(want["p"].sum())
    assert "leak_hz" in recording.config_toml
    # Canary: another seed is another recording.
    evis.video(tmp_path / "in.npy", tmp_path / "b.h5", sensor="v2e-noisy", seed=6, fps=1000)
    assert not np.array_equal(evis.load(tmp_path / "b.h5").events.to_numpy(), want)


def test_frames_are_arrays(tmp_path: Path) -> None:
    stack = codes()
    np.save(tmp_path / "in.npy", stack)
    (tmp_path / "t.txt").write_text("# unit: us\n" + "\n".join(str(7 + 100 * k * k) for k in range(COUNT)))
    reader = evis.frames(tmp_path / "in.npy", timestamps=tmp_path / "t.txt")
    read = list(reader)
    assert [t_us for t_us, _ in read] == [100 * k * k for k in range(COUNT)]
    np.testing.assert_array_equal(np.stack([frame for _, frame in read]), stack)
    assert (reader.kind, reader.transfer, reader.offset_us, reader.warnings) == ("stack", "srgb", 7, [])

    colour = np.repeat(stack[..., None], 3, axis=3).astype(np.uint16) * 257
    np.save(tmp_path / "rgb.npy", colour)
    (first, second) = list(evis.frames(tmp_path / "rgb.npy", fps=10, start=0.15, duration=0.1))
    assert (first[0], second[0], first[1].shape, first[1].dtype) == (
        0,
        100_000,
        (HEIGHT, WIDTH, 3),
        np.uint16,
    )
    np.testing.assert_array_equal(first[1], colour[2])

    half = next(evis.frames(tmp_path / "in.npy", fps=10, size=(WIDTH // 2, HEIGHT), transfer="linear"))[1]
    want = stack[0].reshape(HEIGHT, WIDTH // 2, 2).mean(axis=2) / 255
    np.testing.assert_allclose(half, want, rtol=1e-5)
    assert half.dtype == np.float32


def test_bad_input_is_told(tmp_path: Path) -> None:
    np.save(tmp_path / "in.npy", codes())
    np.save(tmp_path / "bad.npy", codes().astype(np.int64))
    np.save(tmp_path / "order.npy", np.asfortranarray(codes()))
    out = tmp_path / "out.h5"
    with pytest.raises(evis.FormatError, match="give `fps` or `timestamps`"):
        evis.video(tmp_path / "in.npy", out)
    with pytest.raises(evis.FormatError, match="dtype '<i8'"):
        evis.video(tmp_path / "bad.npy", out, fps=30)
    with pytest.raises(evis.FormatError, match="Fortran"):
        evis.frames(tmp_path / "order.npy", fps=30)
    with pytest.raises(evis.ConfigError, match="gamma:G"):
        evis.video(tmp_path / "in.npy", out, fps=30, transfer="film")
    with pytest.raises(evis.ConfigError, match="fps is -1"):
        evis.video(tmp_path / "in.npy", out, fps=-1)
    with pytest.raises(evis.ConfigError, match="size is"):
        evis.video(tmp_path / "in.npy", out, fps=30, size=(0, 3))
    with pytest.raises(evis.ConfigError, match=r"ends with '\.avi'"):
        evis.video(tmp_path / "in.npy", tmp_path / "out.avi", fps=30)
    with pytest.raises(FileNotFoundError):
        evis.video(tmp_path / "none.mp4", out)
    assert not out.exists()
    evis.video(tmp_path / "in.npy", out, fps=30)
    with pytest.raises(FileExistsError):
        evis.video(tmp_path / "in.npy", out, fps=30)


def test_a_recording_is_no_film(tmp_path: Path) -> None:
    np.save(tmp_path / "in.npy", codes())
    evis.video(tmp_path / "in.npy", tmp_path / "events.h5", fps=1000)
    with pytest.raises(evis.ConfigError, match=r"events.h5, which holds events or labels \(HDF5\)"):
        evis.video(tmp_path / "events.h5", tmp_path / "out.h5")


def test_no_ffmpeg_says_how_to_get_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.mp4").write_bytes(b"film")
    monkeypatch.setenv("EVIS_FFMPEG", str(tmp_path / "missing"))
    with pytest.raises(evis.ConfigError, match=r"apt-get install ffmpeg.*evis\[video\]"):
        evis.video(tmp_path / "a.mp4", tmp_path / "out.h5")


def test_a_film_has_its_own_times(tmp_path: Path) -> None:
    ffmpeg = find_ffmpeg()
    if ffmpeg is None:
        pytest.skip("no ffmpeg: pip install imageio-ffmpeg, or apt-get install ffmpeg")
    film = tmp_path / "a.mkv"
    make = f"{ffmpeg} -v error -f rawvideo -pix_fmt gray -s {WIDTH}x{HEIGHT} -r 25 -i pipe:0 -c:v ffv1"
    subprocess.run([*make.split(), "-pix_fmt", "bgr0", str(film)], input=codes().tobytes(), check=True)
    report = evis.video(film, tmp_path / "out.h5", transfer="srgb")
    assert (report.frames, report.kind) == (COUNT, "film")
    assert len(report.warnings) == 1
    assert "frames come at 25 Hz" in report.warnings[0]
    assert "`upsampler` puts frames between" in report.warnings[0]
    times = [40_000 * k for k in range(COUNT)]
    want = expected(np.repeat(codes()[..., None], 3, axis=3), times)
    np.testing.assert_array_equal(evis.load(tmp_path / "out.h5").events.to_numpy(), want)
    read = list(evis.frames(film))
    assert [t for t, _ in read] == times
    np.testing.assert_array_equal(read[3][1][..., 1], codes()[3])


def test_a_folder_is_read_in_the_order_of_its_numbers(tmp_path: Path) -> None:
    ffmpeg = find_ffmpeg()
    if ffmpeg is None:
        pytest.skip("no ffmpeg to write PNG with: pip install imageio-ffmpeg, or apt-get install ffmpeg")
    folder = tmp_path / "frames"
    folder.mkdir()
    make = f"{ffmpeg} -v error -f rawvideo -pix_fmt gray -s {WIDTH}x{HEIGHT} -r 25 -i pipe:0"
    subprocess.run([*make.split(), str(folder / "f%d.png")], input=codes().tobytes(), check=True)
    assert len(os.listdir(folder)) == COUNT
    read = np.stack([frame for _, frame in evis.frames(folder, fps=50)])
    np.testing.assert_array_equal(read, codes())


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_leaves_a_whole_file(tmp_path: Path) -> None:
    repeats = 40_000  # No machine is done with them before the signal comes.
    np.save(tmp_path / "in.npy", np.tile(codes(), (repeats, 1, 1)))
    script = "import evis\nevis.video('in.npy', 'out.h5', fps=1000, sensor='v2e-noisy')\n"
    child = subprocess.Popen(
        [sys.executable, "-c", HEED_CTRL_C + script], cwd=tmp_path, stderr=subprocess.PIPE
    )
    while not (tmp_path / "out.h5").exists():
        assert child.poll() is None, "it ended too early"
        time.sleep(0.005)
    child.send_signal(signal.SIGINT)
    _, told = child.communicate(timeout=60)
    assert b"KeyboardInterrupt" in told, told
    recording = evis.load(tmp_path / "out.h5")
    assert recording.complete
    assert recording.report is not None
    assert recording.report["interrupted"]
    assert 0 < recording.report["frames"] < repeats * COUNT
    assert len(recording.events) == recording.report["events"]
