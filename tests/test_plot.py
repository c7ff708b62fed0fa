"""Plots show the events' own numbers, films show the same pictures, and bad input is named."""

from __future__ import annotations

import io
import re
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_readme import blocks, python, run_code

import evis
from evis import _commands, _progress, plot
from evis._pictures import (
    flow_picture,
    last_polarity,
    polarity_picture,
    reference_of,
    surface_picture,
    tone_mapped,
)

pytest.importorskip("matplotlib")

ROOT = Path(__file__).resolve().parent.parent
WIDTH, HEIGHT = 16, 12
ORANGE, BLUE = (230, 159, 0), (0, 66, 120)


def scattered(count: int = 3000, first_us: int = 0, length_us: int = 60_000) -> evis.EventArray:
    """Events anywhere but in the last row, more ON than OFF and more at the left, some in one microsecond."""
    rng = np.random.default_rng(7)
    t = first_us + np.sort(rng.integers(0, length_us, count))
    t[10:20] = t[10]
    x, y = (rng.random(count) ** 2 * WIDTH).astype(int), rng.integers(0, HEIGHT - 1, count)
    x[10:13], y[10:13] = 5, 5
    return evis.EventArray.from_columns(t, x, y, rng.random(count) < 0.6, width=WIDTH, height=HEIGHT)


def rows(events: evis.EventArray) -> list[tuple[int, int, int, int]]:
    return list(zip(*(column.tolist() for column in events.columns), strict=True))


