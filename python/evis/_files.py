"""Files: HDF5 through the engine, NumPy's own formats beside it."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from . import _check, _evis, _io
from ._bodies import Bodies, Instance, bodies_of
from ._by_camera import ByCamera
from ._events import EventArray, EventCarrier, EventCD, as_event_cd
from ._evis import ConfigError, EvisError, FormatError
from ._packets import CAUSE, LABEL_KINDS, AnyEvents, CameraInfo, Packet, Poses, values_at
from ._represent import Limits, Raw
from ._simulator import Simulator, Stream
from .imu import ImuSamples, columns_of

HDF5_ENDINGS = (".h5", ".hdf5")


class _Source(Protocol):
    """What a recording is read from: the engine's HDF5 reader, or arrays."""

    @property
    def cameras(self) -> list[dict[str, Any]]: ...
    @property
    def labels(self) -> list[str]: ...
    @property
    def seed(self) -> int: ...
    @property
    def method(self) -> str: ...
    @property
    def environment(self) -> int: ...
    @property
    def config_toml(self) -> str: ...
    @property
    def t_offset_us(self) -> int: ...
    def is_complete(self) -> bool: ...
    def report_json(self) -> str | None: ...
    def event_count(self, camera: int) -> int: ...
    def events(self, camera: int, limits: tuple[int, int] | None) -> npt.NDArray[np.void]: ...
    def causes(self, camera: int, limits: tuple[int, int] | None) -> npt.NDArray[np.uint8] | None: ...
    def label_times(self, camera: int, kind: str) -> npt.NDArray[np.int64]: ...
    def label(self, camera: int, kind: str, index: int) -> _evis.Label: ...
    def poses(
        self, camera: int
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64], npt.NDArray[np.float64]]: ...


class _ArraySource:
    """Events of one camera that a file of another program held."""

    labels: list[str] = []  # noqa: RUF012 - never changed, and the protocol wants a list
    seed = 0
    method = ""
    environment = 0
    config_toml = ""
    t_offset_us = 0

    def __init__(self, events: EventArray, name: str = "camera") -> None:
        self._events = events
        self.cameras = [camera_of(events, name)]

    def is_complete(self) -> bool:
        return True

    def report_json(self) -> None:
        return None

    def event_count(self, camera: int) -> int:
        return len(self._events)

    def events(self, camera: int, limits: tuple[int, int] | None) -> npt.NDArray[np.void]:
        return (self._events if limits is None else self._events.slice_time(*limits)).to_numpy()

    def causes(self, camera: int, limits: tuple[int, int] | None) -> None:
        return None

    def label_times(self, camera: int, kind: str) -> npt.NDArray[np.int64]:
        return np.empty(0, np.int64)

    def label(self, camera: int, kind: str, index: int) -> _evis.Label:
        raise ConfigError(f"this file has no label {kind}")

    def poses(
        self, camera: int
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        return np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 4))


def camera_of(events: EventArray, name: str) -> dict[str, Any]:
    """Describe the camera of ``events``, whose lens is not known."""
    unknown = float("nan")
    return asdict(CameraInfo(name, events.width, events.height, unknown, unknown, unknown, unknown))


def recording_of(events: EventArray) -> Recording:
    """Return events as a recording of one camera."""
    return Recording(_ArraySource(events))


class RecordedLabels(Sequence[npt.NDArray[Any]]):
    """Label images of one kind in a file; each is read when it is asked for.

    Attributes
    ----------
    kind : str
        See `Labels`.
    t_us : numpy.ndarray
        int64 (N,), microseconds since the stream's start.
    """

    def __init__(self, source: _Source, camera: int, kind: str) -> None:
        self._source = source
        self._camera = camera
        self.kind = kind
        self.t_us = source.label_times(camera, kind)

    def __len__(self) -> int:
        """Count the images."""
        return len(self.t_us)

    def __getitem__(self, index: Any) -> Any:
        """Read image ``index``, (H, W) or (H, W, C)."""
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        return self._frame(index).data

    def __repr__(self) -> str:
        """Say what they are, how many, and when."""
        when = f", t_us {self.t_us[0]} to {self.t_us[-1]}" if len(self) else ""
        return f"RecordedLabels({self.kind!r}, {len(self)} images{when})"

    def interval_us(self, index: int) -> tuple[int, int]:
        """Return the time of image ``index``, and the other end of its flow or its exposure's start (us)."""
        frame = self._frame(index)
        return frame.t_us, frame.t_other_us

    def exposure_us(self, index: int) -> tuple[int, int]:
        """Return when image ``index`` begins and ends: a frame's exposure; labels have none (us)."""
        t_us, other_us = self.interval_us(index)
        return (other_us, 2 * t_us - other_us) if self.kind == "frame" else (t_us, t_us)

    def at_events(self, events: AnyEvents) -> tuple[npt.NDArray[Any], npt.NDArray[np.int64]]:
        """Return what the image nearest in time says at each event's pixel; see `Labels.at_events`.

        Parameters
        ----------
        events : EventArray, RecordedView or other carrier of events
            N events of the same camera.

        Returns
        -------
        values : numpy.ndarray
            (N,) or (N, C), of the images' dtype.
        apart_us : numpy.ndarray
            int64 (N,), time between event and image, microseconds.

        Raises
        ------
        ConfigError
            If there is no image, or the events have another size.
        """
        camera = self._source.cameras[self._camera]
        return values_at(self, (camera["width"], camera["height"]), lambda k: self[k], events)

    def _frame(self, index: int) -> _evis.Label:
        position = index + len(self) if index < 0 else index
        if not 0 <= position < len(self):
            raise IndexError(f"there are {len(self)} images of {self.kind}, and no {index}")
        return self._source.label(self._camera, self.kind, position)

    @property
    def data(self) -> npt.NDArray[Any]:
        """All images as one array (N, H, W) or (N, H, W, C)."""
        if len(self):
            return np.stack([self[index] for index in range(len(self))])
        camera = self._source.cameras[self._camera]
        dtype, channels = LABEL_KINDS[self.kind]
        shape = (0, camera["height"], camera["width"])
        return np.empty(shape if channels == 1 else (*shape, channels), dtype)


