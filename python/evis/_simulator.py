"""The simulator and its stream."""

from __future__ import annotations

import time
import warnings
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from . import _check, _evis, _method
from ._dense import dense_of, request_of
from ._evis import ConfigError, EvisError
from ._method import Method
from ._packets import CameraInfo, Packet, packet_from
from ._poses import (
    NodePoses,
    lens_changes,
    light_changes,
    material_changes,
    node_jumps,
    node_poses,
    node_visible,
    visible_jumps,
)
from ._progress import Progress, TimeLeft
from ._request import Request
from ._scene import EventCamera, Scene, motion_text, moved_scene, raw_of
from ._sensor import Sensor, sensor_of
from .representations import Dense

if TYPE_CHECKING:
    import numpy.typing as npt
    from numpy.typing import ArrayLike

_USUAL_WINDOW_US = 10_000

# One for all, or one per environment.
EnvironmentSensors: TypeAlias = Sensor | str | Sequence[Sensor | str]
LabelName: TypeAlias = Literal[
    "depth",
    "flow",
    "flow_forward",
    "flow_forward_valid",
    "flow_backward",
    "flow_backward_valid",
    "instance",
    "semantic",
    "normal",
    "hdr",
    "cause",
]


@dataclass(frozen=True, slots=True)
class Device:
    """A graphics device that can run EVIS.

    Attributes
    ----------
    index : int
        Position in the list; ``Simulator(device=index)`` takes it.
    name : str
        Name that the driver gives; any part of it also chooses the device.
    backend : str
        ``vulkan``, ``metal`` or ``dx12``.
    kind : str
        ``cpu``, ``integrated``, ``discrete``, ``virtual`` or ``other``.
    driver : str
        Driver name and version.
    """

    index: int
    name: str
    backend: str
    kind: str
    driver: str


def devices() -> tuple[Device, ...]:
    """List the devices that can run EVIS; empty where there is no driver."""
    return tuple(Device(**device) for device in _evis.list_devices())


