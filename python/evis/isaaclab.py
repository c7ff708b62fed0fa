"""Event cameras in Isaac Lab: a camera configuration that takes the place of an RGB camera's.

Never run inside Isaac: classes and fields follow the published sources of Isaac Lab 2.3.2 and 3.0.0, and what
is tested is `evis.gbuffer.EventPipeline` beneath, on G-buffers of EVIS's own renderer in Isaac's convention.
Isaac Lab is imported when `EventCameraCfg` or `EventCamera` is first used; without it this module can be
imported, and using them raises `EvisError`. docs/isaaclab.md has an example, and what to check first.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from ._check import duration_us, micros, shown
from ._evis import ConfigError, EvisError
from ._sensor import Exposure, Sensor, sensor_of
from .gbuffer import LINEAR, EventPipeline, PipelineSettings

if TYPE_CHECKING:
    EventCameraCfg: Any
    EventCamera: Any

__all__ = ["EventCamera", "EventCameraCfg", "event_counts", "event_voxels", "settings_of"]

_LDR = "rgb"


def __getattr__(name: str) -> Any:
    """Make the classes that derive from Isaac Lab's when they are first used."""
    if name == "EventCameraCfg":
        return _classes()[0]
    if name == "EventCamera":
        return _classes()[1]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def settings_of(cfg: Any) -> PipelineSettings:
    """Return what a camera's configuration means for `EventPipeline`.

    Parameters
    ----------
    cfg : EventCameraCfg
        Or anything with its fields.

    Returns
    -------
    PipelineSettings
        With a sensor of ``threshold`` (ON and OFF, or both alike), the stages of ``noise``, and
        ``motion_blur`` as its exposure; a sensor of thresholds alone latches with ``log_eps`` 1e-5 where
        ``warp`` is ``"evis-paper"``, as the EVIS paper's does.

    Raises
    ------
    ConfigError
        If a field cannot be used.
    """
    if cfg.event_source not in ("hdr", "ldr"):
        raise ConfigError(f"event_source is {shown(cfg.event_source)}; it must be 'hdr' or 'ldr'")
    pair = cfg.threshold if isinstance(cfg.threshold, (tuple, list)) else (cfg.threshold, cfg.threshold)
    if len(pair) != 2:
        raise ConfigError(f"threshold is {shown(cfg.threshold)}; it must be a number, or ON and OFF")
    if cfg.noise is None and cfg.warp == "evis-paper":
        sensor = Sensor(trigger="latch", log_eps=1e-5)
    else:
        sensor = sensor_of(cfg.noise, "noise")
    sensor = replace(sensor, threshold_on=pair[0], threshold_off=pair[1])
    if cfg.motion_blur:
        sensor = replace(sensor, exposure=Exposure(time_us=duration_us("motion_blur", cfg.motion_blur)))
    return PipelineSettings(
        sensor=sensor,
        warp=cfg.warp,
        steps=cfg.steps,
        margin=cfg.margin,
        light=cfg.event_source,
        exposure_locked=cfg.exposure_locked,
        motion_scale=tuple(cfg.motion_scale),
        check_motion=cfg.check_motion,
        voxel_bins=cfg.voxel_bins,
        window_us=duration_us("window", cfg.window) if cfg.window else 0,
        reference_luminance=cfg.reference_luminance,
        backend=cfg.backend,
        seed=cfg.seed,
    )


def event_counts(env: Any, sensor_cfg: Any) -> Any:
    """Observation term: events per pixel and polarity, float32 (N, H, W, 2), OFF first.

    Parameters
    ----------
    env : ManagerBasedEnv
        The environment.
    sensor_cfg : SceneEntityCfg
        Names the `EventCamera` in the scene.
    """
    return _observed(env, sensor_cfg, "event_counts")


def event_voxels(env: Any, sensor_cfg: Any) -> Any:
    """Observation term: a voxel grid of ON minus OFF events, float32 (N, H, W, bins).

    Parameters
    ----------
    env : ManagerBasedEnv
        The environment.
    sensor_cfg : SceneEntityCfg
        Names the `EventCamera` in the scene.
    """
    return _observed(env, sensor_cfg, "event_voxels")


def _observed(env: Any, sensor_cfg: Any, name: str) -> Any:
    values = env.scene.sensors[sensor_cfg.name].data.output[name]
    # Releases from 3.0 on wrap tensors.
    tensor = values.torch if hasattr(type(values), "torch") else values
    return tensor.float().clone()