@dataclass(frozen=True, slots=True)
class RecordedState:
    """What a host said of its own state: joints, commands, rewards, poses of bodies that it moved.

    Attributes
    ----------
    names : tuple of str
        What each of the K values is.
    t_us : numpy.ndarray
        int64 (N,), microseconds since the stream's start.
    values : numpy.ndarray
        float64 (N, K), in the host's own units.
    """

    names: tuple[str, ...]
    t_us: npt.NDArray[np.int64]
    values: npt.NDArray[np.float64]

    def __len__(self) -> int:
        """Count the rows."""
        return len(self.t_us)

    def __getitem__(self, name: str) -> npt.NDArray[np.float64]:
        """Return the column of that name, float64 (N,); a view."""
        if name not in self.names:
            raise KeyError(f"there is no {name!r}; there are {', '.join(self.names)}")
        return self.values[:, self.names.index(name)]


class RecordedView(EventCarrier):
    """One camera of a recording.

    Dense arrays of its events are methods: ``view.voxel_grid(bins=5)`` and others, see `EventArray`. With
    ``start_us`` and ``end_us``, they read the events between, and no others.
    """

    def __init__(self, source: _Source, index: int) -> None:
        self._source = source
        self._index = index
        self.camera = CameraInfo(**source.cameras[index])

    def __len__(self) -> int:
        """Count the events, without reading them."""
        return self._source.event_count(self._index)

    def __repr__(self) -> str:
        """Say which camera, how many events, and which labels."""
        labels = f", labels {', '.join(self.labels)}" if self.labels else ""
        return f"RecordedView({self.camera.name!r}, {len(self)} events{labels})"

    @cached_property
    def events(self) -> EventArray:
        """All events; read once and kept."""
        return self._array(None)

    @cached_property
    def causes(self) -> npt.NDArray[np.uint8] | None:
        """Why each event fired, uint8 (N,), indices of `CAUSES`; None where the file does not say."""
        return self._source.causes(self._index, None)

    def slice_time(self, start_us: int, end_us: int) -> EventArray:
        """Read the events with ``start_us <= t < end_us``, and no others."""
        return self._array((start_us, max(start_us, end_us)))

    def _event_array(self) -> EventArray:
        return self.events

    def _raw(self, limits: Limits) -> Raw:
        start_us, end_us = limits
        if start_us is None or end_us is None or "events" in self.__dict__:
            return self.events._raw(limits)
        return self.slice_time(start_us, end_us)._raw(limits)

    def _array(self, limits: tuple[int, int] | None) -> EventArray:
        events = self._source.events(self._index, limits)
        return EventArray._trusted(events, self.camera.width, self.camera.height)

    @cached_property
    def labels(self) -> Mapping[str, RecordedLabels]:
        """Labels by kind."""
        images = [kind for kind in self._source.labels if kind != CAUSE]
        return {kind: RecordedLabels(self._source, self._index, kind) for kind in images}

    @cached_property
    def poses(self) -> Poses:
        """Poses of the camera at the label rate."""
        return Poses(*self._source.poses(self._index))


