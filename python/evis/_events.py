"""Events as arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, Literal, TypeAlias, overload

import numpy as np
import numpy.typing as npt

from . import _check, _evis
from ._evis import ConfigError
from ._represent import Limits, Raw, Representable

EventCD: np.dtype[np.void] = _evis.event_dtype()
"""dtype of one event, Metavision's ``EventCD``: ``x <u2, y <u2, p <i2, t <i8``, 16 bytes."""

Events: TypeAlias = npt.NDArray[np.void]
"""A 1-D structured array of dtype `EventCD`."""


_COLUMNS = ("t", "x", "y", "p")


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
            index = int(np.argmax(events[name] != column))
            raise ConfigError(
                f"{name} holds a value that does not fit {EventCD[name]}: {column[index]} of event {index}"
            )
    return events


class EventArray(Representable):
    """Events of one camera, sorted by time: an array, and the size of the sensor that it came from.

    Packets, recordings, emulators and hosts all give their events as this type. The columns `t`, `x`, `y` and
    `p` (or ``events["t"]``) are views of one structured array of dtype `EventCD`; slices, ``events[a:b]`` and
    `slice_time`, are views too. ``events[mask]`` is a copy. NumPy functions take an `EventArray` as that
    structured array. Dense arrays for networks are methods: `voxel_grid` and others.

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

    Examples
    --------
    >>> import evis
    >>> columns = [5, 6, 35], [0, 1, 2], [0, 0, 0], [1, 0, 1]
    >>> events = evis.EventArray.from_columns(*columns, width=3, height=1)
    >>> len(events), events.sensor_size, events["x"].tolist()
    (3, (3, 1), [0, 1, 2])
    >>> events[events.p == 1].t.tolist(), events[1:].t.tolist()
    ([5, 35], [6, 35])
    >>> [int(event["t"]) for event in events]
    [5, 6, 35]
    """

    __slots__ = ("_events", "_height", "_width")

    def __init__(self, events: npt.ArrayLike, *, width: int, height: int) -> None:
        array = as_event_cd(events)
        width = _check.whole("width", width, 1, 65536, " pixels")
        height = _check.whole("height", height, 1, 65536, " pixels")
        back = np.flatnonzero(array["t"][1:] < array["t"][:-1])
        if back.size:
            index = int(back[0]) + 1
            raise ConfigError(
                f"events are not sorted by t: event {index} is at {array['t'][index]} us, after one at "
                f"{array['t'][index - 1]} us; sort them: events[np.argsort(events['t'], kind='stable')]"
            )
        self._set(array, width, height)

    def _set(self, array: Events, width: int, height: int) -> None:
        self._events = array
        self._width = int(width)
        self._height = int(height)

    @classmethod
    def _trusted(cls, array: Events, width: int, height: int) -> EventArray:
        """Wrap what the engine made, without checking it again."""
        made = object.__new__(cls)
        # Once per frame: as _set, without the call.
        made._events, made._width, made._height = array, int(width), int(height)
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
    def sensor_size(self) -> tuple[int, int]:
        """Width and height of the sensor in pixels."""
        return self._width, self._height

    @property
    def dtype(self) -> np.dtype[np.void]:
        """The dtype of an event, `EventCD`."""
        return self._events.dtype

    @property
    def shape(self) -> tuple[int]:
        """Number of events, as the shape (N,) of the structured array."""
        return (len(self),)

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

    def tobytes(self) -> bytes:
        """Return the bytes of the structured array, 16 per event, padding included."""
        return self._events.tobytes()

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
        self,
        time_us: int | None = None,
        *,
        count: int | None = None,
        edges: Sequence[int] | npt.NDArray[np.integer[Any]] | None = None,
        start_us: int | None = None,
        end_us: int | None = None,
    ) -> Iterator[EventWindow]:
        """Iterate over consecutive windows: by time, by count, or between given times; one of the three.

        Windows by time and between times are half-open, and empty ones come too.

        Parameters
        ----------
        time_us : int, optional
            Length of a window in microseconds; the last one may be shorter.
        count : int, optional
            Events of a window; the last one may have fewer. A window lasts from its first event to a
            microsecond after its last one; events of one instant may be parted.
        edges : sequence of int, optional
            Microseconds, ascending; window k is ``[edges[k], edges[k + 1])``.
        start_us : int, optional
            Start of the first window of ``time_us``; 0 where not given, or the first event's time where that
            is negative. Of windows of ``count``, only events from then on.
        end_us : int, optional
            End of the last window, exclusive; one past the last event where not given.

        Yields
        ------
        EventWindow
            A view, with the window's ``start_us`` and ``end_us``.

        Raises
        ------
        ConfigError
            If not exactly one of ``time_us``, ``count`` and ``edges`` is given, or a value cannot be used.

        Examples
        --------
        >>> import evis
        >>> columns = [5, 6, 35], [0, 1, 2], [0, 0, 0], [1, 0, 1]
        >>> events = evis.EventArray.from_columns(*columns, width=3, height=1)
        >>> [(window.start_us, len(window)) for window in events.windows(time_us=10)]
        [(0, 2), (10, 0), (20, 0), (30, 1)]
        >>> [len(window) for window in events.windows(count=2)]
        [2, 1]
        >>> [len(window) for window in events.windows(edges=[6, 35, 40])]
        [1, 1]
        """
        given = [
            name
            for name, value in (("time_us", time_us), ("count", count), ("edges", edges))
            if value is not None
        ]
        if len(given) != 1:
            shown = " and ".join(given) or "none of them"
            raise ConfigError(f"windows take one of time_us, count and edges; {shown} is given")
        if edges is not None:
            if start_us is not None or end_us is not None:
                raise ConfigError("edges say where windows begin and end; leave start_us and end_us away")
            return self._between(_ascending("edges", edges))
        for name, limit in (("start_us", start_us), ("end_us", end_us)):
            if limit is not None:
                _check.time_us(name, limit)
        if count is not None:
            return self._by_count(_check.whole("count", count, 1, 2**62, " events"), start_us, end_us)
        length = _check.time_us("time_us", time_us)
        if length <= 0:
            raise ConfigError(f"time_us is {length}; it must be above 0 microseconds")
        first = min(0, int(self.t[0])) if len(self) else 0
        start = first if start_us is None else int(start_us)
        end = (int(self.t[-1]) + 1 if len(self) else start) if end_us is None else int(end_us)
        return (self._window(begin, min(begin + length, end)) for begin in range(start, end, length))

    def _window(self, start_us: int, end_us: int) -> EventWindow:
        first, last = np.searchsorted(self.t, (start_us, end_us), side="left")
        return EventWindow._of(self._events[first:last], self._width, self._height, start_us, end_us)

    def _between(self, edges: list[int]) -> Iterator[EventWindow]:
        return (self._window(start, end) for start, end in pairwise(edges))

    def _by_count(self, count: int, start_us: int | None, end_us: int | None) -> Iterator[EventWindow]:
        first = 0 if start_us is None else int(np.searchsorted(self.t, start_us, side="left"))
        last = len(self) if end_us is None else int(np.searchsorted(self.t, end_us, side="left"))
        for begin in range(first, last, count):
            events = self._events[begin : min(begin + count, last)]
            start, end = int(events["t"][0]), int(events["t"][-1]) + 1
            yield EventWindow._of(events, self._width, self._height, start, end)

    def _raw(self, limits: Limits) -> Raw:
        return self._events, (self._width, self._height), True

    def __len__(self) -> int:
        """Count the events."""
        return int(self._events.shape[0])

    @overload
    def __getitem__(self, key: Literal["t", "x", "y", "p"]) -> npt.NDArray[Any]: ...
    @overload
    def __getitem__(self, key: int | np.integer[Any]) -> np.void: ...
    @overload
    def __getitem__(self, key: slice | npt.NDArray[Any] | Sequence[int] | Sequence[bool]) -> EventArray: ...
    def __getitem__(self, key: Any) -> Any:
        """Return a column, an event, or some of the events.

        Parameters
        ----------
        key : str, int, slice, or array
            ``"t"``, ``"x"``, ``"y"`` or ``"p"``: that column, a view. A number: that event, as a structured
            scalar. A slice: those events, a view. A mask, bool (N,), or ascending indices: those events, a
            copy.

        Raises
        ------
        ConfigError
            If there is no such column, a mask has another shape than (N,), or the events would no longer be
            sorted by time.
        IndexError
            If there is no such event.
        """
        if isinstance(key, str):
            if key not in _COLUMNS:
                raise ConfigError(f"events have no column '{key}'; there is {', '.join(_COLUMNS)}")
            return self._events[key]
        if hasattr(key, "__index__") and np.ndim(key) == 0:
            return self._events[int(key)]
        if not isinstance(key, slice):
            key = np.asarray(key)
            if key.dtype == np.bool_ and key.shape != self.shape:
                raise ConfigError(
                    f"the mask has shape {key.shape}; it must have that of the events, {self.shape}"
                )
            if key.ndim != 1 or key.dtype.kind not in "biu":
                if key.size:
                    raise ConfigError(
                        f"the index has dtype {key.dtype} and shape {key.shape}; it must be a column's name, "
                        "a number, a slice, a mask, or ascending indices (N,)"
                    )
                key = np.empty(0, np.intp)
        events = self._events[key]
        ascends = (key.step or 1) > 0 if isinstance(key, slice) else key.dtype == np.bool_
        if not ascends and bool((events["t"][1:] < events["t"][:-1]).any()):
            raise ConfigError(
                "the index puts events out of order, and an EventArray is sorted by t; take the structured "
                "array: events.to_numpy()[index]"
            )
        return EventArray._trusted(events, self._width, self._height)

    def __iter__(self) -> Iterator[np.void]:
        """Iterate over the events, structured scalars with the fields x, y, p and t; columns are faster."""
        return iter(self._events)

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


