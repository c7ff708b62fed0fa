"""Recordings of the Rust side, read by h5py: whole, while written, killed, repaired, and on a full disk.

The file is written by the example ``write_recording`` of evis-core, named by ``EVIS_WRITE_RECORDING`` or
built and run through cargo.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest

h5py = pytest.importorskip("h5py")
resource = pytest.importorskip("resource")

ROOT = Path(__file__).resolve().parent.parent
WIDTH, HEIGHT = 640, 480


@pytest.fixture(scope="session")
def program() -> list[str]:
    """The command that writes recordings."""
    given = os.environ.get("EVIS_WRITE_RECORDING")
    if given:
        return [given]
    build = ["cargo", "build", "--release", "-p", "evis-core", "--example", "write_recording"]
    subprocess.run(build, cwd=ROOT, check=True)
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    return [str(target / "release" / "examples" / "write_recording")]


def run(program: list[str], out: Path, *settings: str) -> str:
    done = subprocess.run([*program, str(out), *settings], capture_output=True, text=True, check=True)
    return done.stdout


def expected(count: int, rate: int) -> dict[str, np.ndarray]:
    """The first `count` events, as the example's documentation defines them."""
    i = np.arange(count, dtype=np.uint64)
    m = i * np.uint64(0x9E3779B97F4A7C15)
    h = ((m ^ (m >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)) >> np.uint64(40)
    return {
        "x": h % WIDTH,
        "y": h // WIDTH % HEIGHT,
        "p": h // 7 % 2,
        "t": i * np.uint64(1_000_000) // np.uint64(rate),
    }


def check_camera(camera: h5py.Group, rate: int, *, in_step: bool) -> int:
    """Compares events, index, poses and labels with what was written; returns the number of events."""
    counts = {name: camera["events"][name].shape[0] for name in "xytp"}
    count = min(counts.values())
    if in_step:
        assert len(set(counts.values())) == 1, counts
    want = expected(count, rate)
    for name in "xytp":
        got = camera["events"][name][:count]
        assert np.array_equal(got.astype(np.uint64), want[name]), name
    index = camera["ms_to_idx"][:]
    t = want["t"].astype(np.int64)
    entries = int(t[-1]) // 1000 + 1 if count else 0
    if in_step:
        assert len(index) == entries
    index = index[:entries]
    assert np.array_equal(index, np.searchsorted(t, 1000 * np.arange(len(index))))

    poses = camera["poses"]
    rows = min(poses[name].shape[0] for name in ("t_us", "position", "rotation_xyzw"))
    assert np.array_equal(poses["position"][:rows, 0], poses["t_us"][:rows].astype(float))
    for kind in [name for name in camera["labels"] if not name.endswith("_us")]:
        times = camera["labels"][f"{kind}_t_us"][:]
        frames = camera["labels"][kind]
        assert frames.shape[1:3] == (HEIGHT, WIDTH)
        rows = min(len(times), frames.shape[0])
        for k in range(rows):
            assert times[k] == 20_000 * k
            assert (frames[k] == np.float32(times[k])).all()
    return count


def test_a_finished_file_opens_plainly_and_in_swmr_mode(program: list[str], tmp_path: Path) -> None:
    out = tmp_path / "out.h5"
    run(program, out, "events=300000", "rate=1000000", "labels=1")
    for swmr in (False, True):
        with h5py.File(out, "r", swmr=swmr) as f:
            assert check_camera(f["cam0"], 1_000_000, in_step=True) == 300_000
            assert f["events/t"] == f["cam0/events/t"], "a hard link, not a copy"
            assert f["ms_to_idx"] == f["cam0/ms_to_idx"]
            assert f["t_offset"][()] == 1_700_000_000_000_000
            assert (f["events/height"][()], f["events/width"][()]) == (HEIGHT, WIDTH)
            assert (f.attrs["height"], f.attrs["width"]) == (HEIGHT, WIDTH)
            dtypes = {name: f["events"][name].dtype.str for name in "xytp"}
            assert dtypes == {"x": "<u2", "y": "<u2", "t": "<u4", "p": "|u1"}
            x = f["events/x"]
            assert (x.chunks, x.maxshape, x.shuffle, x.compression, x.compression_opts) == (
                (65_536,), (None,), True, "gzip", 2,
            )  # fmt: skip
            depth = f["cam0/labels/depth"]
            assert depth.chunks == (1, HEIGHT, WIDTH)
            assert depth.dtype == np.float32
            assert f["cam0/labels/flow_forward"].shape[1:] == (HEIGHT, WIDTH, 2)
            assert f["evis/config_toml"][0].decode() == "rate_hz = 1000.0\n"
            assert bytes(f["evis/report_json"][:]) == b'{"events": 1}'
            assert f["evis"].attrs["method"] == "native"
            assert f["evis/complete"][()] == 1
            with pytest.raises(AssertionError):
                check_camera(f["cam0"], 900_000, in_step=True)  # canary: another rate is not accepted


def test_two_cameras_have_no_links_and_long_streams_have_64_bit_times(
    program: list[str], tmp_path: Path
) -> None:
    out = tmp_path / "out.h5"
    run(program, out, "events=100000", "rate=1000000", "cameras=2", "wide=1")
    with h5py.File(out, "r") as f:
        assert sorted(f) == ["cam0", "cam1", "evis"]
        assert list(f["evis/cameras"][:]) == [b"cam0", b"cam1"]
        for name in ("cam0", "cam1"):
            assert f[name]["events/t"].dtype == np.int64
            assert check_camera(f[name], 1_000_000, in_step=True) == 100_000


@pytest.mark.parametrize("seed", range(8))
def test_a_kill_loses_at_most_the_last_second(program: list[str], tmp_path: Path, seed: int) -> None:
    chance = random.Random(seed)
    # From a slow stream, whose chunks stay unfinished for long, to one that fills several a second.
    rate = [2_000, 50_000, 400_000, 1_500_000][seed % 4]
    out = tmp_path / "out.h5"
    settings = ["events=1000000000", f"rate={rate}", f"packet={rate // 100}", "paced=1", "cameras=2"]
    if seed % 2:
        settings.append("labels=1")
    process = subprocess.Popen([*program, str(out), *settings], stdout=subprocess.PIPE, text=True)
    given: list[tuple[float, int]] = []

    def listen() -> None:
        assert process.stdout is not None
        given.extend((time.monotonic(), int(line)) for line in process.stdout)

    listener = threading.Thread(target=listen)
    listener.start()
    time.sleep(chance.uniform(0.2, 3.5))
    process.send_signal(signal.SIGKILL)
    killed = time.monotonic()
    process.wait()
    listener.join()
    promised = max((n for when, n in given if when <= killed - 1.0), default=0)

    with pytest.raises(OSError, match="already open"):
        h5py.File(out, "r")  # what repair is for
    with h5py.File(out, "r", swmr=True) as f:
        for name in ("cam0", "cam1"):
            found = check_camera(f[name], rate, in_step=False)
            assert found >= promised, f"{found} of {promised} events, {given[-1][1]} were given in all"
    report = run(program, out, "repair=1")
    assert "reopened: true" in report
    with h5py.File(out, "r") as f:
        for name in ("cam0", "cam1"):
            assert check_camera(f[name], rate, in_step=True) >= promised
        assert f["evis/complete"][()] == 0
    with h5py.File(out, "r+") as f:
        f.attrs["touched"] = 1  # a repaired file can be written to like any other


def test_a_reader_follows_the_writer(program: list[str], tmp_path: Path) -> None:
    out = tmp_path / "out.h5"
    settings = ["events=600000", "rate=200000", "packet=2000", "paced=1"]
    process = subprocess.Popen([*program, str(out), *settings], stdout=subprocess.DEVNULL)
    try:
        while not out.exists():
            time.sleep(0.01)
        time.sleep(0.2)
        seen = []
        with h5py.File(out, "r", swmr=True) as f:
            while process.poll() is None:
                for name in "xytp":
                    f["cam0/events"][name].refresh()
                count = f["cam0/events/t"].shape[0]
                want = expected(count, 200_000)
                assert all(
                    np.array_equal(f["cam0/events"][name][:count].astype(np.uint64), want[name])
                    for name in "xyp"
                )
                seen.append(count)
                time.sleep(0.05)
    finally:
        process.kill()
        process.wait()
    assert seen == sorted(seen)
    assert len(set(seen)) > 2, "the reader saw the stream grow"


def test_a_full_disk_is_said_and_keeps_what_was_stored(program: list[str], tmp_path: Path) -> None:
    out = tmp_path / "out.h5"

    def limit() -> None:
        # The nearest thing to a full disk that needs no rights: a write past this size fails.
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (6_000_000, 6_000_000))

    done = subprocess.run(
        [*program, str(out), "events=5000000", "rate=1000000", "paced=1"],
        preexec_fn=limit, restore_signals=False, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 1
    assert "panicked" not in done.stderr
    assert str(out) in done.stderr
    assert "cannot write" in done.stderr
    assert "disk" in done.stderr
    with h5py.File(out, "r") as f:
        count = min(f["cam0/events"][name].shape[0] for name in "xytp")
        assert count > 500_000, "what was flushed before is there"
        want = expected(count, 1_000_000)
        assert all(np.array_equal(f["cam0/events"][name][:count], want[name]) for name in "xytp")
        assert f["evis/complete"][()] == 0

    # No room for the file at all: the folder stays as it was.
    (tmp_path / "empty").mkdir()

    def nothing() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (500, 500))

    done = subprocess.run(
        [*program, str(tmp_path / "empty" / "out.h5")],
        preexec_fn=nothing, restore_signals=False, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 1
    assert "panicked" not in done.stderr
    assert done.stderr.startswith("cannot create")
    assert done.stderr.count("\n") == 1, done.stderr
    assert list((tmp_path / "empty").iterdir()) == []
