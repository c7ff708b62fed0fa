"""Reports of convergence from Python."""

from __future__ import annotations

from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest

import evis


def test_the_triggers_converge_as_theory_says(tmp_path: Path):
    report = evis.verify()
    assert report.passed
    assert repr(report) == "Verification(18 of 18 pass)"
    assert str(report).endswith("18 of 18 rows PASS")
    rows = {(check.signal, check.trigger): check for check in report.checks}
    crossing, latch = (rows["sinusoid", t] for t in ("crossing", "latch"))
    for check, order in ((crossing, 2.0), (latch, 1.0)):
        assert check.expected_order == order
        assert check.order == pytest.approx(order, abs=0.25)
    assert latch.order != pytest.approx(2.0, abs=0.5), "canary"
    ramp = rows["exponential ramp", "crossing"]
    assert (ramp.signal_class, ramp.theory, ramp.expected_order) == ("ramp", "exact", None)
    assert all(row.rms_us is not None and row.rms_us < 1.0 for row in ramp.rows)
    assert ramp.rows[0].interval_s == pytest.approx(1 / 250)
    with pytest.raises(FrozenInstanceError):
        ramp.fault = "no"  # type: ignore[misc]
    report.save(tmp_path / "a.svg")
    assert "order 2" in (tmp_path / "a.svg").read_text()
    report.save(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(evis.ConfigError, match=r"\.png or \.svg"):
        report.save(tmp_path / "a.pdf")


def test_a_scene_is_measured(spinner: evis.Scene, tmp_path: Path):
    report = evis.measure.verify_scene(
        spinner,
        size=(32, 24),
        duration=0.02,
        truth_pixels=120,
        rates_hz=[250, 500, 1000, 2000],
        samples=[4],
        triggers=["crossing", "latch"],
        sensor=evis.Sensor(threshold_on=0.05, threshold_off=0.05),
        cache=False,
    )
    chart = report.chart
    assert (chart.scene, chart.width, len(chart.points)) == ("spinner", 32, 8)
    assert chart.floor is not None
    assert chart.floor.at(2000).scaled.f1 > max(p.score.at(2000).scaled.f1 for p in chart.points)
    assert [point.setting.trigger for point in chart.points] == ["crossing"] * 4 + ["latch"] * 4
    assert {(fit.trigger, fit.over, fit.against, fit.held) for fit in report.fits} == {
        (trigger, "rate", against, 4.0)
        for trigger in ("crossing", "latch")
        for against in ("truth", "finest")
    }
    assert "oracle's own error" in str(report)
    report.save(tmp_path / "a.svg")
    assert "spinner" in (tmp_path / "a.svg").read_text()
    assert repr(report) == "SceneVerification(spinner: 8 settings)"


def test_failure_modes_are_measured(tmp_path: Path):
    report = evis.measure.verify_failures(methods=["native", "evis-paper"], failures=["borders"], cache=False)
    assert repr(report) == "FailureVerification(1 of 1 claims hold)"
    assert report.passed
    assert set(report.failures) == {"borders"}
    native, paper = (report.cell("borders", method) for method in ("native", "evis-paper"))
    assert native.passed
    assert native.claim
    assert native.number is not None
    assert native.f1 == native.number > 0.98
    assert paper.passed is None
    assert paper.number is not None
    assert paper.number < 0.9, "canary"
    assert native.details["events over truth's"] == pytest.approx(1.0, abs=0.02)
    with pytest.raises(KeyError):
        report.cell("borders", "splat")
    assert "1 of 1 claims hold" in str(report)
    report.save(tmp_path / "a.svg")
    assert "borders without margin" in (tmp_path / "a.svg").read_text()
    with pytest.raises(evis.ConfigError, match="one of native, high, splat, no-aa"):
        evis.measure.verify_failures(methods=["teleport"])
    with pytest.raises(evis.ConfigError, match="keyframe-burst"):
        evis.measure.verify_failures(failures=["border"])


def test_light_is_compared(spinner: evis.Scene, tmp_path: Path):
    report = evis.measure.verify_light(spinner, at=0.01, samples=64, size=(32, 24), worst=3)
    coarse = evis.measure.verify_light(spinner, at=0.01, samples=1, size=(32, 24))
    assert report.all.pixels == 32 * 24
    assert coarse.all.median > 2 * report.all.median, "canary: fewer samples are worse"
    assert report.difference.shape == (24, 32)
    worst = report.worst[0]
    assert len(report.worst) == 3
    assert report.difference[worst.y, worst.x] == pytest.approx(worst.difference, abs=1e-6)
    assert abs(worst.difference) == pytest.approx(report.all.worst, abs=1e-6)
    assert "interior" in report.regions
    assert sum(error.pixels for error in report.objects.values()) == report.regions["interior"].pixels
    assert "worst pixels" in str(report)
    report.save(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(evis.ConfigError, match=r"shadows is .soft."):
        evis.measure.verify_light(spinner, shadows="soft")  # type: ignore[arg-type]


def test_what_cannot_be_verified_is_told(spinner: evis.Scene):
    with pytest.raises(evis.ConfigError, match="triggers is 'swing'; it must be 'crossing' or 'latch'"):
        evis.measure.verify_scene(spinner, triggers=["swing"])  # type: ignore[list-item]
    with pytest.raises(evis.ConfigError, match="samples is empty"):
        evis.measure.verify_scene(spinner, samples=[])
    with pytest.raises(evis.ConfigError, match="rates is 0"):
        evis.measure.verify_scene(spinner, rates_hz=[0])
