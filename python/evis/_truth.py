"""Truth: events known to be right, and what is known of each."""

from __future__ import annotations

import math
from dataclasses import asdict
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _check, _evis
from ._events import EventArray, as_event_cd
from ._evis import ConfigError
from ._packets import CameraInfo
from ._sensor import Sensor, thresholds_of

REGIONS = ("interior", "silhouette", "disoccluded", "shadow_edge")
"""Names of the regions; their indices are the codes in `Truth.event_region` and `Truth.span_region`."""


class Truth:
    """Events that a sensor should fire, at some pixels of one camera over ``[0, duration_us)``.

    Columns are arrays of their own; changing them does not change the truth.

    Attributes
    ----------
    events : EventArray
        Events at the known pixels.
    pixels : numpy.ndarray
        uint16 (N, 2), x and y of the pixels that it knows, by y, then x; one without events is silent.
    speed : numpy.ndarray
        float32 (E,), image speed at each event in pixels per second, 0 or NaN where unknown; empty where no
        speed is known.
    event_region : numpy.ndarray
        uint8 (E,), index into `REGIONS` of each event; empty where all are interior.
    span_start : numpy.ndarray
        uint32 (N + 1,): the spans of pixel i are rows ``span_start[i]`` to ``span_start[i + 1]`` of the next
        two; empty where all is interior.
    span_t_us, span_region : numpy.ndarray
        int64 and uint8 (S,): from ``span_t_us`` until its next span the pixel lies in ``span_region``.
    """

    def __init__(self, handle: _evis.Truth) -> None:
        self._handle = handle

    @classmethod
    def load(cls, path: str | PathLike[str], *, camera: str | None = None) -> Truth:
        """Read a truth file, or take a recording as truth.

        Parameters
        ----------
        path : path
            HDF5. A recording gives all pixels, no speeds, everything interior, and the thresholds of the
            settings that it stores.
        camera : str, optional
            Name of the camera; a file with one camera needs none.

        Raises
        ------
        OSError
            If the file cannot be read.
        FormatError
            If it is no recording, is damaged, or has no such camera.
        """
        return cls(_evis.Truth.load(Path(path), camera))

    @classmethod
    def from_events(
        cls,
        events: EventArray | npt.ArrayLike,
        *,
        size: tuple[int, int] | None = None,
        sensor: Sensor | None = None,
        duration_us: int | None = None,
        reference_luminance: float | None = None,
        pixels: npt.ArrayLike | None = None,
        speed: npt.ArrayLike | None = None,
        event_region: npt.ArrayLike | None = None,
        provenance: str = "",
    ) -> Truth:
        """Take events that are known to be right as truth.

        Parameters
        ----------
        events : EventArray or array_like
            Events, sorted by time.
        size : (int, int), optional
            Width and height of the sensor; that of an `EventArray` where not given.
        sensor : Sensor, optional
            Sensor that they are the truth for; unknown where not given.
        duration_us : int, optional
            Microseconds that the truth covers; one past the last event where not given.
        reference_luminance : float, optional
            Y_ref in ``ln(Y / Y_ref + log_eps)``.
        pixels : array_like, optional
            Shape (N, 2), x and y of the pixels that it knows, by y, then x; all of them where not given.
        speed : array_like, optional
            Shape (E,), image speed at each event in pixels per second.
        event_region : array_like, optional
            Shape (E,), index into `REGIONS` of each event.
        provenance : str
            Where it comes from, JSON.

        Raises
        ------
        ConfigError
            If the size is missing, or parts do not fit together.
        """
        if isinstance(events, EventArray):
            size = (events.width, events.height) if size is None else size
            array = events.to_numpy()
        else:
            array = as_event_cd(events)
        if size is None:
            raise ConfigError("size is missing; it must be (width, height) where events are a plain array")
        width, height = _check.size(size, 65536)
        if duration_us is None:
            duration_us = int(array["t"].max(initial=0)) + 1
        unknown = math.nan
        numbers = (unknown, unknown, unknown)
        if sensor is not None:
            numbers = thresholds_of(sensor)
        return cls(
            _evis.Truth(
                camera=asdict(CameraInfo("camera", width, height, unknown, unknown, unknown, unknown)),
                sensor=numbers,
                reference_luminance=(
                    unknown
                    if reference_luminance is None
                    else _check.number("reference_luminance", reference_luminance)
                ),
                duration_us=_check.time_us("duration_us", duration_us),
                events=np.ascontiguousarray(array),
                pixels=_column(pixels, np.uint16),
                speed=_column(speed, np.float32),
                event_region=_column(event_region, np.uint8),
                span_start=None,
                span_t_us=None,
                span_region=None,
                provenance=provenance,
            )
        )

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> Path:
        """Write an HDF5 file, which also opens as a recording.

        Raises
        ------
        FileExistsError
            If the file exists, unless ``overwrite``.
        OSError
            If the disk refuses.
        """
        path = Path(path)
        self._handle.save(path, overwrite)
        return path

    @property
    def camera(self) -> CameraInfo:
        """The camera."""
        return CameraInfo(**self._handle.camera)

    @property
    def sensor(self) -> Sensor:
        """Sensor that this is the truth for; thresholds and ``log_eps`` are NaN where unknown."""
        threshold_on, threshold_off, log_eps = self._handle.sensor
        return Sensor(threshold_on=threshold_on, threshold_off=threshold_off, log_eps=log_eps)

    @property
    def duration_us(self) -> int:
        """Length in microseconds."""
        return self._handle.duration_us

    @property
    def reference_luminance(self) -> float:
        """Y_ref in ``ln(Y / Y_ref + log_eps)``; NaN where unknown."""
        return self._handle.reference_luminance

    @property
    def sampled_hz(self) -> float | None:
        """Rate in Hz of exact light that was sampled (``evis truth --sampled``); None for truth."""
        return self._handle.sampled_hz

    @property
    def provenance(self) -> str:
        """Where it comes from, JSON."""
        return self._handle.provenance

    @cached_property
    def events(self) -> EventArray:
        """Events at the known pixels."""
        return EventArray._trusted(self._handle.events(), self.camera.width, self.camera.height)

    @cached_property
    def pixels(self) -> npt.NDArray[np.uint16]:
        """Known pixels, uint16 (N, 2)."""
        return self._handle.pixels()

    @cached_property
    def speed(self) -> npt.NDArray[np.float32]:
        """Image speed at each event, pixels per second, float32 (E,) or empty."""
        return self._handle.speed()

    @cached_property
    def event_region(self) -> npt.NDArray[np.uint8]:
        """Region of each event, uint8 (E,) or empty."""
        return self._handle.event_region()

    @cached_property
    def span_start(self) -> npt.NDArray[np.uint32]:
        """Where the spans of each pixel start, uint32 (N + 1,) or empty."""
        return self._handle.span_start()

    @cached_property
    def span_t_us(self) -> npt.NDArray[np.int64]:
        """Start of each span in microseconds, int64 (S,)."""
        return self._handle.span_t_us()

    @cached_property
    def span_region(self) -> npt.NDArray[np.uint8]:
        """Region of each span, uint8 (S,)."""
        return self._handle.span_region()

    def __repr__(self) -> str:
        """Say how many events at how many pixels, and how long."""
        camera = self.camera
        return (
            f"Truth({len(self.events)} events, {len(self.pixels)} pixels of {camera.width}x{camera.height}, "
            f"{self.duration_us} us)"
        )


def load_truth(path: str | PathLike[str], *, camera: str | None = None) -> Truth:
    """Read a truth file, or take a recording as truth; see `Truth.load`."""
    return Truth.load(path, camera=camera)


def _column(values: npt.ArrayLike | None, dtype: npt.DTypeLike) -> npt.NDArray[Any] | None:
    if values is None:
        return None
    given = np.asarray(values)
    column = given.astype(dtype)
    if np.dtype(dtype).kind == "u" and not np.array_equal(column, given):
        raise ConfigError(f"an array of {given.dtype} holds a value that does not fit {np.dtype(dtype)}")
    return np.ascontiguousarray(column)
