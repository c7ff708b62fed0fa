"""Scores of streams, pictures and flow whose values can be said beforehand, and truth as a file."""

from __future__ import annotations

import dataclasses
import json
import threading
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

import evis
from evis import metrics

SENSOR = evis.Sensor(threshold_on=0.25, threshold_off=0.2)


def some_truth(count: int = 400, *, sensor: evis.Sensor | None = SENSOR) -> evis.Truth:
    """Events 20 ms apart in each of eight pixels."""
    k = np.arange(count)
    t, x, p = 5000 + k // 8 * 20_000 + k % 8 * 311, k % 8, k % 3 == 0
    events = evis.EventArray.from_columns(t, x, np.zeros(count, int), p, width=8, height=2)
    return evis.Truth.from_events(events, sensor=sensor, duration_us=2_000_000)


def moved(events: evis.EventArray, by_us: int) -> evis.EventArray:
    t, x, y, p = events.columns
    return evis.EventArray.from_columns(t + by_us, x, y, p, width=events.width, height=events.height)


def test_a_late_stream_has_a_bias():
    truth = some_truth()
    score = metrics.score(moved(truth.events, 400), truth, sensor=SENSOR)
    plain = score.at(1000).plain
    assert (plain.f1, plain.matched, plain.missed, plain.spurious) == (1.0, 400, 0, 0)
    assert plain.time_error is not None
    assert plain.time_error.bias_us == plain.time_error.rms_us == plain.time_error.median_us == 400
    assert (score.at(300).plain.f1, score.at(300).plain.time_error) == (0.0, None)
    assert (score.exact_sequence, score.fired_pixels, score.pixels) == (1.0, 8, 16)
    region = plain.region("interior")
    assert region is not None
    assert region.f1 == 1.0
    assert plain.region("silhouette") is None
    with pytest.raises(evis.ConfigError, match="1000, 300, 100"):
        score.at(5)


def test_percentiles_are_numpys():
    truth = some_truth()
    errors = np.random.default_rng(1).integers(-900, 900, len(truth.events))
    t, x, y, p = truth.events.columns
    order = np.argsort(t + errors, kind="stable")
    stream = evis.EventArray.from_columns(
        (t + errors)[order], x[order], y[order], p[order], width=8, height=2
    )
    found = metrics.score(stream, truth).at(1000).plain.time_error
    assert found is not None
    assert found.median_us == pytest.approx(np.median(np.abs(errors)))
    assert found.p95_us == pytest.approx(np.percentile(np.abs(errors), 95))
    assert found.rms_us == pytest.approx(np.sqrt(np.mean(errors.astype(float) ** 2)))
    assert found.bias_us == pytest.approx(np.mean(errors))


def test_a_score_is_frozen_printed_and_stored():
    truth = some_truth()
    score = metrics.score(truth.events, truth, tolerances_us=[700])
    with pytest.raises(dataclasses.FrozenInstanceError):
        score.events = 3  # type: ignore[misc]
    assert "700 us plain     1.0000" in str(score)
    assert metrics.Score.from_json(score.to_json(indent=1)) == score
    assert score.to_dict() == json.loads(score.to_json())
    assert metrics.Score.from_json(score.to_json()) != metrics.score(truth.events, truth), "canary"
    for bad in ("", "[]", "{}", '{"tolerances": []}'):
        with pytest.raises(evis.FormatError, match="not the JSON of a score"):
            metrics.Score.from_json(bad)


def test_speed_and_regions_reach_the_score():
    events = some_truth().events
    count = len(events)
    truth = evis.Truth.from_events(
        events,
        duration_us=2_000_000,
        speed=np.full(count, 25.0),
        event_region=np.arange(count) % 2 * 3,
    )
    level = metrics.score(moved(events, 3000), truth).at(1000)
    assert (level.plain.f1, level.scaled.f1) == (0.0, 1.0)
    shadow = level.scaled.region("shadow_edge")
    assert shadow is not None
    assert shadow.truth_events == count // 2
    np.testing.assert_array_equal(truth.event_region[:4], [0, 3, 0, 3])
    assert metrics.REGIONS[3] == "shadow_edge"


