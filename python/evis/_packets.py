"""What a stream yields."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeAlias, overload

import numpy as np
import numpy.typing as npt

from . import _check, _evis
from ._by_camera import ByCamera
from ._events import EventArray, EventCarrier, EventCD, Events, EventWindow
from ._evis import ConfigError, EvisError
from .lens import Lens, distortion_of

CAUSE = "cause"

CAUSES = ("signal", "leak", "shot", "hot")
"""Why an event fired, by number: light, the pixel's leak, shot noise, a hot pixel."""

LABEL_KINDS: Mapping[str, tuple[np.dtype[Any], int]] = MappingProxyType(
    {name: (np.dtype(dtype), channels) for name, dtype, channels in _evis.label_kinds()}
)
"""Per label: its dtype, and its values per pixel."""


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """A rendered camera; pixel centres lie at +0.5.

    Attributes
    ----------
    name : str
        Name of the camera.
    width, height : int
        Pixels.
    fx, fy : float
        Focal lengths in pixels; NaN, as cx and cy, where the lens is not known or orthographic.
    cx, cy : float
        Principal point in pixels from the left and the top edge; OpenCV, ROS and DSEC want 0.5 less.
    distortion_model : str, optional
        ``radtan`` or ``fisheye``; None for a pinhole.
    distortion_coefficients : tuple of float
        In OpenCV's order; empty for a pinhole.
    """

    name: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion_model: str | None = None
    distortion_coefficients: tuple[float, ...] = ()

    @property
    def lens(self) -> Lens:
        """The lens, which projects points and unprojects pixels."""
        distortion = None
        if self.distortion_model is not None:
            distortion = distortion_of(self.distortion_model, self.distortion_coefficients)
        return Lens(fx=self.fx, fy=self.fy, cx=self.cx, cy=self.cy, distortion=distortion)

    @property
    def matrix(self) -> npt.NDArray[np.float64]:
        """Intrinsic matrix, float64 (3, 3); x right, y down, z forward, pixel centres at +0.5."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def __repr__(self) -> str:
        """Say its name, size and focal lengths."""
        lens = "" if self.distortion_model is None else f", {self.distortion_model}"
        return (
            f"CameraInfo({self.name!r}, {self.width}x{self.height}, fx {self.fx:.6g}, fy {self.fy:.6g}{lens})"
        )


@dataclass(frozen=True, slots=True)
class Poses:
    """Poses of a camera over time, ``world_from_camera``: metres, +Y up, the camera looks along its -Z.

    Attributes
    ----------
    t_us : numpy.ndarray
        int64 (N,), microseconds.
    position : numpy.ndarray
        float64 (N, 3), metres.
    rotation : numpy.ndarray
        float64 (N, 4), unit quaternions (x, y, z, w).
    """

    t_us: npt.NDArray[np.int64]
    position: npt.NDArray[np.float64]
    rotation: npt.NDArray[np.float64]

    def __len__(self) -> int:
        """Count the poses."""
        return len(self.t_us)

    def __repr__(self) -> str:
        """Count them, and say when."""
        when = f", t_us {self.t_us[0]} to {self.t_us[-1]}" if len(self) else ""
        return f"Poses({len(self)} poses{when})"

    @property
    def matrix(self) -> npt.NDArray[np.float64]:
        """Matrices ``world_from_camera``, float64 (N, 4, 4)."""
        x, y, z, w = self.rotation.T
        made = np.zeros((len(self), 4, 4))
        made[:, 0, :3] = np.stack([0.5 - y * y - z * z, x * y - z * w, x * z + y * w], axis=-1)
        made[:, 1, :3] = np.stack([x * y + z * w, 0.5 - x * x - z * z, y * z - x * w], axis=-1)
        made[:, 2, :3] = np.stack([x * z - y * w, y * z + x * w, 0.5 - x * x - y * y], axis=-1)
        made *= 2.0
        made[:, :3, 3] = self.position
        made[:, 3, 3] = 1.0
        return made


AnyEvents: TypeAlias = "EventArray | EventWindow | EventCarrier"
"""Events of one camera, or what carries them."""


@dataclass(frozen=True, slots=True)
class Labels:
    """Images of one kind of label, by time.

    Attributes
    ----------
    kind : str
        ``depth`` (float32 (H, W), planar z in metres, +inf where nothing), ``flow_forward`` and
        ``flow_backward`` (float32 (H, W, 2), pixels, x right, y down), ``flow_forward_valid`` and
        ``flow_backward_valid`` (uint8 (H, W)), ``instance`` and ``semantic`` (uint32 (H, W), 0 where
        nothing), ``normal`` (float32 (H, W, 3), world axes) ``hdr`` (float32 (H, W, 3), linear RGB)
        or ``frame`` (float32 (H, W), mean linear luminance over an exposure).
    t_us : numpy.ndarray
        int64 (N,), microseconds since the stream's start.
    t_other_us : numpy.ndarray
        int64 (N,), the other end of a flow's interval, or the start of a frame's exposure, whose middle is
        `t_us`; equal to `t_us` for every other kind. `start_us` and `end_us` are an exposure's ends.
    images : tuple of numpy.ndarray
        N images, never copied.
    """

    kind: str
    t_us: npt.NDArray[np.int64]
    t_other_us: npt.NDArray[np.int64]
    images: tuple[npt.NDArray[Any], ...]
    _size: tuple[int, int]

    @property
    def start_us(self) -> npt.NDArray[np.int64]:
        """When each image begins, int64 (N,): a frame's exposure; of labels, their time."""
        return self.t_other_us if self.kind == "frame" else self.t_us

    @property
    def end_us(self) -> npt.NDArray[np.int64]:
        """When each image ends, int64 (N,): a frame's exposure; of labels, their time."""
        return 2 * self.t_us - self.t_other_us if self.kind == "frame" else self.t_us

    def __repr__(self) -> str:
        """Say what they are, how many, and when; images have millions of numbers."""
        width, height = self._size
        when = f", t_us {self.t_us[0]} to {self.t_us[-1]}" if len(self) else ""
        return f"Labels({self.kind!r}, {len(self)} images, {width}x{height}{when})"

    def __len__(self) -> int:
        """Count the images."""
        return len(self.images)

    def __iter__(self) -> Iterator[tuple[int, npt.NDArray[Any]]]:
        """Iterate over (t_us, image)."""
        return zip(self.t_us.tolist(), self.images, strict=True)

    @property
    def data(self) -> npt.NDArray[Any]:
        """All images as one array (N, H, W) or (N, H, W, C); a copy where N > 1."""
        if len(self.images) == 1:
            return self.images[0][np.newaxis]
        if self.images:
            return np.stack(self.images)
        dtype, channels = LABEL_KINDS[self.kind]
        width, height = self._size
        return np.empty((0, height, width) if channels == 1 else (0, height, width, channels), dtype)

    def at_events(self, events: AnyEvents) -> tuple[npt.NDArray[Any], npt.NDArray[np.int64]]:
        """Return what the image nearest in time says at each event's pixel.

        Parameters
        ----------
        events : EventArray, View or other carrier of events
            N events of the same camera.

        Returns
        -------
        values : numpy.ndarray
            (N,) or (N, C), of the images' dtype: depth, flow, instance or another label per event.
        apart_us : numpy.ndarray
            int64 (N,), time between event and image, microseconds. What moved by a pixel meanwhile may be
            something else there: `label_rate_hz` bounds it.

        Raises
        ------
        ConfigError
            If there is no image, or the events have another size.

        Examples
        --------
        >>> import evis
        >>> scene = evis.Scene.builtin("spinner")
        >>> sim = evis.Simulator(scene, size=(64, 48), labels=["instance"], label_rate_hz=1000)
        >>> packet = sim.step(20_000)
        >>> instance, apart_us = packet.labels["instance"].at_events(packet.events)
        >>> instance.shape == packet.t.shape, int(apart_us.max()) <= 1000
        (True, True)
        """
        return values_at(self, self._size, lambda k: self.images[k], events)


