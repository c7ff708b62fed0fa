"""What a sensor is, as values."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cache
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypeAlias

from . import _check, _evis, _limits
from ._evis import ConfigError
from ._short import ShortRepr

Trigger: TypeAlias = Literal["crossing", "latch", "difference"]
"""``crossing``: every crossing at its own time; ``latch``: at most one event per pixel and sample;
``difference``: every crossing between two samples, counted from the first of them (PIX2NVS)."""

Times: TypeAlias = Literal["crossing", "sample", "even", "shared"]
"""When the events of an interval happen: at crossings, at its end, evenly, or as v2e shares them."""


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Exposure(ShortRepr):
    """What pixels see: frames of light, each the mean of linear light over an exposure, in its place.

    The EVIS paper's option of letting events see motion-blurred frames. Real pixels have a bandwidth
    (`Photoreceptor.cutoff_hz`) and no exposure. A frame is a sample of the light at its exposure's middle,
    rounded down; events lie between two of them, and come when the later one's exposure has ended.

    Attributes
    ----------
    time_us : int
        How long light is gathered, up to 10 000 000 microseconds; 0: pixels see light itself.
    period_us : int
        From the start of one exposure to that of the next, ``time_us`` to 10 000 000: they begin at its
        multiples. 0: one begins where another ends.
    """

    time_us: int = 0
    period_us: int = 0


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Photoreceptor(ShortRepr):
    """From light to the signal that the trigger sees.

    Attributes
    ----------
    curve : {"log", "linlog"}
        ``ln(Y / Y_ref + log_eps)``, or v2e's curve: with ``I = full_scale * Y / Y_ref``,
        ``I * ln(knee) / knee`` up to the knee, else ``ln I``.
    full_scale, knee : float
        See ``linlog``.
    dark_light : float
        Dark current, as light that is added to ``Y / Y_ref``.
    cutoff_hz : float
        -3 dB frequency of one pole of the low-pass at ``Y_ref``; 0: none.
    order : {1, 2}
        Poles, all alike.
    filter : {"exact", "euler"}
        The exact answer to a signal that is straight between samples, or v2e's and EVIS's step with the end
        sample (with two poles, OpenEB's).
    bandwidth : {"constant", "light"}
        Whether the cutoff is multiplied by ``(Y / Y_ref + bandwidth_offset) / (1 + bandwidth_offset)``, kept
        within ``bandwidth_least`` and ``bandwidth_most``.
    bandwidth_offset, bandwidth_least, bandwidth_most : float
        See ``bandwidth``.
    noise : float
        White noise before the low-pass (``exact`` only): its root mean square behind it, log units, at any
        light; 0: none. `Sensor.photoreceptor_noise_for` gives the one for a rate of events.
    """

    curve: Literal["log", "linlog"] = "log"
    full_scale: float = 255.0
    knee: float = 20.0
    dark_light: float = 0.0
    cutoff_hz: float = 0.0
    order: int = 1
    filter: Literal["exact", "euler"] = "exact"
    bandwidth: Literal["constant", "light"] = "constant"
    bandwidth_offset: float = 0.0
    bandwidth_least: float = 0.01
    bandwidth_most: float = 100.0
    noise: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Pattern(ShortRepr):
    """What differs from pixel to pixel.

    Attributes
    ----------
    sigma : float
        Standard deviation of each pixel's thresholds, log units; ON and OFF apart.
    least, most : float
        Thresholds are kept between these.
    dead_share : float
        Share of pixels that never fire.
    sensitive_share, sensitive_threshold : float
        Share of pixels whose thresholds are both ``sensitive_threshold``: OpenEB's "crazy pixels".
    redraw : bool
        Whether ``sigma`` is redrawn for every pixel and frame, as ESIM does, instead of once.
    start : {"signal", "phase"}
        Where references start: at the signal, or uniformly between the thresholds.
    """

    sigma: float = 0.0
    least: float = 0.01
    most: float = 100.0
    dead_share: float = 0.0
    sensitive_share: float = 0.0
    sensitive_threshold: float = 1e-3
    redraw: bool = False
    start: Literal["signal", "phase"] = "signal"


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Noise(ShortRepr):
    """Events without a cause in the scene; rates are means over pixels, in events per second.

    Attributes
    ----------
    leak_hz : float
        ON events of a pixel that sees no change.
    leak_law : {"ramp", "poisson"}
        The reference falls evenly, or events come at random times.
    leak_spread_decades : float
        Standard deviation of the pixels' leak rates (log-normal).
    leak_jitter : float
        Standard deviation of the time between two leak events, as a share of it (``ramp``); at most 0.2.
    shot_hz : float
        Shot noise, ON and OFF together, before light takes its share.
    shot_light_share, shot_light_offset : float
        The rate is multiplied by ``1 - share * (Y / Y_ref + offset) / (1 + offset)``. EVIS: 1 and 0; v2e:
        0.75 and 20 / 255.
    shot_per_threshold : bool
        Whether a polarity's rate is inversely proportional to the pixel's own threshold (v2e).
    shot_spread_decades : float
        Standard deviation of the pixels' shot rates (log-normal).
    on_share : float
        Share of ON events in shot noise and of hot pixels.
    reference : {"keep", "signal"}
        What leak (``poisson``), shot noise and hot pixels do to the reference.
    hot_share, hot_hz : float
        Share of hot pixels, and their rate.
    burst_events, burst_us : float
        Mean number of shot events that follow each one (``shot_hz`` counts them all), and their mean delay;
        their shortest one where ``burst_longest_us`` is set.
    burst_longest_us : float
        Longest delay of those that follow: delays are then as many per decade from ``burst_us`` to here. 0:
        delays are exponential.
    alternation : float
        Probability that a shot event's polarity is not that of the pixel's last event; below 0: independent.
    shot_recovery_us : float
        How long shot noise takes to come back after an event of its pixel: ``t`` after it, its rate is
        multiplied by ``1 - exp(-(t / shot_recovery_us)**2)``; bursts come nevertheless. 0: at once.
    """

    leak_hz: float = 0.0
    leak_law: Literal["ramp", "poisson"] = "ramp"
    leak_spread_decades: float = 0.0
    leak_jitter: float = 0.0
    shot_hz: float = 0.0
    shot_light_share: float = 0.0
    shot_light_offset: float = 0.0
    shot_per_threshold: bool = False
    shot_spread_decades: float = 0.0
    on_share: float = 0.5
    reference: Literal["keep", "signal"] = "keep"
    hot_share: float = 0.0
    hot_hz: float = 0.0
    burst_events: float = 0.0
    burst_us: float = 300.0
    burst_longest_us: float = 0.0
    alternation: float = -1.0
    shot_recovery_us: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Refractory(ShortRepr):
    """Silence after an event.

    Attributes
    ----------
    period_us : int
        Its length in microseconds; 0: none.
    rule : {"suppress", "defer", "hold"}
        ``suppress``: events are lost, the reference moves (ESIM, EVIS). ``defer``: the reference stays, what
        is a threshold away at the end fires then (v2e). ``hold``: the reference is the signal at the end
        (hardware).
    """

    period_us: int = 0
    rule: Literal["suppress", "defer", "hold"] = "suppress"


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Readout(ShortRepr):
    """From the pixel to the wire.

    Attributes
    ----------
    latency_us : float
        Delay of every event.
    latency_light_us : float
        Further delay, inversely proportional to light: this at ``Y_ref``, at most a hundred times this.
    jitter_us : float
        Standard deviation of the delay.
    row_ns, event_ns : int
        Time that the bus takes per row and per event, nanoseconds; rows are read one after the other.
    rate_limit_hz : float
        Events per second at most, counted in windows of a millisecond; 0: no limit.
    tick_us : int
        Times are multiples of this, rounded up.
    """

    latency_us: float = 0.0
    latency_light_us: float = 0.0
    jitter_us: float = 0.0
    row_ns: int = 0
    event_ns: int = 0
    rate_limit_hz: float = 0.0
    tick_us: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class Diffusion:
    """Brownian motion with drift in place of thresholds on the signal: DVS-Voltmeter (ECCV 2022).

    With ``I = 255 * Y / Y_ref`` and its change ``dI`` per microsecond, the drift is ``k1 dI / (I + k2) + k4 +
    k5 I`` and the volatility ``k3 sqrt(I) / (I + k2) + k6``; events where the sum is 1 away from the last.

    Attributes
    ----------
    k1, k2, k3, k4, k5, k6 : float
        See the formula.
    """

    k1: float
    k2: float
    k3: float
    k4: float
    k5: float
    k6: float


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Sensor(ShortRepr):
    """An event sensor: thresholds, and stages that are off unless asked for.

    A pixel's signal is ``ln(Y / Y_ref + log_eps)`` with the luminance Y = 0.2126 R + 0.7152 G + 0.0722 B
    (Rec. ITU-R BT.709-6, item 3.2) of linear light. Values are checked where a sensor is used, and by
    `check`. A `Simulator` and an `EventEmulator` take all of them.

    Attributes
    ----------
    threshold_on : float
        Rise of the signal that fires an ON event, log units, at least 0.001.
    threshold_off : float
        Fall of the signal that fires an OFF event, a magnitude, log units, at least 0.001.
    log_eps : float
        ``log_eps`` in the formula above; above 0.
    trigger : {"crossing", "latch", "difference"}
        How a change between two samples becomes events.
    times : {"crossing", "sample", "even", "shared"}
        When events happen; anything but ``crossing`` imitates other simulators.
    most_events : int
        Events of one pixel in one interval at most.
    exposure, photoreceptor, pattern, noise, refractory, readout
        The stages: `Exposure`, `Photoreceptor`, `Pattern`, `Noise`, `Refractory`, `Readout`.
    diffusion : Diffusion, optional
        Another trigger, in place of thresholds, photoreceptor, leak and shot noise.
    """

    threshold_on: float = 0.2
    threshold_off: float = 0.2
    log_eps: float = 1e-3
    trigger: Trigger = "crossing"
    times: Times = "crossing"
    most_events: int = 65535
    exposure: Exposure = field(default_factory=Exposure)
    photoreceptor: Photoreceptor = field(default_factory=Photoreceptor)
    pattern: Pattern = field(default_factory=Pattern)
    noise: Noise = field(default_factory=Noise)
    refractory: Refractory = field(default_factory=Refractory)
    readout: Readout = field(default_factory=Readout)
    diffusion: Diffusion | None = None

    @classmethod
    def preset(cls, name: str) -> Sensor:
        """Return a sensor by name.

        Parameters
        ----------
        name : str
            One of `presets`.

        Raises
        ------
        ConfigError
            If there is no such preset; the message lists them.
        """
        return cls._of_json(_evis.sensor_preset(str(name)))

    @staticmethod
    def presets() -> dict[str, str]:
        """Return the presets: where each comes from, and what of its source it leaves out, by name."""
        return dict(_evis.sensor_presets())

    @classmethod
    def from_toml(cls, source: str | PathLike[str]) -> Sensor:
        """Read a sensor.

        Parameters
        ----------
        source : str or path
            TOML text, or the path of a file; text holds a line break or ``=``.

        Raises
        ------
        ConfigError
            If the text is no TOML, a key is unknown, or a value cannot be used.
        FormatError
            If the file is no text.
        OSError
            If the file cannot be read.
        """
        is_text = isinstance(source, str) and ("=" in source or "\n" in source or not source.strip())
        text = str(source) if is_text else _limits.text_of(source)
        return cls._of_json(_evis.sensor_from_toml(text))

    def to_toml(self) -> str:
        """Return the sensor as TOML; stages that are off are left out.

        Raises
        ------
        ConfigError
            If a value cannot be used.
        """
        return _evis.sensor_to_toml(self._json())

    def sample(
        self, ranges: Mapping[str, Sequence[float] | Mapping[str, Sequence[Any]]], seed: int
    ) -> Sensor:
        """Return this sensor with some values drawn at random: one of a training set.

        Parameters
        ----------
        ranges : mapping
            By path, such as ``"threshold_on"`` or ``"noise.leak_hz"``: ``(low, high)`` for a uniform draw, or
            ``{"choices": [...]}``.
        seed : int
            0 or more; a value depends on it and on its own path only.

        Raises
        ------
        ConfigError
            If a path or a range cannot be used, or the drawn sensor cannot be; if a value is drawn that the
            sensor does not use, such as thresholds of one with ``diffusion``.
        """
        if not isinstance(ranges, Mapping):
            raise ConfigError(
                f"ranges are {_check.shown(ranges)}; they must be a mapping, such as "
                "{'threshold_on': (0.1, 0.3)}"
            )
        plain = {
            path: dict(range_) if isinstance(range_, Mapping) else _check.items(path, range_, "(0.1, 0.3)")
            for path, range_ in ranges.items()
        }
        seed = _check.whole("seed", seed, 0, 2**64 - 1)
        try:
            text = json.dumps(plain)
        except TypeError as error:
            raise ConfigError(f"ranges are {ranges!r}; they must hold numbers and text ({error})") from None
        return Sensor._of_json(_evis.sensor_sample(self._json(), text, seed))

    def photoreceptor_noise_for(
        self, rate_hz: float, *, law: Literal["measured", "v2e"] = "measured"
    ) -> float:
        """Return the ``photoreceptor.noise`` with which pixels fire so often under constant light.

        Parameters
        ----------
        rate_hz : float
            Events of a pixel per second, ON and OFF together, at ``Y_ref`` where light sets the bandwidth;
            1e-4 to 0.8 times ``photoreceptor.cutoff_hz``.
        law : {"measured", "v2e"}
            A fit to this pixel's own events, with one or two poles; or v2e's
            (``compute_photoreceptor_noise_voltage`` in its ``emulator_utils.py``):
            ``log10(C / rms) = -0.0026 x^3 - 0.036 x^2 - 0.1949 x + 0.321`` with
            ``x = log10(rate_hz / (2 cutoff_hz))`` and the mean threshold ``C``.

        Raises
        ------
        ConfigError
            If there is no low-pass, or the rate is outside the range that was measured.
        """
        if law not in ("measured", "v2e"):
            raise ConfigError(f"law is {law!r}; it must be 'measured' or 'v2e'")
        return _evis.sensor_photoreceptor_noise(self._json(), _check.number("rate_hz", rate_hz), law == "v2e")

    def check(self) -> None:
        """Check every value.

        Raises
        ------
        ConfigError
            Names the first value that cannot be used, and what would work.

        Warns
        -----
        UserWarning
            Where values together are allowed, and probably not meant.
        """
        for text in _evis.sensor_check(self._json())[0]:
            warnings.warn(text, stacklevel=3)

    @property
    def thresholds_only(self) -> bool:
        """Whether every stage beyond the thresholds is off."""
        return _evis.sensor_check(self._json())[1]

    def __repr__(self) -> str:
        """Name the preset that is nearest, and what differs from it."""
        own = _values(self)
        near, least = "", _differences(own, _values(Sensor()))
        for name, preset in _presets().items():
            differ = _differences(own, preset)
            # What is not much nearer to a preset than to an ideal sensor says so in its own terms.
            if len(differ) < (len(least) if near else len(least) - 2 * bool(differ)):
                near, least = name, differ
        if not near:
            return ShortRepr.__repr__(self)
        shown = ", ".join(f"{path}={value!r}" for path, value in least.items())
        return f"Sensor.preset({near!r}){' with ' if shown else ''}{shown}"

    def _json(self) -> str:
        return json.dumps(_check.plain(self))

    @classmethod
    def _of_json(cls, text: str) -> Sensor:
        values = json.loads(text)
        diffusion = values["diffusion"]
        stages: dict[str, Any] = {
            "exposure": Exposure(**values["exposure"]),
            "photoreceptor": Photoreceptor(**values["photoreceptor"]),
            "pattern": Pattern(**values["pattern"]),
            "noise": Noise(**values["noise"]),
            "refractory": Refractory(**values["refractory"]),
            "readout": Readout(**values["readout"]),
            "diffusion": None if diffusion is None else Diffusion(**diffusion),
        }
        return cls(**{**values, **stages})


def _values(value: Any, path: str = "") -> dict[str, Any]:
    """Return the settings of a sensor by path."""
    found: dict[str, Any] = {}
    for field_ in fields(value):
        own = getattr(value, field_.name)
        if isinstance(own, ShortRepr):
            found |= _values(own, f"{field_.name}.")
        else:
            found[path + field_.name] = own
    return found


def _differences(own: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    return {path: value for path, value in own.items() if value != other[path]}


@cache
def _presets() -> dict[str, dict[str, Any]]:
    return {name: _values(Sensor.preset(name)) for name in Sensor.presets()}


def sensor_of(sensor: Any, what: str = "sensor") -> Sensor:
    """Return a sensor as it is, by the name of a preset or TOML file, and an ideal one for None."""
    if sensor is None:
        return Sensor()
    if isinstance(sensor, str):
        if sensor.lower().endswith(".toml"):
            return Sensor.from_toml(Path(sensor))
        presets = Sensor.presets()
        if sensor not in presets:
            raise ConfigError(
                f"{what} is {_check.shown(sensor)}; it must be {_check.one_of(presets)}, or the path of a "
                f"TOML file{_check.did_you_mean(sensor, presets)}"
            )
        return Sensor.preset(sensor)
    if not isinstance(sensor, Sensor):
        raise ConfigError(
            f"{what} is {_check.shown(sensor)}; it must be an evis.Sensor, or the name of a preset or of a "
            "TOML file"
        )
    return sensor


def thresholds_of(sensor: Any) -> tuple[float, float, float]:
    """Return both thresholds and ``log_eps`` of a sensor, an ideal one for None; nothing else is used."""
    if not isinstance(sensor, (Sensor, type(None))):
        raise ConfigError(
            f"sensor is {_check.shown(sensor)}; it must be an evis.Sensor, such as "
            "evis.Sensor(threshold_on=0.25) or evis.Sensor.preset('davis346')"
        )
    sensor = sensor or Sensor()
    return (
        _check.number("threshold_on", sensor.threshold_on),
        _check.number("threshold_off", sensor.threshold_off),
        _check.number("log_eps", sensor.log_eps),
    )
