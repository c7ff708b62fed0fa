"""Whether events converge to truth, as fast as theory says, and survive what is known to break methods."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from . import _check, _evis
from ._chart import SceneChart, _scene_chart, truth_request
from ._request import LightRequest
from ._scene import Scene, raw_of
from ._sensor import Sensor
from ._simulator import Device, _selector, _word

TriggerVariant = Literal["crossing", "latch"]
"""Crossings on a straight line of log intensity, or at most one event per sample."""


@dataclass(frozen=True, slots=True)
class Convergence:
    """Errors of a trigger at one sampling interval.

    Attributes
    ----------
    interval_s : float
        Seconds between samples.
    expected, fired : int
        Crossings of the closed form, events of the trigger.
    count_error : int
        Events missed or spurious.
    matched : int
        Events whose times are compared.
    median_us, rms_us, p95_us : float or None
        Of the magnitude of the time error, in microseconds; None where nothing is matched.
    """

    interval_s: float
    expected: int
    fired: int
    count_error: int
    matched: int
    median_us: float | None
    rms_us: float | None
    p95_us: float | None


@dataclass(frozen=True, slots=True)
class FormCheck:
    """A trigger on a closed form, held against theory.

    Attributes
    ----------
    signal : str
        The closed form.
    signal_class : {"smooth", "ramp", "edge", "jump"}
        How it moves between two samples.
    trigger : {"crossing", "latch"}
        How samples become events.
    theory : {"order", "exact"}
        What falls, if anything is left to fall.
    expected_order : float or None
        The power of the interval with which it should.
    order, order_rms : float or None
        Fitted to the median and to the root mean square; None where fewer than three errors exceed the
        rounding.
    rows : tuple of Convergence
        From the longest interval to the shortest.
    fault : str or None
        What does not agree with theory.
    """

    signal: str
    signal_class: Literal["smooth", "ramp", "edge", "jump"]
    trigger: TriggerVariant
    theory: Literal["order", "exact"]
    expected_order: float | None
    order: float | None
    order_rms: float | None
    rows: tuple[Convergence, ...]
    fault: str | None

    @property
    def passed(self) -> bool:
        """Whether theory and measurement agree."""
        return self.fault is None


class _Report:
    __slots__ = ("_json",)

    def __init__(self, text: str) -> None:
        self._json = text

    def to_json(self) -> str:
        """Return what ``evis verify --json`` prints."""
        return self._json

    def save(self, path: str | PathLike[str]) -> None:
        """Draw errors against the sampling interval, as SVG or PNG by the ending of ``path``.

        Raises
        ------
        ConfigError
            For another ending.
        OSError
            If the file cannot be written.
        """
        _evis.draw_verify(self._json, path)

    def __str__(self) -> str:
        """Return the table that ``evis verify`` prints."""
        return _evis.verify_table(self._json)


class Verification(_Report):
    """The triggers on closed forms; made by `verify`. ``print`` shows a table."""

    __slots__ = ("_checks",)

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._checks = tuple(_form_check(held) for held in json.loads(text)["checks"])

    @property
    def checks(self) -> tuple[FormCheck, ...]:
        """One per closed form and trigger."""
        return self._checks

    @property
    def passed(self) -> bool:
        """Whether all agree with theory."""
        return all(check.passed for check in self._checks)

    def __repr__(self) -> str:
        """Say how many agree."""
        return f"Verification({sum(check.passed for check in self._checks)} of {len(self._checks)} pass)"


@dataclass(frozen=True, slots=True)
class ErrorFit:
    """How the median time error of a trigger falls on a scene.

    Attributes
    ----------
    trigger : {"crossing", "latch"}
        The trigger.
    over : {"rate", "samples"}
        What is varied.
    held : float
        What is not: the number of samples per pixel, or the rate in Hz.
    against : {"truth", "finest"}
        The oracle, or the same run at the highest rate, which does not see the samples' error.
    median_us : tuple of (float, float or None)
        Rate in Hz or number of samples, and median time error in microseconds; None where too few events
        have a partner.
    order : float or None
        Power of the sampling interval, or of one over the number of samples; None for fewer than three errors
        above the rounding.
    """

    trigger: TriggerVariant
    over: Literal["rate", "samples"]
    held: float
    against: Literal["truth", "finest"]
    median_us: tuple[tuple[float, float | None], ...]
    order: float | None


class SceneVerification(_Report):
    """The engine on a scene against the converged oracle; made by `verify_scene`. ``print`` shows a table."""

    __slots__ = ("_chart", "_fits")

    def __init__(self, text: str) -> None:
        super().__init__(text)
        held = json.loads(text)
        self._chart = _scene_chart(held["chart"])
        self._fits = tuple(_fit(fit) for fit in held["fits"])

    @property
    def chart(self) -> SceneChart:
        """Settings, scored at 2 ms, 1 ms, 300 us and 100 us; its floor is the oracle's own error."""
        return self._chart

    @property
    def fits(self) -> tuple[ErrorFit, ...]:
        """How errors fall."""
        return self._fits

    def __repr__(self) -> str:
        """Say what was measured."""
        return f"SceneVerification({self._chart.scene}: {len(self._chart.points)} settings)"