class Simulator:
    """Renders a scene as event cameras see it.

    Parameters
    ----------
    scene : Scene
        What to render; several simulators may share it.
    sensor : Sensor, str, or mapping of them by camera, optional
        Sensor of every camera, or the name of a preset or TOML file. ``{"left": "davis346", "right":
        Sensor(...)}`` gives each of these cameras its own; the names are those of cameras of the scene,
        rendered or not. A camera that is given none has what the scene gives it; else an ideal sensor, 0.2 /
        0.2 (with the method ``evis-paper``: the same that latches, with ``log_eps`` 1e-5). Thresholds that
        the scene gives a camera come before its sensor's. Every stage runs on the device, but a sensor with
        ``diffusion``, ``exposure`` or ``photoreceptor.noise`` is simulated on the host, from the light of
        every instant.
    quality : {"draft", "standard", "high", "reference"}, optional
        Fixed settings of sampling, the same for every scene; nothing is rendered to choose them. Tiles that
        show triangles smaller than pixels are rendered where everything else is followed (``decoupled``),
        and a scene that cannot be followed is rendered as a whole; `notes` says so.
        ``docs/accuracy.md`` says how near to the truth each came, and at which cost. Settings given by hand
        stand over it. ``standard`` where neither a quality, a settings file, a method nor any of
        ``rate_hz``, ``adaptive_px``, ``samples``, ``antialias`` and ``texture_taps`` is given.
    settings : path-like, optional
        Settings from a file: one that `tune` or ``evis tune`` wrote, or a recording (``.h5``), whose own
        settings are used again. Arguments given here override it.
    method : {"native", "decoupled", "splat", "evis-paper"} or Warp, optional
        How light is sampled: instants are rendered (``native``), or splatted from keyframes; or visibility is
        followed in continuous time and each pixel is evaluated at its own times, on the CPU (``decoupled``,
        which needs a device for labels and frames only).
    rate_hz : float, optional
        Sampled instants per second, on a grid fixed in absolute time; 1000 without a preset. Only for
        ``native``, since a splat has its own, and for a sensor that is defined on frames: it takes so many
        with ``decoupled``.
    adaptive_px : float, optional
        Only for ``native``: each tile of the picture is sampled no more often than that nothing it may show
        moves farther than so many pixels between two of its samples, and ``rate_hz`` at most. Where not
        given, everything is rendered at ``rate_hz``.
    samples : int, optional
        Samples per pixel and instant, 1 to 256, averaged in linear light; 4 where not given.
    antialias : {"samples", "edges"}, optional
        ``samples``: visibility and shading at every sample. ``edges``: visibility at every sample, shading
        at one in four, which lie on a grid: ``samples`` is 4, 16, 36, 64, 100, 144, 196 or 256.
    texture_taps : int, optional
        Places at which a sample reads a texture, at most, along each side of its share of the pixel, 1 to
        16; 2 up to 8 samples, 3 up to 15, then 4 where not given. Beyond them mip levels average, and blur.
    shadows : {"maps", "rays"}, optional
        ``maps``: by shadow maps fitted to the world, soft by a texel. ``rays``: along shadows' borders by
        rays, as sharp as what throws them, for up to twice the work; things that throw shadows must be rigid
        and without holes. Where not given, the preset's; maps without one.
    compute : {"cpu", "gpu"}, optional
        Where ``method="decoupled"`` evaluates pixels. ``cpu``, the default: on the processor's cores, in 64
        bits. ``gpu``: by compute passes on the device, in 32 bits; pixels that see more than 16 facets,
        surfaces with other maps than base colour behind a distorted lens, and stages of sensors that take
        frames stay on the processor. Not measured on a graphics card yet.
    shadow_map : int, optional
        Texels of a shadow map's edge, 64 to 16384. If not given, the power of two nearest to 12.8 times the
        longest edge of any of the scene's pictures, 1024 to 8192 (8192 for 640x480); but 4096 at most where
        more than two lights throw shadows, and 2048 where one of them moves or more than eight throw any.
        Fewer take less memory (4 bytes per texel and map, twice where things move) and less time.
    audit : float, optional
        Share of the tiles that are skipped, or sampled less often than at every instant, which are rendered
        once more and compared (`Report.audited`); no event depends on it. 0.005 where not given, 0 for none.
    cameras : sequence of str or EventCamera, optional
        Cameras to render: names of the scene's own, or cameras to add to it; all of the scene's if not
        given.
    size : (int, int), optional
        Width and height in pixels of every camera; if not given, each camera's own (640x480 where it has
        none).
    labels : sequence of str
        Any of ``depth``, ``flow``, ``instance``, ``semantic``, ``normal``, ``hdr``; ``flow`` stands for
        ``flow_forward`` and ``flow_backward`` with their validity masks. ``cause`` is no image: it tells why
        each event fired (`View.causes`).
    label_rate_hz : float, optional
        Label images and poses per second; 50 where not given.
    frame_rate_hz : float, optional
        Frames per second beside the events, as ``labels["frame"]``: float32 (H, W), mean linear luminance
        over an exposure; ``t_us`` is its middle, `start_us` and `end_us` its ends. None if not given.
    exposure_us : int, optional
        Exposure of those frames: even, and at most the time between two. 10000 where not given, or all of
        that time, rounded down to even, where it is shorter. Only with ``frame_rate_hz``.
    camera_motion : {"none", "orbit", "dolly", "shake"} or path, optional
        How cameras move that the scene leaves at rest: see `Scene.with_camera_motion`. Where not given, only
        the camera of a scene that brings neither a camera nor any motion moves, and a warning says so.
    camera_speed : float, optional
        Mean image speed of that motion in pixels per second; 100 where not given.
    start : float
        Scene time in seconds at which the stream starts; the stream's own time starts at 0.
    seed : int
        Seed of everything random: what is frozen in the sensor, and its noise.
    reference_luminance : float, optional
        Y_ref of the sensor's formula; the value that brings the first camera's log-mean to 0.18 if not given.
    poses : sequence of str
        Names of nodes and cameras whose poses come from outside, with each `step`: a physics engine, an
        agent. They begin where the scene has them, and a `step` may hide them. Such a simulator takes
        ``native`` or ``decoupled`` sampling, and neither streams nor exposes frames.
    materials : sequence of str
        Names of materials that a `step` may change, or of nodes where no material has the name: what such a
        node draws gets materials of its own, which change for it alone. Otherwise as ``poses``.
    lights : sequence of str
        Names of lights that a `step` may change, or of nodes that carry one where no light has the name: such
        a node gets a light of its own. Otherwise as ``poses``, which also moves lights.
    pose_step_us : int, optional
        With ``poses``, ``materials`` or ``lights``: steps are multiples of so many microseconds; 10000 where
        not given. With ``native`` sampling it is a multiple of the time between two samples (250 us in every
        preset but ``reference``, which has 125).
    dense : str or Dense, optional
        Packets carry this array of each window of time in the place of events (`View.dense`,
        `Packet.stack_dense`): ``event_frame``, ``counts``, ``voxel_grid``, ``time_surface`` or a
        `evis.representations.Dense` of one of them. With ``native`` and ``splat`` on a graphics device it is
        made there, and no event leaves it; it is the array of the same events everywhere. Not with the label
        ``cause``.
    dense_window_us : int, optional
        Length of these windows, 1000 to 60 000 000 microseconds, 10 000 where not given; they begin at its
        multiples, in stream time, and each is part of the packet in which it ends. Only with ``dense``.
    device : Device, str or int, optional
        A device, its index, or a part of its name; the fastest kind where not given. Where the machine has
        none, presets take decoupled sampling.

    Raises
    ------
    ConfigError
        If a value cannot be used or a camera does not exist.
    DeviceError
        If there is no such device.
    """

    def __new__(cls, *args: Any, **kwargs: Any) -> Simulator:
        """Keep the arguments, for pickles."""
        made = super().__new__(cls)
        made._made_with = (args, kwargs)
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the settings: what is unpickled is a new simulator, which begins at its start."""
        return _simulator, (type(self), *self._made_with)

    _made_with: tuple[tuple[Any, ...], dict[str, Any]]

    def __init__(
        self,
        scene: Scene,
        *,
        sensor: Sensor | str | Mapping[str, Sensor | str] | None = None,
        quality: Literal["draft", "standard", "high", "reference"] | None = None,
        settings: str | PathLike[str] | None = None,
        method: Method | None = None,
        rate_hz: float | None = None,
        adaptive_px: float | None = None,
        samples: int | None = None,
        antialias: Literal["samples", "edges"] | None = None,
        texture_taps: int | None = None,
        shadows: Literal["maps", "rays"] | None = None,
        compute: Literal["cpu", "gpu"] | None = None,
        shadow_map: int | None = None,
        audit: float | None = None,
        cameras: Sequence[str | EventCamera] | None = None,
        size: tuple[int, int] | None = None,
        labels: Iterable[LabelName] = (),
        label_rate_hz: float | None = None,
        frame_rate_hz: float | None = None,
        exposure_us: int | None = None,
        camera_motion: str | PathLike[str] | None = None,
        camera_speed: float | None = None,
        start: float | None = None,
        seed: int | None = None,
        reference_luminance: float | None = None,
        poses: Sequence[str] = (),
        materials: Sequence[str] = (),
        lights: Sequence[str] = (),
        pose_step_us: int | None = None,
        dense: str | Dense | None = None,
        dense_window_us: int | None = None,
        device: Device | str | int | None = None,
    ) -> None:
        raw_of(scene)
        self._dense = None if dense is None else dense_of(dense)
        if dense is None and dense_window_us is not None:
            raise ConfigError(
                f"dense_window_us is {_check.shown(dense_window_us)}; it must be left out, or given with "
                "dense: the array that is made of each window"
            )
        self._dense_window_us = (
            _USUAL_WINDOW_US
            if dense_window_us is None
            else _check.time_us("dense_window_us", dense_window_us)
        )
        self._driven = [str(name) for name in _check.items("poses", poses, "['a node', 'a camera']")]
        self._changed = [
            str(name) for name in _check.items("materials", materials, "['a material', 'a node']")
        ]
        self._lit = [str(name) for name in _check.items("lights", lights, "['a light']")]
        names: list[str] = []
        if cameras is not None:
            cameras = _check.items("cameras", cameras, f"{list(scene.cameras)}")
            if not cameras:
                raise ConfigError("cameras is empty; it must name a camera, or be None for all")
            added = [camera for camera in cameras if isinstance(camera, EventCamera)]
            scene = scene.with_cameras(added) if added else scene
            names = [camera.name if isinstance(camera, EventCamera) else str(camera) for camera in cameras]
        own = None
        if not (sensor is None or isinstance(sensor, Mapping)):
            own = sensor_of(sensor)
            own.check()
        warp = method if isinstance(method, _method.Warp) else None
        request = Request(
            settings=None if settings is None else fspath(settings),
            sensor=None if own is None else own._json(),
            sensors=_by_camera(sensor) if isinstance(sensor, Mapping) else {},
            quality=_word(quality),
            method=None if warp else _word(method),
            warp=_method.as_json(warp),
            rate_hz=_check.number_or_none("rate_hz", rate_hz),
            adaptive_px=_check.number_or_none("adaptive_px", adaptive_px),
            samples=_check.whole_or_none("samples", samples),
            antialias=_word(antialias),
            texture_taps=_check.whole_or_none("texture_taps", texture_taps),
            shadows=_word(shadows),
            compute=_word(compute),
            shadow_map=_check.whole_or_none("shadow_map", shadow_map),
            audit=_check.number_or_none("audit", audit),
            cameras=names,
            size=None if size is None else _check.size(size),
            start_us=None if start is None else _start_us(start),
            seed=None if seed is None else _check.whole("seed", seed, 0, 2**63 - 1),
            labels=[str(label) for label in _check.items("labels", labels, "['depth', 'flow']")],
            label_rate_hz=_check.number_or_none("label_rate_hz", label_rate_hz),
            frame_rate_hz=_check.number_or_none("frame_rate_hz", frame_rate_hz),
            exposure_us=None
            if exposure_us is None
            else _check.whole("exposure_us", exposure_us, 0, _check.MOST_US, " microseconds"),
            camera_motion=motion_text(camera_motion),
            camera_speed=None if camera_speed is None else _speed(camera_speed),
            reference_luminance=_check.number_or_none("reference_luminance", reference_luminance),
            poses=list(self._driven),
            materials=list(self._changed),
            lights=list(self._lit),
            pose_step_us=None if pose_step_us is None else _check.time_us("pose_step_us", pose_step_us),
            dense=None if self._dense is None else request_of(self._dense, self._dense_window_us),
        )
        self._engine_of = (scene._raw, request, _selector(device))
        self._engine = _evis.Simulator(*self._engine_of)
        self._stream: weakref.ref[Stream] | None = None
        raw = self._engine.scene
        applied = raw.camera_motion
        if applied is None or applied == scene._raw.camera_motion:
            self._scene = scene
        else:
            # A default motion is made again by its name.
            word = motion_text(camera_motion) or applied[0]
            first = names[0] if names else None
            self._scene = Scene(raw, (moved_scene, (scene, word, camera_speed, first, size)))
        self._cameras = tuple(CameraInfo(**camera) for camera in self._engine.cameras)
        self._cameras_of = self._ask_cameras()
        each = (Sensor._of_json(json) for json in self._engine.sensors)
        self._sensors = {camera.name: own for camera, own in zip(self._cameras, each, strict=True)}
        self._labels = tuple(self._engine.labels)
        self._clipped_told = False
        if not (self._driven or self._changed or self._lit):
            _warn_of_motion(scene, self._scene, [camera.name for camera in self._cameras])
            for warning in self._engine.warnings:
                warnings.warn(_evis.printable(warning), stacklevel=2)

    @property
    def scene(self) -> Scene:
        """The scene as it begins, with the cameras that were added, moved as `camera_motion` says.

        Nothing of it is where a host has moved it in steps.
        """
        return self._scene

    @property
    def sensor(self) -> Sensor:
        """The sensor of the first camera; `sensors` has every camera's."""
        return self._sensors[self._cameras[0].name]

    @property
    def sensors(self) -> dict[str, Sensor]:
        """The sensor of each rendered camera by its name, thresholds that the scene gives it included."""
        return dict(self._sensors)

    @property
    def method(self) -> str:
        """Name of the method that samples instants."""
        return self._engine.method

    @property
    def cameras(self) -> tuple[CameraInfo, ...]:
        """The rendered cameras, in order, with the lenses of the first environment."""
        return self._cameras

    def cameras_of(self, environment: int) -> tuple[CameraInfo, ...]:
        """Return the rendered cameras with the lenses that ``environment`` has now.

        Raises
        ------
        ConfigError
            If there is no such environment.
        """
        index = _check.whole("environment", environment)
        if index >= self.environments:
            raise ConfigError(f"environment is {index}; it must be between 0 and {self.environments - 1}")
        return self._cameras_of[index]

    def _ask_cameras(self) -> list[tuple[CameraInfo, ...]]:
        """Return the cameras by environment; equal ones are one object."""
        known: dict[CameraInfo, CameraInfo] = {camera: camera for camera in self._cameras}

        def made(camera: dict[str, Any]) -> CameraInfo:
            own = CameraInfo(**camera)
            return known.setdefault(own, own)

        of = self._engine.cameras_of
        return [tuple(made(camera) for camera in of(index)) for index in range(self.environments)]

    @property
    def environments(self) -> int:
        """Environments rendered side by side."""
        return self._engine.environments

    @property
    def labels(self) -> tuple[str, ...]:
        """Kinds of labels that packets carry."""
        return self._labels

    @property
    def dense(self) -> Dense | None:
        """The dense array that packets carry in the place of events."""
        return self._dense

    @property
    def dense_window_us(self) -> int:
        """Length of the windows of dense arrays, in microseconds."""
        return self._dense_window_us

    @property
    def seed(self) -> int:
        """Seed of everything random."""
        return self._engine.seed

    @property
    def config_toml(self) -> str:
        """The settings in force as TOML, as event files store them."""
        return self._engine.config_toml

    @property
    def quality(self) -> str | None:
        """The preset in force; None where settings were given by hand or by a file."""
        return self._engine.quality

    @property
    def notes(self) -> tuple[str, ...]:
        """What the preset could not have on this scene and device, such as shadow rays."""
        return tuple(self._engine.notes)

    @property
    def reference_luminance(self) -> float | None:
        """Y_ref in force: the one given, or the one found at the start."""
        return self._engine.reference_luminance

    @property
    def device(self) -> Device:
        """The device that renders."""
        return Device(**self._engine.device)

    @property
    def now_us(self) -> int:
        """Stream time up to which `step` has come, in microseconds; 0 again after a stream."""
        return 0 if self._stream is not None and not self._streams() else self._engine.now_us

    def _streams(self) -> bool:
        """Whether a stream has the engine now."""
        stream = None if self._stream is None else self._stream()
        return stream is not None and not stream._ended

    def _own_engine(self) -> _evis.Simulator:
        """Return the engine; after a stream, a new one at the start."""
        if self._streams():
            raise EvisError(
                "a stream has this simulator's engine; close the stream (with sim.stream(...) as stream), "
                "read it to its end, or make another Simulator of the scene"
            )
        if self._stream is not None:
            self._engine, self._stream = _evis.Simulator(*self._engine_of), None
            self._cameras_of = self._ask_cameras()
        return self._engine

    def step(
        self,
        until_us: int,
        poses: Mapping[str, ArrayLike] | None = None,
        *,
        pose_times_us: ArrayLike | None = None,
        velocities: Mapping[str, ArrayLike] | None = None,
        angular_velocities: Mapping[str, ArrayLike] | None = None,
        visible: Mapping[str, ArrayLike] | None = None,
        materials: Mapping[str, Mapping[str, ArrayLike]] | None = None,
        lights: Mapping[str, Mapping[str, ArrayLike]] | None = None,
    ) -> Packet:
        """Run to ``until_us`` and return everything from now on; the GIL is released meanwhile.

        Ctrl-C ends it between intervals and loses nothing: the next step goes on from `now_us`.

        Parameters
        ----------
        until_us : int
            Stream time in microseconds, later than `now_us`; with ``poses``, a multiple of ``pose_step_us``.
        poses : mapping of str to array, optional
            Where the nodes are that a host moves (``poses`` of the simulator), by name: world-from-node at
            ``until_us`` as x, y, z in metres and a unit quaternion qx, qy, qz, qw, shape (7,), or a rigid
            matrix (4, 4). One per environment in front: (E, 7). With ``pose_times_us`` of T times, (T, 7) or
            (E, T, 7). Cameras look along -Z with +Y up. A node without a pose rests during the step. From the
            last pose to the next one positions run straight and rotations turn evenly.
        pose_times_us : array of int, optional
            Stream times of the poses in microseconds, after `now_us` and ascending; the last one is
            ``until_us``. In the first step they may begin at 0, which replaces the pose that the scene has.
        velocities : mapping of str to array, optional
            Metres per second at each pose, (3,) in place of (7,). Between two poses that have one the
            position is the cubic through both (exact for constant acceleration).
        angular_velocities : mapping of str to array, optional
            Radians per second about the axes of the world at each pose, (3,) in place of (7,); at most a turn
            between two poses. Between two poses that have one the rotation is a cubic through both, in
            rotation vectors (exact about a fixed axis, with constant angular acceleration).
        visible : mapping of str to bool or array of bool, optional
            Whether nodes that a host moves are seen, with all that hangs on them but other such nodes; they
            stay so. Not for nodes that carry a camera or a light. The change comes all at once, just after
            `now_us`: light jumps there, and fires events at once. In the first step a node was never
            otherwise. One per environment: (E,). With ``pose_times_us`` of T times, (T,) or (E, T): each
            value holds up to its time, from just after the one before.
        materials : mapping of str to mapping, optional
            New factors of materials that a host changes (``materials`` of the simulator), by name; what is
            not given stays. ``color``: linear RGB, (3,), which multiplies the texture; ``emissive``: emitted
            radiance, (3,), strength included; ``metallic`` and ``roughness``: in [0, 1]. One per environment
            in front. They change when ``visible`` does, once per step. Alpha and textures cannot change.
        lights : mapping of str to mapping, optional
            New values of lights that a host changes (``lights`` of the simulator), by name; what is not given
            stays. ``color``: linear RGB, (3,); ``intensity``: lux or candela; ``on``: whether it shines. One
            per environment in front. They change when materials do. ``poses`` move lights.

        Returns
        -------
        Packet
            Everything in ``[now_us, until_us)``.

        Raises
        ------
        ConfigError
            If ``until_us`` does not lie after `now_us`, or poses cannot be used: names that no host moves,
            shapes, values that are not finite, rotations that are no unit quaternions, times out of order;
            nodes that cannot be hidden, factors that a material does not have. Then nothing has changed.
        DeviceError
            If the device failed.
        EvisError
            If a stream of this simulator runs.
        """
        until = _check.time_us("until_us", until_us)
        given = None
        if poses is not None:
            given = node_poses(
                self._driven, self.environments, until, poses, pose_times_us, velocities, angular_velocities
            )
        elif velocities or angular_velocities:
            raise ConfigError("velocities are given without poses; give both")
        seen = node_visible(self._driven, self.environments, until, visible or {}, pose_times_us)
        changes = material_changes(self._changed, range(self.environments), materials or {})
        lit = light_changes(self._lit, range(self.environments), lights or {})
        raw = self._own_engine().step(until, given, seen, changes, lit)
        return self._packet(raw)

    def _step_rows(self, until_us: int, rows: list[NodePoses]) -> Packet:
        """Run to ``until_us``, with poses as the engine takes them: each node may have times of its own."""
        return self._packet(self._own_engine().step(until_us, rows, [], [], []))

    def _packet(self, raw: _evis.Packet) -> Packet:
        """Return a packet; the first one with light that was clipped warns."""
        packet = packet_from(raw, self._cameras_of, self._labels)
        if packet.report.clipped_light and not self._clipped_told:
            self._clipped_told = True
            warnings.warn(packet.report.clipped_light[0], stacklevel=3)
        return packet

    def reset(
        self,
        env_ids: int | Sequence[int] | npt.NDArray[np.integer[Any]] | None = None,
        *,
        seed: int | Sequence[int] | None = None,
        sensor: EnvironmentSensors | Mapping[str, EnvironmentSensors] | None = None,
        poses: Mapping[str, ArrayLike] | None = None,
        visible: Mapping[str, ArrayLike] | None = None,
        materials: Mapping[str, Mapping[str, ArrayLike]] | None = None,
        lights: Mapping[str, Mapping[str, ArrayLike]] | None = None,
        lenses: Mapping[str, Mapping[str, ArrayLike]] | None = None,
    ) -> None:
        """Reset environments and their pixel memory at `now_us`; the time goes on.

        What the pixels of these environments see at `now_us` becomes their reference, as at the start of a
        stream; filters rest at it, no pixel is refractory, and no event of theirs from before is still to
        come. Events of other environments do not change by a byte. Labels are those of the new poses from
        `now_us` on, and flow does not look back beyond it.

        Parameters
        ----------
        env_ids : int or sequence of int, optional
            The environments; all where not given. None of them where it is empty.
        seed : int or sequence of int, optional
            Seed of everything random in these environments from now on, one for all or one each: what is
            frozen in their sensors, and noise, as in a simulator of this seed at this time. What is frozen
            stays where not given; noise is a function of time, and does not come again either way.
        sensor : Sensor, str, sequence or mapping of them by camera, optional
            Sensors of these environments from now on, one for all or one per environment of ``env_ids``, such
            as ``[base.sample(ranges, seed) for seed in seeds]``; for every camera, or by its name. They may
            differ from the simulator's sensor in thresholds and their spread, bandwidth, leak, noise,
            refractory period, latency and bus; a stage that is on stays on, and what is off stays off. Where
            no seed is given, each pixel keeps its draw: one sigma above the mean stays one sigma above. Files
            of `Writer` name the sensor that the simulator was made with.
        poses : mapping of str to array, optional
            Where the nodes jump to that a host moves, without any event: as of `step`, (7,) or (4, 4), or one
            per environment of ``env_ids`` in front. A node without a pose stays where it is.
        visible : mapping of str to bool or array of bool, optional
            Which of these nodes are seen from now on, without any event: one, or one per environment of
            ``env_ids``. Others stay as they are.
        materials : mapping of str to mapping, optional
            Factors of materials from now on, without any event: as of `step`, with one per environment of
            ``env_ids`` in front.
        lights : mapping of str to mapping, optional
            Values of lights from now on, without any event: as of `step`, with one per environment of
            ``env_ids`` in front.
        lenses : mapping of str to mapping, optional
            Lenses of cameras from now on, by camera: ``fov_y_degrees``, ``orthographic_height`` and ``far``
            in metres, or ``fx``, ``fy``, ``cx`` and ``cy`` in pixels of the camera's own size; each one
            number, or one per environment of ``env_ids``. Views of later packets, and `cameras_of`, tell
            them; files of `Writer` those of the first packet. Not for cameras with a distortion.

        Raises
        ------
        ConfigError
            If an environment does not exist or is named twice; if poses cannot be used; for a sensor that
            cannot be, or has other stages than the simulator's; for methods with
            keyframes and sensors with an exposure; and where `now_us` is not the end of a step to where
            samples are, which with ``poses`` of the simulator it always is, unless Ctrl-C ended the step.
            Then nothing has changed.
        DeviceError
            If the device failed.
        EvisError
            If a stream of this simulator runs.
        """
        if env_ids is None:
            environments = list(range(self.environments))
        elif hasattr(env_ids, "__index__") and np.ndim(env_ids) == 0:
            environments = [_check.whole("env_ids", env_ids)]
        else:
            environments = _check.wholes("env_ids", env_ids)
        if any(environment >= self.environments for environment in environments):
            raise ConfigError(
                f"env_ids is {_check.shown(env_ids)}; it must be between 0 and {self.environments - 1}"
            )
        seeds: list[int] = []
        if seed is not None:
            each = (
                [seed] * len(environments)
                if hasattr(seed, "__index__") and np.ndim(seed) == 0
                else _check.items("seed", seed, "[0, 1]")
            )
            seeds = [_check.whole("seed", one, 0, 2**63 - 1) for one in each]
        sensors = [] if sensor is None else self._environment_sensors(environments, sensor)
        jumps = [] if poses is None else node_jumps(self._driven, environments, poses)
        seen = visible_jumps(self._driven, environments, visible or {})
        changes = material_changes(self._changed, environments, materials or {})
        lit = light_changes(self._lit, environments, lights or {})
        names = [camera.name for camera in self._cameras]
        other = lens_changes(names, environments, lenses or {})
        self._own_engine().reset(environments, seeds, sensors, other, jumps, seen, changes, lit)
        if other:
            self._cameras_of = self._ask_cameras()
            self._cameras = self._cameras_of[0]

    def _environment_sensors(self, environments: list[int], sensor: Any) -> list[tuple[int, int, str]]:
        """Environment, index of the camera, and sensor as JSON."""
        names = [camera.name for camera in self._cameras]
        given = sensor if isinstance(sensor, Mapping) else dict.fromkeys(names, sensor)
        made = []
        for name, each in given.items():
            if name not in names:
                raise ConfigError(f"sensor names the camera {name!r}; it must be {_check.one_of(names)}")
            alone = isinstance(each, (Sensor, str))
            own = (
                [each] * len(environments) if alone else _check.items("sensor", each, "[Sensor(), Sensor()]")
            )
            if len(own) != len(environments):
                raise ConfigError(
                    f"sensor has {len(own)} sensors for {len(environments)} environments; one, or one each"
                )
            for environment, one in zip(environments, own, strict=True):
                if one is None:
                    raise ConfigError("sensor holds None; it must hold sensors, or names of presets")
                made.append((environment, names.index(name), sensor_of(one)._json()))
        return made

    def stream(
        self,
        *,
        duration: float | None = None,
        packet_us: int = 10_000,
        progress: bool | Callable[[StreamProgress], object] = False,
    ) -> Stream:
        """Stream packets, rendered ahead while Python works.

        A stream begins where `step` has come. While it runs, this simulator neither steps nor streams. Once
        it has ended or was closed, the simulator is at its start again: the next stream gives the same bytes.
        Events and labels do not depend on ``packet_us``. Ctrl-C stops between intervals.

        Parameters
        ----------
        duration : float, optional
            Seconds from now; to the end of the scene's motion where not given.
        packet_us : int
            Length of a packet in microseconds; the last one may be shorter.
        progress : bool or callable
            True shows a bar with the time left on standard error, or a line every ten seconds where that is
            no terminal. A callable is given a `StreamProgress` after every packet.

        Returns
        -------
        Stream
            An iterator of `Packet`; use it in ``with`` to stop early.

        Raises
        ------
        ConfigError
            If a value is not positive, or the scene has no end and no duration is given.
        EvisError
            If another stream of this simulator runs.
        """
        own = self._own_engine()
        if duration is None:
            end = self._scene.duration
            if end is None:
                raise ConfigError("this scene's motion has no end: give duration, in seconds")
            left_us = _check.micros("duration", end) - self._engine.start_us - self.now_us
            if left_us <= 0:
                raise ConfigError(
                    f"this scene's motion has ended, {end} s after 0: give duration, in seconds"
                )
        else:
            left_us = _check.duration_us("duration", duration)
        end_us = self.now_us + left_us
        engine = own.stream(left_us, _check.time_us("packet_us", packet_us))
        stream = Stream(self, engine, end_us, progress)
        # Weakly: a stream that is garbage-collected returns the engine.
        self._stream = weakref.ref(stream)
        return stream

    def __repr__(self) -> str:
        """Say what renders where."""
        cameras = ", ".join(f"{camera.name} {camera.width}x{camera.height}" for camera in self._cameras)
        cameras = _evis.printable(cameras)
        return f"Simulator({self._scene.name!r}, {self.environments} x [{cameras}] on {self.device.name})"