def stairs(axes: Any) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Values and edges of each step line, by its label."""
    return {patch.get_label(): patch.get_data()[:2] for patch in axes.patches}


def image(axes: Any) -> np.ndarray:
    (shown,) = axes.get_images()
    return shown.get_array()


# Figures.


def test_rates_are_counts_over_time():
    events = scattered()
    (axes,) = plot.rates(events, bin_us=5000).axes
    drawn = stairs(axes)
    for name, polarity in (("ON", 1), ("OFF", 0)):
        rate, edges = drawn[name]
        counts = Counter(t // 5000 for t, _, _, p in rows(events) if p == polarity)
        assert np.allclose(edges, 5.0 * np.arange(13)), "milliseconds"
        assert np.allclose(rate, [counts[k] / 0.005 for k in range(12)])
    assert not np.allclose(drawn["ON"][0], drawn["OFF"][0]), "canary: the other polarity"
    assert axes.get_xlabel() == "time (ms)"


def test_bins_of_rates_are_round_and_hold_every_event():
    for first, length, width, unit in (
        (0, 60_000, 500, "ms"),
        (1_700_000_000_000_123, 3_000_000, 20_000, "s"),
        (0, 900, 5, "us"),
    ):
        events = scattered(first_us=first, length_us=length)
        (axes,) = plot.rates(events).axes
        total = sum(rate.sum() for rate, _ in stairs(axes).values())
        assert round(total * width * 1e-6) == len(events)
        assert axes.get_xlabel().endswith(f"({unit})")
    assert "after" not in axes.get_xlabel()


def test_streams_start_at_zero_unless_their_first_event_is_late():
    assert [plot._span_us(scattered(first_us=first))[0] for first in (0, 2000)] == [0, 0]
    late = scattered(first_us=30_000)
    assert plot._span_us(late) == (late.t[0], late.t[-1] + 1)


def test_times_far_from_zero_are_told_from_the_first_event_on():
    events = scattered(first_us=1_700_000_000_000_123)
    (axes,) = plot.rates(events).axes
    assert axes.get_xlabel() == f"time after {events.t[0]} us (ms)"
    assert axes.get_xlim()[1] < 61


def test_intervals_are_those_of_each_pixel():
    events = scattered()
    (axes,) = plot.intervals(events).axes
    last: dict[tuple[int, int], tuple[int, int]] = {}
    gaps: dict[str, list[int]] = {"same polarity": [], "other polarity": []}
    for t, x, y, p in rows(events):
        if (x, y) in last:
            before, polarity = last[x, y]
            gaps["same polarity" if p == polarity else "other polarity"].append(t - before)
        last[x, y] = (t, p)
    drawn = stairs(axes)
    assert min(gaps["same polarity"] + gaps["other polarity"]) == 0, "some lie within a microsecond"
    for name, wanted in gaps.items():
        count, edges = drawn[name]
        inside = [sum(low <= max(gap, 0.7) < high for gap in wanted) for low, high in zip(edges, edges[1:])]  # noqa: B905, RUF007
        assert count.tolist() == inside
        assert count.sum() == len(wanted)
        assert (edges[1:] == np.rint(edges[1:])).all(), "no bin that no interval can fall into"
    assert drawn["same polarity"][0].tolist() != drawn["other polarity"][0].tolist(), "canary"


def test_intervals_say_where_there_are_none():
    once = evis.EventArray.from_columns([1, 2], [0, 1], [0, 0], [1, 0], width=4, height=4)
    (axes,) = plot.intervals(once).axes
    assert [text.get_text() for text in axes.texts] == ["no pixel fired twice"]
    assert not stairs(axes)


def test_the_map_has_each_pixels_rate():
    events = scattered()
    axes, _ = plot.rate_map(events).axes
    shown = image(axes)
    counts = Counter((y, x) for _, x, y, _ in rows(events))
    seconds = (int(events.t[-1]) + 1) * 1e-6
    wanted = np.array([[counts[y, x] / seconds for x in range(WIDTH)] for y in range(HEIGHT)])
    assert np.allclose(shown.filled(0), wanted)
    assert np.array_equal(np.ma.getmaskarray(shown), wanted == 0)
    assert (wanted == 0).any()
    assert not np.allclose(shown.filled(0)[:, ::-1], wanted), "canary: mirrored"
    y, x = np.unravel_index(wanted.argmax(), wanted.shape)
    assert axes.get_title() == f"Rate per pixel, up to {wanted[y, x]:.0f}/s at ({x}, {y})"


def test_thumbnails_show_counts_surfaces_and_polarities():
    events = scattered()
    figure = plot.thumbnails(events, count=3, window_us=4000)
    axes = figure.axes
    end = int(events.t[-1]) + 1
    for k in range(3):
        last = end * (k + 1) // 3
        window = events.slice_time(last - 4000, last)
        assert np.array_equal(image(axes[k]).filled(0), window.counts().sum(axis=0))
        surface = events.time_surface(2000, at_us=last - 1)
        assert np.array_equal(image(axes[3 + k]), surface_picture(surface))
        assert np.array_equal(image(axes[6 + k]), polarity_picture(window.to_numpy(), (WIDTH, HEIGHT)))
        assert not np.array_equal(image(axes[k]), image(axes[(k + 1) % 3])), "canary: another window"


def test_the_cloud_has_every_event_where_it_fits():
    events = scattered(500)
    (axes,) = plot.xyt(events).axes
    (points,) = axes.collections
    drawn = np.array(points._offsets3d, float)
    t, x, y, p = events.columns
    assert np.allclose(drawn, [t / 1000, x, y])
    colors = np.rint(255 * points._facecolors[:, :3]).astype(int)
    assert np.array_equal(colors, np.where(p[:, None] == 1, ORANGE, BLUE))
    assert axes.get_zlim() == (HEIGHT, 0), "rows run down"
    few = plot.xyt(events, most=100)
    (some,) = few.axes[0].collections
    kept = np.array(some._offsets3d).T
    assert len({tuple(row) for row in kept.tolist()} & {tuple(row) for row in drawn.T.tolist()}) == 100
    assert np.array_equal(kept, np.array(plot.xyt(events, most=100).axes[0].collections[0]._offsets3d).T)
    assert few.get_suptitle().startswith("100 of 500 events")


def test_the_summary_has_all_of_it():
    events = scattered()
    titles = [axes.get_title() for axes in plot.summary(events).axes]
    assert [title.split()[0] for title in titles[:3]] == ["Event", "Time", "Rate"]
    assert len(titles) == 3 + 1 + 12 + 1, "three plots, a scale, twelve thumbnails, a scale"


def test_everything_with_the_events_of_one_camera_is_plotted(tmp_path: Path):
    events = scattered()
    (path,) = evis.save(tmp_path / "events.raw", events)
    wanted = stairs(plot.rates(events).axes[0])["ON"][0]
    recording = evis.load(path, width=WIDTH, height=HEIGHT)
    for source in (path, str(path), recording, recording.view, next(events.windows(100_000))):
        assert np.array_equal(stairs(plot.rates(source).axes[0])["ON"][0], wanted)


# Pictures.


def test_pictures_show_the_last_polarity():
    events = evis.EventArray.from_columns([0, 1, 2], [1, 1, 3], [0, 0, 2], [1, 0, 1], width=4, height=3)
    assert last_polarity(events.to_numpy(), (4, 3)).tolist() == [[0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 2]]
    shown = image(plot.polarity(events).axes[0])
    assert shown[0, 1].tolist() == [*BLUE]
    assert shown[2, 3].tolist() == [*ORANGE]
    assert shown[1, 1].tolist() == [255, 255, 255]


def test_surfaces_fade_from_their_polarity_to_white():
    events = evis.EventArray.from_columns([0, 50, 50], [0, 1, 1], [0, 0, 0], [1, 1, 0], width=3, height=1)
    shown = image(plot.surface(events, tau_us=50, at_us=100).axes[0])[0].astype(int)
    wanted = [np.rint(255 + np.exp(-age / 50) * (np.array(ORANGE) - 255)) for age in (100, 50)]
    assert np.abs(shown[0] - wanted[0]).max() <= 1
    assert np.abs(shown[1] - wanted[1]).max() <= 1, "of two in one microsecond, ON is shown"
    assert shown[2].tolist() == [255, 255, 255]
    assert np.abs(shown[0] - wanted[1]).max() > 20, "canary: another age"


def test_flow_has_the_hue_of_its_direction():
    flow = np.array([[(4, 0), (0, 4), (-4, 0), (0, -4), (0, 0), (2, 0), (9, 0), (4, 0)]], np.float32)
    flow = np.concatenate([flow, [[(np.nan, 0)]]], axis=1)
    valid = np.array([[1, 1, 1, 1, 1, 1, 1, 0, 1]], np.uint8)
    right, down, left, up, rest, slow, fast, unknown, nan = flow_picture(flow, valid, 4.0)[0].tolist()
    assert (right, left) == ([255, 0, 0], [0, 255, 255])
    assert (down, up) == ([128, 255, 0], [128, 0, 255])
    assert (rest, slow, fast) == ([255, 255, 255], [255, 128, 128], right)
    assert (unknown, nan) == ([0, 0, 0], [0, 0, 0])
    assert flow_picture(flow, valid, 0.0)[0, 0].tolist() == [255, 255, 255], "nothing moves"


def test_pictures_are_those_of_preview(device: evis.Device, tmp_path: Path):
    """The Rust program draws the same frame, and the same events beside it."""
    sim = evis.Simulator(
        evis.Scene.builtin("spinner"), size=(80, 48), quality="draft", labels=["hdr"], label_rate_hz=100
    )
    evis.save(tmp_path / "run.h5", sim.stream(duration=0.05))
    preview = ["preview", "run.h5", "-o", "picture.png", "--at", "0.04", "--window-ms", "10"]
    assert python("-m", "evis", *preview, cwd=tmp_path).returncode == 0
    from matplotlib.image import imread

    picture = np.rint(255 * imread(tmp_path / "picture.png")[:48, :, :3]).astype(int)
    recording = evis.load(tmp_path / "run.h5")
    frames = recording.labels["hdr"]
    index = int(np.searchsorted(frames.t_us, 40_000, side="right")) - 1
    frame = tone_mapped(frames[index], reference_of(recording, frames[index]))
    assert np.abs(picture[:, :80] - frame).max() <= 1
    assert np.abs(picture[:, :80] - tone_mapped(frames[0], 1.0)).max() > 10, "canary: another frame, exposure"
    events = polarity_picture(recording.slice_time(30_000, 40_000).to_numpy(), (80, 48))
    assert np.array_equal(picture[:, -80:], events)
    unknown = evis._files.recording_of(recording.events)
    assert reference_of(unknown, np.full((4, 5, 3), 0.5, np.float32)) == pytest.approx(0.5 / 0.18)


# Films.


def film(path: Path) -> tuple[dict[str, Any], np.ndarray]:
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    reader = imageio_ffmpeg.read_frames(str(path))
    about = next(reader)
    width, height = about["size"]
    return about, np.stack([np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader])


def test_films_show_windows_one_after_another(tmp_path: Path):
    pytest.importorskip("imageio_ffmpeg")
    events = scattered()
    path = tmp_path / "film.mp4"
    count = plot.video(events, path, fps=25, slow=4, window_us=10_000)
    about, frames = film(path)
    assert count == len(frames) == 6, "60 ms, a frame every 10 ms"
    assert about["fps"] == 25
    assert about["size"] == (480, 390), "pixels are 30 wide; a caption of 30 below"
    for k, frame in enumerate(frames):
        window = events.slice_time(10_000 * k, 10_000 * (k + 1))
        wanted = polarity_picture(window.to_numpy(), (WIDTH, HEIGHT)).astype(int)
        centres = frame[15:360:30, 15::30].astype(int)
        assert np.abs(centres - wanted).max() < 40, "as films compress colours"
        assert np.abs(centres[:, ::-1] - wanted).max() > 100, "canary: mirrored"
    assert frames[:, 360:, :150].min() < 180, "the time is written"


def test_surfaces_of_films_are_those_of_the_events():
    events = scattered()
    ends = np.array([20_000, 40_000])
    for end, frame in zip(ends.tolist(), plot._frames(events, ends, "surface", 8000), strict=True):
        wanted = surface_picture(events.time_surface(8000, end_us=end))
        shown = frame[15:360:30, 15::30].astype(int)
        assert np.abs(shown - wanted).max() <= 1
        assert np.abs(shown - surface_picture(events.time_surface(8000, end_us=end + 9000))).max() > 20, (
            "canary"
        )


def test_the_same_events_give_the_same_film(tmp_path: Path):
    pytest.importorskip("imageio_ffmpeg")
    for name, events in (("a", scattered()), ("b", scattered()), ("other", scattered(2000))):
        plot.video(events, tmp_path / f"{name}.mp4", fps=50)
    a, b, other = (path.read_bytes() for path in sorted(tmp_path.iterdir()))
    assert a == b
    assert a != other, "canary"


def test_films_of_clouds_have_even_sides(tmp_path: Path):
    pytest.importorskip("imageio_ffmpeg")
    assert plot.video(scattered(), tmp_path / "cloud.mp4", kind="xyt", fps=50) == 3
    about, frames = film(tmp_path / "cloud.mp4")
    assert about["size"] == (800, 470)
    orange = (np.abs(frames[-1].astype(int) - ORANGE) < 40).all(axis=-1)
    assert orange.sum() > 50


def test_a_film_that_fails_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "film.mp4"
    path.write_bytes(b"old")

    def broken(*_: Any) -> Any:
        yield np.zeros((32, 32, 3), np.uint8)
        raise KeyboardInterrupt

    monkeypatch.setattr(plot, "_frames", broken)
    with pytest.raises(KeyboardInterrupt):
        plot.video(scattered(), path)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


# Progress.


def test_progress_tells_the_time_left(monkeypatch: pytest.MonkeyPatch):
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr(sys, "stderr", Terminal())
    with _progress.Progress(4, "frames") as progress:
        progress.advance(1)
        assert progress.line(30.0) == "#######-----------------------  25%  1 frames  1:30 left"
        progress.advance(3)
        assert progress.line(40.0).endswith("100%  4 frames  0:00 left")
    assert "4 frames" in sys.stderr.getvalue()
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with _progress.Progress(1, "frames") as progress:
        progress.advance()
    assert sys.stderr.getvalue() == "", "no terminal, no bar"


# Bad input, and the command.


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda e, _: plot.rates(e.slice_time(0, 0)), "there are no events"),
        (lambda e, _: plot.rates(3), "events are 3"),
        (lambda e, _: plot.rates(e, bin_us=0), "bin_us is 0"),
        (lambda e, _: plot.rates(e, bin_us=2.5), "bin_us is 2.5"),
        (lambda e, _: plot.surface(e, tau_us=0), "tau_us"),
        (lambda e, _: plot.thumbnails(e, count=0), "count is 0"),
        (lambda e, _: plot.thumbnails(e, window_us=0), "window_us is 0"),
        (lambda e, _: plot.xyt(e, most=0), "most is 0"),
        (lambda e, p: plot.video(e, p / "film.avi"), "films end with .mp4"),
        (lambda e, p: plot.video(e, p / "film.mp4", kind="map"), "kind is 'map'"),
        (lambda e, p: plot.video(e, p / "film.mp4", fps=0), "fps is 0"),
        (lambda e, p: plot.video(e, p / "film.mp4", fps=float("nan")), "fps is nan"),
        (lambda e, p: plot.video(e, p / "film.mp4", slow=-1), "slow is -1"),
        (lambda e, p: plot.video(e, p / "film.mp4", window_us=0), "window_us is 0"),
        (lambda e, p: plot.video(e, p / "film.mp4", fps=1000, slow=1e6), "lower fps or a lower slow"),
    ],
)
def test_bad_input_is_named(make: Any, message: str, tmp_path: Path):
    with pytest.raises(evis.ConfigError, match=re.escape(message)):
        make(scattered(length_us=60_000), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_events_too_far_apart_are_refused():
    far = evis.EventArray.from_columns([0, 1 << 50], [0, 0], [0, 0], [1, 1], width=4, height=4)
    with pytest.raises(evis.ConfigError, match="choose a longer one"):
        plot.rates(far, bin_us=1)
    assert len(plot.rates(far).axes) == 1


@pytest.mark.parametrize(
    ("module", "extra", "draw"),
    [
        ("matplotlib.figure", "'evis[plot]'", lambda p: plot.rates(scattered())),
        ("imageio_ffmpeg", "'evis[plot,video]'", lambda p: plot.video(scattered(), p / "film.mp4")),
    ],
)
def test_missing_packages_are_named(
    module: str, extra: str, draw: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(evis.ConfigError, match=re.escape(f"pip install {extra}")):
        draw(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_command_draws_pictures_and_films(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    pytest.importorskip("imageio_ffmpeg")
    source = str(tmp_path / "events.npz")
    evis.save(source, scattered())
    for kind in plot.KINDS:
        assert _commands.run("plot", [source, "-o", str(tmp_path / "p.png"), "--kind", kind]) == 0
        assert capsys.readouterr().out == f"{tmp_path / 'p.png'}  {kind} of 3000 events\n"
    assert (tmp_path / "p.png").read_bytes()[:4] == b"\x89PNG"
    for ending, start in (("svg", b"<?xml"), ("pdf", b"%PDF"), ("jpg", b"\xff\xd8")):
        out = tmp_path / f"p.{ending}"
        assert _commands.run("plot", [source, "-o", str(out), "--kind", "rates", "--window-ms", "5"]) == 0
        assert out.read_bytes().startswith(start)
    part = ["--start", "0.02", "--duration", "0.02", "--fps", "100"]
    assert _commands.run("plot", [source, "--video", str(tmp_path / "f.mp4"), *part]) == 0
    assert capsys.readouterr().out.endswith("f.mp4  2 frames\n")
    assert len(film(tmp_path / "f.mp4")[1]) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["events.npz", "-o", "p.bmp"], "--output is p.bmp"),
        (["events.npz", "-o", "p.png", "--kind", "map", "--window-ms", "5"], "says nothing for --kind map"),
        (["events.npz", "-o", "p.png", "--start", "5"], "has no events in that part"),
        (["events.npz", "-o", "p.png", "--duration", "0"], "--duration is 0"),
        (["events.npz", "-o", "p.png", "--camera", "left"], "no camera named 'left'"),
        (["events.npz", "-o", "events.npz"], "is the recording itself"),
        (["events.npz", "-o", "no/such/p.png"], "No such file"),
        (["empty.npz", "-o", "p.png"], "has no events"),
        (["none.h5", "-o", "p.png"], "No such file"),
        (["letter.txt", "-o", "p.png"], "content tells no format"),
    ],
)
def test_the_command_names_bad_input(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    evis.save("events.npz", scattered())
    evis.save("empty.npz", scattered().slice_time(0, 0))
    Path("letter.txt").write_text("Dear reader,")
    before = sorted(tmp_path.iterdir())
    assert _commands.run("plot", arguments) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("error: ")
    assert message in shown.err
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    "arguments", [["x.h5"], ["x.h5", "-o", "x.png", "--fps", "3"], ["x.h5", "--start", "a"]]
)
def test_the_command_refuses_what_makes_no_sense(arguments: list[str]):
    with pytest.raises(SystemExit) as ended:
        _commands.run("plot", arguments)
    assert ended.value.code == 2


def test_an_interrupted_command_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    def interrupted(_: Any) -> int:
        raise KeyboardInterrupt

    monkeypatch.setitem(_commands.COMMANDS, "plot", interrupted)
    assert _commands.run("plot", []) == 130
    assert capsys.readouterr().err == "interrupted\n"


# Documents.


def test_code_of_the_page_runs(device: evis.Device, tmp_path: Path):
    code, _ = blocks(ROOT / "docs/view.md", "python")
    done = run_code(code, tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 2
    # Canary: code that is out of date does not pass.
    assert run_code(code.replace("bin_us=", "bins="), tmp_path).returncode != 0


def test_the_gallery_shows_all_of_its_pictures_and_they_are_small():
    page = (ROOT / "docs/gallery.md").read_text("utf-8")
    shown = set(re.findall(r"\]\(images/gallery/([^)]+)\)", page))
    held = {path.name: path.stat().st_size for path in (ROOT / "docs/images/gallery").iterdir()}
    assert len(held) >= 6
    assert shown == set(held)
    films = {name for name in held if name.endswith(".gif")}
    assert max(held[name] for name in films) < 1_600_000
    assert max(size for name, size in held.items() if name not in films) < 150_000
    assert sum(size for name, size in held.items() if name not in films) < 1_000_000
    script = (ROOT / "tools/gallery.py").read_text("utf-8")
    assert {name for name in held if name not in script} == set(), "one command makes them all"
