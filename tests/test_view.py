"""What is written for Rerun's viewer is read back with its own reader, and is what the recording holds."""

from __future__ import annotations

import os
import re
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_readme import blocks, run_code

import evis
from evis import _commands
from evis import rerun as evis_rerun
from evis._pictures import flow_of, full_speed, reference_of, tone_mapped

rerun = pytest.importorskip("rerun")
chunk = pytest.importorskip("rerun.chunk", reason="an older rerun-sdk, whose reader is another")

SIZE = (64, 48)
IMAGE = "/world/cameras/camera/image"
Rows = dict[str, dict[str, list[tuple[int | None, Any]]]]


def read(path: Path) -> Rows:
    """Every value by entity and component, with its time in microseconds, None for what always holds."""
    found: Rows = defaultdict(lambda: defaultdict(list))
    for part in chunk.RrdReader(str(path)).stream():
        batch = part.to_record_batch()
        assert part.is_static or part.timeline_names == ["time"], "one timeline"
        times = [None] * batch.num_rows
        if not part.is_static:
            times = batch.column("time").cast("int64").to_numpy() // 1000
        for name in set(batch.schema.names) - {"time", "rerun.controls.RowId"}:
            column = batch.column(name).to_pylist()
            found[str(part.entity_path)][name] += [
                (None if t is None else int(t), v[0]) for t, v in zip(times, column, strict=True)
            ]
    return found


def images(rows: Rows, entity: str, dtype: Any = np.uint8) -> dict[int, np.ndarray]:
    """Images by their time."""
    (buffers,) = (values for name, values in rows[entity].items() if name.endswith("Image:buffer"))
    (formats,) = (values for name, values in rows[entity].items() if name.endswith("Image:format"))
    made = {}
    for (t_us, buffer), (_, format) in zip(buffers, formats, strict=True):
        pixels = np.array(buffer, np.uint8).view(dtype)
        made[t_us] = pixels.reshape(format["height"], format["width"], -1).squeeze()
    return made


def last_codes(events: evis.EventArray) -> np.ndarray:
    codes = np.zeros((events.height, events.width), np.uint8)
    for x, y, p in zip(events.x.tolist(), events.y.tolist(), events.p.tolist(), strict=True):
        codes[y, x] = 2 if p else 1
    return codes


def view_names(path: Path) -> set[str]:
    """What the viewer's layout shows, by title."""
    reader = chunk.RrdReader(str(path))
    (layout,) = reader.blueprints()
    batches = [part.to_record_batch() for part in reader.stream(store=layout)]
    name = "ViewBlueprint:display_name"
    return {b.column(name).to_pylist()[0][0] for b in batches if name in b.schema.names}


def scattered(count: int = 4000, first_us: int = 0) -> evis.EventArray:
    rng = np.random.default_rng(3)
    t = first_us + np.sort(rng.integers(0, 55_000, count))
    places = (rng.integers(0, side, count) for side in SIZE)
    return evis.EventArray.from_columns(t, *places, rng.random(count) < 0.7, width=SIZE[0], height=SIZE[1])


@pytest.fixture(scope="module")
def recording(device: evis.Device, tmp_path_factory: pytest.TempPathFactory) -> evis.Recording:
    path = tmp_path_factory.mktemp("view") / "spinner.h5"
    sim = evis.Simulator(
        evis.Scene.builtin("spinner"),
        size=SIZE,
        quality="draft",
        labels=["depth", "flow", "hdr", "instance", "semantic"],
        label_rate_hz=100,
        frame_rate_hz=100,
        exposure_us=2000,
    )
    evis.save(path, sim.stream(duration=0.05))
    return evis.load(path)


