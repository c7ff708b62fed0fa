"""Speed against accuracy, measured on the user's own scene and machine."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Literal

from . import _check, _evis, _limits
from ._evis import ConfigError
from ._method import Warp
from ._request import ChartRequest, TruthRequest
from ._scene import Scene, raw_of
from ._sensor import Sensor, Trigger, thresholds_of
from ._simulator import Device, _selector
from .metrics import Score

DEFAULT_TRUTH_PIXELS = 1000


@dataclass(frozen=True, slots=True)
class ChartSetting:
    """What a point of a chart runs.

    Attributes
    ----------
    published : str or None
        The name that publications give it.
    method : str
        Sampling method.
    rate_hz : float
        Sampled instants per second.
    rendered_hz : float
        Frames rendered per simulated second.
    samples : int
        Samples per pixel and instant.
    antialias : {"samples", "edges"}
        How they are taken.
    trigger : {"crossing", "latch"}
        How a change becomes events.
    splat : Warp or None
        Settings of ``splat`` and ``evis-paper``.
    adaptive_px : float or None
        Pixels that anything may move between two samples of it; None where everything is sampled at
        ``rate_hz``.
    quality : str or None
        The preset that it is.
    """

    published: str | None
    method: str
    rate_hz: float
    rendered_hz: float
    samples: int
    antialias: Literal["samples", "edges"]
    trigger: Trigger
    splat: Warp | None
    adaptive_px: float | None = None
    quality: str | None = None


@dataclass(frozen=True, slots=True)
class ChartPoint:
    """One setting, timed and scored.

    Attributes
    ----------
    setting : ChartSetting
        What was run.
    setup_ms : float
        Least milliseconds of preparation: pipelines and uploads, no part of the cost.
    wall_ms_per_s : tuple of float
        Wall milliseconds of work per simulated second, one per repetition.
    events : int
        Events fired, all pixels.
    clamped : int
        Pixel intervals at the limit of events, where some are lost.
    hash : str
        Hash of the events, the same for each repetition.
    score : evis.metrics.Score
        Against truth.
    """

    setting: ChartSetting
    setup_ms: float
    wall_ms_per_s: tuple[float, ...]
    events: int
    clamped: int
    hash: str
    score: Score

    def cost_ms(self, *, render_ms: float = 0.0) -> float:
        """Return the least milliseconds of work per simulated second, each frame charged ``render_ms``."""
        return min(self.wall_ms_per_s) + render_ms * self.setting.rendered_hz

    def f1(self, *, tolerance_us: int = 1000) -> float:
        """Return F1 at the scaled tolerance; `evis.metrics` says how it is scaled."""
        return self.score.at(tolerance_us).scaled.f1


@dataclass(frozen=True, slots=True)
class SceneChart:
    """Everything measured on one scene.

    Attributes
    ----------
    scene, camera : str
        Names.
    width, height : int
        Pixels.
    start_us, duration_us : int
        What part of the scene, in microseconds.
    sensor : Sensor
        The camera's sensor; each point sets the trigger.
    device : str
        What rendered.
    measured : str
        Day, YYYY-MM-DD in UTC.
    repetitions : int
        Runs of each setting.
    truth_pixels, truth_events, truth_firing : int
        Pixels that truth is made for, spread evenly over the picture; their events; how many of the pixels
        have any (0 in files of versions that did not count them). With 500 events, F1 is known to about 0.01.
    floor : evis.metrics.Score or None
        Truth's own error: two truths with independent samples, scored against each other.
    points : tuple of ChartPoint
        In the ladder's order.
    not_measured : tuple of (ChartSetting, str)
        Settings that could not be, and why.
    """

    scene: str
    camera: str
    width: int
    height: int
    start_us: int
    duration_us: int
    sensor: Sensor
    device: str
    measured: str
    repetitions: int
    truth_pixels: int
    truth_events: int
    truth_firing: int
    floor: Score | None
    points: tuple[ChartPoint, ...]
    not_measured: tuple[tuple[ChartSetting, str], ...]


@dataclass(frozen=True, slots=True)
class Recommendation:
    """A setting to use, and why.

    Attributes
    ----------
    setting : ChartSetting
        What to run.
    sensor : Sensor
        The sensor with the setting's trigger.
    label : str
        The setting in a few words.
    cost_ms_per_s : float
        Milliseconds of work per simulated second.
    f1 : float
        F1 at the scaled tolerance.
    voxel_l1 : float or None
        Relative L1 of voxel grids, where it is defined.
    sentence : str
        The same in a sentence.
    command : str
        The command that runs it.
    """

    setting: ChartSetting
    sensor: Sensor
    label: str
    cost_ms_per_s: float
    f1: float
    voxel_l1: float | None
    sentence: str
    command: str

    @property
    def simulator(self) -> dict[str, Any]:
        """Keyword arguments for `Simulator`: sensor, rate_hz or method, samples, antialias."""
        splat = self.setting.splat
        if self.setting.quality is not None:
            return {"sensor": self.sensor, "quality": self.setting.quality}
        instants: dict[str, Any] = {"method": splat}
        if splat is None:
            instants = {
                "method": self.setting.method,
                "rate_hz": self.setting.rate_hz,
                "adaptive_px": self.setting.adaptive_px,
            }
        return {
            "sensor": self.sensor,
            **instants,
            "samples": self.setting.samples,
            "antialias": self.setting.antialias,
        }


class Chart:
    """Cost against error of many settings; made by `chart`, `from_json` or `load`.

    Examples
    --------
    >>> import evis
    >>> made = evis.chart(evis.Scene.builtin("spinner"), size=(32, 24), duration=0.05, truth_pixels=200,
    ...                   rates_hz=[500], samples=[4], edges=False, published=False,
    ...                   splat=False, adaptive=False, repetitions=1, floor=False, cache=False)
    >>> [point.setting.trigger for point in made.points]
    ['crossing', 'latch']
    """

    __slots__ = ("_json", "_scenes")

    def __init__(self, text: str) -> None:
        _evis.check_chart(text)
        self._json = text
        self._scenes = tuple(_scene_chart(held) for held in json.loads(text)["scenes"])

    @classmethod
    def from_json(cls, text: str) -> Chart:
        """Read what `to_json` or ``evis chart --report`` wrote.

        Raises
        ------
        FormatError
            If it is something else, or of another version.
        """
        return cls(text)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Chart:
        """Read a file that ``evis chart --report`` or `to_json` wrote.

        Raises
        ------
        FormatError
            If it is something else, or of another version.
        OSError
            If it cannot be read.
        """
        return cls(_limits.text_of(path))

    @classmethod
    def of(cls, charts: Iterable[Chart]) -> Chart:
        """Join charts: `save` draws a row for each scene."""
        held = [json.loads(chart.to_json()) for chart in charts]
        if not held:
            raise ConfigError("there is no chart to join; give at least one")
        return cls(json.dumps({**held[0], "scenes": [scene for one in held for scene in one["scenes"]]}))

    @property
    def scenes(self) -> tuple[SceneChart, ...]:
        """One per scene."""
        return self._scenes

    @property
    def points(self) -> tuple[ChartPoint, ...]:
        """Points of the first scene."""
        return self._scenes[0].points

    def to_json(self) -> str:
        """Return everything that was measured."""
        return self._json

    def save(self, path: str | PathLike[str], *, tolerance_us: int = 1000, render_ms: float = 0.0) -> None:
        """Draw the chart; an existing file is replaced.

        Parameters
        ----------
        path : path
            The picture, ``.svg`` or ``.png``.
        tolerance_us : int
            Tolerance of F1: 1000, 300 or 100 microseconds.
        render_ms : float
            Milliseconds that each rendered frame costs on top, as a heavier renderer would.

        Raises
        ------
        ConfigError
            If a value cannot be used, or the ending is another.
        OSError
            If the file cannot be written.
        """
        _evis.draw_chart(
            self._json,
            fspath(path),
            _check.time_us("tolerance_us", tolerance_us),
            _check.number("render_ms", render_ms, " milliseconds"),
        )

    def recommend(
        self,
        *,
        budget_ms: float | None = None,
        target_f1: float | None = None,
        scene: int = 0,
        tolerance_us: int = 1000,
        render_ms: float = 0.0,
    ) -> Recommendation:
        """Recommend a setting: the most accurate within a budget, or the cheapest that is good enough.

        Parameters
        ----------
        budget_ms : float, optional
            Milliseconds of work per simulated second; 1000 is real time.
        target_f1 : float, optional
            F1 to reach. One of the two goals must be given.
        scene : int
            Which of `scenes`.
        tolerance_us, render_ms
            As in `save`.

        Raises
        ------
        ConfigError
            If no measured setting reaches the goal; the message names the nearest one.
        """
        text = _evis.recommend_chart(
            self._json,
            _check.whole("scene", scene),
            _check.number_or_none("budget_ms", budget_ms, " milliseconds"),
            _check.number_or_none("target_f1", target_f1),
            _check.time_us("tolerance_us", tolerance_us),
            _check.number("render_ms", render_ms, " milliseconds"),
        )
        held = json.loads(text)
        setting = _setting(held.pop("setting"))
        known = self._scenes[scene].sensor
        sensor = Sensor(
            threshold_on=known.threshold_on,
            threshold_off=known.threshold_off,
            log_eps=known.log_eps,
            trigger=setting.trigger,
        )
        return Recommendation(setting=setting, sensor=sensor, **held)

    def __repr__(self) -> str:
        """Say what was measured."""
        scenes = ", ".join(f"{scene.scene}: {len(scene.points)} points" for scene in self._scenes)
        return f"Chart({scenes})"


def chart(
    scene: Scene,
    *,
    quick: bool = False,
    rates_hz: Sequence[float] | None = None,
    samples: Sequence[int] | None = None,
    edges: bool | None = None,
    latch_rates_hz: Sequence[float] | None = None,
    published: bool = True,
    splat: bool = True,
    adaptive: bool = True,
    repetitions: int = 3,
    sensor: Sensor | None = None,
    camera: str | None = None,
    size: tuple[int, int] | None = (160, 120),
    start: float = 0.0,
    duration: float = 0.25,
    truth_pixels: int | None = DEFAULT_TRUTH_PIXELS,
    reference_luminance: float | None = None,
    floor: bool = True,
    cache: str | PathLike[str] | bool = True,
    device: Device | str | int | None = None,
) -> Chart:
    """Measure a ladder of settings on a scene: each scored against truth, and timed in turn with the others.

    Truth takes minutes and is kept for the next time. The GIL is released; Ctrl-C ends it.

    Parameters
    ----------
    scene : Scene
        What to measure on.
    quick : bool
        Fewer settings, for a first look.
    rates_hz : sequence of float, optional
        Sampled instants per second. Where neither rates nor samples are given, the dearest combinations are
        left out.
    samples : sequence of int, optional
        Samples per pixel.
    edges : bool, optional
        Whether one shaded sample with the coverage of four is measured too, at each rate.
    latch_rates_hz : sequence of float, optional
        Rates at which the trigger also latches, with each number of samples.
    published : bool
        Whether the settings that the EVIS paper publishes are measured too, as far as they exist.
    splat : bool
        Whether ``splat`` is measured too, with each of its options unless ``quick``.
    adaptive : bool
        Whether adaptive time and the presets are measured too.
    repetitions : int
        Runs of each setting; the fastest counts.
    sensor : Sensor, optional
        Thresholds and ``log_eps``; the trigger is the ladder's.
    camera : str, optional
        Name of the camera; the first where not given.
    size : (int, int), optional
        Width and height in pixels; None takes the camera's own.
    start, duration : float
        What part of the scene, in seconds.
    truth_pixels : int, optional
        Pixels that truth is made for, spread over the picture; None for all.
    reference_luminance : float, optional
        Y_ref of the sensor's formula; the one that truth finds where not given.
    floor : bool
        Whether truth is made once more for a quarter of its pixels, with independent samples, to know its
        own error.
    cache : path or bool
        Folder that keeps truths; True for the user's own cache, False for none.
    device : Device, str or int, optional
        A device, its index, or a part of its name; the fastest kind where not given.

    Returns
    -------
    Chart
        With one scene; `Chart.of` joins several.

    Raises
    ------
    ConfigError
        If a value cannot be used, or nothing fires.
    DeviceError
        If there is no such device, or it failed.
    """
    asked: ChartRequest = {
        "quick": quick,
        "rates_hz": None if rates_hz is None else _check.numbers("rates_hz", rates_hz),
        "samples": None if samples is None else _check.wholes("samples", samples),
        "edges": edges,
        "latch_rates_hz": None
        if latch_rates_hz is None
        else _check.numbers("latch_rates_hz", latch_rates_hz),
        "published": published,
        "splat": splat,
        "adaptive": adaptive,
        "repetitions": _check.whole("repetitions", repetitions),
        "reference_luminance": _check.number_or_none("reference_luminance", reference_luminance),
        "floor": floor,
    }
    truth = truth_request(sensor, camera, size, start, duration, truth_pixels, cache, device)
    return Chart(_evis.chart(raw_of(scene), asked, truth))


def truth_request(
    sensor: Sensor | None,
    camera: str | None,
    size: tuple[int, int] | None,
    start: float,
    duration: float,
    truth_pixels: int | None,
    cache: bool | str | PathLike[str],
    device: Device | str | int | None,
) -> TruthRequest:
    """Return for the engine what settings are measured on beside truth, and where truth is kept."""
    return {
        "sensor": thresholds_of(sensor),
        "camera": None if camera is None else str(camera),
        "size": None if size is None else _check.size(size),
        "start_us": _check.micros("start", start),
        "duration_us": _check.duration_us("duration", duration),
        "truth_pixels": None if truth_pixels is None else _check.whole("truth_pixels", truth_pixels),
        "cache": _evis.chart_cache() if cache is True else None if cache is False else Path(cache),
        "device": _selector(device),
    }


def _setting(held: dict[str, Any]) -> ChartSetting:
    splat = held.get("splat")
    return ChartSetting(**{"published": None, **held, "splat": None if splat is None else Warp(**splat)})


def _scene_chart(held: dict[str, Any]) -> SceneChart:
    truth = held["truth"]
    floor = truth["floor"]
    return SceneChart(
        scene=held["scene"],
        camera=held["camera"],
        width=held["width"],
        height=held["height"],
        start_us=held["start_us"],
        duration_us=held["duration_us"],
        sensor=Sensor(**held["sensor"]),
        device=held["device"]["name"],
        measured=held["measured"],
        repetitions=held["repetitions"],
        truth_pixels=truth["pixels"],
        truth_events=truth["events"],
        truth_firing=truth.get("firing", 0),
        floor=None if floor is None else Score.from_json(json.dumps(floor)),
        points=tuple(
            ChartPoint(
                setting=_setting(point["setting"]),
                setup_ms=point["setup_ms"],
                wall_ms_per_s=tuple(point["wall_ms_per_s"]),
                events=point["events"],
                clamped=point["clamped"],
                hash=point["hash"],
                score=Score.from_json(json.dumps(point["score"])),
            )
            for point in held["points"]
        ),
        not_measured=tuple((_setting(lack["setting"]), lack["reason"]) for lack in held["not_measured"]),
    )
