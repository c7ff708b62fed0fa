"""Event files of other programs: read piece by piece, written piece by piece, iterated as Metavision does."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from . import _check, _evis
from ._events import EventArray, EventCarrier, EventCD, Events
from ._evis import ConfigError, EvisError, FormatError

EventExtTrigger: np.dtype[np.void] = np.dtype(
    {"names": ["p", "t", "id"], "formats": ["<i2", "<i8", "<i2"], "offsets": [0, 8, 16], "itemsize": 24}
)
"""dtype of an edge of an external signal, Metavision's ``EventExtTrigger``, 24 bytes."""

ImuDtype: np.dtype[np.void] = np.dtype(
    [
        ("t", "<i8"),
        ("temperature", "<f4"),
        ("acceleration", "<f4", (3,)),
        ("rotation", "<f4", (3,)),
        ("magnetic", "<f4", (3,)),
    ]
)
"""dtype of an inertial sample: us, degrees Celsius, g, degrees per second, microtesla."""

Mode: TypeAlias = Literal["delta_t", "n_events", "mixed"]


@dataclass(frozen=True, slots=True)
class FileFrame:
    """An image of a file.

    Attributes
    ----------
    start_us, end_us : int
        When its exposure starts and ends, microseconds; equal where the exposure is not known.
    image : numpy.ndarray
        uint8 (H, W), (H, W, 3) red, green, blue, or (H, W, 4) with alpha; read-only.
    """

    start_us: int
    end_us: int
    image: npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class FilePacket(EventCarrier):
    """A part of a file.

    Dense arrays of its events are methods: ``packet.voxel_grid(bins=5)`` and others, see `EventArray`.

    Attributes
    ----------
    events : EventArray
        Sorted by time: those of a camera that goes back a little, as Metavision's do, are sorted within the
        packet, and keep their order where times are equal. Else they own the reader's memory, never copied.
    triggers : numpy.ndarray
        `EventExtTrigger` (M,).
    frames : tuple of FileFrame
        Images.
    imu : numpy.ndarray
        `ImuDtype` (K,).
    """

    events: EventArray
    triggers: npt.NDArray[np.void]
    frames: tuple[FileFrame, ...]
    imu: npt.NDArray[np.void]

    def _event_array(self) -> EventArray:
        return self.events


def formats() -> dict[str, str]:
    """Return the formats by name, each with a description."""
    return dict(_evis.file_formats())


class EventFile:
    """A file of events of any format, read packet by packet in constant memory; see `open`.

    Iterating yields `FilePacket`. Of a damaged file everything before the damage comes first, then
    `FormatError`, whose message names the byte. Where neither the file nor the caller says the sensor's size,
    it is that of the smallest sensor that holds all events: the first packet then takes a reading of the
    whole file. The file is open until `close`, the end of a ``with`` block, or until nothing refers to it.

    Attributes
    ----------
    path : Path
        The file.
    format : str
        Name of the format, a key of `formats`.
    size : tuple of int or None
        (width, height) in pixels; None where neither the file nor the caller says.
    cameras : tuple of str
        Names of all its cameras, where they have names.
    camera : str or None
        The one that is read.
    t_offset_us : int
        Absolute time of the stream's zero in microseconds, where the file keeps it apart.
    properties : mapping of str to str
        More that the file says: serial number, generation, source.
    """

    def __init__(
        self, path: str | PathLike[str], *, camera: str | None = None, size: tuple[int, int] | None = None
    ) -> None:
        self.path = Path(path)
        self._open_reader: _evis.EventFileReader | None = _evis.EventFileReader(
            self.path, camera=camera, size=size
        )
        self._reach: tuple[int, int] | None = None
        self.format: str = self._reader.format
        self.size = self._reader.size
        self.cameras = tuple(self._reader.cameras)
        self.camera = self._reader.camera
        self.t_offset_us = self._reader.t_offset_us
        self.properties: Mapping[str, str] = dict(self._reader.properties)

    @property
    def _reader(self) -> _evis.EventFileReader:
        if self._open_reader is None:
            raise ConfigError(f"{self.path} is closed; open it again with evis.open")
        return self._open_reader

    def close(self) -> None:
        """Close the file. Reading it raises `ConfigError` from then on; closing it again does nothing."""
        self._open_reader = None

    def __enter__(self) -> EventFile:
        """Return the file, which the end of the ``with`` block closes."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self.close()

    def seek(self, t_us: int) -> None:
        """Move, back or forth, so that every event at ``t_us`` microseconds and later is still to come.

        The next packet may begin somewhat earlier.
        """
        self._reader.seek(_time_us("t_us", t_us))

    def __iter__(self) -> Iterator[FilePacket]:
        """Iterate over the packets that are left."""
        while (parts := self._reader.read()) is not None:
            events, triggers, frames, imu = parts
            yield FilePacket(
                self._array(events),
                np.frombuffer(triggers, EventExtTrigger),
                tuple(_frame(*frame) for frame in frames),
                _imu(imu),
            )

    def events(self, start_us: int | None = None, end_us: int | None = None) -> EventArray:
        """Return the events with ``start_us <= t < end_us`` as one array.

        Parameters
        ----------
        start_us, end_us : int, optional
            Microseconds; from where the file is at, and to its end, where they are not given.

        Returns
        -------
        EventArray
            Sorted by time: those of a camera that goes back a little are sorted, and keep their order where
            times are equal.

        Raises
        ------
        FormatError
            If the file is damaged, or an event lies outside of the size that the caller gave.
        """
        if start_us is not None:
            self.seek(start_us)
        if end_us is None and start_us is None:
            return self._array(self._reader.read_events())
        parts = []
        for events in self._raw_events():
            keep = np.ones(len(events), bool) if start_us is None else events["t"] >= start_us
            if end_us is not None:
                keep &= events["t"] < end_us
            parts.append(events if keep.all() else events[keep])
            if end_us is not None and len(events) and int(events["t"][0]) >= end_us:
                break
        return self._array(np.concatenate(parts) if parts else np.empty(0, EventCD))

    def _raw_events(self) -> Iterator[Events]:
        """Iterate over the events that are left, as arrays in the order of the file."""
        while (parts := self._reader.read()) is not None:
            yield parts[0]

    def _array(self, events: Events) -> EventArray:
        # Metavision's cameras go back in time by a little now and then.
        if bool((events["t"][1:] < events["t"][:-1]).any()):
            events = events[np.argsort(events["t"], kind="stable")]
        width, height = self.size or self._smallest()
        reach = (int(events["x"].max(initial=0)) + 1, int(events["y"].max(initial=0)) + 1)
        if reach[0] > width or reach[1] > height:
            raise FormatError(
                f"{self.path}: events reach {reach[0]}x{reach[1]}, beyond the size {width}x{height}"
            )
        return EventArray._trusted(events, width, height)

    def _smallest(self) -> tuple[int, int]:
        """Return the smallest size that holds all events of the file, which is read once for it."""
        if self._reach is None:
            reader = _evis.EventFileReader(self.path, camera=self.camera, size=None)
            width, height = 1, 1
            try:
                while (parts := reader.read()) is not None:
                    width = max(width, int(parts[0]["x"].max(initial=0)) + 1)
                    height = max(height, int(parts[0]["y"].max(initial=0)) + 1)
            except FormatError:
                # What comes before the damage has a size too; reading on meets the damage again.
                pass
            self._reach = width, height
        return self._reach

    def __repr__(self) -> str:
        """Say what the file is."""
        size = "unknown size" if self.size is None else f"{self.size[0]}x{self.size[1]}"
        closed = ", closed" if self._open_reader is None else ""
        return f"EventFile({str(self.path)!r}, {self.format}, {size}{closed})"


def _time_us(what: str, value: int) -> int:
    # Cameras count from 1970, further than recordings of EVIS reach.
    return _check.whole(what, value, -(1 << 62), 1 << 62, " microseconds")


def _frame(start_us: int, end_us: int, width: int, height: int, channels: int, pixels: bytes) -> FileFrame:
    shape = (height, width) if channels == 1 else (height, width, channels)
    return FileFrame(start_us, end_us, np.frombuffer(pixels, np.uint8).reshape(shape))


def _imu(rows: list[tuple[int, list[float]]]) -> npt.NDArray[np.void]:
    return np.array([(t, v[0], v[1:4], v[4:7], v[7:10]) for t, v in rows], ImuDtype)


def open(
    path: str | PathLike[str], *, camera: str | None = None, size: tuple[int, int] | None = None
) -> EventFile:
    """Open a file of events of any format for reading piece by piece; its content tells the format.

    Parameters
    ----------
    path : path
        The file, or a folder in DSEC's layout.
    camera : str, optional
        The camera, where the file has several.
    size : tuple of int, optional
        (width, height) in pixels, for files that do not say.

    Returns
    -------
    EventFile
        Iterate over it for packets; ``with`` closes it.

    Raises
    ------
    OSError
        If the file cannot be read.
    FormatError
        If its content is of no format that is read, or damaged.

    Examples
    --------
    >>> import evis, numpy as np, tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "events.raw"
    >>> events = evis.EventArray(np.array([(3, 4, 1, 20)], evis.EventCD), width=1280, height=720)
    >>> _ = evis.save(path, events)
    >>> with evis.open(path) as file:
    ...     for packet in file:
    ...         print(len(packet.events))
    1
    """
    return EventFile(path, camera=camera, size=size)


class EventsIterator:
    """Slices of a file, by time or by number, with the signature of Metavision's ``EventsIterator``.

    Slices by time are half-open, ``[start, start + delta_t)``, and tile time: a slice without events is
    yielded too.

    Parameters
    ----------
    input_path : path
        A file of any format that `open` reads.
    start_ts : int
        First microsecond.
    mode : str
        ``"delta_t"``: slices of so many microseconds. ``"n_events"``: of so many events; the last may have
        fewer. ``"mixed"``: whichever comes first.
    delta_t : int
        Microseconds.
    n_events : int
        Events.
    max_duration : int, optional
        Microseconds after ``start_ts`` at which the slices end; else they end with the file.
    relative_timestamps : bool
        Count times from ``start_ts``.
    camera : str, optional
        The camera, where the file has several.
    size : tuple of int, optional
        (width, height), for files that do not say.

    Yields
    ------
    numpy.ndarray
        `EventCD` (N,), a plain array as Metavision yields it, in the order of the file.

    Raises
    ------
    ConfigError
        If a parameter is not positive, or the mode is another.
    """

    def __init__(
        self,
        input_path: str | PathLike[str],
        start_ts: int = 0,
        mode: Mode = "delta_t",
        delta_t: int = 10000,
        n_events: int = 10000,
        max_duration: int | None = None,
        relative_timestamps: bool = False,
        *,
        camera: str | None = None,
        size: tuple[int, int] | None = None,
    ) -> None:
        if mode not in ("delta_t", "n_events", "mixed"):
            raise ConfigError(f"mode is {_check.shown(mode)}; it must be 'delta_t', 'n_events' or 'mixed'")
        for name, value in (("delta_t", delta_t), ("n_events", n_events), ("max_duration", max_duration)):
            if value is not None and _time_us(name, value) <= 0:
                raise ConfigError(f"{name} is {value}; it must be above 0")
        self.start_ts = _time_us("start_ts", start_ts)
        self.mode = mode
        self.delta_t = delta_t
        self.n_events = n_events
        self.max_duration = max_duration
        self.relative_timestamps = relative_timestamps
        self._file = EventFile(input_path, camera=camera, size=size)
        self._now = self.start_ts

    def get_size(self) -> tuple[int, int]:
        """Return (height, width) in pixels.

        Raises
        ------
        EvisError
            If the file does not say; pass ``size`` then.
        """
        if self._file.size is None:
            raise EvisError(f"{self._file.path} does not say the sensor's size; pass size=(width, height)")
        width, height = self._file.size
        return height, width

    def get_current_time(self) -> int:
        """Return the microsecond at which the next slice starts."""
        return self._now

    def __iter__(self) -> Iterator[Events]:
        """Iterate from ``start_ts`` on."""
        self._file.seek(self.start_ts)
        end = None if self.max_duration is None else self.start_ts + self.max_duration
        self._now = self.start_ts
        source = _Source(self._file, self.start_ts, end)
        while True:
            if self.mode == "n_events":
                if not source.fill(self.n_events, None):
                    return
                events = source.take(min(self.n_events, source.held))
                self._now = int(events["t"][-1]) + 1
            else:
                if end is not None and self._now >= end:
                    return
                until = self._now + self.delta_t
                if end is not None:
                    until = min(until, end)
                most = self.n_events if self.mode == "mixed" else None
                if not source.fill(most, until):
                    return
                count = source.before(until)
                if most is not None and count >= most:
                    events = source.take(most)
                    self._now = int(events["t"][-1]) + 1
                else:
                    events = source.take(count)
                    self._now = until
            if self.relative_timestamps:
                events = events.copy()
                events["t"] -= self.start_ts
            yield events

    def __repr__(self) -> str:
        """Say what is iterated, and how."""
        return f"EventsIterator({self._file!r}, mode={self.mode!r})"


class _Source:
    """Events that were read and not yet handed out."""

    def __init__(self, file: EventFile, start: int, end: int | None) -> None:
        self._packets = file._raw_events()
        self._start = start
        self._end = end
        self._parts: list[Events] = []
        self._done = False
        self._past_end = False
        self.held = 0

    def fill(self, count: int | None, until: int | None) -> bool:
        """Read until ``count`` events or one at ``until`` are there; False once nothing is left."""
        while not self._done:
            if count is not None and self.held >= count:
                break
            if until is not None and self._parts and int(self._parts[-1]["t"][-1]) >= until:
                break
            events = next(self._packets, None)
            if events is None:
                self._done = True
                break
            if len(events) and int(events["t"][0]) < self._start:
                events = events[np.searchsorted(events["t"], self._start) :]
            if self._end is not None and len(events) and int(events["t"][-1]) >= self._end:
                events = events[: np.searchsorted(events["t"], self._end)]
                self._done = self._past_end = True
            if len(events):
                self._parts.append(events)
                self.held += len(events)
        # Silence before the end that was asked for is sliced too, where the file goes on after it.
        return self.held > 0 or (until is not None and (not self._done or self._past_end))

    def before(self, until: int) -> int:
        """Count the events that are earlier than ``until``."""
        return sum(int(np.searchsorted(part["t"], until)) for part in self._parts)

    def take(self, count: int) -> Events:
        """Hand out the first ``count`` events."""
        taken: list[Events] = []
        self.held -= count
        while count:
            part = self._parts[0]
            taken.append(part[:count])
            if len(part) > count:
                self._parts[0] = part[count:]
            else:
                self._parts.pop(0)
            count -= len(taken[-1])
        if len(taken) == 1:
            return taken[0]
        return np.concatenate(taken) if taken else np.empty(0, EventCD)


class EventFileWriter:
    """Writes events to a file of another program's format, piece by piece.

    As a context manager it finishes the file; an exception within leaves no file, and an old one stays.

    Parameters
    ----------
    path : path
        The file.
    size : tuple of int
        (width, height) in pixels.
    format : str, optional
        A key of `formats`; by the name's ending where not given (``.raw`` is EVT 3.0).
    overwrite : bool
        Replace a file that exists.

    Raises
    ------
    FileExistsError
        If the file exists, unless ``overwrite``.
    ConfigError
        If the name tells no format, or the format is not known.
    FormatError
        If the format does not hold sensors of this size.
    """

    def __init__(
        self,
        path: str | PathLike[str],
        *,
        size: tuple[int, int],
        format: str | None = None,
        overwrite: bool = False,
    ) -> None:
        self.path = Path(path)
        self.format = format_for(self.path, format)
        self._writer = _evis.EventFileWriter(self.path, format=self.format, size=size, overwrite=overwrite)

    def write(self, events: EventArray | Events, triggers: npt.NDArray[np.void] | None = None) -> None:
        """Append events, and triggers among them, sorted by time.

        Parameters
        ----------
        events : EventArray or numpy.ndarray
            `EventCD` (N,).
        triggers : numpy.ndarray, optional
            `EventExtTrigger` (M,), for formats that hold them.

        Raises
        ------
        FormatError
            If they go back in time, lie outside of the sensor, or do not fit the format.
        """
        array = events.to_numpy() if isinstance(events, EventArray) else np.ascontiguousarray(events, EventCD)
        edges = [] if triggers is None else [(int(e["t"]), int(e["id"]), bool(e["p"])) for e in triggers]
        self._writer.write(np.ascontiguousarray(array), edges)

    def close(self) -> None:
        """Finish the file."""
        self._writer.finish()

    def __enter__(self) -> EventFileWriter:
        """Return the writer."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish the file, or leave none after an exception."""
        if kind is None:
            self._writer.finish()
        else:
            self._writer.abandon()


def format_for(path: Path, format: str | None = None) -> str:
    """Return the format of a new file: the one that is given, or the one of its ending."""
    name = _evis.format_of_ending(path) if format is None else format
    if name is None or name not in formats():
        given = f"path ends with '{path.suffix}'" if format is None else f"format is {_check.shown(format)}"
        raise ConfigError(f"{given}; it must be one of {', '.join(formats())}, or an ending that tells one")
    return name


def read_all(path: Path, camera: str | None, width: int | None, height: int | None) -> tuple[EventArray, str]:
    """Return all events of a file, with the sensor's size, and the camera's name."""
    given = None if width is None or height is None else (width, height)
    file = EventFile(path, camera=camera, size=given)
    if file.size is None and (width is not None or height is not None):
        reach = file._smallest()
        file.size = (width or reach[0], height or reach[1])
    return file.events(), file.camera or "camera"


def write_all(path: Path, events: EventArray, format: str, overwrite: bool) -> None:
    """Write the events of one camera."""
    with EventFileWriter(
        path, size=(events.width, events.height), format=format, overwrite=overwrite
    ) as writer:
        writer.write(events)