def _ascending(what: str, values: Any) -> list[int]:
    times = [_check.time_us(what, value) for value in _check.items(what, values, "[0, 10_000, 20_000]")]
    for before, after in pairwise(times):
        if after <= before:
            raise ConfigError(f"{what} has {after} after {before}; {what} must ascend")
    return times


class EventWindow(EventArray):
    """Events of ``[start_us, end_us)``, an `EventArray` that knows its interval; made by `windows`."""

    __slots__ = ("end_us", "start_us")

    start_us: int
    """First microsecond."""

    end_us: int
    """One past the last microsecond."""

    @classmethod
    def _of(cls, array: Events, width: int, height: int, start_us: int, end_us: int) -> EventWindow:
        made = cls.__new__(cls)
        made._set(array, width, height)
        made.start_us, made.end_us = start_us, end_us
        return made

    def __repr__(self) -> str:
        """Say how many events, in which interval, and on what sensor."""
        span = f"[{self.start_us}, {self.end_us}) us"
        return f"EventWindow({len(self)} events, {span}, {self.width}x{self.height})"


class EventCarrier(Representable):
    """What has the events of one camera, and more: its dense arrays and windows are those of the events."""

    __slots__ = ()

    def _event_array(self) -> EventArray:
        raise NotImplementedError

    def _raw(self, limits: Limits) -> Raw:
        return self._event_array()._raw(limits)

    def windows(
        self,
        time_us: int | None = None,
        *,
        count: int | None = None,
        edges: Sequence[int] | npt.NDArray[np.integer[Any]] | None = None,
        start_us: int | None = None,
        end_us: int | None = None,
    ) -> Iterator[EventWindow]:
        """Iterate over consecutive windows of the events: see `EventArray.windows`."""
        array = self._event_array()
        return array.windows(time_us, count=count, edges=edges, start_us=start_us, end_us=end_us)