@pytest.fixture(scope="module")
def rows(recording: evis.Recording, tmp_path_factory: pytest.TempPathFactory) -> Rows:
    path = tmp_path_factory.mktemp("view") / "spinner.rrd"
    counts = evis_rerun.view(recording, save=path)
    found = read(path)
    for entity, count in counts.items():
        timed = {len([t for t, _ in values if t is not None]) for values in found[entity].values()} - {0}
        assert timed == {count}, entity
    kinds = [entity.split("/")[-1] for entity in counts if "/image/" in entity]
    assert view_names(path) == {"world", "camera: event rate", *(f"camera: {kind}" for kind in kinds)}
    assert len(kinds) == 8
    return found


# A recording with labels.


def test_windows_show_the_last_polarity(recording: evis.Recording, rows: Rows):
    shown = images(rows, f"{IMAGE}/events")
    assert sorted(shown) == [10_000, 20_000, 30_000, 40_000, 50_000]
    for end, codes in shown.items():
        assert np.array_equal(codes, last_codes(recording.slice_time(end - 10_000, end)))
        assert not np.array_equal(codes, last_codes(recording.slice_time(end - 20_000, end - 10_000))), (
            "canary"
        )


def test_rates_count_every_event(recording: evis.Recording, rows: Rows):
    for name, polarity in (("ON", 1), ("OFF", 0)):
        rates = dict(rows[f"/rates/camera/{name}"]["Scalars:scalars"])
        for end, rate in rates.items():
            window = recording.slice_time(end - 10_000, end)
            assert rate * 0.01 == pytest.approx((window.p == polarity).sum())
        assert round(sum(rates.values()) * 0.01) == (recording.events.p == polarity).sum()
    on, off = (sum(v for _, v in rows[f"/rates/camera/{n}"]["Scalars:scalars"]) for n in ("ON", "OFF"))
    assert on != off, "canary: polarities are told apart"


def test_poses_are_the_recordings(recording: evis.Recording, rows: Rows):
    poses, logged = recording.poses, rows["/world/cameras/camera"]
    places, turns = logged["Transform3D:translation"], logged["Transform3D:quaternion"]
    assert [t for t, _ in places] == poses.t_us.tolist()
    assert np.allclose([v for _, v in places], poses.position, atol=1e-6)
    assert np.allclose([v for _, v in turns], poses.rotation, atol=1e-6)
    assert not np.allclose(places[0][1], poses.position[-1], atol=1e-3), "canary: the camera moves"
    ((_, track),) = rows["/world/tracks/camera"]["LineStrips3D:strips"]
    assert np.allclose(track, poses.position, atol=1e-6)


def quaternion_matrix(q: Any) -> np.ndarray:
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_lens_poses_and_depth_agree_with_flow(recording: evis.Recording, rows: Rows):
    """What the viewer makes of them moves over the picture as the exact flow says."""
    pinhole = {name: values[0][1] for name, values in rows[IMAGE].items()}
    # Rerun stores matrices by column.
    lens = np.reshape(pinhole["Pinhole:image_from_camera"], (3, 3)).T
    assert pinhole["Pinhole:resolution"] == [*SIZE]
    # Right, up, back, by Rerun's codes of the camera's own axes.
    assert [*pinhole["Pinhole:camera_xyz"]] == [3, 1, 6]
    depth = images(rows, f"{IMAGE}/depth", np.float32)
    logged = rows["/world/cameras/camera"]
    places, turns = (dict(logged[f"Transform3D:{name}"]) for name in ("translation", "quaternion"))
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    pixels = np.stack([x + 0.5, y + 0.5, np.ones(x.shape)], axis=-1).reshape(-1, 3)

    def moved(start: int, end: int, axes: np.ndarray) -> np.ndarray:
        seen = (pixels @ np.linalg.inv(lens).T) * depth[start].reshape(-1, 1) * axes
        world = seen @ quaternion_matrix(turns[start]).T + places[start]
        again = (world - places[end]) @ quaternion_matrix(turns[end]) * axes
        return (again @ lens.T / again[:, 2:])[:, :2] - pixels[:, :2]

    flow = recording.labels["flow_forward"][0].reshape(-1, 2)
    ids = recording.labels["instance"][0].ravel()
    wall = ids == ids[0]
    start, end = recording.labels["flow_forward"].interval_us(0)
    down_forward = np.array([1, -1, -1])
    assert np.abs(flow[wall]).max() > 0.15, "the camera moves"
    assert np.abs(moved(start, end, down_forward) - flow)[wall].max() < 0.01
    assert np.abs(moved(start, end, np.ones(3)) - flow)[wall].max() > 0.1, "canary: axes of another camera"


