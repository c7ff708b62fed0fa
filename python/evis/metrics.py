"""How close events, pictures and flow come to the truth.

>>> import evis
>>> events = evis.EventArray.from_columns(t=[1000, 4000], x=[1, 2], y=[0, 0], p=[1, 0], width=4, height=3)
>>> truth = evis.Truth.from_events(events, sensor=evis.Sensor(), duration_us=300_000)
>>> score = evis.metrics.score(events, truth)
>>> score.at(1000).plain.f1
1.0
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _check, _evis
from ._events import EventArray, Events, as_event_cd
from ._evis import ConfigError, FormatError
from ._files import HDF5_ENDINGS, Recording, load
from ._sensor import Sensor, thresholds_of
from ._truth import REGIONS, Truth, load_truth

__all__ = [
    "REGIONS",
    "EndpointError",
    "MatchScore",
    "RegionScore",
    "Score",
    "TimeError",
    "ToleranceScore",
    "Truth",
    "endpoint_error",
    "load_truth",
    "mse",
    "psnr",
    "score",
    "ssim",
    "voxel_l1",
]

DEFAULT_TOLERANCES_US = (1000, 300, 100)


@dataclass(frozen=True, slots=True)
class TimeError:
    """Time errors of matched pairs, stream minus truth, in microseconds.

    Attributes
    ----------
    median_us, p95_us : float
        Median and 95th percentile of the magnitude, interpolated linearly as `numpy.percentile` does.
    rms_us : float
        Root of the mean square.
    bias_us : float
        Mean; positive where the stream is late.
    median_per_interval : float or None
        Median of the magnitude over the time to the nearest other truth event of the pixel, to one part in
        256; None where no pixel has two.
    """

    median_us: float
    p95_us: float
    rms_us: float
    bias_us: float
    median_per_interval: float | None


@dataclass(frozen=True, slots=True)
class RegionScore:
    """One region's share of a matching.

    A truth event counts in its own region, a matched event in that of its truth event, an unmatched one where
    the pixel lies at its time.

    Attributes
    ----------
    region : str
        One of `REGIONS`.
    truth_events, events, matched : int
        Counts.
    precision, recall, f1 : float
        ``matched / events``, ``matched / truth_events``, and their harmonic mean.
    """

    region: str
    truth_events: int
    events: int
    matched: int
    precision: float
    recall: float
    f1: float


@dataclass(frozen=True, slots=True)
class MatchScore:
    """The result of one matching.

    Attributes
    ----------
    matched, missed, spurious : int
        Pairs, truth events without partner, events of the stream without partner.
    precision, recall, f1 : float
        ``matched / events`` (1 without events), ``matched / truth_events``, and their harmonic mean.
    chance_f1 : float
        F1 after each pixel's times were shifted cyclically by an amount of its own.
    missed_per_pixel_s, spurious_per_pixel_s : float
        Rates per pixel and second.
    time_error : TimeError or None
        None where nothing matched.
    regions : tuple of RegionScore
        Regions in which something happened.
    """

    matched: int
    missed: int
    spurious: int
    precision: float
    recall: float
    f1: float
    chance_f1: float
    missed_per_pixel_s: float
    spurious_per_pixel_s: float
    time_error: TimeError | None
    regions: tuple[RegionScore, ...]

    def region(self, name: str) -> RegionScore | None:
        """Return the score in the region of this name; None where nothing happened there."""
        return next((region for region in self.regions if region.region == name), None)


@dataclass(frozen=True, slots=True)
class ToleranceScore:
    """Scores at one tolerance.

    Attributes
    ----------
    tolerance_us : int
        Microseconds.
    plain : MatchScore
        With this tolerance everywhere.
    scaled : MatchScore
        With the tolerance ``max(tau, min(0.1 px * (tau / 1 ms) / speed, 10 tau))`` of each truth event.
    """

    tolerance_us: int
    plain: MatchScore
    scaled: MatchScore


@dataclass(frozen=True, slots=True)
class Score:
    """A stream against truth; ``print(score)`` shows a table.

    Attributes
    ----------
    duration_us, pixels : int
        Duration and number of the pixels that were compared.
    truth_events, events : int
        Events of the truth, and those of the stream that were compared.
    ignored_unknown_pixel, ignored_outside_interval : int
        Events of the stream at pixels that the truth does not know, and outside ``[0, duration_us)``.
    count_ratio : float
        ``events / truth_events``.
    tolerances : tuple of ToleranceScore
        As asked for.
    fired_pixels : int
        Pixels with an event on either side.
    exact_sequence, exact_sequence_fired : float
        Share of pixels whose sequence of polarities is that of the truth: of all, and of those that fired.
    voxel_l1 : float or None
        See `voxel_l1`.
    integrated_log_rms : float or None
        RMS over pixels and boundaries of 20 ms of the difference of the sums
        ``threshold_on * ON events - threshold_off * OFF events``, log units; None where the thresholds are
        unknown.
    chance_shift_us : tuple of int
        Least and largest shift of the chance streams: more than 50 ms either way; for truths shorter than
        200 ms between a quarter and three quarters of the duration.
    cut_clusters : int
        Clusters of events that were too large for one exact matching and were matched piece by piece.
    """

    duration_us: int
    pixels: int
    truth_events: int
    events: int
    ignored_unknown_pixel: int
    ignored_outside_interval: int
    count_ratio: float
    tolerances: tuple[ToleranceScore, ...]
    fired_pixels: int
    exact_sequence: float
    exact_sequence_fired: float
    voxel_l1: float | None
    integrated_log_rms: float | None
    chance_shift_us: tuple[int, int]
    cut_clusters: int

    def at(self, tolerance_us: int) -> ToleranceScore:
        """Return the scores at a tolerance.

        Raises
        ------
        ConfigError
            If it was not asked for.
        """
        for level in self.tolerances:
            if level.tolerance_us == tolerance_us:
                return level
        present = ", ".join(str(level.tolerance_us) for level in self.tolerances)
        raise ConfigError(f"tolerance_us is {tolerance_us}; it must be one that was scored: {present}")

    def to_dict(self) -> dict[str, Any]:
        """Return the score as dictionaries, lists and numbers."""
        made: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return made

    def to_json(self, *, indent: int | None = None) -> str:
        """Return the score as JSON; `from_json` reads it."""
        return json.dumps(asdict(self), indent=indent)

    @classmethod
    def from_json(cls, text: str) -> Score:
        """Read what `to_json` or ``evis score --json`` (its key ``score``) wrote.

        Raises
        ------
        FormatError
            If it is something else.
        """
        try:
            held = json.loads(text)
            levels = tuple(
                ToleranceScore(
                    level["tolerance_us"], _match_score(level["plain"]), _match_score(level["scaled"])
                )
                for level in held["tolerances"]
            )
            least, largest = held["chance_shift_us"]
            return cls(**{**held, "tolerances": levels, "chance_shift_us": (least, largest)})
        except (ValueError, TypeError, KeyError) as error:
            raise FormatError(f"this is not the JSON of a score: {error}") from error

    def __str__(self) -> str:
        """Show a table."""
        return _evis.score_table(self.to_json())


def _match_score(held: dict[str, Any]) -> MatchScore:
    error = held["time_error"]
    return MatchScore(
        **{
            **held,
            "time_error": None if error is None else TimeError(**error),
            "regions": tuple(RegionScore(**region) for region in held["regions"]),
        }
    )


def score(
    events: EventArray | Recording | npt.ArrayLike | str | PathLike[str],
    truth: Truth | str | PathLike[str],
    *,
    tolerances_us: Sequence[int] = DEFAULT_TOLERANCES_US,
    sensor: Sensor | None = None,
    camera: str | None = None,
) -> Score:
    """Score events against truth.

    Per pixel and polarity, events are matched with truth one to one and in order within a tolerance: most
    pairs, and among those the least sum of time errors. Events at pixels that the truth does not know, and
    outside its time, are counted and otherwise ignored.

    Parameters
    ----------
    events : EventArray, Recording, array_like or path
        Events sorted by time: an `EventArray`, a structured array with x, y, p and t, a recording, or a file
        that `evis.load` opens.
    truth : Truth or path
        What is right; a recording is taken as truth too, and so is, with a warning, exact light that was
        sampled (`Truth.sampled_hz`).
    tolerances_us : sequence of int
        Microseconds, 1 to 1 000 000.
    sensor : Sensor, optional
        Sensor that made the events; thresholds and ``log_eps`` must be those of the truth. For recordings,
        those that they store where not given.
    camera : str, optional
        Camera of a recording of several; the truth's where not given.

    Returns
    -------
    Score
        ``score.at(1000).plain.f1``, ``score.at(1000).scaled.time_error.median_us`` and so on.

    Raises
    ------
    ConfigError
        If stream and truth do not belong together (size, thresholds), the stream is not sorted, the truth is
        empty, or a tolerance cannot be used.
    OSError, FormatError
        If a file cannot be read.
    """
    tolerances = _check.wholes("tolerances_us", tolerances_us)
    known = _as_truth(truth, camera)
    array, size, stored = _as_events(events, known, camera)
    if sensor is not None:
        stored = thresholds_of(sensor)
    return Score.from_json(_evis.score(array, known._handle, tolerances, stored, size))


def voxel_l1(
    events: EventArray | Recording | npt.ArrayLike | str | PathLike[str],
    truth: Truth | str | PathLike[str],
    *,
    camera: str | None = None,
) -> float | None:
    """Relative L1 distance of voxel grids, at the truth's pixels over its time.

    Each 20 ms window from 0 on gives a grid of five bins,
    ``V(b, y, x) = sum p * max(0, 1 - |b - 4 (t - t0) / 20 ms|)`` over its events with p = +1 or -1 (Rebecq et
    al., High Speed and High Dynamic Range Video with an Event Camera, 2019, with the window's bounds in place
    of its first and last event).

    Parameters
    ----------
    events, truth, camera
        As in `score`.

    Returns
    -------
    float or None
        ``sum |V - V_truth| / sum |V_truth|``: 0 is perfect, no events score 1; None where V_truth is zero.

    Raises
    ------
    ConfigError, OSError, FormatError
        As `score`.
    """
    known = _as_truth(truth, camera)
    array, _, _ = _as_events(events, known, camera)
    return _evis.voxel_l1(array, known._handle)


def _as_truth(truth: Truth | str | PathLike[str], camera: str | None) -> Truth:
    known = truth if isinstance(truth, Truth) else Truth.load(truth, camera=camera)
    if known.sampled_hz is not None:
        light = f"exact light sampled at {known.sampled_hz:g} Hz"
        warnings.warn(f"this is no truth but {light}: what that rate costs is left out", stacklevel=3)
    return known


def _as_events(
    events: EventArray | Recording | npt.ArrayLike | str | PathLike[str], truth: Truth, camera: str | None
) -> tuple[Events, tuple[int, int] | None, tuple[float, float, float] | None]:
    """Return events, the size of their sensor and its thresholds, where they are known."""
    told_size = True
    if isinstance(events, (str, PathLike)):
        # NumPy files may not hold the size; the one that is guessed then says nothing.
        told_size = Path(events).suffix.lower() in HDF5_ENDINGS
        events = load(events)
    stored = None
    if isinstance(events, Recording):
        if camera is None and len(events) > 1 and truth.camera.name in events:
            camera = truth.camera.name
        view = events.view if camera is None or len(events) == 1 else events[camera]
        stored = _evis.sensor_of_settings(events.config_toml, view.camera.name)
        events = view.events
    if isinstance(events, EventArray):
        size = (events.width, events.height) if told_size else None
        return np.ascontiguousarray(events.to_numpy()), size, stored
    return as_event_cd(events), None, stored


def mse(frame: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Mean square error of two frames.

    Parameters
    ----------
    frame, reference : array_like
        Shape (H, W) or (H, W, C), any real type; computed from float32 values.

    Returns
    -------
    float
        In squared units of the frames.

    Raises
    ------
    ConfigError
        If the shapes differ or a value is not finite.
    """
    return _evis.mse(_picture("frame", frame), _picture("reference", reference))


def psnr(frame: npt.ArrayLike, reference: npt.ArrayLike, *, data_range: float) -> float:
    """Peak signal-to-noise ratio, ``10 log10(data_range**2 / mse)``.

    Parameters
    ----------
    frame, reference : array_like
        Shape (H, W) or (H, W, C), any real type; computed from float32 values.
    data_range : float
        Difference between the largest and the smallest value that a pixel can have, such as 1 or 255.

    Returns
    -------
    float
        Decibels; inf for equal frames.

    Raises
    ------
    ConfigError
        If the shapes differ, a value is not finite, or the range is not above 0.
    """
    return _evis.psnr(_picture("frame", frame), _picture("reference", reference), data_range)


def ssim(frame: npt.ArrayLike, reference: npt.ArrayLike, *, data_range: float) -> float:
    """Structural similarity (Wang et al., Image Quality Assessment, 2004).

    Gaussian window of 11x11 pixels with a standard deviation of 1.5, K1 = 0.01, K2 = 0.03; the mean over all
    windows that lie inside the frame, and over channels.

    Parameters
    ----------
    frame, reference : array_like
        Shape (H, W) or (H, W, C), each side at least 11, any real type; computed from float32 values.
    data_range : float
        Difference between the largest and the smallest value that a pixel can have, such as 1 or 255.

    Returns
    -------
    float
        1 for equal frames.

    Raises
    ------
    ConfigError
        If the shapes differ or are too small, a value is not finite, or the range is not above 0.
    """
    return _evis.ssim(_picture("frame", frame), _picture("reference", reference), data_range)


