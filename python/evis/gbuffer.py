"""Events from G-buffers: light, depth and motion vectors that a renderer makes of many environments.

`EventPipeline` is what every host shares: it checks what comes, pushes it as keyframes, and keeps events per
environment, dense arrays and files of episodes. It needs no simulator; `evis.isaaclab` is its adapter for
Isaac Lab. For renderers without motion vectors, `MotionFromPoses` makes them of depth, poses and instance
ids. docs/isaaclab.md has examples.
"""

from __future__ import annotations

import warnings
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from . import _check
from ._emulator import EventEmulator, KeyframeReport, MotionCheck, check_motion
from ._emulator import _warp as _emulator_warp
from ._episodes import EpisodeRecorder
from ._events import EventArray, EventCD
from ._evis import ConfigError
from ._host_arrays import Copies
from ._method import Warp
from ._pose_motion import Axes, MotionFromPoses, motion_from_poses
from ._sensor import Sensor, thresholds_of
from ._static import StaticCheck, check_static, compared, linear, luminance

__all__ = [
    "DEPTH",
    "LINEAR",
    "Axes",
    "EpisodeRecorder",
    "EventPipeline",
    "MotionFromPoses",
    "PipelineSettings",
    "StaticCheck",
    "check_static",
    "motion_from_poses",
]

Float = npt.NDArray[np.float32]

LINEAR = ("rgb_radiance", "rgb_hdr", "HdrColor")
"""Names under which renderers give linear light, the best first; the later two follow a camera's exposure."""

DEPTH = ("distance_to_image_plane", "depth")
"""Names under which renderers give planar depth."""

_STILL_PX = 0.01
"""What moves by less stands still: a hundredth of a pixel changes light by far less than a threshold."""

_STATIC_KEYFRAMES = 64
"""Keyframes of still pictures that are checked: exposure and filters settle within a second."""

_STATIC_SHARE = 1e-3
"""Share of a still picture's pixels that must have fired before anything is suspected."""

_DECISIVE_PX = 0.75
"""A flipped axis leads 1.5 px astray from here on, which is where `check_motion` compares."""

