"""Files of other programs in Python: open, load, save, Writer, EventsIterator, DSEC, HDF5."""

import json
import os
import re
import struct
import zlib
from dataclasses import replace

import h5py
import numpy as np
import pytest

import evis
from evis import _evis
from evis.imu import ImuSamples
from evis.motion import Placement

#: OpenCV's axes for glTF's, and back.
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])

#: Files that are written and read: jAER's AEDAT is written only, and DSEC's layout is a folder.
FORMATS = [name for name in evis.formats() if name not in ("aedat2", "dsec")]


def some_events(count=5000, width=1280, height=720, latest_us=20_000_000) -> evis.EventArray:
    rng = np.random.default_rng(3)
    t = np.sort(rng.integers(0, latest_us, count))
    x, y, p = rng.integers(0, width, count), rng.integers(0, height, count), rng.integers(0, 2, count)
    order = np.lexsort((x, y, t))
    return evis.EventArray.from_columns(*(c[order] for c in (t, x, y, p)), width=width, height=height)


def run(*args) -> int:
    return _evis.run_cli(["evis", *map(str, args)])


@pytest.mark.parametrize("format", FORMATS)
def test_what_is_saved_is_loaded_and_opened(tmp_path, format):
    events = some_events()
    # The name tells nothing: the content does.
    path = tmp_path / "events.bin"
    assert evis.save(path, events, format=format) == (path,)
    size = {} if format != "npy" else {"width": 1280, "height": 720}
    loaded = evis.load(path, **size)
    assert loaded.events == events
    assert loaded.slice_time(5_000_000, 6_000_000) == events.slice_time(5_000_000, 6_000_000)
    file = evis.open(path)
    assert file.format == format
    assert file.size == (None if format == "npy" else (1280, 720))
    packets = list(file)
    assert np.array_equal(np.concatenate([packet.events for packet in packets]), events.to_numpy())
    assert np.array_equal(
        evis.open(path).events(7_000_000, 8_000_000), events.slice_time(7_000_000, 8_000_000).to_numpy()
    )
    wrong = events.to_numpy().copy()
    wrong["x"][100] ^= 1
    assert not np.array_equal(file.events(0), wrong), "canary: one bit must be seen"
    with pytest.raises(FileExistsError):
        evis.save(path, events, format=format)


def test_formats_come_by_ending_and_errors_say_what_works(tmp_path):
    events = some_events(100)
    for ending, format in [("raw", "evt3"), ("aedat4", "aedat4"), ("mcap", "mcap"), ("txt", "text")]:
        evis.save(tmp_path / f"a.{ending}", events)
        assert evis.open(tmp_path / f"a.{ending}").format == format
    with pytest.raises(evis.ConfigError, match=r"ends with '\.xyz'.*evt3"):
        evis.save(tmp_path / "a.xyz", events)
    with pytest.raises(evis.ConfigError, match="format is 'zz'"):
        evis.save(tmp_path / "a.raw", events, format="zz")
    (tmp_path / "noise.raw").write_bytes(bytes(range(1, 200)))
    with pytest.raises(evis.FormatError, match="no known event format"):
        evis.open(tmp_path / "noise.raw")
    with pytest.raises(OSError, match="No such file"):
        evis.open(tmp_path / "missing.raw")
    cut = tmp_path / "cut.raw"
    cut.write_bytes((tmp_path / "a.raw").read_bytes()[:-1])
    packets = iter(evis.open(cut))
    good = next(packets).events
    with pytest.raises(evis.FormatError, match="at byte"):
        next(packets)
    assert 0 < len(good) < 100
    assert np.array_equal(good, events.to_numpy()[: len(good)])


def test_files_are_closed_by_with(tmp_path):
    events = some_events(100)
    evis.save(tmp_path / "a.raw", events)
    with evis.open(tmp_path / "a.raw") as file:
        assert file.events() == events
    assert repr(file).endswith("1280x720, closed)")
    for use in (file.events, lambda: file.seek(0), lambda: next(iter(file))):
        with pytest.raises(evis.ConfigError, match=r"a\.raw is closed; open it again"):
            use()
    file.close()


def test_packets_of_files_are_event_arrays_of_some_size_in_order(tmp_path):
    events = some_events(300, 640, 480)
    evis.save(tmp_path / "a.npy", events)
    reach = (int(events.x.max()) + 1, int(events.y.max()) + 1)
    file = evis.open(tmp_path / "a.npy")
    assert file.size is None
    (packet,) = file
    assert isinstance(packet.events, evis.EventArray)
    assert packet.events.sensor_size == reach
    assert packet.voxel_grid(bins=2).shape == (2, reach[1], reach[0])
    given = evis.open(tmp_path / "a.npy", size=(700, 500))
    assert given.events(0) == evis.EventArray(events.to_numpy(), width=700, height=500)
    with pytest.raises(evis.FormatError, match="outside of 640x9"):
        evis.open(tmp_path / "a.npy", size=(640, 9)).events()
    # A camera that goes back in time, and comes to the same microsecond twice.
    back = events.to_numpy().copy()
    back["t"][100:103] = back["t"][99] - 5, back["t"][99] - 5, back["t"][99] - 6
    np.save(tmp_path / "back.npy", back)
    want = back[np.argsort(back["t"], kind="stable")]
    assert not np.array_equal(want, back), "canary: there is something to sort"
    for got in [
        next(iter(evis.open(tmp_path / "back.npy"))).events,
        evis.open(tmp_path / "back.npy").events(),
    ]:
        assert np.array_equal(got, want)
    raw = list(evis.files.EventsIterator(tmp_path / "back.npy", mode="n_events", n_events=300))
    assert np.array_equal(raw[0], back), "Metavision's signature keeps the order of the file"


