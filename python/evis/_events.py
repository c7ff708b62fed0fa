"""Events as arrays."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from . import _check, _evis
from ._evis import ConfigError

EventCD: np.dtype[np.void] = _evis.event_dtype()
"""dtype of one event, Metavision's ``EventCD``: ``x <u2, y <u2, p <i2, t <i8``, 16 bytes."""

Events: TypeAlias = npt.NDArray[np.void]
"""A 1-D structured array of dtype `EventCD`."""


def as_event_cd(events: npt.ArrayLike) -> Events:
    """Return ``events`` as a contiguous `EventCD` array, without a copy where it is one already.

    Parameters
    ----------
    events : array_like
        1-D structured array with the fields x, y, p and t, in any layout and of any integer type that fits.

    Returns
    -------
    numpy.ndarray
        dtype `EventCD`, shape (N,), C-contiguous.

    Raises
    ------
    ConfigError
        If a field is missing, a value does not fit, or the array is not 1-D.
    """
    array: npt.NDArray[Any] = np.asarray(events)
    if array.ndim != 1:
        raise ConfigError(f"events has shape {array.shape}; it must be 1-D")
    if array.dtype == EventCD:
        return np.ascontiguousarray(array)
    names = array.dtype.names or ()
    if not {"x", "y", "p", "t"} <= set(names):
        raise ConfigError(
            f"events has dtype {array.dtype}; it must be structured with the fields x, y, p, t (evis.EventCD)"
        )
    return _from_columns(array["t"], array["x"], array["y"], array["p"])


def _from_columns(t: npt.ArrayLike, x: npt.ArrayLike, y: npt.ArrayLike, p: npt.ArrayLike) -> Events:
    columns = {name: np.asarray(values) for name, values in (("t", t), ("x", x), ("y", y), ("p", p))}
    shape = columns["t"].shape
    for name, column in columns.items():
        if column.ndim != 1 or column.shape != shape:
            raise ConfigError(f"{name} has shape {column.shape}; it must be 1-D and as long as t, {shape}")
        if column.dtype.kind not in "iub":
            raise ConfigError(
                f"{name} has dtype {column.dtype}; it must be an integer type (t in microseconds)"
            )
    # The padding bytes are zero, so that equal streams are equal as bytes.
    events: Events = np.zeros(shape, dtype=EventCD)
    for name, column in columns.items():
        events[name] = column
        if column.dtype.kind != "b" and not np.array_equal(events[name], column):
            raise ConfigError(f"{name} holds a value that does not fit {EventCD[name]}")
    return events