class EventCameraData:
    """Data of an `EventCamera`: Isaac Lab's own, with events among ``output``."""

    def __init__(self, data: Any, output: dict[str, Any]) -> None:
        self._data = data
        self.output = output

    def __getattr__(self, name: str) -> Any:
        """Return what Isaac Lab's data has."""
        if name == "_data":
            raise AttributeError(name)
        return getattr(self._data, name)


def _linear_name() -> str:
    """Return the best linear buffer that the installed release knows."""
    try:
        from isaaclab.renderers.output_contract import RenderBufferKind
    except ImportError:
        # Isaac Lab 2 passes names of annotators on to Replicator.
        return "HdrColor"
    known = {str(getattr(kind, "value", kind)) for kind in RenderBufferKind}
    return next((name for name in LINEAR if name in known), LINEAR[1])


def _has_motion(cfg: Any) -> bool:
    """Whether the camera's renderer gives motion vectors, as far as it says."""
    specs = getattr(getattr(cfg, "renderer_cfg", None), "supported_output_types", None)
    supported = specs() if callable(specs) else None
    return supported is None or "motion_vectors" in {str(getattr(kind, "value", kind)) for kind in supported}


@cache
def _classes() -> tuple[Any, Any]:
    try:
        import torch
        from isaaclab.sensors import Camera, CameraCfg
        from isaaclab.utils import configclass
    except ImportError as error:
        raise EvisError(
            f"Isaac Lab cannot be imported ({error}); EventCameraCfg needs Isaac Lab 2.3 or 3.0 in this "
            "Python. evis.gbuffer.EventPipeline takes tensors of any renderer without it"
        ) from error

    class EventCamera(Camera):  # type: ignore[misc]
        """A camera that gives events beside its pictures."""

        def __init__(self, cfg: Any) -> None:
            self._event_settings = settings_of(cfg)
            if not cfg.motion and "motion_vectors" not in cfg.data_types:
                raise ConfigError(
                    f"{cfg.prim_path}: the renderer gives no motion_vectors; set motion= to a function of "
                    "the camera's data that makes them (evis.gbuffer.MotionFromPoses), or take another one"
                )
            self._events: EventPipeline | None = None
            self._elapsed_s = 0.0
            self._event_output: dict[str, Any] = {}
            super().__init__(cfg)

        @property
        def pipeline(self) -> EventPipeline:
            """What makes the events: reports, lists of events per environment, state of checks."""
            if self._events is None:
                raise EvisError("the camera is not initialized; it is when the simulation first plays")
            return self._events

        @property
        def data(self) -> EventCameraData:
            """Isaac Lab's data, with ``event_counts`` and ``event_voxels`` in ``output``."""
            data = super().data
            if not self._event_output:
                for name, array in self.pipeline.output.items():
                    # What PyTorch makes is where the camera's pictures are.
                    tensor = torch.from_numpy(array) if isinstance(array, np.ndarray) else array
                    self._event_output[name] = _wrapped(tensor.to(self._device))
            return EventCameraData(data, {**data.output, **self._event_output})

        def update(self, dt: float, force_recompute: bool = False) -> None:
            """Advance time; where a picture is due, it is rendered now, and becomes events."""
            # Isaac's own clock is float32, and restarts with each environment's reset.
            self._elapsed_s += dt
            super().update(dt, True)

        def reset(self, env_ids: Any = None, *args: Any, **kwargs: Any) -> None:
            """Reset environments, with the first picture that is rendered later."""
            super().reset(env_ids, *args, **kwargs)
            mask = args[0] if args else kwargs.get("env_mask")
            if mask is not None:
                env_ids = np.flatnonzero(np.asarray(mask.numpy() if hasattr(mask, "numpy") else mask))
            self._event_output = {}
            if self._events is not None:
                self._events.reset(env_ids)

        def _initialize_impl(self) -> None:
            super()._initialize_impl()
            border = 2 * self._event_settings.margin
            self._events = EventPipeline(
                self.num_instances,
                self.cfg.height - border,
                self.cfg.width - border,
                self._event_settings,
                name=self.cfg.camera_name or self.cfg.prim_path.rsplit("/", 1)[-1],
            )

        def _update_buffers_impl(self, due: Any) -> None:
            # Isaac Lab 3 calls with a mask, also where nothing is due; 2.3 with numbers.
            any_due = getattr(self, "_env_mask_has_any", None)
            if any_due is not None and not any_due(due):
                return
            # A reset lets environments be due apart, but motion vectors are of one gap for all of them.
            super()._update_buffers_impl(self._ALL_INDICES if any_due is None else self._ALL_ENV_MASK)
            t_us = micros("time", self._elapsed_s)
            pipeline = self.pipeline
            # After a reset, Isaac renders once more at the time of the last picture.
            if pipeline.now_us is not None and t_us <= pipeline.now_us:
                return
            _warn_of_delay(self._data)
            motion = self.cfg.motion(self._data) if self.cfg.motion else None
            pipeline.push(self._data.output, t_us, motion_vectors=motion)
            self._event_output = {}

    class EventCameraCfg(CameraCfg):  # type: ignore[misc]
        """Configuration of an `EventCamera`: Isaac Lab's ``CameraCfg``, and what makes events of it.

        ``width`` and ``height`` are those of the rendered pictures, larger than the sensor by ``margin`` on
        every side. What events need is added to ``data_types``.
        """

        class_type: type = EventCamera

        threshold: float | tuple[float, float] = 0.15
        """Change of log luminance that fires: one number, or ON and OFF."""

        event_source: str = "hdr"
        """``"hdr"``: the best linear buffer of the release. ``"ldr"``: the tone-mapped ``rgb``."""

        noise: Sensor | str | None = None
        """Sensor, or name of a preset (``"evis"``: the plugin's noise), whose stages are used; None: none."""

        motion_blur: float = 0.0
        """Seconds of exposure: pixels see motion-blurred frames in the place of light; 0: light itself."""

        margin: int = 0
        """Pixels that are rendered beyond each border of the sensor."""

        warp: Any = "splat"
        """``"splat"``, ``"evis-paper"`` or an ``evis.Warp``: how instants between two renders are made."""

        steps: int | str | None = None
        """Instants per gap (K); None: 8 for ``"evis-paper"``, else as many as the motion asks for."""

        exposure_locked: bool = False
        """Whether automatic exposure is off, so that ``rgb_hdr`` and ``HdrColor`` may be used."""

        motion_scale: tuple[float, float] = (1.0, 1.0)
        """What x and y of the motion vectors are multiplied by; the check of their convention names it."""

        check_motion: bool = True
        """Whether the convention of motion vectors is checked by the first pictures that tell it."""

        motion: Any = None
        """Function of the camera's data that returns motion vectors (N, H, W, 2), where there are none."""

        voxel_bins: int = 5
        """Bins of ``event_voxels``."""

        window: float = 0.0
        """Seconds that ``event_counts`` and ``event_voxels`` cover; 0: the last gap between two renders."""

        reference_luminance: float = 1.0
        """Light of about a middle grey, in the renderer's units."""

        backend: str = "auto"
        """What makes the events: ``"auto"``, ``"engine"`` or ``"torch"``, as of `PipelineSettings`."""

        seed: int = 0
        """Seed of the sensor's noise; cameras of one seed have the same noise."""

        camera_name: str | None = None
        """Name of the camera in files; None: the last part of ``prim_path``."""

        def __post_init__(self) -> None:
            """Ask the renderer for what events need."""
            above = getattr(super(), "__post_init__", None)
            if callable(above):
                above()
            needed = ["distance_to_image_plane", _linear_name() if self.event_source == "hdr" else _LDR]
            if _has_motion(self):
                needed.append("motion_vectors")
            cfg: Any = self
            asked = list(cfg.data_types)
            cfg.data_types = [*asked, *(name for name in needed if name not in asked)]

    for made in (EventCamera, EventCameraCfg):
        made.__module__, made.__qualname__ = __name__, made.__name__
    return configclass(EventCameraCfg), EventCamera


def _wrapped(tensor: Any) -> Any:
    """Return a tensor as the installed release has outputs."""
    try:
        import warp
        from isaaclab.utils.warp import ProxyArray
    except ImportError:
        return tensor
    return ProxyArray(warp.from_torch(tensor))


def _warn_of_delay(data: Any) -> None:
    info = data.info if isinstance(data.info, dict) else {}
    if any(isinstance(own, dict) and "capture" in own for own in info.values()):
        warnings.warn(
            "the renderer delivers pictures one capture late, and events are stamped too late by the time "
            "between two renders",
            stacklevel=2,
        )