def test_triggers_frames_and_imu_come_with_the_packets(tmp_path):
    events = some_events(1000, latest_us=1000)
    triggers = np.zeros(3, evis.files.EventExtTrigger)
    triggers["t"], triggers["id"], triggers["p"] = (1, 500, 999), (0, 3, 0), (1, 0, 1)
    with evis.files.EventFileWriter(tmp_path / "a.raw", size=(1280, 720)) as writer:
        writer.write(events, triggers)
    packet = next(iter(evis.open(tmp_path / "a.raw")))
    assert np.array_equal(packet.triggers, triggers)
    assert packet.frames == ()
    assert packet.imu.dtype == evis.files.ImuDtype
    path = tmp_path / "b.raw"
    with (
        pytest.raises(evis.FormatError, match="earlier"),
        evis.files.EventFileWriter(path, size=(1280, 720)) as w,
    ):
        w.write(events.to_numpy()[::-1])
    assert not path.exists()
    assert not list(tmp_path.glob(".b*"))


def test_slices_of_the_iterator_are_half_open_and_tile_time(tmp_path):
    events = some_events(3000, latest_us=1_000_000)
    path = tmp_path / "a.raw"
    evis.save(path, events)
    t = events.t
    iterator = evis.files.EventsIterator(path, delta_t=7000)
    assert iterator.get_size() == (720, 1280)
    slices = list(iterator)
    assert len(slices) == int(t[-1]) // 7000 + 1
    for k, part in enumerate(slices):
        assert np.array_equal(part, events.slice_time(k * 7000, (k + 1) * 7000).to_numpy())
    # A second pass is the same.
    assert sum(len(part) for part in iterator) == 3000
    # Empty slices are yielded too.
    sparse = list(evis.files.EventsIterator(path, delta_t=20))
    assert any(len(part) == 0 for part in sparse)
    assert sum(map(len, sparse)) == 3000

    part = list(evis.files.EventsIterator(path, 100_000, "delta_t", 10_000, max_duration=95_000))
    assert len(part) == 10
    want = events.slice_time(100_000, 195_000)
    assert np.array_equal(np.concatenate(part), want.to_numpy())
    relative = evis.files.EventsIterator(
        path, 100_000, delta_t=10_000, max_duration=95_000, relative_timestamps=True
    )
    assert np.array_equal(np.concatenate(list(relative))["t"], want.t - 100_000)

    counts = [len(part) for part in evis.files.EventsIterator(path, mode="n_events", n_events=700)]
    assert counts == [700, 700, 700, 700, 200]
    mixed = list(evis.files.EventsIterator(path, mode="mixed", n_events=50, delta_t=20_000))
    assert np.array_equal(np.concatenate(mixed), events.to_numpy())
    assert max(map(len, mixed)) == 50
    assert any(0 < len(part) < 50 for part in mixed)
    for wrong in [{"mode": "all"}, {"delta_t": 0}, {"n_events": -1}, {"max_duration": 0}]:
        with pytest.raises(evis.ConfigError, match=next(iter(wrong))):
            evis.files.EventsIterator(path, **wrong)


def test_a_stream_is_written_to_other_formats_as_it_comes(tmp_path):
    scene = evis.Scene.builtin("spinner")
    evis.save(tmp_path / "a.h5", evis.Simulator(scene, size=(64, 48), seed=3).stream(duration=0.05))
    sim = evis.Simulator(scene, size=(64, 48), seed=3)
    with evis.Writer(tmp_path / "a.raw", sim) as writer, sim.stream(duration=0.05) as stream:
        for packet in stream:
            writer.write(packet)
    want = evis.load(tmp_path / "a.h5").events
    assert len(want)
    assert evis.load(tmp_path / "a.raw").events == want
    labelled = evis.Simulator(evis.Scene.builtin("spinner"), size=(64, 48), labels=("depth",))
    with pytest.raises(evis.ConfigError, match="depth"):
        evis.Writer(tmp_path / "b.raw", labelled)