@dataclass(frozen=True, slots=True)
class FailureCell:
    """A failure's number for a method.

    Attributes
    ----------
    failure, method : str
        Id of the failure and name of the method.
    number : float or None
        The measure of the failure; ``FailureVerification.failures`` says what it is. None where the run gave
        nothing to take it from.
    interval : (float, float) or None
        Where the number lies with 95 % confidence, for those that say so.
    details : dict of str to float or None
        Further measures.
    f1 : float or None
        Within 1 ms, scaled by image speed, at all pixels of truth; None where truth has no events.
    median_us : float or None
        Median time error of the pairs, microseconds.
    truth_events, events : int
        Events of truth, and of the method at truth's pixels.
    at_still, still_pixels : int
        Events at pixels whose light does not change, and how many of those there are.
    outside : int
        Events outside the interval of their packet.
    unknown : int
        Pixels and instants that the method said it could not know.
    claim : str or None
        Why a limit is claimed; None where nothing is.
    faults : tuple of str
        Which claims do not hold.
    """

    failure: str
    method: str
    number: float | None
    interval: tuple[float, float] | None
    details: Mapping[str, float | None]
    f1: float | None
    median_us: float | None
    truth_events: int
    events: int
    at_still: int
    still_pixels: int
    outside: int
    unknown: int
    claim: str | None
    faults: tuple[str, ...]

    @property
    def passed(self) -> bool | None:
        """Whether all that is claimed holds; None where nothing is claimed."""
        return None if self.claim is None else not self.faults


class FailureVerification(_Report):
    """Every failure mode for every method; made by `verify_failures`. ``print`` shows a table."""

    __slots__ = ("_cells", "_failures")

    def __init__(self, text: str) -> None:
        super().__init__(text)
        held = json.loads(text)
        self._cells = tuple(_cell(cell) for cell in held["cells"])
        self._failures = {note["id"]: f"{note['title']}: {note['number']}" for note in held["failures"]}

    @property
    def cells(self) -> tuple[FailureCell, ...]:
        """One per failure and method, failure by failure."""
        return self._cells

    @property
    def failures(self) -> Mapping[str, str]:
        """What each failure is, and what its number is, by id."""
        return self._failures

    @property
    def passed(self) -> bool:
        """Whether every claim holds."""
        return all(cell.passed is not False for cell in self._cells)

    def cell(self, failure: str, method: str) -> FailureCell:
        """Return the cell of a failure and a method.

        Raises
        ------
        KeyError
            If it was not measured.
        """
        for cell in self._cells:
            if (cell.failure, cell.method) == (failure, method):
                return cell
        raise KeyError((failure, method))

    def __repr__(self) -> str:
        """Say how many claims hold."""
        claims = [cell for cell in self._cells if cell.claim is not None]
        return f"FailureVerification({sum(not c.faults for c in claims)} of {len(claims)} claims hold)"


@dataclass(frozen=True, slots=True)
class LightError:
    """How far log light is off over some pixels, engine less oracle.

    Attributes
    ----------
    pixels : int
        How many.
    median, p95, worst : float
        Of the magnitude of the difference of ``ln(Y / Y_ref + eps)``.
    bias : float
        Its mean; positive where the engine is too bright.
    """

    pixels: int
    median: float
    p95: float
    worst: float
    bias: float