@dataclass(frozen=True, slots=True)
class StreamProgress:
    """How far a stream has come.

    Attributes
    ----------
    t_us, start_us, end_us : int
        Stream time that is reached, and that the stream starts and ends at, in microseconds.
    events : int
        Events so far, of all cameras and environments.
    elapsed_s : float
        Seconds since the stream was asked for.
    left_s : float, optional
        Seconds left by what was measured so far; it never rises. None in the first second.
    """

    t_us: int
    start_us: int
    end_us: int
    events: int
    elapsed_s: float
    left_s: float | None


class Stream(Iterator[Packet]):
    """Packets in order, made by `Simulator.stream`. Leaving it, by ``with`` or `close`, stops the engine."""

    def __init__(
        self,
        simulator: Simulator,
        engine: _evis.Stream,
        end_us: int,
        progress: bool | Callable[[StreamProgress], object] = False,
    ) -> None:
        self._start_us = simulator.now_us
        self._on_progress = progress if callable(progress) else None
        self._bar = Progress(end_us - self._start_us, "us of stream") if progress is True else None
        self._began, self._left, self._count = time.monotonic(), TimeLeft(), 0
        self._simulator = simulator
        self._end_us = end_us
        self._engine = engine
        self._last_us = -1
        self._events: int | None = 0
        self._ended = False

    @property
    def simulator(self) -> Simulator:
        """The simulator that it came from."""
        return self._simulator

    @property
    def end_us(self) -> int:
        """Stream time at which the stream ends, in microseconds."""
        return self._end_us

    def __next__(self) -> Packet:
        """Wait for the next packet; the GIL is released meanwhile. A stream without any event warns."""
        try:
            raw = next(self._engine)
        except StopIteration:
            self._ended = True
            if self._bar is not None:
                self._bar.close()
            if self._last_us == self._end_us and self._events == 0:
                warnings.warn(NO_EVENT, stacklevel=2)
                self._events = None
            raise
        except BaseException:
            # Ctrl-C and failures end the engine too.
            self._ended = True
            raise
        packet = self._simulator._packet(raw)
        if self._events is not None:
            self._events += packet.report.events
        self._last_us = packet.end_us
        self._count += packet.report.events
        if self._bar is not None:
            self._bar.reach(packet.end_us - self._start_us)
        if self._on_progress is not None:
            self._on_progress(self._progress(packet.end_us))
        return packet

    def _progress(self, t_us: int) -> StreamProgress:
        elapsed_s = time.monotonic() - self._began
        left_s = self._left.after(elapsed_s, (t_us - self._start_us) / max(self._end_us - self._start_us, 1))
        return StreamProgress(t_us, self._start_us, self._end_us, self._count, elapsed_s, left_s)

    def close(self) -> None:
        """Stop the engine after the interval in work; closing twice does nothing."""
        if self._bar is not None:
            self._bar.close()
        self._engine.close()
        self._ended = True

    def __repr__(self) -> str:
        """Say where it is, and of which simulator."""
        at = "ended" if self._ended else f"at {max(self._last_us, self._start_us)} us"
        return f"Stream({at} of {self._start_us} to {self._end_us} us, {self._simulator!r})"

    def __enter__(self) -> Stream:
        """Return the stream."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the engine."""
        self.close()