def test_the_command_converts_and_describes(tmp_path, capfd):
    events = some_events()
    evis.save(tmp_path / "a.npy", events)
    assert run("convert", tmp_path / "a.npy", tmp_path / "a.raw", "--size", "1280x720") == 0
    assert evis.load(tmp_path / "a.raw").events == events
    arguments = ("--start", "2", "--end", "10", "--crop", "100,50,640,480", "--flip", "y", "--rebase")
    assert run("convert", tmp_path / "a.raw", tmp_path / "b.aedat4", *arguments) == 0
    part = events.slice_time(2_000_000, 10_000_000).to_numpy()
    part = part[(part["x"] >= 100) & (part["x"] < 740) & (part["y"] >= 50) & (part["y"] < 530)]
    got = evis.load(tmp_path / "b.aedat4")
    assert (got.cameras[0].width, got.cameras[0].height) == (640, 480)
    assert np.array_equal(got.events.t, part["t"] - 2_000_000)
    assert np.array_equal(got.events.x, part["x"] - 100)
    assert np.array_equal(got.events.y, 479 - (part["y"] - 50))
    capfd.readouterr()
    assert run("info", tmp_path / "a.raw") == 0
    told = capfd.readouterr().out
    assert "EVT 3.0" in told
    assert "1280x720" in told
    for arguments, said in [
        (("a.raw", "a.raw"), "the output is the input"),
        (("a.raw", "c.xyz"), "tells no format"),
        (("a.raw", "b.aedat4"), "exists already"),
        (("a.raw", "c.dat", "--crop", "1000,0,640,480"), "does not lie within 1280x720"),
    ]:
        names = [tmp_path / name if "." in name else name for name in arguments[:2]]
        assert run("convert", *names, *arguments[2:]) == 2
        assert said in capfd.readouterr().err


def test_convert_takes_the_distortion_out(tmp_path, capfd):
    events = some_events(width=640, height=480)
    evis.save(tmp_path / "bent.raw", events)
    distortion = evis.lens.RadialTangential(k1=-0.28, k2=0.06, p1=0.001, p2=-0.002)
    camera = evis.rig.RigCamera(
        name="cam0", width=640, height=480, fx=400.0, fy=410.0, cx=330.0, cy=236.5, distortion=distortion
    )
    evis.rig.Rig((camera,)).save(tmp_path / "lens.yaml")
    given = ("--undistort", "--calibration", tmp_path / "lens.yaml")
    assert run("convert", tmp_path / "bent.raw", tmp_path / "flat.raw", *given) == 0
    # The inverse of OpenCV's model by fixed-point iteration, as OpenCV itself has it.
    bent = np.stack([(events.x + 0.5 - 330.0) / 400.0, (events.y + 0.5 - 236.5) / 410.0])
    x, y = bent
    for _ in range(200):
        u = x * x + y * y
        factor = 1 - 0.28 * u + 0.06 * u * u
        aside = 2 * 0.001 * x * y - 0.002 * (u + 2 * x * x), 0.001 * (u + 2 * y * y) - 2 * 0.002 * x * y
        x, y = (bent[0] - aside[0]) / factor, (bent[1] - aside[1]) / factor
    place = np.stack([400.0 * x + 330.0, 410.0 * y + 236.5])
    inside = (place >= 0).all(0) & (place[0] < 640) & (place[1] < 480)
    assert 0.5 < inside.mean() < 0.95
    flat = evis.load(tmp_path / "flat.raw").events
    want = events.to_numpy()[inside]
    assert np.array_equal(flat.t, want["t"])
    assert np.array_equal(flat.p, want["p"])
    assert np.array_equal(np.stack([flat.x, flat.y]), np.floor(place[:, inside]).astype(int))
    assert not np.array_equal(flat.x, want["x"]), "canary: pixels move"
    capfd.readouterr()
    two = evis.rig.Rig.stereo(0.1, evis.EventCamera(name="a", width=640, height=480, fx=400.0))
    two.save(tmp_path / "two.yaml")
    evis.save(tmp_path / "wide.raw", some_events(10))
    for file, arguments, said in [
        ("bent.raw", ("--undistort",), "does not say which lens"),
        ("bent.raw", ("--undistort", "--calibration", tmp_path / "two.yaml"), "has cameras cam0, cam1"),
        ("bent.raw", (*given, "--calibration-camera", "cam7"), "cam7 is not in"),
        ("wide.raw", given, "has 640x480 pixels, and the events 1280x720"),
    ]:
        assert run("convert", tmp_path / file, tmp_path / "no.raw", *arguments) == 2
        assert said in capfd.readouterr().err