def test_truth_comes_back_from_its_file(tmp_path: Path):
    made = some_truth()
    t, x, _, p = made.events.columns
    truth = evis.Truth.from_events(
        made.events.to_numpy(),
        size=(8, 2),
        sensor=SENSOR,
        duration_us=2_000_000,
        reference_luminance=0.5,
        pixels=[[k, 0] for k in range(8)],
        speed=np.arange(len(t)),
        event_region=p,
        provenance='{"from": "a test"}',
    )
    path = truth.save(tmp_path / "truth.h5")
    with pytest.raises(FileExistsError):
        truth.save(path)
    back = evis.measure.load_truth(path)
    assert back.events == truth.events
    for name in ("pixels", "speed", "event_region", "span_start", "span_t_us", "span_region"):
        np.testing.assert_array_equal(getattr(back, name), getattr(truth, name), err_msg=name)
    assert back.sensor.threshold_on == pytest.approx(0.25)
    assert (back.duration_us, back.reference_luminance) == (2_000_000, 0.5)
    assert (back.provenance, back.camera.width) == ('{"from": "a test"}', 8)
    assert (back.pixels.dtype, back.speed.dtype, back.span_t_us.dtype) == (np.uint16, np.float32, np.int64)
    assert "400 events, 8 pixels of 8x2" in repr(back)
    # It is a recording too, and plain HDF5.
    assert evis.load(path).events == truth.events
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file["truth/pixels"], truth.pixels)
        np.testing.assert_array_equal(file["truth/speed"], truth.speed)
        np.testing.assert_array_equal(file["truth/event_region"], p)
        np.testing.assert_array_equal(file["events/x"], x)
        assert file["truth/duration_us"][()] == 2_000_000
        assert file["truth/threshold_off"][()] == np.float32(0.2)
        assert file["truth/provenance_json"].asstr()[0] == '{"from": "a test"}'


def test_sampled_light_is_told_from_truth():
    truth = some_truth()
    assert truth.sampled_hz is None
    sampled = evis.Truth.from_events(
        truth.events, duration_us=2_000_000, provenance='{"settings": {"sampled_hz": 500.0}}'
    )
    assert sampled.sampled_hz == 500.0
    with pytest.warns(UserWarning, match="no truth but exact light sampled at 500 Hz"):
        score = metrics.score(truth.events, sampled)
    assert score.at(1000).plain.f1 == 1.0


def test_files_and_arrays_score_alike(tmp_path: Path):
    truth = some_truth(sensor=None)
    events = moved(truth.events, 50)
    evis.save(tmp_path / "a.h5", {"left": events, "right": moved(events, 5000)})
    evis.save(tmp_path / "a.npz", events)
    evis.save(tmp_path / "a.npy", events)
    truth.save(tmp_path / "truth.h5")
    expected = metrics.score(events, truth)
    assert metrics.score(events.to_numpy(), truth) == expected
    assert metrics.score(tmp_path / "a.npz", tmp_path / "truth.h5") == expected
    assert metrics.score(str(tmp_path / "a.npy"), truth) == expected
    assert metrics.score(tmp_path / "a.h5", truth, camera="left") == expected
    assert metrics.score(evis.load(tmp_path / "a.h5"), truth, camera="left") == expected
    assert metrics.score(tmp_path / "a.h5", truth, camera="right") != expected, "canary"
    with pytest.raises(evis.EvisError, match="left, right"):
        metrics.score(tmp_path / "a.h5", truth)
    itself = metrics.score(tmp_path / "a.h5", tmp_path / "a.h5", camera="right")
    assert itself.at(100).plain.f1 == 1.0


def test_what_does_not_belong_together_is_refused(tmp_path: Path):
    truth = some_truth()
    other_size = evis.EventArray.from_columns([5], [0], [0], [1], width=9, height=2)
    with pytest.raises(evis.ConfigError, match="9x2 pixels, the truth's 8x2"):
        metrics.score(other_size, truth)
    with pytest.raises(evis.ConfigError, match=r"threshold_on = 0.3, the truth with 0.25"):
        metrics.score(truth.events, truth, sensor=evis.Sensor(threshold_on=0.3))
    unsorted = truth.events.to_numpy()[::-1]
    with pytest.raises(evis.ConfigError, match="not sorted by time: event 1 at"):
        metrics.score(unsorted, truth)
    for tolerances in ([], [0], [10_000_000]):
        with pytest.raises(evis.ConfigError, match="tolerances_us"):
            metrics.score(truth.events, truth, tolerances_us=tolerances)
    silent = evis.Truth.from_events(np.empty(0, evis.EventCD), size=(8, 2), duration_us=100)
    with pytest.raises(evis.ConfigError, match=r"has no events .* the stream has 400 events"):
        metrics.score(truth.events, silent)
    with pytest.raises(evis.ConfigError, match="size is missing"):
        evis.Truth.from_events(truth.events.to_numpy())
    with pytest.raises(evis.ConfigError, match="outside its interval"):
        evis.Truth.from_events(truth.events, duration_us=10)
    with pytest.raises(evis.ConfigError, match="3 speeds"):
        evis.Truth.from_events(truth.events, speed=[1, 2, 3])
    with pytest.raises(evis.ConfigError, match="0 to 3"):
        evis.Truth.from_events(truth.events, event_region=np.full(400, 7))
    with pytest.raises(evis.ConfigError, match="does not fit"):
        evis.Truth.from_events(truth.events, pixels=[[-1, 0]])
    with pytest.raises(evis.ConfigError, match=r"\(N, 2\)"):
        evis.Truth.from_events(truth.events, pixels=[[1, 0, 2]])
    with pytest.raises(FileNotFoundError):
        evis.measure.load_truth(tmp_path / "missing.h5")
    (tmp_path / "text.h5").write_text("no HDF5")
    with pytest.raises(evis.FormatError, match="HDF5"):
        evis.measure.load_truth(tmp_path / "text.h5")


def test_voxel_grids_follow_their_formula():
    random = np.random.default_rng(3)

    def noise(count: int) -> evis.EventArray:
        t = np.sort(random.integers(0, 60_000, count))
        x, y, p = (random.integers(0, limit, count) for limit in (4, 3, 2))
        return evis.EventArray.from_columns(t, x, y, p, width=4, height=3)

    def grid(events: evis.EventArray) -> np.ndarray:
        made = np.zeros((3, 5, 3, 4))
        for t, x, y, p in zip(*(column.tolist() for column in events.columns), strict=True):
            place = 4 * (t % 20_000) / 20_000
            made[t // 20_000, :, y, x] += (2 * p - 1) * np.maximum(0, 1 - np.abs(np.arange(5) - place))
        return made

    stream, right = noise(300), noise(280)
    truth = evis.Truth.from_events(right, duration_us=60_000)
    expected = np.abs(grid(stream) - grid(right)).sum() / np.abs(grid(right)).sum()
    assert metrics.voxel_l1(stream, truth) == pytest.approx(expected)
    assert metrics.voxel_l1(right, truth) == 0.0
    assert metrics.score(stream, truth).voxel_l1 == metrics.voxel_l1(stream, truth)


def slow_ssim(a: np.ndarray, b: np.ndarray, data_range: float) -> float:
    """Wang et al. 2004, window by window."""
    offsets = np.arange(11) - 5
    weights = np.exp(-(offsets[:, None] ** 2 + offsets**2) / (2 * 1.5**2))
    weights /= weights.sum()
    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    found = []
    for y in range(a.shape[0] - 10):
        for x in range(a.shape[1] - 10):
            p, q = a[y : y + 11, x : x + 11], b[y : y + 11, x : x + 11]
            mp, mq = (weights * p).sum(), (weights * q).sum()
            vp, vq = (weights * (p - mp) ** 2).sum(), (weights * (q - mq) ** 2).sum()
            cov = (weights * (p - mp) * (q - mq)).sum()
            found.append((2 * mp * mq + c1) * (2 * cov + c2) / ((mp**2 + mq**2 + c1) * (vp + vq + c2)))
    return float(np.mean(found))


def test_pictures_are_compared_by_their_formulas():
    random = np.random.default_rng(4)
    a, b = random.random((2, 17, 23, 3)).astype(np.float32)
    expected = np.mean([slow_ssim(a[..., k].astype(float), b[..., k].astype(float), 1.0) for k in range(3)])
    assert metrics.ssim(a, b, data_range=1.0) == pytest.approx(expected, abs=1e-9)
    assert metrics.ssim(a[..., 0], a[..., 0], data_range=1.0) == pytest.approx(1.0)
    assert metrics.ssim(a, b, data_range=1.0) < 0.5, "canary"
    error = np.mean((a.astype(float) - b) ** 2)
    assert metrics.mse(a, b) == pytest.approx(error)
    assert metrics.psnr(a, b, data_range=1.0) == pytest.approx(-10 * np.log10(error))
    assert metrics.psnr(a, a, data_range=1.0) == np.inf
    bytes_a, bytes_b = (a * 255).astype(np.uint8), (b * 255).astype(np.uint8)
    assert metrics.mse(bytes_a, bytes_b) == pytest.approx(np.mean((bytes_a.astype(float) - bytes_b) ** 2))
    # Views that are not contiguous are taken too.
    assert metrics.mse(a[::2, ::-1], b[::2, ::-1]) == pytest.approx(
        np.mean((a[::2].astype(float) - b[::2]) ** 2)
    )
    with pytest.raises(evis.ConfigError, match="one size"):
        metrics.mse(a, b[:16])
    with pytest.raises(evis.ConfigError, match="at least 11"):
        metrics.ssim(a[:10], b[:10], data_range=1.0)
    with pytest.raises(evis.ConfigError, match="data_range is 0"):
        metrics.psnr(a, b, data_range=0)
    with pytest.raises(evis.ConfigError, match="H, W"):
        metrics.mse(a[0, 0], b[0, 0])
    broken = a.copy()
    broken[2, 5, 1] = np.nan
    with pytest.raises(evis.ConfigError, match="the reference is NaN at x = 5, y = 2"):
        metrics.mse(a, broken)


def test_flow_is_compared_where_it_is_defined():
    reference = np.zeros((4, 5, 2), np.float32)
    flow = reference.copy()
    # Distances 0, 2, 4 and 6 in the four rows.
    flow[:, :, 0] = (2 * np.arange(4) * 0.6)[:, None]
    flow[:, :, 1] = (2 * np.arange(4) * 0.8)[:, None]
    error = metrics.endpoint_error(flow, reference)
    assert error.pixels == 20
    assert (error.mean, error.median) == (pytest.approx(3.0), pytest.approx(3.0))
    assert (error.below_1px, error.below_3px, error.below_5px) == (0.25, 0.5, 0.75)
    flow[0] = np.nan
    mask = np.ones((4, 5), bool)
    mask[0] = False
    error = metrics.endpoint_error(flow, reference, mask=mask)
    assert (error.pixels, error.mean, error.median) == (15, pytest.approx(4.0), pytest.approx(4.0))
    with pytest.raises(evis.ConfigError, match="mask out"):
        metrics.endpoint_error(flow, reference)
    with pytest.raises(evis.ConfigError, match="no pixel"):
        metrics.endpoint_error(flow, reference, mask=np.zeros((4, 5)))
    with pytest.raises(evis.ConfigError, match=r"\(H, W, 2\)"):
        metrics.endpoint_error(flow, reference[:3])
    with pytest.raises(evis.ConfigError, match="mask has shape"):
        metrics.endpoint_error(flow, reference, mask=mask[:3])


def test_scoring_releases_the_gil():
    k = np.arange(1_500_000)
    events = evis.EventArray.from_columns(k, k * 7 % 320, k * 13 % 240, k % 2, width=320, height=240)
    truth = evis.Truth.from_events(events)
    done = threading.Event()

    def work() -> None:
        metrics.score(events, truth)
        done.set()

    thread = threading.Thread(target=work)
    thread.start()
    turns = 0
    while not done.is_set():
        time.sleep(0.001)
        turns += 1
    thread.join()
    assert turns > 20, "nothing else could run meanwhile"
