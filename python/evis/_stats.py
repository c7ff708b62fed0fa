"""Statistics of events: of one recording, of two, and sensors that are fitted to them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from typing import Any, TypeAlias

from . import _check, _evis
from ._events import EventArray
from ._evis import ConfigError
from ._files import Recording, load
from ._sensor import Sensor, sensor_of

Source: TypeAlias = "EventArray | Recording | str | PathLike[str]"
"""Events, a recording of one camera, or the path of one (.h5, .npz, .npy)."""

Curve: TypeAlias = "tuple[tuple[float, ...], ...]"


@dataclass(frozen=True, kw_only=True, slots=True)
class Statistics:
    """What is counted about a stream; "cold" are pixels that are not hot. Made by `statistics`.

    A figure is None where nothing is left to count: in recordings so short that one event makes a pixel hot.

    Attributes
    ----------
    width, height : int
        Pixels.
    duration_s : float
        Length, seconds.
    events : int
        All events.
    rate_hz, cold_rate_hz, cold_on_hz, cold_off_hz : float (of cold pixels: or None)
        Events per pixel and second; of cold pixels; of those the ON and the OFF events.
    on_share : float or None
        Share of ON events, cold pixels.
    silent_share : float
        Share of pixels that never fired.
    hot_pixels : int
        Pixels above 20 events per second.
    hot_share, hot_event_share, hot_hz : float (the last two: or None)
        Their share of all pixels and of all events, and their mean rate.
    fano : float or None
        Variance over mean of the counts of cold pixels; 1 for Poisson processes of one rate.
    fano_by_window : tuple of (float, float)
        The same in shorter windows: seconds, Fano factor.
    pairs : int
        Neighbouring events of one cold pixel.
    alternation : float or None
        Share of them whose polarities differ.
    alternation_after : tuple of (float or None)
        The same after an ON event, and after an OFF event.
    least_interval_us : int or None
        Shortest time between two events of a pixel.
    interval_quantiles_us : tuple of float or None
        1, 10, 50, 90 and 99 % of the times between two events of a cold pixel.
    intervals : tuple of (float, float)
        Their density: seconds, pairs per second and event.
    burst_share, burst_interval_us : float or None
        How many more pairs are within 5 ms than those up to 10 ms suggest, and their mean interval or None.
    regularity : float or None
        Median variation of the times between ON events in a row; near 1: random, below a half: regular.
    pixel_rates : tuple of (float, float)
        Events per second, share of pixels above.
    spatial_correlation : tuple of (float, float, float)
        Pixels, correlation of counts along rows, along columns.
    temporal_correlation, spectrum : tuple of (float, float)
        Of the number of events per millisecond: seconds, autocorrelation; Hz, power over a Poisson process's.
    unsteadiness : float or None
        Relative deviation of the rate over 50 ms, beyond what counting explains.
    """

    width: int
    height: int
    duration_s: float
    events: int
    rate_hz: float
    cold_rate_hz: float | None
    cold_on_hz: float | None
    cold_off_hz: float | None
    on_share: float | None
    silent_share: float
    hot_pixels: int
    hot_share: float
    hot_event_share: float | None
    hot_hz: float | None
    fano: float | None
    fano_by_window: Curve
    pairs: int
    alternation: float | None
    alternation_after: tuple[float | None, float | None]
    least_interval_us: int | None
    interval_quantiles_us: tuple[float, ...] | None
    intervals: Curve
    burst_share: float | None
    burst_interval_us: float | None
    regularity: float | None
    pixel_rates: Curve
    spatial_correlation: Curve
    temporal_correlation: Curve
    spectrum: Curve
    unsteadiness: float | None


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


def _statistics(held: dict[str, Any]) -> Statistics:
    return Statistics(**{name: _tuples(value) for name, value in held.items()})


def _events(source: Source, duration: float | None) -> tuple[EventArray, tuple[int, int]]:
    """Return events and the stream time in microseconds that they cover."""
    if isinstance(source, (str, PathLike)):
        source = load(source)
    end_us = 0
    if isinstance(source, Recording):
        if source.report is not None:
            end_us = round(1e6 * float(source.report.get("stream_s", 0.0)))
        events = source.events
    elif isinstance(source, EventArray):
        events = source
    else:
        raise ConfigError(
            f"source is {_check.shown(source)}; it must be an evis.EventArray, an evis.Recording or the path "
            "of a recording"
        )
    if not len(events) and not end_us:
        raise ConfigError("source holds no events; it must hold some")
    start_us = min(0, int(events.t[0])) if end_us else int(events.t[0])
    end_us = max(end_us, int(events.t[-1]) + 1 if len(events) else 0)
    if duration is not None:
        end_us = min(end_us, start_us + _check.duration_us("duration", duration))
        events = events.slice_time(start_us, end_us)
    return events, (start_us, end_us)


def _text(source: Source, duration: float | None) -> str:
    events, range_us = _events(source, duration)
    return _evis.statistics(events.to_numpy(), (events.width, events.height), range_us)


def statistics(source: Source, *, duration: float | None = None) -> Statistics:
    """Count what a stream of events is like.

    Parameters
    ----------
    source : EventArray, Recording or path
        Events of one camera. Arrays count from their first event to just after their last one.
    duration : float, optional
        Seconds from the start that are used.

    Examples
    --------
    >>> import evis
    >>> events = evis.measure.static_scene("gen4-like", 64, 48, duration=2.0)
    >>> 0 <= evis.statistics(events).cold_rate_hz < 1
    True
    """
    return _statistics(json.loads(_text(source, duration)))


def static_scene(
    sensor: Sensor | str,
    width: int,
    height: int,
    *,
    duration: float,
    light: float | None = None,
    seed: int = 0,
) -> EventArray:
    """Return the noise of a sensor before a still, even scene.

    Parameters
    ----------
    sensor : Sensor or str
        The sensor, or the name of a preset or TOML file.
    width, height : int
        Pixels.
    duration : float
        Seconds.
    light : float, optional
        Y / Y_ref. If not given, the light of the recording that a preset's noise was fitted to, where the
        sensor has that noise (``dvxplorer-like``: 0), and 0.18 else.
    seed : int
        Seed of everything random.

    Raises
    ------
    ConfigError
        If a value cannot be used, or light is negative or infinite.
    """
    sensor = sensor_of(sensor)
    sensor.check()
    width, height = _check.whole("width", width, 1, 65536), _check.whole("height", height, 1, 65536)
    duration_us = _check.duration_us("duration", duration)
    if duration_us > 86_400_000_000:
        raise ConfigError(f"duration is {duration}; it must be above 0 and at most 86400 seconds")
    seed = _check.whole("seed", seed, 0, 2**63 - 1)
    light = _check.number_or_none("light", light)
    events = _evis.static_scene(sensor._json(), (width, height), duration_us, light, seed)
    return EventArray(events, width=width, height=height)


@dataclass(frozen=True, slots=True)
class Estimate:
    """Something that was found about a sensor.

    Attributes
    ----------
    name, unit, note : str
        What, of what, and how it is to be understood.
    value : float
        How much.
    """

    name: str
    value: float
    unit: str
    note: str


@dataclass(frozen=True, slots=True)
class FlickerEstimate:
    """Thresholds as one flickering light shows them.

    Attributes
    ----------
    hz, contrast : float
        The stimulus.
    on, off, sigma : float
        Apparent thresholds, log units, and their deviation between pixels: the pixel's over what its low-pass
        leaves of the stimulus.
    pairs : int
        Pairs of events that were measured.
    """

    hz: float
    contrast: float
    on: float
    off: float
    sigma: float
    pairs: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Calibration:
    """What recordings say about a sensor; made by `calibrate`. ``print`` shows a table.

    Attributes
    ----------
    sensor : Sensor
        The base, with what was found in place of what was there; ``sensor.to_toml()`` is what
        ``evis calibrate`` writes.
    found : tuple of Estimate
        From a still scene.
    flicker : tuple of FlickerEstimate
        From flickering light, per recording.
    cutoff_hz : float or None
        Of a low-pass of one pole, where two frequencies or more show one.
    unknown : tuple of str
        What such recordings cannot say.
    warnings : tuple of str
        What is probably not meant.
    recording, simulated : Statistics or None
        Of the recording of a still scene as far as it was used, and of a simulation of the sensor before one.
    """

    sensor: Sensor
    found: tuple[Estimate, ...]
    flicker: tuple[FlickerEstimate, ...]
    cutoff_hz: float | None
    unknown: tuple[str, ...]
    warnings: tuple[str, ...]
    recording: Statistics | None
    simulated: Statistics | None
    _table: str

    def __str__(self) -> str:
        """Return the table that ``evis calibrate`` prints."""
        return self._table


def calibrate(
    source: Source | Sequence[Source],
    *,
    stimulus: tuple[float, float] | Sequence[tuple[float, float]] | None = None,
    base: Sensor | str | None = None,
    duration: float | None = None,
    seed: int = 0,
) -> Calibration:
    """Fit a sensor to a recording of a still scene, or to recordings of flickering light.

    A still scene shows noise: rates, hot pixels, how pixels differ, bursts, alternation of polarities; it
    cannot show thresholds or bandwidth. Light that flickers as a sine on all pixels shows thresholds and how
    they differ, and the bandwidth where there are two frequencies or more.

    Parameters
    ----------
    source : EventArray, Recording, path, or a sequence of them
        One recording of a still scene; or as many of flicker as there are stimuli.
    stimulus : (float, float) or a sequence of them, optional
        Frequency in Hz and contrast (Imax - Imin) / (Imax + Imin) of light
        ``mean * (1 + contrast * sin(2 pi hz t))``.
    base : Sensor or str, optional
        The sensor that has what recordings do not tell; an ideal one if not given.
    duration : float, optional
        Seconds from the start that are used.
    seed : int
        Seed of the simulations that a fit is corrected by.

    Raises
    ------
    ConfigError
        If there are too few events, or the recording is not in step with the stimulus.

    >>> import evis
    >>> events = evis.measure.static_scene("v2e-noisy", 64, 48, duration=1.0)
    >>> print(round(float(evis.calibrate(events).found[0].value), 1))
    2.2
    """
    base = sensor_of(base, "base")
    base.check()
    seed = _check.whole("seed", seed, 0, 2**63 - 1)
    single = isinstance(source, (EventArray, Recording, str, PathLike))
    sources: list[Source] = (
        [source] if single else _check.items("source", source, "['a.h5', 'b.h5']")  # type: ignore[list-item]
    )
    if stimulus is None:
        if len(sources) != 1:
            raise ConfigError(f"there are {len(sources)} sources; a still scene is calibrated from one")
        events, range_us = _events(sources[0], duration)
        size = (events.width, events.height)
        text, sensor, table = _evis.calibrate_still(events.to_numpy(), size, range_us, base._json(), seed)
        held = json.loads(text)
        return Calibration(
            sensor=Sensor._of_json(sensor),
            found=tuple(Estimate(**item) for item in held["found"]),
            flicker=(),
            cutoff_hz=None,
            unknown=tuple(held["unknown"]),
            warnings=tuple(held["warnings"]),
            recording=_statistics(held["recording"]),
            simulated=_statistics(held["simulated"]),
            _table=table,
        )
    try:
        pairs: list[Any] = [stimulus] if isinstance(stimulus[0], (int, float)) else list(stimulus)
        stimuli = [(float(hz), float(contrast)) for hz, contrast in pairs]
    except (TypeError, ValueError, LookupError):
        raise ConfigError(
            f"stimulus is {_check.shown(stimulus)}; it must be (hz, contrast), or one such pair per source"
        ) from None
    if len(stimuli) != len(sources):
        raise ConfigError(f"there are {len(sources)} sources and {len(stimuli)} stimuli; give one per source")
    parts = []
    for one, pair in zip(sources, stimuli, strict=True):
        events, _ = _events(one, duration)
        parts.append((events.to_numpy(), (events.width, events.height), pair))
    text, sensor, table = _evis.calibrate_flicker(parts, base._json())
    held = json.loads(text)
    return Calibration(
        sensor=Sensor._of_json(sensor),
        found=(),
        flicker=tuple(
            FlickerEstimate(**item.pop("stimulus"), **item) for item in (dict(r) for r in held["recordings"])
        ),
        cutoff_hz=held["cutoff_hz"],
        unknown=tuple(held["unknown"]),
        warnings=(),
        recording=None,
        simulated=None,
        _table=table,
    )


class Comparison:
    """Two recordings side by side; made by `compare`. ``print`` shows a table."""

    __slots__ = ("_json", "_sides")

    def __init__(self, text: str) -> None:
        held = json.loads(text)
        self._json = text
        self._sides = (_statistics(held["a"]["stats"]), _statistics(held["b"]["stats"]))

    @property
    def a(self) -> Statistics:
        """The first."""
        return self._sides[0]

    @property
    def b(self) -> Statistics:
        """The second."""
        return self._sides[1]

    def to_json(self) -> str:
        """Return what ``evis compare --json`` prints."""
        return self._json

    def save(self, path: str | PathLike[str]) -> None:
        """Draw the figure, as SVG or PNG by the ending of ``path``.

        Raises
        ------
        ConfigError
            For another ending.
        OSError
            If the file cannot be written.
        """
        _evis.draw_compare(self._json, path)

    def __str__(self) -> str:
        """Return the table that ``evis compare`` prints."""
        return _evis.compare_table(self._json)

    def __repr__(self) -> str:
        """Say how much was compared."""
        return f"Comparison({self.a.events} and {self.b.events} events)"


def compare(a: Source, b: Source, *, duration: float | None = None) -> Comparison:
    """Set the statistics of two recordings side by side.

    Parameters
    ----------
    a, b : EventArray, Recording or path
        Events of one camera each.
    duration : float, optional
        Seconds of each that are used; the Fano factor and the share of hot pixels depend on the length.

    Examples
    --------
    >>> import evis
    >>> names = "v2e-noisy", "dvxplorer-like"
    >>> a, b = (evis.measure.static_scene(name, 64, 48, duration=1.0) for name in names)
    >>> comparison = evis.compare(a, b)
    >>> comparison.a.cold_rate_hz > comparison.b.cold_rate_hz
    True
    """
    sides = []
    for label, source in (("A", a), ("B", b)):
        name = fspath(source) if isinstance(source, (str, PathLike)) else label
        sides.append({"name": str(name), "stats": json.loads(_text(source, duration))})
    return Comparison(json.dumps({"a": sides[0], "b": sides[1]}))