def values_at(
    labels: Any, size: tuple[int, int], image: Callable[[int], npt.NDArray[Any]], events: AnyEvents
) -> tuple[npt.NDArray[Any], npt.NDArray[np.int64]]:
    """Read ``labels``, whose images have ``size``, at the pixels of events: `Labels.at_events`."""
    own = events._event_array() if isinstance(events, EventCarrier) else events
    if not isinstance(own, (EventArray, EventWindow)):
        raise ConfigError(
            f"events is {_check.shown(events)}; it must be an EventArray, a window or a view of them"
        )
    if (own.width, own.height) != size:
        raise ConfigError(
            f"events are {own.width}x{own.height} and the images of {labels.kind} {size[0]}x{size[1]}; give "
            "events of the same camera"
        )
    dtype, channels = LABEL_KINDS[labels.kind]
    values = np.empty(len(own) if channels == 1 else (len(own), channels), dtype)
    times = labels.t_us
    if not len(own):
        return values, np.empty(0, np.int64)
    if not len(times):
        raise ConfigError(f"there is no image of {labels.kind}; a higher label_rate_hz makes more")
    nearest = np.searchsorted(times[:-1] + np.diff(times) // 2, own.t)
    order = np.argsort(nearest, kind="stable")
    ends = np.searchsorted(nearest[order], np.arange(len(times) + 1))
    for k in np.flatnonzero(np.diff(ends)):
        here = order[ends[k] : ends[k + 1]]
        values[here] = image(int(k))[own.y[here], own.x[here]]
    return values, np.abs(own.t - times[nearest])


@dataclass(frozen=True, slots=True)
class DenseWindows:
    """Dense arrays of the windows of time that end in a packet; see ``dense`` of `Simulator`.

    Attributes
    ----------
    start_us, end_us : numpy.ndarray
        int64 (K,), when each window begins and ends, microseconds since the stream's start.
    arrays : tuple of numpy.ndarray
        K arrays, each as the function of `evis.representations` makes it of the window's events; never
        copied.
    """

    start_us: npt.NDArray[np.int64]
    end_us: npt.NDArray[np.int64]
    arrays: tuple[npt.NDArray[Any], ...]

    def __len__(self) -> int:
        """Count the windows."""
        return len(self.arrays)

    def __iter__(self) -> Iterator[npt.NDArray[Any]]:
        """Iterate over the arrays."""
        return iter(self.arrays)

    def __getitem__(self, index: int) -> npt.NDArray[Any]:
        """Return the array of a window."""
        return self.arrays[index]

    def __repr__(self) -> str:
        """Say how many, of which shape, and when."""
        if not len(self):
            return "DenseWindows(0 windows)"
        array = self.arrays[0]
        when = f"{self.start_us[0]} to {self.end_us[-1]} us"
        return f"DenseWindows({len(self)} windows of {array.dtype} {array.shape}, {when})"


@dataclass(frozen=True, slots=True)
class View(EventCarrier):
    """One camera of one environment, during a packet.

    Dense arrays of its events are methods: ``view.voxel_grid(bins=5)`` and others, see `EventArray`.

    Attributes
    ----------
    environment : int
        Index of the environment.
    camera : CameraInfo
        The camera, with the lens that it has in this environment.
    labels : mapping of str to Labels
        One entry per label asked for, also where no image falls into the packet.
    poses : Poses
        Poses of the camera at the label rate.
    causes : numpy.ndarray or None
        Why each event fired, uint8 (N,), indices of `CAUSES`; None where ``cause`` is not among the labels
        asked for.
    dense : DenseWindows or None
        Dense arrays of the windows that end in the packet; None where the simulator was not asked for them.
    """

    environment: int
    camera: CameraInfo
    _events: EventArray
    labels: Mapping[str, Labels]
    poses: Poses
    causes: npt.NDArray[np.uint8] | None = None
    dense: DenseWindows | None = None

    @property
    def events(self) -> EventArray:
        """The events, sorted by (t, y, x); holds the engine's memory, never copied.

        Raises
        ------
        EvisError
            If the simulator makes dense arrays in the place of events.
        """
        if self.dense is not None:
            raise EvisError(
                "this packet has dense arrays in the place of events: view.dense; a simulator without dense= "
                "gives events, and every array of them"
            )
        return self._events

    @property
    def t(self) -> npt.NDArray[np.int64]:
        """Microseconds since the stream's start, int64 (N,); a view of `events`."""
        return self.events.t

    @property
    def x(self) -> npt.NDArray[np.uint16]:
        """Columns, from the left, uint16 (N,); a view of `events`."""
        return self.events.x

    @property
    def y(self) -> npt.NDArray[np.uint16]:
        """Rows, from the top, uint16 (N,); a view of `events`."""
        return self.events.y

    @property
    def p(self) -> npt.NDArray[np.int16]:
        """Polarities, ON = 1 and OFF = 0, int16 (N,); a view of `events`."""
        return self.events.p

    def _event_array(self) -> EventArray:
        return self.events

    def __repr__(self) -> str:
        """Say whose events they are, and how many."""
        labels = f", labels {', '.join(self.labels)}" if self.labels else ""
        where = f"{self.camera.name!r}, environment {self.environment}"
        return f"View({where}, {_held(self)}{labels})"


@dataclass(frozen=True, slots=True)
class Report:
    """Counts and measured times of a packet.

    Attributes
    ----------
    events : int
        Events of all views.
    dropped : int
        Events that the readout dropped, beyond its rate limit or where 2^18 waited for a bus; no other event
        is lost, or the run has failed.
    suppressed : int
        Events that pixels lost to their refractory period.
    clamped : int
        Pixels and intervals whose event count hit the limit.
    instants : int
        Instants sampled.
    drawn_pixels : int
        Pixels drawn for events, all views and instants, each by all of its samples; margins of keyframes too.
    rendered_tiles : int
        Tiles of 16x16 pixels, all views, whose events are rendered though the method is ``decoupled``: their
        triangles are smaller than pixels.
    on_device : int
        With ``compute="gpu"``: how many of `drawn_pixels` compute passes have evaluated.
    refollowed : int
        Pixels, counted in each block of time, that these could not follow and left to the processor.
    resting : int
        With the method ``decoupled``: pixels, counted in each block of time, of tiles of 8x8 in which nothing
        changed, which cost nothing.
    keyframes : int
        Keyframes drawn, all views; 0 for a method without them.
    clipped : int
        Pixels of keyframes, margins included, with more light than `evis-paper` counts: 65 536 Y_ref.
    clipped_light : list of str
        Of which cameras: the first time, and the brightest light.
    unknown : int
        Pixels and instants that the method could not know; there the pixel waits for its next known instant.
    reruns : int
        Submissions run again because a buffer was too small.
    audited : int
        Tiles that were skipped, or sampled less often than at every instant, and were rendered once more to
        compare; no event depends on it.
    audited_with_others : int
        Of those, tiles that were compared by samples at other places than those of the stream.
    changed : int
        Of the audited ones, tiles in which light had changed by more than half a threshold.
    findings : list of str
        What changed there: camera, pixel, time and object.
    host_ms, device_wait_ms, pack_ms, total_ms : float
        Measured milliseconds: on the host, waiting for the device, packing events, and all together.
    """

    events: int
    dropped: int
    suppressed: int
    clamped: int
    instants: int
    drawn_pixels: int
    rendered_tiles: int
    on_device: int
    refollowed: int
    resting: int
    keyframes: int
    clipped: int
    clipped_light: list[str]
    unknown: int
    reruns: int
    audited: int
    audited_with_others: int
    changed: int
    findings: list[str]
    host_ms: float
    device_wait_ms: float
    pack_ms: float
    total_ms: float


def _held(view: View) -> str:
    """Say what a view holds of events."""
    return f"{len(view.events)} events" if view.dense is None else f"{len(view.dense)} dense arrays"


def _stacked(views: tuple[View, ...], kind: str, index: int) -> npt.NDArray[Any]:
    """Stack one image of each view."""
    images = []
    for view in views:
        if kind not in view.labels:
            raise ConfigError(
                f"the packet has no label {_check.shown(kind)}; it has {', '.join(view.labels) or 'none'} "
                "(labels=[...] of the simulator)"
            )
        labels = view.labels[kind]
        if not -len(labels) <= index < len(labels):
            raise ConfigError(
                f"index is {index}; this packet has {len(labels)} images of {kind} (label_rate_hz says how "
                "often there is one)"
            )
        images.append(labels.images[index])
    return _stack(views, images)


def _stack(views: tuple[View, ...], arrays: list[npt.NDArray[Any]]) -> npt.NDArray[Any]:
    """Stack an array of each view."""
    if len({array.shape for array in arrays}) > 1:
        sizes = ", ".join(f"{view.camera.name} {view.camera.width}x{view.camera.height}" for view in views)
        raise ConfigError(
            f"cameras have different sizes ({sizes}); name one: camera='{views[0].camera.name}'"
        )
    return np.stack(arrays)


class _OneView(EventCarrier):
    """Shortcuts that need exactly one view."""

    __slots__ = ()

    @property
    def view(self) -> View:
        """The one view, where there is one camera and one environment.

        Raises
        ------
        EvisError
            If there are several; says how to choose one.
        """
        raise NotImplementedError

    def _event_array(self) -> EventArray:
        return self.view.events

    @property
    def t(self) -> npt.NDArray[np.int64]:
        """Microseconds since the stream's start, int64 (N,); one view only."""
        return self.view.t

    @property
    def x(self) -> npt.NDArray[np.uint16]:
        """Columns, from the left, uint16 (N,); one view only."""
        return self.view.x

    @property
    def y(self) -> npt.NDArray[np.uint16]:
        """Rows, from the top, uint16 (N,); one view only."""
        return self.view.y

    @property
    def p(self) -> npt.NDArray[np.int16]:
        """Polarities, ON = 1 and OFF = 0, int16 (N,); one view only."""
        return self.view.p

    @property
    def causes(self) -> npt.NDArray[np.uint8] | None:
        """Why each event fired, uint8 (N,), indices of `CAUSES`, where asked for; one view only."""
        return self.view.causes

    @property
    def dense(self) -> DenseWindows | None:
        """Dense arrays of the windows that end in the packet, where asked for; one view only."""
        return self.view.dense


class EnvironmentPacket(_OneView, ByCamera[View]):
    """One environment's part of a packet: a mapping from camera names to `View`.

    With one camera, `events`, `labels` and `poses` are that camera's own; with several, they are mappings
    by camera name.
    """

    __slots__ = ("_views", "index")

    def __init__(self, index: int, views: tuple[View, ...]) -> None:
        self.index = index
        self._views = {view.camera.name: view for view in views}

    @property
    def view(self) -> View:
        """The one view, where there is one camera."""
        if len(self._views) != 1:
            names = ", ".join(self._views)
            raise EvisError(f"there are {len(self._views)} cameras ({names}): choose one, packet['NAME']")
        return next(iter(self._views.values()))

    @property
    def events(self) -> EventArray | Any:
        """`EventArray` with one camera; a mapping from camera names to such arrays with several."""
        if len(self._views) == 1:
            return self.view.events
        return {name: view.events for name, view in self._views.items()}

    @property
    def labels(self) -> Mapping[str, Labels] | Any:
        """Labels by kind with one camera; a mapping from camera names to such mappings with several."""
        if len(self._views) == 1:
            return self.view.labels
        return {name: view.labels for name, view in self._views.items()}

    @property
    def poses(self) -> Poses | Any:
        """Poses with one camera; a mapping from camera names to poses with several."""
        if len(self._views) == 1:
            return self.view.poses
        return {name: view.poses for name, view in self._views.items()}

    def stack_labels(self, kind: str, index: int = -1) -> npt.NDArray[Any]:
        """Return one image of each camera as (N, H, W) or (N, H, W, C): see `Packet.stack_labels`."""
        return _stacked(tuple(self._views.values()), kind, index)

    def __repr__(self) -> str:
        """Count the events by camera."""
        counts = ", ".join(f"{name}: {_held(view)}" for name, view in self._views.items())
        return f"EnvironmentPacket({self.index}, {_evis.printable(counts)})"


class Packet(_OneView):
    """Everything that happened in ``[start_us, end_us)``, all environments and cameras.

    ======================  =====================================================
    one camera              ``packet.events``, ``packet.t``, ``packet.labels``
    several cameras         ``packet["left"].events``, ``packet.events["left"]``
    several environments    ``packet[3].events``, ``packet[3]["left"].events``
    everything              ``for view in packet.views: ...``
    dense arrays            ``packet.voxel_grid(bins=5)``; one view only
    made by the engine      ``packet.dense``, ``packet.stack_dense()``
    ======================  =====================================================

    Attributes
    ----------
    start_us, end_us : int
        First microsecond of the packet, and one past its last.
    views : tuple of View
        One per environment and camera, environment-major.
    report : Report
        Counts and measured times.
    """

    __slots__ = ("_environments", "_host", "end_us", "report", "start_us", "views")

    # What a host said of its time: for a `Writer` that records bodies. Copies and pickles go without it.
    _host: _evis.HostSpan | None

    def __init__(self, start_us: int, end_us: int, views: tuple[View, ...], report: Report) -> None:
        self._host = None
        self.start_us = start_us
        self.end_us = end_us
        self.views = views
        self.report = report
        grouped: dict[int, list[View]] = {}
        for view in views:
            grouped.setdefault(view.environment, []).append(view)
        self._environments = tuple(
            EnvironmentPacket(index, tuple(group)) for index, group in sorted(grouped.items())
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle what users see."""
        return Packet, (self.start_us, self.end_us, self.views, self.report)

    @property
    def environments(self) -> tuple[EnvironmentPacket, ...]:
        """The environments, by index."""
        return self._environments

    def environment(self, index: int) -> EnvironmentPacket:
        """Return environment ``index``; the same as ``packet[index]``."""
        try:
            return self._environments[index]
        except IndexError:
            raise ConfigError(
                f"environment is {index}; it must be between 0 and {len(self._environments) - 1}"
            ) from None

    @overload
    def __getitem__(self, key: int) -> EnvironmentPacket: ...
    @overload
    def __getitem__(self, key: str) -> View: ...
    def __getitem__(self, key: int | str) -> EnvironmentPacket | View:
        """Return an environment by index, or, where there is one environment, a camera's view by name."""
        if isinstance(key, str):
            return self._only[key]
        return self.environment(key)

    def packed(self, camera: str | None = None) -> tuple[Events, npt.NDArray[np.int64]]:
        """Return the events of all environments as one array.

        Parameters
        ----------
        camera : str, optional
            The camera, where there are several.

        Returns
        -------
        events : numpy.ndarray
            `EventCD` (sum of N_e,), environment by environment, each sorted by (t, y, x); a copy where there
            is more than one environment.
        offsets : numpy.ndarray
            int64 (E + 1,): those of environment e are ``events[offsets[e]:offsets[e + 1]]``.

        Raises
        ------
        EvisError
            If there are several cameras and none is named; `ConfigError`, if there is none of the name.
        """
        views = [each.view if camera is None else each[camera] for each in self._environments]
        offsets = np.zeros(len(views) + 1, np.int64)
        np.cumsum([len(view.events) for view in views], out=offsets[1:])
        if len(views) == 1:
            return views[0].events.to_numpy(), offsets
        # The padding is zero, as the engine's.
        events: Events = np.zeros(int(offsets[-1]), EventCD)
        for begin, view in zip(offsets.tolist(), views, strict=False):
            events[begin : begin + len(view.events)] = view.events.to_numpy()
        return events, offsets

    def stack_labels(self, kind: str, index: int = -1, *, camera: str | None = None) -> npt.NDArray[Any]:
        """Return one label image of each view as one array, as networks take batches.

        Parameters
        ----------
        kind : str
            Kind of label, such as ``depth``; see `Labels`.
        index : int
            Which of the packet's images; the last one where not given. All views have theirs at equal times.
        camera : str, optional
            This camera alone, of every environment; every camera where not given.

        Returns
        -------
        numpy.ndarray
            (N, H, W), or (N, H, W, C) for flow, normals and HDR, in the order of `views`: environment by
            environment, in each the cameras. A copy.

        Raises
        ------
        ConfigError
            If the packet has no such labels or image, there is no such camera, or cameras differ in size.
        """
        return _stacked(self._chosen(camera), kind, index)

    def stack_dense(self, index: int = -1, *, camera: str | None = None) -> npt.NDArray[Any]:
        """Return the dense array of one window of each view as one array, as networks take batches.

        Parameters
        ----------
        index : int
            Which of the windows that end in the packet; the last one where not given.
        camera : str, optional
            This camera alone, of every environment; every camera where not given.

        Returns
        -------
        numpy.ndarray
            (N, ..., H, W) in the order of `views`: environment by environment, in each the cameras. A copy.

        Raises
        ------
        ConfigError
            If the simulator was not asked for dense arrays, no such window ends in the packet, there is no
            such camera, or cameras differ in size.
        """
        views, arrays = self._chosen(camera), []
        for view in views:
            if view.dense is None:
                raise ConfigError(
                    "the packet has events, and no dense arrays; dense='counts' of the simulator makes them"
                )
            if not -len(view.dense) <= index < len(view.dense):
                raise ConfigError(
                    f"index is {index}; {len(view.dense)} windows end in this packet (dense_window_us of the "
                    "simulator)"
                )
            arrays.append(view.dense[index])
        return _stack(views, arrays)

    def _chosen(self, camera: str | None) -> tuple[View, ...]:
        return self.views if camera is None else tuple(each[camera] for each in self._environments)

    def __len__(self) -> int:
        """Count the environments."""
        return len(self._environments)

    def __iter__(self) -> Iterator[EnvironmentPacket]:
        """Iterate over the environments."""
        return iter(self._environments)

    @property
    def _only(self) -> EnvironmentPacket:
        if len(self._environments) != 1:
            raise EvisError(
                f"there are {len(self._environments)} environments: choose one, packet[INDEX], "
                "or iterate over packet.views"
            )
        return self._environments[0]

    @property
    def view(self) -> View:
        """The one view, where there is one camera and one environment."""
        return self._only.view

    @property
    def events(self) -> EventArray | Any:
        """`EventArray` with one camera, a mapping by camera name with several; one environment only."""
        return self._only.events

    @property
    def labels(self) -> Mapping[str, Labels] | Any:
        """Labels by kind with one camera, a mapping by camera name with several; one environment only."""
        return self._only.labels

    @property
    def poses(self) -> Poses | Any:
        """Poses with one camera, a mapping by camera name with several; one environment only."""
        return self._only.poses

    def __repr__(self) -> str:
        """Say when, and count views and events."""
        span = f"{self.start_us} to {self.end_us} us"
        return f"Packet({span}, {len(self.views)} views, {self.report.events} events)"


def labels_from(
    frames: list[_evis.Label], kinds: tuple[str, ...], size: tuple[int, int]
) -> Mapping[str, Labels]:
    """Group the engine's label images by kind; every kind of ``kinds`` gets an entry."""
    grouped: dict[str, list[_evis.Label]] = {kind: [] for kind in kinds}
    for frame in frames:
        grouped.setdefault(frame.kind, []).append(frame)
    return {
        kind: Labels(
            kind,
            np.array([frame.t_us for frame in group], dtype=np.int64),
            np.array([frame.t_other_us for frame in group], dtype=np.int64),
            tuple(frame.data for frame in group),
            size,
        )
        for kind, group in grouped.items()
    }


def _dense(windows: list[tuple[int, int, npt.NDArray[Any]]] | None) -> DenseWindows | None:
    if windows is None:
        return None
    starts, ends = (np.array([window[i] for window in windows], np.int64) for i in (0, 1))
    return DenseWindows(starts, ends, tuple(window[2] for window in windows))


def packet_from(
    raw: _evis.Packet, cameras: Sequence[tuple[CameraInfo, ...]], kinds: tuple[str, ...]
) -> Packet:
    """Dress the engine's packet; ``cameras`` by environment."""
    views = []
    for view in raw.views:
        camera = cameras[view.environment][view.camera]
        images = tuple(kind for kind in kinds if kind != CAUSE)
        labels = labels_from(view.labels, images, (camera.width, camera.height))
        causes = view.causes if CAUSE in kinds else None
        events = EventArray._trusted(view.events, camera.width, camera.height)
        poses = Poses(*view.poses)
        views.append(View(view.environment, camera, events, labels, poses, causes, _dense(view.dense)))
    packet = Packet(raw.start_us, raw.end_us, tuple(views), Report(**raw.report))
    packet._host = raw.host
    return packet
