"""Charts from Python: measured, drawn, recommended from."""

from __future__ import annotations

import json
import sys
from dataclasses import FrozenInstanceError, replace
from pathlib import Path
from typing import Any

import pytest
from test_gil import interrupted

import evis

TINY: dict[str, Any] = {
    "size": (32, 24),
    "duration": 0.02,
    "rates_hz": [100, 500],
    "samples": [4],
    "edges": False,
    "splat": False,
    "adaptive": False,
    "repetitions": 2,
    "truth_pixels": 120,
    "cache": False,
    # So small a picture moves little: only a keen sensor sees it.
    "sensor": evis.Sensor(threshold_on=0.05, threshold_off=0.05),
}


@pytest.fixture(scope="module")
def made(device: evis.Device) -> evis.measure.Chart:
    return evis.chart(evis.Scene.builtin("spinner"), **TINY)


def test_points_are_typed_and_scored(made: evis.measure.Chart):
    scene = made.scenes[0]
    assert (scene.scene, scene.width, scene.height, scene.duration_us) == ("spinner", 32, 24, 20_000)
    names = [point.setting.published for point in made.points]
    assert names[:3] == [None, None, "paper 1000 Hz"]
    assert [name and name.split()[1][:2] for name in names[3:]] == ["25", "12", "40", "30"]
    assert scene.floor is not None
    assert scene.floor.at(1000).scaled.f1 > max(point.f1() for point in made.points)
    assert scene.not_measured == ()
    assert made.points[-1].setting.method == "evis-paper"
    assert made.points[-1].setting.splat == evis.Warp(variant="evis-paper", keyframe_hz=30.0, steps=8)
    point = made.points[0]
    assert len(point.wall_ms_per_s) == 2
    assert point.cost_ms(render_ms=10.0) == pytest.approx(point.cost_ms() + 10.0 * 100)
    assert point.score.truth_events == scene.truth_events > 0
    assert 0 < scene.truth_firing <= min(scene.truth_pixels, scene.truth_events)
    with pytest.raises(FrozenInstanceError):
        point.events = 0  # type: ignore[misc]


def test_charts_are_drawn_joined_and_read_again(made: evis.measure.Chart, tmp_path: Path):
    made.save(tmp_path / "a.svg")
    assert "charged" not in (tmp_path / "a.svg").read_text()
    evis.measure.Chart.of([made, made]).save(tmp_path / "b.svg", render_ms=10.0, tolerance_us=100)
    text = (tmp_path / "b.svg").read_text()
    assert "charged 10 ms" in text
    assert "within 100 µs" in text
    made.save(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    (tmp_path / "r.json").write_text(made.to_json())
    assert evis.measure.Chart.load(tmp_path / "r.json").points == made.points
    with pytest.raises(evis.ConfigError, match=r"\.png or \.svg"):
        made.save(tmp_path / "a.pdf")
    with pytest.raises(FileNotFoundError):
        made.save(tmp_path / "no" / "a.svg")
    older = json.loads(made.to_json())
    del older["scenes"][0]["truth"]["firing"]
    assert evis.measure.Chart.from_json(json.dumps(older)).scenes[0].truth_firing == 0
    newer = json.dumps({**json.loads(made.to_json()), "evis_chart": 9})
    with pytest.raises(evis.FormatError, match="version 9"):
        evis.measure.Chart.from_json(newer)


def test_a_recommendation_can_be_simulated(made: evis.measure.Chart):
    found = made.recommend(budget_ms=1e9)
    assert found.f1 == max(point.f1() for point in made.points)
    assert found.command.startswith("evis run spinner -o events.h5 --size 32x24")
    sim = evis.Simulator(evis.Scene.builtin("spinner"), size=(32, 24), **found.simulator)
    assert len(sim.step(20_000).events) > 0
    adaptive = replace(found.setting, method="native", rate_hz=1000.0, adaptive_px=0.3, samples=4)
    found = replace(found, setting=adaptive)
    sim = evis.Simulator(evis.Scene.builtin("spinner"), size=(32, 24), **found.simulator)
    assert sim.method == "native"
    with pytest.raises(evis.ConfigError, match="the cheapest is"):
        made.recommend(budget_ms=1e-3)
    with pytest.raises(evis.ConfigError, match="one goal"):
        made.recommend()
    with pytest.raises(evis.ConfigError, match="scene is 3"):
        made.recommend(budget_ms=1e9, scene=3)


def test_what_cannot_be_measured_is_told(spinner: evis.Scene):
    with pytest.raises(evis.ConfigError, match="nobody"):
        evis.chart(spinner, **{**TINY, "camera": "nobody"})
    with pytest.raises(evis.ConfigError, match="rates is 0"):
        evis.chart(spinner, **{**TINY, "rates_hz": [0]})
    with pytest.raises(evis.ConfigError, match="fires within"):
        evis.chart(spinner, **{**TINY, "sensor": evis.Sensor(threshold_on=50.0, threshold_off=50.0)})
    with pytest.raises(evis.ConfigError, match="at least one"):
        evis.measure.Chart.of([])


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
def test_ctrl_c_ends_a_chart(device: evis.Device):
    text = interrupted(
        """
        import evis

        print("ready", flush=True)
        try:
            evis.chart(evis.Scene.builtin("warehouse"), truth_pixels=None, cache=False)
        except KeyboardInterrupt:
            print("stopped", flush=True)
        """
    )
    assert "stopped" in text