class EventArray:
    """Events of one camera, sorted by time: an array, and the size of the sensor that it came from.

    The columns `t`, `x`, `y` and `p` are views of one structured array of dtype `EventCD`; slices by time
    are views too. NumPy functions take an `EventArray` as that structured array.

    Parameters
    ----------
    events : array_like
        1-D structured array with the fields x, y, p, t; not copied where its dtype is `EventCD`. Sorted by t.
    width, height : int
        Size of the sensor in pixels.

    Raises
    ------
    ConfigError
        If the array cannot be read as events, is not sorted by time, or the size is not positive.
    """

    __slots__ = ("_events", "_height", "_width")

    def __init__(self, events: npt.ArrayLike, *, width: int, height: int) -> None:
        array = as_event_cd(events)
        width = _check.whole("width", width, 1, 65536, " pixels")
        height = _check.whole("height", height, 1, 65536, " pixels")
        if array.size and bool((np.diff(array["t"]) < 0).any()):
            raise ConfigError(
                "events are not sorted by t; sort them: events[np.argsort(events['t'], kind='stable')]"
            )
        self._set(array, width, height)

    def _set(self, array: Events, width: int, height: int) -> None:
        self._events = array
        self._width = int(width)
        self._height = int(height)

    @classmethod
    def _trusted(cls, array: Events, width: int, height: int) -> EventArray:
        """Wrap what the engine made, without checking it again."""
        made = cls.__new__(cls)
        made._set(array, width, height)
        return made

    @classmethod
    def from_columns(
        cls,
        t: npt.ArrayLike,
        x: npt.ArrayLike,
        y: npt.ArrayLike,
        p: npt.ArrayLike,
        *,
        width: int,
        height: int,
    ) -> EventArray:
        """Build from four columns of equal length.

        Parameters
        ----------
        t : array_like of int, shape (N,)
            Microseconds since the stream's start, sorted.
        x, y : array_like of int, shape (N,)
            Pixel, right and down from the top-left one.
        p : array_like of int or bool, shape (N,)
            Polarity, ON = 1, OFF = 0.
        width, height : int
            Size of the sensor in pixels.

        Raises
        ------
        ConfigError
            If lengths differ, a value does not fit its column, or t is not sorted.
        """
        return cls(_from_columns(t, x, y, p), width=width, height=height)

    @property
    def width(self) -> int:
        """Pixels per row of the sensor."""
        return self._width

    @property
    def height(self) -> int:
        """Rows of the sensor."""
        return self._height

    @property
    def t(self) -> npt.NDArray[np.int64]:
        """Microseconds since the stream's start, int64 (N,); a view."""
        return self._events["t"]

    @property
    def x(self) -> npt.NDArray[np.uint16]:
        """Columns, from the left, uint16 (N,); a view."""
        return self._events["x"]

    @property
    def y(self) -> npt.NDArray[np.uint16]:
        """Rows, from the top, uint16 (N,); a view."""
        return self._events["y"]

    @property
    def p(self) -> npt.NDArray[np.int16]:
        """Polarities, ON = 1 and OFF = 0, int16 (N,); a view."""
        return self._events["p"]

    @property
    def columns(
        self,
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.uint16], npt.NDArray[np.uint16], npt.NDArray[np.int16]]:
        """The views (t, x, y, p), in this order."""
        return self.t, self.x, self.y, self.p

    def to_numpy(self) -> Events:
        """Return the structured array of dtype `EventCD`, shape (N,), without a copy."""
        return self._events

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        """Serve NumPy with the structured array."""
        wanted = None if dtype is None else np.dtype(dtype)
        if wanted is None or wanted == self._events.dtype:
            return self._events.copy() if copy else self._events
        if copy is False:
            raise ValueError(f"events have dtype {self._events.dtype}; {wanted} needs a copy")
        return self._events.astype(wanted)

    def slice_time(self, start_us: int, end_us: int) -> EventArray:
        """Events with ``start_us <= t < end_us``, as a view.

        Parameters
        ----------
        start_us, end_us : int
            Microseconds since the stream's start.

        Returns
        -------
        EventArray
            Shares memory with this one; empty where ``end_us <= start_us``.
        """
        first, last = np.searchsorted(self.t, (start_us, max(start_us, end_us)), side="left")
        return EventArray._trusted(self._events[first:last], self._width, self._height)

    def windows(
        self, window_us: int, *, start_us: int | None = None, end_us: int | None = None
    ) -> Iterator[EventArray]:
        """Iterate over consecutive windows of time, empty ones too.

        Parameters
        ----------
        window_us : int
            Length of a window in microseconds; the last one may be shorter.
        start_us : int, optional
            Start of the first window; 0 where not given, or the first event's time where that is negative.
        end_us : int, optional
            End of the last window, exclusive; one past the last event where not given.

        Yields
        ------
        EventArray
            A view of ``[start_us + k * window_us, start_us + (k + 1) * window_us)``.

        Raises
        ------
        ConfigError
            If ``window_us`` is not positive.
        """
        if _check.time_us("window_us", window_us) <= 0:
            raise ConfigError(f"window_us is {window_us}; it must be above 0 microseconds")
        first = min(0, int(self.t[0])) if len(self) else 0
        start = first if start_us is None else start_us
        end = (int(self.t[-1]) + 1 if len(self) else start) if end_us is None else end_us
        return (self.slice_time(begin, min(begin + window_us, end)) for begin in range(start, end, window_us))

    def __len__(self) -> int:
        """Count the events."""
        return int(self._events.shape[0])

    def __eq__(self, other: object) -> bool:
        """Compare size and events."""
        if not isinstance(other, EventArray):
            return NotImplemented
        same_size = (self._width, self._height) == (other._width, other._height)
        # By value: the padding of events made elsewhere may hold anything.
        return same_size and bool(np.array_equal(self._events, other._events))

    __hash__ = None  # type: ignore[assignment]  # arrays are mutable

    def __repr__(self) -> str:
        """Say how many events, when, and on what sensor."""
        span = f", {self.t[0]} to {self.t[-1]} us" if len(self) else ""
        return f"EventArray({len(self)} events{span}, {self._width}x{self._height})"