def test_hdf5_of_others_is_read(tmp_path):
    events = some_events(3000, 640, 480, 2_000_000)
    t, x, y, p = events.columns

    def columns(group, names="txyp", times=t):
        for name, column in zip(names, (times, x, y, p), strict=True):
            group.create_dataset(name, data=column, chunks=(512,), compression="gzip", shuffle=True)

    # libver earliest: superblock 0, and B-trees of version 1.
    with h5py.File(tmp_path / "dsec.h5", "w", libver=("earliest", "v108")) as file:
        columns(file.create_group("events"), times=t.astype(np.uint32))
        file["t_offset"] = 77
        file["events/height"], file["events/width"] = 480, 640
    with h5py.File(tmp_path / "v2e.h5", "w", libver=("earliest", "v108")) as file:
        rows = np.stack([t, x, y, p], 1).astype(np.uint32)
        file.create_dataset("events", data=rows, chunks=(512, 4), compression="gzip")
    with h5py.File(tmp_path / "m3ed.h5", "w") as file:
        columns(file.create_group("prophesee/left"))
    with h5py.File(tmp_path / "utils.h5", "w") as file:
        columns(file.create_group("events"), ("ts", "xs", "ys", "ps"), times=t / 1e6)
    for name in ("dsec", "v2e", "m3ed", "utils"):
        file = evis.open(tmp_path / f"{name}.h5")
        assert np.array_equal(file.events(), events.to_numpy()), name
        assert np.array_equal(
            file.events(500_000, 600_000), events.slice_time(500_000, 600_000).to_numpy()
        ), name
        assert np.array_equal(evis.load(tmp_path / f"{name}.h5").events.to_numpy(), events.to_numpy()), name
    assert evis.open(tmp_path / "dsec.h5").t_offset_us == 77
    assert evis.open(tmp_path / "dsec.h5").size == (640, 480)
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["pictures"] = np.zeros(3)
    with pytest.raises(evis.FormatError, match="layouts"):
        evis.open(tmp_path / "other.h5")


@pytest.mark.skipif(not os.environ.get("EVIS_READERS"), reason="run by make test-readers")
def test_hdf5_with_plugins_is_read(tmp_path):
    import hdf5plugin

    events = some_events(3000, 640, 480, 2_000_000)
    for name, filters in {
        "blosc-zstd": hdf5plugin.Blosc(cname="zstd", clevel=1, shuffle=hdf5plugin.Blosc.SHUFFLE),
        "blosc-lz4": hdf5plugin.Blosc(cname="lz4"),
        "zstd": hdf5plugin.Zstd(),
        "lz4": hdf5plugin.LZ4(),
    }.items():
        path = tmp_path / f"{name}.h5"
        with h5py.File(path, "w", libver=("earliest", "v108")) as file:
            for column, values in zip("txyp", events.columns, strict=True):
                file.create_dataset(f"events/{column}", data=values, chunks=(1000,), **filters)
        assert np.array_equal(evis.open(path).events(), events.to_numpy()), name


