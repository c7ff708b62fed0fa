"""What is saved is loaded; unusable files and outputs are refused."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

import evis
from evis import blender, dataset, evaluate, measure


def some_events(count: int = 5000, *, seed: int = 0, width: int = 64, height: int = 48) -> evis.EventArray:
    random = np.random.default_rng(seed)
    t = np.sort(random.integers(0, 1_000_000, count))
    x, y, p = (random.integers(0, limit, count) for limit in (width, height, 2))
    return evis.EventArray.from_columns(t, x, y, p, width=width, height=height)


@pytest.mark.parametrize("ending", [".h5", ".hdf5", ".npz"])
def test_events_come_back(tmp_path: Path, ending: str):
    events = some_events()
    path = tmp_path / f"out{ending}"
    assert evis.save(path, events) == (path,)
    recording = evis.load(path)
    assert recording.events == events
    assert recording.slice_time(100_000, 200_000) == events.slice_time(100_000, 200_000)
    assert len(recording.view) == len(events)
    assert recording.events != some_events(seed=1), "canary"
    assert recording.complete


@pytest.mark.parametrize("mapped", [False, True])
def test_npy_can_be_mapped(tmp_path: Path, mapped: bool):
    events = some_events()
    evis.save(tmp_path / "out.npy", events)
    recording = evis.load(tmp_path / "out.npy", width=64, height=48, mapped=mapped)
    assert recording.events == events
    base = recording.events.to_numpy()
    while base is not None and not isinstance(base, np.memmap):
        base = getattr(base, "base", None)
    assert isinstance(base, np.memmap) == mapped
    assert np.load(tmp_path / "out.npy").dtype["t"] == np.dtype("<i8")


def test_several_cameras_come_back(tmp_path: Path):
    cameras = {"left": some_events(seed=1), "right": some_events(seed=2, width=32, height=24)}
    evis.save(tmp_path / "out.h5", cameras)
    recording = evis.load(tmp_path / "out.h5")
    assert list(recording) == ["left", "right"]
    assert recording["left"].events == cameras["left"]
    assert recording["right"].events == cameras["right"]
    with pytest.raises(evis.EvisError, match="left, right"):
        _ = recording.events
    with pytest.raises(evis.ConfigError, match="2 cameras"):
        evis.save(tmp_path / "out.npz", cameras)


def test_h5py_reads_dsecs_columns(tmp_path: Path):
    events = some_events()
    evis.save(tmp_path / "out.h5", events)
    with h5py.File(tmp_path / "out.h5") as file:
        for name, column in zip("txyp", events.columns, strict=True):
            assert np.array_equal(file["events"][name][:], column)
        assert file["events/t"].dtype == np.uint32
        assert file.attrs["width"] == 64


def test_a_recording_can_be_saved_again(tmp_path: Path):
    events = some_events()
    evis.save(tmp_path / "one.h5", events)
    evis.save(tmp_path / "two.h5", evis.load(tmp_path / "one.h5"))
    evis.save(tmp_path / "three.npz", evis.load(tmp_path / "two.h5"))
    assert evis.load(tmp_path / "three.npz").events == events


def test_empty_events_come_back(tmp_path: Path):
    nothing = some_events(0)
    for ending in (".h5", ".npz"):
        evis.save(tmp_path / f"out{ending}", nothing)
        assert evis.load(tmp_path / f"out{ending}").events == nothing


def test_an_existing_file_is_kept(tmp_path: Path):
    for ending in (".h5", ".npz", ".npy"):
        path = tmp_path / f"out{ending}"
        evis.save(path, some_events())
        before = path.read_bytes()
        with pytest.raises(FileExistsError, match="overwrite=True"):
            evis.save(path, some_events(seed=1))
        assert path.read_bytes() == before
        evis.save(path, some_events(seed=1), overwrite=True)
        assert path.read_bytes() != before


def test_unusable_files_are_refused(tmp_path: Path):
    with pytest.raises(FileNotFoundError):
        evis.load(tmp_path / "missing.h5")
    with pytest.raises(FileNotFoundError):
        evis.load(tmp_path / "missing.npz")
    (tmp_path / "events.raw").write_text("no events")
    with pytest.raises(evis.ConfigError, match=r"\.raw.*content tells no format"):
        evis.load(tmp_path / "events.raw")
    with pytest.raises(evis.ConfigError, match=r"\.xyz"):
        evis.save(tmp_path / "events.xyz", some_events())
    for name in ("text.h5", "text.npz", "text.npy"):
        (tmp_path / name).write_text("no events")
        with pytest.raises(evis.FormatError, match=name):
            evis.load(tmp_path / name)
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(evis.FormatError, match="columns t, x, y and p"):
        evis.load(tmp_path / "other.npz")
    with pytest.raises(OSError, match="folder"):
        evis.save(tmp_path / "no folder" / "out.h5", some_events())
    evis.save(tmp_path / "cut.h5", some_events())
    whole = (tmp_path / "cut.h5").read_bytes()
    (tmp_path / "cut.h5").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(evis.FormatError):
        evis.load(tmp_path / "cut.h5")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_pipes_and_endless_files_are_refused_by_every_reader_in_python(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "set").mkdir()
    os.mkfifo(tmp_path / "set" / "manifest.json")
    readers: list[Callable[[Path], object]] = [
        evis.load,
        evis.Sensor.from_toml,
        measure.Chart.load,
        evaluate.Network,
        blender.read,
        dataset.read_spec,
        lambda _: dataset.load(tmp_path / "set"),
    ]
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        for read in readers:
            with pytest.raises(OSError, match="only regular files are read"):
                read(path)


def test_text_that_is_none_and_files_beyond_the_limit_are_refused(tmp_path: Path):
    path = tmp_path / "a"
    path.write_bytes(b"\xff\xfe = 1")
    for read in (evis.Sensor.from_toml, measure.Chart.load, dataset.read_spec):
        with pytest.raises(evis.FormatError, match="no UTF-8 text"):
            read(path)
    before = evis.limits().memory
    with path.open("wb") as file:
        file.truncate(2**20 + 1)
    try:
        evis.set_limits(memory=2**20)
        for read in (evis.Sensor.from_toml, measure.Chart.load, dataset.read_spec, evaluate.Network):
            with pytest.raises(evis.FormatError, match=r"1048577 bytes.*set_limits"):
                read(path)
    finally:
        evis.set_limits(memory=before)


def mutants(whole: bytes, count: int, seed: int) -> Iterator[bytes]:
    """Yield files with some bytes replaced, doubled or cut out."""
    random = np.random.default_rng(seed)
    for _ in range(count):
        mutant = bytearray(whole)
        for _ in range(int(random.integers(1, 5))):
            at = int(random.integers(len(mutant)))
            match int(random.integers(5)):
                case 0:
                    del mutant[at : at + int(random.integers(1, 16))]
                case 1:
                    mutant[at:at] = mutant[at : at + 8]
                case 2:
                    mutant[at] = ord(random.choice(list("'\"(){}[],:<>|0289")))
                case _:
                    mutant[at] ^= 1 << int(random.integers(8))
        yield bytes(mutant)


@pytest.mark.parametrize("name", ["a.npy", "mapped.npy", "a.npz"])
def test_mutated_numpy_files_raise_what_is_promised_or_hold_events(tmp_path: Path, name: str):
    path = tmp_path / name
    evis.save(path, some_events(40))
    whole = path.read_bytes()
    read = refused = 0
    for mutant in mutants(whole, 800, seed=3):
        path.write_bytes(mutant)
        try:
            events = evis.load(path, mapped=name.startswith("mapped")).events
        except (OSError, evis.FormatError, evis.ConfigError):
            refused += 1
            continue
        read += 1
        assert bool((np.diff(events.t) >= 0).all())
        assert set(events.p.tolist()) <= {0, 1}
        assert events.x.max(initial=0) < events.width
        assert events.y.max(initial=0) < events.height
    assert min(10 * read, refused) > 100, f"{read} read, {refused} refused: nothing was tested"


@pytest.mark.parametrize("mapped", [False, True])
def test_events_that_cannot_be_are_refused(tmp_path: Path, mapped: bool):
    path = tmp_path / "a.npy"
    for field, value, message in (
        ("p", 7, "polarit"),
        ("t", -5, "sorted|earlier"),
        ("t", 2**60, r"4503599627370496"),
    ):
        events = some_events(50).to_numpy().copy()
        events[field][-1] = value
        np.save(path, events)
        with pytest.raises(evis.FormatError, match=message):
            evis.load(path, mapped=mapped)
    np.save(path, some_events(500).to_numpy())
    with pytest.raises(evis.ConfigError, match=r"width is 10; .* works"):
        evis.load(path, width=10, mapped=mapped)


def test_a_report_that_is_no_json_is_a_format_error(tmp_path: Path):
    path = tmp_path / "a.h5"
    evis.save(path, some_events(10))
    for text in (b"{", b"[1]", b"[" * 100_000):
        with h5py.File(path, "r+") as file:
            file["evis/report_json"].resize((len(text),))
            file["evis/report_json"][:] = np.frombuffer(text, np.uint8)
        with pytest.raises(evis.FormatError, match="report"):
            evis.load(path)


def test_a_stream_is_saved_while_it_runs(tmp_path: Path, spinner: evis.Scene):
    def simulator() -> evis.Simulator:
        return evis.Simulator(
            spinner, size=(64, 48), rate_hz=500.0, samples=1, labels=["depth", "flow"], seed=3
        )

    path = tmp_path / "out.h5"
    sim = simulator()
    assert evis.save(path, sim.stream(duration=0.05)) == (path,)
    recording = evis.load(path)
    packets = list(simulator().stream(duration=0.05))
    assert np.array_equal(recording.events.to_numpy(), np.concatenate([packet.events for packet in packets]))
    assert recording.complete
    assert recording.seed == 3
    assert recording.cameras == sim.cameras
    assert 'scene = "spinner"' in recording.config_toml
    assert recording.report is not None
    assert recording.report["events"] == len(recording.events)
    assert recording.labels["depth"].t_us.tolist() == [0, 20_000, 40_000]
    for kind in recording.labels_present:
        images = [image for packet in packets for image in packet.labels[kind].images]
        assert np.array_equal(recording.labels[kind].data, np.stack(images))
    assert recording.labels["flow_forward"].interval_us(-1) == (40_000, 60_000)
    positions = np.concatenate([packet.poses.position for packet in packets])
    assert np.array_equal(recording.poses.position, positions)


def test_a_failed_writer_leaves_no_file(tmp_path: Path, spinner: evis.Scene):
    sim = evis.Simulator(spinner, size=(64, 48), rate_hz=500.0, samples=1)
    with pytest.raises(RuntimeError), evis.Writer(tmp_path / "out.h5", sim):
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []
