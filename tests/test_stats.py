"""Statistics, calibration and comparison."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import evis


def noisy(**noise: float) -> evis.Sensor:
    return replace(evis.Sensor(), noise=evis.sensors.Noise(**noise))  # type: ignore[arg-type]


def test_statistics_count_what_is_there() -> None:
    t = np.arange(100, dtype=np.int64) * 10_000
    p = (np.arange(100) % 2).astype(np.int16)
    events = evis.EventArray.from_columns(
        t=t, x=np.zeros(100, np.uint16), y=np.zeros(100, np.uint16), p=p, width=4, height=2
    )
    got = evis.statistics(events)
    assert (got.events, got.hot_pixels, got.hot_share, got.silent_share) == (100, 1, 1 / 8, 7 / 8)
    assert got.least_interval_us == 10_000
    assert got.duration_s == pytest.approx(0.990001)
    assert got.pairs == 0
    slow = evis.statistics(
        evis.EventArray.from_columns(
            t=t * 10, x=np.zeros(100, np.uint16), y=np.zeros(100, np.uint16), p=p, width=4, height=2
        )
    )
    assert (slow.hot_pixels, slow.pairs, slow.alternation) == (0, 99, 1.0)
    assert slow.interval_quantiles_us is not None
    assert slow.interval_quantiles_us[2] == 100_000
    with pytest.raises(evis.ConfigError, match="no events"):
        evis.statistics(evis.EventArray(np.empty(0, evis.EventCD), width=4, height=2))


def test_a_calibration_finds_its_noise(tmp_path: Path) -> None:
    events = evis.measure.static_scene(
        noisy(shot_hz=2.0, on_share=0.7, hot_share=0.01, hot_hz=90), 64, 48, duration=4.0
    )
    made = evis.calibrate(events, base="v2e-clean")
    assert made.sensor.noise.shot_hz == pytest.approx(2.0, rel=0.06)
    assert made.sensor.noise.on_share == pytest.approx(0.7, abs=0.03)
    assert made.sensor.noise.hot_hz == pytest.approx(90, rel=0.1)
    assert made.sensor.threshold_on == evis.Sensor.preset("v2e-clean").threshold_on
    assert made.recording is not None
    assert made.simulated is not None
    assert made.simulated.cold_rate_hz == pytest.approx(made.recording.cold_rate_hz, rel=0.05)
    assert "not to be had" in str(made)
    assert any("thresholds" in line for line in made.unknown)
    (tmp_path / "s.toml").write_text(made.sensor.to_toml())
    assert evis.Sensor.from_toml(tmp_path / "s.toml") == made.sensor
    evis.save(tmp_path / "a.npz", events)
    assert evis.calibrate(tmp_path / "a.npz", base="v2e-clean").sensor == made.sensor
    with pytest.raises(evis.ConfigError, match="record longer"):
        evis.calibrate(evis.EventArray(events.to_numpy()[:50], width=64, height=48))
    with pytest.raises(evis.ConfigError, match="one"):
        evis.calibrate([events, events])


def test_a_still_scene_has_the_light_that_a_preset_was_fitted_in() -> None:
    """In the dark, the noise of ``dvxplorer-like`` is that of its recording; 0.9 of it goes with light."""

    def rate_hz(sensor: evis.Sensor | str, **keywords: float) -> float:
        events = evis.measure.static_scene(sensor, 64, 48, duration=4.0, **keywords)
        rate = evis.statistics(events, duration=4.0).cold_rate_hz
        assert rate is not None
        return rate

    assert rate_hz("dvxplorer-like") == rate_hz("dvxplorer-like", light=0.0)
    assert rate_hz("dvxplorer-like", light=1.0) < 0.5 * rate_hz("dvxplorer-like")
    own = evis.Sensor.preset("dvxplorer-like")
    louder = replace(own, noise=replace(own.noise, shot_hz=1.0))
    assert rate_hz(louder) == rate_hz(louder, light=0.18)


def test_flicker_shows_thresholds() -> None:
    sensor = evis.Sensor(threshold_on=0.15, threshold_off=0.25)
    emulator = evis.EventEmulator(8, 6, sensor)
    parts = []
    for k in range(2000):
        light = 0.3 * (1 + 0.6 * np.sin(2 * np.pi * 4 * k * 1e-3 + 0.7))
        parts.append(emulator.push(np.full((6, 8), light, np.float32), 1000 * k).to_numpy())
    events = evis.EventArray(np.concatenate(parts), width=8, height=6)
    made = evis.calibrate(events, stimulus=(4, 0.6))
    assert made.sensor.threshold_on == pytest.approx(0.15, rel=0.03)
    assert made.sensor.threshold_off == pytest.approx(0.25, rel=0.03)
    assert made.cutoff_hz is None
    assert made.flicker[0].hz == 4
    assert "second frequency" in made.unknown[0]
    with pytest.raises(evis.ConfigError, match="contrast"):
        evis.calibrate(events, stimulus=(4, 1.5))
    with pytest.raises(evis.ConfigError, match="one per source"):
        evis.calibrate(events, stimulus=[(4, 0.6), (8, 0.6)])


def test_two_recordings_side_by_side(tmp_path: Path) -> None:
    a = evis.measure.static_scene(noisy(shot_hz=3.0), 64, 48, duration=2.0)
    b = evis.measure.static_scene(noisy(shot_hz=1.0, burst_events=0.5), 64, 48, duration=2.0, seed=1)
    evis.save(tmp_path / "b.npz", b)
    comparison = evis.compare(a, tmp_path / "b.npz")
    assert comparison.a.cold_rate_hz == pytest.approx(3 * comparison.b.cold_rate_hz, rel=0.1)
    assert comparison.b.fano > comparison.a.fano + 0.5
    assert "b.npz" in str(comparison)
    assert json.loads(comparison.to_json())["a"]["stats"]["events"] == len(a)
    comparison.save(tmp_path / "c.svg")
    comparison.save(tmp_path / "c.png")
    assert "intervals" in (tmp_path / "c.svg").read_text()
    assert (tmp_path / "c.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(evis.ConfigError, match=r"\.png or \.svg"):
        comparison.save(tmp_path / "c.gif")


def test_a_recording_is_read_alike_from_python_and_from_the_command(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assets = os.environ.get("EVIS_ASSETS")
    if assets is None:
        pytest.skip("EVIS_ASSETS names no folder with recordings")
    path = Path(assets) / "recordings" / "dvxplorer_dark_640x480.npz"
    from evis import _evis

    assert _evis.run_cli(["evis", "compare", str(path), str(path), "--duration", "0.5", "--json"]) == 0
    told = json.loads(capfd.readouterr().out)
    comparison = evis.compare(path, path, duration=0.5)
    assert told["a"]["stats"] == json.loads(comparison.to_json())["a"]["stats"]
    assert comparison.a.events > 50_000