@dataclass(frozen=True, slots=True)
class LightPixel:
    """One of the worst pixels.

    Attributes
    ----------
    x, y : int
        Column and row.
    object : str
        Object and material in its middle.
    region : {"interior", "silhouette", "shadow_edge"}
        What runs through it.
    engine, oracle : float
        Luminance.
    difference : float
        Of log light.
    """

    x: int
    y: int
    object: str
    region: Literal["interior", "silhouette", "shadow_edge"]
    engine: float
    oracle: float
    difference: float


class LightVerification(_Report):
    """The engine's light against the oracle's; made by `verify_light`. ``print`` shows a table."""

    __slots__ = ("_held",)

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._held = json.loads(text)

    @property
    def all(self) -> LightError:
        """Over all pixels."""
        return LightError(**self._held["all"])

    @property
    def regions(self) -> Mapping[str, LightError]:
        """By region, those that occur."""
        return {of["name"]: LightError(**of["error"]) for of in self._held["regions"]}

    @property
    def objects(self) -> Mapping[str, LightError]:
        """By object and material, of pixels that nothing runs through; those that are off most first."""
        return {of["name"]: LightError(**of["error"]) for of in self._held["objects"]}

    @property
    def worst(self) -> tuple[LightPixel, ...]:
        """The worst pixels, the worst first."""
        return tuple(LightPixel(**pixel) for pixel in self._held["worst"])

    @property
    def difference(self) -> npt.NDArray[np.float32]:
        """Difference of log light, float32 of shape (height, width)."""
        shape = (self._held["height"], self._held["width"])
        return np.array(self._held["difference"], np.float32).reshape(shape)

    def __repr__(self) -> str:
        """Say what was compared."""
        return (
            f"LightVerification({self._held['scene']}: median {self.all.median:.4f}, 95 % {self.all.p95:.4f})"
        )


def verify() -> Verification:
    """Measure every trigger on closed forms, and hold the order of its error against theory.

    Takes about a second; the GIL is released.

    >>> import evis
    >>> evis.verify()
    Verification(18 of 18 pass)
    """
    return Verification(_evis.verify())


def verify_scene(
    scene: Scene,
    *,
    rates_hz: Sequence[float] = (250.0, 500.0, 1000.0, 2000.0, 4000.0),
    samples: Sequence[int] = (1, 4, 16, 64),
    triggers: Sequence[TriggerVariant] = ("crossing", "latch"),
    sensor: Sensor | None = None,
    camera: str | None = None,
    size: tuple[int, int] | None = (160, 120),
    start: float = 0.0,
    duration: float = 0.1,
    truth_pixels: int | None = 400,
    cache: str | PathLike[str] | bool = True,
    device: Device | str | int | None = None,
) -> SceneVerification:
    """Measure the engine on a scene against the converged oracle, over rates, samples and triggers.

    Takes minutes. The GIL is released; Ctrl-C ends it.

    Parameters
    ----------
    scene : Scene
        What to measure on.
    rates_hz : sequence of float
        Sampled instants per second.
    samples : sequence of int
        Samples per pixel.
    triggers : sequence of {"crossing", "latch"}
        The first is measured with every number of samples, the others with the largest.
    sensor : Sensor, optional
        Thresholds and ``log_eps``.
    camera : str, optional
        Name of the camera; the first where not given.
    size : (int, int), optional
        Width and height in pixels; None takes the camera's own.
    start, duration : float
        What part of the scene, in seconds.
    truth_pixels : int, optional
        Pixels that truth is made for, spread over the picture; None for all.
    cache : path or bool
        Folder that keeps truths; True for the user's own cache, False for none.
    device : Device, str or int, optional
        A device, its index, or a part of its name; the fastest kind where not given.

    Raises
    ------
    ConfigError
        If a value cannot be used, or nothing fires.
    DeviceError
        If there is no such device, or it failed.
    """
    text = _evis.verify_scene(
        raw_of(scene),
        _check.numbers("rates_hz", rates_hz),
        _check.wholes("samples", samples),
        _check.names("triggers", triggers),
        truth_request(sensor, camera, size, start, duration, truth_pixels, cache, device),
    )
    return SceneVerification(text)