_DECISIVE_SHARE = 0.025
"""Share of the pixels that must move so far along an axis before its sign counts as checked."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PipelineSettings:
    """How G-buffers become events.

    Attributes
    ----------
    sensor : Sensor or str, optional
        The sensor, or the name of a preset or TOML file; an ideal one if not given.
    warp : Warp or {"splat", "evis-paper"}
        How the instants between two keyframes are made.
    steps : int or {"auto"}, optional
        Instants per gap, before ``warp.steps``; ``auto``: as many as the motion asks for. 1 where keyframes
        come at the rate of instants.
    margin : int
        Pixels that pictures show beyond each border of the sensor: they are larger by it on every side.
    light : {"hdr", "ldr"}
        ``hdr``: the first of `LINEAR` that the renderer gives. ``ldr``: ``rgb``, under the sRGB curve; what a
        tone curve clips makes no events.
    exposure_locked : bool
        Whether ``rgb_hdr`` and ``HdrColor`` may be used: their scale follows the camera's exposure, and with
        automatic exposure everything fires when it changes.
    motion_scale : (float, float)
        What x and y of motion vectors are multiplied by to lead, in pixels, x right and y down, from each
        keyframe to the last one.
    check_motion : bool
        Whether the convention of the motion vectors is checked with the first pictures that decide it.
    voxel_bins : int
        Bins of ``event_voxels``.
    window_us : int
        Microseconds before the last keyframe that dense arrays cover; 0: the gap that it ends.
    reference_luminance : float
        Y_ref of the sensor's formula, in the renderer's units: about the light of a middle grey.
    seed, camera, threads : int
        See `EventEmulator`.
    """

    sensor: Sensor | str | None = None
    warp: Warp | Literal["splat", "evis-paper"] = "splat"
    steps: int | Literal["auto"] | None = None
    margin: int = 0
    light: Literal["hdr", "ldr"] = "hdr"
    exposure_locked: bool = False
    motion_scale: tuple[float, float] = (1.0, 1.0)
    check_motion: bool = True
    voxel_bins: int = 5
    window_us: int = 0
    reference_luminance: float = 1.0
    seed: int = 0
    camera: int = 0
    threads: int = 0


class EventPipeline:
    """Turn a renderer's G-buffers of N environments, seen by one camera each, into events.

    Arrays are NumPy, PyTorch, anything with DLPack or NumPy's array interface, or wrap a tensor as ``.torch``
    (Isaac Lab's ``ProxyArray``). What is on a graphics card is copied to the CPU once per keyframe, which a
    warning says once, with its cost. Nothing is kept of a host's buffers after `push` returns.

    Parameters
    ----------
    num_envs : int
        Environments, the first dimension of every array.
    height, width : int
        Size of the sensor in pixels; pictures are larger by ``settings.margin`` on every side.
    settings : PipelineSettings, optional
        How G-buffers become events.
    name : str
        Name of the camera, in files and messages.

    Raises
    ------
    ConfigError
        If a setting cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> from evis.gbuffer import EventPipeline
    >>> pipeline = EventPipeline(2, 24, 32)
    >>> x = np.arange(32, dtype=np.float32) * np.ones((2, 24, 1), np.float32)
    >>> for k in range(2):
    ...     outputs = {
    ...         "rgb_radiance": np.repeat(0.5 + 0.4 * np.sin((x - 2 * k) / 3)[..., None], 3, axis=-1),
    ...         "distance_to_image_plane": np.full((2, 24, 32, 1), 2.0, np.float32),
    ...         "motion_vectors": np.full((2, 24, 32, 2), (-2.0, 0.0), np.float32),
    ...     }
    ...     events = pipeline.push(outputs, 8000 * k)
    >>> len(events), pipeline.output["event_counts"].shape, pipeline.reports[1].steps
    (2, (2, 24, 32, 2), 7)
    """

    def __init__(
        self,
        num_envs: int,
        height: int,
        width: int,
        settings: PipelineSettings | None = None,
        *,
        name: str = "camera",
    ) -> None:
        settings = PipelineSettings() if settings is None else settings
        if not isinstance(settings, PipelineSettings):
            raise ConfigError(f"settings is {_check.shown(settings)}; it must be a PipelineSettings")
        if settings.light not in ("hdr", "ldr"):
            raise ConfigError(f"light is {_check.shown(settings.light)}; it must be 'hdr' or 'ldr'")
        self._settings = settings
        self._name = name
        self._scale = _scale(settings.motion_scale)
        self._warp = _warp_of(settings)
        self._bins = _check.whole("voxel_bins", settings.voxel_bins, 1, 2**15)
        self._window_us = _check.time_us("window_us", settings.window_us)
        if self._window_us < 0:
            raise ConfigError(f"window_us is {self._window_us}; it must not be negative")
        self._emulator: EventEmulator[list[EventArray]] = EventEmulator(
            width,
            height,
            settings.sensor,
            batch=_check.whole("num_envs", num_envs, 1, 2**31),
            seed=settings.seed,
            camera=settings.camera,
            reference_luminance=settings.reference_luminance,
            threads=settings.threads,
        )
        self._num_envs = int(num_envs)
        border = 2 * (self._warp.margin or 0)
        self._shape = (self._num_envs, height + border, width + border)
        sensor = self._emulator.sensor
        self._threshold = min(thresholds_of(sensor)[:2])
        self._recorder: EpisodeRecorder | None = None
        self._nothing = [EventArray(np.empty(0, EventCD), width=width, height=height)] * self._num_envs
        # Of each environment: the time of its first keyframe since the last reset, None before it.
        self._starts: list[int | None] = [None] * self._num_envs
        self._now_us: int | None = None
        self._before_us: int | None = None
        self._last = list(self._nothing)
        self._recent: list[list[npt.NDArray[np.void]]] = [[] for _ in range(self._num_envs)]
        self._dense: dict[str, npt.NDArray[Any]] = {}
        # Axes of the motion vectors that are still unchecked, and the light that they are checked with.
        self._unchecked = {0, 1} if settings.check_motion else set[int]()
        self._older: npt.NDArray[Any] | None = None
        self._static_left = _STATIC_KEYFRAMES
        self._anchors: dict[int, Float] = {}
        # Checksums of the last keyframe's light and motion.
        self._seen: tuple[int, int] | None = None
        self._warned: set[str] = set()

    @property
    def num_envs(self) -> int:
        """Environments."""
        return self._num_envs

    @property
    def name(self) -> str:
        """Name of the camera."""
        return self._name

    @property
    def settings(self) -> PipelineSettings:
        """How G-buffers become events."""
        return self._settings

    @property
    def now_us(self) -> int | None:
        """Time of the last keyframe in microseconds; None before the first one."""
        return self._now_us

    @property
    def events(self) -> list[EventArray]:
        """Events of the last push, per environment."""
        return list(self._last)

    @property
    def reports(self) -> tuple[KeyframeReport, ...]:
        """What became of the last keyframe, per environment; empty before the first one."""
        found: Any = self._emulator.keyframe_report
        return tuple(found or ())

    @property
    def motion_checked(self) -> bool:
        """Whether sign, unit and axes of the motion vectors were found right, along x and along y."""
        return self._settings.check_motion and not self._unchecked

    def push(
        self,
        outputs: Mapping[str, Any],
        t_us: int,
        *,
        motion_vectors: Any = None,
        hold: Iterable[int] = (),
    ) -> list[EventArray]:
        """Take what the renderer gave at one time; return the events since the last keyframe.

        Pictures that are black and without any depth before the first keyframe come from a renderer that
        still loads: they are left out. So is, byte for byte, the last keyframe's light with its motion once
        more: the renderer did not run in between.

        Parameters
        ----------
        outputs : mapping
            By Isaac Lab's names: light, (N, H, W, 3) or (N, H, W, 4), float32 (uint8 for ``rgb``);
            ``distance_to_image_plane`` or ``depth``, float32 (N, H, W, 1) or (N, H, W), metres, +inf where
            nothing is (leave it out in all keyframes where there is none); ``motion_vectors``, float32
            (N, H, W, 2): pixels from each place to where its surface was at the last keyframe, x right,
            y down, after ``motion_scale``. Others are ignored.
        t_us : int
            Time in microseconds, above that of the last keyframe.
        motion_vectors : array_like, optional
            Instead of the renderer's, such as `MotionFromPoses` makes them.
        hold : iterable of int
            Environments whose pictures are not to be trusted (`MotionFromPoses.held`): their pixels keep
            their memory and make no events.

        Returns
        -------
        list of EventArray
            Events in ``(t0, t1]`` of each environment. An environment's first keyframe makes none.

        Raises
        ------
        ConfigError
            If a buffer is missing or cannot be used, if light is tone-mapped or follows an exposure and this
            was not allowed, or if the motion vectors follow another convention: it is named, and what to
            multiply them by. Nothing has changed then.
        """
        if not isinstance(outputs, Mapping):
            raise ConfigError(f"outputs is {_check.shown(outputs)}; it must be a mapping of names to arrays")
        t_us = _check.time_us("t_us", t_us)
        if self._now_us is not None and t_us <= self._now_us:
            raise ConfigError(f"t_us is {t_us}; it must be above {self._now_us}, that of the last keyframe")
        copies = Copies()
        light = self._light(outputs, copies)
        depth = next((copies.take(name, outputs[name]) for name in DEPTH if name in outputs), None)
        if depth is not None:
            depth = self._checked("depth", depth, (1,))
        elif "distance_to_camera" in outputs:
            raise ConfigError(
                "outputs has distance_to_camera, which is measured along rays; ask the renderer for "
                "distance_to_image_plane"
            )
        motion = self._motion(outputs, motion_vectors, copies)
        if self._now_us is None and not light.any() and (depth is None or not _any_depth(depth)):
            return list(self._nothing)
        # The same motion again says that what moved has not moved on.
        moves = bool((np.abs(motion) >= _STILL_PX).any())
        seen = (zlib.crc32(np.ascontiguousarray(light).data), zlib.crc32(np.ascontiguousarray(motion).data))
        if moves and seen == self._seen:
            return list(self._nothing)
        held = self._ids("hold", hold)
        if held:
            light = linear(light).copy()
            light[held] = np.nan
        checked = self._check_motion(light, motion, held)
        events = self._emulator.push_keyframe(
            light, depth, motion, t_us, steps=self._settings.steps, warp=self._warp
        )
        # From here on nothing fails: an error has left everything as it was.
        self._seen = seen
        self._unchecked -= checked
        self._older = light.copy() if self._unchecked else None
        self._before_us, self._now_us = self._now_us, t_us
        self._starts = [t_us if start is None else start for start in self._starts]
        self._set_last_events(events)
        self._check_still(light, motion, held)
        if copies.size:
            self._warn("copy", f"{self._name}: {copies.in_words('keyframe')}")
        return list(events)

    def record(self, recorder: EpisodeRecorder) -> None:
        """Write the events of each environment's episodes, from now on; cameras may share a recorder.

        Raises
        ------
        ConfigError
            If the recorder has a camera of this name.
        """
        recorder.join(self._name, (self._emulator.width, self._emulator.height))
        self._recorder = recorder

    def reset(self, env_ids: Any = None) -> None:
        """Reset environments with their next keyframe, and end their episodes.

        Parameters
        ----------
        env_ids : int, slice, sequence or tensor of int, optional
            Environments; all if not given.

        Raises
        ------
        ConfigError
            If there is no such environment.
        OSError
            If an episode's file cannot be written.
        """
        ids = list(range(self._num_envs)) if env_ids is None else self._ids("env_ids", env_ids)
        self._emulator.reset(ids)
        for env in ids:
            started = self._starts[env] is not None
            self._starts[env] = None
            self._recent[env] = []
            self._last[env] = self._nothing[env]
            self._anchors.pop(env, None)
            if started and self._recorder is not None:
                self._recorder.end(self._name, env)
        self._dense = {}

    @property
    def output(self) -> dict[str, npt.NDArray[Any]]:
        """Dense arrays, as hosts take observations.

        ``event_counts`` is int32 (N, H, W, 2), events, OFF first; ``event_voxels`` is float32
        (N, H, W, bins), a voxel grid of ON minus OFF (`EventArray.voxel_grid`), over ``window_us`` before the
        last keyframe, or over its gap. Zeros before the first events.
        """
        if not self._dense:
            height, width = self._emulator.height, self._emulator.width
            counts = np.zeros((self._num_envs, height, width, 2), np.int32)
            voxels = np.zeros((self._num_envs, height, width, self._bins), np.float32)
            for env in range(self._num_envs):
                events, start_us, end_us = self._window(env)
                if not len(events):
                    continue
                counts[env] = np.moveaxis(events.counts(start_us=start_us, end_us=end_us), 0, -1)
                grid = events.voxel_grid(self._bins, start_us=start_us, end_us=end_us)
                voxels[env] = np.moveaxis(grid, 0, -1)
            self._dense = {"event_counts": counts, "event_voxels": voxels}
        return dict(self._dense)

    def _window(self, env: int) -> tuple[EventArray, int, int]:
        """Events of an environment's window, and its limits."""
        events, end_us = self._last[env], (self._now_us or 0) + 1
        if self._window_us:
            if self._recent[env]:
                joined = np.concatenate(self._recent[env])
                events = EventArray(joined, width=events.width, height=events.height)
            return events, end_us - self._window_us, end_us
        start_us = end_us - 1 if self._before_us is None else self._before_us + 1
        # With an exposure, events are as old as the light that they come of.
        return events, min(start_us, int(events.t[0])) if len(events) else start_us, end_us

    def _set_last_events(self, events: list[EventArray]) -> None:
        self._last = events
        self._dense = {}
        for env, own in enumerate(events):
            if self._window_us:
                since = self._now_us - self._window_us if self._now_us is not None else 0
                parts = [part for part in self._recent[env] if len(part) and part["t"][-1] > since]
                self._recent[env] = [*parts, own.to_numpy()] if len(own) else parts
            start = self._starts[env]
            if self._recorder is not None and len(own) and start is not None:
                self._recorder.add(self._name, env, own, start)

    def _light(self, outputs: Mapping[str, Any], copies: Copies) -> npt.NDArray[Any]:
        if self._settings.light == "ldr":
            if "rgb" not in outputs:
                raise ConfigError(f"outputs has {_names(outputs)}; with light='ldr' it must have rgb")
            return self._checked("rgb", copies.take("rgb", outputs["rgb"]), (3, 1), (np.uint8, np.float32))
        name = next((name for name in LINEAR if name in outputs), None)
        if name is None:
            tone_mapped = (
                "; rgb is tone-mapped: light='ldr' takes it all the same, without what its curve clips"
                if "rgb" in outputs
                else ""
            )
            raise ConfigError(
                f"outputs has {_names(outputs)}; it must have linear light: {_check.one_of(LINEAR)}"
                f"{tone_mapped}"
            )
        if name != LINEAR[0] and not self._settings.exposure_locked:
            raise ConfigError(
                f"light is {name}, whose scale follows the camera's exposure; switch automatic exposure off "
                f"and set exposure_locked=True, or ask the renderer for {LINEAR[0]}"
            )
        return self._checked(name, copies.take(name, outputs[name]), (3, 1))

    def _motion(self, outputs: Mapping[str, Any], given: Any, copies: Copies) -> Float:
        if given is None and "motion_vectors" not in outputs:
            raise ConfigError(
                f"outputs has {_names(outputs)}; it must have motion_vectors, or give motion_vectors=: "
                "MotionFromPoses makes them of depth, poses and instance ids"
            )
        values = copies.take("motion_vectors", outputs["motion_vectors"] if given is None else given)
        motion: Float = self._checked("motion_vectors", values, (2,))
        # An adapter's own vectors are right already.
        return motion if given is not None or self._scale is None else motion * self._scale

    def _checked(
        self,
        what: str,
        array: npt.NDArray[Any],
        channels: tuple[int, ...],
        dtypes: tuple[Any, ...] = (np.float32,),
    ) -> npt.NDArray[Any]:
        """Bring an array to (N, H, W, C), of a dtype that the emulator takes."""
        given = array
        if array.ndim == 4 and array.shape[-1] == 4 and 3 in channels:
            array = array[..., :3]
        if array.ndim == 3 and 1 in channels:
            array = array[..., None]
        if array.shape[:-1] != self._shape or array.shape[-1] not in channels:
            raise ConfigError(
                f"{what} has shape {given.shape}; it must have {(*self._shape, channels[0])}: environments, "
                f"rows, columns{' with the margin' if self._warp.margin else ''}, channels"
            )
        if array.dtype in (np.float16, np.float64):
            array = array.astype(np.float32)
        if array.dtype not in dtypes:
            wanted = " or ".join(np.dtype(dtype).name for dtype in dtypes)
            raise ConfigError(f"dtype of {what} is {given.dtype}; it must be {wanted}")
        return array

    def _ids(self, what: str, ids: Any) -> list[int]:
        if isinstance(ids, slice):
            return list(range(self._num_envs))[ids]
        if not isinstance(ids, (int, np.integer, Sequence)):
            ids = list(ids) if isinstance(ids, (set, frozenset, range)) else Copies().take(what, ids)
        given = np.atleast_1d(np.asarray(ids))
        if given.ndim != 1 or (given.size and given.dtype.kind not in "iu"):
            mask = ": np.flatnonzero(mask) for a mask" if given.dtype == np.bool_ else ""
            raise ConfigError(f"{what} is {_check.shown(ids)}; it must be numbers of environments{mask}")
        for index in given:
            if not 0 <= index < self._num_envs:
                raise ConfigError(f"{what} has {index}; it must be at least 0 and below {self._num_envs}")
        return [int(index) for index in given]

    def _check_motion(self, light: npt.NDArray[Any], motion: Float, held: list[int]) -> set[int]:
        """Check the convention with the environment that moves most; return the axes that it decides."""
        if not self._unchecked or self._older is None:
            return set()
        began = [env for env, start in enumerate(self._starts) if start is not None and env not in held]
        speeds = [float(np.nan_to_num(np.abs(motion[env]), posinf=0.0).sum()) for env in began]
        if not speeds or max(speeds) == 0.0:
            return set()
        env = began[int(np.argmax(speeds))]
        older, newer = (np.ascontiguousarray(light[env]) for light in (self._older, light))
        vectors = motion[env]
        found, exchanged = (_convention_of(older, newer, each) for each in (vectors, vectors[..., ::-1]))
        if exchanged is not None and exchanged.is_right:
            worse = found is None or (found.is_right and found.error > 2 * exchanged.error)
            if worse:
                raise ConfigError(
                    f"{self._name}: motion_vectors have y before x; they must be x, y: give "
                    "motion_vectors[..., [1, 0]]"
                )
        if found is None:
            return set()
        if not found.is_right:
            x, y = (float(a) * b for a, b in zip(self._settings.motion_scale, found.scale, strict=True))
            remedy = (
                "render motion vectors without the jitter of antialiasing, of this frame and not of another"
                if found.scale == (0.0, 0.0)
                else f"set motion_scale=({x:g}, {y:g})"
            )
            raise ConfigError(
                f"{self._name}: motion_vectors are {found.convention}; they must be pixels from this "
                f"keyframe to the last one, x right, y down: {remedy}"
            )
        moved = np.abs(vectors) >= _DECISIVE_PX
        return {axis for axis in (0, 1) if float(moved[..., axis].mean()) >= _DECISIVE_SHARE}

    def _check_still(self, light: npt.NDArray[Any], motion: Float, held: list[int]) -> None:
        """Warn, once, where the light of a picture changes in which nothing moves."""
        if not self._static_left:
            return
        moves = (np.abs(motion) >= _STILL_PX).any(axis=(1, 2, 3))
        known = np.isfinite(motion).mean(axis=(1, 2, 3)) >= 0.5
        still = np.flatnonzero(known & ~moves)
        self._static_left -= bool(len(still))
        anchors = {}
        for env in still[:4]:
            if env in held:
                continue
            now = luminance("light", light[env])
            anchors[int(env)] = anchor = self._anchors.get(int(env), now)
            found = compared(anchor, now, self._threshold)
            if found.share >= _STATIC_SHARE:
                self._static_left = 0
                self._warn(
                    "still",
                    f"{self._name}: {100 * found.share:.1f} % of the pixels of environment {env} fire though "
                    f"nothing moves; {found.advice}; or a light changes",
                )
        self._anchors = anchors

    def _warn(self, kind: str, text: str) -> None:
        if kind not in self._warned:
            self._warned.add(kind)
            warnings.warn(text, stacklevel=3)

    def __repr__(self) -> str:
        """Say size and time."""
        width, height = self._emulator.width, self._emulator.height
        return f"EventPipeline({self._name!r}, {self._num_envs} x {width}x{height}, now_us={self._now_us})"


def _convention_of(older: npt.NDArray[Any], newer: npt.NDArray[Any], vectors: Float) -> MotionCheck | None:
    """Return the vectors' convention by the pictures; None if these do not decide it."""
    try:
        return check_motion(older, newer, np.ascontiguousarray(vectors))
    except ConfigError:
        return None


def _scale(value: Any) -> Float | None:
    pair = _check.numbers("motion_scale", value)
    if len(pair) != 2 or not all(np.isfinite(pair)) or 0.0 in pair:
        raise ConfigError(f"motion_scale is {_check.shown(value)}; it must be two numbers that are not 0")
    return None if pair == [1.0, 1.0] else np.asarray(pair, np.float32)


def _warp_of(settings: PipelineSettings) -> Warp:
    margin = _check.whole("margin", settings.margin)
    warp = settings.warp if isinstance(settings.warp, Warp) else _emulator_warp(settings.warp, None)
    if margin and warp.margin not in (None, margin):
        raise ConfigError(f"margin is {margin} and warp.margin {warp.margin}; give one of them, or the same")
    return replace(warp, margin=margin or warp.margin)


def _any_depth(depth: npt.NDArray[Any]) -> bool:
    return bool((np.isfinite(depth) & (depth > 0)).any())


def _names(outputs: Mapping[str, Any]) -> str:
    return ", ".join(map(str, outputs)) or "nothing"