class Recording(EventCarrier, ByCamera[RecordedView]):
    """A file of events: a mapping from camera names to `RecordedView`, read piece by piece.

    With one camera, `events`, `labels`, `poses`, `slice_time`, and `voxel_grid` and the other dense arrays
    need no name.

    Attributes
    ----------
    cameras : tuple of CameraInfo
        The cameras.
    labels_present : tuple of str
        Kinds of labels in it.
    seed : int
        Seed of everything random.
    environment : int
        Index of the environment in its batch.
    config_toml : str
        The settings that made it.
    t_offset_us : int
        Absolute time of the stream's start in microseconds.
    complete : bool
        Whether the writer finished it; False after a kill or Ctrl-C.
    report : mapping or None
        Counts and times that the writer left at the end.
    """

    def __init__(self, source: _Source, reload: tuple[Any, ...] | None = None) -> None:
        self._source = source
        self._reload = reload
        self.cameras = tuple(CameraInfo(**camera) for camera in source.cameras)
        self.labels_present = tuple(source.labels)
        self.seed = source.seed
        self.method = source.method
        self.environment = source.environment
        self.config_toml = source.config_toml
        self.t_offset_us = source.t_offset_us
        self.complete = source.is_complete()
        self.report: Mapping[str, Any] | None = _report(source.report_json())
        self._views = {camera.name: RecordedView(source, index) for index, camera in enumerate(self.cameras)}

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by path: the file is opened again."""
        if self._reload is None:
            raise TypeError("this recording has no file of its own; save it, and pickle what evis.load gives")
        return _load, self._reload

    @cached_property
    def bodies(self) -> Bodies | None:
        """Objects and cameras, and their poses and velocities; None where the file names none.

        Poses are there where ``pose_rate_hz`` (``--pose-rate``) was given.
        """
        source = self._source
        if not isinstance(source, _evis.Recording):
            return None
        bodies = Bodies._of(source.bodies())
        return bodies if bodies.names else None

    @property
    def instances(self) -> tuple[Instance, ...]:
        """Objects by their ids in images of the label ``instance``; empty where the file names none."""
        return () if self.bodies is None else self.bodies.instances

    @property
    def classes(self) -> dict[int, str]:
        """Names of semantic classes by ids in images of the label ``semantic``; empty where none has one."""
        return {} if self.bodies is None else self.bodies.classes

    @property
    def states(self) -> Mapping[str, RecordedState]:
        """What a host said of its own state, by name (`Writer.write_state`); empty where it said nothing."""
        source = self._source
        if not isinstance(source, _evis.Recording):
            return {}
        found = {name: source.state(name) for name in source.states()}
        return {name: RecordedState(tuple(names), t, values) for name, (names, t, values) in found.items()}

    @property
    def imus(self) -> Mapping[str, ImuSamples]:
        """Samples of inertial measurement units by name; empty where there are none."""
        source = self._source
        if not isinstance(source, _evis.Recording):
            return {}
        return {name: ImuSamples(*source.imu(name)) for name in source.imus()}

    @property
    def view(self) -> RecordedView:
        """The one camera's part.

        Raises
        ------
        EvisError
            If there are several cameras; names them.
        """
        if len(self._views) != 1:
            names = ", ".join(self._views)
            raise EvisError(f"there are {len(self._views)} cameras ({names}): choose one, recording['NAME']")
        return next(iter(self._views.values()))

    @property
    def events(self) -> EventArray:
        """All events; one camera only."""
        return self.view.events

    def _event_array(self) -> EventArray:
        return self.view.events

    def _raw(self, limits: Limits) -> Raw:
        return self.view._raw(limits)

    @property
    def labels(self) -> Mapping[str, RecordedLabels]:
        """Labels by kind; one camera only."""
        return self.view.labels

    @property
    def poses(self) -> Poses:
        """Poses of the camera; one camera only."""
        return self.view.poses

    def slice_time(self, start_us: int, end_us: int) -> EventArray:
        """Read the events with ``start_us <= t < end_us``; one camera only."""
        return self.view.slice_time(start_us, end_us)

    def __repr__(self) -> str:
        """Count events by camera."""
        counts = ", ".join(f"{name}: {len(view)} events" for name, view in self._views.items())
        return f"Recording({_evis.printable(counts)}{'' if self.complete else ', incomplete'})"


def _report(text: str | None) -> Mapping[str, Any] | None:
    if not text:
        return None
    try:
        report = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FormatError(
            f"the report in the file is no JSON ({error}); record or copy the file again"
        ) from error
    if not isinstance(report, dict):
        raise FormatError(
            f"the report in the file is {_check.shown(report)}, and no mapping; record it again"
        )
    return report


def _read_foreign(
    path: Path, error: FormatError, camera: str | None, width: int | None, height: int | None
) -> Any:
    """Read an HDF5 file that EVIS's own reader refused with ``error``."""
    # A recording of EVIS that is damaged also resembles other programs' layouts, and is not read as one.
    if "`info --repair`" in str(error) or "report" in str(error):
        raise error
    try:
        return _io.read_all(path, camera, width, height)
    except FormatError as other:
        # Where it is none of their layouts either, the first error says more.
        if "none of the known layouts" in str(other):
            raise error from None
        raise