def _simulator(cls: type[Simulator], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Simulator:
    return cls(*args, **kwargs)


NO_EVENT = (
    "no event was fired: nowhere did light change by a threshold; see with frame_rate_hz=10 what the cameras "
    "see, lower the sensor's thresholds, or raise camera_speed"
)


def _warn_of_motion(given: Scene, moved: Scene, cameras: list[str]) -> None:
    """Warn of a default camera motion, and of a static scene."""
    applied = moved._raw.camera_motion
    if given._raw.camera_motion is None and applied is not None and applied[2]:
        warnings.warn(_evis.printable(moved.warnings[-1]), stacklevel=3)
    elif moved._raw.rests(cameras):
        warnings.warn(
            "nothing moves and no light changes, so nothing but noise can fire: camera_motion='orbit', "
            "'dolly' or 'shake' moves the camera",
            stacklevel=3,
        )


def _by_camera(sensors: Mapping[str, Sensor | str]) -> dict[str, str]:
    """Check sensors of single cameras; errors name the camera."""
    checked = {}
    for camera, sensor in sensors.items():
        if not isinstance(camera, str) or not isinstance(sensor, (Sensor, str)):
            raise ConfigError(
                f"sensor has {camera!r}: {sensor!r}; it must map names of cameras to sensors or to names of "
                "presets"
            )
        try:
            own = Sensor.preset(sensor) if isinstance(sensor, str) else sensor
            own.check()
        except ConfigError as error:
            raise ConfigError(f"camera '{camera}': {error}") from None
        checked[camera] = own._json()
    return checked


def _start_us(start: Any) -> int:
    start_us = _check.micros("start", start)
    if not 0 <= start_us <= 86_400_000_000:
        raise ConfigError(f"start is {start}; it must be between 0 and 86400 seconds")
    return start_us


def _speed(camera_speed: Any) -> float:
    speed = _check.number("camera_speed", camera_speed, " pixels per second")
    if not 0.01 <= speed <= 100_000:
        raise ConfigError(f"camera_speed is {speed:g}; it must be from 0.01 to 100000 pixels per second")
    return speed


def _word(value: object) -> str | None:
    return None if value is None else str(value)


def _selector(device: Device | str | int | None) -> str | None:
    if device is None:
        return None
    return str(device.index) if isinstance(device, Device) else str(device)
