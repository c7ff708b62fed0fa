"""Dense arrays equal the published formulas, written here from the papers, and tonic's."""

from __future__ import annotations

import importlib
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import evis
from evis import representations

SIZES = [(7, 5), (346, 260), (1280, 720)]


def random_events(seed: int, count: int, size: tuple[int, int], span_us: int = 5000) -> evis.EventArray:
    """Sorted events with ties of time, and of time and place where the sensor is small."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(-100, span_us, count))
    x, y = rng.integers(0, size[0], count), rng.integers(0, size[1], count)
    # The corners, so that a wrong stride is seen.
    corners = min(count, 4)
    x[:corners] = [0, size[0] - 1, 0, size[0] - 1][:corners]
    y[:corners] = [0, 0, size[1] - 1, size[1] - 1][:corners]
    return evis.EventArray.from_columns(t, x, y, rng.integers(0, 2, count), width=size[0], height=size[1])


CASES = {
    "ties": random_events(1, 3000, (7, 5), 40),
    "davis": random_events(2, 20_000, (346, 260)),
    "720p": random_events(3, 50_000, (1280, 720)),
    "one event": random_events(4, 1, (7, 5)),
    "two instants": random_events(5, 50, (7, 5), -98),
    "none": random_events(6, 0, (7, 5)),
}


@pytest.fixture(params=CASES.values(), ids=CASES.keys())
def events(request: pytest.FixtureRequest) -> evis.EventArray:
    return request.param


def same(made: np.ndarray, expected: np.ndarray) -> bool:
    return made.shape == expected.shape and np.allclose(made, expected, rtol=1e-5, atol=2e-5)


def assert_same(made: np.ndarray, expected: np.ndarray, dtype: str = "float32") -> None:
    """Compare, and make sure that a difference is seen."""
    assert made.dtype == dtype
    assert made.flags.c_contiguous
    assert same(made, expected)
    wrong = expected.astype(np.float64)
    wrong.flat[expected.size // 2] += 1e-3
    assert not same(made, wrong), "canary: another value"
    assert not same(made, np.flip(expected, -1)) or not np.any(expected - np.flip(expected, -1)), (
        "canary: flipped"
    )


def t_star(events: evis.EventArray, steps: float) -> np.ndarray:
    """Times from 0 to `steps`: (t - t_1) / (t_N - t_1)."""
    if not len(events):
        return np.zeros(0)
    span = int(events.t[-1] - events.t[0])
    return steps * (events.t - events.t[0]) / (span or 1)


def bump(a: np.ndarray) -> np.ndarray:
    """k_b(a) = max(0, 1 - |a|), Zhu et al. 2019."""
    return np.maximum(0, 1 - np.abs(a))


# Formulas of the papers, bin by bin over all events.


def published_voxel_grid(events: evis.EventArray, bins: int) -> np.ndarray:
    """V(x, y, b) = sum_i p_i k_b(b - t_i*), t_i* = (B - 1) (t_i - t_1) / (t_N - t_1) (Zhu et al. 2019)."""
    grid = np.zeros((bins, events.height, events.width))
    polarity = np.where(events.p > 0, 1.0, -1.0)
    for b in range(bins):
        np.add.at(grid[b], (events.y, events.x), polarity * bump(b - t_star(events, bins - 1)))
    return grid


def published_split_grid(events: evis.EventArray, bins: int) -> np.ndarray:
    grid = np.zeros((2, bins, events.height, events.width))
    for b in range(bins):
        np.add.at(grid[:, b], (events.p, events.y, events.x), bump(b - t_star(events, bins - 1)))
    return grid


def e2vid_normalized(grid: np.ndarray) -> np.ndarray:
    """EventPreprocessor of E2VID: mean and deviation of the values that are not 0."""
    nonzero = grid != 0
    if not nonzero.any():
        return grid
    mean = grid.sum() / nonzero.sum()
    deviation = np.sqrt((grid**2).sum() / nonzero.sum() - mean**2)
    return nonzero * (grid - mean) / deviation


def published_est(events: evis.EventArray, bins: int, f: np.ndarray) -> np.ndarray:
    """V(p, n, y, x) = sum_k f_k max(0, 1 - |(n dt - t_k) / dt|), dt = 1 / (B - 1) (Gehrig et al. 2019)."""
    tensor = np.zeros((2, bins, events.height, events.width))
    for n in range(bins):
        weight = bump((n / (bins - 1) - t_star(events, 1)) * (bins - 1))
        np.add.at(tensor[:, n], (events.p, events.y, events.x), f * weight)
    return tensor


def published_surface(
    events: evis.EventArray, t: int, fall: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """S(u, p) = fall(t - T(u, p)), T the time of the last event of p at u until t (Lagorce et al. 2017)."""
    last = np.full((2, events.height, events.width), -np.inf)
    until = events.t <= t
    np.maximum.at(last, (events.p[until], events.y[until], events.x[until]), events.t[until])
    return np.where(np.isneginf(last), 0, fall(t - last))


def published_average(events: evis.EventArray, empty: float) -> np.ndarray:
    """T_p(x, y) = sum_i t_i / sum_i 1 over the events of polarity p there (Zhu et al. 2019)."""
    total, number = (np.zeros((2, events.height, events.width)) for _ in range(2))
    np.add.at(total, (events.p, events.y, events.x), t_star(events, 1))
    np.add.at(number, (events.p, events.y, events.x), 1)
    return np.where(number > 0, total / np.maximum(number, 1), empty)


def published_bits(events: evis.EventArray, bins: int) -> np.ndarray:
    """Whether there is an event in the b-th part of time."""
    fired = np.zeros((bins, 2, events.height, events.width))
    if len(events):
        first, length = int(events.t[0]), int(events.t[-1]) + 1 - int(events.t[0])
        # Python's integers: exact.
        part = [(int(t) - first) * bins // length for t in events.t]
        fired[part, events.p, events.y, events.x] = 1
    return fired


def test_event_frame(events: evis.EventArray) -> None:
    expected = np.zeros((events.height, events.width))
    np.add.at(expected, (events.y, events.x), np.where(events.p > 0, 1, -1))
    assert_same(events.event_frame(), expected, "int32")


def test_counts(events: evis.EventArray) -> None:
    expected = np.zeros((2, events.height, events.width))
    np.add.at(expected, (events.p, events.y, events.x), 1)
    assert_same(events.counts(), expected, "int32")


@pytest.mark.parametrize("bins", [1, 2, 5, 10])
def test_voxel_grid(events: evis.EventArray, bins: int) -> None:
    assert_same(events.voxel_grid(bins), published_voxel_grid(events, bins))
    assert_same(events.voxel_grid(bins=bins, polarity="split"), published_split_grid(events, bins))


def test_voxel_grid_normalized_as_e2vid(events: evis.EventArray) -> None:
    grid = events.voxel_grid(5)
    made = events.voxel_grid(5, normalize=True)
    if len(events) == 1:
        # E2VID divides by 0 here.
        assert not made.any()
        return
    expected = e2vid_normalized(grid.astype(np.float64))
    assert np.allclose(made, expected, rtol=1e-4, atol=1e-4)
    assert not len(events) or not np.allclose(made, grid, rtol=1e-4, atol=1e-4), "canary"


@pytest.mark.parametrize("bins", [2, 9])
def test_event_spike_tensor(events: evis.EventArray, bins: int) -> None:
    polarity = np.where(events.p > 0, 1.0, -1.0)
    values = {"time": t_star(events, 1), "count": np.ones(len(events)), "polarity": polarity}
    for measure, f in values.items():
        made = events.event_spike_tensor(bins, measure=measure)  # type: ignore[arg-type]
        assert_same(made, published_est(events, bins, f))
    assert np.array_equal(made, events.event_spike_tensor(bins, measure="polarity"))


def test_time_surface(events: evis.EventArray) -> None:
    last = int(events.t[-1]) if len(events) else 0
    falls: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        "exponential": lambda age: np.exp(-age / 700.0),
        "linear": lambda age: np.maximum(0, 1 - age / 700.0),
    }
    for decay, fall in falls.items():
        keywords: dict[str, Any] = {"decay": decay}
        assert_same(events.time_surface(700, **keywords), published_surface(events, last, fall))
        # Between, at, before and after events.
        times = sorted({-200, last // 2, last, last + 500, *events.t[: len(events) // 3 : 700].tolist()})
        expected = np.stack([published_surface(events, t, fall) for t in times])
        assert_same(events.time_surface(700, at_us=times, **keywords), expected)
        assert_same(events.time_surface(700, at_us=times[0], **keywords), expected[0])


def test_averaged_timestamps(events: evis.EventArray) -> None:
    assert_same(events.averaged_timestamps(), published_average(events, 0))
    assert_same(events.averaged_timestamps(empty=-1.0), published_average(events, -1))
    missing = np.isnan(events.averaged_timestamps(empty=float("nan")))
    assert np.array_equal(missing, events.counts() == 0)


@pytest.mark.parametrize(("frames", "bits"), [(1, 8), (3, 3), (2, 1)])
def test_binary_stack_and_bina_rep(events: evis.EventArray, frames: int, bits: int) -> None:
    fired = published_bits(events, frames * bits)
    assert_same(events.binary_stack(frames * bits), fired, "uint8")
    # Barchid et al. 2022: N binary frames are the bits of a number, the first the most significant.
    powers = 2.0 ** np.arange(bits - 1, -1, -1)
    grouped = fired.reshape(frames, bits, *fired.shape[1:])
    assert_same(events.bina_rep(frames, bits), np.tensordot(powers, grouped, (0, 1)) / (2**bits - 1))


def test_the_last_instant_belongs_to_the_last_bin() -> None:
    events = evis.EventArray.from_columns([0, 100], [1, 2], [0, 0], [1, 1], width=4, height=1)
    grid = events.voxel_grid(bins=5)
    assert (grid[4, 0, 2], grid.sum()) == (1.0, 2.0)
    assert events.binary_stack(5)[4, 1, 0, 2] == 1
    # A window is half-open: an event at its end belongs to the next one.
    assert events.voxel_grid(bins=5, start_us=0, end_us=100).sum() == 1.0
    assert events.counts(start_us=100, end_us=101).sum() == 1
    assert events.counts(end_us=100).sum() == 1
    # With limits, bins are on them and not on events.
    assert events.voxel_grid(bins=5, start_us=0, end_us=200)[2, 0, 2] == 1.0
    assert events.averaged_timestamps(start_us=0, end_us=400)[1, 0, 2] == 0.25
    assert events.time_surface(100, end_us=200, decay="linear")[1, 0].tolist() == [0, 0, 0, 0]
    assert events.time_surface(200, end_us=200, decay="linear")[1, 0].tolist() == [0, 0, 0.5, 0]


# tonic


def tonic() -> Any:
    if os.environ.get("EVIS_READERS"):
        return importlib.import_module("tonic.transforms")
    return pytest.importorskip(
        "tonic.transforms", reason="tonic is not installed: make test-readers installs it"
    )


TONIC = ["ties", "davis", "720p"]


@pytest.mark.parametrize("name", TONIC)
@pytest.mark.parametrize("bins", [1, 5])
def test_voxel_grid_is_tonics(name: str, bins: int) -> None:
    transforms, events = tonic(), CASES[name]
    theirs = transforms.ToVoxelGrid((events.width, events.height, 2), bins)(events.to_numpy())[:, 0]
    # It scales times by B in the place of B - 1, and drops what would be in bin B.
    assert_same(events.voxel_grid(bins + 1)[:bins], theirs)
    assert not same(events.voxel_grid(bins), theirs), "canary"


@pytest.mark.parametrize("name", TONIC)
def test_counts_are_tonics(name: str) -> None:
    transforms, events = tonic(), CASES[name]
    size = (events.width, events.height, 2)
    assert_same(events.counts(), transforms.ToImage(size)(events.to_numpy()), "int32")
    frames = transforms.ToFrame(size, time_window=10, include_incomplete=False)(
        events.slice_time(-100, 0).to_numpy()
    )
    start = int(events.t[0])
    windows = list(events.windows(time_us=10, start_us=start, end_us=start + 10 * len(frames)))
    assert len(windows) >= 9
    assert_same(np.stack([window.counts() for window in windows]), frames, "int32")


@pytest.mark.parametrize("name", ["ties", "davis"])
def test_windows_by_count_are_tonics(name: str) -> None:
    tonic()
    from tonic.slicers import SliceByEventCount

    events = CASES[name]
    theirs, _ = SliceByEventCount(700, include_incomplete=True).slice(events.to_numpy(), None)
    ours = list(events.windows(count=700))
    # Theirs are all full: the last one overlaps the end.
    assert len(ours) == len(theirs)
    full = len(events) // 700
    assert full >= 4
    assert all(np.array_equal(a.to_numpy(), b) for a, b in zip(ours[:full], theirs[:full], strict=True))


@pytest.mark.parametrize("name", TONIC)
def test_time_surfaces_are_tonics(name: str) -> None:
    transforms, events = tonic(), CASES[name]
    size, length = (events.width, events.height, 2), 20 if name == "ties" else 1000
    theirs = transforms.ToTimesurface(size, dt=length, tau=500.0)(events.to_numpy())
    start = int(events.t[0])
    assert len(theirs) >= 5
    for k, expected in enumerate(theirs):
        at = start + (k + 1) * length
        # It leaves away what happens at the very time.
        assert_same(events.slice_time(start, at).time_surface(500, at_us=at), expected)


@pytest.mark.parametrize("name", TONIC)
@pytest.mark.parametrize(("frames", "bits"), [(1, 8), (2, 4)])
def test_bina_rep_is_tonics(name: str, frames: int, bits: int) -> None:
    transforms, events = tonic(), CASES[name]
    binary = transforms.ToFrame((events.width, events.height, 2), n_time_bins=frames * bits)(
        events.to_numpy()
    )
    # Its parts are of whole microseconds, and what is after the last one is left away.
    start = int(events.t[0])
    length = (int(events.t[-1]) - start) // (frames * bits)
    limits = {"start_us": start, "end_us": start + length * frames * bits}
    assert_same(events.binary_stack(frames * bits, **limits), np.minimum(binary, 1), "uint8")
    theirs = transforms.ToBinaRep(frames, bits)(binary)
    assert_same(events.bina_rep(frames, bits, **limits), theirs)


# Who has them


METHODS: dict[str, tuple[Any, ...]] = {
    "event_frame": (),
    "counts": (),
    "voxel_grid": (5,),
    "time_surface": (1000.0,),
    "event_spike_tensor": (4,),
    "averaged_timestamps": (),
    "binary_stack": (4,),
    "bina_rep": (1, 4),
}


@pytest.mark.parametrize("name", METHODS)
def test_functions_take_arrays_of_other_programs(name: str) -> None:
    events = CASES["davis"]
    expected = getattr(events, name)(*METHODS[name])
    assert expected.any()
    function = getattr(representations, name)
    packed = np.zeros(len(events), [("t", "<u8"), ("x", "<i4"), ("y", "<i4"), ("p", "?")])
    for field, column in zip("txyp", events.columns, strict=True):
        packed[field] = column - events.t[0] if field == "t" else column
    signed = {"x": events.x, "y": events.y, "t": events.t.tolist(), "p": 2 * events.p - 1}
    for other in (events.to_numpy(), packed, events.columns, list(events.columns), signed):
        for size in ((346, 260), [346, 260, 2], np.array([346, 260])):
            assert np.array_equal(function(other, *METHODS[name], sensor_size=size), expected)
    assert np.array_equal(function(events, *METHODS[name]), expected)
    larger = function(events, *METHODS[name], sensor_size=(400, 300))
    assert np.array_equal(larger[..., :260, :346], expected)
    assert larger.shape[-2:] == (300, 400)


@pytest.mark.parametrize("name", METHODS)
def test_everything_with_events_has_them(name: str, tmp_path: Path) -> None:
    events = evis.EventArray(random_events(7, 500, (40, 30)).slice_time(0, 5000), width=40, height=30)
    expected = getattr(events, name)(*METHODS[name])
    camera = evis.packets.CameraInfo("left", 40, 30, 1.0, 1.0, 1.0, 1.0)
    poses = evis.packets.Poses(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 4)))
    view = evis.packets.View(0, camera, events, {}, poses)
    packet = evis.Packet(0, 5000, (view,), None)  # type: ignore[arg-type]
    evis.save(tmp_path / "events.h5", events)
    evis.save(tmp_path / "events.raw", events)
    recording = evis.load(tmp_path / "events.h5")
    (file_packet,) = evis.open(tmp_path / "events.raw")
    carriers = [view, packet, packet[0], packet[0]["left"], recording, recording.view, file_packet]
    for carrier in carriers:
        assert np.array_equal(getattr(carrier, name)(*METHODS[name]), expected), type(carrier)
        lengths = [len(window) for window in carrier.windows(count=200)]  # type: ignore[attr-defined]
        assert lengths == [200, 200, len(events) - 400], type(carrier)
    limited = getattr(events, name)(*METHODS[name], start_us=1000, end_us=3000)
    assert not np.array_equal(limited, expected), "canary"
    fresh = evis.load(tmp_path / "events.h5")
    for carrier in (*carriers, fresh):
        made = getattr(carrier, name)(*METHODS[name], start_us=1000, end_us=3000)
        assert np.array_equal(made, limited), type(carrier)
    assert "events" not in fresh.view.__dict__, "of a file, only what is asked for is read"


def test_a_packet_of_several_cameras_asks_which() -> None:
    camera = evis.packets.CameraInfo("left", 40, 30, 1.0, 1.0, 1.0, 1.0)
    poses = evis.packets.Poses(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 4)))
    nothing = evis.EventArray(np.empty(0, evis.EventCD), width=40, height=30)
    views = [
        evis.packets.View(0, evis.packets.CameraInfo(name, 40, 30, 1.0, 1.0, 1.0, 1.0), nothing, {}, poses)
        for name in ("left", "right")
    ]
    packet = evis.Packet(0, 5000, tuple(views), None)  # type: ignore[arg-type]
    with pytest.raises(evis.EvisError, match=r"2 cameras \(left, right\): choose one"):
        packet.voxel_grid(bins=5)
    assert packet["left"].voxel_grid(bins=5).shape == (5, 30, 40)
    assert camera.width == 40


def test_the_simulator_gives_them_in_one_line(spinner: evis.Scene) -> None:
    for packet in evis.Simulator(spinner, size=(64, 48)).stream(duration=0.02):
        grid = packet.voxel_grid(bins=5)
        assert grid.shape == (5, 48, 64)
        assert_same(grid, published_voxel_grid(packet.view.events, 5))


# Windows


def test_windows_by_time_by_count_and_by_edges() -> None:
    columns = [5, 6, 6, 35], [0, 1, 1, 2], [0, 0, 0, 0], [1, 0, 1, 1]
    events = evis.EventArray.from_columns(*columns, width=3, height=1)

    def shown(**keywords: Any) -> list[tuple[int, int, list[int]]]:
        return [(w.start_us, w.end_us, w.t.tolist()) for w in events.windows(**keywords)]

    assert shown(time_us=20) == [(0, 20, [5, 6, 6]), (20, 36, [35])]
    assert shown(time_us=20, start_us=6, end_us=7) == [(6, 7, [6, 6])]
    assert shown(count=2) == [(5, 7, [5, 6]), (6, 36, [6, 35])]
    assert shown(count=3) == [(5, 7, [5, 6, 6]), (35, 36, [35])]
    assert shown(count=9, start_us=6, end_us=35) == [(6, 7, [6, 6])]
    assert shown(edges=[0, 6, 35, 36]) == [(0, 6, [5]), (6, 35, [6, 6]), (35, 36, [35])]
    assert shown(edges=np.array([6, 7, 9])) == [(6, 7, [6, 6]), (7, 9, [])]
    assert shown(edges=[]) == []
    window = next(events.windows(time_us=20))
    assert np.shares_memory(window.to_numpy(), events.to_numpy())
    assert window == events.slice_time(0, 20)
    assert repr(window) == "EventWindow(3 events, [0, 20) us, 3x1)"
    copy = pickle.loads(pickle.dumps(window))
    assert (copy, copy.start_us, copy.end_us) == (window, 0, 20)
    empty = evis.EventArray(np.empty(0, evis.EventCD), width=3, height=1)
    assert list(empty.windows(count=2)) == []
    assert [len(w) for w in empty.windows(edges=[0, 5, 9])] == [0, 0]


def test_windows_tile_what_there_is() -> None:
    for events in CASES.values():
        for keywords in ({"time_us": 33}, {"count": 77}):
            parts = [window.to_numpy() for window in events.windows(**keywords)]
            whole = np.concatenate([np.empty(0, evis.EventCD), *parts])
            assert np.array_equal(whole, events.to_numpy())
            assert len(parts) > 1 or len(events) < 77


# Errors


def test_events_that_cannot_be_used_are_named() -> None:
    good = CASES["davis"]
    for name, arguments in METHODS.items():
        function = getattr(representations, name)

        def refusal(
            size: tuple[int, int] = (346, 260),
            function: Callable[..., Any] = function,
            arguments: tuple[Any, ...] = arguments,
            **columns: tuple[int, int],
        ) -> str:
            changed = {
                field: column.astype(np.int64) for field, column in zip("txyp", good.columns, strict=True)
            }
            for field, (index, value) in columns.items():
                changed[field][index] = value
            with pytest.raises(evis.ConfigError) as caught:
                function(changed, *arguments, sensor_size=size)
            return str(caught.value)

        assert "event 9000 lies at x = 346, y = " in refusal(x=(9000, 346))
        assert "outside of the sensor of 346x260 pixels" in refusal(y=(19_999, 260))
        assert "event 123 has polarity 2; it must be 1 for ON, and 0 or -1 for OFF" in refusal(p=(123, 2))
        assert "event 500 is at -101 us, after one at " in refusal(t=(500, -101))
        assert f"event 0 is at {-(1 << 60)} us; times must be within" in refusal(t=(0, -(1 << 60)))
        assert "x holds a value that does not fit uint16: -1 of event 77" in refusal(x=(77, -1))
        assert "sensor_size" in refusal(size=(0, 5))
    unsorted = good.to_numpy()[::-1]
    with pytest.raises(
        evis.ConfigError, match=r"not sorted by t: event \d+ is at \d+ us, after one at \d+ us; sort them"
    ):
        evis.EventArray(unsorted, width=346, height=260)
    with pytest.raises(evis.ConfigError, match=r"event \d+ is at -?\d+ us, after one at"):
        representations.counts(unsorted, sensor_size=(346, 260), start_us=0)


def test_settings_that_cannot_be_used_are_refused() -> None:
    events = CASES["davis"]
    refusals: list[tuple[Callable[[], object], str]] = [
        (lambda: events.voxel_grid(0), "bins is 0; it must be between 1 and"),
        (lambda: events.voxel_grid(2.5), "bins is 2.5; it must be a whole number"),  # type: ignore[arg-type]
        (lambda: events.voxel_grid(5, polarity="both"), "it must be 'signed' or 'split'"),  # type: ignore[arg-type]
        (lambda: events.voxel_grid(5, normalize="yes"), "normalize is 'yes'"),  # type: ignore[arg-type]
        (
            lambda: events.voxel_grid(5, start_us=7, end_us=7),
            "end_us is 7; it must be after start_us, which is 7",
        ),
        (lambda: events.voxel_grid(5, start_us=1 << 60), "start_us is 1152921504606846976"),
        (lambda: events.voxel_grid(5, end_us=0.5), "end_us is 0.5"),  # type: ignore[arg-type]
        (lambda: events.voxel_grid(2**31), "values is too large"),
        (lambda: events.event_spike_tensor(1), "bins is 1"),
        (lambda: events.event_spike_tensor(5, measure="x"), "'time' or 'count' or 'polarity'"),  # type: ignore[arg-type]
        (lambda: events.time_surface(0), "tau_us is 0"),
        (lambda: events.time_surface(float("nan")), "tau_us is NaN"),
        (
            lambda: events.time_surface(5, at_us=[3, 2]),
            "at_us is 2; it must be after the time before it, 3 us",
        ),
        (lambda: events.time_surface(5, at_us="now"), "at_us are sequences"),  # type: ignore[arg-type]
        (lambda: events.time_surface(5, decay="square"), "'exponential' or 'linear'"),  # type: ignore[arg-type]
        (lambda: events.averaged_timestamps(empty="x"), "empty is 'x'"),  # type: ignore[arg-type]
        (lambda: events.binary_stack(0), "bins is 0"),
        (lambda: events.bina_rep(0, 8), "frames is 0"),
        (lambda: events.bina_rep(1, 25), "bits is 25; it must be between 1 and 24"),
        (lambda: events.windows(), "one of time_us, count and edges; none of them is given"),
        (lambda: events.windows(10, count=5), "time_us and count is given"),
        (lambda: events.windows(count=0), "count is 0"),
        (lambda: events.windows(edges=[3, 3]), "edges has 3 after 3; edges must ascend"),
        (lambda: events.windows(edges=[3, 4], end_us=5), "leave start_us and end_us away"),
        (lambda: representations.counts(events.to_numpy()), "sensor_size is not given"),
        (lambda: representations.counts({"x": [1]}, sensor_size=(4, 4)), "must have t, x, y and p"),
        (lambda: representations.counts(([1], [1]), sensor_size=(4, 4)), "sequence of 2"),  # type: ignore[arg-type]
        (lambda: representations.counts(([0.5], [1], [1], [1]), sensor_size=(4, 4)), "t has dtype float64"),
        (lambda: representations.counts(np.zeros(3), sensor_size=(4, 4)), "fields x, y, p, t"),  # type: ignore[arg-type]
        (lambda: representations.counts(events, sensor_size=(4, 4, 9)), "width and height in pixels"),
    ]
    for refuse, expected in refusals:
        with pytest.raises(evis.ConfigError) as caught:
            refuse()
        assert expected in str(caught.value)


# Tensors


def test_they_go_through_dlpack_without_a_copy() -> None:
    for name, arguments in METHODS.items():
        made = getattr(CASES["ties"], name)(*arguments)
        taken = np.from_dlpack(made)
        assert np.shares_memory(taken, made)
        assert made.flags.writeable


def test_to_torch_shares_memory() -> None:
    torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install torch")
    grid = CASES["ties"].voxel_grid()
    tensor = representations.to_torch(grid)
    assert tensor.dtype == torch.float32
    tensor[0, 0, 0] = 42.0
    assert grid[0, 0, 0] == 42.0
    assert representations.to_torch(grid, device="cpu").device.type == "cpu"


def test_without_torch_the_error_says_what_to_install() -> None:
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "import evis, numpy as np\n"
        "try: evis.representations.to_torch(np.zeros(3))\n"
        "except evis.EvisError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "PyTorch is not installed; install it: pip install torch\n"