def load(
    path: str | PathLike[str],
    *,
    width: int | None = None,
    height: int | None = None,
    mapped: bool = False,
    camera: str | None = None,
) -> Recording:
    """Open a file of events; its content tells the format.

    A recording of EVIS is read piece by piece, whatever state it is in: also while it is being written, and
    after its writer was killed. Of every other format all events are read at once, sorted by time; `open`
    reads those piece by piece.

    Parameters
    ----------
    path : path
        A file of one of `formats`, or a folder in DSEC's layout.
    width, height : int, optional
        Size of the sensor for files that do not hold it; if not given, the smallest that holds all
        events.
    mapped : bool
        Map an ``.npy`` file into memory instead of reading it.
    camera : str, optional
        The camera, of a file of another program that has several.

    Returns
    -------
    Recording
        ``recording.events`` for one camera, ``recording["left"].events`` for several.

    Raises
    ------
    OSError
        If the file cannot be read.
    FormatError
        If it holds no events, is damaged, or holds events that cannot be: outside of the sensor, out of
        order, of another polarity than 0 and 1 (-1 counts as 0 in NumPy files that are not mapped).
    ConfigError
        If its content tells no format and its ending none either, or ``width`` or ``height`` is less than its
        events need.
    """
    path = Path(path)
    ending = path.suffix.lower()
    format = _evis.recognise_format(path)
    reload = (path.absolute(), width, height, mapped, camera)
    if format == "hdf5" or (format is None and ending in HDF5_ENDINGS):
        try:
            return Recording(_evis.Recording(path), reload)
        except FormatError as error:
            found = _read_foreign(path, error, camera, width, height)
            return Recording(_ArraySource(*found), reload)
    if ending in (".npz", ".npy") and format in (ending[1:], None):
        return Recording(_ArraySource(_load_arrays(path, width, height, mapped)), reload)
    if format is None and path.is_dir():
        raise ConfigError(f"path is the folder {path}, which is not in DSEC's layout; give a file of events")
    if format is None:
        raise ConfigError(
            f"path ends with '{ending}' and its content tells no format; it must be one of "
            f"{', '.join(_io.formats())}"
        )
    return Recording(_ArraySource(*_io.read_all(path, camera, width, height)), reload)


def _load(
    path: Path, width: int | None, height: int | None, mapped: bool, camera: str | None = None
) -> Recording:
    return load(path, width=width, height=height, mapped=mapped, camera=camera)


def _load_arrays(path: Path, width: int | None, height: int | None, mapped: bool) -> EventArray:
    for name, side in (("width", width), ("height", height)):
        if side is not None:
            _check.whole(name, side, 1, 65536, " pixels")
    if mapped and path.suffix.lower() == ".npy":
        events = _mapped(path)
        sides = [int(events[axis].max(initial=0)) + 1 for axis in ("x", "y")]
    else:
        events, *sides = _evis.read_events(path)
    wanted = []
    for name, axis, given, held in zip(("width", "height"), "xy", (width, height), sides, strict=True):
        least = int(events[axis].max(initial=0)) + 1 if given is not None else 0
        if given is not None and given < least:
            raise ConfigError(
                f"{name} is {given}; {path} has events up to {axis} = {least - 1}: {least} works"
            )
        wanted.append(held if given is None else given)
    return EventArray._trusted(events, *wanted)


def _mapped(path: Path) -> npt.NDArray[np.void]:
    if not path.is_file() and path.exists():
        raise FormatError(f"{path} is no regular file; give a file of events")
    try:
        events = as_event_cd(np.load(path, mmap_mode="r", allow_pickle=False))
    except OSError:
        raise
    except Exception as error:
        # NumPy's reader of headers raises whatever Python's parser does.
        raise FormatError(f"{path} cannot be read: {error}; it must hold events (evis.EventCD)") from error
    late = max(abs(int(limit)) for limit in (events["t"].min(initial=0), events["t"].max(initial=0)))
    if bool((np.diff(events["t"]) < 0).any()):
        raise FormatError(f"{path} cannot be read: its events are not sorted by t")
    if not 0 <= int(events["p"].min(initial=0)) <= int(events["p"].max(initial=0)) <= 1:
        raise FormatError(f"{path} cannot be read: it has polarities other than 0 (OFF) and 1 (ON)")
    if late > _evis.MOST_T_US:
        raise FormatError(f"{path} cannot be read: it has events at {late} us; {_evis.MOST_T_US} us work")
    return events


def _states(given: Mapping[str, Sequence[str]] | None) -> dict[str, list[str]]:
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise ConfigError(
            f"states is {_check.shown(given)}; it must be a mapping, such as {{'arm': ['shoulder', 'elbow']}}"
        )
    return {str(name): _check.names(f"states[{name!r}]", names) for name, names in given.items()}