def png16(path):
    """Decode a 16-bit PNG without filters of an encoder's choice being assumed: all five are undone."""
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at, packed = 8, b""
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        body = data[at + 8 : at + 8 + length]
        if kind == b"IHDR":
            width, height, depth, color = struct.unpack(">IIBB", body[:10])
        if kind == b"IDAT":
            packed += body
        at += 12 + length
    assert depth == 16
    channels = {0: 1, 2: 3}[color]
    step = 2 * channels
    raw, out = zlib.decompress(packed), np.zeros((height, width * step), np.uint8)
    for row in range(height):
        line = raw[row * (width * step + 1) : (row + 1) * (width * step + 1)]
        above = out[row - 1].tolist() if row else [0] * (width * step)
        now = list(line[1:])
        for k in range(len(now)):
            left = now[k - step] if k >= step else 0
            corner = above[k - step] if k >= step else 0
            guess = left + above[k] - corner
            near = min((abs(guess - v), i, v) for i, v in enumerate((left, above[k], corner)))[2]
            now[k] = (now[k] + (0, left, above[k], (left + above[k]) // 2, near)[line[0]]) & 255
        out[row] = now
    return out.reshape(height, width, channels, 2).astype(np.uint16) @ np.array([256, 1], np.uint16)


def test_a_recording_becomes_a_folder_of_dsec(tmp_path):
    sim = evis.Simulator(
        evis.Scene.builtin("spinner"), size=(96, 72), labels=("depth", "flow"), label_rate_hz=20, seed=1
    )
    evis.save(tmp_path / "a.h5", sim.stream(duration=0.2))
    folder = tmp_path / "sequence"
    assert run("convert", tmp_path / "a.h5", folder, "--format", "dsec") == 0
    recording = evis.load(tmp_path / "a.h5")
    want = recording.events
    # The rules of DSEC's EventSlicer.
    with h5py.File(folder / "events/left/events.h5") as file:
        t, ms_to_idx, offset = file["events/t"][:], file["ms_to_idx"][:], int(file["t_offset"][()])
        assert t.dtype == np.uint32
        assert offset == 0
        assert ms_to_idx[0] == 0
        for ms in range(1, len(ms_to_idx)):
            index = int(ms_to_idx[ms])
            assert index == len(t) or t[index] >= 1000 * ms
            assert t[index - 1] < 1000 * ms or index == 0
        assert np.array_equal(t, want.t)
        for name, dtype in (("x", np.uint16), ("y", np.uint16), ("p", np.uint8)):
            assert file["events"][name].dtype == dtype
            assert np.array_equal(file["events"][name][:], getattr(want, name))
    with h5py.File(folder / "events/left/rectify_map.h5") as file:
        rectify = file["rectify_map"][()]
    assert rectify.shape == (72, 96, 2)
    assert rectify.dtype == np.float32
    assert np.array_equal(rectify[want.y, want.x], np.stack([want.x, want.y], 1).astype(np.float32))
    # Flow: (value - 2^15) / 128, and a validity.
    times = np.loadtxt(folder / "flow/forward_timestamps.txt", delimiter=",", dtype=np.int64)
    flow, valid = recording.labels["flow_forward"], recording.labels["flow_forward_valid"]
    names = sorted((folder / "flow/forward").iterdir())
    assert len(names) == len(times) >= 2
    for k, name in enumerate(names):
        index = flow.t_us.tolist().index(times[k, 0])
        assert flow.interval_us(index) == tuple(times[k])
        image = png16(name)
        mask = image[..., 2] == 1
        assert np.array_equal(mask, valid[index] == 1)
        assert mask.any()
        decoded = (image[..., :2].astype(np.float64) - 2**15) / 128
        assert np.abs(decoded - flow[index])[mask].max() <= 0.5 / 128 + 1e-6
    assert "  camRect0:\n" in (folder / "calibration/cam_to_cam.yaml").read_text()
    assert not (folder / "disparity").exists()
    # And EVIS reads it.
    file = evis.open(folder)
    assert (file.format, file.cameras, file.size) == ("dsec", ("left",), (96, 72))
    assert np.array_equal(file.events(), want.to_numpy())
    assert run("convert", folder, tmp_path / "a.raw") == 0
    assert evis.load(tmp_path / "a.raw").events == want
    assert run("convert", tmp_path / "a.h5", folder, "--format", "dsec") == 2


def yaml_rows(text, key):
    """Rows of numbers that follow ``key:``."""
    lines = text[text.index(f"{key}:\n") :].splitlines()[1:]
    rows = []
    for line in lines:
        if not line.strip().startswith("- ["):
            break
        rows.append(json.loads(line.strip()[2:]))
    return np.array(rows)


def yaml_matrix(text, camera):
    found = re.search(rf"  {camera}:\n(?:    .*\n)*?    camera_matrix: (.*)\n", text)
    return np.array(json.loads(found[1]))


def test_a_distorted_converging_pair_becomes_a_rectified_one(tmp_path):
    """End to end: maps, calibration, disparity and flow, by the poses and labels that were rendered."""
    bent = evis.lens.RadialTangential(k1=-0.3, k2=0.08, p1=1e-3, p2=-5e-4)
    wide = evis.lens.Fisheye(k1=0.02, k2=-0.01)
    builder = evis.SceneBuilder("pair", ambient=(1.0, 1.0, 1.0))
    builder.material("white")
    builder.material("black", color=(0.02, 0.02, 0.02))
    builder.card("wall", size=(8, 8), material="black", pose=Placement(position=(0, 0, -2)))
    moves = evis.motion.ConstantVelocity(velocity=(0.25, 0.1, 0.0))
    ball = Placement(position=(-0.05, -0.02, 0.0))
    builder.sphere("ball", radius=0.15, material="white", pose=replace(ball, motion=moves))
    builder.node("head", pose=Placement(position=(0, 0, 1.6)))
    lens = {"width": 120, "height": 90, "fx": 90.0, "fy": 91.0, "near": 0.1}
    turn = Placement(position=(0.2, 0.012, -0.01), rotation_degrees=(2, 8, -3), parent="head")
    cameras = [
        evis.EventCamera(
            name="left", cx=61.0, cy=44.0, distortion=bent, pose=Placement(parent="head"), **lens
        ),
        evis.EventCamera(name="right", cx=58.5, cy=46.5, distortion=wide, pose=turn, **lens),
    ]
    for camera in cameras:
        builder.camera(camera)
    sim = evis.Simulator(
        builder.build(), method="native", rate_hz=500, labels=("depth", "flow"), label_rate_hz=20, seed=1
    )
    evis.save(tmp_path / "a.h5", sim.stream(duration=0.11))
    recording = evis.load(tmp_path / "a.h5")
    folder = tmp_path / "sequence"
    assert run("convert", tmp_path / "a.h5", folder, "--format", "dsec") == 0
    text = (folder / "calibration/cam_to_cam.yaml").read_text()
    f, f_y, c_x, c_y = yaml_matrix(text, "camRect0")
    assert f == f_y
    assert np.array_equal(yaml_matrix(text, "camRect3"), yaml_matrix(text, "camRect0"))
    assert yaml_matrix(text, "cam3").tolist() == [90.0, 91.0, 58.0, 46.0]
    Q = yaml_rows(text, "cams_03")  # noqa: N806 - its name
    assert Q[:3].tolist() == [[1, 0, 0, -c_x], [0, 1, 0, -c_y], [0, 0, 0, f]]
    baseline = 1 / Q[3, 2]
    assert baseline == pytest.approx(np.linalg.norm([0.2, 0.012, 0.01]))
    # The same as the rig's in Python, in the files' convention.
    T = yaml_rows(text, "T_21")  # noqa: N806 - its name
    rig = evis.rig.Rig.load(folder / "calibration/cam_to_cam.yaml")
    pair = rig.rectify("cam0", "cam3")
    np.testing.assert_allclose(rig.transform("cam3", "cam0"), FLIP @ T @ FLIP, atol=1e-12)
    R = {"left": yaml_rows(text, "R_rect0"), "right": yaml_rows(text, "R_rect3")}  # noqa: N806 - its name
    np.testing.assert_allclose(pair.opencv()[0], R["left"], atol=1e-12)
    np.testing.assert_allclose(pair.opencv()[1], R["right"], atol=1e-12)
    maps = {}
    for eye, name in (("left", "cam0"), ("right", "cam3")):
        with h5py.File(folder / f"events/{eye}/rectify_map.h5") as file:
            maps[eye] = file["rectify_map"][()]
        assert maps[eye].dtype == np.float32
        np.testing.assert_allclose(maps[eye], pair.map(name) - 0.5, atol=1e-4)
    # A point that the left camera shows: where both rectified pictures have it, by what was stored.
    view, other = recording["left"], recording["right"]
    depths = view.labels["depth"]
    to_right = np.linalg.inv(other.poses.matrix) @ view.poses.matrix
    y, x = np.mgrid[:90, :120]
    pixels = np.column_stack([x.ravel(), y.ravel()]) + 0.5
    rays = view.camera.lens.unproject(pixels)
    points = rays / -rays[:, 2:] * depths[0].reshape(-1, 1)
    right = points @ to_right[0, :3, :3].T + to_right[0, :3, 3]
    seen = other.camera.lens.project(right)
    inside = (seen > 0).all(1) & (seen < [120, 90]).all(1)
    assert inside.sum() > 5000
    there = pair.pixels("cam3", seen[inside]) - 0.5
    here = maps["left"].reshape(-1, 2)[inside]
    along = (points[inside] @ (FLIP[:3, :3] @ R["left"].T @ FLIP[:3, :3]))[:, 2]
    shift = here[:, 0] - there[:, 0]
    assert np.abs(here[:, 1] - there[:, 1]).max() < 0.01
    assert np.abs(shift - f * baseline / -along).max() < 0.01
    raw = np.abs(pixels[inside, 1] - seen[inside, 1])
    assert raw.max() > 5, "canary: rows of the distorted pictures differ"
    # And what the images of disparity say: each pixel has it of the nearest one of the sensor's.
    names = sorted((folder / "disparity/event").iterdir())
    assert len(names) == len(depths)
    image = png16(names[0])[..., 0] / 256
    assert (image > 0).mean() > 0.95
    disparity = np.full(90 * 120, np.nan)
    disparity[inside] = shift
    source = pair.sources("cam0", pixels)
    nearest = np.floor(source).astype(int)
    known = ((nearest >= 0) & (nearest < [120, 90])).all(1)
    wanted = np.full(90 * 120, np.nan)
    wanted[known] = disparity[nearest[known, 1] * 120 + nearest[known, 0]]
    both = np.isfinite(wanted) & (image.ravel() > 0)
    assert both.sum() > 4000
    assert np.abs(image.ravel() - wanted)[both].max() < 0.5 / 256 + 0.01
    assert np.ptp(wanted[both]) > 3, "the ball is nearer than the wall"
    # Q makes points of it, in the rectified axes.
    row, column = 45, 60
    made = Q @ [column, row, image[row, column], 1]
    assert made[2] / made[3] == pytest.approx(f * baseline / image[row, column])
    # Flow, of the same pixels: the ball moves, and its middle as pinhole geometry says.
    flow = png16(folder / "flow/forward/000000.png")
    mask = (flow[..., 2] == 1).ravel()
    decoded = ((flow[..., :2].astype(np.float64) - 2**15) / 128).reshape(-1, 2)
    rendered = view.labels["flow_forward"][0].reshape(-1, 2)
    begin = pixels[nearest[known, 1] * 120 + nearest[known, 0]]
    ends = begin + rendered[nearest[known, 1] * 120 + nearest[known, 0]]
    moved = np.full((90 * 120, 2), np.nan)
    moved[known] = pair.pixels("cam0", ends) - pair.pixels("cam0", begin)
    both = mask & np.isfinite(moved).all(1)
    assert both.sum() > 9000
    assert np.abs(decoded - moved)[both].max() < 0.5 / 128 + 1e-4
    assert np.linalg.norm(moved[both], axis=1).max() > 0.5
    # Events of the ball: the middle of its edges lies in one row, shifted by its disparity.
    first, last = (recording[name].events for name in ("left", "right"))
    assert len(first) > 500
    a, b = pair.events("cam0", first), pair.events("cam3", last)
    assert a.shape == (len(first), 2)
    middles = np.array([(each.min(0) + each.max(0)) / 2 for each in (a, b)])
    assert abs(middles[0, 1] - middles[1, 1]) < 1.0
    middle = np.array([-0.05 + 0.25 * 0.055, -0.02 + 0.1 * 0.055, -1.6]) @ FLIP[:3, :3] @ R["left"].T
    assert middles[0, 0] - middles[1, 0] == pytest.approx(f * baseline / middle[2], abs=1.0)
    unmoved = [(each.y.min() + each.y.max()) / 2 for each in (first, last)]
    assert abs(unmoved[0] - unmoved[1]) > 3, "canary"


def test_what_dsec_cannot_rectify_is_said(tmp_path, capfd):
    """Two cameras above each other: each without its own distortion, and no disparity."""
    bent = evis.lens.RadialTangential(k1=-0.3, k2=0.08)
    like = {"width": 64, "height": 48, "fx": 50.0, "distortion": bent}
    up = evis.motion.Placement(position=(0, 0.2, 2))
    cameras = [
        evis.EventCamera(name="left", pose=evis.motion.Placement(position=(0, 0, 2)), **like),
        evis.EventCamera(name="right", pose=up, **like),
    ]
    sim = evis.Simulator(
        evis.Scene.builtin("spinner"), cameras=cameras, method="native", rate_hz=500, labels=("depth",)
    )
    evis.save(tmp_path / "a.h5", sim.stream(duration=0.02))
    assert run("convert", tmp_path / "a.h5", tmp_path / "s", "--format", "dsec") == 0
    told = capfd.readouterr().out
    assert "side by side" in told
    assert "no disparity" in told
    text = (tmp_path / "s/calibration/cam_to_cam.yaml").read_text()
    assert "disparity_to_depth" not in text
    assert np.array_equal(yaml_rows(text, "R_rect3"), np.eye(3))
    alone = evis.rig.Rig.stereo(0.1, evis.EventCamera(name="c", **like)).rectify()
    with h5py.File(tmp_path / "s/events/right/rectify_map.h5") as file:
        np.testing.assert_allclose(file["rectify_map"][()], alone.map("left") - 0.5, atol=1e-4)


def recording_with_everything(path):
    """Record two cameras with images of all types, poses and an inertial unit."""
    right = evis.EventCamera(
        name="right eye", pose=evis.motion.Placement(parent="camera", position=(0.1, 0, 0))
    )
    sim = evis.Simulator(
        evis.Scene.builtin("spinner"),
        cameras=["camera", right],
        size=(48, 36),
        labels=("depth", "flow", "instance", "normal", "hdr"),
        label_rate_hz=50,
        seed=1,
    )
    t_us = np.arange(0, 100_000, 5000)
    values = np.arange(t_us.size * 3, dtype=np.float64).reshape(-1, 3)
    with evis.Writer(path, sim, imus=["body"], duration_us=100_000) as writer:
        for packet in sim.stream(duration=0.1):
            writer.write(packet)
        writer.write_imu("body", ImuSamples(t_us, values, values + 0.5))
    return evis.load(path), t_us, values


def test_a_recording_becomes_a_bag_with_all_that_it_has(tmp_path, capfd):
    recording, t_us, values = recording_with_everything(tmp_path / "a.h5")
    bag = tmp_path / "a.mcap"
    assert run("convert", tmp_path / "a.h5", bag) == 0
    assert ", 80 images, 10 poses, 20 inertial samples" in capfd.readouterr().out
    topics = {"camera": "/camera/events", "right eye": "/right_eye/events"}
    for name, topic in topics.items():
        assert len(recording[name].events) > 100
        assert evis.load(bag, camera=topic).events == recording[name].events
    # A part of it holds the events alone, and says so.
    capfd.readouterr()
    part = ("convert", tmp_path / "a.h5", tmp_path / "b.mcap", "--camera", "camera", "--end", "0.05")
    assert run(*part) == 0
    told = capfd.readouterr().out.splitlines()[1]
    assert told == (
        "left out: the lens, 5 images of depth, 5 images of flow_forward, 5 images of flow_forward_valid, "
        "5 images of flow_backward, 5 images of flow_backward_valid, 5 images of instance, "
        "5 images of normal, 5 images of hdr, 5 poses, 20 inertial samples, 4 bodies, the settings"
    )
    assert run(*part, "--force", "--json") == 0
    assert json.loads(capfd.readouterr().out)["left_out"] == told.removeprefix("left out: ").split(", ")
    assert run(*part, "--force", "--events-only") == 0
    assert "left out" not in capfd.readouterr().out
    assert evis.load(tmp_path / "b.mcap").events == recording["camera"].slice_time(0, 50_000)
    assert run("convert", tmp_path / "a.h5", bag) == 2
    # And back.
    capfd.readouterr()
    assert run("convert", bag, tmp_path / "back.h5") == 0
    told = capfd.readouterr().out
    assert ", 80 images, 10 poses, 20 inertial samples" in told
    assert "left out" not in told
    back = evis.load(tmp_path / "back.h5")
    assert list(back) == ["camera", "right_eye"]
    for name, own in {"camera": "camera", "right eye": "right_eye"}.items():
        was, now = recording[name], back[own]
        assert now.events == was.events
        assert list(now.labels) == list(was.labels)
        for kind, images in was.labels.items():
            assert now.labels[kind].t_us.tolist() == images.t_us.tolist()
            assert all(np.array_equal(now.labels[kind][k], images[k]) for k in range(len(images)))
        assert now.poses.t_us.tolist() == was.poses.t_us.tolist()
        assert np.abs(now.poses.matrix - was.poses.matrix).max() < 1e-14
        assert now.camera.cx == was.camera.cx
    assert np.array_equal(back.imus["body"].accelerometer, recording.imus["body"].accelerometer)

    pytest.importorskip("rosbags", reason="run by make test-readers")
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    view, store = recording["camera"], get_typestore(Stores.ROS2_HUMBLE)
    found = {}
    with AnyReader([bag], default_typestore=store) as reader:
        for connection, stamp_ns, raw in reader.messages():
            if connection.msgtype != "event_camera_msgs/msg/EventPacket":
                message = store.deserialize_cdr(raw, connection.msgtype)
                stamp = message.header.stamp
                assert stamp.sec * 10**9 + stamp.nanosec == stamp_ns
                found.setdefault(connection.topic, []).append((stamp_ns // 1000, message))
    assert set(found) == {f"/{name}/{kind}" for name in ("camera", "right_eye") for kind in view.labels} | {
        "/camera/camera_info", "/camera/pose", "/right_eye/camera_info", "/right_eye/pose", "/body/imu"
    }  # fmt: skip
    encodings = {"depth": "32FC1", "flow_forward": "32FC2", "flow_forward_valid": "8UC1", "instance": "32SC1"}
    for kind, images in view.labels.items():
        messages = found[f"/camera/{kind}"]
        assert [t for t, _ in messages] == images.t_us.tolist()
        for k, (_, message) in enumerate(messages):
            assert (message.width, message.height, message.is_bigendian) == (48, 36, 0)
            assert message.encoding == encodings.get(kind, message.encoding)
            image = np.frombuffer(message.data.tobytes(), images[k].dtype).reshape(images[k].shape)
            # The world has z up.
            want = images[k][..., [0, 2, 1]] * np.float32([1, -1, 1]) if kind == "normal" else images[k]
            assert np.array_equal(image, want)
            assert message.step == image.nbytes // 36
    lens = view.camera
    info = found["/camera/camera_info"][0][1]
    assert np.array_equal(info.k, [lens.fx, 0, lens.cx - 0.5, 0, lens.fy, lens.cy - 0.5, 0, 0, 1])
    assert (info.distortion_model, info.d.tolist(), info.width) == ("plumb_bob", [0.0] * 5, 48)
    # A point ahead of the camera lies where EVIS has it, in a world whose z is EVIS's y.
    z_up = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    for (t, message), want_t, matrix in zip(
        found["/camera/pose"], view.poses.t_us, view.poses.matrix, strict=True
    ):
        assert t == want_t
        p, q = message.pose.position, message.pose.orientation
        u = np.array([q.x, q.y, q.z])
        point = np.array([0.3, 0.2, 2.0])
        turned = point + 2 * np.cross(u, np.cross(u, point) + q.w * point)
        want = z_up @ (matrix[:3, :3] @ (point * [1, -1, -1]) + matrix[:3, 3])
        assert np.abs(np.add([p.x, p.y, p.z], turned) - want).max() < 1e-12
        assert np.abs(np.add([p.x, p.y, p.z], point) - want).max() > 1e-3, "the comparison can fail"
    samples = found["/body/imu"]
    assert [t for t, _ in samples] == t_us.tolist()
    for (_, message), value in zip(samples, values, strict=True):
        own = message.linear_acceleration
        assert [own.x, own.y, own.z] == value.tolist()
        assert message.angular_velocity.z == value[2] + 0.5
        assert message.orientation_covariance[0] == -1


def test_the_good_part_of_a_damaged_file_is_kept_on_request(tmp_path, capfd):
    events = some_events()
    evis.save(tmp_path / "a.raw", events)
    data = (tmp_path / "a.raw").read_bytes()
    (tmp_path / "a.raw").write_bytes(data[: len(data) // 4 * 2 + 1])
    assert run("convert", tmp_path / "a.raw", tmp_path / "b.npz") == 2
    assert not (tmp_path / "b.npz").exists()
    capfd.readouterr()
    assert run("convert", tmp_path / "a.raw", tmp_path / "b.npz", "--until-damage") == 0
    assert "at byte" in capfd.readouterr().err
    kept = evis.load(tmp_path / "b.npz").events
    assert 1000 < len(kept) < len(events)
    assert kept == events[: len(kept)]


def test_a_folder_of_dsec_holds_the_events_of_any_file(tmp_path):
    events = some_events()
    evis.save(tmp_path / "a.raw", events)
    assert run("convert", tmp_path / "a.raw", tmp_path / "sequence", "--format", "dsec") == 0
    assert evis.load(tmp_path / "sequence").events == events
    with h5py.File(tmp_path / "sequence/events/left/events.h5") as file:
        assert np.array_equal(file["events/t"][:], events.t)
    assert run("convert", tmp_path / "a.raw", tmp_path / "sequence", "--format", "dsec") == 2
