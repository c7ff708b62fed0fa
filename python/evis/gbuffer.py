"""Events from G-buffers: light, depth and motion vectors that a renderer makes of many environments.

`EventPipeline` is what every host shares: it checks what comes, pushes it as keyframes, and keeps events per
environment, dense arrays and files of episodes. It needs no simulator; `evis.isaaclab` is its adapter for
Isaac Lab. For renderers without motion vectors, `MotionFromPoses` makes them of depth, poses and instance
ids. docs/isaaclab.md has examples.
"""

from __future__ import annotations

import re
import sys
import warnings
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
import numpy.typing as npt

from . import _check
from ._device_events import DeviceEvents
from ._emulator import EventEmulator, KeyframeReport, MotionCheck, check_motion
from ._emulator import _warp as _emulator_warp
from ._episodes import EpisodeRecorder
from ._events import EventArray, EventCD
from ._evis import ConfigError, EvisError
from ._host_arrays import Copies, unwrapped
from ._method import Warp
from ._pose_motion import Axes, MotionFromPoses, motion_from_poses
from ._sensor import Sensor, thresholds_of
from ._static import StaticCheck, check_static, compared, linear, luminance

if TYPE_CHECKING:
    from ._torch_keyframes import TorchKeyframes

__all__ = [
    "DEPTH",
    "LINEAR",
    "Axes",
    "DeviceEvents",
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

_LDR = "rgb"

_STAGES = "the sensor has stages beyond its thresholds, which only the engine has"

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
    backend : {"auto", "engine", "torch"}
        What makes the events. ``engine``: EVIS's own, on the CPU, with every sensor. ``torch``: PyTorch, on
        the device of the tensors that come, the CPU included; for sensors of thresholds alone
        (`Sensor.thresholds_only`). ``auto``: ``torch`` where the sensor is one and the first keyframe's
        arrays are all tensors on one CUDA device, else ``engine``.
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
    backend: Literal["auto", "engine", "torch"] = "auto"
    seed: int = 0
    camera: int = 0
    threads: int = 0


class EventPipeline:
    """Turn a renderer's G-buffers of N environments, seen by one camera each, into events.

    Arrays are NumPy, PyTorch, anything with DLPack or NumPy's array interface, or wrap a tensor as ``.torch``
    (Isaac Lab's ``ProxyArray``). Tensors on a CUDA device stay there, with what is made of them, where
    PyTorch supports the sensor (``settings.backend``); otherwise they are copied to the CPU once per
    keyframe, which a single warning reports, with its cost. Nothing is kept of a host's buffers after `push`
    returns.

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
        if settings.backend not in ("auto", "engine", "torch"):
            raise ConfigError(
                f"backend is {_check.shown(settings.backend)}; it must be 'auto', 'engine' or 'torch'"
            )
        if settings.backend == "torch" and not self._emulator.sensor.thresholds_only:
            raise ConfigError(f"backend is 'torch', but {_STAGES}; set backend='engine'")
        # Chosen with the first keyframe.
        self._backend: Literal["engine", "torch"] | None = None
        self._torch: TorchKeyframes | None = None
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
        self._last: Sequence[EventArray] = list(self._nothing)
        self._recent: list[list[npt.NDArray[np.void]]] = [[] for _ in range(self._num_envs)]
        # With the time of their keyframe.
        self._recent_on_device: list[tuple[int, DeviceEvents]] = []
        self._dense: dict[str, Any] = {}
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
    def backend(self) -> Literal["engine", "torch"] | None:
        """What makes the events; None before the first keyframe."""
        return self._backend

    @property
    def events(self) -> Sequence[EventArray]:
        """Events of the last push, per environment: a list, or `DeviceEvents` where PyTorch makes them."""
        return self._last if isinstance(self._last, DeviceEvents) else list(self._last)

    @property
    def reports(self) -> tuple[KeyframeReport, ...]:
        """What became of the last keyframe, per environment; empty before the first one."""
        if self._torch is not None:
            return self._torch.reports
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
    ) -> Sequence[EventArray]:
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
        list of EventArray, or DeviceEvents
            Events in ``(t0, t1]`` of each environment; on the device where PyTorch makes them. An
            environment's first keyframe makes none.

        Raises
        ------
        ConfigError
            If a buffer is missing or cannot be used, or is on another device than the first ones; if light is
            tone-mapped or follows an exposure and this was not allowed, or if the motion vectors follow
            another convention: it is named, and what to multiply them by. Nothing has changed then.
        EvisError
            If ``backend`` is ``torch`` and PyTorch is not installed.
        """
        if not isinstance(outputs, Mapping):
            raise ConfigError(f"outputs is {_check.shown(outputs)}; it must be a mapping of names to arrays")
        t_us = _check.time_us("t_us", t_us)
        if self._now_us is not None and t_us <= self._now_us:
            raise ConfigError(f"t_us is {t_us}; it must be above {self._now_us}, that of the last keyframe")
        light_name = self._light_name(outputs)
        depth = next((outputs[name] for name in DEPTH if name in outputs), None)
        if depth is None and "distance_to_camera" in outputs:
            raise ConfigError(
                "outputs has distance_to_camera, which is measured along rays; ask the renderer for "
                "distance_to_image_plane"
            )
        motion = self._motion_of(outputs, motion_vectors)
        scale = None if motion_vectors is not None else self._scale
        held = self._ids("hold", hold)
        given = (outputs[light_name], depth, motion)
        backend = self._backend or self._chosen(given)
        push = self._push_to_torch if backend == "torch" else self._push_to_engine
        return push(light_name, given, scale, held, t_us)

    def _chosen(self, given: tuple[Any, ...]) -> Literal["engine", "torch"]:
        """Choose what makes the events of tensors such as these."""
        if self._settings.backend != "auto":
            return self._settings.backend
        here = self._emulator.sensor.thresholds_only and _on_one_card(given)
        return "torch" if here else "engine"

    def _push_to_engine(
        self, light_name: str, given: tuple[Any, Any, Any], scale: Float | None, held: list[int], t_us: int
    ) -> Sequence[EventArray]:
        copies = Copies()
        codes = (np.uint8, np.float32) if light_name == _LDR else (np.float32,)
        light = self._checked(light_name, copies.take(light_name, given[0]), (3, 1), codes)
        depth = None if given[1] is None else self._checked("depth", copies.take("depth", given[1]), (1,))
        motion: Float = self._checked("motion_vectors", copies.take("motion_vectors", given[2]), (2,))
        motion = motion if scale is None else motion * scale
        if self._now_us is None and not light.any() and (depth is None or not _any_depth(depth)):
            return list(self._nothing)
        # The same motion again says that what moved has not moved on.
        moves = bool((np.abs(motion) >= _STILL_PX).any())
        seen = (zlib.crc32(np.ascontiguousarray(light).data), zlib.crc32(np.ascontiguousarray(motion).data))
        if moves and seen == self._seen:
            return list(self._nothing)
        if held:
            light = linear(light).copy()
            light[held] = np.nan
        checked = set[int]()
        if self._unchecked and self._older is not None:
            older, newer = self._older, light
            speeds = [float(np.nan_to_num(np.abs(own), posinf=0.0).sum()) for own in motion]
            checked = self._check_motion(speeds, lambda env: (older[env], newer[env], motion[env]), held)
        events = self._emulator.push_keyframe(
            light, depth, motion, t_us, steps=self._settings.steps, warp=self._warp
        )
        # From here on nothing fails: an error has left everything as it was.
        self._seen = seen
        self._unchecked -= checked
        self._older = light.copy() if self._unchecked else None
        self._pushed("engine", events, t_us)
        if self._static_left:
            known = np.isfinite(motion).mean(axis=(1, 2, 3)) >= 0.5
            still = known & ~(np.abs(motion) >= _STILL_PX).any(axis=(1, 2, 3))
            self._check_still(still.tolist(), lambda env: luminance("light", light[env]), held)
        if copies.size:
            why = "" if self._emulator.sensor.thresholds_only else f"; {_STAGES}"
            self._warn("copy", f"{self._name}: {copies.in_words('keyframe')}{why}")
        return list(events)

    def _push_to_torch(
        self, light_name: str, given: tuple[Any, Any, Any], scale: Float | None, held: list[int], t_us: int
    ) -> Sequence[EventArray]:
        try:
            from . import _torch_keyframes as on_device
        except ImportError as error:
            raise EvisError(
                "backend is 'torch', and PyTorch cannot be imported; install it: pip install 'evis[torch]'"
            ) from error
        codes = ("uint8", "float32") if light_name == _LDR else ("float32",)
        pictures = self._shaped(light_name, on_device.as_tensor(light_name, given[0], codes), (3, 1))
        own = self._torch or on_device.TorchKeyframes(
            self._num_envs,
            self._emulator.height,
            self._emulator.width,
            sensor=self._emulator.sensor,
            warp=_emulator_warp(self._warp, self._settings.steps),
            reference_luminance=self._settings.reference_luminance,
            device=pictures.device,
        )
        own.check_device(light_name, pictures)
        light, depth = own.luminance(pictures), None
        if given[1] is not None:
            depth = self._shaped("depth", on_device.as_tensor("depth", given[1]), (1,))[..., 0]
            own.check_device("depth", depth)
        motion = self._shaped("motion_vectors", on_device.as_tensor("motion_vectors", given[2]), (2,))
        own.check_device("motion_vectors", motion)
        if scale is not None:
            motion = motion * on_device.as_tensor("motion_scale", scale).to(motion.device)
        if self._now_us is None and not bool(pictures.any()) and not on_device.any_depth(depth):
            return own.nothing()
        fastest = on_device.fastest(motion)
        moves = max(fastest) >= _STILL_PX
        if moves and own.is_last(light, motion):
            return own.nothing()
        if held:
            light = light.clone()
            light[held] = float("nan")
        checked = set[int]()
        if self._unchecked and own.last_light is not None:
            pairs = (own.last_light, light, motion)
            speeds = on_device.speeds(motion)
            checked = self._check_motion(speeds, lambda env: on_device.on_host(env, *pairs), held)
        events = own.push(light, depth, motion, t_us)
        # From here on nothing fails.
        self._torch = own
        self._unchecked -= checked
        self._pushed("torch", events, t_us)
        for report in own.reports:
            for text in report.warnings:
                self._warn(re.sub(r"[0-9.]+", "", text), text)
        if self._static_left and min(fastest) < _STILL_PX:
            known = on_device.known_shares(motion)
            still = [speed < _STILL_PX and share >= 0.5 for speed, share in zip(fastest, known, strict=True)]
            self._check_still(still, lambda env: on_device.on_host(env, light)[0], held)
        return events

    def _pushed(self, backend: Literal["engine", "torch"], events: Sequence[EventArray], t_us: int) -> None:
        """Note the events of a keyframe."""
        self._backend = backend
        self._before_us, self._now_us = self._now_us, t_us
        self._starts = [t_us if start is None else start for start in self._starts]
        self._set_last_events(events)

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
        if self._torch is not None:
            self._torch.reset(ids)
        if isinstance(self._last, DeviceEvents):
            self._last = self._last.without(ids)
            self._recent_on_device = [(t_us, part.without(ids)) for t_us, part in self._recent_on_device]
        else:
            self._last = [
                self._nothing[env] if env in ids else events for env, events in enumerate(self._last)
            ]
        for env in ids:
            started = self._starts[env] is not None
            self._starts[env] = None
            self._recent[env] = []
            self._anchors.pop(env, None)
            if started and self._recorder is not None:
                self._recorder.end(self._name, env)
        self._dense = {}

    @property
    def output(self) -> dict[str, Any]:
        """Dense arrays, as hosts take observations.

        ``event_counts`` is int32 (N, H, W, 2), events, OFF first; ``event_voxels`` is float32
        (N, H, W, bins), a voxel grid of ON minus OFF (`EventArray.voxel_grid`), over ``window_us`` before the
        last keyframe, or over its gap. Zeros before the first events. NumPy arrays, or tensors on the device
        where PyTorch makes the events.
        """
        if not self._dense and isinstance(self._last, DeviceEvents):
            self._dense = self._dense_on_device(self._last)
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

    def _dense_on_device(self, last: DeviceEvents) -> dict[str, Any]:
        parts, (start_us, end_us) = [last], self._limits_us()
        if self._window_us:
            parts = [part for _, part in self._recent_on_device]
        counts = [part.counts(start_us) for part in parts]
        voxels = [part.voxel_grid(self._bins, start_us, end_us) for part in parts]
        return {
            "event_counts": sum(counts[1:], counts[0]),
            "event_voxels": sum(voxels[1:], voxels[0]),
        }

    def _limits_us(self) -> tuple[int, int]:
        """First microsecond of what dense arrays cover, and one past the last."""
        end_us = (self._now_us or 0) + 1
        if self._window_us:
            return end_us - self._window_us, end_us
        return end_us - 1 if self._before_us is None else self._before_us + 1, end_us

    def _window(self, env: int) -> tuple[EventArray, int, int]:
        """Events of an environment's window, and its limits."""
        events, (start_us, end_us) = self._last[env], self._limits_us()
        if self._window_us:
            if self._recent[env]:
                joined = np.concatenate(self._recent[env])
                events = EventArray(joined, width=events.width, height=events.height)
            return events, start_us, end_us
        # With an exposure, events are as old as the light that they come of.
        return events, min(start_us, int(events.t[0])) if len(events) else start_us, end_us

    def _set_last_events(self, events: Sequence[EventArray]) -> None:
        self._last = events
        self._dense = {}
        since = self._now_us - self._window_us if self._now_us is not None else 0
        on_device = isinstance(events, DeviceEvents)
        if on_device and self._window_us:
            kept = [(t_us, part) for t_us, part in self._recent_on_device if t_us > since]
            self._recent_on_device = [*kept, (self._now_us or 0, cast("DeviceEvents", events))]
        if on_device and self._recorder is None:
            return
        for env, own in enumerate(events):
            if self._window_us and not on_device:
                parts = [part for part in self._recent[env] if len(part) and part["t"][-1] > since]
                self._recent[env] = [*parts, own.to_numpy()] if len(own) else parts
            start = self._starts[env]
            if self._recorder is not None and len(own) and start is not None:
                self._recorder.add(self._name, env, own, start)

    def _light_name(self, outputs: Mapping[str, Any]) -> str:
        if self._settings.light == "ldr":
            if _LDR not in outputs:
                raise ConfigError(f"outputs has {_names(outputs)}; with light='ldr' it must have rgb")
            return _LDR
        name = next((name for name in LINEAR if name in outputs), None)
        if name is None:
            tone_mapped = (
                "; rgb is tone-mapped: light='ldr' takes it all the same, without what its curve clips"
                if _LDR in outputs
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
        return name

    def _motion_of(self, outputs: Mapping[str, Any], given: Any) -> Any:
        if given is not None:
            return given
        if "motion_vectors" not in outputs:
            raise ConfigError(
                f"outputs has {_names(outputs)}; it must have motion_vectors, or give motion_vectors=: "
                "MotionFromPoses makes them of depth, poses and instance ids"
            )
        return outputs["motion_vectors"]

    def _checked(
        self,
        what: str,
        array: npt.NDArray[Any],
        channels: tuple[int, ...],
        dtypes: tuple[Any, ...] = (np.float32,),
    ) -> npt.NDArray[Any]:
        """Bring an array to (N, H, W, C), of a dtype that the emulator takes."""
        given, array = array, self._shaped(what, array, channels)
        if array.dtype in (np.float16, np.float64):
            array = array.astype(np.float32)
        if array.dtype not in dtypes:
            wanted = " or ".join(np.dtype(dtype).name for dtype in dtypes)
            raise ConfigError(f"dtype of {what} is {given.dtype}; it must be {wanted}")
        return array

    def _shaped(self, what: str, array: Any, channels: tuple[int, ...]) -> Any:
        """View an array or a tensor as (N, H, W, C)."""
        given = array
        if array.ndim == 4 and array.shape[-1] == 4 and 3 in channels:
            array = array[..., :3]
        if array.ndim == 3 and 1 in channels:
            array = array[..., None]
        if tuple(array.shape[:-1]) != self._shape or array.shape[-1] not in channels:
            raise ConfigError(
                f"{what} has shape {tuple(given.shape)}; it must have {(*self._shape, channels[0])}: "
                f"environments, rows, columns{' with the margin' if self._warp.margin else ''}, channels"
            )
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

    def _check_motion(
        self,
        speeds: list[float],
        pictures: Callable[[int], tuple[npt.NDArray[Any], ...]],
        held: list[int],
    ) -> set[int]:
        """Check the convention with the environment that moves most; return the axes that it decides.

        `pictures` returns the older and the newer light of an environment, and its motion.
        """
        began = [env for env, start in enumerate(self._starts) if start is not None and env not in held]
        if not began or max(speeds[env] for env in began) == 0.0:
            return set()
        env = max(began, key=lambda env: speeds[env])
        older, newer, vectors = pictures(env)
        older, newer = np.ascontiguousarray(older), np.ascontiguousarray(newer)
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

    def _check_still(self, still: list[bool], picture: Callable[[int], Float], held: list[int]) -> None:
        """Warn, once, where the light of a picture changes in which nothing moves: `still`."""
        envs = [env for env, is_still in enumerate(still) if is_still]
        self._static_left -= bool(envs)
        anchors = {}
        for env in envs[:4]:
            if env in held:
                continue
            now = picture(env)
            anchors[env] = anchor = self._anchors.get(env, now)
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
            warnings.warn(text, stacklevel=4)

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


def _on_one_card(given: tuple[Any, ...]) -> bool:
    """Whether all that was given are tensors of PyTorch on the same CUDA device."""
    kind = getattr(sys.modules.get("torch"), "Tensor", None)
    tensors = [unwrapped(values) for values in given if values is not None]
    if kind is None or not all(isinstance(values, kind) for values in tensors):
        return False
    return tensors[0].device.type == "cuda" and len({values.device for values in tensors}) == 1