class Writer:
    """Writes packets to a file as they come. In HDF5, what is flushed each second survives a kill.

    Other formats (see `save`) hold the events of one camera, without labels and poses; their file has its
    name once it is closed, also where an exception ended it.

    Several environments give one file each: ``out.h5`` becomes ``out_0000.h5``, ``out_0001.h5`` and so on.
    Left by an exception, Ctrl-C included, the files keep what was written and stay readable, marked as
    incomplete.

    Parameters
    ----------
    path : path
        Ends with ``.h5`` or ``.hdf5``, or with the ending of another format.
    simulator : Simulator
        Where the packets come from.
    duration_us : int, optional
        Stream time in microseconds that no event passes, where it is known: times are then stored as
        uint32 (as DSEC does) where they fit, else as int64.
    overwrite : bool
        Replace files that exist.
    imus : sequence of str
        Names of inertial measurement units that `write_imu` brings samples of; HDF5 only.
    states : mapping of str to sequence of str, optional
        Names of what `write_state` brings, each with the names of its values, such as
        ``{"arm": ["shoulder", "elbow"]}``; HDF5 only.
    pose_rate_hz : float, optional
        Poses and velocities of objects and cameras per second, up to the end of the last packet
        (`Recording.bodies`); none where not given. HDF5 only. Where a host moves nodes (``poses`` of the
        simulator), also at the times at which it gave poses, as it gave them, and a microsecond after a
        `Simulator.reset` that moved a node; velocities are then those that it gave, or the mean ones since
        the pose before.

    Raises
    ------
    FileExistsError
        If a file exists, unless ``overwrite``.
    ConfigError
        If the path's ending tells no format, or the format does not hold the simulator's cameras or labels.

    Examples
    --------
    >>> import evis, tempfile, pathlib
    >>> sim = evis.Simulator(evis.Scene.builtin("spinner"), size=(64, 48))
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "out.h5"
    >>> with evis.Writer(path, sim) as writer, sim.stream(duration=0.02) as stream:
    ...     for packet in stream:
    ...         writer.write(packet)
    >>> evis.load(path).complete
    True
    """

    def __init__(
        self,
        path: str | PathLike[str],
        simulator: Simulator,
        *,
        duration_us: int | None = None,
        overwrite: bool = False,
        imus: Sequence[str] = (),
        states: Mapping[str, Sequence[str]] | None = None,
        pose_rate_hz: float | None = None,
    ) -> None:
        path = Path(path)
        self._format = _io.format_for(path)
        self._imus = [str(name) for name in imus]
        if self._imus and self._format != "hdf5":
            raise ConfigError(f"{path.suffix} holds no inertial samples; write to .h5")
        self._states = _states(states)
        if self._states and self._format != "hdf5":
            raise ConfigError(f"{path.suffix} holds no states; write to .h5")
        if not isinstance(simulator, Simulator):
            raise ConfigError(
                f"simulator is {_check.shown(simulator)}; it must be the evis.Simulator of the packets"
            )
        self._pose_rate_hz = _check.number_or_none("pose_rate_hz", pose_rate_hz)
        if self._pose_rate_hz is not None:
            if self._format != "hdf5":
                raise ConfigError(f"{path.suffix} holds no poses; write to .h5, or leave pose_rate_hz away")
            _evis.body_times(self._pose_rate_hz, 0, 0)
        self._bodies_until_us = -1
        self._host_bodies: _evis.HostBodies | None = None
        if self._format != "hdf5" and (len(simulator.cameras) > 1 or simulator.labels):
            raise ConfigError(
                f"{path.suffix} holds the events of one camera; the simulator has {len(simulator.cameras)} "
                f"cameras and the labels {tuple(simulator.labels)}: write to .h5"
            )
        count = simulator.environments
        self._simulator = simulator
        self._duration_us = duration_us
        self._overwrite = overwrite
        self._paths = (
            (path,)
            if count == 1
            else tuple(path.with_stem(f"{path.stem}_{index:04d}") for index in range(count))
        )
        for each in self._paths:
            _check_free(each, overwrite)
        self._names = self._paths
        self._camera_index = {camera.name: index for index, camera in enumerate(simulator.cameras)}
        self._writers: list[_evis.Writer] = []
        self._event_writers: list[_evis.EventFileWriter] = []
        self._totals: dict[str, Any] = {}

    @property
    def paths(self) -> tuple[Path, ...]:
        """The files, one per environment; also once they are closed."""
        return self._names

    def _open(self) -> list[_evis.Writer]:
        # Not before the first packet is there: a run that fails at once leaves no file and keeps an old one.
        while len(self._writers) < len(self._paths):
            environment = len(self._writers)
            self._writers.append(
                _evis.Writer(
                    self._paths[environment],
                    cameras=[asdict(camera) for camera in self._simulator.cameras_of(environment)],
                    seed=self._simulator.seed,
                    method=self._simulator.method,
                    environment=environment,
                    config_toml=self._simulator.config_toml,
                    duration_us=self._duration_us,
                    t_offset_us=0,
                    labels=list(self._simulator.labels),
                    overwrite=self._overwrite,
                    imus=self._imus,
                    bodies=self._bodies(environment, [])._infos(),
                    states=list(self._states.items()),
                )
            )
        return self._writers

    def _bodies(self, environment: int, t_us: list[int]) -> Bodies:
        simulator = self._simulator
        cameras = [camera.name for camera in simulator.cameras]
        start_us = simulator._engine.start_us
        return bodies_of(simulator.scene._raw, cameras, environment, start_us, t_us)

    def _bodies_of(self, packet: Packet, rate_hz: float) -> list[Bodies]:
        """Where bodies were during a packet, by environment."""
        simulator = self._simulator
        if simulator._driven and packet._host is None:
            raise ConfigError(
                f"the packet of {packet.start_us} to {packet.end_us} us is a copy, which does not say where "
                "nodes were; with pose_rate_hz, write what Simulator.step returned"
            )
        times = _evis.body_times(rate_hz, self._bodies_until_us, packet.end_us)
        self._bodies_until_us = packet.end_us
        if packet._host is None or not simulator._driven:
            return [self._bodies(each, times) for each in range(len(self._paths))] if times else []
        if self._host_bodies is None:
            cameras = [camera.name for camera in simulator.cameras]
            start_us = simulator._engine.start_us
            self._host_bodies = _evis.HostBodies(simulator.scene._raw, simulator._driven, cameras, start_us)
        # Nothing is known of what was before the first packet that is written.
        known = [t_us for t_us in times if t_us >= packet.start_us]
        return [Bodies._of(raw) for raw in self._host_bodies.follow(packet._host, known)]

    def _open_events(self) -> list[_evis.EventFileWriter]:
        camera = self._simulator.cameras[0]
        while len(self._event_writers) < len(self._paths):
            path = self._paths[len(self._event_writers)]
            size = (camera.width, camera.height)
            self._event_writers.append(
                _evis.EventFileWriter(path, format=self._format, size=size, overwrite=self._overwrite)
            )
        return self._event_writers

    def write_imu(self, name: str, samples: ImuSamples, *, environment: int = 0) -> None:
        """Append samples of an inertial measurement unit, which continue those written before.

        Parameters
        ----------
        name : str
            One of `imus`.
        samples : ImuSamples
            From `evis.imu.simulate`.
        environment : int
            Whose file.

        Raises
        ------
        OSError
            If the disk refuses.
        ConfigError
            If there is no such unit or environment.
        FormatError
            If times go back, or a value is not finite.
        """
        if name not in self._imus:
            raise ConfigError(f"imus has no {name!r}; it has {', '.join(self._imus) or 'none'}")
        environment = _check.whole("environment", environment, 0, len(self._paths) - 1)
        self._open()[environment].write_imu(self._imus.index(name), *columns_of(samples))

    def write_state(
        self, name: str, t_us: npt.ArrayLike, values: npt.ArrayLike, *, environment: int = 0
    ) -> None:
        """Append what the host says of its own state, which continues what was written before.

        Parameters
        ----------
        name : str
            One of `states`.
        t_us : int or array_like of int
            Stream time in microseconds, () or (N,).
        values : array_like of float
            (K,) of one time, or (N, K), in the order of the names; stored as float64, NaN too.
        environment : int
            Whose file.

        Raises
        ------
        OSError
            If the disk refuses.
        ConfigError
            If there is no such state or environment, or a shape is another one.
        FormatError
            If a time does not come after the one before.
        """
        if name not in self._states:
            raise ConfigError(f"states has no {name!r}; it has {', '.join(self._states) or 'none'}")
        environment = _check.whole("environment", environment, 0, len(self._paths) - 1)
        times = np.asarray(t_us)
        try:
            rows = np.asarray(values, np.float64)
        except (TypeError, ValueError):
            raise ConfigError(f"values is {_check.shown(values)}; it must be numbers") from None
        width = len(self._states[name])
        if times.ndim > 1 or times.dtype.kind not in "iu":
            raise ConfigError(f"t_us is {_check.shown(t_us)}; it must be whole microseconds, one or (N,)")
        if rows.shape != (*times.shape, width):
            raise ConfigError(f"values has shape {rows.shape}; it must have {(*times.shape, width)}")
        flat = np.atleast_1d(times).astype(np.int64)
        index = list(self._states).index(name)
        self._open()[environment].write_state(
            index, flat, np.ascontiguousarray(rows.reshape(len(flat), width))
        )

    def write(self, packet: Packet) -> None:
        """Append a packet; packets are written in order.

        Raises
        ------
        OSError
            If the disk refuses.
        FormatError
            If the packet does not continue what was written.
        ConfigError
            If the poses of nodes that a host moves are wanted, and the packet is a copy.
        """
        if self._format != "hdf5":
            event_writers = self._open_events()
            for view in packet.views:
                event_writers[view.environment].write(np.ascontiguousarray(view.events.to_numpy()))
            return
        rate_hz = self._pose_rate_hz
        bodies = [] if rate_hz is None else self._bodies_of(packet, rate_hz)
        writers = self._open()
        for view in packet.views:
            writer = writers[view.environment]
            camera = self._camera_index[view.camera.name]
            writer.write_events(camera, np.ascontiguousarray(view.events.to_numpy()), view.causes)
            for labels in view.labels.values():
                for t_us, t_other_us, image in zip(
                    labels.t_us.tolist(), labels.t_other_us.tolist(), labels.images, strict=True
                ):
                    writer.write_label(camera, labels.kind, t_us, t_other_us, image)
            writer.write_poses(camera, view.poses.t_us, view.poses.position, view.poses.rotation)
        for writer, made in zip(writers, bodies, strict=False):
            velocities = made.linear_velocity, made.angular_velocity
            writer.write_bodies(made.t_us, made.position, made.rotation, *velocities)
        for name, amount in asdict(packet.report).items():
            self._totals[name] = self._totals.get(name, type(amount)()) + amount

    def close(self) -> None:
        """Finish the files; closing twice does nothing."""
        if self._format != "hdf5":
            event_writers = self._open_events()
            self._event_writers, self._paths = [], ()
            for event_writer in event_writers:
                event_writer.finish()
            return
        writers = self._open()
        report = json.dumps(self._totals)
        self._writers, self._paths = [], ()
        for writer in writers:
            writer.finish(report)

    def __enter__(self) -> Writer:
        """Return the writer."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish the files, or leave them incomplete after an exception."""
        if kind is None:
            self.close()
            return
        event_writers, self._event_writers = self._event_writers, []
        for event_writer in event_writers:
            event_writer.finish()
        writers, self._writers, self._paths = self._writers, [], ()
        for writer in writers:
            writer.abandon()