def test_label_images_are_the_recordings(recording: evis.Recording, rows: Rows):
    labels = recording.labels
    depth = images(rows, f"{IMAGE}/depth", np.float32)
    assert list(depth) == labels["depth"].t_us.tolist()
    for image, held in zip(depth.values(), labels["depth"], strict=True):
        assert np.array_equal(image, np.where(np.isfinite(held), held, 0))
    low, high = rows[f"{IMAGE}/depth"]["DepthImage:depth_range"][0][1]
    assert 0 < low < high
    frames, reference = images(rows, f"{IMAGE}/hdr"), reference_of(recording, labels["hdr"][0])
    for image, held in zip(frames.values(), labels["hdr"], strict=True):
        assert np.array_equal(image, tone_mapped(held, reference))
    assert not np.array_equal(frames[0], tone_mapped(labels["hdr"][-1], reference)), "canary: another frame"
    grey, exposed = images(rows, f"{IMAGE}/frame"), reference_of(recording, labels["frame"][0])
    assert list(grey) == labels["frame"].t_us.tolist()
    for image, held in zip(grey.values(), labels["frame"], strict=True):
        assert np.array_equal(image, tone_mapped(held, exposed))
    for kind in ("flow_forward", "flow_backward"):
        speed = full_speed(recording.view, kind)
        assert 10 < speed < 1000, "pixels per second"
        for index, image in enumerate(images(rows, f"{IMAGE}/{kind}").values()):
            assert np.array_equal(image, flow_of(recording.view, kind, index, speed))
    for kind in ("instance", "semantic"):
        for image, held in zip(
            images(rows, f"{IMAGE}/{kind}", np.uint16).values(), labels[kind], strict=True
        ):
            assert np.array_equal(image, held)


# Events alone.


@pytest.mark.parametrize("ending", ["raw", "dat", "aedat4", "npz", "npy", "txt", "mcap", "es", "h5"])
def test_files_of_every_format_bring_events(ending: str, tmp_path: Path):
    events = scattered()
    evis.save(tmp_path / f"events.{ending}", events)
    counts = evis_rerun.view(tmp_path / f"events.{ending}", save=tmp_path / "events.rrd")
    rows = read(tmp_path / "events.rrd")
    assert len(counts) == 3, "events, and two rates"
    shown = images(rows, next(entity for entity in counts if entity.endswith("/image/events")))
    assert len(shown) == 6
    held = [shown[t][: SIZE[1], : SIZE[0]] for t in sorted(shown)]
    for k, codes in enumerate(held):
        assert np.array_equal(codes, last_codes(events.slice_time(10_000 * k, 10_000 * (k + 1))))
    assert not np.array_equal(held[0], held[1]), "canary"
    assert not any("Pinhole" in name for entity in rows.values() for name in entity), "the lens is not known"


def test_a_picture_without_events_follows_one_with_events(tmp_path: Path):
    events = evis.EventArray.from_columns([1000, 55_000], [1, 2], [1, 2], [1, 0], width=4, height=4)
    evis_rerun.view(events, save=tmp_path / "x.rrd")
    rows = read(tmp_path / "x.rrd")
    shown = {t: codes.sum() for t, codes in images(rows, f"{IMAGE}/events").items()}
    assert shown == {10_000: 2, 20_000: 0, 60_000: 1}
    assert [rate for _, rate in rows["/rates/camera/ON"]["Scalars:scalars"]] == [100, 0, 0, 0, 0, 0]