def _picture(name: str, values: npt.ArrayLike) -> npt.NDArray[np.float32]:
    array = np.asarray(values)
    if array.ndim not in (2, 3) or array.dtype.kind not in "iufb":
        raise ConfigError(
            f"{name} has shape {array.shape} and dtype {array.dtype}; it must be (H, W) or (H, W, C), numbers"
        )
    return np.ascontiguousarray(array.reshape(*array.shape[:2], -1), dtype=np.float32)


@dataclass(frozen=True, slots=True)
class EndpointError:
    """Distances between flow vectors.

    Attributes
    ----------
    pixels : int
        Pixels that were compared.
    mean, median : float
        Pixels.
    below_1px, below_3px, below_5px : float
        Share of pixels whose distance is below 1, 3 and 5 pixels.
    """

    pixels: int
    mean: float
    median: float
    below_1px: float
    below_3px: float
    below_5px: float


def endpoint_error(
    flow: npt.ArrayLike, reference: npt.ArrayLike, *, mask: npt.ArrayLike | None = None
) -> EndpointError:
    """Endpoint error of a flow field.

    Parameters
    ----------
    flow, reference : array_like
        Shape (H, W, 2), pixels, x right and y down.
    mask : array_like, optional
        Shape (H, W), where both are defined; everywhere where not given.

    Returns
    -------
    EndpointError
        Mean, median, and shares below 1, 3 and 5 pixels.

    Raises
    ------
    ConfigError
        If shapes differ, the mask leaves nothing, or a vector that counts is not finite.
    """
    fields = [np.asarray(field, dtype=np.float32) for field in (flow, reference)]
    shape = fields[0].shape
    chosen = None if mask is None else np.asarray(mask).astype(np.bool_)
    if len(shape) != 3 or shape[2] != 2 or fields[1].shape != shape:
        raise ConfigError(
            f"flow has shape {shape}, reference {fields[1].shape}; both must have one shape (H, W, 2)"
        )
    if chosen is not None and chosen.shape != shape[:2]:
        raise ConfigError(f"mask has shape {chosen.shape}; it must be {shape[:2]}, as the flow is")
    first, second = (np.ascontiguousarray(field.reshape(-1, 2)) for field in fields)
    flat = None if chosen is None else np.ascontiguousarray(chosen.reshape(-1))
    return EndpointError(**_evis.endpoint_error(first, second, flat))