def save(
    path: str | PathLike[str],
    source: Stream | EventArray | Mapping[str, EventArray] | Recording,
    *,
    overwrite: bool = False,
    format: str | None = None,
    pose_rate_hz: float | None = None,
) -> tuple[Path, ...]:
    """Write events to a file.

    Parameters
    ----------
    path : path
        ``.h5`` or ``.hdf5`` for everything; an ending of another format for the events of one camera:
        ``.raw`` (EVT 3.0), ``.dat``, ``.aedat4``, ``.aedat``, ``.txt``, ``.zip``, ``.npz``, ``.npy``,
        ``.mcap``, ``.es``.
    source : Stream, EventArray, mapping of str to EventArray, or Recording
        A stream is simulated while it is written; each second what is there is flushed, and Ctrl-C keeps it.
        A mapping goes from camera names to events.
    overwrite : bool
        Replace a file that exists.
    format : str, optional
        A key of `formats`, where the ending does not tell it: ``"evt2"``.
    pose_rate_hz : float, optional
        Of a stream: poses and velocities of objects and cameras per second, see `Writer`.

    Returns
    -------
    tuple of Path
        The files written: one per environment.

    Raises
    ------
    FileExistsError
        If a file exists, unless ``overwrite``.
    OSError
        If the disk refuses.
    ConfigError
        If the ending is another, or the format cannot hold the source.
    """
    path = Path(path)
    if not isinstance(source, (Stream, Recording)):
        arrays = list(source.values()) if isinstance(source, Mapping) else [source]
        if not all(isinstance(events, EventArray) for events in arrays):
            raise ConfigError(
                f"source is {_check.shown(source)}; it must be a Stream, as Simulator.stream makes, an "
                "evis.EventArray, a mapping of them by camera, or an evis.Recording"
            )
    name = format if format is not None else _evis.format_of_ending(path)
    if pose_rate_hz is not None and not (name == "hdf5" and isinstance(source, Stream)):
        raise ConfigError("pose_rate_hz is given; it is for streams that are written to .h5")
    if name == "hdf5":
        if isinstance(source, Stream):
            return _save_stream(path, source, overwrite, pose_rate_hz)
        _check_free(path, overwrite)
        if isinstance(source, Recording):
            _save_recording(path, source, overwrite)
        else:
            cameras = {"camera": source} if isinstance(source, EventArray) else source
            _save_cameras(path, cameras, overwrite)
    elif name in ("npz", "npy"):
        _check_free(path, overwrite)
        _save_arrays(path, _single(source), name)
    else:
        name = _io.format_for(path, format)
        _check_free(path, overwrite)
        _io.write_all(path, _single(source), name, overwrite)
    return (path,)