def test_a_part_and_other_windows(tmp_path: Path):
    events = scattered(first_us=1_700_000_000_000_000)
    start = 1_700_000_000_012_345
    evis_rerun.view(events, save=tmp_path / "x.rrd", start_us=start, end_us=start + 20_000, window_us=8000)
    rows = read(tmp_path / "x.rrd")
    shown = images(rows, f"{IMAGE}/events")
    assert sorted(shown) == [start + 8000, start + 16_000, start + 20_000], "the last one is shorter"
    assert np.array_equal(
        shown[start + 20_000], last_codes(events.slice_time(start + 16_000, start + 20_000))
    )
    rate = sum(
        dict(rows[f"/rates/camera/{name}"]["Scalars:scalars"])[start + 20_000] for name in ("ON", "OFF")
    )
    assert rate * 0.004 == pytest.approx(len(events.slice_time(start + 16_000, start + 20_000)))


def test_cameras_are_told_apart(tmp_path: Path):
    left, right = scattered(), scattered(300)
    evis.save(tmp_path / "two.h5", {"left": left, "right": right})
    both = evis_rerun.view(tmp_path / "two.h5", save=tmp_path / "x.rrd")
    assert {entity.split("/")[2] for entity in both if entity.startswith("/rates")} == {"left", "right"}
    titles = {f"{name}: {what}" for name in ("left", "right") for what in ("events", "event rate")}
    assert view_names(tmp_path / "x.rrd") == titles, "no poses, no world"
    shown = images(read(tmp_path / "x.rrd"), "/world/cameras/right/image/events")
    assert np.array_equal(shown[10_000], last_codes(right.slice_time(0, 10_000)))
    one = evis_rerun.view(tmp_path / "two.h5", save=tmp_path / "x.rrd", camera="left")
    assert {entity.split("/")[2] for entity in one if entity.startswith("/rates")} == {"left"}


def test_names_may_hold_any_characters(tmp_path: Path):
    evis.save(tmp_path / "odd.h5", {"front left (1)": scattered(50)})
    counts = evis_rerun.view(tmp_path / "odd.h5", save=tmp_path / "x.rrd")
    assert len([entity for entity in counts if entity.endswith("/image/events")]) == 1
    assert len(read(tmp_path / "x.rrd")) >= len(counts)


def test_rows_go_to_a_stream_of_the_users_own(tmp_path: Path):
    stream = rerun.RecordingStream("mine")
    stream.save(tmp_path / "mine.rrd")
    counts = evis_rerun.log(stream, scattered())
    rerun.send_columns(
        "mine",
        [rerun.TimeColumn("time", duration=[0.01])],
        rerun.Scalars.columns(scalars=[4.0]),
        recording=stream,
    )
    stream.disconnect()
    rows = read(tmp_path / "mine.rrd")
    assert rows["/mine"]["Scalars:scalars"] == [(10_000, 4.0)]
    assert set(counts) < set(rows)


# Bad input, and the command.


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"window_us": 0}, "window_us is 0"),
        ({"window_us": 1.5}, "window_us is 1.5"),
        ({"window_us": 1 << 60}, f"window_us is {1 << 60}"),
        ({"start_us": 5, "end_us": 5}, "end_us is 5; it must be above start_us"),
        ({"start_us": "a"}, "start_us is 'a'"),
        ({"start_us": 10**9}, "there is nothing to show with start_us=1000000000"),
        ({"camera": "left"}, "no camera named 'left'"),
        ({"save": "x.h5"}, "end with .rrd"),
    ],
)
def test_bad_options_are_named(options: dict[str, Any], message: str, tmp_path: Path):
    path = tmp_path / options.pop("save", "x.rrd")
    with pytest.raises(evis.ConfigError, match=re.escape(message)):
        evis_rerun.view(scattered(), save=path, **options)
    assert list(tmp_path.iterdir()) == []


def test_bad_sources_are_named(tmp_path: Path):
    nothing = scattered().slice_time(0, 0)
    far = evis.EventArray.from_columns([0, 1 << 50], [0, 0], [0, 0], [1, 1], width=4, height=4)
    (tmp_path / "letter.txt").write_text("Dear reader,")
    for source, message, kind in (
        (nothing, "there is nothing to show: no event", evis.ConfigError),
        (far, "choose a longer window", evis.ConfigError),
        (3, "source is 3", evis.ConfigError),
        (tmp_path / "none.h5", "No such file", OSError),
        (tmp_path / "letter.txt", "content tells no format", evis.ConfigError),
    ):
        with pytest.raises(kind, match=message):
            evis_rerun.view(source, save=tmp_path / "x.rrd")
    with pytest.raises(OSError, match="No such file"):
        evis_rerun.view(scattered(), save=tmp_path / "no" / "x.rrd")
    assert [path.name for path in tmp_path.iterdir()] == ["letter.txt"]


def test_a_recording_without_events_shows_what_it_has(
    recording: evis.Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(evis.files.RecordedView, "slice_time", lambda *_: scattered().slice_time(0, 0))
    counts = evis_rerun.view(recording, save=tmp_path / "x.rrd", end_us=20_000)
    assert f"{IMAGE}/events" not in counts
    assert counts[f"{IMAGE}/depth"] == counts["/world/cameras/camera"] == 2


def test_a_missing_package_and_display_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    if sys.platform == "linux":
        monkeypatch.delenv("DISPLAY", raising=False)
        monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
        with pytest.raises(evis.ConfigError, match=r"--save OUT.rrd"):
            evis_rerun.view(scattered())
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(evis.ConfigError, match=re.escape("pip install 'evis[view]'")):
        evis_rerun.view(scattered(), save=tmp_path / "x.rrd")


def test_the_viewer_opens_where_there_is_a_display(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    spawned = []

    def spawn(stream: Any) -> None:
        assert os.environ["PATH"].startswith(str(Path(sys.executable).parent)), "where pip puts the viewer"
        spawned.append(stream)
        stream.save(tmp_path / "shown.rrd")

    def failing(stream: Any) -> None:
        raise RuntimeError("no viewer\nand much more")

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(rerun.RecordingStream, "spawn", spawn)
    counts = evis_rerun.view(scattered())
    spawned[0].disconnect()
    assert len(images(read(tmp_path / "shown.rrd"), f"{IMAGE}/events")) == counts[f"{IMAGE}/events"] == 6
    monkeypatch.setattr(rerun.RecordingStream, "spawn", failing)
    with pytest.raises(evis.ConfigError, match="the viewer did not open: no viewer; write a file instead"):
        evis_rerun.view(scattered())


def test_the_command_writes_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    evis.save(tmp_path / "events.npz", scattered())
    out = tmp_path / "out.rrd"
    arguments = [str(tmp_path / "events.npz"), "--save", str(out), "--window-ms", "5", "--duration", "0.02"]
    assert _commands.run("view", arguments) == 0
    assert capsys.readouterr().out.splitlines()[:2] == [str(out), f"       4  {IMAGE}/events"]
    assert sorted(images(read(out), f"{IMAGE}/events")) == [5000, 10_000, 15_000, 20_000]
    assert _commands.run("view", [str(tmp_path / "none.h5"), "--save", str(out)]) == 2
    assert capsys.readouterr().err.startswith("error: ")
    with pytest.raises(SystemExit) as ended:
        _commands.run("view", [])
    assert ended.value.code == 2


def test_code_of_the_page_runs(device: evis.Device, tmp_path: Path):
    _, code = blocks(Path(__file__).resolve().parent.parent / "docs/view.md", "python")
    done = run_code(code, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("10 pictures of events\n")
    rows = read(tmp_path / "mine.rrd")
    assert [t for t, _ in rows["/battery"]["Scalars:scalars"]] == [10_000, 20_000]
    assert len(images(rows, f"{IMAGE}/events")) == 10
    # Canary: code that is out of date does not pass.
    assert run_code(code.replace("window_us=", "window="), tmp_path).returncode != 0