def verify_failures(
    *,
    methods: Sequence[str] | None = None,
    failures: Sequence[str] | None = None,
    compute: Literal["cpu", "gpu"] | None = None,
    cache: str | PathLike[str] | bool = True,
    device: Device | str | int | None = None,
) -> FailureVerification:
    """Measure every method on small scenes that are known to break methods, against truth.

    Takes minutes. The GIL is released; Ctrl-C ends it.

    Parameters
    ----------
    methods : sequence of str, optional
        Names of methods, such as ``"native"``, ``"splat"``, ``"evis-paper"``; all where not given.
    failures : sequence of str, optional
        Ids of failures, such as ``"keyframe-burst"``, ``"rotation"``; all where not given.
    compute : {"cpu", "gpu"}, optional
        Where decoupled sampling evaluates pixels; ``cpu`` where not given. See `Simulator`.
    cache : path or bool
        Folder that keeps truths; True for the user's own cache, False for none.
    device : Device, str or int, optional
        A device, its index, or a part of its name; the fastest kind where not given.

    Raises
    ------
    ConfigError
        If there is no such method or failure; the message lists those that exist.
    DeviceError
        If there is no such device, or it failed.
    """
    text = _evis.verify_failures(
        methods=None if methods is None else _check.names("methods", methods),
        failures=None if failures is None else _check.names("failures", failures),
        compute=_word(compute),
        cache=_evis.chart_cache() if cache is True else None if cache is False else Path(cache),
        device=_selector(device),
    )
    return FailureVerification(text)


def verify_light(
    scene: Scene,
    *,
    at: float = 0.0,
    samples: int = 16,
    shadows: Literal["maps", "rays"] = "maps",
    camera: str | None = None,
    size: tuple[int, int] | None = (160, 120),
    worst: int = 10,
    device: Device | str | int | None = None,
) -> LightVerification:
    """Compare the engine's light with the oracle's at one instant, pixel by pixel.

    Takes seconds to minutes. The GIL is released; Ctrl-C ends it.

    Parameters
    ----------
    scene : Scene
        The scene.
    at : float
        Scene time in seconds.
    samples : int
        The engine's samples per pixel.
    shadows : {"maps", "rays"}
        How the engine tells shadow from light.
    camera : str, optional
        Name of the camera; the first where not given.
    size : (int, int), optional
        Width and height in pixels; None takes the camera's own.
    worst : int
        How many of the worst pixels are listed.
    device : Device, str or int, optional
        A device, its index, or a part of its name; the fastest kind where not given.

    Raises
    ------
    ConfigError
        If a value cannot be used.
    DeviceError
        If there is no such device, or it failed.
    """
    asked: LightRequest = {
        "at_us": _check.micros("at", at),
        "samples": _check.whole("samples", samples),
        "shadows": str(shadows),
        "camera": None if camera is None else str(camera),
        "size": None if size is None else _check.size(size),
        "worst": _check.whole("worst", worst),
        "device": _selector(device),
    }
    return LightVerification(_evis.verify_light(raw_of(scene), asked))


def _cell(held: dict[str, Any]) -> FailureCell:
    interval = held.get("interval")
    limit = held["limit"]
    return FailureCell(
        **{
            key: held[key]
            for key in (
                "failure",
                "method",
                "number",
                "f1",
                "median_us",
                "truth_events",
                "events",
                "at_still",
                "still_pixels",
                "outside",
                "unknown",
            )
        },
        interval=None if interval is None else (interval[0], interval[1]),
        details={detail["name"]: detail["value"] for detail in held["details"]},
        claim=None if limit is None else limit["reason"],
        faults=tuple(held["faults"]),
    )


def _form_check(held: dict[str, Any]) -> FormCheck:
    measured, theory = held["measured"], held["theory"]
    kind, numbers = (theory, {}) if isinstance(theory, str) else next(iter(theory.items()))
    return FormCheck(
        signal=measured["signal"],
        signal_class=held["class"],
        trigger=measured["variant"],
        theory=kind,
        expected_order=numbers.get("order"),
        order=measured["order"],
        order_rms=measured["order_rms"],
        rows=tuple(Convergence(**row) for row in measured["rows"]),
        fault=held["fault"],
    )


def _fit(held: dict[str, Any]) -> ErrorFit:
    over, numbers = next(iter(held["over"].items()))
    return ErrorFit(
        trigger=held["trigger"],
        over=over,
        held=float(next(iter(numbers.values()))),
        against=held["against"],
        median_us=tuple((float(at), error) for at, error in held["median_us"]),
        order=held["order"],
    )