def _check_free(path: Path, overwrite: bool) -> None:
    if path.exists() and not overwrite:
        raise FileExistsError(f"{path} exists; choose another name, or pass overwrite=True")


def _save_stream(path: Path, stream: Stream, overwrite: bool, pose_rate_hz: float | None) -> tuple[Path, ...]:
    with stream:
        writer = Writer(
            path,
            stream.simulator,
            duration_us=stream.end_us,
            overwrite=overwrite,
            pose_rate_hz=pose_rate_hz,
        )
        paths = writer.paths
        with writer:
            for packet in stream:
                writer.write(packet)
    return paths


def _open_plain(path: Path, cameras: Sequence[dict[str, Any]], end_us: int, overwrite: bool) -> _evis.Writer:
    return _evis.Writer(
        path,
        cameras=list(cameras),
        seed=0,
        method="",
        environment=0,
        config_toml="",
        duration_us=end_us,
        t_offset_us=0,
        labels=[],
        overwrite=overwrite,
    )


def _save_cameras(path: Path, cameras: Mapping[str, EventArray], overwrite: bool) -> None:
    if not cameras:
        raise ConfigError("source is an empty mapping; it must hold at least one camera")
    end_us = max((int(events.t[-1]) + 1 for events in cameras.values() if len(events)), default=0)
    infos = [camera_of(events, name) for name, events in cameras.items()]
    writer = _open_plain(path, infos, end_us, overwrite)
    for index, events in enumerate(cameras.values()):
        writer.write_events(index, events.to_numpy())
    writer.finish("{}")


def _save_recording(path: Path, recording: Recording, overwrite: bool) -> None:
    bodies, imus, states = recording.bodies, recording.imus, recording.states
    writer = _evis.Writer(
        path,
        cameras=[asdict(camera) for camera in recording.cameras],
        seed=recording.seed,
        method=recording.method,
        environment=recording.environment,
        config_toml=recording.config_toml,
        duration_us=None,
        t_offset_us=recording.t_offset_us,
        labels=list(recording.labels_present),
        overwrite=overwrite,
        imus=list(imus),
        bodies=[] if bodies is None else bodies._infos(),
        states=[(name, list(state.names)) for name, state in states.items()],
    )
    for index, samples in enumerate(imus.values()):
        writer.write_imu(index, *columns_of(samples))
    for index, state in enumerate(states.values()):
        writer.write_state(index, state.t_us, state.values)
    for index, view in enumerate(recording.values()):
        writer.write_events(index, view.events.to_numpy(), view.causes)
        for kind, images in view.labels.items():
            for position in range(len(images)):
                t_us, t_other_us = images.interval_us(position)
                writer.write_label(index, kind, t_us, t_other_us, images[position])
        writer.write_poses(index, view.poses.t_us, view.poses.position, view.poses.rotation)
    if bodies is not None:
        velocities = bodies.linear_velocity, bodies.angular_velocity
        writer.write_bodies(bodies.t_us, bodies.position, bodies.rotation, *velocities)
    writer.finish(json.dumps(recording.report or {}))


def _single(source: Stream | EventArray | Mapping[str, EventArray] | Recording) -> EventArray:
    """Return the one camera's events of ``source``, for formats that hold no more."""
    if isinstance(source, EventArray):
        return source
    if isinstance(source, Stream):
        with source:
            cameras, environments = source.simulator.cameras, source.simulator.environments
            if len(cameras) * environments != 1:
                raise ConfigError(
                    f"the stream has {len(cameras)} cameras in {environments} environments; this format "
                    "holds one camera: write to .h5"
                )
            parts = [packet.events.to_numpy() for packet in source]
            events = np.concatenate(parts) if parts else np.empty(0, EventCD)
            return EventArray._trusted(events, cameras[0].width, cameras[0].height)
    if len(source) != 1:
        raise ConfigError(f"source holds {len(source)} cameras; this format holds one: write to .h5")
    if isinstance(source, Recording):
        return source.events
    return next(iter(source.values()))


def _save_arrays(path: Path, events: EventArray, format: str) -> None:
    # Under another name first: a failure leaves no half-written file.
    path = Path(os.path.realpath(path))
    draft = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}.draft")
    try:
        with draft.open("wb") as file:
            if format == "npy":
                np.save(file, events.to_numpy(), allow_pickle=False)
            else:
                t, x, y, p = events.columns
                np.savez_compressed(file, t=t, x=x, y=y, p=p, width=events.width, height=events.height)
        os.replace(draft, path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise
